"""Scenes for large teams of discs: two halls with one door between them, and a crowd in the open."""

import math

import numpy as np
from jaxtyping import Float

from plr_jax._arrays import require_integer
from plr_jax._problem import Problem
from plr_jax.geometry.workspace import Workspace
from plr_jax.robots.disc import DiscRobot

_RADIUS = 0.4
_MOST_AT_A_DOOR = 50
_WALLS = (
    ((10.0, 0.0), (11.0, 0.0), (11.0, 9.4), (10.0, 9.4)),
    ((10.0, 10.6), (11.0, 10.6), (11.0, 20.0), (10.0, 20.0)),
)
_COVERED, _CLEAR = 0.15, 0.05
_MOST_TRIALS = 1_000_000


def door(num_robots: int) -> Problem:
    """Discs in two halls, 10 x 20 each, that change halls by way of one door, 1.5 diameters wide.

    Half of them start in each hall, on points (1 + 1.7 i, 2 + 3.9 j) and their mirror images, row by row. Each goes
    to the mirror image of its start: two change places.

    Args:
        num_robots: An even number from 2 to 50; the first half starts to the left of the door.

    Returns:
        The problem: discs of radius 0.4.

    Raises:
        ValueError: For another number of robots.
    """
    require_integer("num_robots", num_robots, 2)
    if num_robots % 2 or num_robots > _MOST_AT_A_DOOR:
        raise ValueError(f"num_robots must be an even number from 2 to 50, got {num_robots!r}.")
    row, column = np.divmod(np.arange(num_robots // 2), 5)
    left = np.stack([1 + 1.7 * column, 2 + 3.9 * row], axis=1)
    right = left * (-1, 1) + (21, 0)
    workspace = Workspace(((0, 0), (21, 20)), _WALLS)
    starts, goals = np.concatenate([left, right]), np.concatenate([right, left])
    return Problem(workspace, [DiscRobot(_RADIUS)] * num_robots, starts, goals)


def crowd(num_robots: int, seed: int = 0) -> Problem:
    """Discs that cover 15 % of an open square, at random places and bound for others.

    Args:
        num_robots: At least 1.
        seed: Of the random places. Starts keep 0.05 clear of the walls and of one another, and so do goals.

    Returns:
        The problem: discs of radius 0.4.

    Raises:
        ValueError: If there is no robot, the seed is no integer of at least 0, or no places are found.
    """
    require_integer("num_robots", num_robots, 1)
    require_integer("seed", seed, 0)
    side = math.sqrt(num_robots * math.pi * _RADIUS**2 / _COVERED)
    rng = np.random.default_rng(seed)
    starts, goals = (_scattered(num_robots, side, rng) for _ in range(2))
    return Problem(Workspace(((0, 0), (side, side)), []), [DiscRobot(_RADIUS)] * num_robots, starts, goals)


def _scattered(num_robots: int, side: float, rng: np.random.Generator) -> Float[np.ndarray, "robots 2"]:
    """Places in a square, one after the other, each uniform among those clear of the walls and of those before."""
    places, margin = np.empty((num_robots, 2)), _RADIUS + _CLEAR
    placed = 0
    for _ in range(_MOST_TRIALS):
        place = rng.uniform(margin, side - margin, 2)
        if (np.hypot(*(places[:placed] - place).T) >= 2 * _RADIUS + _CLEAR).all():
            places[placed] = place
            placed += 1
            if placed == num_robots:
                return places
    raise ValueError(f"Found no places for {num_robots} robots; try another seed.")
