"""Mazes of OGBench (package ``ogbench``), and the distance between any two positions, to evaluate and to shape.

``maze_distance(env)(env.unwrapped.get_xy(), env.unwrapped.cur_goal_xy)`` is what an agent still has to go.
"""

from typing import Any

import gymnasium  # pyright: ignore[reportMissingImports]
import numpy as np
import ogbench  # noqa: F401  # pyright: ignore[reportMissingImports]

from plr_jax import PairPLR, Workspace, construct_pairs


def maze_distance(env: gymnasium.Env) -> PairPLR:
    """The distance between two positions of a maze, or batches of them; teleports are left out.

    Args:
        env: Such as ``gymnasium.make("antmaze-large-v0")``.
    """
    maze: Any = env.unwrapped
    unit = maze._maze_unit
    corner = np.array(maze.ij_to_xy((0, 0))) - unit / 2
    return construct_pairs(Workspace.from_mask(maze.maze_map == 0, unit, corner, tolerance=0))


class WithDistance(gymnasium.Wrapper):
    """An environment of OGBench that tells after each step, in ``info``, the distance to the goal of its task."""

    def __init__(self, env: gymnasium.Env):
        super().__init__(env)
        self.distance = maze_distance(env)

    def step(self, action: Any) -> Any:
        """As that of the environment."""
        *others, info = self.env.step(action)
        maze: Any = self.unwrapped
        return *others, info | {"distance": float(self.distance(maze.get_xy(), np.array(maze.cur_goal_xy)))}
