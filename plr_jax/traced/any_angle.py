"""Lengths of shortest paths among the blocked cells of a traced grid, which bend at convex corners of these."""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int32

from plr_jax.traced.bits import Mask, Shape, packed
from plr_jax.traced.sight import (
    Broadcast,
    Ends,
    cell_centers,
    crossed_cells,
    crosses_nothing,
    flat_words,
    inside_free_cells,
    lattice,
    margin,
    sees_between,
    towards,
)

Lengths = Float[Array, "*batch corners"]

MOST_CORNERS = 2**12
"""Corners whose lengths take 64 megabytes."""
_ALL_KEPT = 2**8


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Corners:
    """Corners of cells at which paths can bend, since one of the four cells there is blocked.

    Attributes:
        free: The grid.
        index: Which corner inside the grid each place holds, row by row.
        is_convex: Which places hold one at which paths can bend.
        is_complete: Whether there are places for all.
    """

    free: Bool[Array, "*maps h w"]
    index: Int32[Array, "*maps corners"]
    is_convex: Bool[Array, "*maps corners"]
    is_complete: Bool[Array, "*maps"]

    @property
    def _is_lattice(self) -> bool:
        """Whether every corner inside the grid has its place: what segments between them cross is then in a table."""
        return len(self.index) == _num_inside(self.free.shape) <= _ALL_KEPT

    def points(self, dtype: jnp.dtype) -> Float[Array, "corners 2"]:
        """Where they are."""
        corners = jnp.asarray(lattice(self.free.shape), dtype)
        return corners if self._is_lattice else corners[self.index]

    def _pulled(self, dtype: jnp.dtype) -> Float[Array, "corners 2"]:
        """Points near them, inside the cells that are opposite of the blocked ones."""
        blocked = (~self.free).astype(dtype)
        lower_left, lower_right = blocked[:-1, :-1], blocked[:-1, 1:]
        upper_left, upper_right = blocked[1:, :-1], blocked[1:, 1:]
        away = [
            lower_left + upper_left - lower_right - upper_right,
            lower_left + lower_right - upper_left - upper_right,
        ]
        # Where there is no convex corner that may be nowhere: any point inside a cell will do.
        away = jnp.where(jnp.stack(away, axis=-1) < 0, -1, 1).reshape(-1, 2)[self.index]
        return self.points(dtype) + margin(self.free.shape, dtype) * away.astype(dtype)

    def see_each_other(self, a: Ends, b: Ends) -> Bool[Array, "n"]:
        """Whether points, moved inside free cells, see each other."""
        return crosses_nothing(
            packed(~self.free), self.free.shape, towards(a, b.mean(axis=-2)), towards(b, a.mean(axis=-2))
        )

    def seen_from(self, ends: Ends) -> Bool[Array, "n corners"]:
        """Which places are seen from points, moved inside free cells, if they hold a convex corner."""
        corners = self._pulled(ends.dtype)[None]
        return crosses_nothing(packed(~self.free), self.free.shape, towards(ends[:, None], corners), corners)

    def seen_from_centers(self, dtype: jnp.dtype) -> Bool[Array, "cells corners"]:
        """Which places are seen from the centers of cells, row by row, if they hold a convex corner."""
        if self._is_lattice:
            table = crossed_cells(self.free.shape, from_centers=True)
            return sees_between(table, flat_words(~self.free))
        return self.seen_from(inside_free_cells(self.free, jnp.asarray(cell_centers(self.free.shape), dtype))[0])

    def lengths(self, dtype: jnp.dtype) -> Float[Array, "corners corners"]:
        """Between those that see each other the length of the segment, else ``inf``."""
        if self._is_lattice:
            left, blocked = crossed_cells(self.free.shape, from_centers=False), flat_words(~self.free)
            seen = sees_between(left, blocked) | sees_between(left.swapaxes(1, 2), blocked)
        else:
            pulled = self._pulled(dtype)
            seen = crosses_nothing(packed(~self.free), self.free.shape, pulled[:, None], pulled[None])
        seen &= self.is_convex[None] & self.is_convex[:, None] & ~jnp.eye(len(self.index), dtype=bool)
        points = self.points(dtype)
        return jnp.where(seen, distance(points[:, None], points[None]), jnp.inf)


def _num_inside(shape: Shape) -> int:
    return (shape[0] - 1) * (shape[1] - 1)


