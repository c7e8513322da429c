"""Growing in rounds: many cells are sampled, fitted and split together, with progress and a way to stop early."""

import warnings
from collections.abc import Callable, Sized
from typing import TypeVar

from tqdm import tqdm

from plr_jax.plr.growth.limits import Limits

GrowingTree = TypeVar("GrowingTree", bound=Sized)
"""A partition under construction; its length is its number of leaves."""


class ConstructionInterrupted(UserWarning):
    """Ctrl-C ended a construction early; what it returns is the PLR built so far."""


def grow(tree: GrowingTree, split_some: Callable[[GrowingTree], GrowingTree | None], limits: Limits) -> GrowingTree:
    """Split in rounds, from the root alone, until ``split_some`` gives None instead of a larger tree.

    Returns the last tree. An interrupt (Ctrl-C) loses the round, never the tree so far, which then comes with a
    ``ConstructionInterrupted`` warning.
    """
    total = limits.max_leaves if limits.max_leaves < 1e9 else None
    with tqdm(desc="construct", unit=" leaves", total=total, delay=2, leave=False, disable=None) as progress:
        try:
            while (larger := split_some(tree)) is not None:
                progress.update(len(larger) - len(tree))
                tree = larger
        except KeyboardInterrupt:
            message = f"Interrupted at {len(tree)} leaves: the PLR is the one built so far."
            warnings.warn(message, ConstructionInterrupted, stacklevel=4)
    return tree
