"""Which boxes walls reach into, and which sources are asked whether a path bends around them."""

import numpy as np
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from oracle_helpers import MIDDLE
from piece_helpers import TEN, WORKSPACES, as_pieces, box

from plr_jax import VisibilityGraph, Workspace
from plr_jax.oracles.cells.sight import GoalCones, meet_walls


@given(st.integers(0, 100_000))
@settings(max_examples=15, deadline=None)
def test_walls_meet_the_boxes_whose_inside_they_reach(seed):
    rng = np.random.default_rng(seed)
    workspace = WORKSPACES[seed % 3](rng)
    lo, hi = np.sort(rng.uniform(-1, 11, (2, 30, 2)), axis=0)
    inside = shapely.multilinestrings(list(shapely.linestrings(workspace.boundary.segments)))
    reach = shapely.length(shapely.intersection(inside, shapely.box(*(lo + 1e-9).T, *(hi - 1e-9).T)))
    met = meet_walls(workspace.edge_tree, lo, hi)
    assert met[reach > 1e-6].all()
    assert not met[shapely.distance(inside, shapely.box(*lo.T, *hi.T)) > 1e-9].any()


def test_a_wall_along_the_side_of_a_box_is_not_in_it():
    walls = Workspace(TEN, [box(4, 4, 6, 6)]).edge_tree
    lo = np.array([[2.0, 4], [6, 6], [3, 3], [4.5, 4.5], [0, 0]])
    hi = np.array([[4.0, 6], [7, 7], [5, 5], [5, 5], [10, 10]])
    np.testing.assert_array_equal(meet_walls(walls, lo, hi), [False, False, True, False, True])


def test_the_goal_is_never_asked_and_corners_where_paths_wrap_around_them():
    """From behind a wall paths to (1, 5) turn at its upper corners, from in front of it at none."""
    oracle = VisibilityGraph(MIDDLE, (1, 5))
    sight = oracle.cell_sources(oracle.workspace.bounds).sight
    cones = GoalCones.of(oracle.sources, sight.turns)
    assert cones.turn[0] == -1 and (cones.turn[1:] >= 0).all()
    np.testing.assert_array_equal(cones.view, np.arange(5))
    np.testing.assert_array_equal(cones.kind, cones.view)
    named = {tuple(point): i for i, point in enumerate(oracle.sources.points.tolist())}
    in_front_and_behind = as_pieces([box(2, 4, 3, 5), box(8, 6, 9, 7)])
    for source, bends in {(1, 5): [True, True], (4, 8): [False, False], (6, 8): [False, True]}.items():
        found = sight.may_bend(in_front_and_behind, np.full(2, named[source]))
        np.testing.assert_array_equal(found, bends)