def places(shape: Shape) -> int:
    """How many corners are kept by default: all of a small grid, half of those of a large one."""
    inside = _num_inside(shape)
    return inside if inside <= _ALL_KEPT else -(-inside // 2)


def convex_corners(free: Mask, count: int) -> Corners:
    """Those of a grid, in so many places."""
    around = jnp.stack([free[:-1, :-1], free[:-1, 1:], free[1:, :-1], free[1:, 1:]]).reshape(4, -1)
    is_convex = jnp.sum(~around, axis=0) == 1
    if count >= is_convex.size:
        return Corners(free, jnp.arange(is_convex.size, dtype=jnp.int32), is_convex, jnp.array(True))
    index = jnp.nonzero(is_convex, size=count, fill_value=0)[0].astype(jnp.int32)
    found = is_convex.sum()
    return Corners(free, index, jnp.arange(count) < found, found <= count)


def distance(a: Broadcast, b: Broadcast) -> Float[Array, "..."]:
    """Length of segments; its gradient is 0 where they are points."""
    squares = jnp.sum((a - b) ** 2, axis=-1)
    return jnp.where(squares > 0, jnp.sqrt(jnp.where(squares > 0, squares, 1)), 0)


# Shortest paths between corners: relaxation of all at once, in as many rounds as paths have bends. What the distance
# of a corner depends on is the corner at which its path begins, so the gradient follows that one alone.


@jax.custom_jvp
def from_seen(lengths: Float[Array, "corners corners"], seen: Lengths) -> Lengths:
    """Distances of corners to a goal, from those of the corners that it sees, ``inf`` for others."""

    def relaxed(state):
        old, _ = state
        new = jnp.minimum(old, jnp.min(lengths + old[None], axis=-1))
        return new, jnp.any(new < old)

    return lax.while_loop(lambda state: state[1], relaxed, (seen, jnp.array(True)))[0]


@from_seen.defjvp
def _(primals, tangents):
    lengths, seen = primals
    through = from_seen(lengths, seen)
    corners = jnp.arange(len(seen))
    onward = jnp.where(seen <= through, corners, jnp.argmin(lengths + through[None], axis=1))
    for _ in range(len(seen).bit_length()):
        onward = onward[onward]
    return through, jnp.where(jnp.isfinite(through), tangents[1][onward], 0)


def between_all(lengths: Float[Array, "corners corners"]) -> Float[Array, "corners corners"]:
    """Distances between all corners (Floyd and Warshall)."""
    own = jnp.where(jnp.eye(len(lengths), dtype=bool), 0, lengths)
    return lax.fori_loop(0, len(own), lambda k, d: jnp.minimum(d, d[:, k, None] + d[None, k]), own)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class CornerPaths:
    """Distances to a goal, by way of corners.

    Attributes:
        corners: Those of the grid.
        distances: Their own distances.
        goal: The goal.
    """

    corners: Corners
    distances: Float[Array, "*maps corners"]
    goal: Float[Array, "*maps 2"]

    @classmethod
    def to(cls, corners: Corners, goal: Float[Array, "2"]) -> "CornerPaths":
        """Those to a goal."""
        lengths = corners.lengths(goal.dtype)
        (ends,), (is_free,) = inside_free_cells(corners.free, goal[None])
        seen = corners.seen_from(ends[None])[0] & is_free & corners.is_convex
        from_goal = _length(seen, goal[None], corners.points(goal.dtype))
        return cls(corners, from_seen(lengths, from_goal), goal)

    @property
    def is_complete(self) -> Bool[Array, ""]:
        """Whether there are places for all corners."""
        return self.corners.is_complete

    def cells(self) -> Float[Array, "h w"]:
        """Those of the centers of cells."""
        x = jnp.asarray(cell_centers(self.corners.free.shape), self.goal.dtype)
        return self._distance(x, self.corners.seen_from_centers(x.dtype)).reshape(self.corners.free.shape)

    def distance(self, x: Float[Array, "n 2"]) -> Float[Array, "n"]:
        """Those of points."""
        x = x.astype(jnp.promote_types(x.dtype, self.goal.dtype))
        return self._distance(x, self.corners.seen_from(inside_free_cells(self.corners.free, x)[0]))

    def _distance(self, x: Float[Array, "n 2"], seen: Bool[Array, "n corners"]) -> Float[Array, "n"]:
        goal = jnp.broadcast_to(self.goal.astype(x.dtype), x.shape)
        (ends, is_free), (goal_ends, goal_is_free) = (inside_free_cells(self.corners.free, p) for p in (x, goal))
        sees_goal = self.corners.see_each_other(ends, goal_ends) & goal_is_free
        through = jnp.isfinite(self.distances)[None] & seen
        by_corners = _length(through, x[:, None], self.corners.points(x.dtype)[None], self.distances[None])
        value = jnp.minimum(_length(sees_goal, x, goal), jnp.min(by_corners, axis=-1))
        return jnp.where(is_free, value, jnp.inf)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class CornerPairs:
    """Distances between any two points, by way of corners.

    Attributes:
        corners: Those of the grid.
        between: Distances between corners.
    """

    corners: Corners
    between: Float[Array, "*maps corners corners"]

    @classmethod
    def of(cls, corners: Corners) -> "CornerPairs":
        """Those of a grid."""
        return cls(corners, between_all(corners.lengths(jnp.zeros(()).dtype)))

    @property
    def is_complete(self) -> Bool[Array, ""]:
        """Whether there are places for all corners."""
        return self.corners.is_complete

    def distance(self, x: Float[Array, "n 2"], y: Float[Array, "n 2"]) -> Float[Array, "n"]:
        """Those of pairs of points."""
        dtype = jnp.promote_types(jnp.promote_types(x.dtype, y.dtype), self.between.dtype)
        x, y, points = x.astype(dtype), y.astype(dtype), self.corners.points(dtype)[None]
        (x_ends, x_is_free), (y_ends, y_is_free) = (inside_free_cells(self.corners.free, each) for each in (x, y))
        from_x = _length(self.corners.seen_from(x_ends), x[:, None], points)
        from_y = _length(self.corners.seen_from(y_ends), y[:, None], points)
        onward = jnp.min(self.between[None] + from_y[:, None], axis=-1)
        by_corners = jnp.min(from_x + onward, axis=-1)
        value = jnp.minimum(_length(self.corners.see_each_other(x_ends, y_ends), x, y), by_corners)
        return jnp.where(x_is_free & y_is_free & jnp.isfinite(value), value, jnp.inf)


def _length(seen: Bool[Array, "*batch"], a: Broadcast, b: Broadcast, onward: Any = 0) -> Float[Array, "*batch"]:
    """Length of segments whose ends see each other, and of what follows; else ``inf``, with gradients of 0."""
    return jnp.where(seen, distance(a, b) + onward, jnp.inf)
