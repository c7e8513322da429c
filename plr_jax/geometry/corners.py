"""The corners at which shortest paths turn, what each sees, and which join: all that no goal changes."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax.geometry.boundary import turned_left
from plr_jax.geometry.visibility import Viewpoints, VisibilityTable, Walls, visibility_table
from plr_jax.geometry.workspace import Workspace

_CHUNK = 1 << 20


@dataclass(frozen=True, eq=False)
class Corners:
    """The turning points of shortest paths. Knows no goal.

    Args:
        table: Visibility polygons of the corners.
        opens: Unit vector along the wall with which each corner's sector opens, ``(corners, 2)``; zero for the
            point contacts of a workspace with ``squeeze``, which may be turned around on any side.
        closes: The same for the wall with which it closes.
        edges: Corners that see one another, each pair once, ``(edges, 2)``. Left out are those whose line cuts
            off a part of the obstacle at both: a shortest path bends around neither, so it goes on at neither.
    """

    table: VisibilityTable
    opens: Float[np.ndarray, "corners 2"]
    closes: Float[np.ndarray, "corners 2"]
    edges: Int[np.ndarray, "edges 2"]

    @property
    def points(self) -> Float[np.ndarray, "corners 2"]:
        """Positions of the corners."""
        return self.table.points

    @property
    def num_bytes(self) -> int:
        """Bytes of the corners, their visibility polygons and edges, and of the walls they look at."""
        walls = self.table.walls
        arrays = (self.opens, self.closes, self.edges, walls.normal, walls.offset)
        return self.table.num_bytes + sum(a.nbytes for a in arrays)


def find_corners(workspace: Workspace) -> Corners:
    """Reflex corners of free space and, where squeezing is allowed, point contacts; and which to join."""
    boundary, walls = workspace.boundary, Walls.of(workspace.boundary, workspace.tolerance)
    turns = boundary.is_reflex(1e-3 * workspace.tolerance)
    contacts = boundary.contacts if workspace.squeeze else np.empty(0, int)
    turns |= np.isin(boundary.edges[:, 0], contacts)
    sector = np.flatnonzero(turns)
    vertex, owner = np.unique(boundary.edges[sector, 0], return_inverse=True)
    opens, closes = boundary.edges[sector, 1], boundary.sector_end[sector]
    points = boundary.vertices[vertex]
    table = visibility_table(walls, Viewpoints(points, owner, opens, closes))
    along = [np.zeros_like(points), np.zeros_like(points)]
    for direction, towards in zip(along, (opens, closes), strict=True):
        offset = boundary.vertices[towards] - points[owner]
        direction[owner] = offset / np.linalg.norm(offset, axis=1, keepdims=True)
        direction[np.isin(vertex, contacts)] = 0.0
    return Corners(table, along[0], along[1], _tangent_edges(table, along[0], along[1]))


def _tangent_edges(
    table: VisibilityTable, opens: Float[np.ndarray, "corners 2"], closes: Float[np.ndarray, "corners 2"]
) -> Int[np.ndarray, "edges 2"]:
    """Pairs of corners that see one another and whose line is tangent to the obstacle at one of them, each once."""
    points, slack = table.points, 100 * table.walls.tolerance
    step = max(1, _CHUNK // max(1, len(points)))
    edges = [np.empty((0, 2), int)]
    for begin in range(0, len(points), step):
        part = slice(begin, begin + step)
        tangent = _is_tangent(points[part], opens[part], closes[part], points, slack)
        tangent |= _is_tangent(points, opens, closes, points[part], slack).T
        v, w = np.nonzero(np.triu(tangent, 1 + begin))
        v += begin
        for corner, other in ((0, 1), (1, 0)):
            ends = (v, w)
            seen = table.sees(ends[corner], points[ends[other]])
            v, w = v[seen], w[seen]
        edges.append(np.stack([v, w], axis=1))
    return np.concatenate(edges)


def _is_tangent(
    points: Float[np.ndarray, "corners 2"],
    opens: Float[np.ndarray, "corners 2"],
    closes: Float[np.ndarray, "corners 2"],
    x: Float[np.ndarray, "n 2"],
    slack: float,
) -> Bool[np.ndarray, "corners n"]:
    """Whether the line from each corner to each point has both of the corner's walls on one side."""
    above = []
    for wall in (opens, closes):
        normal = turned_left(wall)
        above.append(normal @ x.T - (normal * points).sum(axis=1)[:, None])
    return ~((np.minimum(*above) < -slack) & (np.maximum(*above) > slack))
