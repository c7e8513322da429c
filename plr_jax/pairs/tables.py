"""What a query of pairs reads: walls, corners, distances between them, and the list of corners of each leaf."""

from dataclasses import dataclass, field, replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt16, UInt32

from plr_jax._arrays import padded, padded_size, runs, size_in_eighths
from plr_jax.geometry.box import Box
from plr_jax.pairs.near_walls import NearWalls
from plr_jax.pairs.occluders import occluders_of
from plr_jax.pairs.portable import MARGIN, RECEDING, seen_corners, walls_with_sides
from plr_jax.pairs.stored import Stored, distances_table
from plr_jax.plr.frame import unresolved_types
from plr_jax.plr.tables import Tables, build_tables

_UNROLLED = 16  # walls, or occluders, at a time
_LEAVES_AT_ONCE = 32


@dataclass(frozen=True)
class _NoLeaf:
    """What the tables of a partition alone ask of a leaf model."""

    least_bytes: float = 1.0
    has_deep_trees: bool = False


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class PairTables:
    """All that a query reads. Coordinates count from the middle of the domain.

    Attributes:
        partition: Finds leaves.
        walls: Ends of the walls that block sight, moved back a little; groups of them, padded with empty ones.
        occluders: Segments inside obstacles, see :func:`occluders_of`; groups, padded with zeros.
        near: Walls that may hide a corner of a leaf's list; None where they are too many to be worth it.
        x: First coordinate of the corners of each leaf's list; padding is ``inf``.
        y: Second coordinate.
        listed: The corners; padding is one more than the last corner.
        distances: Distance between each two corners, row by row; ``inf`` for padding.
        onward: Two numbers in one, about the ways from each corner, by a corner of a leaf's list, to anywhere in the
            leaf's box: in the last bits the corner of the list by which the shortest goes; in the other bits, as a
            float, a lower bound of the length of all ways by other corners of the list.
        corners: The corners; padding is ``inf``.
        middle: The middle of the domain, in 32 bits, and what they leave of it.
        half: Half its width, along each axis.
        proud_walls: Ends of the walls moved into free space instead.
        proud_corners: The corners moved into it twice as far.
        rounding: The largest error of distances by way of the corners, from the rounding of points in the file; and
            that of distances by way of the proud corners, which is larger.
        unresolved: Types of points that cannot be answered, see :func:`unresolved_types`.
        is_certain: Whether what counts as a way is certainly free, see :attr:`in_free_space`.
    """

    partition: Tables
    walls: Float[Array, "groups 16 7"]
    occluders: Float[Array, "groups_of_occluders 16 7"]
    near: NearWalls | None
    x: Float[Array, "leaves longest"]
    y: Float[Array, "leaves longest"]
    listed: UInt16[Array, "leaves longest"]
    distances: Float[Array, "size size"]
    onward: UInt32[Array, "leaves size"]
    corners: Float[Array, "size 2"]
    middle: Float[Array, "2 2"]
    half: Float[Array, "2"]
    proud_walls: Float[Array, "groups 16 7"]
    proud_corners: Float[Array, "size 2"]
    rounding: Float[Array, "2"]
    unresolved: tuple[str, ...] = field(metadata={"static": True})
    is_certain: bool = field(default=False, metadata={"static": True})

    @property
    def in_free_space(self) -> "PairTables":
        """The same, but what counts as a way is certainly free."""
        x, y = (along[self.listed] for along in self.proud_corners.T)
        return replace(self, walls=self.proud_walls, near=None, x=x, y=y, is_certain=True)


def build_pair_tables(stored: Stored, num_bytes: int) -> PairTables:
    """The tables of what a file of so many bytes holds."""
    middle = (stored.domain.lo + stored.domain.hi) / 2
    domain = Box(stored.domain.lo - middle, stored.domain.hi - middle)
    cells, count = stored.cells, len(stored.corner)
    partition = build_tables(domain, cells, np.zeros((len(cells), 1)), _NoLeaf(), num_bytes)
    size, rows = size_in_eighths(count + 1), size_in_eighths(len(cells))
    distances = jnp.asarray(distances_table(stored, size))
    listed = _listed(stored, rows, count)
    width = float(stored.domain.width.max())
    corners = seen_corners(stored)
    aside = float(np.linalg.norm(corners - stored.points, axis=1).max(initial=0.0))
    points = np.append(corners - middle, np.full((1, 2), np.inf), axis=0)
    boxes = cells.grown_boxes(domain)
    receding = RECEDING * width
    walls = stored.outline.moved_walls(receding) - np.tile(middle, 2)
    near = NearWalls.of(boxes, stored.leaf, stored.listed, points[:-1], walls, MARGIN * width, listed.shape)
    proud = stored.outline.moved_points(-2 * receding)[stored.corner] - middle
    farther = float(np.linalg.norm(proud + middle - stored.points, axis=1).max(initial=0.0))
    x, y = (along[listed] for along in points.T)
    return PairTables(
        partition=partition,
        walls=_in_groups(walls_with_sides(walls)),
        occluders=_in_groups(_occluders(stored, receding)),
        near=near,
        x=_in_32_bits(x),
        y=_in_32_bits(y),
        listed=jnp.asarray(listed),
        distances=distances,
        onward=_ways_to_leaves(distances, listed, _beside(points[listed], *boxes)),
        corners=_in_32_bits(padded(points, size, np.inf)),
        middle=_in_32_bits(np.stack([middle, middle - middle.astype(np.float32)])),
        half=_in_32_bits(stored.domain.width / 2),
        proud_walls=_in_groups(walls_with_sides(stored.outline.moved_walls(-receding) - np.tile(middle, 2))),
        proud_corners=_in_32_bits(padded(proud, size, np.inf)),
        rounding=_in_32_bits(stored.rounding + 2 * np.array([aside, farther])),
        unresolved=unresolved_types(stored.domain),
    )


