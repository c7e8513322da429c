"""The rivals of PLRs without an oracle, by hand."""

import math

import numpy as np
import pytest

from experiments import _distance_tables
from experiments.solving import _cars, _plane, _rivals, _speed_map
from plr_jax import CellState, Euclidean, PlaneSpace, ReedsShepp, RigidBodySpace, VisibilityGraph, Workspace, scenes

SQUARE = Workspace(((0, 0), (1, 1)))


def test_broken_bounds_are_counted():
    problem = scenes.maze()
    found = problem.workspace, problem.goals[0]
    exact = VisibilityGraph(*found)
    plr = _plane._solved(found, {"max_leaves": 200}, x := found[0].sample_free(500, 1), exact(x), 0)[1]
    far = lambda x: exact(x) + 10  # noqa: E731
    (counts,) = _plane.violations([plr], found, far, 500, 0)
    assert counts["lower_violated"] == 0 < counts["upper_violated"] <= counts["points_tested"]
    (counts,) = _plane.violations([plr], found, lambda x: 0 * exact(x), 500, 0)
    assert counts["upper_violated"] == 0 < counts["lower_violated"]


def test_spaces_count_what_they_are_asked():
    asked = _rivals.counted(PlaneSpace(SQUARE))
    assert asked.is_free(np.full((3, 2), 0.5)).all()
    assert asked.are_free(np.zeros((2, 2)), np.ones((2, 2))).all()
    assert (asked.classify(np.zeros((4, 2)), np.ones((4, 2))) == CellState.FREE).all()
    assert asked.sees_boxes(np.zeros((1, 2)), np.zeros((1, 2)), np.ones((1, 2))).all()
    assert asked.tests.for_json() == {"calls": 4, "configurations": 3, "motions": 2, "boxes": 5}
    problem = scenes.tangle()
    assert not hasattr(_rivals.counted(RigidBodySpace(problem.workspace, problem.robots[0])), "sees_boxes")


def test_centers_run_fastest_along_the_first_coordinate_and_one_of_two_neighbors_counts():
    space = PlaneSpace(Workspace(((0, 0), (3, 2))))
    expected = [(0.5, 0.5), (1.5, 0.5), (2.5, 0.5), (0.5, 1.5), (1.5, 1.5), (2.5, 1.5)]
    np.testing.assert_allclose(_rivals.centers(space.domain, (3, 2), np.arange(6)), expected)
    assert _rivals.even_sizes(space.domain, np.ones(2), 600) == (30, 20)
    assert _rivals.even_sizes(space.domain, np.array([1.0, 6.0]), 400) == (10, 40)
    assert sorted(_rivals.all_neighbors(2, 1)) == [(0, 1), (1, -1), (1, 0), (1, 1)]
    assert len(_rivals.all_neighbors(2, 2)) == 8 and len(_rivals.all_neighbors(2, 4)) == 24


def test_grids_among_no_obstacles_tell_the_distance():
    space, goal = PlaneSpace(SQUARE), np.array([0.3, 0.4])
    x = SQUARE.sample_free(2_000, 5)
    exact = Euclidean(goal)(x)
    inside = ((x > 0.01) & (x < 0.99)).all(axis=1)  # beyond, fields go on as at their outer centers
    x, exact = x[inside], exact[inside]
    searched = _rivals.grid_search(space, goal, (64, 64), _rivals.all_neighbors(2, 4))
    assert np.abs(searched(x) - exact).max() < 0.015
    assert np.abs(_rivals.marched(space, goal, (64, 64))(x) - exact).max() < 0.006
    twice = _rivals.marched(space, goal, (64, 64), lambda q: np.full(len(q), 2.0))
    assert np.abs(twice(x) - 2 * exact).max() < 0.012


def test_fast_boxes_bound_themselves():
    boxes = _speed_map.MAPS["two regions, 10 x as fast"]
    rng = np.random.default_rng(0)
    ends = np.sort(rng.random((2, 3_000, 2)), axis=0)
    lower, upper = boxes.bounds(*ends)
    for share in rng.random((20, 3_000, 2)):
        factor = boxes(ends[0] + share * (ends[1] - ends[0]))
        assert ((lower <= factor) & (factor <= upper)).all()
    touching = boxes.bounds(boxes.hi, boxes.hi + 0.01)
    np.testing.assert_allclose(touching, [(0.1, 0.1), (1, 1)])
    np.testing.assert_allclose(boxes.bounds(boxes.lo, boxes.hi), 0.1)


def test_roadmaps_are_compared_at_equal_error():
    rows = [
        {"mean": mean, "tests": {"configurations": tests // 2, "motions": tests - tests // 2}}
        for mean, tests in ((0.1, 1_000), (0.01, 100_000))
    ]
    tests, is_more = _distance_tables._tests_at_equal_error(rows, math.sqrt(0.001))
    assert tests == pytest.approx(10_000) and not is_more
    assert _distance_tables._tests_at_equal_error(rows, 0.001) == (pytest.approx(100_000), True)


def test_the_table_of_a_car_knows_its_own_cells_and_their_reflections():
    oracle = ReedsShepp((0, 0, 0), 1.0)
    sizes = (21, 11, 8)
    values = _cars.lookup_table(oracle, sizes)
    poses = np.array([(0.0, 0.0, 0.0), (-25.0, 25.0, -np.pi), (12.5, -7.5, np.pi / 4), (12.5, 7.5, np.pi)])
    np.testing.assert_allclose(_cars.looked_up(values, poses), oracle(poses), atol=1e-5)
