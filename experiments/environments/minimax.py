"""minimax's mazes (package ``minimax-lib``) with the length of the shortest path in rewards and in metrics."""

from typing import Any

import jax
import jax.numpy as jnp
from flax import struct  # pyright: ignore[reportMissingImports]
from jaxtyping import Array, Float
from minimax.envs.maze.maze import EnvState, Maze  # pyright: ignore[reportMissingImports]

from plr_jax import GridDistance, grid_distance


@struct.dataclass
class ShapedState(EnvState):
    """minimax's state, and the steps to its goal, which are found once a maze."""

    distance: GridDistance


class ShapedMaze(Maze):
    """minimax's maze whose agent is paid for coming nearer along the shortest path.

    Added to the reward is ``discount * potential(after) - potential(before)`` (Ng, Harada, Russell, 1999). Its
    metrics have the length from our distance too: 0 where no path leads, as minimax says it.

    Args:
        discount: That of the agent that learns.
        weight: What a step is worth.
        options: Those of ``Maze``.
    """

    def __init__(self, discount: float = 0.99, weight: float = 0.01, **options: Any):
        super().__init__(**options)
        self.discount, self.weight = discount, weight

    def reset_env(self, key: jax.Array) -> tuple[Any, ShapedState]:
        """As minimax's."""
        observations, state = super().reset_env(key)
        return observations, _with_distance(state)

    def set_env_instance(self, encoding: Any) -> tuple[Any, ShapedState]:
        """As minimax's."""
        observations, state = super().set_env_instance(encoding)
        return observations, _with_distance(state)

    def step_env(self, key: jax.Array, state: ShapedState, action: Any) -> Any:
        """As minimax's."""
        observations, after, reward, done, info = super().step_env(key, state, action)
        gain = self.discount * jnp.where(done, 0, self._potential(after)) - self._potential(state)
        return observations, after, reward + gain, done, info

    def get_env_metrics(self, state: ShapedState) -> dict[str, jax.Array]:
        """As minimax's."""
        length = _steps(state)
        metrics = {"n_walls": state.wall_map.sum(), "passable": jnp.isfinite(length)}
        return metrics | {"shortest_path_length": jnp.where(metrics["passable"], length, 0).astype(jnp.uint32)}

    def _potential(self, state: ShapedState) -> Float[Array, ""]:
        return jnp.where(jnp.isfinite(_steps(state)), -self.weight * _steps(state), 0)


def _with_distance(state: EnvState) -> ShapedState:
    return ShapedState(**vars(state), distance=grid_distance(~state.wall_map, state.goal_pos + 0.5, moves=4))


def _steps(state: ShapedState) -> Float[Array, ""]:
    return state.distance(state.agent_pos + 0.5)
