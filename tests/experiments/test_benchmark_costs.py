"""The sections on construction, exact oracles, heuristics, cold starts and growth, at their smallest."""

import importlib.util
import itertools
import json
import math
import sys
from types import SimpleNamespace

import numpy as np
import pytest
import shapely

from experiments._sections import figures_of
from experiments.benchmarks import _cold_start, _construct, _growth, _heuristic, _oracle
from plr_jax import VisibilityGraph, Workspace, construct, scenes, sum_of_distances
from plr_jax.plr.sampling import cell_fit

SECTIONS = {
    "oracle": _oracle,
    "construct": _construct,
    "heuristic": _heuristic,
    "cold_start": _cold_start,
    "growth": _growth,
}


def has(*modules):
    return all(importlib.util.find_spec(module) for module in modules)


@pytest.fixture(scope="module")
def measured():
    """Results of a section as they come back from its file; it is measured once."""
    results = {}

    def of(section):
        if section not in results:
            measured = SECTIONS[section].measure(0, True)
            results[section] = json.loads(json.dumps(measured, allow_nan=False))
        return results[section]

    return of


@pytest.mark.parametrize("section", SECTIONS)
def test_table_and_figures_need_the_results_alone(section, measured, tmp_path):
    results = measured(section)
    assert SECTIONS[section].table(results).endswith("\n")
    for path in figures_of(SECTIONS[section], results, tmp_path):
        assert path.name.startswith(f"benchmark_{section}") and path.stat().st_size > 0


def test_oracle_measures_ours_and_says_why_a_rival_is_absent(measured, monkeypatch):
    for row in measured("oracle")["maps"].values():
        assert row["seconds_prepare"] > 0 and all(x > 0 for x in row["microseconds_a_point"].values())
        assert row["rivals"].keys() == set(_oracle.RIVALS)
        for outcome in row["rivals"].values():
            assert "skipped" in outcome or (outcome["largest_difference"] < 1e-9 and outcome["version"])
    oracle = VisibilityGraph(*_oracle.polygon_field(16, 0))
    monkeypatch.delenv(_oracle.RIVALS_PYTHON, raising=False)
    assert "names no Python" in _oracle._rival("pyvisgraph", oracle, 0, None)["skipped"]
    monkeypatch.setenv(_oracle.RIVALS_PYTHON, "/no/such/python")
    assert "cannot be run" in _oracle._rival("pyvisgraph", oracle, 0, None)["skipped"]
    assert "over the limit" in _oracle._rival("pyvisgraph", oracle, 0, "a smaller map")["skipped"]


@pytest.mark.parametrize(
    ("script", "reason"),
    [("import time; time.sleep(60)", "over the limit"), ("raise KeyError(7)", "failed: KeyError")],
)
def test_a_rival_that_takes_too_long_or_crashes_is_recorded_so(script, reason, monkeypatch, tmp_path):
    python = tmp_path / "python"
    python.write_text(f'#!/bin/sh\nexec "{sys.executable}" -c "{script}"\n')
    python.chmod(0o755)
    monkeypatch.setenv(_oracle.RIVALS_PYTHON, str(python))
    monkeypatch.setattr(_oracle, "RIVAL_LIMIT", 2.0)
    oracle = VisibilityGraph(*_oracle.polygon_field(16, 0))
    assert reason in _oracle._rival("pyvisgraph", oracle, 0, None)["skipped"]


def test_octagons_are_disjoint_and_all_their_corners_stand_out():
    workspace, goal = _oracle.polygon_field(300, seed=3)
    holes = list(workspace.free_space.interiors)
    assert len(holes) == 300 // 8 and all(len(hole.coords) == 9 for hole in holes)
    polygons = [shapely.Polygon(hole) for hole in holes]
    assert all(polygon.equals(polygon.convex_hull) for polygon in polygons)
    assert workspace.is_free(goal[None])[0]
    assert len(workspace.boundary.vertices) == 8 * len(holes) + 4


@pytest.mark.parametrize("workspace", [scenes.maze().workspace, _oracle.polygon_field(40, 0)[0]])
def test_obstacles_in_a_slit_frame_leave_the_same_free_space(workspace):
    obstacles = _oracle._obstacles(workspace.free_space, 1.0)
    assert all(not obstacle.interiors for obstacle in obstacles)
    within = shapely.difference(shapely.box(*workspace.free_space.bounds), shapely.union_all(obstacles))
    assert shapely.symmetric_difference(within, workspace.free_space).area < 1e-6


def test_rivals_get_obstacles_that_overlap_where_ours_touch():
    squares = [[(1, 1), (2, 1), (2, 2), (1, 2)], [(2, 2), (3, 2), (3, 3), (2, 3)]]
    polygons = _oracle._polygons(Workspace(((0, 0), (4, 4)), squares), np.array([0.5, 0.5]))
    assert len(polygons["holes"]) == 1
    apart = _oracle._polygons(Workspace(((0, 0), (4, 4)), squares[:1]), np.array([0.5, 0.5]))
    assert sorted(map(tuple, apart["holes"][0])) == sorted(map(tuple, np.array(squares[0], float).tolist()))


def test_construct_measures_errors_and_shares(measured):
    results = measured("construct")
    assert {row["function"] for row in results["rows"]} == {"cone", "maze, visibility graph"}
    for row in results["rows"]:
        assert 0 < row["seconds"] < math.inf and 0 < row["mean"] < row["max"] < 0.2 and row["samples"] > 0
        assert sum(row["shares"].values()) == pytest.approx(1)
        assert row["shares"].keys() == {"oracle", "fit", "bookkeeping"} and min(row["shares"].values()) > 0
    assert results["tasks"]["maze"]["max"] <= results["tasks"]["maze"]["allowed"]


