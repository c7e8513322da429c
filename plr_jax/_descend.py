"""Collision-free paths from many starts to a goal, found by following a cost-to-go function ``f``.

If costs are lengths in a workspace, paths go from corner to corner of the obstacles. Each corner ``x`` is joined to
the two visible *places* ``y`` (corners or goal) of least ``|x - y| + f(y)``. Dijkstra's algorithm finds paths along
these edges, even if ``f`` has local minima. For other costs and spaces see ``_lookahead.py``.
"""

import enum
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from plr_jax import _arrays
from plr_jax._lookahead import Chains, Field, Next, PathCosts, by_lookahead, chains_of
from plr_jax._types import ArrayLike, Distances
from plr_jax.geometry.boundary import Edges, Indices
from plr_jax.geometry.corners import ReflexCorners, TurnPoints, find_corners, find_turn_points
from plr_jax.geometry.graph import Arcs, Graph, dijkstra, first_visible_in_parts, path_ends
from plr_jax.geometry.vectors import distances_between
from plr_jax.geometry.workspace import Workspace
from plr_jax.spaces import ConfigurationSpace, CostMap, PlaneSpace
from plr_jax.spaces._space import require_space


class DescentStatus(enum.StrEnum):
    """The result of the descent from one start; the value of each member is a message for users."""

    REACHED = "the path ends at the goal"
    STUCK = "neither the goal nor a place from which it can be reached is in sight"
    START_NOT_FREE = "the start lies in an obstacle or outside the bounds, or is not finite"


@dataclass(frozen=True, eq=False)
class Descent:
    """Paths from many starts to a goal, or to the nearest of several goals.

    Attributes:
        status: The :class:`DescentStatus` of each start, ``(n,)``.
        vertices: Vertices of the paths, ``(n, longest, dim)``, from the start to a goal. Copies of the goal fill up
            shorter paths. All vertices are NaN if there is no path. Along periodic axes, segments go the shorter way.
        counts: Number of vertices of each path, ``(n,)``, without the copies of the goal: 1 if the start is the goal,
            0 if there is no path.
        paths: The vertices of each path without the copies of the goal, a list of ``n`` arrays ``(counts[i], dim)``.
        lengths: Length of each path, ``(n,)``: in workspace units, or for other spaces by their ``motion_cost``. The
            length is ``inf`` if there is no path.
        costs: Integral of the cost map along each path, ``(n,)``; without a cost map, the length; ``inf`` if there is
            no path.
    """

    status: Shaped[np.ndarray, " n"]
    vertices: Float[np.ndarray, "n longest dim"]
    counts: Int[np.ndarray, " n"]
    lengths: Float[np.ndarray, " n"]
    costs: Float[np.ndarray, " n"]

    @property
    def reached(self) -> Bool[np.ndarray, " n"]:
        """Whether each path ends at the goal."""
        return self.counts > 0

    @cached_property
    def paths(self) -> list[Float[np.ndarray, "m dim"]]:
        """The vertices of each path, ``(m, dim)``, without the copies of the goal; ``m`` is 0 if there is no path."""
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
    offsets: ArrayLike | None = None,
    cost_map: CostMap | None = None,
) -> Descent:
    """Follow a cost-to-go, such as a PLR, from many starts to its goal.

    The common call is ``descend(plr, workspace, starts, goal).paths``.

    *Lengths in a workspace*: paths go from corner to corner of the obstacles. The cost-to-go only ranks the edges
    between corners. So each start from which a path exists reaches the goal, and path lengths say little about the
    errors of the cost-to-go.

    *Other costs and spaces*: paths take finite steps to the visible point where the cost-to-go falls most per cost of
    the step. Then vertices are skipped or shifted to reduce the cost. From local minima, a slower search finds a way
    on, or gives up (STUCK) after it has expanded 1,000 nodes. With a cost map, each start takes a few tenths of a
    second.

    Args:
        distance_fn: The field: a function of points ``(n, dim)`` that returns costs-to-go ``(n,)``, NumPy or JAX, in
            units of the motion cost; ``inf`` where unknown. Its points lie in the domain, with periodic axes wrapped.
        space: Free space. A Workspace is that of a point; for a disc, pass the inflated workspace.
        starts: Start points, ``(n, dim)``.
        goal: Goal point, ``(dim,)``, in free space or on its boundary. If costs are lengths in a workspace, there may
            be several goals, ``(k, 2)``: each path ends at the goal to which the shortest path was found. At the
            goals themselves, the values of ``distance_fn`` are not used.
        offsets: Cost of ending at each goal, ``(k,)``, as for :class:`NearestGoal`; None: 0. Only for several goals.
        cost_map: Factor of the motion cost at each point: the map for which ``distance_fn`` was computed. None: the
            factor is 1 everywhere.

    Returns:
        Status, path, length and cost for each start. With a cost map, costs are integrated to about 0.1 % or better;
        a path may cost some percent more than the cheapest.

    Raises:
        ValueError: If ``distance_fn`` is no function, ``space`` has a wrong type or only tests single configurations,
            not segments (:class:`FreeTest`), a shape is wrong, the goal is not free, or a returned value is invalid:
            NaN of the field, or not positive and finite for the cost map.

    References: Putman et al., Section I; de Berg et al., 2008, chapter 15; Falcone and Ferretti, 2014, chapter 8.
    """
    _arrays.require_function("distance_fn", distance_fn)
    if isinstance(space, Workspace) and cost_map is None:
        chains = _along_corners(distance_fn, space, starts, goal, offsets)
    else:
        if offsets is not None:
            raise ValueError("offsets need several goals in a Workspace without a cost map: leave offsets out.")
        space = PlaneSpace(space) if isinstance(space, Workspace) else space
        require_space(space)
        if not isinstance(space, ConfigurationSpace):
            expected = "classify and are_free to prove motions free"
            raise ValueError(f"space must have {expected}, got {_arrays.shortened(space)}.")
        _arrays.require_type("cost_map", cost_map, CostMap | None, "a CostMap, such as RasterCost")
        chains = by_lookahead(distance_fn, PathCosts(space, cost_map), starts, goal)
    vertices, counts, lengths, costs, is_free = chains
    reached = counts > 0
    members = np.array([DescentStatus.REACHED, DescentStatus.STUCK, DescentStatus.START_NOT_FREE], dtype=object)
    status = members[np.where(reached, 0, np.where(is_free, 1, 2))]
    vertices = np.where(reached[:, None, None], vertices, np.nan)
    return Descent(status, vertices, counts, np.where(reached, lengths, np.inf), np.where(reached, costs, np.inf))


