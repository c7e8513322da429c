"""Tables of a PairPLR's file that queries in JAX read."""

from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt16, UInt32

from plr_jax._arrays import padded, padded_size, ragged_indices, size_in_eighths
from plr_jax.geometry.box import Box
from plr_jax.pairs.hiding import NearWalls, occluders_of
from plr_jax.pairs.portable import MARGIN, RECEDING, Scene, walls_with_sides
from plr_jax.pairs.stored import PairsFileData, distances_table
from plr_jax.plr.frame import unresolved_types
from plr_jax.plr.tables import Tables, build_tables

_UNROLLED, _CLUSTER = 16, 32  # occluders, and neighboring walls in a box, tested in one step of a loop
_LEAVES_AT_ONCE = 32
_NOWHERE = 1e30  # a coordinate beyond every domain, for boxes of no walls


@dataclass(frozen=True)
class _NoLeaf:
    least_bytes: float = 1.0
    has_deep_trees: bool = False


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Walls:
    """Groups of neighboring walls, seven coefficients a wall (:func:`walls_with_sides`).

    Each box, ``(x, y)`` of its middle and then half its widths, contains a group, with a margin for rounding.
    """

    groups: Float[Array, "groups 32 7"]
    boxes: Float[Array, "groups 4"]


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class PairTables:
    """The tables that a query reads. Coordinates are relative to the middle of the domain.

    Attributes:
        walls: Walls that block sight, moved back a little.
        occluders: Segments inside obstacles (:func:`occluders_of`), in groups.
        near: Walls that may hide a listed corner; None if they are too many to save time.
        x: First coordinate of the corners that each leaf lists, padded with ``inf``; ``y`` likewise.
        listed: Indices of the corners that each leaf lists; the padding is one more than the last index.
        onward: For each leaf and corner, two packed numbers about paths from the corner to the leaf's box through a
            corner that the leaf lists. The last bits are the listed corner of the shortest path; the rest is a float,
            a lower bound of the length through any other.
        middle: The middle of the domain in 32 bits, and the remainder.
        half: Half the domain width along each axis.
        proud_walls: Walls moved into free space; ``proud_corners`` move twice as far.
        sure_walls: Walls for lower bounds, without thin obstacles and with gaps where obstacles touch; None if equal
            to ``walls``.
        rounding: Largest error of a distance through ``corners``, and through ``proud_corners``.
        unresolved: Point types that cannot be answered (:func:`unresolved_types`).
        is_certain: Whether every path found is certainly free.
    """

    partition: Tables
    walls: Walls
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
    proud_walls: Walls
    proud_corners: Float[Array, "size 2"]
    sure_walls: Walls | None
    rounding: Float[Array, "2"]
    unresolved: tuple[str, ...] = field(metadata={"static": True})
    is_certain: bool = field(default=False, metadata={"static": True})


def table_size(num_corners: int) -> int:
    """Return the number of rows of tables of corners: out of few sizes, with a row of ``inf`` for padding."""
    return size_in_eighths(num_corners + 1)


