"""Searches of grids that repair what they found when cells change: LPA* and D* Lite of python-motion-planning.

Without its pictures, and for all cells of a change at once: it asks for one cell a click.
"""

from typing import Any

import numpy as np
from jaxtyping import Bool, Int

Cell = tuple[int, int]


def incremental_planners(free: Bool[np.ndarray, "h w"], start: Cell, goal: Cell) -> dict[str, Any]:
    """One of each kind, which has planned once; cells are columns and rows."""
    import python_motion_planning as pmp

    height, width = free.shape
    planners = {}
    for name, kind in (("LPA*", pmp.LPAStar), ("D* Lite", pmp.DStarLite)):
        grid: Any = pmp.Grid(width + 2, height + 2)  # whose border is blocked
        grid.update(grid.obstacles | {(x + 1, y + 1) for y, x in np.argwhere(~free).tolist()})
        planners[name] = kind((start[0] + 1, start[1] + 1), (goal[0] + 1, goal[1] + 1), grid)
    return planners


def replanned(planner: Any, cells: Int[np.ndarray, "n 2"], *, blocked: bool) -> float:
    """The length of the path after cells have been blocked or freed, as the package does at a click on each."""
    nodes = [planner.map[x + 1, y + 1] for x, y in cells.tolist()]
    for node in nodes:
        (planner.obstacles.add if blocked else planner.obstacles.discard)(node.current)
    planner.env.update(planner.obstacles)
    for node in nodes:
        for each in ([] if blocked else [node]) + planner.getNeighbor(node):
            planner.updateVertex(each)
    return float(planner.plan()[0])
