from typing import NamedTuple

import numpy as np
import pytest
from planner_helpers import MIXED, heuristic_table, joint_lattice_of

from plr_jax import BLOptions, bl_plan, scenes, validate
from plr_jax.planners import straight_line, zero
from plr_jax.planners.best_first import best_successors

DOOR = scenes.single_door()


class Separable(NamedTuple):
    """A heuristic that offers its terms."""

    per_robot: object

    def __call__(self, q):
        return self.per_robot(q).sum(axis=1)


def random_states(joint, num, seed=0):
    rng = np.random.default_rng(seed)
    return np.stack([rng.integers(len(lattice.q), size=num) for lattice in joint.lattices], axis=1)


# Separable heuristics


@pytest.mark.parametrize("weight", [0.0, 3.5])
def test_tables_hold_what_the_heuristic_says(weight):
    joint, heuristic = joint_lattice_of(MIXED, 1.0), straight_line(MIXED)
    estimate = heuristic_table(joint, heuristic, weight)
    assert estimate.plain is None
    state = random_states(joint, 50)
    q = joint.configurations(state)
    np.testing.assert_allclose(estimate(joint, state), weight * heuristic(q), rtol=1e-12)
    for i, table in enumerate(estimate.tables):
        assert len(table) == len(joint.lattices[i].q)
        np.testing.assert_array_equal(table[state[:, i]], heuristic.per_robot(q)[:, i])


def test_terms_are_cost_and_weighted_estimate_of_the_child():
    joint = joint_lattice_of(MIXED, 1.0)
    estimate = heuristic_table(joint, straight_line(MIXED), 3.0)
    for lattice, table, term in zip(joint.lattices, estimate.tables, estimate.scores, strict=True):
        assert term.dtype == np.float32 and term.shape == lattice.child.shape
        np.testing.assert_array_equal(np.isinf(term), np.isinf(lattice.cost))
        node = len(table) // 2
        for primitive in range(term.shape[1]):
            if np.isfinite(term[node, primitive]):
                expected = lattice.cost[node, primitive] + 3 * table[lattice.child[node, primitive]]
                assert term[node, primitive] == pytest.approx(expected, rel=1e-6)


# Plain functions


def bent(q):
    """Not a sum over robots, and not in the order of straight lines."""
    return 1 + np.abs(np.sin(3 * q[:, 0, 0] + q[:, 1, 1])) + np.abs(q[:, 2, 0] - q[:, 0, 1])


@pytest.mark.parametrize("factor", [1.0, 50.0])
def test_a_plain_function_is_called_for_joint_configurations_in_few_batch_sizes(factor):
    sizes = set()

    def counting(q):
        sizes.add(len(q))
        return factor * bent(q)

    joint = joint_lattice_of(MIXED, 1.0)
    estimate = heuristic_table(joint, counting, 2.0)
    assert estimate.plain is counting
    for n in range(40):
        state = random_states(joint, n)
        expected = 2 * factor * bent(joint.configurations(state))
        np.testing.assert_allclose(estimate(joint, state), expected, rtol=1e-12)
    assert sizes == {1, 2, 4, 8, 16, 32, 64}


@pytest.mark.parametrize("separable", [True, False], ids=["separable", "plain"])
@pytest.mark.filterwarnings("error")
def test_estimates_too_large_for_float32_prune_nothing(separable):
    def huge(q):
        return np.where(q[..., 0] > 4, 1e300, 1e39)

    heuristic = Separable(huge) if separable else lambda q: huge(q).max(axis=1)
    assert bl_plan(DOOR, heuristic, BLOptions(step=0.5)).solved


