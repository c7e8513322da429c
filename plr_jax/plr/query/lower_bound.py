"""The proven lower bound of a PLR as a distance function."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol, runtime_checkable

import jax
from jaxtyping import Array, Float

from plr_jax._arrays import shortened
from plr_jax._types import ArrayLike
from plr_jax.plr.query.stack import TableStack


@runtime_checkable
class BoundedFn(Protocol):
    """A PLR of which something is proven."""

    @property
    def band(self) -> Float[Array, "2 rows"] | None:
        """The proof."""
        ...

    @property
    def dim(self) -> int:
        """Number of axes."""
        ...

    def bounds(self, x: ArrayLike, /) -> tuple[Float[Array, "*batch"], Float[Array, "*batch"]]:
        """Lower and upper bounds of the distance."""
        ...

    @staticmethod
    def stack(plrs: Any, /) -> TableStack:
        """One function of several."""
        ...


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class LowerBound:
    """A distance function that is nowhere above the truth: see :attr:`plr_jax.PLR.lower`.

    Attributes:
        plr: The PLR.
        is_lower_bound: True, by which planners know.
    """

    plr: BoundedFn
    is_lower_bound = True

    @property
    def dim(self) -> int:
        """Number of axes."""
        return self.plr.dim

    def __call__(self, x: ArrayLike) -> Float[Array, "*batch"]:
        """The lower of the bounds, of points ``(..., dim)``."""
        return self.plr.bounds(x)[0]

    @staticmethod
    def stack(fns: Sequence["LowerBound"]) -> TableStack:
        """One function of all robots' lower bounds, as PLRs stack."""
        if not fns or not all(isinstance(fn, LowerBound) for fn in fns):
            raise ValueError(f"Lower bounds of PLRs can be stacked, at least one, got {shortened(fns)}.")
        first, *_ = fns
        return replace(first.plr.stack([fn.plr for fn in fns]), bands=tuple(fn.plr.band for fn in fns))
