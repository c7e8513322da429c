from itertools import combinations, product

import numpy as np
import pytest
import shapely
from planner_helpers import apart, hallway, heuristic_table, joint_lattice_of
from robot_helpers import sampled_distance

from plr_jax import DiscRobot, PointRobot, Problem, RectangleRobot, Workspace, scenes
from plr_jax.planners import straight_line
from plr_jax.planners.bl.successors import best_successors

TIGHT = Workspace(((0, 0), (3, 3)), [shapely.box(1.4, 1.4, 1.6, 1.6)])
MIXED = Problem(
    TIGHT,
    [DiscRobot(0.3), RectangleRobot(0.8, 0.3), PointRobot()],
    [(0.5, 0.5, 1), (2.5, 2.5, 0.1), (0.5, 2.5, 2)],
    [(2.5, 2.5, 0), (0.6, 0.6, 0), (2.5, 0.5, 0)],
)
DISCS = Problem(TIGHT, [DiscRobot(0.4), DiscRobot(0.3)], [(0.5, 0.5), (2.5, 2.5)], [(2.5, 2.5), (0.5, 0.5)])


def terms_of(joint):
    return heuristic_table(joint, straight_line(joint.problem), 2.0).scores


def free_states(joint, num, seed):
    """Random joint configurations in which no two robots overlap, some of them close together."""
    rng = np.random.default_rng(seed)
    found = []
    while len(found) < num:
        state = np.array([[rng.integers(len(lattice.q)) for lattice in joint.lattices]])
        if apart(joint, state, np.zeros((1, len(joint.lattices)), np.uint8)).all():
            found.append(state[0])
    return np.array(found, dtype=np.int32)


def all_children(joint, terms, state):
    """Every joint primitive of one state that collides with nothing, and its score."""
    primitive = np.array(list(product(*(range(term.shape[1]) for term in terms))), dtype=np.uint8)
    score = sum(term[state[i], primitive[:, i]].astype(float) for i, term in enumerate(terms))
    valid = np.isfinite(score)
    valid[valid] = apart(joint, np.repeat(state[None], valid.sum(), axis=0), primitive[valid])
    return {tuple(p): s for p, s in zip(primitive[valid].tolist(), score[valid].tolist(), strict=True)}


def found_children(children, row):
    known = np.isfinite(children.score[row])
    keys = [tuple(p) for p in children.primitive[row, known].tolist()]
    assert len(set(keys)) == len(keys), "no child twice"
    return dict(zip(keys, children.score[row, known].tolist(), strict=True))


@pytest.mark.parametrize(("problem", "step"), [(MIXED, 1.0), (DISCS, 0.5)], ids=["mixed", "discs"])
def test_all_children_when_nothing_is_cut(problem, step):
    joint = joint_lattice_of(problem, step)
    terms, state = terms_of(joint), free_states(joint, 12, seed=3)
    sizes = np.cumprod([term.shape[1] for term in terms])
    children = best_successors(joint, terms, state, int(sizes[-1]) + 5)
    assert children.score.shape == (len(state), sizes[-1]) and children.whole.all()
    assert children.num_scored == len(state) * sizes.sum()
    num_valid = 0
    for row in range(len(state)):
        expected, found = all_children(joint, terms, state[row]), found_children(children, row)
        assert set(found) == set(expected)
        np.testing.assert_allclose([found[key] for key in expected], list(expected.values()), rtol=1e-5)
        assert (np.diff(children.score[row][: len(found)]) >= 0).all(), "best first"
        num_valid += len(found)
    assert 0 < num_valid < 0.9 * len(state) * sizes[-1], "some children collide"
    assert children.num_valid == num_valid