_NUM_WAYS = 2  # edges per corner: the best one by the field, and another one in case of a small error


def _along_corners(
    field_fn: Field, workspace: Workspace, starts: ArrayLike, goal: ArrayLike, offsets: ArrayLike | None
) -> Chains:
    """Find paths in a workspace from corner to corner, along edges that the cost-to-go ``field_fn`` ranks best.

    Return the vertices of the paths, their numbers of vertices (0: no path), lengths, costs (lengths plus the offset
    of the goal), and whether each start is free.
    """
    # 1. Check the arguments, and evaluate the field at all *places*: the goals, then the corners. The function gets a
    #    copy of the places, as it may modify its argument.
    starts = _arrays.as_points("starts", workspace.settled(starts), 2)
    goal = _arrays.as_numbers("goal", workspace.settled(goal), "numbers of shape (2,) or (k, 2)")
    goal = goal if goal.ndim == 2 else _arrays.as_finite_point("The goal", goal, 2)[None]
    goals = _arrays.as_points("goal", goal, 2)
    if not len(goals):
        raise ValueError("goal must be one point (2,) or several (k, 2), got none.")
    if not (is_fine := workspace.is_free(goals)).all():
        got = f"{goals[is_fine.argmin()].tolist()}: move it out of the obstacle or into the bounds"
        raise ValueError(f"The goal must be in free space, got {got}.")
    places = find_corners(workspace)[0].without(goals).with_points(goals)
    num_goals, points = len(goals), places.points
    field = _arrays.as_distances("The field", field_fn(points.copy()), points)
    field[:num_goals] = offsets = _arrays.as_offsets(offsets, num_goals)
    end = Arcs(np.full(num_goals, len(points)), np.arange(num_goals), offsets)  # to the goals from a place after all

    def shortest(edges: Edges) -> tuple[Float[np.ndarray, "places"], Next]:
        graph = Graph(np.append(points, points[:1], axis=0), edges, arcs=end)
        length, onward = dijkstra(graph.adjacency, len(points))
        # The next place of a goal is the goal, unless another goal costs less from there. Places without a path point
        # to goal 0, so that indexing works; their length is inf, so no path uses them.
        onward[:num_goals] = np.where(onward[:num_goals] == len(points), np.arange(num_goals), onward[:num_goals])
        return length[:-1], np.maximum(onward[:-1], 0)

    # 2. Join each corner to its best places by the field. Join corners without a path to all places that they see.
    edges = _edges(workspace, places, field, np.arange(num_goals, len(points)), _NUM_WAYS)
    length, onward = shortest(edges)
    if len(lost := np.flatnonzero(~np.isfinite(length))):
        everything = _edges(workspace, places, np.zeros(len(points)), lost, len(points))
        edges = _unique_pairs(np.concatenate([edges, everything]))
        length, onward = shortest(edges)
    # 3. Join each place to the place after the next one if visible, until there are no new edges. Skip pairs that
    #    were tried in the last round.
    tried = np.full(len(points), -1)
    while True:
        after_next = onward[onward]
        place = np.flatnonzero((onward >= num_goals) & (after_next != tried))
        pairs = _unique_pairs(np.stack([place, after_next[place]], axis=1))
        tried = after_next
        joined = _unique_pairs(np.concatenate([edges, pairs[workspace.is_visible(*points[pairs.T])]]))
        if len(joined) == len(edges):
            break
        edges = joined
        length, onward = shortest(edges)
    # A goal from which another one costs less is no end.
    if not (is_end := onward[:num_goals] == np.arange(num_goals)).all():
        return _along_corners(field_fn, workspace, starts, goals[is_end], offsets[is_end])
    # 4. Find the first place of each start: the nearest visible goal, else a visible place where a shortest path may
    #    turn, else any visible place (each has a cone without sides, with normals of 0). With several goals, places
    #    where a path may turn are compared also for starts that see a goal: a path to another goal may be shorter.
    is_free = workspace.is_free(starts)
    x = starts[is_free]
    reached = num_goals + np.flatnonzero(np.isfinite(length[num_goals:]))
    at_goals = TurnPoints(np.arange(num_goals), goals, offsets, np.zeros((2, num_goals, 2)), places.slack)
    anywhere = TurnPoints(reached, points[reached], length[reached], np.zeros((2, len(reached), 2)), places.slack)
    at_corners = find_turn_points(places, length, onward, num_goals)
    to_place, least = np.full(len(x), -1), np.full(len(x), np.inf)
    for turns, may_be_shorter in ((at_goals, False), (at_corners, num_goals > 1), (anywhere, False)):
        pending = np.flatnonzero((to_place < 0) | may_be_shorter)
        a = x[pending]
        place, by_place = turns.first_visible(a, lambda i, place, a=a: workspace.is_visible(a[i], points[place]))
        to_place[pending] = np.where(by_place < least[pending], place, to_place[pending])
        least[pending] = np.minimum(by_place, least[pending])
    first = np.full(len(starts), -1)
    first[is_free] = to_place
    # A start at a corner continues to the corner's next place.
    at_corner = (first >= num_goals) & (starts == points[first]).all(axis=1)
    first[at_corner] = onward[first[at_corner]]
    # 5. Follow the next places.
    vertices, counts = chains_of(starts, points, onward, first, num_goals)
    lengths = np.linalg.norm(np.diff(vertices, axis=1), axis=2).sum(axis=1)
    return vertices, counts, lengths, lengths + offsets[path_ends(onward)[np.maximum(first, 0)]], is_free


