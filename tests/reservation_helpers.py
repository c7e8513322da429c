"""A team's paths as a table of reservations, for the tests of what replans them."""

import numpy as np
from planner_helpers import search_budget
from team_helpers import MIXED, search_of

from plr_jax import scenes
from plr_jax.planners import Status
from plr_jax.planners.replanning import ReservationTable

TEAMS = {"rooms": (scenes.four_rooms(4), 0.5), "crowd": (scenes.crowd(12), 0.4), "mixed": (MIXED, 0.6)}


def table_of(name, waiting=6, seconds=60.0):
    problem, step = TEAMS[name]
    search = search_of(problem, step)
    assert search.run(10_000) is Status.SOLVED
    state = np.concatenate([search.branch, np.repeat(search.branch[-1:], waiting, axis=0)])
    kinds, costs_to_go, tolerance = search.moves.kinds, search.moves.heuristic, problem.workspace.tolerance
    return search.joint, ReservationTable(kinds, costs_to_go, state, tolerance, search_budget(seconds=seconds))


def blocked_from_scratch(table):
    budget = search_budget()
    return ReservationTable(table.kinds, table.costs_to_go, table.state, table.conflicts.tolerance, budget).blocked
