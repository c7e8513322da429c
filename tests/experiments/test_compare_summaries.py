"""Rivals of a file of all pairs, each at its smallest, and what they are made of by hand."""

import numpy as np
import pytest
from scipy.sparse.csgraph import shortest_path

from experiments import compare_summaries
from experiments.baselines._brute_distance import MAZE, THIN_MAZE, BruteDistance
from experiments.summaries import _embeddings, _given, _landmarks, _network, _node_tables, _polygons
from experiments.summaries._given import Given, Pairs
from plr_jax import VisibilityGraph, Workspace, scenes
from plr_jax.geometry.graph import Graph

SQUARE = Workspace(((0, 0), (1, 1)))


def given(workspace, max_bytes, goals=20):
    oracle = VisibilityGraph(workspace, workspace.sample_free(1, 0)[0])
    return Given(oracle, max_bytes, _given.draw_pairs(oracle, goals, 50, 1), 0, True)


def test_the_polygon_is_exact():
    problem = scenes.maze()
    brute, x = BruteDistance(MAZE, goal := problem.goals[0]), problem.workspace.sample_free(5_000, 3)
    y = np.tile(goal, (len(x), 1))
    for _, summary in _polygons.exact(given(problem.workspace, 1_024)):
        assert summary.num_bytes == 4 * 28
        np.testing.assert_allclose(summary(x, y), brute(x), rtol=0, atol=1e-6)
        np.testing.assert_allclose(summary(y, x), brute(x), rtol=0, atol=1e-6)


def test_lists_of_corners_tell_the_exact_distances():
    known = given(scenes.thin_maze().workspace, 1_024)
    x, goals = known.workspace.sample_free(2_000, 1), known.workspace.sample_free(5, 2)
    expected = [BruteDistance(THIN_MAZE, goal)(x) for goal in goals]
    np.testing.assert_allclose(known.fields(x)(goals), expected, atol=1e-9)


def test_greedy_spanners_keep_what_they_must():
    triangle = Graph(np.array([(0.0, 0.0), (1.0, 0.0), (0.5, 0.4)]), np.array([(0, 1), (1, 2), (2, 0)]))
    assert _polygons.greedy_spanner(triangle, 1.5).num_edges == 2  # around the long side, 1.28 times as far
    assert _polygons.greedy_spanner(triangle, 1.25).num_edges == 3
    points = np.random.default_rng(0).random((40, 2))
    complete = Graph(points, np.argwhere(np.triu(np.ones((40, 40)), 1)))
    for stretch in (1.1, 1.5, 3.0):
        kept = _polygons.greedy_spanner(complete, stretch)
        ratio = shortest_path(kept.adjacency) / (np.linalg.norm(points[:, None] - points, axis=2) + np.eye(40))
        assert 1.0 < ratio.max() <= stretch * (1 + 1e-12) and kept.num_edges < complete.num_edges


def test_spanners_count_the_bits_of_their_edges():
    assert _polygons._edge_bits(4, 3) == 5  # 20 ways to take 3 of 6
    assert _polygons._edge_bits(4, 6) == 0


def test_spanners_are_never_below_the_truth():
    known = given(scenes.maze().workspace, 1_024)
    pairs = known.training
    for _, summary in _polygons.spanners(known):
        error = summary(pairs.x, pairs.y) - pairs.distance
        assert error.min() > -1e-6 and (error < 2 * pairs.distance + 1e-6).all()


