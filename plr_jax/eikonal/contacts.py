"""Where open cells of a mesh touch in an edge or a corner alone, with blocked ones in between.

From such a place a path may begin on either side, and in a space that lets robots squeeze through it may pass. So
blocked cells there that are flush with free space count as mixed: through them, what is known on one side meets what
is known on the other.
"""

from itertools import product

import numpy as np
from jaxtyping import Bool, Float

from plr_jax.eikonal.mesh import Mesh
from plr_jax.geometry.voxels import spread
from plr_jax.spaces import CellState, ConfigurationSpace


def with_open_contacts(mesh: Mesh, space: ConfigurationSpace) -> Mesh:
    """The mesh with such cells counted as mixed."""
    signs = np.array(list(product((-1, 1), repeat=mesh.dim)))
    while mesh.dim > 1:
        middle, half = _edges(mesh)
        x = middle[:, None] + signs * mesh.inset
        around = mesh.locate(np.where(mesh.domain.periodic, x % 1.0, x).reshape(-1, mesh.dim)).reshape(x.shape[:2])
        is_open = (mesh.state[around] != CellState.BLOCKED) & (((x > 0) & (x < 1)) | mesh.domain.periodic).all(axis=2)
        # What is beside the edge may be blocked, though its cell is not.
        edge, side = np.nonzero(is_open & _are_parted(is_open)[:, None])
        beside = middle[edge] + np.where(half[edge] > 0, 0.0, signs[side] * mesh.inset)
        lo, hi = np.minimum(middle[edge], beside) - half[edge], np.maximum(middle[edge], beside) + half[edge]
        lo, hi = (mesh.domain.at(end) for end in (lo, hi))
        is_open[edge, side] = space.classify(lo, hi) != CellState.BLOCKED
        touches = np.zeros(len(mesh.state), bool)
        touches[around[_are_parted(is_open)]] = True
        touches &= mesh.is_flush & (mesh.state == CellState.BLOCKED)
        if not touches.any():
            break
        mesh = mesh.with_state(np.where(touches, np.int8(CellState.MIXED), mesh.state))
    return mesh


def _are_parted(is_open: Bool[np.ndarray, "edges sides"]) -> Bool[np.ndarray, "edges"]:
    """Whether some open sides are joined to others through no open ones."""
    is_first = is_open & (np.cumsum(is_open, axis=1) == 1)
    return np.asarray((is_open & ~spread(is_first, is_open)).any(axis=1))


def _edges(mesh: Mesh) -> tuple[Float[np.ndarray, "edges dim"], Float[np.ndarray, "edges dim"]]:
    """What edges and corners of flush cells have in common with open cells: middles and half widths, fractions."""
    flush, beside = mesh.flush_pairs
    shares = np.array(list(product((0.0, 0.5, 1.0), repeat=mesh.dim)))
    lo, hi = (mesh.fractions(flush, np.full(mesh.dim, end)) for end in (0.0, 1.0))
    low, high, _ = mesh.shared_boxes(flush, beside)
    x = low[:, None] + (high - low)[:, None] * shares
    half = np.where(shares == 0.5, (high - low)[:, None] / 2, 0.0)
    is_edge = ((x == lo[:, None]) | (x == hi[:, None])).sum(axis=2) > 1
    both = np.unique(np.append(np.where(mesh.domain.periodic, x % 1.0, x), half, axis=2)[is_edge], axis=0)
    return both[:, : mesh.dim], both[:, mesh.dim :]
