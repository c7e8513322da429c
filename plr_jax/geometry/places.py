"""Where a shortest path among polygons can turn, and whether it would be taut there."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax.geometry.boundary import cross
from plr_jax.geometry.workspace import Workspace

_SLACK = 100
"""Tolerances of the workspace by which a taut path may seem slack."""


@dataclass(frozen=True, eq=False)
class Places:
    """The goal, which is place 0, and the corners that stick out into free space.

    Args:
        points: The places, ``(places, 2)``.
        walls: Unit vectors along the two walls of each corner, ``(2, places, 2)``; zero for the goal, and for the
            point contacts of a workspace with ``squeeze``, which may be turned around on any side.
        slack: How far on the wrong side of a line a point may lie.
    """

    points: Float[np.ndarray, "places 2"]
    walls: Float[np.ndarray, "2 places 2"]
    slack: float

    @classmethod
    def of(cls, workspace: Workspace, goal: Float[np.ndarray, "2"]) -> "Places":
        """The places of a workspace; a corner that is the goal is left out."""
        boundary = workspace.boundary
        turns = boundary.is_reflex(1e-3 * workspace.tolerance)
        contacts = boundary.contacts if workspace.squeeze else np.empty(0, int)
        turns |= np.isin(boundary.edges[:, 0], contacts)
        turns &= (boundary.vertices[boundary.edges[:, 0]] != goal).any(axis=1)
        vertex, sector = np.unique(boundary.edges[turns, 0], return_index=True)
        sector = np.flatnonzero(turns)[sector]
        along = (
            boundary.vertices[[boundary.edges[sector, 1], boundary.sector_end[sector]]] - boundary.vertices[vertex]
        )
        along /= np.linalg.norm(along, axis=2, keepdims=True)
        along[:, np.isin(vertex, contacts)] = 0.0
        points = np.concatenate([goal[None], boundary.vertices[vertex]])
        walls = np.concatenate([np.zeros((2, 1, 2)), along], axis=1)
        return cls(points, walls, _SLACK * workspace.tolerance)

    def __len__(self) -> int:
        return len(self.points)

    def distances(self, x: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n places"]:
        """Straight distance of each point to each place."""
        dx, dy = x[:, :1] - self.points[:, 0], x[:, 1:] - self.points[:, 1]
        return np.sqrt(dx * dx + dy * dy)

    def tangent(self, corners: Int[np.ndarray, "corners"]) -> Bool[np.ndarray, "corners places"]:
        """Whether lines from some corners to all places have both walls of either end on one side.

        Any other line cuts off a part of the obstacle at an end, so no shortest path turns there to go along it.
        """
        way = self.points - self.points[corners][:, None]
        tangent = np.ones(way.shape[:2], bool)
        for walls in (self.walls, self.walls[:, corners][:, :, None]):
            first, second = cross(way, walls[0]), cross(way, walls[1])
            tangent &= (np.minimum(first, second) >= -self.slack) | (np.maximum(first, second) <= self.slack)
        return tangent

    def taut(self, onward: Int[np.ndarray, "places"]) -> "TautTurns":
        """The turns of paths that go on from each place to a given other one."""
        way = self.points[onward] - self.points
        length = np.linalg.norm(way, axis=1, keepdims=True)
        way = np.divide(way, length, out=np.zeros_like(way), where=length > 0)
        side = np.sign(cross(way, self.walls.sum(axis=0)))[:, None]
        sided = side * np.stack([*self.walls, way])
        normal = np.stack([sided[..., 1], -sided[..., 0]], axis=-1)
        return TautTurns(normal, (normal * self.points).sum(axis=2) + self.slack)


@dataclass(frozen=True, eq=False)
class TautTurns:
    """From which points a path by way of each place would be taut.

    Seen from there, both walls of the corner and the way on lie to one side, the side on which the way on has the
    walls: the path bends around the obstacle. Any other path can be pulled tight, to go by another place.

    Args:
        normal: Normals of three lines through each place, ``(3, places, 2)``.
        offset: What ``normal @ x`` does not exceed where the path is taut, ``(3, places)``.
    """

    normal: Float[np.ndarray, "3 places 2"]
    offset: Float[np.ndarray, "3 places"]

    def __call__(self, x: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, "n places"]:
        """Whether the path from each point by way of each place is taut."""
        taut = np.ones((len(x), self.normal.shape[1]), bool)
        for normal, offset in zip(self.normal, self.offset, strict=True):
            taut &= x @ normal.T <= offset
        return taut
