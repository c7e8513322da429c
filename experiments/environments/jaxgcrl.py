"""Mazes of JaxGCRL (package ``jaxgcrl``): distances between any two positions, and rewards shaped by them.

``maze_distance("u_maze")(obs[:2], obs[-2:])`` takes the place of ``jnp.linalg.norm(obs[:2] - obs[-2:])``.
"""

import jax
import jax.numpy as jnp
import numpy as np
from brax.envs.base import Env, State, Wrapper  # pyright: ignore[reportMissingImports]
from jaxgcrl.envs import ant_maze  # pyright: ignore[reportMissingImports]

from plr_jax import PairPLR, Workspace, construct_pairs


def maze_distance(layout: str, scaling: float = 4.0) -> PairPLR:
    """The distance between two positions of a maze, or batches of them.

    Args:
        layout: As ``maze_layout_name`` of ``AntMaze``, ``HumanoidMaze`` and ``SimpleMaze``.
        scaling: As ``maze_size_scaling``: the side of a cell.
    """
    # Cell [i, j] has its center at x = i, y = j.
    free = np.array([[cell != 1 for cell in row] for row in getattr(ant_maze, layout.upper())]).T
    return construct_pairs(Workspace.from_mask(free, scaling, (-scaling / 2, -scaling / 2), tolerance=0))


class ShapedMaze(Wrapper):
    """A maze whose agent is paid for coming nearer along the shortest path.

    Added to the reward is ``discount * potential(after) - potential(before)`` (Ng, Harada, Russell, 1999).

    Args:
        env: An ``AntMaze``, ``HumanoidMaze`` or ``SimpleMaze``.
        distance: That of :func:`maze_distance`, of its layout and scaling.
        discount: That of the agent that learns.
        weight: What a unit of length is worth.
    """

    def __init__(self, env: Env, distance: PairPLR, discount: float = 0.99, weight: float = 1.0):
        super().__init__(env)
        self.distance, self.discount, self.weight = distance, discount, weight

    def step(self, state: State, action: jax.Array) -> State:
        """As that of the maze."""
        after = self.env.step(state, action)
        gain = self.discount * jnp.where(after.done == 1, 0, self._potential(after)) - self._potential(state)
        return after.replace(reward=after.reward + gain)  # pyright: ignore[reportAttributeAccessIssue]

    def _potential(self, state: State) -> jax.Array:
        q = state.pipeline_state.q  # pyright: ignore[reportOptionalMemberAccess]
        distance = self.distance(q[..., :2], q[..., -2:])
        return jnp.where(jnp.isfinite(distance), -self.weight * distance, 0)