@pytest.mark.parametrize("width", [1, 7, 60])
def test_a_cut_product_gives_some_of_the_children_and_says_so(width):
    joint = joint_lattice_of(MIXED, 1.0)
    terms, state = terms_of(joint), free_states(joint, 12, seed=4)
    children = best_successors(joint, terms, state, width)
    assert children.score.shape[1] <= width
    for row in range(len(state)):
        expected, found = all_children(joint, terms, state[row]), found_children(children, row)
        assert set(found) <= set(expected)
        np.testing.assert_allclose(list(found.values()), [expected[key] for key in found], rtol=1e-5)
        assert (np.diff(children.score[row][: len(found)]) >= 0).all()
        if children.whole[row]:
            assert set(found) == set(expected)
        if len(expected) > width:
            assert not children.whole[row]
    assert not children.whole.all()


def test_of_one_robot_the_best_are_kept_and_whole_is_exact():
    problem = scenes.single_door()
    joint = joint_lattice_of(problem, 0.8)
    terms, state = terms_of(joint), np.arange(len(joint.lattices[0].q), dtype=np.int32)[:, None]
    for width in (1, 4, 8, 9):
        children = best_successors(joint, terms, state, width)
        best = np.sort(terms[0], axis=1)[:, :width]
        np.testing.assert_array_equal(children.score, best)
        np.testing.assert_array_equal(children.whole, np.isfinite(terms[0]).sum(axis=1) <= width)
        assert children.num_scored == terms[0].size
        assert children.num_valid == np.isfinite(terms[0]).sum(), "counted before the cut"


def test_a_wide_cut_of_three_robots_keeps_the_best_child():
    joint = joint_lattice_of(MIXED, 1.0)
    terms, state = terms_of(joint), free_states(joint, 12, seed=5)
    children = best_successors(joint, terms, state, 100)
    for row in range(len(state)):
        expected = all_children(joint, terms, state[row])
        if expected:
            assert children.score[row, 0] == pytest.approx(min(expected.values()), rel=1e-5)


def test_discs_face_to_face_have_the_children_that_one_draws():
    # In a hallway one cell wide the left disc may step left or stay, and the right one likewise; both may step
    # the same way at the same time, since they keep their distance.
    problem = hallway(4)
    joint = joint_lattice_of(problem, 1.0)
    lattice = joint.lattices[0]
    column = np.floor(lattice.q[:, 0]).astype(int).tolist()
    state = np.array([[column.index(1), np.floor(joint.lattices[1].q[:, 0]).astype(int).tolist().index(2)]], np.int32)
    children = best_successors(joint, terms_of(joint), state, 1000)
    moves = {
        (round(float(a[0] - 1.5)), round(float(b[0] - 2.5)))
        for a, b in joint.configurations(joint.move(np.repeat(state, 9, axis=0), children.primitive[0, :9]))[
            :, :, :2
        ].astype(float)[: int(np.isfinite(children.score).sum())]
    }
    assert moves == {(-1, -1), (-1, 0), (-1, 1), (0, 0), (0, 1), (1, 1)}


def test_collisions_are_those_that_samples_show():
    joint = joint_lattice_of(MIXED, 1.0)
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
    joint = joint_lattice_of(MIXED, 1.0)
    state = free_states(joint, 5, seed=7)
    q = joint.configurations(state)
    assert q.shape == (5, 3, 3) and (q[:, 0, 2] == 1).all() and (q[:, 2, 2] == 2).all()
    for i, lattice in enumerate(joint.lattices):
        dof = lattice.q.shape[1]
        np.testing.assert_array_equal(q[:, i, :dof], lattice.q[state[:, i]])


def test_moves_and_their_costs():
    joint = joint_lattice_of(MIXED, 1.0)
    state = free_states(joint, 20, seed=8)
    rng = np.random.default_rng(0)
    primitive = np.stack([rng.integers(lattice.child.shape[1], size=20) for lattice in joint.lattices], axis=1)
    primitive = primitive.astype(np.uint8)
    moved, cost = joint.move(state, primitive), joint.move_costs(state, primitive)
    for row in range(20):
        steps = list(zip(joint.lattices, state[row], primitive[row], strict=True))
        assert moved[row].tolist() == [lattice.child[s, p] for lattice, s, p in steps]
        assert cost[row] == pytest.approx(sum(lattice.cost[s, p] for lattice, s, p in steps))
