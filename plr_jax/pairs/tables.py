"""Tables that queries of a PairPLR in JAX read, built from its file.

Coordinates are relative to the middle of the domain.
"""

from dataclasses import field, replace

import jax
import numpy as np
from jaxtyping import Array, Float, UInt16, UInt32

from plr_jax._arrays import batches, padded, ragged_indices, size_in_eighths
from plr_jax._compiled import pytree
from plr_jax.geometry.box import Box
from plr_jax.pairs.occlusion import NearWalls
from plr_jax.pairs.portable import MARGIN, RECEDING, MovedObstacles
from plr_jax.pairs.stored import PairsFileData, distances_table
from plr_jax.plr.frame import unresolved_types
from plr_jax.plr.leaves.base import LeafModel
from plr_jax.plr.tables import Tables, build_tables

_CLUSTER = 32  # neighboring walls in a box, tested in one step of a loop
_PATHS_AT_ONCE = 2**16  # paths from corners to leaves that fit into caches
STEEPEST = 127  # slope of a bound that rises by 1 for each unit of length, in the numbers of `PairTables.onward`
NO_WAY = np.uint32(2**16 - 1)  # length of `PairTables.onward` for corners without a path to the leaf
_LEVEL = np.uint32(STEEPEST << 16 | STEEPEST << 24)  # both slopes of `PairTables.onward`, if they are 0
_SHRUNK = np.float32(1 - 8 * np.finfo(np.float32).eps)  # makes up for the rounding of bounds to leaves
_NOWHERE = 1e30  # a coordinate beyond every domain, for boxes of no walls


@pytree
class Walls:
    """Walls in groups of neighbors; each group has a bounding box."""

    groups: Float[Array, "groups 32 4"]  # coordinates of both ends of neighboring walls
    boxes: Float[Array, "groups 4"]  # of a box around each group with a margin for rounding: middle, half widths


@pytree
class PairTables:
    """The arrays that a query of a PairPLR reads."""

    partition: Tables
    walls: Walls  # moved into obstacles a little
    near: NearWalls | None  # walls that may hide a listed corner; None if they are too many to save time
    x: Float[Array, "leaves longest"]  # of the corners that each leaf lists, padded with `inf`
    y: Float[Array, "leaves longest"]
    listed: UInt16[Array, "leaves longest"]  # index of each of these corners; padding is the number of corners
    distances: Float[Array, "size size"]  # between corners
    # A lower bound of the length of paths from each corner, by the corners that a leaf lists, to points of the leaf.
    # It is linear in the point:
    #
    #     bits 24 to 31: slope along y    bits 16 to 23: slope along x    bits 0 to 15: value at `middles`
    #
    # The value is in units of `step`, rounded down. Slopes are stored times `STEEPEST`, plus `STEEPEST`.
    onward: UInt32[Array, "leaves size"]
    step: Float[Array, ""]
    middles: Float[Array, "leaves 2"]  # of the boxes of leaves
    middle: Float[Array, "2 2"]  # of the domain, rounded to 32 bits, and the rounding error
    half: Float[Array, "2"]  # half the width of the domain
    outset_walls: Walls  # moved into free space
    outset_corners: Float[Array, "size 2"]  # moved twice as far
    sure_walls: Walls | None  # without thin obstacles, and open where obstacles touch; None if equal to `walls`
    rounding: Float[Array, "2"]  # largest error of a distance through corners, and through `outset_corners`
    unresolved: tuple[str, ...] = field(metadata={"static": True})  # point types too coarse for the domain
    has_arcs: bool = field(default=False, metadata={"static": True})  # whether paths back may have other lengths
    is_certain: bool = field(default=False, metadata={"static": True})  # whether every path found is certainly free


def table_size(num_corners: int) -> int:
    """Return the number of rows of tables with a row for each corner; rows after ``num_corners`` are padding."""
    # One of few sizes, so that few functions are compiled, with room for a corner at `inf`.
    return size_in_eighths(num_corners + 1)