def test_grids_interpolate_between_free_nodes():
    grid = _node_tables.grid_of(SQUARE, 20)
    table = np.stack([grid.free @ [1.0, 2.0], np.full(len(grid.free), 3.0)], axis=1)[grid.nearest]
    for x in np.random.default_rng(0).random((50, 2)):
        np.testing.assert_allclose(grid.read(table, x), [x @ [1.0, 2.0], 3.0], atol=1e-5)
    walled = Workspace(((0, 0), (1, 1)), [[(0.4, 0.0), (0.6, 0.0), (0.6, 0.9), (0.4, 0.9)]])
    grid = _node_tables.grid_of(walled, 81)  # 9 by 9
    assert grid.shape == (9, 9) and len(grid.free) == 81 - 8  # x = 0.5, below y = 0.9
    assert walled.is_free(grid.free).all()
    inside = np.ravel_multi_index((4, 0), (9, 9))
    assert np.abs(grid.free[grid.nearest[inside]] - [0.5, 0.0]).max() == 0.125
    assert grid.table_bytes(2, 12) == 16 + 11 + 2 * (8 + -(-73 * 12 // 8))


def test_the_finest_grid_fits():
    for max_bytes in (200, 1_000, 5_000):
        grid = _node_tables.finest_grid(SQUARE, lambda grid: grid.table_bytes(1, 8), max_bytes)
        assert 0.8 * max_bytes < grid.table_bytes(1, 8) <= max_bytes
    assert _node_tables.finest_grid(SQUARE, lambda grid: grid.table_bytes(1, 8), 20) is None


@pytest.mark.parametrize("bits", [8, 16])
def test_rounding_moves_by_half_a_step(bits):
    values = np.random.default_rng(0).normal(size=(1_000, 3)) * [1, 10, 0]
    moved = np.abs(_node_tables.rounded(values, bits) - values).max(axis=0)
    assert (moved <= 0.5 * np.ptp(values, axis=0) / (2**bits - 1) + 1e-6).all() and moved[1] > 0


def test_fastmap_keeps_the_distances_of_the_plane():
    known = given(SQUARE, 1_024)
    points = SQUARE.sample_free(200, 2)
    placed = _embeddings.fastmap(known, points, 3)
    between = np.linalg.norm(points[:, None] - points, axis=2)
    np.testing.assert_allclose(np.linalg.norm(placed[:, None] - placed, axis=2), between, atol=1e-6)
    assert np.abs(placed[:, 2]).max() < 1e-6


def test_landmarks_bound_and_are_spread():
    known = given(scenes.maze().workspace, 4_096)
    chosen = _landmarks._Landmarks(known)
    first, second = chosen.graph.vertices[_landmarks._farthest(known, chosen.graph.vertices, 2)]
    assert known.exact.with_goal(first)(second[None])[0] > 2  # the maze's ends
    greedy = _landmarks._greedy(known, chosen.graph.vertices, chosen.pairs, 3)
    errors = [chosen._error(*(known.fields(end)(greedy[:n]) for end in chosen.pairs[:2])) for n in (1, 2, 3)]
    assert errors[0] > errors[1] > errors[2]


def test_avoid_goes_down_the_heaviest_branch_without_a_landmark():
    """Root 0 with branches 1-2-3 and 4-5."""
    parents, distances = np.array([-9999, 0, 1, 2, 0, 4]), np.array([0.0, 1, 2, 3, 1, 2])
    weight = np.array([0.0, 1, 1, 1, 2, 2])
    assert _landmarks._worst_leaf(distances, parents, weight, set(), 0) == 5
    assert _landmarks._worst_leaf(distances, parents, weight, {5}, 0) == 3


def test_shares_between_bounds_fit():
    lower, upper = np.zeros(50), np.full(50, 2.0)
    assert _landmarks._best_share(lower, upper, np.full(50, 0.5)) == 0.25
    assert _landmarks._best_share(lower, upper, lower) == 0


def test_networks_are_symmetric_and_not_below_the_straight_line():
    known = given(SQUARE, 1_024)
    ((_, summary),) = _network.candidates(known)
    x, y, _ = known.training
    answer = np.asarray(summary(x, y))
    np.testing.assert_allclose(answer, summary(y, x), atol=1e-6)
    assert (answer >= np.linalg.norm(x - y, axis=1) - 1e-6).all() and 0.8 * 1_024 < summary.num_bytes <= 1_024


def test_errors_are_those_of_each_side():
    found = compare_summaries.errors(np.array([1.0, 2.5, 2.0, 4.00001]), np.array([1.0, 2.0, 3.0, 4.0]))
    assert found["mean"] == pytest.approx(1.50001 / 4) and found["largest"] == 1 and found["pairs"] == 4
    assert found["below"] == found["above"] == 0.25 and found["share"] == pytest.approx(1.50001 / 10)


def test_pairs_are_free_exact_and_drawn_once():
    exact = VisibilityGraph(problem := scenes.maze().workspace, (0.06, 0.07))
    pairs = _given.draw_pairs(exact, 30, 10, 5)
    assert len(np.unique(pairs.y, axis=0)) == 30 and len(np.unique(pairs.x, axis=0)) == 300
    assert problem.is_free(pairs.x).all() and problem.is_free(pairs.y).all()
    for x, y, distance in zip(*(column[:20] for column in pairs), strict=True):
        assert BruteDistance(MAZE, y)(x[None])[0] == pytest.approx(distance, abs=1e-9)
    again, other = _given.draw_pairs(exact, 30, 10, 5), _given.draw_pairs(exact, 30, 10, 6)
    np.testing.assert_array_equal(again.x, pairs.x)
    assert not np.isin(other.x, pairs.x).any()


def test_published_lengths_are_those_of_the_arena(data_dir, monkeypatch):
    monkeypatch.setenv("PLR_JAX_DATA", str(data_dir))
    pairs = _given.published("arena")
    assert isinstance(pairs, Pairs) and len(pairs.distance) == 160 and _given.published("maze") is None
    assert (pairs.distance >= np.linalg.norm(pairs.x - pairs.y, axis=1) - 1e-4).all()
