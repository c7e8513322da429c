"""Exact distances by lists: for each point the corners that a path from it can turn at first."""

from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax import VisibilityGraph
from plr_jax.geometry.corners import CornerVisibility, corner_visibility
from plr_jax.geometry.vectors import turned_left

_POINTS_AT_ONCE = 20_000

Points = Float[np.ndarray, "n 2"]


class CornerLists(NamedTuple):
    """Corners that each point sees, padded, and how far each is, ``inf`` in the padding."""

    corner: Int[np.ndarray, "n most"]
    length: Float[np.ndarray, "n most"]


def corner_lists(corners: CornerVisibility, x: Points, tangent: bool) -> CornerLists:
    """The corners that points see, or only those that a shortest path can turn at.

    Args:
        corners: Corners, and what they see.
        x: Points.
        tangent: Whether to leave out corners both of whose walls the line to the point does not leave on one side.

    Returns:
        Lists as long as the longest, rounded up to a power of two, so that few sizes are compiled.
    """
    points = corners.corners.points
    may = _is_tangent(corners, x) if tangent else np.ones((len(x), len(points)), bool)
    point, corner = np.nonzero(may)
    seen = corners.table.sees(corner, x[point])
    point, corner = point[seen], corner[seen]
    count = np.bincount(point, minlength=len(x))
    place = np.arange(len(point)) - np.repeat(np.cumsum(count) - count, count)
    most = 1 << int(np.ceil(np.log2(max(1, count.max(initial=1)))))
    lists = CornerLists(np.zeros((len(x), most), np.int32), np.full((len(x), most), np.inf))
    lists.corner[point, place] = corner
    lists.length[point, place] = np.linalg.norm(x[point] - points[corner], axis=1)
    return lists


def _is_tangent(visibility: CornerVisibility, x: Points) -> Bool[np.ndarray, "n corners"]:
    """Whether the line from each corner to each point has both walls of the corner on one side."""
    corners, above = visibility.corners, []
    for wall in corners.walls:
        normal = turned_left(wall)
        above.append(x @ normal.T - (normal * corners.points).sum(axis=1))
    return (np.minimum(*above) >= -corners.slack) | (np.maximum(*above) <= corners.slack)


class Fields:
    """Exact distances of the same points from one goal after the other, which lists make cheap.

    Args:
        exact: The exact distance.
        points: Free points.
    """

    def __init__(self, exact: VisibilityGraph, points: Points):
        self.exact, self.points = exact, points

    @cached_property
    def _lists(self) -> list[CornerLists]:
        corners = corner_visibility(self.exact.workspace)
        starts = range(0, len(self.points), _POINTS_AT_ONCE)
        return [corner_lists(corners, self.points[at : at + _POINTS_AT_ONCE], tangent=True) for at in starts]

    def __call__(self, goals: Float[np.ndarray, "goals 2"]) -> Float[np.ndarray, "goals n"]:
        """Distances of all points from each goal."""
        return np.stack([self._from(goal) for goal in goals])

    def _from(self, goal: Float[np.ndarray, "2"]) -> Float[np.ndarray, "n"]:
        oracle = self.exact.with_goal(goal)
        onward = np.append(oracle.distances[1:], np.inf)  # of the corners, of which there may be none
        by_corners = np.concatenate([(onward[i] + length).min(axis=1) for i, length in self._lists])
        seen = oracle._goal_table.sees(np.zeros(len(self.points), int), self.points)
        return np.where(seen, np.linalg.norm(self.points - goal, axis=1), by_corners)
