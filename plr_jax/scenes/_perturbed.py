"""Variants of a problem, to see how much a result owes to the starts and goals of one."""

from contextlib import suppress

import numpy as np

from plr_jax._arrays import as_finite, require_integer
from plr_jax._problem import Problem

_ATTEMPTS = 1000


def perturbed(problem: Problem, seed: int, distance: float | int = 0.1) -> Problem:
    """The problem with its starts and goals moved a little, all still free.

    Args:
        problem: The problem.
        seed: Seed of the generator; the same seed gives the same variant.
        distance: How far a start or goal moves at most, in workspace units. A heading turns by as
            much as takes the robot's farthest corner that far.

    Returns:
        A problem that differs in its starts and goals alone.

    Raises:
        ValueError: If the distance is not positive and finite, the seed no integer of at least 0, or no variant is
            found that is free.
    """
    as_finite("distance", distance, positive=True)
    require_integer("seed", seed, 0)
    rng = np.random.default_rng(seed)
    for i in range(len(problem.robots)):
        for end in range(2):
            problem = _moved(problem, end, i, rng, distance)
    return problem


def _moved(problem: Problem, end: int, i: int, rng: np.random.Generator, distance: float | int) -> Problem:
    """The problem with a robot's start or goal moved to a free configuration near it."""
    for _ in range(_ATTEMPTS):
        ends = np.stack([problem.starts, problem.goals])
        angle, radius = rng.uniform(0, 2 * np.pi), distance * np.sqrt(rng.uniform())
        ends[end, i, :2] += radius * np.array([np.cos(angle), np.sin(angle)])
        if problem.robots[i].dof == 3:
            ends[end, i, 2] += rng.uniform(-1, 1) * distance / problem.robots[i].circumscribed_radius
        with suppress(ValueError):
            return Problem(problem.workspace, problem.robots, ends[0], ends[1], problem.rotation_weight)
    raise ValueError(f"Robot {i} found no other free {('start', 'goal')[end]} within {distance:g}.")
