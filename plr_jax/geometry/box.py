"""Axis-aligned boxes: the bounds of a workspace, the domain of a PLR."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from plr_jax._arrays import as_finite_point, as_points, require_integer, shortened
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
        lo, hi = as_finite_point("Box lo", lo), as_finite_point("Box hi", hi)
        if lo.shape != hi.shape:
            raise ValueError(f"Box corners must have one length, got lo of {lo.size} and hi of {hi.size} numbers.")
        flat = np.flatnonzero(hi <= lo)
        if flat.size:
            axis = flat[0]
            raise ValueError(
                f"Box must have positive width along every axis, got lo={lo[axis]:g} and hi={hi[axis]:g} "
                f"on axis {axis}."
            )
        vars(self).update(lo=lo, hi=hi)

    @classmethod
    def of(cls, value: "Box | ArrayLike", name: str = "The box") -> "Box":
        """The box that is meant where either a box or its corners may be given.

        Args:
            value: A Box, or its corners ``(lo, hi)``.
            name: What the box is called in an error.

        Returns:
            The box.

        Raises:
            ValueError: If it is neither, or as for the class.
        """
        if isinstance(value, Box):
            return value
        try:
            lo, hi = value
        except (TypeError, ValueError):
            raise ValueError(f"{name} must be a Box or its corners (lo, hi), got {shortened(value)}.") from None
        return cls(lo, hi)

    @property
    def dim(self) -> int:
        """Number of axes."""
        return self.lo.size

    @property
    def width(self) -> Float[np.ndarray, "dim"]:
        """Edge length along each axis."""
        return self.hi - self.lo

    def contains(self, x: ArrayLike) -> Bool[np.ndarray, "n"]:
        """Whether points lie in the closed box.

        Args:
            x: Points, ``(n, dim)``.

        Returns:
            True where inside or on the boundary; False for NaN.

        Raises:
            ValueError: If ``x`` has another shape.
        """
        x = as_points("x", x, self.dim)
        return np.all((self.lo <= x) & (x <= self.hi), axis=1)

    def grid(self, resolution: int) -> Float[np.ndarray, "rows columns 2"]:
        """Cell centers of a grid of (nearly) square cells over a box in the plane.

        Args:
            resolution: Number of cells along the longer side, at least 1.

        Returns:
            The centers, row 0 at the lowest ``y``; at least one row and one column.

        Raises:
            ValueError: If the box is not 2-D, or the resolution less than 1.
        """
        if self.dim != 2:
            raise ValueError(f"A grid of rows and columns needs a box of two dimensions, got {self.dim}.")
        require_integer("resolution", resolution, 1)
        columns, rows = np.maximum(1, np.rint(resolution * self.width / self.width.max())).astype(int)
        x = self.lo[0] + self.width[0] * (np.arange(columns) + 0.5) / columns
        y = self.lo[1] + self.width[1] * (np.arange(rows) + 0.5) / rows
        return np.stack(np.meshgrid(x, y), axis=-1)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Box) and np.array_equal(self.lo, other.lo) and np.array_equal(self.hi, other.hi)

    def __hash__(self) -> int:
        return hash((self.lo.tobytes(), self.hi.tobytes()))

    def __repr__(self) -> str:
        return f"Box({self.lo.tolist()}, {self.hi.tolist()})"
