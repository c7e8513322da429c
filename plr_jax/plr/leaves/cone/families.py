"""Fitting sources all at once: the offset of one is that of its parent and the way there.

So far fewer numbers explain the samples, and each is the more certain.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax.plr.leaves.cone.fit import Cones, Samples, normal_equations
from plr_jax.plr.leaves.sparse_squares import solve_sparse, weighted_squares

if TYPE_CHECKING:
    from scipy.sparse import csr_array

_STEPS = 6


def fit_families(cones: Cones, samples: Sequence[Samples], parents: Int[np.ndarray, "sources"]) -> Cones:
    """Cones that err least at the samples of each, by Gauss-Newton steps from given ones.

    A source that is its own parent, a root, keeps an offset of its own; without children it stays as it is.
    """
    each = np.arange(len(parents))
    is_root = parents == each
    in_family = ~is_root
    in_family[parents[~is_root]] = True
    if not in_family.any():
        return cones
    chains, point, root_offset = _chains(parents), cones.point, np.where(is_root, cones.offset, 0.0)
    count, dim = point.shape
    used = np.append(np.repeat(in_family, dim), is_root & in_family)
    for _ in range(_STEPS):
        here = _with_offsets(point, root_offset, parents, chains)
        step = _step(here, samples, parents, chains, used)
        point = point - step[: count * dim].reshape(count, dim)
        root_offset = root_offset - step[count * dim :]
    return _with_offsets(point, root_offset, parents, chains)


def _chains(parents: Int[np.ndarray, "sources"]) -> "csr_array":
    """Which sources are on the way from each one to its root, itself and the root among them, as ones."""
    from scipy.sparse import csr_array, eye_array

    child = np.flatnonzero(parents != np.arange(len(parents)))
    onward = csr_array((np.ones(len(child)), (child, parents[child])), shape=(len(parents), len(parents)))
    chains = farther = csr_array(eye_array(len(parents)))
    while (farther := csr_array(farther @ onward)).nnz:
        chains = csr_array(chains + farther)
    return chains


def _with_offsets(
    point: Float[np.ndarray, "sources dim"],
    root_offset: Float[np.ndarray, "sources"],
    parents: Int[np.ndarray, "sources"],
    chains: "csr_array",
) -> Cones:
    """Cones whose offsets follow from their parents."""
    return Cones(point, chains @ (root_offset + np.linalg.norm(point - point[parents], axis=1)))


def _step(
    cones: Cones,
    samples: Sequence[Samples],
    parents: Int[np.ndarray, "sources"],
    chains: "csr_array",
    used: Bool[np.ndarray, "parameters"],
) -> Float[np.ndarray, "parameters"]:
    """By how much coordinates of all sources, then offsets of all roots, are too large; 0 for those not in use."""
    from scipy.sparse import diags_array

    equations = [normal_equations(samples[i], cones[[i]]) for i in range(len(cones))]
    normal, moments = (np.concatenate(part) for part in zip(*equations, strict=True))
    of_parameters = _numbers_of_parameters(cones, parents, chains) @ diags_array(used.astype(np.float64))
    squares = weighted_squares(of_parameters, normal) + diags_array((~used).astype(np.float64))
    return solve_sparse(squares, of_parameters.T @ moments.ravel())


def _numbers_of_parameters(cones: Cones, parents: Int[np.ndarray, "sources"], chains: "csr_array") -> "csr_array":
    """By how much coordinates and offset, source by source, grow with each parameter."""
    from scipy.sparse import csr_array, hstack, vstack

    count, dim = cones.point.shape
    way = cones.point - cones.point[parents]
    length = np.linalg.norm(way, axis=1, keepdims=True)
    way = (way / np.where(length > 0, length, 1)).ravel()
    row, column = np.repeat(np.arange(count), dim), np.arange(count * dim)
    of_parent = (parents[:, None] * dim + np.arange(dim)).ravel()
    entries = np.append(way, -way), (np.append(row, row), np.append(column, of_parent))
    lengths = hstack([csr_array(entries, shape=(count, count * dim)), csr_array(np.eye(count))])
    coordinates = csr_array((np.ones(count * dim), (column, column)), shape=(count * dim, count * (dim + 1)))
    number = np.column_stack([column.reshape(count, dim), count * dim + np.arange(count)])
    return csr_array(csr_array(vstack([coordinates, chains @ lengths]))[number.ravel()])