def _edges(workspace: Workspace, places: ReflexCorners, field: Distances, corners: Indices, count: int) -> Edges:
    """Join each corner to the ``count`` visible places of least distance plus cost-to-go; return the edges.

    Places are goals and corners; ``field`` is the cost-to-go of each. ``corners`` are indices in ``places``. Each
    edge is a pair ``(i, j)`` of indices in ``places``, with ``i < j``, and occurs once.
    """

    def lookahead(rows: slice) -> Float[np.ndarray, "rows places"]:
        # Return the distance to each place plus its cost-to-go; NaN where no shortest path can go.
        corner = corners[rows]
        score = distances_between(places.points[corner], places.points) + field
        pairs = corner[:, None], np.arange(len(places.points))
        option = np.isfinite(score) & places.is_tangent(*pairs) & places.is_tangent(*pairs[::-1])
        option[np.arange(len(corner)), corner] = False
        return np.where(option, score, np.nan)

    def sees(row: Int[np.ndarray, " pairs"], place: Int[np.ndarray, " pairs"]) -> Bool[np.ndarray, " pairs"]:
        return workspace.is_visible(places.points[corners[row]], places.points[place])

    ways, _ = first_visible_in_parts(lookahead, len(corners), len(places.points), sees, count)
    row, column = np.nonzero(ways >= 0)
    return _unique_pairs(np.stack([corners[row], ways[row, column]], axis=1))


def _unique_pairs(pairs: Int[np.ndarray, "n 2"]) -> Edges:
    return np.unique(np.sort(pairs, axis=1), axis=0)
