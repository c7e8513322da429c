"""What every rival of a file of all pairs is given, and the pairs that it is judged by."""

import csv
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from experiments.benchmarks._maps import load_map
from plr_jax import VisibilityGraph, Workspace

Points = Float[np.ndarray, "n 2"]


_CHUNK = 4_096  # pairs at a time: temporaries stay in the cache


class Summary(Protocol):
    """Something that tells the distance of any two points of a map."""

    @property
    def num_bytes(self) -> int:
        """Bytes of what has to be stored or sent."""
        ...

    def __call__(self, x: Any, y: Any, /) -> Any:
        """Distances, ``(n,)``, of points ``x`` from points ``y``, ``(n, 2)`` each."""
        ...


Candidates = Iterator[tuple[str, Summary]]
"""Settings, as text, and what they make."""


class Pairs(NamedTuple):
    """Pairs of points and their exact distances."""

    x: Points
    y: Points
    distance: Float[np.ndarray, " n"]

    def first(self, count: int) -> "Pairs":
        """So many of them."""
        return Pairs(*(column[:count] for column in self))


@dataclass(frozen=True)
class Given:
    """What every rival is given.

    Args:
        exact: The exact distance, of whatever goal, to be asked as often as a rival likes.
        max_bytes: Bytes that a summary may have.
        training: Exact distances of pairs, for rivals that learn from examples.
        seed: Seed of everything random.
        smoke: Whether anything will do that runs.
    """

    exact: VisibilityGraph
    max_bytes: int
    training: Pairs
    seed: int
    smoke: bool

    @property
    def workspace(self) -> Workspace:
        """The map."""
        return self.exact.workspace

    def fields(self, goals: Points, points: Points) -> Float[np.ndarray, "goals n"]:
        """Exact distances of all points from each goal."""
        return np.stack([self.exact.with_goal(goal)(points) for goal in goals])


@dataclass(frozen=True, eq=False)
class CompiledSummary:
    """A summary whose answers JAX compiles."""

    num_bytes: int
    answer: Callable[[Any, Any], Float[Array, " n"]]

    def __call__(self, x: Any, y: Any) -> Float[Array, " n"]:
        """Distances of pairs, in single precision."""
        return self.answer(jnp.asarray(x, jnp.float32), jnp.asarray(y, jnp.float32))


def compiled(num_bytes: int, of_pair: Callable[[Array, Array], Array]) -> CompiledSummary:
    """A summary from a function of one pair of points, ``(2,)`` each."""
    return CompiledSummary(
        num_bytes, jax.jit(lambda x, y: jax.lax.map(lambda pair: of_pair(*pair), (x, y), batch_size=_CHUNK))
    )


def straight(x: Float[Array, "2"], y: Float[Array, "2"]) -> Float[Array, ""]:
    """The straight line, which no path is shorter than; its slope is zero where the two are one."""
    return jnp.sqrt(jnp.maximum(((x - y) ** 2).sum(), 1e-30))


# Pairs of points of a map, and their exact distances; and the published ones of the arena.
#
# For the test, each of 5,000 goals has 200 points of its own: goals and points are independent and uniform in free
# space, no point is in two pairs but the goals, and the pairs come in random order. The exact oracle of each goal
# tells the distances. Other goals and points, likewise drawn, are for training and for the choice of settings.

_SMOKE_GOALS, _SMOKE_POINTS = 20, 50
_COUNTS = {"training": (5_000, 200), "choice": (2_000, 10), "test": (5_000, 200)}  # goals, and points of each
_PUBLISHED = "polyanya_arena/arena_euclid.csv"
_SEEDS = {"training": 10_000, "choice": 20_000, "test": 30_000}


@cache
def exact_of(name: str) -> VisibilityGraph | None:
    """The exact oracle of a map; None where its data are absent."""
    found = load_map(name)
    return None if found is None else VisibilityGraph(*found)


@cache
def pairs_of(name: str, use: str, seed: int, smoke: bool) -> Pairs:
    """Pairs of a map for training, for the choice of settings, or for the test."""
    goals, points = (_SMOKE_GOALS, _SMOKE_POINTS) if smoke else _COUNTS[use]
    exact = exact_of(name)
    assert exact is not None
    return draw_pairs(exact, goals, points, _SEEDS[use] + seed)


def draw_pairs(exact: VisibilityGraph, goals: int, points: int, seed: int) -> Pairs:
    """Random free pairs, some path between which there is."""
    first, second, order = (int(s) for s in np.random.SeedSequence(seed).generate_state(3))
    y = exact.workspace.sample_free(goals, first)
    x = exact.workspace.sample_free(goals * points, second).reshape(goals, points, 2)
    distance = np.stack([exact.with_goal(goal)(own) for goal, own in zip(y, x, strict=True)]).ravel()
    pairs = Pairs(x.reshape(-1, 2), np.repeat(y, points, axis=0), distance)
    joined = np.random.default_rng(order).permutation(np.flatnonzero(np.isfinite(distance)))
    return Pairs(*(column[joined] for column in pairs))


def published(name: str) -> Pairs | None:
    """The published lengths of a map; None where there are none."""
    if name != "arena":
        return None
    with open(Path(os.environ["PLR_JAX_DATA"]) / _PUBLISHED, encoding="utf-8") as file:
        columns = ("start_x", "start_y", "goal_x", "goal_y", "euclid_length")
        rows = np.array([[float(row[name]) for name in columns] for row in csv.DictReader(file)])
    return Pairs(rows[:, :2], rows[:, 2:4], rows[:, 4])
