"""Helpers for tests of traced grids: levels of one shape, answered by one compiled function per ``moves``."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
from grid_helpers import drawn

from plr_jax import grid_distance

SHAPE, LEVELS, POINTS = (4, 9), 25, 40  # few rows, for each of which code is compiled
ROOM = drawn("....#....", ".##.#....", ".#..##...", "...#..#..")  # right of column 4 nothing leads to the center
CENTER = [2.5, 2.6]
SNAKE = drawn("..#...#..", "..#.#.#..", "..#.#.#..", "....#....")
NOWHERE = [[-0.1, 3], [3, 4.01], [1.5, 1.5], [5.5, 0.5], [np.inf, 1], [1, -np.inf], [1e30, 1]]
SOMEWHERE = [[0, 0], [0, 4], [1, 2.5], CENTER]
NOT_NUMBERS = [[np.nan, 1], [1, np.nan]]
BAD_GOALS = [[1.5, 1.5], [9.5, 9.0], [np.inf, 0], [-1e30, 1], [np.nan, 1]]


def random_levels(seed, levels=LEVELS, shape=SHAPE):
    """Return maps of four densities, and goals at centers, on sides and corners of a free cell, or inside it."""
    rng = np.random.default_rng(seed)
    free = rng.random((levels, *shape)) > rng.choice([0.1, 0.25, 0.4, 0.6], (levels, 1, 1))
    free[:, 3, 3] |= ~free.any(axis=(1, 2))
    cells = np.stack([rng.permutation(np.argwhere(each))[0] for each in free])
    offsets = rng.choice([0.0, 0.5, 1.0, -1.0], (levels, 2))
    return free, cells[:, ::-1] + np.where(offsets < 0, rng.random((levels, 2)), offsets)


def random_points(seed, levels=LEVELS, shape=SHAPE):
    """Return points of a grid, a third of them at centers, middles of sides and corners of cells."""
    rng = np.random.default_rng(seed)
    points = rng.uniform((0, 0), shape[::-1], (levels, POINTS, 2))
    return np.where(rng.random((levels, POINTS, 1)) < 1 / 3, np.round(2 * points) / 2, points)


def all_levels():
    """Return maps, goals and points: of random levels, of a block, of a snake, of a room with bad goals."""
    free, goals = random_levels(2)
    block = np.ones(SHAPE, bool)
    block[1:3, 2:4] = False
    at_block, in_snake = [(2, 3), (2, 1), (4, 1), (5, 2.5)], [(8.5, 0.6), (7.5, 2.5), (3.5, 1.4)]
    in_room = NOWHERE + SOMEWHERE + NOT_NUMBERS
    rooms = 1 + len(BAD_GOALS)
    others = [np.resize(points, (POINTS, 2)) for points in (at_block, in_snake, *[in_room] * rooms)]
    return (
        np.concatenate([free, [block, SNAKE], [ROOM] * rooms]),
        np.concatenate([goals, [(1, 3.5), (0.5, 0.6), CENTER], BAD_GOALS]).astype(np.float32),
        np.concatenate([random_points(3), others]).astype(np.float32),
    )


@cache
def answers(moves):
    """Return the fields of all levels, their cells, and distances: by fields, and by pairs in both directions.

    The last result are gradients of distances by fields, with respect to points and (their sum) to the goal.
    """

    def of_level(free, goal, x):
        def to_goal(x, goal):
            field = grid_distance(free, goal, moves=moves)
            return field(x).sum(), (field, field.cells, field(x))

        (_, (field, cells, distances)), gradients = jax.value_and_grad(to_goal, (0, 1), has_aux=True)(x, goal)
        goals, pairs = jnp.broadcast_to(goal, x.shape), grid_distance(free, None, moves=moves)
        between = pairs(jnp.stack([x, goals]), jnp.stack([goals, x]))
        return field, cells, jnp.vstack([distances[None], between]), gradients

    return jax.jit(jax.vmap(of_level))(*all_levels())
