"""Distances of pairs: those of an oracle for each goal, alike either way round."""

import math
import pickle

import numpy as np
import pytest
from exact_plane import ExactPlane
from hypothesis import given
from hypothesis import strategies as st
from oracle_helpers import WALL
from piece_helpers import WORKSPACES, box, hard_points

from plr_jax import VisibilityGraph, Workspace, scenes
from plr_jax.oracles import _pair_distances

MAZE = scenes.maze().workspace


def test_straight_around_along_and_nowhere():
    oracle = VisibilityGraph(WALL, (8, 4))
    x = np.array([[2.0, 4], [2, 4], [4, 8], [6, 4], [1, 1], [5, 4], [2, 4], [-1, 4], [np.nan, 1], [6, 8]])
    y = np.array([[8.0, 4], [1, 1], [6, 8], [4, 4], [1, 1], [8, 4], [5, 4], [8, 4], [1, 1], [6, 2]])
    expected = [2 * math.hypot(2, 4) + 2, math.hypot(1, 3), 2, 10, 0, *[math.inf] * 4, 6]
    np.testing.assert_allclose(oracle.between(x, y), expected, atol=1e-12)
    assert oracle.between(x, y).dtype == np.float64 and oracle.between(x[:0], y[:0]).shape == (0,)


@pytest.mark.full
@given(st.integers(0, 100_000), st.sampled_from(WORKSPACES), st.booleans())
def test_pairs_are_as_far_apart_as_an_oracle_of_each_goal_says(seed, kind, squeeze):
    workspace = kind(np.random.default_rng(seed), squeeze)
    x = np.random.default_rng(seed).permutation(hard_points(workspace, seed))[:60]
    oracle, y = VisibilityGraph(workspace, x[0]), x[::-1]
    distance = oracle.between(x, y)
    one_by_one = [oracle.with_goal(b)(a[None])[0] for a, b in zip(x, y, strict=True)]
    np.testing.assert_allclose(distance, one_by_one, rtol=0, atol=1e-7)
    np.testing.assert_array_equal(distance, oracle.between(y, x))
    np.testing.assert_array_equal(oracle.between(x, x), 0)


@pytest.mark.parametrize("most", ["_CANDIDATES", "_WAYS", "_DISTANCES"])
def test_batches_of_any_size_give_the_same_answers(monkeypatch, most):
    x, y = MAZE.sample_free(300, 1), MAZE.sample_free(300, 2)
    whole = VisibilityGraph(MAZE, x[0]).between(x, y)
    monkeypatch.setattr(_pair_distances, most, 40)
    oracle = VisibilityGraph(MAZE, x[0])
    np.testing.assert_array_equal(oracle.between(x, y), whole)
    np.testing.assert_array_equal([oracle.between(a[None], b[None])[0] for a, b in zip(x, y, strict=True)], whole)


@pytest.mark.full
@pytest.mark.parametrize("kind", WORKSPACES)
@given(st.integers(0, 100_000), st.booleans())
def test_single_pairs_have_the_distances_of_batches(kind, seed, squeeze):
    """Through corners, from walls, along walls, from outside and from nowhere; all to the bit, either way round."""
    workspace = kind(np.random.default_rng(seed), squeeze)
    rng = np.random.default_rng(seed)
    x = np.concatenate([hard_points(workspace, seed), rng.uniform(-1, 11, (10, 2)), [[np.nan, 1], [1, np.inf]]])
    x, y = rng.permutation(x)[:60], rng.permutation(x)[:60]
    oracle = VisibilityGraph(workspace, workspace.sample_free(1, seed)[0])
    singly = [oracle.between(b[None], a[None])[0] for a, b in zip(x, y, strict=True)]
    np.testing.assert_array_equal(oracle.between(x, y), singly)
    np.testing.assert_array_equal(oracle.between(x[:5], y[:5]), singly[:5])


@pytest.mark.parametrize("kind", WORKSPACES)
def test_single_pairs_are_as_far_apart_as_in_exact_arithmetic(kind):
    workspace = kind(np.random.default_rng(4))
    x = np.random.default_rng(4).permutation(hard_points(workspace, 4))[:12]
    oracle, plane = VisibilityGraph(workspace, x[0]), ExactPlane(workspace.boundary.segments)
    for a in x[:3]:
        found = [oracle.between(a[None], b[None])[0] for b in x]
        on_grid = workspace.triangulation.place(np.vstack([a, x])).x
        np.testing.assert_allclose(found, plane.distances(on_grid[0], on_grid[1:]), atol=1e-7)


def test_what_is_found_is_shared_by_all_goals_and_left_out_of_pickles():
    oracle, x = VisibilityGraph(MAZE, (0.06, 0.07)), MAZE.sample_free(100, 3)
    y = np.tile(oracle.goal, (100, 1))
    np.testing.assert_allclose(oracle.between(x, y), oracle(x), atol=1e-12)
    assert oracle.with_goal(x[1])._pairs is oracle._pairs
    again = pickle.loads(pickle.dumps(oracle))
    assert vars(again._pairs).keys() < vars(oracle._pairs).keys()
    np.testing.assert_array_equal(again.between(x, y), oracle.between(x, y))


def test_of_rooms_that_are_apart_none_is_reached_from_another():
    oracle = VisibilityGraph(Workspace.from_polygons([{"outer": box(i, 0, i + 1, 1)} for i in (0, 2)]), (0.5, 0.5))
    np.testing.assert_allclose(oracle.between([(0.2, 0.5), (0.2, 0.5)], [(2.5, 0.5), (0.8, 0.5)]), [np.inf, 0.6])
