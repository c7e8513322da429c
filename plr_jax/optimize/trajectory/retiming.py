"""Paths of as many rows as wanted, and the same motions at other times."""

import numpy as np
from jaxtyping import Float

from plr_jax._arrays import runs
from plr_jax._problem import Problem, motion_costs
from plr_jax.robots.motion import between, shorter_turn

Path = Float[np.ndarray, "rows robots dof"]

_SHORTEST = 0.3  # share of the path's time in which a robot makes all its motions, at the shortest


def subdivided(problem: Problem, path: Float[np.ndarray, "steps robots dof"], rows: int) -> Path:
    """The same path of as many rows as wanted, at least 2 and its own: its costliest motions are divided evenly."""
    path = path if len(path) > 1 else np.repeat(path, 2, axis=0)
    cost = motion_costs(problem, path[:-1], path[1:]).sum(axis=1)
    count = np.ones(len(cost), dtype=np.intp)
    for _ in range(rows - len(path)):
        count[np.argmax(cost / count)] += 1
    motion, step = runs(count)
    share = (step / count[motion])[:, None, None]
    return np.concatenate([between(path[motion], path[motion + 1], share), path[-1:]])


def retimed(path: Path, rng: np.random.Generator) -> Path:
    """The same motions of each robot, begun and ended at random times, in as many rows; robots may collide."""
    whole, last = unwrapped(path), len(path) - 1
    result = np.empty_like(path)
    for i in range(path.shape[1]):
        duration = rng.uniform(_SHORTEST, 1.0)
        begin = rng.uniform(0.0, 1.0 - duration)
        when = np.clip((np.linspace(0.0, 1.0, last + 1) - begin) / duration, 0.0, 1.0) * last
        row = np.minimum(when.astype(np.intp), last - 1)
        share = (when - row)[:, None]
        result[:, i] = (1 - share) * whole[row, i] + share * whole[row + 1, i]
    result[0], result[-1] = path[0], path[-1]
    return result


def unwrapped(path: Path) -> Path:
    """The path with headings that do not jump by whole turns."""
    change = np.diff(path, axis=0, prepend=path[:1])
    change[1:, :, 2:] = shorter_turn(path[:-1, :, 2:], path[1:, :, 2:])
    return path[:1] + np.cumsum(change, axis=0)
