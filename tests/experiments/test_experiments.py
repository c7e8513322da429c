"""Every experiment runs at its smallest setting; committed results are those of this code."""

import os
import runpy
import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from experiments import _planning, figures, paper_query, portable, readme_tables, sba_star, table1, table2, threshold
from experiments._browser import chromium
from experiments._nearest_vertex import NearestVertex
from experiments._runner import RESULTS, WHOLE, read
from experiments.benchmarks import _accuracy, _query
from experiments.benchmarks._maps import load_map
from plr_jax import Roadmap, VisibilityGraph, construct, exact_lower_bound, scenes

pytestmark = pytest.mark.full

ROOT = Path(__file__).parents[2]
SCRIPTS = sorted({path.stem for path in (ROOT / "experiments").glob("[!_]*.py")} - {"readme_tables"})


@pytest.mark.parametrize("name", SCRIPTS)
def test_all_sections_of_an_experiment_run_at_their_smallest(name, tmp_path, monkeypatch):
    """Run each experiment in this process, where most functions are compiled already."""
    options = ["--only", "bits"] if name == "page" and chromium() is None else []
    monkeypatch.setattr(sys, "argv", [name, "--smoke", "--output", str(tmp_path), *options])
    monkeypatch.delitem(sys.modules, f"experiments.{name}", raising=False)  # imported by another experiment
    script = runpy.run_module(f"experiments.{name}", run_name="__main__")
    record = read(tmp_path, name)
    assert record["smoke"] and record["experiment"] == name
    assert {"versions", "device", "cores", "dtype", "seed"} <= record.keys()
    assert all(part["date"] for part in record["measured"].values())
    if "PLR_JAX_DATA" in os.environ:
        assert all(record["results"].values())  # no part was skipped
    parts = set(options[1:]) or set(script.get("SECTIONS", [WHOLE]))
    assert record["measured"].keys() == parts


def test_scripts_and_committed_results_match():
    for name in SCRIPTS:
        record = read(RESULTS, name)
        script = import_module(f"experiments.{name}")
        assert record["experiment"] == name and not record["smoke"]
        assert record["results"].keys() <= getattr(script, "SECTIONS", record["results"]).keys()
    paths = readme_tables.README, readme_tables.ALL_RESULTS, readme_tables.PAPER
    page = "".join(path.read_text() for path in paths)
    for path in RESULTS.iterdir():
        assert path.stem in SCRIPTS if path.suffix == ".json" else f"results/{path.name})" in page, path.name


def test_readme_tables_hold_the_committed_results(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["readme_tables", "--check"])
    readme_tables.main()
    paths = readme_tables.README, readme_tables.ALL_RESULTS, readme_tables.PAPER
    pages = "".join(path.read_text() for path in paths)
    assert all(f"<!-- table:{name} -->" in pages for name in readme_tables.TABLES)
    old = tmp_path / "README.md"
    old.write_text("<!-- table:descent -->\nold\n<!-- /table -->\n")
    monkeypatch.setattr(readme_tables, "README", old)
    with pytest.raises(SystemExit, match="out of date"):
        readme_tables.main()
    assert "old" in old.read_text()


def test_results_with_invalid_paths_are_refused():
    readme_tables.require_valid("race", {"trials": [{"valid": None}, {"improved_valid": [True, True]}]})
    with pytest.raises(ValueError, match=r"race\.trials\.0\.valid: a path is not valid"):
        readme_tables.require_valid("race", {"trials": [{"valid": False}]})


def results_of(name):
    return read(RESULTS, name)["results"]


def assert_close(computed, committed):
    """Compare numbers to 2 %, names and files exactly, but neither seconds nor sizes of compiled code."""
    assert computed.keys() == committed.keys()
    for key in computed.keys() - {"seconds", "c_bytes"}:
        is_number = isinstance(committed[key], int | float)
        assert computed[key] == (pytest.approx(committed[key], rel=0.02) if is_number else committed[key]), key


@pytest.mark.parametrize(("name", "leaf"), [("maze", "continuous"), ("floor_plan", "smooth"), ("maze", "cone")])
def test_table_of_leaves_has_bytes_and_errors_of_this_code(name, leaf, tmp_path):
    results, (workspace, goal) = results_of("portable")["leaves"], load_map(name)
    (committed,) = (row for row in results["rows"] if (row["map"], row["leaf"]) == (name, leaf))
    x = workspace.sample_free(results["points"], 0)
    computed = portable.leaf_row(VisibilityGraph(workspace, goal), leaf, x, 0, tmp_path / "header")
    assert_close({"map": name, **computed}, committed)


def accuracy_of(name, workspace, exact):
    """Return the committed rows by contender, and the points of the errors with their distances."""
    results = results_of("benchmark")["accuracy"]
    rows = {row["contender"]: row for row in results["maps"][name] if row["budget"] == 6_144}
    return rows, *_accuracy.reachable_points(workspace, exact, results["points"], _accuracy.POINT_SEED)


@pytest.mark.parametrize("name", ["maze", "den312d"])
def test_table_of_rivals_has_bytes_and_errors_of_this_code(name):
    loaded = load_map(name)
    if loaded is None:
        pytest.skip("PLR_JAX_DATA names no folder with this map")
    workspace, goal = loaded
    exact = VisibilityGraph(workspace, goal)
    committed, x, distance = accuracy_of(name, workspace, exact)
    for contender, leaf in (("PLR, planes", "plane"), ("PLR, continuous", "continuous")):
        plr = _accuracy.make_plr(leaf, _accuracy.Oracle(exact), workspace, 6_144, 0)
        computed = {"bytes": plr.num_bytes, "resident_bytes": plr.answer.resident_bytes}
        assert_close(computed, {key: committed[contender][key] for key in computed})
        assert_close(_accuracy.summary(np.abs(plr.on_host(x) - distance)), committed[contender]["free"])


