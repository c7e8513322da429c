"""Paths that follow a distance field to its goal, from many starts at once, never through a wall.

A shortest path among polygons turns only at corners that stick out into free space. So these, and the goal, are the
places that are worth looking ahead to: the way on from a point leads to the visible one of least ``|x - y| + f(y)``.
Taken greedily, such steps could run in circles where the field ``f`` has bumps. Therefore each corner is joined to
the few best places that it sees, and Dijkstra's algorithm finds the lengths of the ways to the goal along these
joints. A start then goes to the visible place of least ``|x - y| + length(y)``, and on from corner to corner: the
length that remains falls at every step, so a path visits no place twice and ends.
"""

import enum
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from plr_jax._arrays import as_finite_point, as_points
from plr_jax._graph import Graph, dijkstra
from plr_jax._types import ArrayLike, DistanceFn
from plr_jax._workspace import Workspace
from plr_jax.optimize._sight import best_in_sight

_NUM_WAYS = 4
"""Ways on from a corner that the field names. Where corners are closer than its error, the best may be the third."""


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


def descend(distance_fn: DistanceFn, workspace: Workspace, starts: ArrayLike, goal: ArrayLike) -> Descent:
    """Follow a distance field from many starts to its goal, by lookahead to the corners in sight.

    The field is asked once, at the corners of the workspace, which it ranks; every leg of every path is then tested
    for visibility. Corners that the field does not lead to the goal are joined to all they see, so a start reaches
    the goal whenever there is a way. How short the path is depends on the field: with exact distances it is the
    shortest, with a PLR the shortest but for places where the PLR errs by more than two ways differ.

    Args:
        distance_fn: The field, such as a PLR: any function of points ``(n, 2)`` to ``(n,)`` distances to the goal
            by way of free space, NumPy or JAX; ``inf`` where it has none.
        workspace: The free space. For a disc, the inflated one.
        starts: Where to begin, ``(n, 2)``.
        goal: Where to end, ``(2,)``, in closed free space.

    Returns:
        The paths, with a status for each start.

    Raises:
        ValueError: If shapes are wrong, the goal is not free, or the field gives NaN or another number of values.

    References:
        "Extracting optimal trajectories" is a requirement of Putman et al., Section I. The joints are a part of the
        visibility graph: de Berg et al., Computational Geometry (3rd ed.), chapter 15.
    """
    starts, goal = as_points("starts", starts, 2), as_finite_point("The goal", goal, 2)
    if not workspace.is_free(goal[None])[0]:
        raise ValueError(f"The goal {goal.tolist()} is not in free space; move it out of the obstacle or bounds.")
    places = np.concatenate([goal[None], _corners(workspace, goal)])
    length, onward = _ways_to_goal(workspace, places, _field_at(distance_fn, places))
    free = workspace.is_free(starts)
    first = np.full(len(starts), -1)
    first[free] = _first_places(workspace, starts[free], places, length)
    # A start that is a corner begins with the leg that follows.
    at_corner = (first > 0) & (starts == places[first]).all(axis=1)
    first[at_corner] = onward[first[at_corner]]
    return _assemble(starts, free, first, places, onward)


def _corners(workspace: Workspace, goal: Float[np.ndarray, "2"]) -> Float[np.ndarray, "corners 2"]:
    """Where a path can turn: reflex corners and, where squeezing is allowed, point contacts; not the goal."""
    boundary = workspace.boundary
    turns = boundary.is_reflex(1e-3 * workspace.tolerance)
    if workspace.squeeze:
        turns |= np.isin(boundary.edges[:, 0], boundary.contacts)
    corners = boundary.vertices[np.unique(boundary.edges[turns, 0])]
    return corners[(corners != goal).any(axis=1)]


def _field_at(distance_fn: DistanceFn, places: Float[np.ndarray, "places 2"]) -> Float[np.ndarray, "places"]:
    """The field at the goal, where it is zero by definition, and at the corners."""
    field = np.asarray(distance_fn(places), dtype=np.float64)
    if field.shape != (len(places),):
        raise ValueError(f"The field must give one number a point, shape ({len(places)},), got {field.shape}.")
    if np.isnan(field).any():
        raise ValueError(f"The field gives NaN at {places[np.isnan(field)][0].tolist()}; use inf for unreachable.")
    return np.append(0.0, field[1:])


