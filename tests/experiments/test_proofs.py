"""What is proven of PLRs, section by section at its smallest, and the brute-force distances beside the oracle's."""

import json
import math
from functools import cache

import numpy as np
import pytest
import shapely

from experiments import _proof_tables, proofs
from experiments._sections import figures_of
from experiments.baselines._brute_distance import MAZE, THIN_MAZE, BruteDistance
from experiments.proving import _astar, _bounds, _hard_points, _plain, _slivers, _speed, _worst_points
from plr_jax import VisibilityGraph, Workspace, construct, scenes


@cache
def smoke(name):
    """Results of a section at its smallest, as they come back from a file; it is measured once."""
    return json.loads(json.dumps(proofs.SECTIONS[name].measure(0, True), allow_nan=False))


@pytest.mark.parametrize("name", proofs.SECTIONS)
def test_text_and_figures_come_from_the_results_alone(name, tmp_path):
    assert len(proofs.SECTIONS[name].table(smoke(name)).splitlines()) >= 3
    for path in figures_of(proofs.SECTIONS[name], smoke(name), tmp_path):
        assert path.stat().st_size > 10_000


@pytest.mark.parametrize(("scene", "walls"), [("maze", MAZE), ("thin_maze", THIN_MAZE)])
def test_brute_force_agrees_with_the_oracle(scene, walls):
    problem = getattr(scenes, scene)()
    workspace, goal = problem.workspace, problem.goals[0]
    brute, oracle = BruteDistance(walls, goal), VisibilityGraph(workspace, goal)
    x = workspace.sample_free(20_000, 3)
    np.testing.assert_allclose(brute(x), oracle(x), rtol=0, atol=1e-9)
    grid = workspace.bounds.grid(97).reshape(-1, 2)
    assert (np.isinf(brute(grid)) == np.isinf(oracle(grid))).all()


def test_brute_force_goes_around_a_box_as_by_hand():
    brute = BruteDistance([(0.4, -1.0, 0.6, 0.5)], np.array([0.1, 0.5]))
    around = math.hypot(0.3, 0.0) + 0.2 + math.hypot(0.3, 0.4)
    x = np.array([(0.9, 0.1), (0.9, 0.5), (0.5, 0.3), (0.1, 0.2)])
    np.testing.assert_allclose(brute(x), [around, 0.8, np.inf, 0.3], atol=1e-11)


def test_errors_found_are_just_below_those_proven():
    for row in smoke("sizes")["rows"]:
        assert row["bytes"] <= row["budget"]
        assert row["mean"] < row["largest_of_points"] <= row["largest_found"] <= row["proven"]
        assert row["proven_to_found"] < 1.1
        assert 0 < row["seconds_oracle"] < row["seconds"]
    assert [row["leaf"] for row in smoke("sizes")["rows"]] == ["cone", "plane", "continuous"]


def test_noise_is_small_normal_and_the_same_at_the_same_point():
    problem = scenes.maze()
    oracle = VisibilityGraph(problem.workspace, problem.goals[0])
    x = problem.workspace.sample_free(20_000, 1)
    noisy = _plain.with_noise(oracle, 1e-3)
    noise = (noisy(x) - oracle(x)) / 1e-3
    np.testing.assert_array_equal(noisy(x[::-1])[::-1], noisy(x))
    assert abs(noise.mean()) < 0.03 and abs(noise.std() - 1) < 0.03
    assert abs(np.corrcoef(noise[1:], noise[:-1])[0, 1]) < 0.03
    assert np.isclose((np.abs(noise) < 1).mean(), 0.683, atol=0.02)


def test_cones_are_found_from_values_alone():
    cone, plane = (row for row in smoke("plain")["rows"] if row["noise"] == 0)
    assert cone["leaf"] == "cone" and plane["leaf"] == "plane"
    assert cone["mean"] < plane["mean"] / 2


def test_cones_are_timed_beside_planes():
    speed = smoke("speed")
    assert _speed.cone_over_plane(speed["queries"]).keys() == {128}
    assert {(row["map"], row["leaf"]) for row in speed["builds"]} == {("maze", "cone"), ("maze", "plane")}
    assert all(row["seconds"][0] > 0 for row in speed["builds"])


def test_the_search_for_the_largest_error_meets_a_peak_that_samples_miss():
    """A PLR of one plane of the cone above a goal errs most at the goal."""
    oracle = VisibilityGraph(Workspace(((0, 0), (1, 1))), (0.37, 0.41))
    plr = construct(oracle, oracle.workspace.bounds, max_leaves=1)
    x = np.array([[0.9, 0.9]])
    errors = np.abs(np.asarray(plr(x), float) - oracle(x))
    found = _worst_points.largest_found(plr, oracle, x, errors, smoke=True)
    assert found == pytest.approx(max(float(plr(oracle.goal)), *_corner_errors(plr, oracle)), rel=1e-3)


def _corner_errors(plr, oracle):
    corners = np.array([(0, 0), (0, 1), (1, 0), (1, 1)], float)
    return np.abs(np.asarray(plr(corners), float) - oracle(corners))


def test_no_bound_is_broken():
    results = smoke("bounds")
    assert {row["truth"] for row in results["rows"]} == {"oracle", "brute force"}
    for row in [*results["rows"], *smoke("slivers")["totals"].values()]:
        assert row["points"] > 1_000 and row["violations"] == 0
    assert not smoke("slivers")["refused"]
    assert all(row["violations"] == 0 for row in smoke("bands")["rows"])


