"""Free space for compiled functions: what is free, and how far it is to a wall, read from tables."""

from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, Int, UInt32

from plr_jax._arrays import is_of_jax, padded, parts, run_members, runs, size_in_eighths
from plr_jax._types import ArrayLike
from plr_jax.geometry.boundary import Boundary
from plr_jax.geometry.box import Box
from plr_jax.geometry.vectors import distance_to_segment, turn_between

# Cells of a square around a map, and the edges of the boundary that can be the nearest to some point of each.
#
# A square is quartered again and again, as long as more than a few edges are left. An edge cannot be the nearest
# anywhere in a cell if it is farther from the cell than another one is from the cell's farthest corner.


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
        member, cell = run_members(first, owner)
        first, edge = _nearest_of_cells(segments, center, half, cell, edge[member])
    depths, places, counts, edges = (np.concatenate(column) for column in zip(*done, strict=True))
    return NearEdges(depths, places, np.concatenate([[0], np.cumsum(counts)]), edges)


def _nearest_of_cells(
    segments: Segments,
    center: Float[np.ndarray, "cells 2"],
    half: float,
    cell: Int[np.ndarray, "pairs"],
    edge: Int[np.ndarray, "pairs"],
) -> tuple[Int[np.ndarray, "cells+1"], Int[np.ndarray, "kept"]]:
    """Lists of the edges that can be the nearest in cells of one size, of those that are candidates of each."""
    first = np.searchsorted(cell, np.arange(len(center) + 1))
    counts, kept = [], []
    for part in parts(np.diff(first), _AT_ONCE):
        begin, pairs = first[part.start], slice(first[part.start], first[part.stop])
        candidates, of_cell = edge[pairs], cell[pairs]
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
    ends = np.hypot(*np.maximum(np.abs(segments) - half, 0).T)
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


_FEWEST_BITS, _MOST_BITS, _FINER = 4, 9, 3  # of blocks along an axis; of slots in a block
_TOLERANCE = 1e-6  # of the longer side of the bounds
_AT_END = 2.0**-20  # of the way to the end of an edge: how near it the foot may be because of rounding
_IN_LINE = np.pi / 50  # between two edges, about
_HALF = 5 / 8  # of it, half the side of the square


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class FreeSpace:
    """Free space as tables, for functions that JAX compiles; made by ``workspace.tables``.

    A pytree of arrays: a jitted function can close over it or take it as an argument. A cell of a square around the
    bounds lists the edges that can be the nearest to some point of it.

    Attributes:
        origin: The middle of the bounds, in 32 bits, and what they leave of it; all coordinates count from there.
        half: Half the side of the square.
        tolerance: How far in an obstacle a point still counts as free.
        lo: The lower corner of the bounds, rounded outward, and by how much; see ``Frame`` of queries.
        hi: The upper one.
        blocks: For each block of a coarse grid, row by row, its first slot and how finely it is divided into slots.
        slots: The cell of each slot.
        first: Where the list of each cell begins.
        edge: The edges of all lists.
        edges: First and last point of each edge, of which free space is on the left, and where points are to which
            either is the nearest of all edges: 1 in free space, -1 in a wall, 0 if the edges have to say.
        bits: How often the square is halved to blocks, along each axis.
    """

    origin: Float[Array, "2 2"]
    half: Float[Array, ""]
    tolerance: Float[Array, ""]
    lo: Float[Array, "2 2"]
    hi: Float[Array, "2 2"]
    blocks: UInt32[Array, "blocks"]
    slots: UInt32[Array, "slots"]
    first: UInt32[Array, "cells"]
    edge: UInt32[Array, "entries"]
    edges: Float[Array, "edges 6"]
    bits: int = field(metadata={"static": True})

    def is_free(self, x: ArrayLike) -> Bool[Array, "*batch"]:
        """Whether points lie in closed free space.

        Args:
            x: Points, ``(..., 2)``, as for :meth:`clearance`.

        Returns:
            True where free, walls included, and within ``tolerance``, 1e-6 of the longer side of the bounds, of free
            space; False for points twice as far in an obstacle. In between it may be either. But see
            :meth:`clearance` for what is thinner than that. False for all outside the bounds, to the last bit (as 32
            bits round them outward, of points of no more bits), and for points that are not finite: what is free,
            queries take to be inside.

        Raises:
            ValueError: If ``x`` has another last axis.
        """
        module = np if not is_of_jax(x) and not isinstance(self.lo, Tracer) else jnp
        x = module.asarray(x)
        if x.ndim == 0 or x.shape[-1] != 2 or x.dtype == np.float64:
            clearance = self.clearance(x)
            (lo, above), (hi, below) = self._corners(module, x)
        else:
            x = x.astype(np.float32)
            (lo, above), (hi, below) = self._corners(module, x)
            # 32 bits cannot tell the true corners from the rounded ones: what is on these is taken into the bounds.
            inner = (
                module.where(above > 0, module.nextafter(lo, hi), lo),
                module.where(below > 0, module.nextafter(hi, lo), hi),
            )
            clearance = self.clearance(module.clip(x, *inner))
            above = below = module.zeros_like(x)
        # By the arithmetic of a query of PLRs, so that none answers ``inf`` where it is free.
        return (clearance >= -self.tolerance) & jnp.asarray(((x - lo >= above) & (hi - x >= below)).all(axis=-1))

    def _corners(self, module: Any, x: Array | np.ndarray) -> Any:
        """The corners of the bounds and their rests, like points."""
        corners = (module.asarray(corner).astype(x.dtype) for corner in (self.lo, self.hi))
        return ((module.broadcast_to(part, x.shape) for part in corner) for corner in corners)

    def clearance(self, x: ArrayLike) -> Float[Array, "*batch"]:
        """Signed distance to the nearest obstacle or bound.

        Its gradient is a unit vector: away from the nearest point of a wall in free space, and toward it elsewhere.

        Args:
            x: Points, ``(..., 2)``. NumPy's are placed in 64 bits. Of JAX's 32-bit ones, and of all under
                ``jax.jit``, the clearance is that of where rounding has put them, far from the origin, as in UTM,
                decimeters away: enable ``jax_enable_x64`` there.

        Returns:
            Distance to the boundary of free space, to 1e-6 of the longer side of the bounds: positive in free space,
            negative in an obstacle or outside the bounds; NaN for points that are not finite. Farther outside the
            bounds than an eighth of their longer side it is minus the way by a point nearer by, which is a little
            longer than the distance. Its sign may be wrong where what is nearest is a wall or a gap thinner than
            1e-6 of that side, as the tip of a needle is, whose sides 32 bits do not tell apart.

        Raises:
            ValueError: If ``x`` has another last axis.
        """
        on_host = not is_of_jax(x) and not isinstance(self.origin, Tracer)
        x = np.asarray(x, np.float64) if on_host else jnp.asarray(x)
        if x.ndim == 0 or x.shape[-1] != 2:
            raise ValueError(f"x must be points of shape (..., 2), got {x.shape}.")
        if on_host:
            return _clearance(self, x - np.asarray(self.origin, np.float64).sum(axis=0))
        x = x.astype(x.dtype if x.dtype == jnp.float64 else jnp.float32)
        first, rest = (jnp.broadcast_to(part, x.shape) for part in self.origin.astype(x.dtype))
        return _clearance(self, (x - first) - rest)


