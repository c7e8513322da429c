"""Shortest paths in the plane along a distance field to its goal, by lookahead to the corners in sight.

A shortest path among polygons turns only at corners that stick out into free space. So these, and the goal, are the
places worth looking ahead to: the way on from a point leads to the place in sight of least ``|x - y| + f(y)``. Steps
taken so could run in circles where the field ``f`` has bumps. Therefore each corner is joined to the best two places
that it sees, and Dijkstra's algorithm finds the ways to the goal along these edges. A start goes to the place in
sight of least ``|x - y|`` plus the length of the way from there, and on from corner to corner. The length that
remains falls at every step, so a path comes to no place twice, and ends.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import as_distances, as_finite_point, as_points
from plr_jax._types import ArrayLike
from plr_jax.geometry.corners import ReflexCorners, TurnPoints, find_corners, find_turn_points
from plr_jax.geometry.first_visible import first_visible_in_parts
from plr_jax.geometry.graph import Graph, dijkstra
from plr_jax.geometry.vectors import distances_between
from plr_jax.geometry.workspace import Workspace
from plr_jax.optimize._descent import Descent

_NUM_WAYS = 2
"""Ways on from a corner that the field names: the best one, and another where the field errs by a little."""


def along_corners(
    distance_fn: Callable[[ArrayLike], ArrayLike], workspace: Workspace, starts: ArrayLike, goal: ArrayLike
) -> Descent:
    """Shortest paths in the plane, which turn at corners alone; arguments as those of ``descend``."""
    starts, goal = map(workspace.bounds.settled, (starts, goal))
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
    # The paths that go from each start to its first place and on from there.
    points = places.points
    chains = [np.arange(len(points))]
    while (chains[-1][first[first >= 0]] != 0).any():
        chains.append(onward[chains[-1]])
    chain = np.stack(chains, axis=1)[first]
    vertices = np.concatenate([starts[:, None], points[chain]], axis=1)
    counts = 2 + (chain != 0).sum(axis=1) - (starts == points[0]).all(axis=1)
    lengths = np.linalg.norm(np.diff(vertices, axis=1), axis=2).sum(axis=1)
    return Descent.of(vertices, np.where(first < 0, 0, counts), lengths, lengths, free)


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
        pairs = here[:, None], np.arange(len(places.points))
        option = np.isfinite(score) & places.is_tangent(*pairs) & places.is_tangent(*pairs[::-1])
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


def _distinct(pairs: Int[np.ndarray, "n 2"]) -> Int[np.ndarray, "distinct 2"]:
    """Each pair once, whichever way round it is given."""
    return np.unique(np.sort(pairs, axis=1), axis=0)
