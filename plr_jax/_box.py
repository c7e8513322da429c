"""Axis-aligned boxes: the bounds of a workspace, the domain of a PLR."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from plr_jax._types import ArrayLike


@dataclass(frozen=True, eq=False)
class Box:
    """A closed axis-aligned box ``[lo, hi]`` with a positive width along every axis.

    Args:
        lo: Lower corner, ``(dim,)``, finite.
        hi: Upper corner, ``(dim,)``, finite and above ``lo`` along every axis.

    Raises:
        ValueError: If the corners are not finite vectors of one length, or a width is not positive.
    """

    lo: Float[np.ndarray, "dim"]
    hi: Float[np.ndarray, "dim"]

    def __init__(self, lo: ArrayLike, hi: ArrayLike):
        lo, hi = _corner("lo", lo), _corner("hi", hi)
        if lo.shape != hi.shape:
            raise ValueError(f"Box corners must have one length, got lo of {lo.size} and hi of {hi.size} numbers.")
        flat = np.flatnonzero(hi <= lo)
        if flat.size:
            axis = flat[0]
            raise ValueError(
                f"Box must have positive width along every axis, got lo={lo[axis]:g} and hi={hi[axis]:g} "
                f"on axis {axis}."
            )
        lo.flags.writeable = hi.flags.writeable = False
        object.__setattr__(self, "lo", lo)
        object.__setattr__(self, "hi", hi)

    @property
    def dim(self) -> int:
        """Number of axes."""
        return self.lo.size

    @property
    def width(self) -> Float[np.ndarray, "dim"]:
        """Edge length along each axis."""
        return self.hi - self.lo

    def contains(self, x: Float[np.ndarray, "n dim"]) -> Bool[np.ndarray, "n"]:
        """Whether each point lies in the closed box; False for NaN."""
        return np.all((self.lo <= x) & (x <= self.hi), axis=-1)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Box) and np.array_equal(self.lo, other.lo) and np.array_equal(self.hi, other.hi)

    def __hash__(self) -> int:
        return hash((self.lo.tobytes(), self.hi.tobytes()))

    def __repr__(self) -> str:
        return f"Box({self.lo.tolist()}, {self.hi.tolist()})"


def _corner(name: str, value: ArrayLike) -> Float[np.ndarray, "dim"]:
    corner = np.array(value, dtype=np.float64)
    if corner.ndim != 1 or corner.size == 0 or not np.isfinite(corner).all():
        raise ValueError(f"Box {name} must be a vector of finite numbers, got {value!r}.")
    return corner
