"""A disc."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from plr_jax._arrays import as_finite
from plr_jax.robots.robot import Robot


@dataclass(frozen=True, init=False)
class DiscRobot(Robot):
    """A disc that translates in the plane: its configuration is its center ``(x, y)``.

    Args:
        radius: Its radius, in workspace units, positive.

    Raises:
        ValueError: If the radius is not a positive finite number.
    """

    radius: float
    dof = 2

    def __init__(self, radius: Any):
        object.__setattr__(self, "radius", as_finite("DiscRobot radius", radius, positive=True))
        object.__setattr__(self, "rounding", self.radius)

    @property
    def core(self) -> Float[np.ndarray, "1 2"]:
        """Its center."""
        return np.zeros((1, 2))
