"""Environments of other packages, where they are installed."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from grid_helpers import dijkstra

from plr_jax import grid_distance

pytest.importorskip("jaxmarl", reason="pip install '.[environments]'")
jaxnav = pytest.importorskip("experiments.environments.jaxnav")


def test_rewards_of_jaxnav_are_those_of_the_way_around():
    shaped = jaxnav.ShapedJaxNav(num_agents=2, discount=1.0, weight=1.0)
    unshaped = jaxnav.JaxNav(num_agents=2, weight_g=0.0)
    _, state = jax.jit(shaped.reset)(jax.random.key(0))
    actions = {agent: jnp.array([1.0, 0.1]) for agent in shaped.env.agents}
    _, (after, _), rewards, _, _ = jax.jit(shaped.step)(jax.random.key(1), state, actions)
    *_, without, _, _ = unshaped.step_env(jax.random.key(1), state[0], actions)
    for number, agent in enumerate(shaped.env.agents):
        field = grid_distance(np.asarray(after.map_data) == 0, after.goal[number])
        nearer = field(state[0].pos[number]) - field(after.pos[number])
        assert rewards[agent] - without[agent] == pytest.approx(float(nearer), abs=1e-5)


def test_where_a_map_is_wider_than_high_its_path_length_is_another():
    """``dikstra_path`` of JaxNav numbers cells ``x * w + y``, of which there are fewer than that if ``w > h``."""
    from jaxmarl.environments.jaxnav.maps.grid_map import GridMapCircleAgents

    for h, w in ((12, 12), (5, 12)):
        free = np.zeros((h, w), bool)
        free[1:-1, 1:-1] = True
        start, end = np.array([1.5, 1.5]), np.array([w - 1.5, h - 1.5])
        theirs = GridMapCircleAgents.dikstra_path(None, jnp.asarray(~free, int), start, end)
        truth = dijkstra(free, (1, 1), 4)[h - 2, w - 2]
        assert grid_distance(free, end, moves=4)(start) == truth
        assert (float(theirs[1]) == truth) == (w <= h)
