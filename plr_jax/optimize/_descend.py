"""Paths that follow a distance field to its goal, from many starts at once, never through a wall.

A shortest path among polygons turns only at corners that stick out into free space. So these, and the goal, are the
places worth looking ahead to: the way on from a point leads to the place in sight of least ``|x - y| + f(y)``. Steps
taken so could run in circles where the field ``f`` has bumps. Therefore each corner is joined to the best two places
that it sees, and Dijkstra's algorithm finds the ways to the goal along these edges. A start goes to the place in
sight of least ``|x - y|`` plus the length of the way from there, and on from corner to corner. The length that
remains falls at every step, so a path comes to no place twice, and ends.
"""

import enum
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from plr_jax._arrays import as_distances, as_finite_point, as_points
from plr_jax._types import ArrayLike
from plr_jax.geometry.corners import ReflexCorners, TurnPoints, find_corners, find_turn_points
from plr_jax.geometry.first_visible import first_visible_in_parts
from plr_jax.geometry.graph import Graph, dijkstra
from plr_jax.geometry.vectors import distances_between
from plr_jax.geometry.workspace import Workspace

_NUM_WAYS = 2
"""Ways on from a corner that the field names: the best one, and another where the field errs by a little."""


class DescentStatus(enum.StrEnum):
    """How the descent from a start ended; the value is the message."""

    REACHED = "the path ends at the goal"
    STUCK = "neither the goal nor a corner from which it can be reached is in sight"
    START_NOT_FREE = "the start lies in an obstacle or outside the bounds, or is not finite"


@dataclass(frozen=True, eq=False)
class Descent:
    """Paths from many starts to one goal.

    Attributes:
        status: How each descent ended, members of :class:`DescentStatus`, ``(n,)``.
        vertices: The paths, ``(n, longest, 2)``: from the start, along straight legs, to the goal, which is repeated
            up to the length of the longest path. NaN where there is no path.
        counts: Number of vertices of each path without the repetitions, ``(n,)``: 1 where the start is the goal, 0
            where there is no path.
        lengths: Length of each path in workspace units, ``(n,)``; ``inf`` where there is none.
    """

    status: Shaped[np.ndarray, "n"]
    vertices: Float[np.ndarray, "n longest 2"]
    counts: Int[np.ndarray, "n"]
    lengths: Float[np.ndarray, "n"]

    @property
    def reached(self) -> Bool[np.ndarray, "n"]:
        """Whether each path ends at the goal."""
        return self.counts > 0

    @cached_property
    def paths(self) -> list[Float[np.ndarray, "m 2"]]:
        """The paths one by one, without repetitions; no rows where there is none."""
        return [path[:count] for path, count in zip(self.vertices, self.counts.tolist(), strict=True)]

    def __len__(self) -> int:
        return len(self.counts)

    def __repr__(self) -> str:
        return f"Descent({int(self.reached.sum()):,} of {len(self):,} starts reach the goal)"


def descend(
    distance_fn: Callable[[ArrayLike], ArrayLike], workspace: Workspace, starts: ArrayLike, goal: ArrayLike
) -> Descent:
    """Follow a distance field from many starts to its goal, by lookahead to the corners in sight.

    The field is asked once, at the corners of the workspace, whose edges it ranks; every leg of every path is tested
    for visibility. Corners that the field does not lead to the goal are joined to all that they see. So a start
    reaches the goal whenever there is a way, whatever the field; its paths are the shortest but for places where it
    errs by more than the best ways on from a corner differ. Most tests are those of starts, of which it saves few.
    Often, as in the maze, paths are the shortest with a field that is zero as well: that a descent arrives, and how
    long it is, says little of a field.

    Args:
        distance_fn: The field, such as a PLR: any function of points ``(n, 2)`` to ``(n,)`` distances to the goal
            through free space, NumPy or JAX; ``inf`` where it has none.
        workspace: The free space. For a disc, the inflated one.
        starts: Where to begin, ``(n, 2)``.
        goal: Where to end, ``(2,)``, in closed free space.

    Returns:
        The paths, with a status for each start. A path has at most one leg more than the workspace has corners.

    Raises:
        ValueError: If a shape is wrong, the goal is not free, or the field gives NaN or another number of values.

    References:
        "Extracting optimal trajectories" is a requirement of Putman et al., Section I. The edges are a part of the
        visibility graph: de Berg et al., Computational Geometry (3rd ed.), chapter 15.
    """
    starts, goal = as_points("starts", starts, 2), as_finite_point("The goal", goal, 2)
    if not workspace.is_free(goal[None])[0]:
        raise ValueError(f"The goal {goal.tolist()} is not in free space; move it out of the obstacle or bounds.")
    places = find_corners(workspace)[0].without(goal).with_goal(goal)
    field = as_distances("The field", distance_fn(places.points.copy()), places.points)  # a copy it may change
    field = np.append(0.0, field[1:])  # zero at the goal, by definition
    length, onward = _ways_to_goal(workspace, places, field)
    free = workspace.is_free(starts)
    first = np.full(len(starts), -1)
    first[free] = _first_places(workspace, starts[free], places, length, onward)
    # A start that is a corner begins with the leg that follows.
    at_corner = (first > 0) & (starts == places.points[first]).all(axis=1)
    first[at_corner] = onward[first[at_corner]]
    return _assemble(starts, free, first, places.points, onward)


