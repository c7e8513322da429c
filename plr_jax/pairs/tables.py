"""Tables of a PairPLR's file that queries in JAX read. Coordinates are relative to the middle of the domain."""

from dataclasses import field, replace

import jax
import numpy as np
from jaxtyping import Array, Float, UInt16, UInt32

from plr_jax._arrays import padded, ragged_indices, size_in_eighths
from plr_jax._compiled import pytree
from plr_jax.geometry.box import Box
from plr_jax.pairs.occlusion import NearWalls, occluders_of
from plr_jax.pairs.portable import MARGIN, RECEDING, Scene
from plr_jax.pairs.stored import PairsFileData, distances_table
from plr_jax.plr.frame import unresolved_types
from plr_jax.plr.leaves.base import LeafModel
from plr_jax.plr.tables import Tables, build_tables

_UNROLLED, _CLUSTER = 16, 32  # occluders, and neighboring walls in a box, tested in one step of a loop
_PATHS_AT_ONCE = 2**16  # paths from corners to leaves that fit into caches
STEEPEST = 127  # slope of a bound that rises by 1 for each unit of length, in the numbers of `PairTables.onward`
NO_WAY = np.uint32(2**16 - 1)  # length of `PairTables.onward` for corners without a path to the leaf
_LEVEL = np.uint32(STEEPEST << 16 | STEEPEST << 24)  # both slopes of `PairTables.onward`, if they are 0
_SHRUNK = np.float32(1 - 8 * np.finfo(np.float32).eps)  # makes up for the rounding of bounds to leaves
_NOWHERE = 1e30  # a coordinate beyond every domain, for boxes of no walls


@pytree
class Walls:
    """Walls in groups of neighbors, each with a bounding box."""

    groups: Float[Array, "groups 32 4"]  # coordinates of both ends of neighboring walls
    boxes: Float[Array, "groups 4"]  # of a box around each group with a margin for rounding: middle, half widths


@pytree
class PairTables:
    """The arrays that a query of a PairPLR reads."""

    partition: Tables
    walls: Walls  # moved into obstacles a little
    occluders: Float[Array, "groups_of_occluders 16 7"]  # segments inside obstacles (`occluders_of`)
    near: NearWalls | None  # walls that may hide a listed corner; None if they are too many to save time
    x: Float[Array, "leaves longest"]  # of the corners that each leaf lists, padded with `inf`
    y: Float[Array, "leaves longest"]
    listed: UInt16[Array, "leaves longest"]  # index of each of these corners; padding is the number of corners
    distances: Float[Array, "size size"]  # between corners
    # A lower bound of the length of paths from each corner, by the corners that a leaf lists, to points of the leaf.
    # It is linear in the point. The last 16 bits are its value at the middle of the leaf's box, in units of `step`,
    # rounded down. Two times 8 bits are its slopes along both axes, times `STEEPEST`, plus `STEEPEST`.
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
    is_certain: bool = field(default=False, metadata={"static": True})  # whether every path found is certainly free


def table_size(num_corners: int) -> int:
    # One of few sizes, so that few functions are compiled, with room for a corner at `inf`.
    return size_in_eighths(num_corners + 1)


