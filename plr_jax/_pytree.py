"""Functions from outside as arguments of compiled ones."""

from collections.abc import Callable
from typing import Any

import jax


def as_pytree(function: Callable) -> Any:
    """A function that may be an argument of a jitted one: itself if it is a pytree, else compiled for its own."""
    return jax.tree_util.Partial(function) if jax.tree_util.all_leaves([function]) else function
