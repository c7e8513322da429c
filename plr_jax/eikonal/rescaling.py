"""Values bent down, level by level, so that slopes that are a little too steep are no longer.

Wherever a function is steeper than allowed, by a factor ``s``, its values run over some interval. Bending all values
by a function whose own slope is at most ``1 / s`` on that interval makes it right, and what is farther from the goal
only moves down by what is lost. That is far less than dividing everything by the largest factor.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True, eq=False)
class Rescaling:
    """A piecewise linear function of values, 0 at 0, that rises by at most one unit a unit.

    Attributes:
        level: Where its pieces meet, ascending.
        value: What it is there.
    """

    level: Float[np.ndarray, "levels"]
    value: Float[np.ndarray, "levels"]

    def __call__(self, u: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """The values bent down."""
        return np.interp(u, self.level, self.value)


def rescaling_of(
    lowest: Float[np.ndarray, "cells"], highest: Float[np.ndarray, "cells"], factor: Float[np.ndarray, "cells"]
) -> Rescaling:
    """That which divides slopes by a factor, where it is above 1, in cells of given lowest and highest values."""
    order = np.argsort(factor, kind="stable")
    order = order[factor[order] > 1]
    level = np.unique(np.concatenate([lowest[order], highest[order], [lowest.min(), 0.0, highest.max()]]))
    steepest = np.ones(len(level) - 1)
    first, last = np.searchsorted(level, lowest), np.searchsorted(level, highest)
    for cell in order.tolist():  # the steepest last
        steepest[first[cell] : last[cell]] = factor[cell]
    value = np.append(0.0, np.cumsum(np.diff(level) / steepest))
    return Rescaling(level, value - np.interp(0.0, level, value))
