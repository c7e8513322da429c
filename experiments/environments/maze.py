"""An agent in random mazes that are drawn inside ``jit``, one an episode; its reward is shaped by a distance."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

SIZE = 13
LIMIT = 128
"""Steps after which an episode is cut short."""
DISCOUNT = 0.99
_VIEW = 4  # cells that an agent sees in each direction
WEIGHT = 0.1  # of a cell of distance; the goal is worth 1
_LONGEST = 8.0  # logarithm of how much longer a way between two rooms may be than another
_ROOMS = SIZE // 2  # a side
_MOVES = jnp.array([[-1, 0], [1, 0], [0, -1], [0, 1]])

Mask = Bool[Array, "size size"]
Distances = Float[Array, "size size"]
Cell = Int[Array, "2"]
"""Row and column."""
Distance = Callable[[Mask, Cell], Distances]
"""Distances of all cells of a maze to a goal."""


class State(NamedTuple):
    """Where an agent is in its maze.

    Attributes:
        free: Which cells are free.
        goal: The cell to reach.
        distance: What shapes the reward, of all cells.
        cell: The agent's.
        move: Its last one, of four; none at first.
        time: Steps taken.
    """

    free: Mask
    goal: Cell
    distance: Distances
    cell: Cell
    move: Float[Array, "4"]
    time: Int[Array, ""]


def maze(chances: Float[Array, "2 rooms rooms"]) -> Mask:
    """Rooms of a cell, one way between any two: the tree of shortest paths to the first, lengths left to chance."""
    down, right = jnp.exp(_LONGEST * chances)
    down, right = down.at[-1].set(jnp.inf), right.at[:, -1].set(jnp.inf)
    lengths = jnp.stack([jnp.roll(down, 1, 0), down, jnp.roll(right, 1, 1), right])

    def through_neighbors(distance):
        rolled = [jnp.roll(distance, by, axis) for axis in (0, 1) for by in (1, -1)]
        return lengths + jnp.stack(rolled)

    is_root = jnp.arange(_ROOMS**2) == 0
    start = jnp.where(is_root, 0, jnp.inf).reshape(_ROOMS, _ROOMS)
    distance = jax.lax.fori_loop(0, _ROOMS**2, lambda _, d: jnp.minimum(start, through_neighbors(d).min(0)), start)
    room = 2 * jnp.indices((_ROOMS, _ROOMS)).reshape(2, -1).T + 1
    door = jnp.where(is_root[:, None], room, room + _MOVES[through_neighbors(distance).argmin(0).reshape(-1)])
    return jnp.zeros((SIZE, SIZE), bool).at[tuple(jnp.concatenate([room, door]).T)].set(True)


def reset(key: Array, distance: Distance) -> State:
    """A new maze, with start and goal in two of its rooms."""
    chances = jax.random.uniform(key, (2 * _ROOMS**2 + 2,))  # one call: each takes a while to compile
    goal = (chances[0] * _ROOMS**2).astype(int)
    start = (goal + 1 + (chances[1] * (_ROOMS**2 - 1)).astype(int)) % _ROOMS**2
    free, goal, start = maze(chances[2:].reshape(2, _ROOMS, _ROOMS)), _cell(goal), _cell(start)
    return State(free, goal, distance(free, goal), start, jnp.zeros(4), jnp.int32(0))


def _cell(room: Int[Array, ""]) -> Cell:
    return 2 * jnp.stack([room // _ROOMS, room % _ROOMS]) + 1


def step(state: State, action: Int[Array, ""]) -> tuple[State, Float[Array, ""], Bool[Array, ""], Bool[Array, ""]]:
    """State after a move, the reward, whether the goal is reached, and whether time is up."""
    ahead = state.cell + _MOVES[action]
    cell = jnp.where(state.free[tuple(ahead)], ahead, state.cell)
    after = state._replace(cell=cell, move=jax.nn.one_hot(action, 4), time=state.time + 1)
    is_there = (cell == state.goal).all()
    reward = is_there + DISCOUNT * potential(after) - potential(state)
    return after, reward, is_there, after.time == LIMIT


def potential(state: State) -> Float[Array, ""]:
    """That of Ng, Harada and Russell (1999): 0 at the goal, which alone ends a maze; a limit of time does not."""
    return -WEIGHT * state.distance[tuple(state.cell)]


def observe(state: State) -> Float[Array, " features"]:
    """Walls around, the vector to the goal, and the last move."""
    seen = 2 * _VIEW + 1
    walls = jax.lax.dynamic_slice(jnp.pad(~state.free, _VIEW, constant_values=True), state.cell, (seen, seen))
    return jnp.concatenate([walls.reshape(-1), (state.goal - state.cell) / SIZE, state.move])