def test_cones_and_speed_on_the_maze_have_bytes_and_errors_of_this_code():
    workspace, goal = load_map("maze")
    exact = VisibilityGraph(workspace, goal)
    committed, x, distance = accuracy_of("maze", workspace, exact)
    plr = _accuracy.make_plr("cone", _accuracy.Oracle(exact), workspace, 6_144, 0)
    assert_close(_accuracy.summary(np.abs(plr.on_host(x) - distance)), committed["PLR, cones"]["free"])
    plr = construct(exact, workspace.bounds, max_bytes=_query.MAX_BYTES, seed=0)
    grid = _query.makers(plr, exact, 100_000, 0, 0)["grid, JAX"]()
    x = workspace.sample_free(20_000, _query.POINT_SEED)
    rows = results_of("benchmark")["query"]["plane"]["rows"]
    for rival, row in ((_accuracy.Rival(plr.num_bytes, plr, True), "PLR, planes"), (grid, "grid, JAX")):
        assert_close({"bytes": rival.num_bytes, **_query.errors(rival, exact, x)}, rows[row])


@pytest.mark.parametrize("name", table1.SCENES)
def test_table1_has_bytes_and_errors_of_this_code(name):
    """Compute the first and the last row of each scene again."""
    results = results_of("table1")
    rows = {(row["method"], row["configuration"]): row for row in results["rows"] if row["scene"] == name}
    scene = table1.Scene(name, results["points"], results["roadmap_samples"])
    assert rows.keys() == scene.rows.keys()
    for key in [next(iter(rows)), list(rows)[-1]]:
        committed = rows[key]["seeds"][0]
        assert_close(scene.measure(*key, committed["seed"]), committed)


def test_paper_query_has_bytes_and_errors_of_this_code(tmp_path):
    """Compute the rows of PLRs and of lookups in trees again; code sizes depend on the compiler."""
    rows = {(row["method"], row["query"]): row for row in results_of("paper_query")["goal"]}
    roadmap = Roadmap.from_workspace(paper_query.WORKSPACE, paper_query.GOAL, 1_000)
    contenders = paper_query.roadmap_contenders(NearestVertex(roadmap), paper_query.AStar(roadmap), 0)
    lookups = [each for each in contenders if each.vectorized is None]
    x, exact = paper_query.WORKSPACE.sample_free(1_000_000, paper_query.POINT_SEED), paper_query.prepared_graph()
    for contender in (*paper_query.summaries(paper_query.SUMMARISED, 0, tmp_path), *lookups):
        row = rows[contender.method, contender.query]
        computed = paper_query.errors(contender, exact, x)
        assert_close(computed, {error: row[error] for error in computed})
        if contender.query in ("JAX", "tree, SciPy"):
            assert contender.num_bytes == row["bytes"]


def test_searches_in_a_roadmap_agree_with_its_tree():
    roadmap = Roadmap.from_workspace(paper_query.WORKSPACE, paper_query.GOAL, 200)
    nearest, x = NearestVertex(roadmap), paper_query.WORKSPACE.sample_free(20, seed=1)
    for contender in paper_query.roadmap_contenders(nearest, paper_query.AStar(roadmap), 0):
        if contender.vectorized is not None:
            one_by_one = np.concatenate([contender.answer(point[None]) for point in x])
            np.testing.assert_allclose(one_by_one, contender.vectorized(x))
    pairs = np.concatenate([x, x[::-1]], axis=1)
    a_star, table = paper_query.pair_contenders(nearest, paper_query.AStar(roadmap), 0)
    np.testing.assert_allclose(a_star.answer(pairs), table.answer(pairs), rtol=1e-6)


def test_threshold_has_bytes_and_errors_of_this_code():
    results, share = results_of("threshold"), threshold.THRESHOLDS[0]
    committed = [row for row in results["rows"] if (row["map"], row["threshold"]) == ("maze", share)]
    computed = threshold.measure("maze", share, 0, results["points"])
    for computed_row, committed_row in zip(computed, committed, strict=True):
        assert_close(computed_row, committed_row)


def test_fig1_shows_the_file_of_this_code():
    assert_close(figures.surface(0, smoke=False), results_of("figures")["surface"])


@pytest.mark.parametrize("heuristic", [table2.LATTICE, _planning.POINT_PLR])
@pytest.mark.parametrize("name", ["single door", "cross 3"])
def test_table2_has_nodes_and_costs_of_this_code(name, heuristic):
    results = results_of("table2")
    committed = next(row for row in results["rows"] if (row["scene"], row["heuristic"]) == (name, heuristic))
    problem = scenes.perturbed(_planning.SCENES[name](), committed["seed"][0])
    solution, _ = table2.run_of(problem, heuristic, results["plr_bytes"], committed["time_limit"])
    computed = table2.outcome(problem, solution, exact_lower_bound(problem))
    for key in ("nodes", "cost_over_bound", "first_path_cost"):
        assert computed[key] == pytest.approx(committed[key][0], rel=0.02), key


@pytest.mark.parametrize("heuristic", [_planning.NONE, _planning.STRAIGHT])
def test_sba_star_has_vertices_and_costs_of_this_code(heuristic):
    results, problem = results_of("sba_star"), scenes.single_door()
    rows = {(row["scene"], row["heuristic"]): row for row in results["rows"]}
    committed = rows["single door", heuristic]
    options = (results["max_vertices"], exact_lower_bound(problem))
    for seed in range(2):
        computed = sba_star.measure(problem, _planning.build(problem, heuristic), seed, *options)
        for key in ("vertices", "cost_over_bound"):
            assert computed[key] == pytest.approx(committed[key][seed], rel=0.02), key
