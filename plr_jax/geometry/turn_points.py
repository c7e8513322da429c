"""Where a shortest path to one goal can turn first."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from plr_jax.geometry.boundary import cross, turned_left
from plr_jax.geometry.corners import Corners
from plr_jax.geometry.graph import Graph


@dataclass(frozen=True, eq=False)
class Turns:
    """The corners at which a shortest path to one goal can turn first, and the points it can come from.

    At such a corner the path bends around the obstacle. With the way onward given, that leaves the points
    between the straight continuation and the far wall of the corner: those in front of two lines through it.

    Args:
        corner: Indices of the corners, ``(turns,)``.
        points: The corners, ``(turns, 2)``.
        distance: Their distances to the goal, ``(turns,)``.
        normal: Normals of the lines through them, ``(2, turns, 2)``; zero where any point will do.
        slack: How far behind the lines a point may lie.
    """

    corner: Int[np.ndarray, "turns"]
    points: Float[np.ndarray, "turns 2"]
    distance: Float[np.ndarray, "turns"]
    normal: Float[np.ndarray, "2 turns 2"]
    slack: float

    @property
    def num_bytes(self) -> int:
        """Bytes of the arrays."""
        return sum(a.nbytes for a in (self.corner, self.points, self.distance, self.normal))

    def path_lengths(self, x: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n turns"]:
        """Length of the path by way of each corner; NaN if it would not bend around the corner."""
        length = np.square(x[:, :1] - self.points[:, 0])
        length += np.square(x[:, 1:] - self.points[:, 1])
        np.sqrt(length, out=length)
        length += self.distance
        for normal in self.normal:
            height = x @ normal.T
            length[height < (self.points * normal).sum(axis=1) - self.slack] = np.nan
        return length


def find_turns(
    corners: Corners, graph: Graph, distances: Float[np.ndarray, "vertices"], parents: Int[np.ndarray, "vertices"]
) -> Turns:
    """The corners that bend a shortest path to the goal, with the points that come around them.

    Args:
        corners: The corners.
        graph: The goal as vertex 0, then the corners.
        distances: Distance of each vertex to the goal.
        parents: The next vertex on the way there.
    """
    reached = np.flatnonzero(np.isfinite(distances[1:]))
    points, opens, closes = corners.points[reached], corners.opens[reached], corners.closes[reached]
    onward = graph.vertices[parents[1 + reached]] - points
    norm = np.linalg.norm(onward, axis=1, keepdims=True)
    onward = np.divide(onward, norm, out=np.zeros_like(onward), where=norm > 0)
    onward[(opens == 0).all(axis=1)] = 0.0
    # The obstacle fills the corner from the closing wall counterclockwise to the opening one. If it is to
    # the left of the way onward, the path comes around the opening wall, else around the closing one.
    on_left = cross(onward, opens + closes) > 0
    side = np.where(on_left, 1.0, -1.0)[:, None]
    wall = np.where(on_left[:, None], opens, closes)
    normal = np.stack([side * turned_left(onward), side * turned_left(wall)])
    straight_on_is_blocked = (normal[0] * wall).sum(axis=1) < -1e-9
    useful = np.flatnonzero(~straight_on_is_blocked)
    slack = 100 * corners.table.walls.tolerance
    distance = distances[1 + reached[useful]]
    return Turns(reached[useful], points[useful], distance, normal[:, useful], slack)
