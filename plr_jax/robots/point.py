"""A point."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from plr_jax.robots.robot import Robot


@dataclass(frozen=True)
class PointRobot(Robot):
    """A point that translates in the plane: its configuration is its position ``(x, y)``.

    Points never collide with one another, nor with a wall that they only touch.
    """

    rounding = 0.0
    dof = 2

    @property
    def core(self) -> Float[np.ndarray, "1 2"]:
        """The point itself."""
        return np.zeros((1, 2))
