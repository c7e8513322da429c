"""Teams and their lattices, for tests of planners that move robots step by step."""

import shapely
from planner_helpers import joint_lattice_of, search_budget

from plr_jax import DiscRobot, PointRobot, PolygonRobot, Problem, RectangleRobot, Workspace, scenes
from plr_jax.planners.lacam import LaCAM, TeamMoves

TRIANGLE = PolygonRobot([(-0.3, -0.2), (0.4, 0), (-0.3, 0.2)])
FIVE = Problem(
    Workspace(((0, 0), (6, 5)), [shapely.box(2, 0, 2.3, 3)]),
    [DiscRobot(0.3), RectangleRobot(0.9, 0.4), DiscRobot(0.3), PointRobot(), TRIANGLE],
    [(0.5, 0.6, 0), (1.0, 3.7, 0.4), (5.5, 0.6, 0), (3.1, 1.0, 0), (4.0, 4.0, 1.0)],
    [(5.3, 4.4, 0), (5.2, 1.2, -2.0), (0.6, 0.5, 0), (0.4, 4.6, 0), (1.0, 4.0, 0.0)],
)

TEAMS = {"rooms": (scenes.four_rooms(4), 0.5), "crowd": (scenes.crowd(8), 0.4), "mixed": (FIVE, 0.6)}


def team_of(problem, step):
    joint = joint_lattice_of(problem, step)
    return joint, TeamMoves(joint, joint.costs_to_go)


def search_of(problem, step, budget=None):
    joint = joint_lattice_of(problem, step)
    return LaCAM(joint, joint.costs_to_go, 1.0, budget or search_budget())
