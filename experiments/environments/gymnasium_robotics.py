"""Mazes of Gymnasium-Robotics (package ``gymnasium-robotics``), point and ant, with rewards that know the way.

``maze_distance(env)(observation["achieved_goal"], observation["desired_goal"])`` is what an agent still has to go.
"""

from typing import Any

import gymnasium  # pyright: ignore[reportMissingImports]
import gymnasium_robotics  # pyright: ignore[reportMissingImports]
import numpy as np

from plr_jax import PairPLR, Workspace, construct_pairs

gymnasium.register_envs(gymnasium_robotics)


def maze_distance(env: gymnasium.Env) -> PairPLR:
    """The distance between two positions of a maze, or batches of them.

    Args:
        env: Such as ``gymnasium.make("PointMaze_UMaze-v3")``.
    """
    maze = env.unwrapped.maze  # pyright: ignore[reportAttributeAccessIssue]
    free = np.array([[cell != 1 for cell in row] for row in maze.maze_map])
    corner = -maze.x_map_center, -maze.y_map_center
    return construct_pairs(Workspace.from_mask(free, maze.maze_size_scaling, corner, row0="top", tolerance=0))


class ShapedMaze(gymnasium.Wrapper):
    """A maze whose agent is paid for coming nearer along the shortest path.

    Added to the reward is ``discount * potential(after) - potential(before)`` (Ng, Harada, Russell, 1999); potentials
    are of the goal that the step is rewarded for, also where it moves afterwards.

    Args:
        env: With ``reward_type="sparse"``: the dense one is that of a straight line.
        discount: That of the agent that learns.
        weight: What a unit of length is worth.
    """

    def __init__(self, env: gymnasium.Env, discount: float = 0.99, weight: float = 1.0):
        super().__init__(env)
        self.discount, self.weight, self.distance = discount, weight, maze_distance(env)

    def reset(self, **options: Any) -> Any:
        """As that of the maze."""
        observation, info = self.env.reset(**options)
        self.x = observation["achieved_goal"]
        return observation, info

    def step(self, action: Any) -> Any:
        """As that of the maze."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        both = np.stack([self.x, observation["achieved_goal"]])
        distances = np.asarray(self.distance(both, observation["desired_goal"]))
        before, after = np.where(np.isfinite(distances), -self.weight * distances, 0.0)
        self.x = observation["achieved_goal"]
        gain = self.discount * (0.0 if terminated else after) - before
        return observation, float(reward + gain), terminated, truncated, info
