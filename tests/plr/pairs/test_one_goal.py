"""The PLR of one goal, out of the pairs: its sources are corners that paths to the goal turn at."""

import numpy as np
import pytest

from plr_jax import VisibilityGraph, Workspace, construct_pairs, scenes
from plr_jax.pairs.pair_plr import _joined, _sources, plr_to
from plr_jax.plr.partition.cells import Cells, tree_of

FLOOR = scenes.floor_plan().workspace
GOALS = FLOOR.sample_free(6, seed=1)
EXACT = VisibilityGraph(FLOOR, GOALS[0])


@pytest.fixture(scope="module")
def stored():
    return construct_pairs(FLOOR, max_bytes=4_000).stored


def single_precision(x, goal):
    """Distances as exact as those that the pairs answer."""
    return EXACT.with_goal(goal)(x).astype(np.float32)


@pytest.mark.parametrize("goal", GOALS)
def test_sources_lead_to_the_goal_by_exact_ways(stored, goal):
    sources = _sources(stored, single_precision, goal)
    exact = EXACT.with_goal(goal)
    reached = np.isfinite(sources.distances)
    assert reached[0] and sources.parents[0] == 0
    np.testing.assert_allclose(sources.distances[reached], exact(sources.points[reached]), atol=1e-5)
    leg = np.linalg.norm(sources.points - sources.points[sources.parents], axis=1)
    onward = sources.distances[sources.parents] + leg
    np.testing.assert_allclose(onward[reached], sources.distances[reached], atol=1e-4)
    at = np.flatnonzero(reached)
    for _ in range(reached.sum()):  # after as many steps all are at the goal
        at = sources.parents[at]
    assert (at == 0).all()


def test_every_corner_that_a_path_turns_at_is_a_source(stored):
    goal = GOALS[0]
    sources, exact = _sources(stored, single_precision, goal), EXACT.with_goal(goal)
    reached = sources.points[np.isfinite(sources.distances)]
    turns = np.concatenate([exact.shortest_path(x)[1:-1] for x in FLOOR.sample_free(200, seed=2)])
    apart = np.linalg.norm(turns[:, None] - reached, axis=2).min(axis=1)
    # A path may also graze a corner without turning.
    assert len(turns) > 200 and (apart < 1e-6).mean() > 0.99


def test_the_plr_is_exact_where_a_leaf_has_one_first_corner(stored):
    """Most of it is: leaves are halved until one corner serves nearly all of them, but not for ever."""
    plr, x = plr_to(stored, single_precision, GOALS[1]), FLOOR.sample_free(2_000, seed=3)
    error = np.abs(np.asarray(plr(x)) - EXACT.with_goal(GOALS[1])(x))
    assert np.median(error) < 1e-5 and error.mean() < 0.05


def test_walls_that_touch_in_a_point():
    workspace = Workspace(((0, 0), (8, 8)), [[(1, 1), (3, 1), (3, 3), (1, 3)], [(3, 3), (5, 3), (5, 5), (3, 5)]])
    goal = np.array([3.5, 1.0])
    exact = VisibilityGraph(workspace, goal)
    stored = construct_pairs(workspace, max_bytes=2_000).stored
    plr, x = plr_to(stored, lambda x, y: exact(x).astype(np.float32), goal), workspace.sample_free(500, seed=0)
    assert np.abs(np.asarray(plr(x)) - exact(x)).mean() < 1e-2


def test_halves_with_one_source_become_one_leaf():
    axis = np.zeros(1, np.int64)
    halves = Cells.root(2).split(axis)
    quarters = halves[np.zeros(1, np.int64)].split(axis + 1)
    tree = tree_of(quarters.append(halves[np.ones(1, np.int64)]))
    for source, expected in (([3, 3, 3], [3]), ([3, 3, 4], [3, 4]), ([3, 4, 4], [3, 4, 4])):
        cells, kept = _joined(tree, np.array(source))
        assert sorted(kept.tolist()) == expected
        assert np.ldexp(1.0, -cells.depth.sum(axis=1)).sum() == 1
