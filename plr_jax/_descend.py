"""Paths that follow a cost-to-go to its goal, from many starts at once, never through a wall.

Lengths in a workspace: a shortest path among polygons turns only at corners that stick out into free space. So the
corners and the goal are the only places worth looking ahead to. Each corner is joined to the two visible places of
least ``|x - y| + f(y)``, where ``f`` is the field, and Dijkstra's algorithm finds the ways to the goal along these
edges. A start goes to the visible place of least length, and on from corner to corner. The remaining length falls at
every step, so a path visits no place twice, even where the field has bumps.

Other costs and spaces are followed by lookahead: see ``_lookahead.py``.
"""

import enum
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from plr_jax._arrays import as_distances, as_finite_point, as_points, shortened
from plr_jax._lookahead import Chains, Field, Next, PathCosts, by_lookahead, chains_of
from plr_jax._types import ArrayLike
from plr_jax.geometry.corners import ReflexCorners, TurnPoints, find_corners, find_turn_points
from plr_jax.geometry.graph import Graph, dijkstra, first_visible_in_parts
from plr_jax.geometry.vectors import distances_between
from plr_jax.geometry.workspace import Workspace
from plr_jax.spaces import (
    ConfigurationSpace,
    CostMap,
    PlaneSpace,
    require_space,
)


class DescentStatus(enum.StrEnum):
    """How the descent from a start ended; the value is the message."""

    REACHED = "the path ends at the goal"
    STUCK = "neither the goal nor a place from which it can be reached is in sight"
    START_NOT_FREE = "the start lies in an obstacle or outside the bounds, or is not finite"


@dataclass(frozen=True, eq=False)
class Descent:
    """Paths from many starts to one goal.

    Attributes:
        status: How each descent ended, members of :class:`DescentStatus`, ``(n,)``.
        vertices: The paths, ``(n, longest, dim)``: from the start, along straight legs, to the goal, which is
            repeated up to the number of vertices of the longest path. Around periodic axes legs go the short way. NaN
            where there is no path.
        counts: Number of vertices of each path without the repetitions, ``(n,)``: 1 where the start is the goal, 0
            where there is no path.
        lengths: Length of each path, ``(n,)``, ``inf`` where there is none: in workspace units, or by the
            ``motion_cost`` of the space.
        costs: Cost of each path, ``(n,)``, ``inf`` where there is none: the integral of the cost map along the path,
            or its length where there is no cost map.
    """

    status: Shaped[np.ndarray, "n"]
    vertices: Float[np.ndarray, "n longest dim"]
    counts: Int[np.ndarray, "n"]
    lengths: Float[np.ndarray, "n"]
    costs: Float[np.ndarray, "n"]

    @property
    def reached(self) -> Bool[np.ndarray, "n"]:
        """Whether each path ends at the goal."""
        return self.counts > 0

    @cached_property
    def paths(self) -> list[Float[np.ndarray, "m dim"]]:
        """The paths one by one, without repetitions; no rows where there is none."""
        return [path[:count] for path, count in zip(self.vertices, self.counts.tolist(), strict=True)]

    def __len__(self) -> int:
        return len(self.counts)

    def __repr__(self) -> str:
        return f"Descent({int(self.reached.sum()):,} of {len(self):,} starts reach the goal)"


def descend(
    distance_fn: Field,
    space: Workspace | ConfigurationSpace,
    starts: ArrayLike,
    goal: ArrayLike,
    *,
    cost_map: CostMap | None = None,
) -> Descent:
    """Follow a distance function, or another cost-to-go, from many starts to its goal, by lookahead.

    *Lengths in a workspace*: shortest paths turn at corners alone, so paths go from corner to corner. The field is
    evaluated once, at the corners, and ranks their edges; every leg of every path is tested for visibility. Corners
    that the field does not lead to the goal are joined to all corners that they see. So a start reaches the goal
    whenever there is a way, whatever the field. Paths are shortest except where the field errs by more than the best
    ways on from a corner differ. Often, as in the maze, paths are shortest with a field that is zero as well: that a
    descent arrives, and how long its path is, says little about a field.

    *Other costs and spaces*: paths go on by steps of many lengths and directions, to the visible place where the
    field falls most for what the step costs. That is steepest descent in the norm of the motion cost, over finite
    steps, whatever the slope of the field. At last paths are made cheaper: vertices are left out, or shifted to where
    their two legs cost least. Dents of the field that no step leaves are filled by a slow search of the
    configurations around them: a path is STUCK where 1,000 expansions lead to no lower configuration. A step may
    cross a ridge of the field, and so take another way around an obstacle than the field does, which may be much
    longer. The better the field, the better the paths, and the sooner they are found. With a cost map, each start
    takes a few tenths of a second.

    Args:
        distance_fn: The field, such as a PLR: any function of points ``(n, dim)`` to their costs-to-go ``(n,)``
            through free space, NumPy or JAX; ``inf`` where it has none. In units of what motions cost. It is
            evaluated within the domain of the space only, into which periodic coordinates are wrapped.
        space: Free space. A Workspace is free space of points; for the shortest paths of a disc, pass the inflated
            workspace.
        starts: Where to begin, ``(n, dim)``.
        goal: Where to end, ``(dim,)``, in closed free space.
        cost_map: The factor of the motion cost that the field is a cost-to-go of; None: 1 everywhere.

    Returns:
        The paths, with a status for each start, their lengths and their costs. Costs by a cost map err by at most
        0.1 %, and far less where it is smooth.

    Raises:
        ValueError: If the space is none, or only tests configurations, a shape is wrong, the goal is not free, the
            field gives NaN or another number of values, or the cost map a number that is not positive and finite.

    References:
        "Extracting optimal trajectories" is a requirement of Putman et al., Section I. The edges are a part of the
        visibility graph: de Berg et al., Computational Geometry (3rd ed.), chapter 15. Finite
        steps stand for gradients in semi-Lagrangian schemes: Falcone and Ferretti, 2014, chapter 8.
    """
    if isinstance(space, Workspace) and cost_map is None:
        vertices, counts, lengths, costs, is_free = _along_corners(distance_fn, space, starts, goal)
    else:
        space = PlaneSpace(space) if isinstance(space, Workspace) else space
        require_space(space)
        if not isinstance(space, ConfigurationSpace):
            raise ValueError(f"space must prove motions free, with classify and are_free, got {shortened(space)}.")
        if cost_map is not None and not isinstance(cost_map, CostMap):
            raise ValueError(
                f"cost_map must be a CostMap, such as LipschitzCost or RasterCost, got {shortened(cost_map)}."
            )
        vertices, counts, lengths, costs, is_free = by_lookahead(
            distance_fn, PathCosts(space, cost_map), starts, goal
        )
    reached = counts > 0
    members = np.array([DescentStatus.REACHED, DescentStatus.STUCK, DescentStatus.START_NOT_FREE], dtype=object)
    status = members[np.where(reached, 0, np.where(is_free, 1, 2))]
    vertices = np.where(reached[:, None, None], vertices, np.nan)
    return Descent(status, vertices, counts, np.where(reached, lengths, np.inf), np.where(reached, costs, np.inf))


