"""Queries of a roadmap by the nearest vertex, as in the paper; those of `Roadmap` take the best visible vertex."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from plr_jax import Roadmap


@dataclass(frozen=True, eq=False)
class NearestVertex:
    """Distance to a roadmap's goal by way of the vertex nearest to each point.

    Attributes:
        roadmap: A roadmap of a point robot.
        sees: Whether only vertices count that the point sees. Without this test, the vertex may be behind a wall.
    """

    roadmap: Roadmap
    sees: bool = True
    tree: KDTree = field(init=False)

    def __post_init__(self):
        object.__setattr__(self, "tree", KDTree(self.roadmap.graph.vertices))

    def connect(self, x: Float[np.ndarray, "n 2"]) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Return each point's vertex and its distance; ``inf`` for points that are not free or see no vertex."""
        vertices = self.roadmap.graph.vertices
        vertex, length = np.zeros(len(x), int), np.full(len(x), np.inf)
        pending = np.flatnonzero(self.roadmap.is_free(x))
        rank = 1
        while len(pending) and rank <= len(vertices):
            some = x[pending]
            apart, nearest = (each[:, 0] for each in self.tree.query(some, k=[rank]))
            found = self.roadmap.is_visible(some, vertices[nearest]) if self.sees else np.full(len(some), True)
            vertex[pending[found]], length[pending[found]] = nearest[found], apart[found]
            pending = pending[~found]
            rank += 1
        return vertex, length

    def __call__(self, x: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
        vertex, length = self.connect(x)
        return length + self.roadmap.distances[vertex]

    @property
    def num_bytes(self) -> int:
        """Bytes of the roadmap."""
        return self.roadmap.num_bytes