@jax.jit
def _clearance(space: FreeSpace, x: Float[Array, "*batch 2"]) -> Float[Array, "*batch"]:
    is_finite = jnp.isfinite(x).all(axis=-1)
    x = jnp.where(is_finite[..., None], x, 0)
    half = space.half.astype(x.dtype)
    inside = jnp.clip(x, -half, half)
    edge = space.edges[_nearest_edge(space, jax.lax.stop_gradient(inside))].astype(x.dtype)
    way = _norm(x[..., 0] - inside[..., 0], x[..., 1] - inside[..., 1])
    return jnp.where(is_finite, _signed_distance(inside, edge) - way, jnp.nan)


def _nearest_edge(space: FreeSpace, x: Float[Array, "*batch 2"]) -> UInt32[Array, "*batch"]:
    """The edge nearest to each point. Of those that end in the nearest point, the one most across the way there.

    Only that one tells on which side of the boundary the point is.
    """
    cell = _cell(space, x)
    begin, last = space.first[cell], space.first[cell + 1] - 1

    def look(number, best):
        _, best_square, best_across = best
        edge = space.edge[jnp.minimum(begin + number.astype(jnp.uint32), last)]
        (wx, wy), left, _, _ = _to_edge(x, space.edges[edge].astype(x.dtype))
        square, across = wx * wx + wy * wy, jnp.abs(left)
        is_better = (square < best_square) | ((square == best_square) & (across > best_across))
        new = edge, square, across
        return tuple(jnp.where(is_better, a, b) for a, b in zip(new, best, strict=True))

    nowhere = jnp.full(x.shape[:-1], jnp.inf, x.dtype)
    none = jnp.zeros(x.shape[:-1], jnp.uint32), nowhere, -nowhere
    longest = (last - begin + 1).max(initial=1).astype(jnp.int32)
    return jax.lax.fori_loop(0, longest, look, none)[0]


def _cell(space: FreeSpace, x: Float[Array, "*batch 2"]) -> UInt32[Array, "*batch"]:
    """The cell of each point of the square."""
    finest = space.bits + _FINER
    share = (x + space.half.astype(x.dtype)) / (2 * space.half.astype(x.dtype))
    column, row = jnp.moveaxis(jnp.clip(share * 2**finest, 0, 2**finest - 1).astype(jnp.uint32), -1, 0)
    block = space.blocks[(row >> _FINER << space.bits) + (column >> _FINER)]
    bits = block & 15
    mask = (jnp.uint32(1) << bits) - 1
    row, column = (along >> (_FINER - bits) & mask for along in (row, column))
    return space.slots[(block >> 4) + (row << bits) + column]


