"""A path as motion in time."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from plr_jax._problem import Problem, as_path, row_times
from plr_jax._types import ArrayLike
from plr_jax.robots.motion import motions_under_way, shorter_turn


@dataclass(frozen=True, eq=False)
class Timeline:
    """Joint configurations and when they are reached.

    Args:
        times: From 0 to the makespan of the path, never falling.
        configurations: ``(steps, robots, dof)``, headings continued beyond pi, so that robots turn the way in
            which headings run.
    """

    times: Float[np.ndarray, "steps"]
    configurations: Float[np.ndarray, "steps robots dof"]

    @property
    def duration(self) -> float:
        """Time that the path takes: its makespan."""
        return float(self.times[-1])

    def at(self, times: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n robots dof"]:
        """Joint configurations at some times, clipped to those of the path."""
        row, after, share = motions_under_way(self.times, times)
        share = share[:, None, None]
        return (1 - share) * self.configurations[row] + share * self.configurations[after]

    def between(self, first: float, last: float) -> Float[np.ndarray, "steps robots dof"]:
        """The path from one time to another: every step in between, and both ends."""
        inner = self.configurations[(self.times > first) & (self.times < last)]
        ends = self.at(np.array([first, last]))
        return np.concatenate([ends[:1], inner, ends[1:]])


def timeline(problem: Problem, path: ArrayLike) -> Timeline:
    """The path in time: each motion takes as long as its largest cost of a robot, so the whole its makespan.

    Steps in which nothing moves are left out.

    Raises:
        ValueError: If the path has a wrong shape or is not finite.
    """
    path = as_path(problem, path)
    broken = np.argwhere(~np.isfinite(path))
    if broken.size:
        raise ValueError(f"A path must be finite, got {path[tuple(broken[0][:2])]} in step {broken[0][0]}.")
    moves = np.diff(path, axis=0)
    if problem.dof == 3:
        turns = np.array([robot.dof == 3 for robot in problem.robots])
        moves[..., 2] = np.where(turns, shorter_turn(path[:-1, :, 2], path[1:, :, 2]), 0.0)
    kept = moves.any(axis=(1, 2))
    continued = path[:1] + np.concatenate([np.zeros_like(path[:1]), np.cumsum(moves, axis=0)])
    continued[..., :2] = path[..., :2]  # without the rounding of sums
    rows = np.append(True, kept)
    return Timeline(row_times(problem, path)[rows], continued[rows])
