"""A rectangle."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float

from plr_jax._arrays import as_finite
from plr_jax.robots.robot import Robot

_CORNERS = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)])


@dataclass(frozen=True, init=False)
class RectangleRobot(Robot):
    """A rectangle in SE(2): its configuration is its center and heading ``(x, y, theta)``.

    The heading, in radians, is the direction of its length, counterclockwise from the x axis; it is
    periodic, so ``theta`` and ``theta + 2 pi`` are the same.

    Args:
        length: Side along the heading, in workspace units, positive.
        width: Side across the heading, in workspace units, positive.

    Raises:
        ValueError: If a side is not a positive finite number.
    """

    length: float
    width: float
    rounding = 0.0
    dof = 3

    def __init__(self, length: Any, width: Any):
        object.__setattr__(self, "length", as_finite("RectangleRobot length", length, positive=True))
        object.__setattr__(self, "width", as_finite("RectangleRobot width", width, positive=True))

    @cached_property
    def core(self) -> Float[np.ndarray, "4 2"]:
        """Its corners, the one ahead to the left first."""
        return _CORNERS * np.array([self.length, self.width]) / 2
