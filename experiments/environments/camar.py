"""CAMAR (package ``camar``) with rewards shaped by the length of the shortest path, not by a straight line."""

from typing import Any

import jax
import jax.numpy as jnp
from camar import camar_v0  # pyright: ignore[reportMissingImports]
from camar.utils import State  # pyright: ignore[reportMissingImports]
from camar.wrappers import GymnaxWrapper  # pyright: ignore[reportMissingImports]
from flax import struct  # pyright: ignore[reportMissingImports]
from jaxtyping import Array, Bool, Float

from plr_jax import GridDistance, grid_distance


@struct.dataclass
class ShapedState(State):
    """CAMAR's state, the distance to each agent's goal, which is found once a level, and each agent's potential."""

    distance: GridDistance
    potential: Float[Array, " agents"]


class ShapedCamar(GymnaxWrapper):
    """CAMAR whose agents are paid for coming nearer along the shortest path; CAMAR's own wrappers go around it.

    Added to the reward is ``discount * potential(after) - potential(before)`` (Ng, Harada, Russell, 1999). Maps are
    those of obstacles in the cells of a grid: ``random_grid``, ``string_grid``, ``labmaze_grid``.

    Args:
        discount: That of the agent that learns.
        weight: What a unit of length is worth: CAMAR's ``pos_shaping_factor``.
        max_corners: As for ``grid_distance``; a level that has more is not shaped.
        options: Those of ``camar_v0``.
    """

    def __init__(self, discount: float = 0.99, weight: float = 1.0, max_corners: int | None = None, **options: Any):
        super().__init__(camar_v0(pos_shaping_factor=0.0, **options))  # pyright: ignore[reportCallIssue]
        self.discount, self.weight, self.max_corners = discount, weight, max_corners
        self.map = self._env.map_generator
        self.side = getattr(self.map, "obstacle_size", 2 * self.map.landmark_rad)

    def reset(self, key: jax.Array) -> tuple[jax.Array, ShapedState]:
        """As CAMAR's."""
        observations, state = self._env.reset(key)
        free = free_cells(self.map, state.landmark_pos, self.side)
        to = jax.vmap(lambda goal: grid_distance(free, goal, max_corners=self.max_corners))
        distance = to(self.in_cells(state.goal_pos))
        return observations, self._with_potential(state, distance)

    def step(self, key: jax.Array, state: ShapedState, actions: jax.Array) -> Any:
        """As CAMAR's."""
        observations, after, reward, done, info = self._env.step(key, state, actions)
        after = self._with_potential(after, state.distance)
        return observations, after, reward + (self.discount * after.potential - state.potential)[:, None], done, info

    def in_cells(self, x: jax.Array) -> jax.Array:
        """Points in the coordinates of the grid."""
        return (x + jnp.array([self.map.width, self.map.height]) / 2) / self.side

    def _with_potential(self, state: Any, distance: GridDistance) -> ShapedState:
        """Of each agent; 0 where its goal is reached, or where it cannot be."""
        cells = self.in_cells(state.physical_state.agent_pos)
        length = self.side * jax.vmap(lambda field, x: field(x))(distance, cells)
        potential = jnp.where(jnp.isfinite(length) & ~state.on_goal, -self.weight * length, 0)
        return ShapedState(**{**vars(state), "distance": distance, "potential": potential})


def free_cells(map_generator: Any, landmarks: Float[Array, "n 2"], side: float) -> Bool[Array, "h w"]:
    """Cells with a side through which agents pass: obstacles are circles, in blocked cells or around them."""
    h, w = round(map_generator.height / side), round(map_generator.width / side)

    def closed(x: Any, y: Any) -> Any:
        points = (jnp.stack(jnp.meshgrid(x, y), axis=-1) - jnp.array([w, h]) / 2) * side
        to_landmarks = jnp.linalg.norm(points[:, :, None] - landmarks, axis=-1)
        return to_landmarks.min(axis=-1) < 1.5 * map_generator.landmark_rad

    upright = closed(jnp.arange(w + 1.0), jnp.arange(h) + 0.5)
    level = closed(jnp.arange(w) + 0.5, jnp.arange(h + 1.0))
    return ~(upright[:, :-1] & upright[:, 1:] & level[:-1] & level[1:])
