"""Distances of pairs: those of an oracle for each goal, alike either way round."""

import math
import pickle

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from oracle_helpers import TEN, box

import plr_jax
from plr_jax.geometry.workspace import Workspace
from plr_jax.oracles import VisibilityGraph, _pair_distances

WALL = Workspace(TEN, [box(4, 0, 6, 8)])
MAZE = plr_jax.scenes.maze().workspace


def one_by_one(oracle, x, y):
    """Each pair's distance by an oracle of its own."""
    return np.array([oracle.with_goal(b)(a[None])[0] for a, b in zip(x, y, strict=True)])


def random_workspace(seed, lattice, squeeze):
    rng = np.random.default_rng(seed)
    if lattice:
        blocked = np.argwhere(rng.random((10, 10)) < 0.3)
        return Workspace(TEN, [box(i, j, i + 1, j + 1) for i, j in blocked], squeeze=squeeze)
    return Workspace(TEN, [rng.uniform(0, 10, 2) + rng.uniform(-2, 2, (3, 2)) for _ in range(8)], squeeze=squeeze)


def hard_points(workspace, seed):
    """On walls, corners and sides of the triangles, beside them by about the tolerance, and anywhere."""
    rng, triangles = np.random.default_rng(seed), workspace.triangulation.triangles
    on_sides = ((triangles + np.roll(triangles, 1, axis=1)) / 2).reshape(-1, 2)
    beside = on_sides + workspace.tolerance * rng.choice([0.01, 1, 10, 100], (len(on_sides), 1)) * rng.normal(size=2)
    x = rng.permutation(np.concatenate([on_sides, beside, workspace.boundary.vertices]))[:40]
    x = np.concatenate([x, workspace.sample_free(20, seed)])
    return rng.permutation(x[workspace.is_free(x)])


def test_straight_around_along_and_nowhere():
    oracle = VisibilityGraph(WALL, (8, 4))
    x = np.array([[2.0, 4], [2, 4], [4, 8], [6, 4], [1, 1], [5, 4], [2, 4], [-1, 4], [np.nan, 1], [6, 8]])
    y = np.array([[8.0, 4], [1, 1], [6, 8], [4, 4], [1, 1], [8, 4], [5, 4], [8, 4], [1, 1], [6, 2]])
    expected = [2 * math.hypot(2, 4) + 2, math.hypot(1, 3), 2, 10, 0, *[math.inf] * 4, 6]
    np.testing.assert_allclose(oracle.between(x, y), expected, atol=1e-12)
    assert oracle.between(x, y).dtype == np.float64
    assert oracle.between(x[:0], y[:0]).shape == (0,)


@given(st.integers(0, 100_000), st.booleans(), st.booleans())
@settings(max_examples=40)
def test_pairs_are_as_far_apart_as_an_oracle_of_each_goal_says(seed, lattice, squeeze):
    workspace = random_workspace(seed, lattice, squeeze)
    x = hard_points(workspace, seed)
    y = x[::-1]
    oracle = VisibilityGraph(workspace, x[0])
    distance = oracle.between(x, y)
    np.testing.assert_allclose(distance, one_by_one(oracle, x, y), rtol=0, atol=1e-7)
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


def test_what_is_found_is_shared_by_all_goals_and_left_out_of_pickles():
    oracle = VisibilityGraph(MAZE, (0.06, 0.07))
    x, y = MAZE.sample_free(100, 3), np.tile(oracle.goal, (100, 1))
    np.testing.assert_allclose(oracle.between(x, y), oracle(x), atol=1e-12)
    assert oracle.with_goal(x[1])._pairs is oracle._pairs
    again = pickle.loads(pickle.dumps(oracle))
    assert vars(again._pairs).keys() < vars(oracle._pairs).keys()
    np.testing.assert_array_equal(again.between(x, y), oracle.between(x, y))


def test_of_rooms_that_are_apart_none_is_reached_from_another():
    rooms = Workspace.from_polygons([{"outer": box(i, 0, i + 1, 1)} for i in (0, 2)])
    oracle = VisibilityGraph(rooms, (0.5, 0.5))
    distance = oracle.between(np.array([[0.2, 0.5], [0.2, 0.5]]), np.array([[2.5, 0.5], [0.8, 0.5]]))
    np.testing.assert_allclose(distance, [np.inf, 0.6])
    ring = Workspace(TEN, [shapely.Polygon(box(2, 2, 8, 8), [box(4, 4, 6, 6)])])
    distance = VisibilityGraph(ring, (1, 1)).between(np.array([[1.0, 1], [1, 1]]), np.array([[5.0, 5], [9, 9]]))
    np.testing.assert_allclose(distance, [np.inf, 2 * math.hypot(1, 7)])


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize(
    ("x", "y", "message"),
    [
        (np.zeros((2, 2)), np.zeros((3, 2)), "as many points, got 2 and 3"),
        (np.zeros(2), np.zeros((1, 2)), r"x must .*\(n, 2\)"),
        (np.zeros((1, 2)), np.zeros((1, 3)), r"y must .*\(n, 2\)"),
    ],
)
def test_what_is_wrong_is_said(x, y, message):
    with pytest.raises(ValueError, match=message):
        VisibilityGraph(WALL, (1, 1)).between(x, y)