# Shortest paths in the plane, along corners.

_NUM_WAYS = 2  # edges of a corner that the field chooses: the best one, and another in case the field errs a little


def _along_corners(field_fn: Field, workspace: Workspace, starts: ArrayLike, goal: ArrayLike) -> Chains:
    starts, goal = map(workspace.bounds.settled, (starts, goal))
    starts, goal = as_points("starts", starts, 2), as_finite_point("The goal", goal, 2)
    if not workspace.is_free(goal[None])[0]:
        raise ValueError(f"The goal {goal.tolist()} is not in free space; move it out of the obstacle or bounds.")
    places = find_corners(workspace)[0].without(goal).with_goal(goal)
    points = places.points
    field = as_distances("The field", field_fn(points.copy()), points)  # a copy, as the function may change it
    field[0] = 0.0  # at the goal, by definition

    def shortest(edges: Int[np.ndarray, "edges 2"]) -> tuple[Float[np.ndarray, "places"], Next]:
        length, onward = dijkstra(Graph(points, edges), 0)
        return length, np.maximum(onward, 0)  # the goal follows itself

    # 1. Join each corner to the places that promise the shortest ways. Join those that are lost to all they see.
    edges = _edges(workspace, places, field, np.arange(1, len(points)), _NUM_WAYS)
    length, onward = shortest(edges)
    lost = np.flatnonzero(~np.isfinite(length))
    if lost.size:
        everything = _edges(workspace, places, np.zeros(len(points)), lost, len(points))
        edges = _unique_pairs(np.concatenate([edges, everything]))
        length, onward = shortest(edges)
    # 2. Join places to the place after the next where they see it, until no new edge comes up.
    tried = np.full(len(points), -1)
    while True:
        after_next = onward[onward]
        place = np.flatnonzero((onward > 0) & (after_next != tried))
        pairs, tried = _unique_pairs(np.stack([place, after_next[place]], axis=1)), after_next
        joined = _unique_pairs(np.concatenate([edges, pairs[workspace.is_visible(*points[pairs.T])]]))
        if len(joined) == len(edges):
            break
        edges = joined
        length, onward = shortest(edges)
    # 3. Find the first place of each start. Joints may be missing for taut ways: who sees no turn point tries all.
    is_free = workspace.is_free(starts)
    x = starts[is_free]
    to_place = np.where(workspace.is_visible(x, np.broadcast_to(goal, x.shape)), 0, -1)
    reached = 1 + np.flatnonzero(np.isfinite(length[1:]))
    any_side = np.zeros((2, len(reached), 2))
    anywhere = TurnPoints(reached, points[reached], length[reached], any_side, places.slack)
    for turns in (find_turn_points(places, length, onward), anywhere):
        pending = np.flatnonzero(to_place < 0)
        here = x[pending]
        to_place[pending] = turns.first_visible(
            here, lambda point, place, here=here: workspace.is_visible(here[point], points[place])
        )[0]
    first = np.full(len(starts), -1)
    first[is_free] = to_place
    # A start that is a corner begins with the leg after it.
    at_corner = (first > 0) & (starts == points[first]).all(axis=1)
    first[at_corner] = onward[first[at_corner]]
    vertices, counts = chains_of(starts, points, onward, first)
    lengths = np.linalg.norm(np.diff(vertices, axis=1), axis=2).sum(axis=1)
    return vertices, counts, lengths, lengths, is_free


def _edges(
    workspace: Workspace,
    places: ReflexCorners,
    field: Float[np.ndarray, "places"],
    corners: Int[np.ndarray, "corners"],
    count: int,
) -> Int[np.ndarray, "edges 2"]:
    """Pairs of one of the corners and a place it sees, for the ``count`` ways on that promise to be shortest."""

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
    return _unique_pairs(np.stack([corners[row], ways[row, column]], axis=1))


def _unique_pairs(pairs: Int[np.ndarray, "n 2"]) -> Int[np.ndarray, "distinct 2"]:
    """Each pair once, whichever way round it is given."""
    return np.unique(np.sort(pairs, axis=1), axis=0)
