"""What every rival of a PLR has in common, and how a rival that is not installed is skipped."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float


class Rival(NamedTuple):
    """An approximation of a distance function in the plane.

    Attributes:
        num_bytes: Bytes of the numbers it is made of.
        answer: Its fastest call for a batch of points ``(n, 2)``.
        on_device: Whether it takes and gives JAX arrays, of float32; else NumPy arrays.
        function: Its answer to one point or many as a function that JAX can differentiate, if it is one.
        chunk: How many points its compiled code takes at once; None for all.
    """

    num_bytes: int
    answer: Callable[[Any], Any]
    on_device: bool = False
    function: Callable[[Float[Array, "*batch 2"]], Float[Array, "*batch"]] | None = None
    chunk: int | None = None

    def on_host(self, x: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n"]:
        """Answers as float64 NumPy numbers, to points of any precision."""
        return np.asarray(self.answer(jnp.asarray(x, jnp.float32) if self.on_device else x), np.float64)


def compiled(function: Callable[[Float[Array, "2"]], Any], chunk: int | None) -> Callable[[Any], Any]:
    """A function of one point, compiled for a batch of them: all at once or in chunks."""
    if chunk is None:
        return jax.jit(jax.vmap(function))
    return jax.jit(lambda x: jax.lax.map(function, x, batch_size=chunk))


def make_all(makers: dict[str, Callable[[], Any]]) -> tuple[dict[str, Any], dict[str, str]]:
    """What each maker makes; and for those whose package is absent, the reason why they are skipped."""
    made, skipped = {}, {}
    for name, make in makers.items():
        try:
            made[name] = make()
        except ModuleNotFoundError as error:
            skipped[name] = f"{error.name} is not installed: pip install '.[baselines]'"
    return made, skipped