def build_pair_tables(stored: PairsFileData, num_bytes: int) -> PairTables:
    """Build the arrays that queries of a PairPLR read, from the content of its file.

    ``num_bytes`` is the size of the file without its label. The sizes of some arrays depend on it alone.
    """
    middle = (stored.domain.lo + stored.domain.hi) / 2
    domain = Box(stored.domain.lo - middle, stored.domain.hi - middle)
    width = float(stored.domain.width.max())
    cells, num_corners = stored.cells, stored.num_corners
    size, rows = table_size(num_corners), size_in_eighths(len(cells))  # of tables of corners and of leaves
    obstacles, upper_obstacles = (MovedObstacles.of(stored, is_certain) for is_certain in (False, True))
    lower_walls = MovedObstacles.of(stored, False, for_lower_bounds=True).walls
    # 1. Pad the lists to one length, a multiple of eight.
    lengths = np.diff(stored.lists.indptr)
    listed = np.full((rows, 8 * max(1, -(-int(lengths.max()) // 8))), num_corners, np.uint16)
    listed[ragged_indices(lengths)] = stored.lists.indices
    # 2. Find walls near listed corners.
    lo, hi = cells.grown_boxes(domain)
    leaf, corner = stored.lists.nonzero()
    near = NearWalls.of((lo, hi), leaf, corner, obstacles.corners[:-1], obstacles.walls, MARGIN * width, listed.shape)

    def in_32_bits(values: Float[np.ndarray, "*n"]) -> Float[Array, "*n"]:
        return jax.device_put(values.astype(np.float32))  # unlike `jnp.asarray`, compiles nothing

    def in_boxes(walls: Float[np.ndarray, "n 4"]) -> Walls:
        ends = walls.reshape(-1, 2, 2)
        # Sort the walls by the Morton code of their middles, so that groups are compact. Bit k of a middle's x and y,
        # in 1 / 2**10 of the width, becomes bit 2 k or 2 k + 1 of the code.
        place = ((ends.mean(axis=1) / domain.width + 0.5) * 2**10).astype(int)
        bits = place[:, :, None] >> np.arange(10) & 1
        order = np.argsort((bits << 2 * np.arange(10) + np.arange(2)[:, None]).sum(axis=(1, 2)), kind="stable")
        count, ends = _CLUSTER * size_in_eighths(-(-len(walls) // _CLUSTER)), ends[order]
        groups = padded(walls[order], count).reshape(-1, _CLUSTER, 4)
        # Boxes of groups without walls have their lower corner beyond their upper one: no segment meets them.
        margin = RECEDING * float(domain.width.max())
        lo = padded(ends.min(axis=1), count, _NOWHERE).reshape(-1, _CLUSTER, 2).min(axis=1) - margin
        hi = padded(ends.max(axis=1), count, -_NOWHERE).reshape(-1, _CLUSTER, 2).max(axis=1) + margin
        return Walls(in_32_bits(groups), in_32_bits(np.concatenate([(lo + hi) / 2, (hi - lo) / 2], axis=1)))

    # 3. Bound the lengths of paths from corners to leaves, in steps of which the longest path has less than 2**16.
    distances, has_arcs = distances_table(stored, size), len(stored.arcs.start) > 0
    to_corners = np.ascontiguousarray(distances.T) if has_arcs else distances  # by end, then start
    longest = distances.max(where=np.isfinite(distances), initial=0.0) + 2 * np.hypot(*domain.width)
    step = np.asarray(longest / (NO_WAY - 1), np.float32)
    middles = ((lo + hi) / 2).astype(np.float32)
    halves = np.maximum(hi - middles, middles - lo) / _SHRUNK
    middles, halves = (padded(column, rows).astype(np.float32) for column in (middles, halves))
    corners = padded(obstacles.corners, size, np.inf).astype(np.float32)
    x, y = (along[listed] for along in corners.T)
    return PairTables(
        partition=replace(build_tables(domain, cells, np.zeros((len(cells), 1)), LeafModel, num_bytes), leaf=None),
        walls=in_boxes(obstacles.walls),
        near=near,
        x=in_32_bits(x),
        y=in_32_bits(y),
        listed=jax.device_put(listed),
        distances=in_32_bits(distances),
        onward=jax.device_put(_bounds_to_leaves(to_corners, listed, corners, middles, halves, step)),
        step=in_32_bits(step),
        middles=in_32_bits(middles),
        middle=in_32_bits(np.stack([middle, middle - middle.astype(np.float32)])),
        half=in_32_bits(stored.domain.width / 2),
        outset_walls=in_boxes(upper_obstacles.walls),
        outset_corners=in_32_bits(padded(upper_obstacles.corners[:-1], size, np.inf)),
        sure_walls=None if np.array_equal(lower_walls, obstacles.walls) else in_boxes(lower_walls),
        rounding=in_32_bits(stored.rounding + 2 * np.array([obstacles.moved, upper_obstacles.moved])),
        unresolved=unresolved_types(stored.domain),
        has_arcs=has_arcs,
    )


def _bounds_to_leaves(
    distances: Float[np.ndarray, "size size"],
    listed: UInt16[np.ndarray, "rows longest"],
    corners: Float[np.ndarray, "size 2"],
    middles: Float[np.ndarray, "rows 2"],
    halves: Float[np.ndarray, "rows 2"],
    step: Float[np.ndarray, ""],
) -> UInt32[np.ndarray, "rows size"]:
    """Return a lower bound of path lengths from each corner to the points of each leaf: ``PairTables.onward``.

    Paths turn last at one of the corners that the leaf lists, and end at a point of the leaf. The bound is a linear
    function of this point, packed in 32 bits: its value at the leaf's center, as an integer in units of the length
    ``step``, and its rounded slopes. ``distances[k, a]`` is the path
    length from corner ``a`` to corner ``k``, and ``corners[k]`` is the position of corner ``k``. ``listed[i]`` has
    the indices of the corners that leaf ``i`` lists. The box of leaf ``i`` has the center ``middles[i]`` and the half
    widths ``halves[i]``.
    """
    # Fix a corner a and a leaf, whose box has the middle m and the half widths h. The path from a over the listed
    # corner k to a point x has the length d_k + |x - k|, with the distance d_k between a and k. It is convex in x, so
    # at least
    #
    #     p_k(x) = d_k + |m - k| + s_k . (x - m),     its tangent plane at m; s_k is the unit vector from k to m.
    #
    # Take the slopes s of the plane whose corner has the shortest path to m, rounded to multiples of 1 / STEEPEST. In
    # the box, a plane of slopes s is below all p_k if its value at m is at most
    #
    #     min over k of d_k + |m - k| - bend_k,       bend_k = sum over axes of |s_k - s| h.
    onward = np.full((len(listed), len(distances)), NO_WAY, np.uint32)
    counts = np.isfinite(corners[:, 0])[listed].sum(axis=1)  # listed corners of each leaf, without padding
    for count in np.unique(counts[counts > 0]).tolist():
        leaves = np.flatnonzero(counts == count)
        for batch in batches(leaves, max(1, _PATHS_AT_ONCE // (count * len(distances)))):
            # 1. Compute s_k and |m - k| for each leaf and k, and the rounded slopes.
            corner = listed[batch, :count]
            x, y = (middles[batch, None] - corners[corner]).transpose(2, 0, 1)
            length = np.sqrt(x * x + y * y)
            unit = [np.divide(along, length, out=np.zeros_like(along), where=length > 0) for along in (x, y)]
            slopes = [np.round(STEEPEST * along) for along in unit]
            # 2. Compute `bend[leaf, k, l]`: how far the plane of k must be lowered to have the slopes of l's plane.
            bend = np.zeros((*corner.shape, count), np.float32)
            for of_path, slope, half in zip(unit, slopes, halves[batch].T, strict=True):
                bend += np.abs(of_path[:, :, None] - slope[:, None] / STEEPEST) * half[:, None, None]
            slope_x, slope_y = ((along + STEEPEST).astype(np.uint32) for along in slopes)
            packed_slopes = slope_x << 16 | slope_y << 24
            # 3. Compute `paths[leaf, k, a]`, d_k + |m - k|. Lower it by the bend of the shortest path, in place.
            paths = distances.take(corner, axis=0)
            paths += length[:, :, None]
            shortest = paths.argmin(axis=1)
            paths *= _SHRUNK
            for path, lowered, slope, column, leaf in zip(paths, bend, packed_slopes, shortest, batch, strict=True):
                path -= lowered.take(column, axis=1)
                onward[leaf] = slope.take(column)
            # 4. Pack the values at m, rounded down. Bounds below 0 become level planes of value 0.
            least = paths.min(axis=1)
            is_reached = np.isfinite(least)
            steps = np.minimum(np.where(is_reached, least, 0) / step, NO_WAY - 1)
            is_positive = steps >= 0
            steps = np.where(is_positive, steps, 0).astype(np.uint32)
            onward[batch] = np.where(is_reached, np.where(is_positive, onward[batch], _LEVEL) | steps, NO_WAY)
    return onward
