"""Lengths of steps as integers, so that sums have no rounding and do not depend on their order."""

from typing import TypeVar

_Numbers = TypeVar("_Numbers")

CONNECTIVITIES = (4, 8)
_STRAIGHT = {4: 1, 8: 985}
_DIAGONAL = {4: 2, 8: 1393}  # 1393 / 985 is a convergent of the square root of 2, 3.6e-7 below it


def units(connectivity: int) -> int:
    """How many units long a straight step is."""
    return _STRAIGHT[connectivity]


def open_length(connectivity: int, rows: _Numbers, columns: _Numbers) -> _Numbers:
    """Length in units of a shortest path between cells so many rows and columns apart, without obstacles.

    Of arrays of integers at least 0, NumPy or JAX. A diagonal step of a 4-connected grid is two straight ones.
    """
    straight = abs(rows - columns)  # pyright: ignore[reportOperatorIssue]
    diagonal = (rows + columns - straight) // 2  # pyright: ignore[reportOperatorIssue]
    return _STRAIGHT[connectivity] * straight + _DIAGONAL[connectivity] * diagonal
