"""Experiments run at their smallest, one of each family; committed results are those of this code."""

import base64
import json
import runpy
import sys
from importlib import import_module
from pathlib import Path

import pytest

import plr_jax
from experiments import _planning, readme_tables, sba_star, table1, table2
from experiments._runner import RESULTS
from plr_jax import BuildOptions, VisibilityGraph, construct, cyclic_axis, maximum_depth, metrics, scenes

pytestmark = pytest.mark.full

ROOT = Path(__file__).parents[2]
SCRIPTS = sorted({path.stem for path in (ROOT / "experiments").glob("[!_]*.py")} - {"readme_tables"})
# One quick section of each family of experiments; all others run by: python -m experiments.NAME --smoke.
FAMILIES = """fig1, fig4, table2, race, sba_star, trace, benchmark oracle, proofs astar, solve speed_map,
compare_summaries maze_straight_line maze_polygon,
teams unseen, portable query, first_answers one_query, grid_distance rooms, shaping learning, costs estimates,
cost_distance mountain, volumes volumes, living maps doors, lifelong replanned, fleets, pedestrians, scale"""


@pytest.mark.parametrize("words", [family.split() for family in FAMILIES.split(",")], ids=lambda words: words[0])
def test_smallest_experiment_of_each_family_runs(words, tmp_path, monkeypatch):
    """Run each experiment in this process, where most functions are compiled already."""
    name, *sections = words
    options = ["--only", *sections] if sections else []
    monkeypatch.setattr(sys, "argv", [name, "--smoke", "--output", str(tmp_path), *options])
    monkeypatch.delitem(sys.modules, f"experiments.{name}", raising=False)  # imported by another family
    runpy.run_module(f"experiments.{name}", run_name="__main__")
    record = json.loads((tmp_path / f"{name}.json").read_text())
    assert record["smoke"] and record["experiment"] == name
    assert {"versions", "device", "cores", "dtype", "seed"} <= record.keys()
    assert set(sections) <= record["results"].keys() and all(record["results"].values())


def test_scripts_and_committed_results_match():
    for name in SCRIPTS:
        record, script = json.loads((RESULTS / f"{name}.json").read_text()), import_module(f"experiments.{name}")
        assert record["experiment"] == name and not record["smoke"]
        assert record["results"].keys() <= getattr(script, "SECTIONS", record["results"]).keys()
    page = readme_tables.ALL_RESULTS.read_text() + readme_tables.PAPER.read_text()
    for path in RESULTS.iterdir():
        assert path.stem in SCRIPTS if path.suffix == ".json" else f"](results/{path.name})" in page, path.name


def test_readme_tables_hold_the_committed_results(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["readme_tables", "--check"])
    readme_tables.main()
    pages = "".join(
        page.read_text() for page in (readme_tables.README, readme_tables.ALL_RESULTS, readme_tables.PAPER)
    )
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


ROWS = [
    row
    for row in json.loads((RESULTS / "table1.json").read_text())["results"]["rows"]
    if row["method"] == "PLR (VG)" and not row["configuration"].startswith("best axis, 2")
]


@pytest.fixture(scope="module", params=["maze", "thin_maze"])
def measured(request):
    problem = getattr(scenes, request.param)()
    exact = VisibilityGraph(problem.workspace, problem.goals[0])
    x = problem.workspace.sample_free(20_000, seed=1)
    return [row for row in ROWS if row["scene"] == request.param], exact, x, exact(x)


def test_table1_has_bytes_and_errors_of_this_code(measured):
    rows, exact, x, distance = measured
    options = table1.papers_own(9) | table1.ours(1_024, 2_048, 6_144) | table1.cones(256, 512, 1_024)
    for row in rows:
        plr = construct(exact, exact.workspace.bounds, seed=0, **options[row["configuration"]])
        report, told = metrics.error_map(plr, lambda _: distance, x), row["seeds"][0]
        assert (told["seed"], told["bytes"]) == (0, plr.num_bytes), row["configuration"]
        assert report.max <= told["max"] * 1.001 and report.mean == pytest.approx(told["mean"], rel=0.5)


def test_fig1_shows_the_file_of_this_code():
    results = json.loads((RESULTS / "fig1.json").read_text())["results"]
    options = BuildOptions(should_split=maximum_depth, split=cyclic_axis)
    plr = construct(plr_jax.Euclidean((0.0, 0.0)), ((0.0, 0.0), (1.0, 1.0)), max_depth=6, options=options)
    assert base64.b64decode(results["plr_base64"]) == plr.to_bytes() and results["bytes"] == plr.num_bytes


@pytest.mark.parametrize("heuristic", [table2.LATTICE, _planning.POINT_PLR])
@pytest.mark.parametrize("name", ["single door", "cross 3"])
def test_table2_has_nodes_and_costs_of_this_code(name, heuristic):
    results = json.loads((RESULTS / "table2.json").read_text())["results"]
    told = next(row for row in results["rows"] if (row["scene"], row["heuristic"]) == (name, heuristic))
    problem = scenes.perturbed(_planning.SCENES[name](), told["seed"][0])
    solution, _ = table2.run_of(problem, heuristic, results["plr_bytes"], told["time_limit"])
    found = table2.outcome(problem, solution, _planning.lower_bound(problem))
    for key in ("nodes", "cost_over_bound", "first_path_cost"):
        assert found[key] == pytest.approx(told[key][0], rel=0.02), key


@pytest.mark.parametrize("heuristic", [_planning.NONE, _planning.STRAIGHT])
def test_sba_star_has_vertices_and_costs_of_this_code(heuristic):
    results = json.loads((RESULTS / "sba_star.json").read_text())["results"]
    told, problem = next(row for row in results["rows"] if row["heuristic"] == heuristic), scenes.single_door()
    options = (results["max_vertices"], _planning.lower_bound(problem))
    for seed in range(2):
        found = sba_star.measure(problem, _planning.build(problem, heuristic), seed, *options)
        for key in ("vertices", "cost_over_bound"):
            assert found[key] == pytest.approx(told[key][seed], rel=0.02), key
