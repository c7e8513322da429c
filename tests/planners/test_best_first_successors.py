from itertools import product

import numpy as np
import pytest
from planner_helpers import TIGHT, TIGHT_TEAM, apart, heuristic_table, joint_lattice_of

from plr_jax import DiscRobot, Problem, scenes
from plr_jax.planners import straight_line
from plr_jax.planners.best_first import best_successors

DISCS = Problem(TIGHT, [DiscRobot(0.4), DiscRobot(0.3)], [(0.5, 0.5), (2.5, 2.5)], [(2.5, 2.5), (0.5, 0.5)])


def free_states(joint, num, seed):
    """Random joint configurations in which no two robots overlap, some of them close together."""
    rng = np.random.default_rng(seed)
    found = []
    while len(found) < num:
        state = np.array([[rng.integers(len(lattice.q)) for lattice in joint.lattices]])
        if apart(joint, state, np.zeros((1, len(joint.lattices)), np.uint8)).all():
            found.append(state[0])
    return np.array(found, dtype=np.int32)


def terms_of(joint):
    return heuristic_table(joint, straight_line(joint.problem), 2.0).scores


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


@pytest.mark.parametrize(("problem", "step"), [(TIGHT_TEAM, 1.0), (DISCS, 0.5)], ids=["mixed", "discs"])
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


@pytest.mark.parametrize("width", [1, 7, 100])
def test_a_cut_product_gives_some_of_the_children_and_says_so(width):
    joint = joint_lattice_of(TIGHT_TEAM, 1.0)
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
        assert children.whole[row] <= (len(expected) <= width)
        if width == 100 and expected:
            assert children.score[row, 0] == pytest.approx(min(expected.values()), rel=1e-5)
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