def _to_edge(
    x: Float[Array, "*batch 2"], edge: Float[Array, "*batch 6"]
) -> tuple[tuple[Array, Array], Float[Array, "*batch"], Float[Array, "*batch"], Bool[Array, "*batch"]]:
    """Of points beside edges.

    Returns:
        The way from the nearest point of the edge; how far left of its line the point is; where points are to which
        the end is nearest that is the nearest point, or all but is, else 0; whether the nearest point is neither end.
    """
    ax, ay, bx, by, around_a, around_b = jnp.moveaxis(edge, -1, 0)
    dx, dy, ux, uy = bx - ax, by - ay, x[..., 0] - ax, x[..., 1] - ay
    vx, vy = x[..., 0] - bx, x[..., 1] - by
    square = dx * dx + dy * dy
    square = jnp.where(square == 0, 1, square)
    # Counted from the nearer end: beside a tip, what is rounded far away would be more than the tip is thick.
    after, before = (ux * dx + uy * dy) / square, -(vx * dx + vy * dy) / square
    is_first = after < before
    t, ux, uy = (jnp.where(is_first, a, b) for a, b in ((after, before), (ux, vx), (uy, vy)))
    across = dx * uy - dy * ux
    is_between = t > 0
    way = jnp.where(is_between, -dy * across / square, ux), jnp.where(is_between, dx * across / square, uy)
    is_at_end = ~is_between | (t * t * square < _AT_END**2 * (ux * ux + uy * uy))
    around = jnp.where(is_at_end, jnp.where(is_first, around_a, around_b), 0)
    return way, across / jnp.sqrt(square), around, is_between


def _signed_distance(x: Float[Array, "*batch 2"], edge: Float[Array, "*batch 6"]) -> Float[Array, "*batch"]:
    """Distance to edges, positive in free space.

    Free space is on the left. But beyond the tip of a wedge, its edges may be too near one another to say which of
    them is beside the point.
    """
    way, left, around, is_between = _to_edge(x, edge)
    side = jnp.where(around == 0, jnp.where(left >= 0, 1, -1), around)
    return jnp.where(is_between, jnp.where(side * left < 0, -left, left), side * _norm(*way))


def _norm(x: Float[Array, "*batch"], y: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
    """Length, of slope 0 at 0."""
    square = x * x + y * y
    return jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1)), 0)


@jax.ensure_compile_time_eval()  # they are kept, so that they must not be parts of a function that is being traced
def free_space_of(boundary: Boundary, bounds: Box) -> FreeSpace:
    """The tables of free space with that boundary, in bounds."""
    middle, width = (bounds.lo + bounds.hi) / 2, float(bounds.width.max())
    segments = boundary.segments - middle
    bits = int(np.clip(np.ceil(np.log2(4 * len(segments)) / 2), _FEWEST_BITS, _MOST_BITS))
    cells = near_edges(segments, np.full(2, -_HALF * width), 2 * _HALF * width, bits + _FINER)
    blocks, slots = slots_of_cells(cells, bits)
    edges = np.concatenate([segments.reshape(-1, 4), _around_vertices(boundary)[boundary.edges]], axis=1)
    single = partial(jnp.asarray, dtype=jnp.float32)
    return FreeSpace(
        origin=single(np.stack([middle, middle - middle.astype(np.float32)])),
        half=single(_HALF * width),
        tolerance=single(_TOLERANCE * width),
        lo=single(np.stack([bounds.in_single[0], bounds.single_rests[0]])),
        hi=single(np.stack([bounds.in_single[1], bounds.single_rests[1]])),
        blocks=_indices(blocks),
        slots=_indices(slots),
        first=_indices(cells.first),
        edge=_indices(cells.edge),
        edges=single(padded(edges, size_in_eighths(len(edges)))),
        bits=bits,
    )


def _around_vertices(boundary: Boundary) -> Float[np.ndarray, "vertices"]:
    """What points are in to which a vertex is the nearest of all edges: 1 if free space, -1 if a wall.

    0 where the edges beside it say so themselves, as they lie in a line, or where it cannot be said: where free space
    touches itself, unless all but less than a right angle is free, or is not.
    """
    at, leaving = boundary.edges.T
    there, to, back = (boundary.vertices[which] for which in (at, leaving, boundary.sector_end))
    free = np.bincount(at, turn_between(to - there, back - there), len(boundary.vertices))
    touches = np.bincount(at, minlength=len(boundary.vertices)) > 1
    unsaid = np.where(touches, np.pi / 2, _IN_LINE)
    return np.where(free > np.pi + unsaid, 1.0, np.where(free < np.pi - unsaid, -1.0, 0.0))


def _indices(values: np.ndarray) -> UInt32[Array, "padded"]:
    return jnp.asarray(padded(values.astype(np.uint32), size_in_eighths(len(values))))