def build_pair_tables(stored: PairsFileData, num_bytes: int) -> PairTables:
    # The sizes of some tables depend only on `num_bytes`, the size of the file.
    middle = (stored.domain.lo + stored.domain.hi) / 2
    domain = Box(stored.domain.lo - middle, stored.domain.hi - middle)
    cells, count = stored.cells, len(stored.corner)
    size, rows = table_size(count), size_in_eighths(len(cells))
    scene, upper_scene = (Scene.of(stored, is_certain) for is_certain in (False, True))
    lower_walls = Scene.of(stored, False, for_lower_bounds=True).walls
    # 1. Pad the lists to one length, a multiple of eight.
    lengths = np.bincount(stored.leaf, minlength=rows)
    listed = np.full((rows, 8 * max(1, -(-int(lengths.max()) // 8))), count, np.uint16)
    listed[ragged_indices(lengths)] = stored.listed
    # 2. Choose occluders deeper inside obstacles than walls move back, and find walls near listed corners.
    try:
        depth = 4 * RECEDING * float(stored.domain.width.max())
        occluders = occluders_of(stored.outline.region, stored.domain, depth, len(stored.outline.points))
    except ValueError:  # the file has details finer than its lattice: only walls block sight
        occluders = np.zeros((0, 7))
    margin, (lo, hi) = MARGIN * float(stored.domain.width.max()), cells.grown_boxes(domain)
    near = NearWalls.of((lo, hi), stored.leaf, stored.listed, scene.corners[:-1], scene.walls, margin, listed.shape)

    def in_32_bits(values: Float[np.ndarray, "*n"]) -> Float[Array, "*n"]:
        return jax.device_put(values.astype(np.float32))  # unlike `jnp.asarray`, compiles nothing

    def in_groups(rows: Float[np.ndarray, "n columns"], chunk: int) -> Float[Array, "groups {chunk} columns"]:
        groups = size_in_eighths(-(-len(rows) // chunk))
        return in_32_bits(padded(rows, chunk * groups).reshape(-1, chunk, rows.shape[1]))

    def in_boxes(walls: Float[np.ndarray, "n 4"]) -> Walls:
        ends = walls.reshape(-1, 2, 2)
        # Sort the walls by the Morton code of their middles, so that groups are compact.
        place = ((ends.mean(axis=1) / domain.width + 0.5) * 2**10).astype(int)
        bits = place[:, :, None] >> np.arange(10) & 1
        order = np.argsort((bits << 2 * np.arange(10) + np.arange(2)[:, None]).sum(axis=(1, 2)), kind="stable")
        groups, ends = in_groups(walls[order], _CLUSTER), ends[order]
        count, margin = len(groups) * _CLUSTER, RECEDING * float(domain.width.max())
        lo = padded(ends.min(axis=1), count, _NOWHERE).reshape(-1, _CLUSTER, 2).min(axis=1) - margin
        hi = padded(ends.max(axis=1), count, -_NOWHERE).reshape(-1, _CLUSTER, 2).max(axis=1) + margin
        return Walls(groups, in_32_bits(np.concatenate([(lo + hi) / 2, (hi - lo) / 2], axis=1)))

    # 3. Bound the lengths of paths from corners to leaves, in steps of which the longest path has less than 2**16.
    distances = distances_table(stored, size)
    longest = distances.max(where=np.isfinite(distances), initial=0.0) + 2 * np.hypot(*domain.width)
    step = np.asarray(longest / (NO_WAY - 1), np.float32)
    middles = ((lo + hi) / 2).astype(np.float32)
    halves = np.maximum(hi - middles, middles - lo) / _SHRUNK
    middles, halves = (padded(each, rows).astype(np.float32) for each in (middles, halves))
    corners = padded(scene.corners, size, np.inf).astype(np.float32)
    x, y = (along[listed] for along in corners.T)
    return PairTables(
        partition=replace(build_tables(domain, cells, np.zeros((len(cells), 1)), LeafModel, num_bytes), leaf=None),
        walls=in_boxes(scene.walls),
        occluders=in_groups(occluders, _UNROLLED),
        near=near,
        x=in_32_bits(x),
        y=in_32_bits(y),
        listed=jax.device_put(listed),
        distances=in_32_bits(distances),
        onward=jax.device_put(_bounds_to_leaves(distances, listed, corners, middles, halves, step)),
        step=in_32_bits(step),
        middles=in_32_bits(middles),
        middle=in_32_bits(np.stack([middle, middle - middle.astype(np.float32)])),
        half=in_32_bits(stored.domain.width / 2),
        outset_walls=in_boxes(upper_scene.walls),
        outset_corners=in_32_bits(padded(upper_scene.corners[:-1], size, np.inf)),
        sure_walls=None if np.array_equal(lower_walls, scene.walls) else in_boxes(lower_walls),
        rounding=in_32_bits(stored.rounding + 2 * np.array([scene.moved, upper_scene.moved])),
        unresolved=unresolved_types(stored.domain),
    )


def _bounds_to_leaves(
    distances: Float[np.ndarray, "size size"],
    listed: UInt16[np.ndarray, "rows longest"],
    corners: Float[np.ndarray, "size 2"],
    middles: Float[np.ndarray, "rows 2"],
    halves: Float[np.ndarray, "rows 2"],
    step: Float[np.ndarray, ""],
) -> UInt32[np.ndarray, "rows size"]:
    # A distance from a corner is convex, so above its tangent plane at the middle of a leaf's box. Take the plane of
    # the corner with the shortest path to the middle, lowered below the planes of all listed corners in the box:
    # d_k + |m - k| + s_k . (x - m) is the plane of the path over listed corner k, d_k from the corner, with the unit
    # vector s_k from k to the middle m. In a box of half widths h, a plane of slopes s is below it if its value at m
    # is at most d_k + |m - k| - sum(|s_k - s| * h).
    onward = np.full((len(listed), len(distances)), NO_WAY, np.uint32)
    counts = np.isfinite(corners[:, 0])[listed].sum(axis=1)
    for count in np.unique(counts[counts > 0]):
        leaves = np.flatnonzero(counts == count)
        at_once = max(1, _PATHS_AT_ONCE // (count * len(distances)))
        for some in (leaves[first : first + at_once] for first in range(0, len(leaves), at_once)):
            corner = listed[some, :count]
            x, y = (middles[some, None] - corners[corner]).transpose(2, 0, 1)
            length = np.sqrt(x * x + y * y)
            along = [np.divide(each, length, out=np.zeros_like(each), where=length > 0) for each in (x, y)]
            slopes = [np.round(STEEPEST * each) for each in along]
            # How far the plane of each path must be lowered to be below another path in the box.
            bend = np.zeros((*corner.shape, count), np.float32)
            for of_path, slope, half in zip(along, slopes, halves[some].T, strict=True):
                bend += np.abs(of_path[:, :, None] - slope[:, None] / STEEPEST) * half[:, None, None]
            slope_x, slope_y = ((each + STEEPEST).astype(np.uint32) for each in slopes)
            slopes = slope_x << 16 | slope_y << 24
            paths = distances.take(corner, axis=0)
            paths += length[:, :, None]
            shortest = paths.argmin(axis=1)
            paths *= _SHRUNK
            for path, lowered, slope, column, place in zip(paths, bend, slopes, shortest, some, strict=True):
                path -= lowered.take(column, axis=1)
                onward[place] = slope.take(column)
            least = paths.min(axis=1)
            reached = np.isfinite(least)
            steps = np.minimum(np.where(reached, least, 0) / step, NO_WAY - 1)
            slopes = onward[some]
            is_positive = steps >= 0
            steps = np.where(is_positive, steps, 0).astype(np.uint32)
            onward[some] = np.where(reached, np.where(is_positive, slopes, _LEVEL) | steps, NO_WAY)
    return onward
