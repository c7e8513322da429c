"""The published scenes: the problems that the experiments are about."""

from collections.abc import Sequence

from plr_jax._problem import Problem
from plr_jax._robot import PointRobot
from plr_jax._workspace import Workspace

_START, _GOAL = (0.93, 0.95), (0.06, 0.07)

# Walls as boxes (x0, y0, x1, y1). No side lies on a dyadic line, so no cell boundary can hide one.
_MAZE = (
    (0.00, 0.19, 0.71, 0.23),
    (0.27, 0.43, 1.00, 0.47),
    (0.00, 0.68, 0.63, 0.72),
    (0.79, 0.47, 0.83, 0.83),
    (0.41, 0.23, 0.45, 0.36),
    (0.19, 0.79, 0.23, 1.00),
)
_THIN_MAZE = (
    (0.00, 0.205, 0.71, 0.215),
    (0.27, 0.445, 1.00, 0.455),
    (0.00, 0.695, 0.63, 0.705),
    (0.805, 0.455, 0.815, 0.83),
    (0.425, 0.215, 0.435, 0.36),
    (0.205, 0.79, 0.215, 1.00),
)


def maze() -> Problem:
    """A point robot in the unit square among six walls, each 0.04 thick.

    Returns:
        The problem: start (0.93, 0.95), goal (0.06, 0.07).
    """
    return _point_problem(_MAZE)


def thin_maze() -> Problem:
    """The maze with walls 0.01 thick along the same center lines: distance jumps over a short way.

    Returns:
        The problem: start and goal as in :func:`maze`.
    """
    return _point_problem(_THIN_MAZE)


def _point_problem(walls: Sequence[tuple[float, float, float, float]]) -> Problem:
    rings = [[(x0, y0), (x1, y0), (x1, y1), (x0, y1)] for x0, y0, x1, y1 in walls]
    workspace = Workspace(((0.0, 0.0), (1.0, 1.0)), rings)
    return Problem(workspace, [PointRobot()], [_START], [_GOAL])
