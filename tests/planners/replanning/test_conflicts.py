"""Collisions of motions along lattices, against each two of them tested alone."""

import numpy as np
import pytest
from planner_helpers import search_budget
from reservation_helpers import TEAMS
from team_helpers import team_of

from plr_jax.collision.team import motions_apart
from plr_jax.planners._budget import HeldMemory
from plr_jax.planners.replanning import Conflicts


@pytest.mark.parametrize("name", TEAMS)
def test_conflicts_are_those_of_each_two_motions(name):
    problem, step = TEAMS[name]
    _, moves = team_of(problem, step)
    held, rng = HeldMemory(search_budget()), np.random.default_rng(0)
    conflicts = Conflicts(moves.kinds, problem.workspace.tolerance, held)
    for a, ours in enumerate(moves.kinds):
        for b, others in enumerate(moves.kinds):
            edges = rng.integers(ours.edges.num_edges, size=5)
            every = np.arange(others.edges.num_edges)
            for edge, found in zip(edges.tolist(), conflicts.of(a, edges, b), strict=True):
                q0, q1 = (ours.table.q[[node[edge]] * len(every)] for node in (ours.edges.begin, ours.edges.end))
                p0, p1 = (others.table.q[node[every]] for node in (others.edges.begin, others.edges.end))
                free = motions_apart(ours.robot, q0, q1, others.robot, p0, p1, problem.workspace.tolerance)
                assert sorted(found.tolist()) == np.flatnonzero(~free).tolist()
