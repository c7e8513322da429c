"""Robots: the shapes that move through a workspace."""

from dataclasses import dataclass
from typing import TypeAlias


@dataclass(frozen=True)
class PointRobot:
    """A point that translates in the plane: its configuration is its position ``(x, y)``."""


Robot: TypeAlias = PointRobot
"""Any robot."""