def _ways_to_goal(
    workspace: Workspace, places: Float[np.ndarray, "places 2"], field: Float[np.ndarray, "places"]
) -> tuple[Float[np.ndarray, "places"], Int[np.ndarray, "places"]]:
    """Length of a free way from each place to the goal, ``inf`` where there is none, and the next place on it."""
    joints = _joints(workspace, places, field, np.arange(1, len(places)), _NUM_WAYS)
    length, onward = dijkstra(Graph(places, joints), 0)
    lost = np.flatnonzero(~np.isfinite(length))
    if lost.size:
        all_in_sight = _joints(workspace, places, np.zeros(len(places)), lost, len(places))
        joints = _distinct(np.concatenate([joints, all_in_sight]))
        length, onward = dijkstra(Graph(places, joints), 0)
    return _shortened(workspace, places, joints, length, onward)


def _joints(
    workspace: Workspace,
    places: Float[np.ndarray, "places 2"],
    field: Float[np.ndarray, "places"],
    corners: Int[np.ndarray, "corners"],
    count: int,
) -> Int[np.ndarray, "joints 2"]:
    """Pairs of one of some corners and a place it sees, for the ``count`` ways on that promise to be shortest."""

    def lookahead(rows: slice) -> Float[np.ndarray, "rows places"]:
        score = _distances(places[corners[rows]], places) + field
        score[np.arange(len(score)), corners[rows]] = np.inf
        return score

    def sees(row: Int[np.ndarray, "pairs"], place: Int[np.ndarray, "pairs"]) -> Bool[np.ndarray, "pairs"]:
        return workspace.is_visible(places[corners[row]], places[place])

    ways = best_in_sight(lookahead, len(corners), len(places), count, sees)
    row, column = np.nonzero(ways >= 0)
    return _distinct(np.stack([corners[row], ways[row, column]], axis=1))


def _shortened(
    workspace: Workspace,
    places: Float[np.ndarray, "places 2"],
    joints: Int[np.ndarray, "joints 2"],
    length: Float[np.ndarray, "places"],
    onward: Int[np.ndarray, "places"],
) -> tuple[Float[np.ndarray, "places"], Int[np.ndarray, "places"]]:
    """The ways pulled tight: places joined to the place after the next where they see it, as long as some do."""
    while True:
        place = np.flatnonzero(onward > 0)
        pairs = np.stack([place, onward[onward[place]]], axis=1)
        known = len(joints)
        pairs = pairs[workspace.is_visible(places[pairs[:, 0]], places[pairs[:, 1]])]
        joints = _distinct(np.concatenate([joints, pairs]))
        if len(joints) == known:
            return length, onward
        length, onward = dijkstra(Graph(places, joints), 0)


def _first_places(
    workspace: Workspace,
    starts: Float[np.ndarray, "n 2"],
    places: Float[np.ndarray, "places 2"],
    length: Float[np.ndarray, "places"],
) -> Int[np.ndarray, "n"]:
    """The place that each start goes to first, -1 where none from which the goal can be reached is in sight."""
    found = best_in_sight(
        lambda rows: _distances(starts[rows], places) + length,
        len(starts),
        len(places),
        1,
        lambda row, place: workspace.is_visible(starts[row], places[place]),
    )
    return found[:, 0]


def _assemble(
    starts: Float[np.ndarray, "n 2"],
    free: Bool[np.ndarray, "n"],
    first: Int[np.ndarray, "n"],
    places: Float[np.ndarray, "places 2"],
    onward: Int[np.ndarray, "places"],
) -> Descent:
    """The paths that go from each start to its first place and on from there."""
    onward = np.maximum(onward, 0)  # the goal follows itself
    chains = [np.arange(len(places))]
    while (chains[-1][first[first >= 0]] != 0).any():
        chains.append(onward[chains[-1]])
    chain = np.stack(chains, axis=1)[first]
    vertices = np.concatenate([starts[:, None], places[chain]], axis=1)
    counts = 2 + (chain != 0).sum(axis=1) - (starts == places[0]).all(axis=1)
    lengths = np.linalg.norm(np.diff(vertices, axis=1), axis=2).sum(axis=1)
    vertices[first < 0], counts[first < 0], lengths[first < 0] = np.nan, 0, np.inf
    members = np.array([DescentStatus.REACHED, DescentStatus.STUCK, DescentStatus.START_NOT_FREE], dtype=object)
    return Descent(members[np.where(first >= 0, 0, np.where(free, 1, 2))], vertices, counts, lengths)


def _distances(a: Float[np.ndarray, "n 2"], b: Float[np.ndarray, "m 2"]) -> Float[np.ndarray, "n m"]:
    dx, dy = a[:, :1] - b[:, 0], a[:, 1:] - b[:, 1]
    return np.sqrt(dx * dx + dy * dy)


def _distinct(pairs: Int[np.ndarray, "n 2"]) -> Int[np.ndarray, "distinct 2"]:
    """Each pair once, whichever way round it is given."""
    return np.unique(np.sort(pairs, axis=1), axis=0)
