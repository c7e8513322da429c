"""What the tests of lattices share: a workspace, the lattice of one robot, and offsets by their definition."""

import networkx as nx
import numpy as np
import shapely
from planner_helpers import graph_of

from plr_jax import RectangleRobot, Workspace
from plr_jax.planners.lattice.build import PRIMITIVES, build_lattices

BAR = RectangleRobot(1.3, 0.5)
WALLS = Workspace(
    ((0, 0), (6, 5)),
    [[(2, 0), (2.3, 0), (2.3, 3), (2, 3)], [(4, 2.1), (5, 3), (4.2, 4)], shapely.box(3, 4.3, 3.2, 5)],
)


def lattice_of(problem, step, primitives=PRIMITIVES):
    return build_lattices(problem, step, primitives)[0]


def offsets_between(workspace, robot, step, q0, q1):
    """Columns, rows and turns between the cells of configurations, by the definition of the grid."""
    width = workspace.bounds.width
    side = width / np.ceil(width / step - 1e-9)
    cells = [np.floor((q[:, :2] - workspace.bounds.lo) / side).astype(int) for q in (q0, q1)]
    cells = [np.clip(cell, 0, np.rint(width / side).astype(int) - 1) for cell in cells]
    offset = cells[1] - cells[0]
    if not isinstance(robot, RectangleRobot):
        return np.column_stack([offset, np.zeros(len(offset), int)])
    quarters = np.ceil(np.pi / 2 / min(step / robot.circumscribed_radius, np.pi / 4) - 1e-9)
    turn = np.pi / 2 / quarters
    sectors = [np.floor(q[:, 2] / turn + 0.5).astype(int) for q in (q0, q1)]
    turns = (sectors[1] - sectors[0]) % int(4 * quarters)
    return np.column_stack([offset, np.where(turns > 2 * quarters, turns - int(4 * quarters), turns)])


def visited(lattice):
    """The nodes of a lattice but for those that the start and the goal replace."""
    return np.setdiff1d(np.arange(len(lattice.q)), lattice.ends.cell)


def reaches_goal(lattice):
    return nx.has_path(graph_of(lattice), lattice.start, lattice.goal)
