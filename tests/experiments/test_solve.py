"""The rivals of PLRs without an oracle, by hand."""

import numpy as np
import pytest

from experiments.solving import _cars, _rivals, _speed_map
from plr_jax import Euclidean, PlaneSpace, ReedsShepp, Workspace

pytestmark = pytest.mark.full

SQUARE = Workspace(((0, 0), (1, 1)))


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


def test_the_table_of_a_car_knows_its_own_cells_and_their_reflections():
    oracle = ReedsShepp((0, 0, 0), 1.0)
    sizes = (21, 11, 8)
    values = _cars.lookup_table(oracle, sizes)
    poses = np.array([(0.0, 0.0, 0.0), (-25.0, 25.0, -np.pi), (12.5, -7.5, np.pi / 4), (12.5, 7.5, np.pi)])
    np.testing.assert_allclose(_cars.looked_up(values, poses), oracle(poses), atol=1e-5)