def build_pair_tables(stored: PairsFileData, num_bytes: int) -> PairTables:
    """Build the tables of a file of ``num_bytes`` bytes, from which some of their sizes follow."""
    middle = (stored.domain.lo + stored.domain.hi) / 2
    domain = Box(stored.domain.lo - middle, stored.domain.hi - middle)
    cells, count = stored.cells, len(stored.corner)
    size, rows = table_size(count), size_in_eighths(len(cells))
    seen, free = (Scene.of(stored, is_certain) for is_certain in (False, True))
    sure = Scene.of(stored, False, hides_surely=True).walls
    # 1. Pad the lists to one length, a multiple of eight.
    lengths = np.bincount(stored.leaf, minlength=rows)
    listed = np.full((rows, 8 * max(1, -(-int(lengths.max()) // 8))), count, np.uint16)
    listed[ragged_indices(lengths)] = stored.listed
    # 2. Bound the distances of listed corners to their leaves' boxes from below; `inf` for padding.
    (lo, hi), of_leaf = cells.grown_boxes(domain), seen.corners[listed[: len(cells)]]
    apart = np.maximum(np.maximum(lo[:, None] - of_leaf, of_leaf - hi[:, None]), 0)
    beside = np.full(listed.shape, np.inf, np.float32)
    beside[: len(cells)] = np.nextafter(np.hypot(*np.moveaxis(apart, -1, 0)).astype(np.float32), np.float32(0))
    # 3. Choose occluders deeper inside obstacles than walls move back, and find walls near listed corners.
    try:
        depth = 4 * RECEDING * float(stored.domain.width.max())
        occluders = occluders_of(stored.outline.region, stored.domain, depth, len(stored.outline.points))
    except ValueError:  # the file has details finer than its lattice: only walls block sight
        occluders = np.zeros((0, 7))
    margin = MARGIN * float(stored.domain.width.max())
    near = NearWalls.of((lo, hi), stored.leaf, stored.listed, seen.corners[:-1], seen.walls, margin, listed.shape)

    def in_32_bits(values: Float[np.ndarray, "*n"]) -> Float[Array, "*n"]:
        return jnp.asarray(values.astype(np.float32))

    def in_groups(rows: Float[np.ndarray, "n 7"], of: int) -> Float[Array, "groups {of} 7"]:
        groups = size_in_eighths(-(-len(rows) // of))
        return in_32_bits(padded(rows, of * groups).reshape(-1, of, 7))

    def in_boxes(walls: Float[np.ndarray, "n 4"]) -> Walls:
        ends = walls.reshape(-1, 2, 2)
        # Sort the walls by the Morton code of their middles, so that groups are compact.
        place = ((ends.mean(axis=1) / domain.width + 0.5) * 2**10).astype(int)
        bits = place[:, :, None] >> np.arange(10) & 1
        order = np.argsort((bits << 2 * np.arange(10) + np.arange(2)[:, None]).sum(axis=(1, 2)), kind="stable")
        groups, ends = in_groups(walls_with_sides(walls[order]), _CLUSTER), ends[order]
        count, margin = len(groups) * _CLUSTER, RECEDING * float(domain.width.max())
        lo = padded(ends.min(axis=1), count, _NOWHERE).reshape(-1, _CLUSTER, 2).min(axis=1) - margin
        hi = padded(ends.max(axis=1), count, -_NOWHERE).reshape(-1, _CLUSTER, 2).max(axis=1) + margin
        return Walls(groups, in_32_bits(np.concatenate([(lo + hi) / 2, (hi - lo) / 2], axis=1)))

    distances = jnp.asarray(distances_table(stored, size))
    x, y = (along[listed] for along in seen.corners.T)
    return PairTables(
        partition=build_tables(domain, cells, np.zeros((len(cells), 1)), _NoLeaf(), num_bytes),
        walls=in_boxes(seen.walls),
        occluders=in_groups(occluders, _UNROLLED),
        near=near,
        x=in_32_bits(x),
        y=in_32_bits(y),
        listed=jnp.asarray(listed),
        distances=distances,
        onward=_ways_to_leaves(distances, listed, beside),
        corners=in_32_bits(padded(seen.corners, size, np.inf)),
        middle=in_32_bits(np.stack([middle, middle - middle.astype(np.float32)])),
        half=in_32_bits(stored.domain.width / 2),
        proud_walls=in_boxes(free.walls),
        proud_corners=in_32_bits(padded(free.corners[:-1], size, np.inf)),
        sure_walls=None if np.array_equal(sure, seen.walls) else in_boxes(sure),
        rounding=in_32_bits(stored.rounding + 2 * np.array([seen.moved, free.moved])),
        unresolved=unresolved_types(stored.domain),
    )


@jax.jit
def _ways_to_leaves(
    distances: Float[Array, "size size"], listed: UInt16[Array, "rows longest"], beside: Float[Array, "rows longest"]
) -> UInt32[Array, "rows size"]:
    """Return `PairTables.onward`, given each leaf's corners and their distances from its box (``beside``)."""
    rows, longest = listed.shape
    size = len(distances)
    last_bits = np.uint32(padded_size(size) - 1)

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
        other *= np.float32(1 - 4 * np.finfo(np.float32).eps)  # the last bits of `inf` are zeros
        return jax.lax.bitcast_convert_type(other, jnp.uint32) & ~last_bits | last

    step = np.gcd(rows, _LEAVES_AT_ONCE)
    parts = (each.reshape(-1, step, longest) for each in (listed.astype(jnp.uint32), beside))
    return jax.lax.map(of_leaves, tuple(parts)).reshape(rows, size)