def _ways_to_goal(
    workspace: Workspace, places: ReflexCorners, field: Float[np.ndarray, "places"]
) -> tuple[Float[np.ndarray, "places"], Int[np.ndarray, "places"]]:
    """Length of a free way from each place to the goal, ``inf`` where there is none, and the next place on it."""
    edges = _edges(workspace, places, field, np.arange(1, len(places.points)), _NUM_WAYS)
    length, onward = _shortest(places, edges)
    lost = np.flatnonzero(~np.isfinite(length))
    if lost.size:
        everything = _edges(workspace, places, np.zeros(len(places.points)), lost, len(places.points))
        edges = _distinct(np.concatenate([edges, everything]))
        length, onward = _shortest(places, edges)
    return _pulled_tight(workspace, places, edges, length, onward)


def _edges(
    workspace: Workspace,
    places: ReflexCorners,
    field: Float[np.ndarray, "places"],
    corners: Int[np.ndarray, "corners"],
    count: int,
) -> Int[np.ndarray, "edges 2"]:
    """Pairs of one of some corners and a place it sees, for the ``count`` ways on that promise to be shortest."""

    def lookahead(rows: slice) -> Float[np.ndarray, "rows places"]:
        here = corners[rows]
        score = distances_between(places.points[here], places.points) + field
        option = np.isfinite(score) & places.is_tangent(here) & places.is_tangent(slice(None), here).T
        option[np.arange(len(here)), here] = False
        return np.where(option, score, np.nan)

    def sees(row: Int[np.ndarray, "pairs"], place: Int[np.ndarray, "pairs"]) -> Bool[np.ndarray, "pairs"]:
        return workspace.is_visible(places.points[corners[row]], places.points[place])

    ways, _ = first_visible_in_parts(lookahead, len(corners), len(places.points), sees, count)
    row, column = np.nonzero(ways >= 0)
    return _distinct(np.stack([corners[row], ways[row, column]], axis=1))


def _pulled_tight(
    workspace: Workspace,
    places: ReflexCorners,
    edges: Int[np.ndarray, "edges 2"],
    length: Float[np.ndarray, "places"],
    onward: Int[np.ndarray, "places"],
) -> tuple[Float[np.ndarray, "places"], Int[np.ndarray, "places"]]:
    """The ways after joining places to the place after the next where they see it, until no new edge comes up."""
    tried = np.full(len(places.points), -1)
    while True:
        after_next = onward[onward]
        place = np.flatnonzero((onward > 0) & (after_next != tried))
        pairs, tried = _distinct(np.stack([place, after_next[place]], axis=1)), after_next
        visible = workspace.is_visible(*places.points[pairs.T])
        joined = _distinct(np.concatenate([edges, pairs[visible]]))
        if len(joined) == len(edges):
            return length, onward
        edges = joined
        length, onward = _shortest(places, edges)


def _shortest(
    places: ReflexCorners, edges: Int[np.ndarray, "edges 2"]
) -> tuple[Float[np.ndarray, "places"], Int[np.ndarray, "places"]]:
    """Length of the shortest way to the goal along edges, and the next place on it; the goal follows itself."""
    length, onward = dijkstra(Graph(places.points, edges), 0)
    return length, np.maximum(onward, 0)


def _first_places(
    workspace: Workspace,
    starts: Float[np.ndarray, "n 2"],
    places: ReflexCorners,
    length: Float[np.ndarray, "places"],
    onward: Int[np.ndarray, "places"],
) -> Int[np.ndarray, "n"]:
    """The place that each start goes to first, -1 where none from which the goal can be reached is in sight."""
    first = np.where(workspace.is_visible(starts, np.broadcast_to(places.points[0], starts.shape)), 0, -1)
    reached = 1 + np.flatnonzero(np.isfinite(length[1:]))
    any_side = np.zeros((2, len(reached), 2))
    anywhere = TurnPoints(reached, places.points[reached], length[reached], any_side, places.slack)
    # Joints may be missing for the taut ways, so who finds none in sight tries all.
    for options in (find_turn_points(places, length, onward), anywhere):
        pending = np.flatnonzero(first < 0)
        x = starts[pending]

        def sees(point: Int[np.ndarray, "k"], place: Int[np.ndarray, "k"], x=x) -> Bool[np.ndarray, "k"]:
            return workspace.is_visible(x[point], places.points[place])

        first[pending] = options.first_visible(x, sees)[0]
    return first


def _assemble(
    starts: Float[np.ndarray, "n 2"],
    free: Bool[np.ndarray, "n"],
    first: Int[np.ndarray, "n"],
    points: Float[np.ndarray, "places 2"],
    onward: Int[np.ndarray, "places"],
) -> Descent:
    """The paths that go from each start to its first place and on from there."""
    chains = [np.arange(len(points))]
    while (chains[-1][first[first >= 0]] != 0).any():
        chains.append(onward[chains[-1]])
    chain = np.stack(chains, axis=1)[first]
    vertices = np.concatenate([starts[:, None], points[chain]], axis=1)
    counts = 2 + (chain != 0).sum(axis=1) - (starts == points[0]).all(axis=1)
    lengths = np.linalg.norm(np.diff(vertices, axis=1), axis=2).sum(axis=1)
    vertices[first < 0], counts[first < 0], lengths[first < 0] = np.nan, 0, np.inf
    members = np.array([DescentStatus.REACHED, DescentStatus.STUCK, DescentStatus.START_NOT_FREE], dtype=object)
    return Descent(members[np.where(first >= 0, 0, np.where(free, 1, 2))], vertices, counts, lengths)


def _distinct(pairs: Int[np.ndarray, "n 2"]) -> Int[np.ndarray, "distinct 2"]:
    """Each pair once, whichever way round it is given."""
    return np.unique(np.sort(pairs, axis=1), axis=0)
