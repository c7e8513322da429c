"""Corners of cells: every corner that a path from a point turns at first is listed for the point's cell."""

import numpy as np
import pytest
from piece_helpers import TEN, WORKSPACES, box

from plr_jax import VisibilityGraph
from plr_jax.geometry.corners import corner_visibility
from plr_jax.geometry.workspace import Workspace
from plr_jax.pairs.construct import grow_lists
from plr_jax.pairs.visible_corners import visible_corners
from plr_jax.plr.certificate.certificate import Proof
from plr_jax.plr.growth.limits import check_limits

LIMITS = check_limits(2, 0.5, True, lambda dim, leaves: leaves, None, None, 10_000, None, Proof.NONE, 13)


def grown(workspace, most_leaves):
    visibility = corner_visibility(workspace)
    root = visible_corners(visibility, workspace, workspace.bounds)
    return visibility.corners, grow_lists(root, workspace.bounds, LIMITS, most_leaves, lambda lists: 0)


def first_turns(workspace, n, seed):
    """Free points and the corner at which the path to a random goal turns first, where it turns at all."""
    goals = workspace.sample_free(6, seed)
    oracle, points, turns = VisibilityGraph(workspace, goals[0]), [], []
    for goal in goals:
        oracle = oracle.with_goal(goal)
        for x in workspace.sample_free(n, seed + 1):
            path = oracle.shortest_path(x)
            if len(path) > 2:
                points.append(x)
                turns.append(path[1])
    return np.array(points).reshape(-1, 2), np.array(turns).reshape(-1, 2)


@pytest.mark.parametrize("kind", WORKSPACES)
@pytest.mark.parametrize("seed", range(2))
def test_lists_hold_all_corners_that_paths_turn_at_first(kind, seed):
    workspace = kind(np.random.default_rng(seed))
    points, turns = first_turns(workspace, 12, seed)
    for most_leaves in (1, 40):
        corners, lists = grown(workspace, most_leaves)
        lo, hi = lists.cells.boxes(workspace.bounds)
        for x, turn in zip(points, turns, strict=True):
            cell = np.flatnonzero(((lo <= x) & (x <= hi)).all(axis=1))[0]
            listed = corners.points[lists.corner[lists.cell == cell]]
            assert (np.abs(listed - turn).max(axis=1, initial=0.0) <= 1e-9).any()


@pytest.mark.parametrize("kind", WORKSPACES)
def test_corners_seen_by_all_of_a_cell_are_seen_from_its_points(kind):
    workspace = kind(np.random.default_rng(7))
    corners, lists = grown(workspace, 40)
    assert len(lists.cells) > 10 and (np.diff(lists.cell) >= 0).all() and lists.by_all.any()
    assert np.ldexp(1.0, -lists.cells.depth.sum(axis=1)).sum() == 1
    lo, hi = lists.cells.boxes(workspace.bounds)
    x = np.random.default_rng(8).uniform(lo, hi, (20, *lo.shape))
    entry = np.flatnonzero(lists.by_all)
    for points in x:
        own, corner = points[lists.cell[entry]], corners.points[lists.corner[entry]]
        free = workspace.is_free(own)
        assert workspace.is_visible(own[free], corner[free]).all()


def test_a_wall_by_hand():
    """The corners of the near side are listed, and not the one that the wall hides from all of the cell."""
    workspace = Workspace(((0, 0), (16, 16)), [box(6, 6, 10, 10)])
    corners, lists = grown(workspace, 64)
    lo, hi = lists.cells.boxes(workspace.bounds)
    for x, near, hidden in (((1.0, 8.5), {(6, 6), (6, 10)}, (10, 6)), ((15.0, 7.5), {(10, 6), (10, 10)}, (6, 10))):
        (cell,) = np.flatnonzero(((lo < x) & (x < hi)).all(axis=1))
        listed = set(map(tuple, corners.points[lists.corner[lists.cell == cell]].tolist()))
        assert near <= listed and hidden not in listed


def test_without_obstacles_there_is_one_empty_list():
    _, lists = grown(Workspace(TEN, []), 40)
    assert len(lists.cells) == 1 and len(lists.corner) == 0
