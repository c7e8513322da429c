"""Cells of a square around a map, and the edges of the boundary that can be the nearest to some point of each.

A square is quartered again and again, as long as more than a few edges are left. An edge cannot be the nearest
anywhere in a cell if it is farther from the cell than another one is from the cell's farthest corner.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from plr_jax._arrays import parts, run_members, runs
from plr_jax.geometry.vectors import distance_to_segment

_FEW = 4  # edges of a cell that is quartered no more
_ENTRIES_AN_EDGE, _LEAST_ENTRIES = 96, 2**16  # of the lists of all cells together, which bound the tables' memory
_AT_ONCE = 2**17  # pairs of a cell and an edge
_MARGIN = 2.0**-21  # of the square's side: how far beside its cell rounding may put a point

Segments = Float[np.ndarray, "edges 2 2"]


class NearEdges(NamedTuple):
    """Cells of any fineness that fill a square.

    Attributes:
        depth: How often the square was quartered for each cell.
        place: Where the cell is, in cells of its size: column and row.
        first: Where the list of each cell begins in ``edge``; one more for the end of the last one.
        edge: The edges of all lists.
    """

    depth: Int[np.ndarray, "cells"]
    place: Int[np.ndarray, "cells 2"]
    first: Int[np.ndarray, "cells+1"]
    edge: Int[np.ndarray, "entries"]


def near_edges(segments: Segments, corner: Float[np.ndarray, "2"], side: float, finest: int) -> NearEdges:
    """The cells of a square, given by its lower corner and its side, that is quartered so often at most."""
    place, first = np.zeros((1, 2), np.int64), np.array([0, len(segments)])
    edge = np.arange(len(segments))
    most, done, entries = max(_LEAST_ENTRIES, _ENTRIES_AN_EDGE * len(segments)), [], 0
    for depth in range(finest + 1):
        counts = np.diff(first)
        splits = counts > _FEW
        if depth == finest or entries + len(edge) > most:
            splits[:] = False
        kept = np.flatnonzero(~splits)
        done.append((np.full(len(kept), depth), place[kept], counts[kept], edge[run_members(first, kept)[0]]))
        entries += len(done[-1][3])
        if not splits.any():
            break
        owner = np.repeat(np.flatnonzero(splits), 4)
        place = 2 * place[owner] + np.tile([[0, 0], [1, 0], [0, 1], [1, 1]], (splits.sum(), 1))
        half = side * (0.5 ** (depth + 2) + _MARGIN)
        center = corner + side * (place + 0.5) * 0.5 ** (depth + 1)
        first, edge = _nearest_of_cells(segments, center, half, *run_members(first, owner), edge)
    depths, places, counts, edges = (np.concatenate(column) for column in zip(*done, strict=True))
    return NearEdges(depths, places, np.concatenate([[0], np.cumsum(counts)]), edges)


def _nearest_of_cells(
    segments: Segments,
    center: Float[np.ndarray, "cells 2"],
    half: float,
    member: Int[np.ndarray, "pairs"],
    cell: Int[np.ndarray, "pairs"],
    edge: Int[np.ndarray, "entries"],
) -> tuple[Int[np.ndarray, "cells+1"], Int[np.ndarray, "kept"]]:
    """Lists of the edges that can be the nearest in cells of one size, of those that are candidates of each."""
    first = np.searchsorted(cell, np.arange(len(center) + 1))
    counts, kept = [], []
    for part in parts(np.diff(first), _AT_ONCE):
        begin, pairs = first[part.start], slice(first[part.start], first[part.stop])
        candidates, of_cell = edge[member[pairs]], cell[pairs]
        least, most = _distances(segments[candidates] - center[of_cell, None], half)
        reach = np.minimum.reduceat(most, first[part] - begin)
        is_near = least <= reach[of_cell - part.start]
        kept.append(candidates[is_near])
        counts.append(np.bincount(of_cell[is_near] - part.start, minlength=part.stop - part.start))
    return np.concatenate([[0], np.cumsum(np.concatenate(counts))]), np.concatenate(kept)


def _distances(
    segments: Float[np.ndarray, "pairs 2 2"], half: float
) -> tuple[Float[np.ndarray, "pairs"], Float[np.ndarray, "pairs"]]:
    """Least and largest distance of points of a square about the origin to segments."""
    (ax, ay), (bx, by) = segments[:, 0].T, segments[:, 1].T
    dx, dy = bx - ax, by - ay
    corners = [distance_to_segment(ax - x, ay - y, dx, dy) for x in (-half, half) for y in (-half, half)]
    ends = [
        np.hypot(np.maximum(np.abs(x) - half, 0), np.maximum(np.abs(y) - half, 0)) for x, y in ((ax, ay), (bx, by))
    ]
    meets = np.abs(ax * dy - ay * dx) <= half * (np.abs(dx) + np.abs(dy))
    for a, b in ((ax, bx), (ay, by)):
        meets &= (np.minimum(a, b) <= half) & (np.maximum(a, b) >= -half)
    return np.where(meets, 0.0, np.min([*corners, *ends], axis=0)), np.max(corners, axis=0)


def slots_of_cells(cells: NearEdges, coarse: int) -> tuple[Int[np.ndarray, "blocks"], Int[np.ndarray, "slots"]]:
    """Two levels of tables that lead to the cell of a point: the blocks of a coarse grid, and the slots of each.

    Args:
        cells: The cells.
        coarse: How often the square is quartered to blocks.

    Returns:
        For each block, row by row, 16 times its first slot plus how often it is quartered to slots; and for each
        slot, row by row, its cell.
    """
    below, above = np.maximum(cells.depth - coarse, 0), np.maximum(coarse - cells.depth, 0)
    corner = (cells.place >> below[:, None]) << above[:, None]
    cell, part = runs(4**above)
    x, y = corner[cell, 0] + part % (1 << above[cell]), corner[cell, 1] + (part >> above[cell])
    block = (y << coarse) + x
    bits = np.zeros(4**coarse, np.int64)
    np.maximum.at(bits, block, below[cell])
    first = np.cumsum(4**bits) - 4**bits
    finer = bits[block] - below[cell]
    corner = (cells.place & ((1 << below) - 1)[:, None])[cell] << finer[:, None]
    pair, part = runs(4**finer)
    x, y = corner[pair, 0] + part % (1 << finer[pair]), corner[pair, 1] + (part >> finer[pair])
    slots = np.empty(int((4**bits).sum()), np.int64)
    slots[first[block[pair]] + (y << bits[block[pair]]) + x] = cell[pair]
    return 16 * first + bits, slots
