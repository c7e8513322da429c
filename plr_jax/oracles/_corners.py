"""The corners at which shortest paths turn, what each sees, and which join: all that no goal changes."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._workspace import Workspace
from plr_jax.oracles._visibility import Viewpoints, VisibilityTable, Walls, visibility_table

_CHUNK = 1 << 20


@dataclass(frozen=True, eq=False)
class Corners:
    """The turning points of shortest paths. Knows no goal.

    Args:
        table: Visibility polygons of the corners.
        opens: Unit vector along the wall with which each corner's sector opens, ``(corners, 2)``; zero for the
            point contacts of a workspace with ``squeeze``, which may be turned around on any side.
        closes: The same for the wall with which it closes.
        edges: Corners that see one another, each pair once, ``(edges, 2)``.
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
    """Reflex corners of free space and, where squeezing is allowed, point contacts; and who sees whom."""
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
    return Corners(table, along[0], along[1], _mutually_visible(table))


def _mutually_visible(table: VisibilityTable) -> Int[np.ndarray, "edges 2"]:
    """Pairs of viewpoints that see one another, each within its own sector, each pair once."""
    c = len(table.points)
    sees: Bool[np.ndarray, "corners corners"] = np.zeros((c, c), dtype=bool)
    step = max(1, _CHUNK // max(1, c))
    for begin in range(0, c, step):
        v = np.arange(begin, min(c, begin + step)).repeat(c)
        x = np.tile(table.points, (len(v) // c, 1))
        sees[begin : begin + step] = table.sees(v, x).reshape(-1, c)
    return np.argwhere(np.triu(sees & sees.T, 1))