def test_children_are_rescored_by_a_plain_function():
    joint = joint_lattice_of(MIXED, 1.0)
    estimate = heuristic_table(joint, bent, 2.0)
    state = np.array(
        [[lattice.start for lattice in joint.lattices], [lattice.goal for lattice in joint.lattices]], np.int32
    )
    children = best_successors(joint, estimate.scores, state, 5000)
    score, primitive = estimate.rescored(joint, state, children)
    assert not np.array_equal(primitive, children.primitive)
    for row in range(2):
        count = int(np.isfinite(score[row]).sum())
        assert count == np.isfinite(children.score[row]).sum() > 100
        assert np.isfinite(score[row, :count]).all() and (np.diff(score[row, :count]) >= 0).all()
        before, after = (set(map(tuple, p[row, :count].tolist())) for p in (children.primitive, primitive))
        assert before == after
        parents = np.repeat(state[[row]], count, axis=0)
        child = joint.configurations(joint.move(parents, primitive[row, :count]))
        expected = joint.move_costs(parents, primitive[row, :count]) + 2 * bent(child)
        np.testing.assert_allclose(score[row, :count], expected, rtol=1e-5)


# Infinite estimates


@pytest.mark.parametrize("separable", [True, False])
def test_infinite_estimates_exceed_all_others_but_are_finite(separable):
    def terms(q):
        return np.where(q[..., 1] > 5, np.inf, 50 * q[..., 0])

    joint = joint_lattice_of(DOOR, 0.5)
    estimate = heuristic_table(joint, Separable(terms) if separable else lambda q: terms(q).sum(axis=1), 1.0)
    nodes = np.arange(len(joint.lattices[0].q))[:, None]
    values, unknown = estimate(joint, nodes), joint.lattices[0].q[:, 1] > 5
    assert np.isfinite(values).all() and values[unknown].min() > values[~unknown].max()


def half_known(q):
    """No estimate in the upper half, through which every way leads."""
    return np.where(q[..., 1] > 5, np.inf, np.hypot(q[..., 0] - 8.21, q[..., 1] - 1.94))


@pytest.mark.parametrize(
    "heuristic",
    [
        Separable(half_known),
        lambda q: half_known(q).sum(axis=1),
        Separable(lambda q: np.full(q.shape[:2], np.inf)),
        lambda q: np.full(len(q), np.inf),
    ],
    ids=["separable", "plain", "nothing-separable", "nothing-plain"],
)
def test_infinity_prunes_nothing(heuristic):
    solution = bl_plan(DOOR, heuristic, BLOptions(step=0.5))
    report = validate(DOOR, solution.path)
    assert report.valid, report.message


# Refusals


@pytest.mark.parametrize("separable", [True, False])
@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda x: np.full_like(x, np.nan), "NaN"),
        (lambda x: x[:-1], "shape"),
        (lambda x: x[..., None], "shape"),
        (lambda x: 0.0, "shape"),
        (lambda x: "far", "numbers"),
        (lambda x: None, "NaN|numbers|shape"),
    ],
    ids=["nan", "short", "column", "scalar", "text", "none"],
)
def test_a_wrong_heuristic_is_refused(separable, wrong, message):
    heuristic = Separable(lambda q: wrong(zero().per_robot(q))) if separable else lambda q: wrong(np.zeros(len(q)))
    with pytest.raises(ValueError, match=message):
        bl_plan(DOOR, heuristic, BLOptions(step=0.5))


def test_one_nan_among_many_is_refused():
    def heuristic(q):
        return np.where(np.hypot(q[:, 0, 0] - 2, q[:, 0, 1] - 5) < 1, np.nan, 1.0)

    with pytest.raises(ValueError, match="NaN"):
        bl_plan(DOOR, heuristic, BLOptions(searchers=("bl",), step=0.4))


@pytest.mark.parametrize("separable", [True, False])
def test_a_negative_estimate_counts_as_0(separable):
    def dipped(q, least):
        return np.maximum(zero().per_robot(q) + np.abs(q[..., 0] - 8) - 1, least)

    below, at = (Separable(lambda q, least=least: dipped(q, least)) for least in (-np.inf, 0.0))
    if not separable:
        below, at = (lambda q, terms=terms: terms.per_robot(q).sum(axis=1) for terms in (below, at))
    options = BLOptions(searchers=("bl",), step=0.5)
    one, other = bl_plan(DOOR, below, options), bl_plan(DOOR, at, options)
    np.testing.assert_array_equal(one.path, other.path)
    assert one.stats.num_nodes == other.stats.num_nodes