def test_a_bound_that_is_broken_is_counted():
    problem = scenes.maze()
    oracle = VisibilityGraph(problem.workspace, problem.goals[0])
    plrs = _bounds.certified(oracle, problem.workspace, 512, 0)
    rng = np.random.default_rng(0)
    further = {"further": lambda x: oracle(x) + 0.5}
    for row in _bounds.violations(problem.workspace, problem.goals[0], plrs, further, 2_000, rng):
        assert row["violations"] + row["by_tolerance"] == row["points"] > 0 and row["worst"] > 0.3
        assert len(row["examples"]) == 3 and row["examples"][0]["distance"] > row["examples"][0]["bounds"][1]


def test_points_that_reach_the_goal_by_tolerance_alone_are_told_apart():
    """Two rooms that touch in a point, as walls do: the goal is in one of them."""
    walls = [[(0, 0.5), (0.5, 0.5), (0.5, 1), (0, 1)], [(0.5, 0), (1, 0), (1, 0.5), (0.5, 0.5)]]
    goal = np.array([0.2, 0.2])
    x = shapely.points([(0.4, 0.4), (0.5, 0.5), (0.5 + 1e-10, 0.5 + 1e-10), (0.9, 0.9), (0.2, 0.5 + 1e-12)])
    part = _bounds.part_of_goal(Workspace(((0, 0), (1, 1)), walls), goal)
    np.testing.assert_array_equal(shapely.covers(part, x), [True, True, False, False, False])
    part = _bounds.part_of_goal(Workspace(((0, 0), (1, 1)), walls, squeeze=True), goal)
    np.testing.assert_array_equal(shapely.covers(part, x), [True, True, True, True, False])


def test_hard_points_are_free_and_near_walls():
    workspace = scenes.maze().workspace
    oracle = VisibilityGraph(workspace, (0.06, 0.07))
    plr = construct(oracle, workspace.bounds, max_leaves=16)
    x = _hard_points.mixed_points(workspace, [plr], 6_000, np.random.default_rng(0))
    assert workspace.is_free(x).all()
    clearance = np.abs(workspace.clearance(x))
    assert ((clearance > 0) & (clearance < 1e-6)).mean() > 0.05


def test_random_maps_have_slivers_and_come_back():
    narrowest = []
    for number in range(8):
        workspace, goal = _slivers.random_workspace(np.random.default_rng([5, number]))
        again, _ = _slivers.random_workspace(np.random.default_rng([5, number]))
        assert workspace.free_space.equals_exact(again.free_space)
        assert workspace.is_free(goal[None])[0]
        edges = np.linalg.norm(np.diff(workspace.boundary.segments, axis=1), axis=2)
        narrowest.append(edges.min() / workspace.bounds.width.max())
    assert min(narrowest) < 1e-3


def test_a_star_under_lower_bounds_is_optimal():
    rows = {row["heuristic"]: row for row in smoke("astar")["rows"]}
    for name, row in rows.items():
        if "itself" not in name:
            assert row["not_optimal"] == 0 and row["largest_over"] <= 1e-9
    assert rows["exact"]["to_straight"] < rows["straight line"]["to_straight"] == 1
    assert rows["cone, lower, and straight line"]["to_straight"] < 1


def test_a_star_crosses_an_open_grid_as_by_hand():
    rng = np.random.default_rng(3)
    grid = _astar.random_grid(Workspace(((0, 0), (1, 1))), rng)
    a, b = 0, len(grid.points) - 1
    step = np.abs(np.diff(grid.points, axis=0)).max(axis=0)
    count = np.rint(np.abs(grid.points[b] - grid.points[a]) / step.min())
    expected = step.min() * (np.sqrt(2) * count.min() + np.ptp(count))
    cost, expanded, nodes = _astar.a_star(grid, a, b, [0.0] * len(grid.points))
    assert cost == pytest.approx(expected) and nodes <= expanded <= len(grid.points)


def test_gradients_of_cones_point_the_way():
    angles = {row["leaf"]: row["angles"]["0.5"] for row in smoke("gradient")["rows"]}
    assert angles["cone"] < 1e-3 < angles["continuous"] < angles["plane"]


def test_theorem_2_is_refuted_and_what_is_proven_holds():
    results = smoke("theorem2")
    assert results["line"]["fitted"][0] == pytest.approx(-1 / 6)
    assert results["nearly_on_a_line"]["error"] > 5 * results["nearly_on_a_line"]["bound"]
    found = results["maps"]["maze"]["beyond_range"]
    worst = found["worst"]
    assert found["proven_hold"] and found["plr_beyond"] > 0
    assert not worst["range"][0] <= worst["answer"] <= worst["range"][1]
    assert worst["proven"][0] <= worst["distance"] <= worst["proven"][1]
    assert results["maps"]["maze"]["paper_partition"]["proven_violations"] == 0


def test_readme_tables_count_what_the_results_have():
    results = {name: smoke(name) for name in ("sizes", "bounds", "slivers", "astar")}
    oracles = {"maps": {"maze": {"vertices": 28}, "arena": {"skipped": "absent"}}}
    lines = _proof_tables.proofs(results, oracles).splitlines()
    assert "maze 112 bytes" in lines[-1]
    assert len([line for line in lines if line.startswith("|")]) == 2 + len(results["sizes"]["rows"])
    text = _proof_tables.proof_checks(results)
    assert "| maze | brute force |" in text and " 0 paths that are not optimal" in text
