"""Cells of many goals at once: as those of each goal alone, but for what is counted from the least, and shared."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracle_helpers import MIDDLE
from piece_helpers import TEN, WORKSPACES, box, points_of

from plr_jax import VisibilityGraph, Workspace
from plr_jax.oracles.cells.family_sources import SharedCones
from plr_jax.plr.partition.cells import Cells

GRID = Cells(np.full((16, 2), 2), np.stack(np.divmod(np.arange(16), 4), axis=1))


def family_of(workspace, goals):
    """Oracles of goals of one workspace, and the distinct sources of sixteen boxes that fill its bounds."""
    first = VisibilityGraph(workspace, goals[0])
    oracles = [first, *(first.with_goal(goal) for goal in goals[1:])]
    lo, hi = GRID.boxes(workspace.bounds)
    shared = first.shared_cells(workspace.bounds, lo, hi)
    return oracles, VisibilityGraph.family_sources(shared, oracles), lo, hi


def least_cones(found, piece, x):
    """Least cone, over the sources of a piece and over those that all of it sees, at some points."""
    pairs = np.arange(found.first_pair[piece], found.first_pair[piece + 1])
    source = found.source[pairs]
    cone = found.sources.distances[source, None] + np.linalg.norm(x - found.sources.points[source, None], axis=2)
    return cone.min(axis=0), np.where(found.by_all[pairs, None], cone, np.inf).min(axis=0)


def check_member(oracle, found, of_cell, rng):
    """The bounds of each cell hold its distances, after one constant a cell; it has all that reaches the goal."""
    reached = set()
    for cell, node in enumerate(of_cell):
        if node < 0:
            continue
        reached.add(cell)
        constants = []
        for piece in range(found.first_piece[node], found.first_piece[node + 1]):
            x = points_of(rng, found.pieces[:, [piece]], 6)[0]
            exact = oracle(x)
            tips = oracle.workspace.boundary.vertices
            clear = (np.linalg.norm(x[:, None] - tips, axis=2) > 1e-5).all(axis=1)
            lower, upper = least_cones(found, piece, x)
            constants.append(oracle(found.center[[piece]])[0] - found.distance[piece])
            assert (exact - constants[0] >= lower - 3 * found.slack)[clear].all()
            assert (exact - constants[0] <= upper + 3 * found.slack).all()
        np.testing.assert_allclose(constants, constants[0], atol=3 * found.slack)
    return reached


@pytest.mark.parametrize("kind", WORKSPACES)
@given(st.integers(0, 100_000))
@settings(max_examples=3, deadline=None)
def test_every_members_distances_are_within_the_bounds(kind, seed):
    rng = np.random.default_rng(seed)
    workspace = kind(rng)
    oracles, (found, key, node_of), lo, hi = family_of(workspace, workspace.sample_free(4, seed))
    assert node_of.shape == (4, 16) and len(key) == found.num_cells == node_of.max() + 1
    for oracle, of_cell in zip(oracles, node_of, strict=True):
        reached = check_member(oracle, found, of_cell, rng)
        x = rng.uniform(lo + 1e-6, hi - 1e-6, (40, 16, 2))
        hits = np.isfinite(oracle(x.reshape(-1, 2)).reshape(40, 16)).any(axis=0)
        assert set(np.flatnonzero(hits).tolist()) <= reached


def test_cells_behind_a_corner_are_one_for_all_goals_that_are_reached_by_it():
    """Behind a wall from (0, 5) to (8, 5) all paths to goals below, left of it, go by its tip."""
    workspace = Workspace(TEN, [box(0, 4.9, 8, 5.1)])
    goals = [(1.0, 1), (2, 2), (3, 0.5)]
    _, (found, _, node_of), lo, _ = family_of(workspace, goals)
    behind = (lo[:, 1] > 5.1) & (lo[:, 0] < 7)
    assert behind.sum() == 3
    assert (node_of[:, behind] == node_of[0, behind]).all()
    assert len(np.unique(node_of[:, ~behind])) > 3 * 4
    least = np.full(found.num_cells, np.inf)
    np.minimum.at(least, found.cell[found.piece], found.sources.distances[found.source])
    np.testing.assert_array_equal(least, 0)


def test_parts_that_are_alike_are_settled_once():
    _, (found, _, _), _, _ = family_of(MIDDLE, [(1.0, 5), (2, 4.5)])
    node, hash_of_box = np.array([0, 0, 1]), np.array([3, 3, 5], np.uint64)  # the first twice
    lo, hi = (
        np.stack([end(found.pieces[:, found.cell == i], axis=(1, 2)) for i in node]) for end in (np.min, np.max)
    )
    hi[:, 0] = (lo[:, 0] + hi[:, 0]) / 2
    axis, is_upper = np.zeros(3, int), np.zeros(3, bool)
    parts, key, once, which = found.distinct_parts(node, axis, is_upper, lo, hi, hash_of_box)
    assert parts.num_cells == len(key) and which.tolist() == [0, 0, 1] and once.tolist() == [0, 2]
    alone = found.parts(node[once], axis[once], is_upper[once], lo[once], hi[once])
    np.testing.assert_array_equal(parts.pieces, alone.pieces)
    np.testing.assert_array_equal(parts.by_all, alone.by_all)
    np.testing.assert_array_equal(parts.views(parts.source), alone.views(alone.source))


def test_views_are_corners_in_their_order_and_then_goals():
    goals = [(1.0, 5), (9, 5)]
    oracles, (found, _, _), _, _ = family_of(MIDDLE, goals)
    points = np.concatenate([oracles[0].sources.points[1:], goals])
    np.testing.assert_array_equal(found.sources.points, points[found.views(np.arange(len(found.sources.points)))])


def test_cones_have_the_numbers_that_a_dictionary_would_give_them():
    """Those that are alike have one number, for ever."""
    points = np.array([[0.0, 0], [1, 0], [1, 1], [0.5, 0.25]])  # two corners, then two goals
    rng, cones, known = np.random.default_rng(0), SharedCones(points, num_turns=4, step=0.125), {}
    assert len(cones.sources.points) == len(cones.numbers(np.zeros(0, np.int64), np.zeros(0))) == 0
    for _ in range(5):
        kind, steps = rng.integers(0, 8, 40), rng.integers(0, 4, 40)
        found = cones.numbers(kind, 0.125 * (steps + rng.uniform(-0.4, 0.4, 40)))  # nearer than half a step is alike
        expected = [known.setdefault(each, len(known)) for each in zip(kind.tolist(), steps.tolist(), strict=True)]
        np.testing.assert_array_equal(found, expected)
        kinds, steps = np.array(list(known)).T
        np.testing.assert_array_equal(cones.kind, kinds)
        np.testing.assert_array_equal(cones.sources.points, points[kinds // 2])
        np.testing.assert_array_equal(cones.sources.distances, 0.125 * steps)
        np.testing.assert_array_equal(cones.view, kinds // 2)
        np.testing.assert_array_equal(cones.turn, [kind if kind < 4 else -1 for kind in kinds])
