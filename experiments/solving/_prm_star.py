"""PRM* in any configuration space, with the space's own cost of motions."""

import time
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from experiments.solving._counted import counted
from plr_jax import ConfigurationSpace, Roadmap
from plr_jax.geometry.graph import Graph, dijkstra

_BYTES_A_FLOAT = 4


class SampledCosts(NamedTuple):
    """Cost-to-go of the samples of a roadmap, and what it took."""

    vertices: Float[np.ndarray, "v dof"]
    costs: Float[np.ndarray, "v"]
    roadmap: Roadmap
    seconds: float
    tests: dict[str, Any]

    @property
    def num_bytes(self) -> int:
        """Of what answers for this goal: coordinates and costs of the vertices, in float32."""
        return _BYTES_A_FLOAT * (self.vertices.size + self.costs.size)


def prm_star(space: ConfigurationSpace, goal: Float[np.ndarray, "dof"], num_samples: int, seed: int) -> SampledCosts:
    """A roadmap of a space, its samples' costs those of the space, which need not be Euclidean lengths."""
    asked = counted(space)
    scale = space.motion_cost.scale
    began = time.perf_counter()
    roadmap = Roadmap(
        space.domain, asked.is_free, goal, num_samples, seed=seed, is_visible=asked.are_free, weights=scale
    )
    costs = roadmap.distances
    if len(space.motion_cost.blocks) > 1:
        measure = partial(space.motion_cost.lengths, domain=space.domain)
        costs, _ = dijkstra(Graph(roadmap.graph.vertices, roadmap.graph.edges, measure), 0)
    seconds = time.perf_counter() - began
    return SampledCosts(roadmap.graph.vertices, costs, roadmap, seconds, asked.tests.for_json())
