"""The moves of a team against those of each robot, and collisions against the joint motion test, pair by pair."""

from itertools import combinations, product

import numpy as np
import pytest
from planner_helpers import FOUR_NEIGHBORS
from team_helpers import MIXED, team_of

from plr_jax import DiscRobot, Problem, Workspace, scenes
from plr_jax.collision.team import motions_apart

PROBLEMS = {"mixed": (MIXED, 0.6), "rooms": (scenes.four_rooms(8), 0.4), "crowd": (scenes.crowd(12), 0.4)}


def wandered(joint, seed, steps=4):
    """A state that each robot reaches alone, from its start."""
    rng, state = np.random.default_rng(seed), []
    for lattice in joint.lattices:
        node = lattice.start
        for _ in range(steps):
            node = int(rng.choice(lattice.child[node][np.isfinite(lattice.cost[node])]))
        state.append(node)
    return np.array(state)


@pytest.mark.parametrize("name", PROBLEMS)
@pytest.mark.parametrize("seed", range(3))
def test_moves_are_those_of_each_robot_best_first(name, seed):
    joint, moves_of = team_of(*PROBLEMS[name])
    state = wandered(joint, seed)
    moves = moves_of(state)
    for kind, costs in zip(moves_of.kinds, moves_of.heuristic, strict=True):
        for row, i in enumerate(kind.members.tolist()):
            lattice = joint.lattices[i]
            assert moves.child[i] == lattice.child[state[i]].tolist()
            free = np.flatnonzero(np.isfinite(lattice.cost[state[i]]))
            assert sorted(moves.ranked[i]) == free.tolist() and 0 in free
            scores = costs[row, lattice.child[state[i]]][moves.ranked[i]]
            assert (np.diff(scores) >= 0).all()


@pytest.mark.parametrize("name", PROBLEMS)
def test_collisions_are_those_of_each_two_motions(name):
    joint, moves_of = team_of(*PROBLEMS[name])
    robots, tolerance = joint.problem.robots, joint.problem.workspace.tolerance
    num_colliding = 0
    for seed in range(3):
        state = wandered(joint, seed, 12)
        moves = moves_of(state)
        for i, j in combinations(range(len(robots)), 2):
            a, b = joint.lattices[i], joint.lattices[j]
            p, q = (index.ravel() for index in np.indices((a.num_primitives, b.num_primitives)))
            apart = motions_apart(
                robots[i], a.q[[state[i]] * p.size], a.q[a.child[state[i], p]],
                robots[j], b.q[[state[j]] * q.size], b.q[b.child[state[j], q]], tolerance,
            )  # fmt: skip
            collide = ~apart.reshape(a.num_primitives, b.num_primitives)
            for robot, other, expected in ((i, j, collide), (j, i, collide.T)):
                (said,) = [bits for k, bits in moves.neighbors[robot] if k == other] or [[0] * len(expected)]
                assert said == [sum(1 << k for k in np.flatnonzero(row).tolist()) for row in expected]
            num_colliding += collide.sum()
    assert num_colliding > 0


def test_more_primitives_than_bits_in_a_word():
    primitives = [offset for offset in product(range(-4, 5), range(-4, 5), (0,)) if offset != (0, 0, 0)]
    problem = Problem(Workspace(((0, 0), (6, 6)), []), [DiscRobot(0.3)] * 2, [(1, 1), (2, 1)], [(5, 5), (1, 5)])
    joint, moves_of = team_of(problem, 0.5, primitives)
    moves = moves_of(np.array([lattice.start for lattice in joint.lattices]))
    ((other, bits),) = moves.neighbors[0]
    assert other == 1 and len(bits) == 81 and max(bits) >= 1 << 64
    few, few_of = team_of(problem, 0.5, FOUR_NEIGHBORS)
    few_bits = few_of(np.array([lattice.start for lattice in few.lattices])).neighbors[0][0][1]
    at = [0] + [1 + primitives.index(p) for p in FOUR_NEIGHBORS]
    for p, q in product(range(5), repeat=2):
        assert few_bits[p] >> q & 1 == bits[at[p]] >> at[q] & 1
