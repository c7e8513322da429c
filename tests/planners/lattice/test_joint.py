"""Joint configurations and motions of a team on its lattices, and which of them collide."""

from itertools import combinations

import numpy as np
import pytest
from planner_helpers import TIGHT_TEAM, free_states, joint_lattice_of
from robot_helpers import sampled_distance


def test_collisions_are_those_that_samples_show():
    joint = joint_lattice_of(TIGHT_TEAM, 1.0)
    state = free_states(joint, 8, seed=6)
    for i, j in combinations(range(3), 2):
        near, collide = joint.collisions(i, j, state)
        a, b = joint.lattices[i], joint.lattices[j]
        shape = (a.child.shape[1], b.child.shape[1])
        for row in range(len(state)):
            p, q = (index.ravel() for index in np.indices(shape))
            pad = [np.zeros((p.size, 3)) for _ in range(4)]
            for array, lattice, k, primitive in ((0, a, i, p), (2, b, j, q)):
                dof = lattice.q.shape[1]
                pad[array][:, :dof] = lattice.q[state[row, k]]
                pad[array + 1][:, :dof] = lattice.q[lattice.child[state[row, k], primitive]]
            robots = joint.problem.robots
            distance = sampled_distance(robots[i], pad[0], pad[1], robots[j], pad[2], pad[3], 60)
            at = np.flatnonzero(near == row)
            said = collide[at[0]].ravel() if len(at) else np.zeros(p.size, dtype=bool)
            assert said[distance < -1e-6].all(), "a sampled overlap is found"
            assert not said[distance > 0.1].any(), "no collision where samples stay well apart"


def test_configurations_of_a_mixed_team_keep_the_heading_of_round_robots():
    joint = joint_lattice_of(TIGHT_TEAM, 1.0)
    state = free_states(joint, 5, seed=7)
    q = joint.configurations(state)
    assert q.shape == (5, 3, 3) and (q[:, 0, 2] == 1).all() and (q[:, 2, 2] == 2).all()
    for i, lattice in enumerate(joint.lattices):
        dof = lattice.q.shape[1]
        np.testing.assert_array_equal(q[:, i, :dof], lattice.q[state[:, i]])


def test_moves_and_their_costs():
    joint = joint_lattice_of(TIGHT_TEAM, 1.0)
    state = free_states(joint, 20, seed=8)
    rng = np.random.default_rng(0)
    primitive = np.stack([rng.integers(lattice.child.shape[1], size=20) for lattice in joint.lattices], axis=1)
    primitive = primitive.astype(np.uint8)
    moved, cost = joint.move(state, primitive), joint.move_costs(state, primitive)
    for row in range(20):
        steps = list(zip(joint.lattices, state[row], primitive[row], strict=True))
        assert moved[row].tolist() == [lattice.child[s, p] for lattice, s, p in steps]
        assert cost[row] == pytest.approx(sum(lattice.cost[s, p] for lattice, s, p in steps))
