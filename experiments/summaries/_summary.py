"""What a rival is, what it is given, and what all of those in JAX share."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from experiments.summaries._corner_lists import Fields, Points
from plr_jax import VisibilityGraph, Workspace

_CHUNK = 4_096  # pairs at a time, whose temporaries stay in the cache


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
    distance: Float[np.ndarray, "n"]

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

    def fields(self, points: Points) -> Fields:
        """Exact distances of points from goals that are named later."""
        return Fields(self.exact, points)


@dataclass(frozen=True, eq=False)
class CompiledSummary:
    """A summary whose answers JAX compiles."""

    num_bytes: int
    answer: Callable[[Any, Any], Float[Array, "n"]]

    def __call__(self, x: Any, y: Any) -> Float[Array, "n"]:
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
