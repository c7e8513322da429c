"""Shortest paths on a map that JAX may trace, by way of the map's convex corners, at which alone paths bend.

Which points see one another is decided without derivatives. The derivative of a distance is that of the length of one
shortest path, by the ends of the path and, if the map's vertices are traced, by its corners.

A map is a pytree, ``GridCorners`` or ``PolygonCorners``. It has these members:

- ``points(dtype)``: the corners, ``(corners, 2)``.
- ``is_convex``: whether paths may bend at each corner, ``(corners,)``; false for padding.
- ``placed(x)``: points ``(n, 2)`` as *ends* of segments, for tests of sight, and whether each point is free.
- ``see_each_other(a, b)``: whether the straight segment between each pair of ends is free; batches of ends broadcast.
- ``seen_from(ends)``: which corners each end sees, ``(n, corners)``; only entries of convex corners have a meaning.
- ``lengths(dtype)``: the matrix of distances between convex corners that see each other, ``inf`` for all other pairs.
"""

from typing import Any, Self

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from plr_jax._compiled import pytree

Broadcast = Float[Array, "*#batch 2"]
Points = Float[Array, "n 2"]
Lengths = Float[Array, " corners"]
Segments = tuple[Float[Array, "corners corners"], Lengths]  # between corners, and from corners to the goal


@jax.custom_jvp
def bellman_ford(lengths: Float[Array, "corners corners"], straight: Lengths) -> Lengths:
    """Return the distance of each corner to the goal, along straight segments between corners.

    ``lengths[i, j]`` is the length of the segment between corners ``i`` and ``j``. ``straight[i]`` is the length of
    the segment between corner ``i`` and the goal. Both are ``inf`` if the segment is not free.
    """

    # The Bellman-Ford algorithm, for all corners at once: a round extends paths by one corner.
    def relaxed(state):
        old, _ = state
        new = jnp.minimum(old, jnp.min(lengths + old[None], axis=-1))
        return new, jnp.any(new < old)

    return jax.lax.while_loop(lambda state: state[1], relaxed, (straight, jnp.array(True)))[0]


@bellman_ford.defjvp
def _(primals, tangents):
    total = bellman_ford(*primals)
    return total, _tangents_of_paths(primals, total, tangents)


def _tangents_of_paths(segments: Segments, total: Lengths, changes: Segments) -> Lengths:
    """Return how distances ``total`` change, to first order, if the lengths of segments change.

    ``segments`` and their ``changes`` are the arguments of :func:`bellman_ford`, and ``total`` is its result.
    """
    # Pointer doubling: `change` is the sum over the first 1, 2, 4, ... segments of each path, and `onward` the corner
    # at their end. The goal is number `count`, whose path has no segments.
    (lengths, straight), (change_of_lengths, change_of_straight) = segments, changes
    count = len(straight)
    following = _longest_of_equal(jnp.where(total[None] < total[:, None], lengths, jnp.inf), total[None], total)
    is_last = straight <= _rounded_up(total)
    change = jnp.append(jnp.where(is_last, change_of_straight, change_of_lengths[jnp.arange(count), following]), 0)
    onward = jnp.append(jnp.where(is_last, count, following), count)
    for _ in range(count.bit_length()):
        change, onward = change + change[onward], onward[onward]
    return jnp.where(jnp.isfinite(total), change[:-1], 0)


@pytree
class CornerPaths:
    """Shortest paths to the nearest of several goals, by way of convex corners."""

    corners: Any  # a map
    distances: Float[Array, "*maps corners"]  # from convex corners to the nearest goal
    goals: Float[Array, "*maps goals 2"]

    @classmethod
    def to_goals(cls, corners: Any, goals: Float[Array, "goals 2"]) -> Self:
        ends, is_free = corners.placed(goals)
        seen = corners.seen_from(ends) & is_free[:, None] & corners.is_convex[None]
        straight = length_if_seen(seen, goals[:, None], corners.points(goals.dtype)[None]).T
        straight = shortest(straight, jnp.zeros_like(straight))
        return cls(corners, bellman_ford(corners.lengths(goals.dtype), straight), goals)

    def distance(self, x: Points) -> Float[Array, " n"]:
        x = x.astype(jnp.promote_types(x.dtype, self.goals.dtype))
        placed = self.corners.placed(x)
        return self.distance_given_sight(x, placed, self.corners.seen_from(placed[0]))

    def distance_given_sight(self, x: Points, placed: Any, seen: Bool[Array, "n corners"]) -> Float[Array, " n"]:
        """Return the distance of each point to the nearest goal, given which corners the point sees.

        ``seen[i, j]`` says whether point ``x[i]`` sees corner ``j``; ``placed`` is the result of the map's method
        ``placed`` for ``x``. The distance is the least length of the straight segments to goals, and of the paths
        through each visible corner.
        """
        goals = self.goals.astype(x.dtype)
        (ends, is_free), (goal_ends, goal_is_free) = placed, self.corners.placed(goals)
        sees_goal = self.corners.see_each_other(ends[:, None], goal_ends[None]) & goal_is_free[None]
        through = jnp.isfinite(self.distances)[None] & seen
        to_goals = length_if_seen(sees_goal, x[:, None], goals[None])
        to_corners = length_if_seen(through, x[:, None], self.corners.points(x.dtype)[None])
        first = jnp.append(to_goals, to_corners, axis=1)
        onward = jnp.append(jnp.zeros(len(goals), x.dtype), self.distances.astype(x.dtype))
        return jnp.where(is_free, shortest(first, jnp.broadcast_to(onward, first.shape)), jnp.inf)


