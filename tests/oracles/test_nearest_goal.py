"""The nearest of several goals: distances, indices and paths."""

import pickle

import numpy as np
import pytest

from plr_jax import Box, Euclidean, NearestGoal, VisibilityGraph, Workspace, construct

# A room of two, and one without a goal.
ROOMS = Workspace(((0, 0), (10, 4)), [[(4, 0), (4.2, 0), (4.2, 3), (4, 3)], [(8, 0), (8.1, 0), (8.1, 4), (8, 4)]])
DOCKS = [(1.0, 1.0), (7.0, 1.0), (3.5, 3.5)]
FIRST = VisibilityGraph(ROOMS, DOCKS[0])
FNS = [FIRST, *map(FIRST.with_goal, DOCKS[1:])]
X, DOMAIN = ROOMS.sample_free(2000, 0), Box((0, 0), (10, 4))


def test_distance_index_and_path_to_the_nearest_goal():
    nearest = NearestGoal(FNS)
    assert (nearest.dim, nearest.is_lower_bound) == (2, True)
    each = np.stack([fn(X) for fn in FNS])
    np.testing.assert_array_equal(nearest(X), each.min(axis=0))
    x = [(1, 0.9), (5, 0.5), (3.9, 3.5), (9, 1), (-1, 0), (np.nan, 1)]
    assert nearest.which(x).tolist() == [0, 1, 2, -1, -1, -1]
    assert np.isinf(nearest(x)).tolist() == [False] * 3 + [True] * 3
    for point, which in zip(x, (0, 1, 2, 0, 0, 0), strict=True):
        np.testing.assert_array_equal(nearest.shortest_path(point), FNS[which].shortest_path(point))
    assert NearestGoal([FIRST, FIRST]).which(x[:1]).tolist() == [0], "of equals the first"


def test_masked_and_nan_distances_are_unreachable():
    class Masked:
        dim = 1

        def __call__(self, x):
            return np.ma.masked_array(np.where(x[:, 0] < 0, np.nan, x[:, 0]), x[:, 0] > 1)

    nearest = NearestGoal([Masked()])
    assert nearest([[0.5], [2.0], [-1.0]]).tolist() == [0.5, np.inf, np.inf]
    assert nearest.which([[2.0], [-1.0]]).tolist() == [-1, -1]
    with pytest.raises(ValueError, match="Paths need oracles with shortest_path"):
        nearest.shortest_path([0.5])


def test_visibility_graphs_of_one_workspace_have_cells():
    nearest, other = NearestGoal(FNS), VisibilityGraph(Workspace(((0, 0), (10, 4))), DOCKS[0])
    for each in (nearest, pickle.loads(pickle.dumps(nearest))):
        np.testing.assert_array_equal(each.cell_sources(DOMAIN).sources.points[:3], DOCKS)
        assert each.reach(DOMAIN) is not None, "one room has no goal"
    for fns in ([*FNS, other], [FIRST, Euclidean((1, 1))]):
        nearest = NearestGoal(fns)
        assert nearest.cell_sources is None and nearest.reach(DOMAIN) is None
        assert construct(nearest, DOMAIN, max_leaves=2).num_leaves <= 2
        with pytest.raises(ValueError, match=r"answers for whole cells.* got a NearestGoal"):
            construct(nearest, DOMAIN, max_leaves=2, certified=True)