def test_shares_count_for_the_innermost_part_under_way(monkeypatch):
    clock = iter(range(1_000_000))
    monkeypatch.setattr(_construct, "time", SimpleNamespace(perf_counter=lambda: next(clock)))

    def oracle():
        for _ in range(300):
            abs(-1)

    source = "def fit(oracle):\n    for _ in range(100):\n        abs(-1)\n    oracle()\n"
    in_fit = {}
    exec(compile(source, cell_fit.__file__, "exec"), in_fit)

    def build():
        in_fit["fit"](oracle)
        for _ in range(600):
            abs(-1)

    # Every call and every return takes one tick.
    parts = _construct.shares(build, oracle.__code__)
    assert parts == pytest.approx({"oracle": 0.3, "fit": 0.1, "bookkeeping": 0.6}, abs=0.005)
    assert sys.getprofile() is None


def test_fewest_leaves_is_the_first_that_is_good_enough():
    tried = []

    def error(leaves):
        tried.append(leaves)
        return 10 / leaves

    assert _construct.fewest_leaves(error, 0.2) == tried[-1] >= 50
    assert tried[-2] < 50 and all(b <= math.ceil(1.05 * a) for a, b in itertools.pairwise(tried))


def test_heuristic_measures_every_contender_or_says_why_not(measured):
    results = measured("heuristic")
    for row in results["rows"]:
        assert row["bytes"] > 0 and row["mean"] > 0
        names = {**row["distances_a_second"], **row["calls_a_second"], **results["skipped"]}
        assert names.keys() == {
            _heuristic.SUM,
            _heuristic.TERMS,
            _heuristic.IN_JIT,
            _heuristic.LOOP,
            _heuristic.CALLBACK,
            _heuristic.FLOOR,
        }
        rates = [rate for rates in row["distances_a_second"].values() for rate in rates.values()]
        assert all(0 < rate < math.inf for rate in [*rates, *row["calls_a_second"].values()])


@pytest.fixture(scope="module")
def team():
    """PLRs of three robots, and joint configurations."""
    goals = [(0.1, 0.2), (0.9, 0.8), (0.4, 0.6)]
    domain = ((0.0, 0.0), (1.0, 2.0))
    plrs = [
        construct(lambda x, g=g: np.hypot(*(x - g).T), domain, max_leaves=20 + 9 * k) for k, g in enumerate(goals)
    ]
    return plrs, np.random.default_rng(0).random((501, 3, 2)) * (1.0, 2.0)


@pytest.mark.skipif(not has("numba", "ompl"), reason="needs numba and ompl")
def test_the_loop_and_the_callback_answer_as_the_heuristic_does(team):
    from experiments.benchmarks._scalar_heuristic import Callback, ScalarTables, sums

    plrs, q = team
    tables = ScalarTables(plrs)
    expected = sum_of_distances(plrs)(q)
    np.testing.assert_allclose(sums(q, tables.address), expected, rtol=1e-5)
    callback = Callback(q, tables)
    assert callback.num_calls == len(q) - 1
    assert callback() == pytest.approx(expected[1:].sum(), rel=1e-5)
    assert Callback(q, None)() == 0
    corner = np.broadcast_to([1.0, 2.0], (1, 3, 2))
    np.testing.assert_allclose(sums(corner.copy(), tables.address), sum_of_distances(plrs)(corner), rtol=1e-5)
    assert np.isinf(sums(q[:1] + 2, tables.address)[0])


def test_the_sum_within_jit_is_that_of_the_heuristic(team):
    plrs, q = team
    np.testing.assert_allclose(_heuristic._sum_in_jit(plrs, q), sum_of_distances(plrs)(q), rtol=1e-5)
    again = _heuristic.team_of(plrs, 5)
    assert [plr.num_leaves for plr in again] == [plrs[i % 3].num_leaves for i in range(5)]
    assert again[0].tables.leaf_of_slot is not again[3].tables.leaf_of_slot


def test_cold_starts_are_positive(measured):
    rows = measured("cold_start")["rows"]
    assert all(0 < row["least"] <= row["total"] <= row["most"] < 100 for row in rows.values())
    assert {"import jax", "import plr_jax", "first query", "first query, cached"} <= rows.keys()


def test_phases_of_a_cold_start_are_summed_up():
    runs = [{"total": t, "plan": t / 2} for t in (3.0, 1.0, 2.0)]
    assert _cold_start._summary(runs) == {"total": 2.0, "plan": 1.0, "least": 1.0, "most": 3.0}


def test_growth_has_a_finite_exponent_for_every_cost(measured):
    curves = measured("growth")["curves"]
    assert curves.keys() == _growth._CURVES.keys()
    for curve in curves.values():
        assert len(curve["sizes"]) == len(curve["seconds"]) >= 2
        assert min(curve["seconds"]) > 0 and math.isfinite(curve["exponent"])


def test_the_exponent_is_that_of_the_upper_half():
    sizes = [1, 10, 100, 1_000, 10_000]
    power = _growth.fit(sizes, [5.0, 5.0, *(0.5 * n**1.5 for n in sizes[2:])])
    assert power == pytest.approx((1.5, 0.5, 100))
    assert _growth.fit([2, 3, 4, 8], [9, 3, 16, 64])[:2] == pytest.approx((2, 1))