@pytree
class CornerPairs:
    """Shortest paths between any two points, by way of convex corners."""

    corners: Any  # a map
    between: Float[Array, "*maps corners corners"]  # shortest paths between corners; 0 from a corner to itself

    @classmethod
    def of_map(cls, corners: Any) -> "CornerPairs":
        return cls(corners, _paths_between(corners.lengths(jnp.zeros(()).dtype)))

    def distance(self, x: Points, y: Points) -> Float[Array, " n"]:
        # The straight segment, or x -> first corner -> last corner -> y: `onward` is the way from each corner to y.
        dtype = jnp.promote_types(jnp.promote_types(x.dtype, y.dtype), self.between.dtype)
        x, y, points = x.astype(dtype), y.astype(dtype), self.corners.points(dtype)[None]
        (x_ends, x_is_free), (y_ends, y_is_free) = self.corners.placed(x), self.corners.placed(y)
        from_x = length_if_seen(self.corners.seen_from(x_ends), x[:, None], points)
        from_y = length_if_seen(self.corners.seen_from(y_ends), y[:, None], points)
        onward = shortest(from_y[:, None], self.between[None])
        direct = length_if_seen(self.corners.see_each_other(x_ends, y_ends), x, y)[:, None]
        value = shortest(jnp.append(direct, from_x, axis=1), jnp.append(jnp.zeros_like(direct), onward, axis=1))
        return jnp.where(x_is_free & y_is_free & jnp.isfinite(value), value, jnp.inf)


@jax.custom_jvp
def _paths_between(lengths: Float[Array, "corners corners"]) -> Float[Array, "corners corners"]:
    """Return the distances between all corners, given the lengths of segments between corners."""
    # Floyd-Warshall algorithm
    direct = jnp.where(jnp.eye(len(lengths), dtype=bool), 0, lengths)
    return jax.lax.fori_loop(0, len(direct), lambda k, d: jnp.minimum(d, d[:, k, None] + d[None, k]), direct)


@_paths_between.defjvp
def _(primals, tangents):
    # Column j has the distances to corner j, as to a goal that only corner j sees, at distance 0.
    total = _paths_between(*primals)
    straight = jnp.where(jnp.eye(len(total), dtype=bool), 0, jnp.inf)
    change = jax.vmap(_tangents_of_paths, ((None, 1), 1, (None, 1)), 1)
    return total, change((*primals, straight), total, (*tangents, jnp.zeros_like(straight)))


def length_if_seen(seen: Bool[Array, "*batch"], a: Broadcast, b: Broadcast) -> Float[Array, "*batch"]:
    """Return the lengths of segments, ``inf`` unless ``seen``; the gradient is 0 where the ends coincide."""
    dx, dy = a[..., 0] - b[..., 0], a[..., 1] - b[..., 1]
    squares = dx * dx + dy * dy
    length = jnp.where(squares > 0, jnp.sqrt(jnp.where(squares > 0, squares, 1)), 0)
    return jnp.where(seen, length, jnp.inf)


@jax.custom_jvp
def shortest(first: Float[Array, "*#batch k"], onward: Float[Array, "*#batch k"]) -> Float[Array, "*batch"]:
    """Return the minimum of ``first + onward`` over the last axis; its gradient is that of one minimizing entry."""
    return jnp.min(first + onward, axis=-1)


@shortest.defjvp
def _(primals, tangents):
    first, onward = primals
    change = tangents[0] + tangents[1]
    least = shortest(first, onward)  # not jnp.min, whose own gradient would count in second derivatives
    minimizer = _longest_of_equal(first, onward, least)
    is_minimizer = jax.lax.broadcasted_iota(int, change.shape, change.ndim - 1) == minimizer[..., None]
    return least, jnp.sum(jnp.where(is_minimizer, change, 0), axis=-1)


def _longest_of_equal(
    first: Float[Array, "*#batch k"], onward: Float[Array, "*#batch k"], least: Float[Array, "*batch"]
) -> Int[Array, "*batch"]:
    """Return the index, along the last axis, of the shortest path; its length is ``least``, up to rounding.

    A path's length is the sum of its ``first`` segment and the rest, ``onward``. Among paths equal up to rounding,
    the path with the longest first segment counts. If a point sees two corners of its path, the way straight to the
    farther corner is never longer, but rounding may hide this. A segment from a corner to itself has no direction.
    """
    return jnp.argmax(jnp.where(first + onward <= _rounded_up(least)[..., None], first, -1), axis=-1)


def _rounded_up(length: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
    return length * (1 + 4 * jnp.finfo(length.dtype).eps)
