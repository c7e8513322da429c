"""Where a shortest path to one goal can turn first."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from plr_jax.geometry.corners import ReflexCorners
from plr_jax.geometry.first_visible import Sees, first_visible_in_parts
from plr_jax.geometry.vectors import cross_product, distances_between, turned_left


@dataclass(frozen=True, eq=False)
class TurnPoints:
    """The corners at which a shortest path to one goal can turn first, and the points it can come from.

    At such a corner the path bends around the obstacle. With the way onward given, that leaves the points
    between the straight continuation and the far wall of the corner: those in front of two lines through it. Any
    other path can be pulled tight, to turn elsewhere.

    Args:
        vertex: Their indices, where the goal is vertex 0, ``(turns,)``.
        points: The corners, ``(turns, 2)``.
        distance: Their distances to the goal, ``(turns,)``.
        normal: Normals of the lines through them, ``(2, turns, 2)``; zero where any point will do.
        slack: How far behind the lines a point may lie.
    """

    vertex: Int[np.ndarray, "turns"]
    points: Float[np.ndarray, "turns 2"]
    distance: Float[np.ndarray, "turns"]
    normal: Float[np.ndarray, "2 turns 2"]
    slack: float

    @property
    def num_bytes(self) -> int:
        """Bytes of the arrays."""
        return sum(a.nbytes for a in (self.vertex, self.points, self.distance, self.normal))

    def path_lengths(self, x: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n turns"]:
        """Length of the path by way of each corner; NaN if it would not bend around the corner."""
        length = distances_between(x, self.points)
        length += self.distance
        for normal in self.normal:
            height = x @ normal.T
            length[height < (self.points * normal).sum(axis=1) - self.slack] = np.nan
        return length

    def first_visible(
        self, x: Float[np.ndarray, "n 2"], sees: Sees
    ) -> tuple[Int[np.ndarray, "n"], Float[np.ndarray, "n"]]:
        """The vertex that the shortest path from each point goes to first, -1 where it sees none, and its length."""
        way, length = first_visible_in_parts(
            lambda rows: self.path_lengths(x[rows]),
            len(x),
            len(self.vertex),
            lambda point, way: sees(point, self.vertex[way]),
        )
        return np.append(self.vertex, -1)[way[:, 0]], length[:, 0]


def find_turn_points(
    vertices: ReflexCorners, distances: Float[np.ndarray, "vertices"], parents: Int[np.ndarray, "vertices"]
) -> TurnPoints:
    """The corners that bend a shortest path to the goal, with the points that come around them.

    The goal is vertex 0; the parent of a vertex is the next one on the way there.
    """
    vertex = 1 + np.flatnonzero(np.isfinite(distances[1:]))
    points, (opens, closes) = vertices.points[vertex], vertices.walls[:, vertex]
    onward = vertices.points[parents[vertex]] - points
    norm = np.linalg.norm(onward, axis=1, keepdims=True)
    onward = np.divide(onward, norm, out=np.zeros_like(onward), where=norm > 0)
    onward[(opens == 0).all(axis=1)] = 0.0
    # The obstacle fills the corner from the closing wall counterclockwise to the opening one. If it is to
    # the left of the way onward, the path comes around the opening wall, else around the closing one.
    on_left = cross_product(onward, opens + closes) > 0
    side = np.where(on_left, 1.0, -1.0)[:, None]
    wall = np.where(on_left[:, None], opens, closes)
    normal = np.stack([side * turned_left(onward), side * turned_left(wall)])
    straight_on_is_blocked = (normal[0] * wall).sum(axis=1) < -1e-9
    useful = np.flatnonzero(~straight_on_is_blocked)
    vertex = vertex[useful]
    return TurnPoints(vertex, points[useful], distances[vertex], normal[:, useful], vertices.slack)
