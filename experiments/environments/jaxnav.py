"""JaxNav (package ``jaxmarl``) with rewards shaped by the length of the shortest path, not by a straight line."""

from typing import Any

import jax
import jax.numpy as jnp
from jaxmarl.environments.jaxnav.jaxnav_env import JaxNav  # pyright: ignore[reportMissingImports]

from plr_jax import GridDistance, grid_distance


class ShapedJaxNav:
    """JaxNav whose agents are paid for coming nearer along the shortest path, in cells.

    Added to the reward is ``discount * potential(after) - potential(before)`` (Ng, Harada, Russell, 1999). A state is
    JaxNav's, and the distance to each agent's goal, which is found once a level.

    Args:
        discount: That of the agent that learns.
        weight: What a cell is worth; JaxNav pays as much for a unit of the straight line.
        options: Those of ``JaxNav``.
    """

    def __init__(self, discount: float = 0.99, weight: float = 0.25, **options: Any):
        self.env = JaxNav(weight_g=0.0, **options)
        self.discount, self.weight = discount, weight

    def reset(self, key: jax.Array) -> tuple[Any, tuple[Any, GridDistance]]:
        """Observations and the state of a new level."""
        observations, state = self.env.reset(key)
        return observations, (state, distances(state))

    def step(self, key: jax.Array, state: tuple[Any, GridDistance], actions: Any) -> Any:
        """Observations, state, rewards, dones and infos, as JaxNav's ``step_env``: after the last one, ``reset``."""
        before, fields = state
        observations, after, rewards, dones, infos = self.env.step_env(key, before, actions)
        gain = self.discount * self._potential(fields, after) - self._potential(fields, before)
        gain = jnp.where(before.done | before.move_term, 0, gain)
        rewards = {agent: rewards[agent] + gain[number] for number, agent in enumerate(self.env.agents)}
        return observations, (after, fields), rewards, dones, infos

    def _potential(self, fields: GridDistance, state: Any) -> jax.Array:
        """Of each agent; 0 where its goal is reached, or where it cannot be."""
        distance = jax.vmap(lambda field, x: field(x))(fields, state.pos)
        return jnp.where(jnp.isfinite(distance) & ~state.goal_reached, -self.weight * distance, 0)


def distances(state: Any) -> GridDistance:
    """Those to the goals of all agents, on JaxNav's map: 0 is free, rows are ``y``."""
    return jax.vmap(lambda goal: grid_distance(state.map_data == 0, goal))(state.goal)
