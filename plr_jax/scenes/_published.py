"""The published scenes: the problems that the experiments are about.

The floor plan and the scenes of teams are scene files in the folder ``published`` beside this module.
"""

from collections.abc import Sequence
from pathlib import Path

from plr_jax._problem import Problem
from plr_jax.geometry.workspace import Workspace
from plr_jax.robots.point import PointRobot
from plr_jax.scenes._file import load

_FOLDER = Path(__file__).parent / "published"
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


def floor_plan() -> Problem:
    """A point robot on a furnished floor of offices, 24 m x 15 m, from the lounge to the kitchen.

    Eleven rooms along a hallway and a lobby, walls 0.16 m thick, doors 0.8 to 1.4 m wide, more than 200 corners in
    all. Several loops of rooms and doors lead most of the way.

    Returns:
        The problem: start (23.2, 11.6), goal (1.2, 1.2).
    """
    return load(_FOLDER / "floor_plan.json")


def single_door() -> Problem:
    """A disc in two rooms, 10 x 10 in all, joined by a door 1.25 diameters wide.

    Returns:
        The problem: a disc of radius 0.4.
    """
    return load(_FOLDER / "single_door.json")


def four_rooms(num_robots: int) -> Problem:
    """Discs that change rooms by way of one center, through doors 1.25 diameters wide.

    Args:
        num_robots: 2, 3 or 4: one starts in each of the first rooms, bound for the opposite one. 8: two in
            each room.

    Returns:
        The problem: discs of radius 0.4.

    Raises:
        ValueError: For another number of robots.
    """
    return _team("four_rooms", num_robots, (2, 3, 4, 8))


def cross(num_robots: int) -> Problem:
    """Discs in two hallways that cross, 1.5 diameters wide: two cannot pass side by side.

    Args:
        num_robots: 2, facing one another in one hallway, or 3, the third in the other.

    Returns:
        The problem: discs of radius 0.4.

    Raises:
        ValueError: For another number of robots.
    """
    return _team("cross", num_robots, (2, 3))


def tangle() -> Problem:
    """Two rectangles, 1.8 x 0.5, that change places in a hallway with a bay.

    They can neither pass nor turn in the hallway; the bay is narrower than a rectangle is long and too
    shallow to park in.

    Returns:
        The problem.
    """
    return load(_FOLDER / "tangle.json")


def _team(name: str, num_robots: int, numbers: Sequence[int]) -> Problem:
    if num_robots not in numbers:
        choices = ", ".join(map(str, numbers))
        raise ValueError(f"The scene {name} has {choices} robots; there is none with {num_robots!r}.")
    return load(_FOLDER / f"{name}_{num_robots}.json")


def _point_problem(walls: Sequence[tuple[float, float, float, float]]) -> Problem:
    rings = [[(x0, y0), (x1, y0), (x1, y1), (x0, y1)] for x0, y0, x1, y1 in walls]
    workspace = Workspace(((0.0, 0.0), (1.0, 1.0)), rings)
    return Problem(workspace, [PointRobot()], [_START], [_GOAL])