def _occluders(stored: Stored, receding: float) -> Float[np.ndarray, "occluders 7"]:
    """Occluders farther inside obstacles than walls move back."""
    try:
        region = stored.outline.region
    except ValueError:  # details narrower than the lattice: their walls are all that is known
        return np.zeros((0, 7))
    return occluders_of(region, stored.domain, 4 * receding, len(stored.outline.points))


def _in_32_bits(values: Float[np.ndarray, "*n"]) -> Float[Array, "*n"]:
    return jnp.asarray(values.astype(np.float32))


def _in_groups(rows: Float[np.ndarray, "n 7"]) -> Float[Array, "groups 16 7"]:
    """Rows in groups, the last ones zeros: walls without length, and occluders that nothing is beside."""
    size = _UNROLLED * size_in_eighths(-(-len(rows) // _UNROLLED))
    return _in_32_bits(padded(rows, size).reshape(-1, _UNROLLED, 7))


def _listed(stored: Stored, rows: int, count: int) -> UInt16[np.ndarray, "rows longest"]:
    """The lists as rows of one length, a multiple of eight."""
    lengths = np.bincount(stored.leaf, minlength=rows)
    listed = np.full((rows, 8 * max(1, -(-int(lengths.max()) // 8))), count)
    listed[runs(lengths)] = stored.listed
    return listed.astype(np.uint16)


def _beside(
    points: Float[np.ndarray, "rows longest 2"], lo: Float[np.ndarray, "leaves 2"], hi: Float[np.ndarray, "leaves 2"]
) -> Float[np.ndarray, "rows longest"]:
    """How far the corners of lists are from their leaves' boxes, at least; ``inf`` for padding."""
    result = np.full(points.shape[:2], np.inf, np.float32)
    of_leaf = points[: len(lo)]
    apart = np.maximum(np.maximum(lo[:, None] - of_leaf, of_leaf - hi[:, None]), 0)
    result[: len(lo)] = np.nextafter(np.hypot(apart[..., 0], apart[..., 1]).astype(np.float32), np.float32(0))
    return result


def last_bits_of(size: int) -> np.uint32:
    """The bits of a number that tell as many corners."""
    return np.uint32(padded_size(size) - 1)


@jax.jit
def _ways_to_leaves(
    distances: Float[Array, "size size"], listed: UInt16[Array, "rows longest"], beside: Float[Array, "rows longest"]
) -> UInt32[Array, "rows size"]:
    """The corner of each leaf's list by which the shortest way from each corner goes, and the shortest by another."""
    rows, longest = listed.shape
    size = len(distances)
    last_bits = last_bits_of(size)

    def of_leaves(leaves):
        corners, near = leaves

        def with_corner(column, found):
            shortest, other, last = found
            way = near[:, column, None] + distances[corners[:, column]]
            is_shorter = way < shortest
            other = jnp.minimum(other, jnp.maximum(way, shortest))
            return jnp.minimum(way, shortest), other, jnp.where(is_shorter, corners[:, column, None], last)

        shape = len(corners), size
        none = jnp.full(shape, jnp.inf, jnp.float32)
        begin = none, none, jnp.full(shape, size - 1, jnp.uint32)
        count = (near < jnp.inf).sum(axis=1).max()
        _, other, last = jax.lax.fori_loop(0, count, with_corner, begin)
        other *= np.float32(1 - 4 * np.finfo(np.float32).eps)  # whose last bits, if it is `inf`, are zeros
        return jax.lax.bitcast_convert_type(other, jnp.uint32) & ~last_bits | last

    step = np.gcd(rows, _LEAVES_AT_ONCE)
    parts = (each.reshape(-1, step, longest) for each in (listed.astype(jnp.uint32), beside))
    return jax.lax.map(of_leaves, tuple(parts)).reshape(rows, size)
