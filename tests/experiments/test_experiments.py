"""Every experiment runs at its smallest, and its picture can be drawn from its results alone."""

import json
import runpy
import shutil
import statistics
import sys
from functools import cache
from pathlib import Path
from unittest import mock

import pytest

from experiments import _gradient_tables, hostile_files, readme_tables
from experiments.team_sections import _plans
from plr_jax import BLOptions, scenes

ROOT = Path(__file__).parents[2]
SMOKED = [
    *("fig1", "fig2", "fig3", "fig4", "animations", "table1", "error_curve", "table2", "race"),
    *(
        "big_maps",
        "continuity",
        "descent",
        "grid_pairs",
        "maps",
        "placement",
        "trajectory",
        "refinement",
        "sba_star",
        "trace",
        "teams",
        "families",
        "scale",
        "pair_bounds",
        "portable",
        "edges",
        "wire",
    ),
]
TESTED_ELSEWHERE = {"benchmark", "proofs", "solve", "compare_summaries", "readme_tables", "hostile_files"}


def run_script(name, *options):
    """Run an experiment's script as from the command line, but in this process, where most is compiled already."""
    with mock.patch.object(sys, "argv", [name, *map(str, options)]):
        runpy.run_module(f"experiments.{name}", run_name="__main__")


@pytest.fixture(scope="module")
def smoke(tmp_path_factory):
    """The folder into which an experiment at its smallest has written; it runs once."""

    @cache
    def folder_of(name):
        if name == "race":
            pytest.importorskip("ompl")
        folder = tmp_path_factory.mktemp(name)
        run_script(name, "--smoke", "--output", folder)
        return folder

    return folder_of


def record_in(folder, name):
    return json.loads((folder / f"{name}.json").read_text())


def test_every_script_has_its_test():
    scripts = {path.stem for path in (ROOT / "experiments").glob("[!_]*.py")}
    assert scripts == {*SMOKED, *TESTED_ELSEWHERE}


@pytest.mark.parametrize("name", SMOKED)
def test_smoke_and_redraw(name, smoke):
    folder = smoke(name)
    record = record_in(folder, name)
    assert record["smoke"] and record["experiment"] == name and record["results"]
    assert {"versions", "device", "cores", "dtype", "seed"} <= record.keys()
    drawn = [path for path in folder.iterdir() if path.suffix != ".json"]
    assert drawn
    for path in drawn:
        path.unlink()
    run_script(name, "--draw", "--output", folder)
    assert all(path.stat().st_size > 0 for path in drawn)


def test_all_workers_and_resumed_processes_give_the_same_bytes(smoke):
    results = record_in(smoke("scale"), "scale")["results"]
    assert all(row["same"] for row in results["workers"] + results["kills"])
    assert len({row["digest"] for row in results["workers"]}) == 1
    kinds = [row["kind"] for row in results["workers"]]
    assert kinds == ["threads", "processes", "Dask", "processes, one killed", "Dask, one killed"]


def test_traces_arrive_along_shortest_ways(smoke):
    (row,) = record_in(smoke("trace"), "trace")["results"]["rows"]
    assert row["map"] == "maze" and row["starts"] == 200 and row["arrived"] == 1
    assert row["clear"] >= 0.99 and 1 - 1e-6 <= row["ratio"]["mean"] < 1.00001 and row["bytes"] <= row["budget"]


def test_pairs_of_a_grid_are_never_above_the_truth_and_closer_than_landmarks(smoke):
    rows = record_in(smoke("grid_pairs"), "grid_pairs")["results"]["rows"]
    ours = {row["connectivity"]: row for row in rows if row["method"] == "GridPairs"}
    assert ours.keys() == {4, 8}
    for row in rows:
        own = ours[row["connectivity"]]
        assert row["violations"] == 0 and row["pairs"] > 100
        assert own["exact"] == 1 and own["mean_gap"] < 1e-5
        assert row is own or (row["mean_gap"] > 1e-3 and row["exact"] < 1)


def test_polygons_of_pictures_are_near_their_pixels_and_open_where_these_are(smoke):
    rows = record_in(smoke("maps"), "maps")["results"]["rows"]
    assert [row["map"] for row in rows] == ["scan", "plan"]
    for row in rows:
        assert row["hausdorff"] <= 0.5 and row["passages"] > 1000 and row["closed_passages"] == 0
        assert row["bytes"] <= 4096 and row["mean_error"] < 0.01 * row["mean_distance"]


def test_placements_are_free_and_no_dearer_than_their_rivals(smoke):
    rows = record_in(smoke("placement"), "placement")["results"]["rows"]
    assert [row["k"] for row in rows] == [1, 1, 2, 2]
    for row in rows:
        assert row["free"] and abs(row["said"] / row["cost"] - 1) < 1e-5
        rivals = [row[name] for name in ("of_points", "of_grid", "straight", "best_start") if row[name] is not None]
        assert row["cost"] <= min(rivals)


def test_table2_solves_with_every_heuristic_and_all_paths_are_valid(smoke):
    results = record_in(smoke("table2"), "table2")["results"]
    rows = {(row["scene"], row["heuristic"]): row for row in results["rows"]}
    assert len(rows) == 2 * 6
    for (scene, heuristic), row in rows.items():
        if heuristic != "none" or scene == "single door":
            assert row["valid"] == [True] * len(results["seeds"])
            assert all(1 <= ratio < 1.2 for ratio in row["cost_over_bound"])
    nodes = {
        heuristic: max(rows["single door", heuristic]["nodes"]) for heuristic in ("none", "straight line", "PLR")
    }
    assert nodes["PLR"] < nodes["straight line"] < nodes["none"]


def test_the_race_is_summed_up_as_by_hand(smoke):
    results = record_in(smoke("race"), "race")["results"]
    for trial, total in zip(results["trials"], results["summary"], strict=True):
        ours, attempts = trial["ours"], trial["ompl"].values()
        assert ours["valid"] and all(attempt["valid"] is not False for attempt in attempts)
        times = [attempt["seconds"] for attempt in attempts if attempt["seconds"] is not None]
        assert total["same_cost"]["at_least"] == (not times)
        assert total["same_cost"]["ratio"] == pytest.approx(min(times, default=trial["limit"]) / ours["seconds"])
        assert total["cost_5_percent_more"]["best"] <= total["same_cost"]["best"]


def test_what_continuity_costs_and_buys(smoke):
    rows = {row["leaf"]: row for row in record_in(smoke("continuity"), "continuity")["results"]["rows"]}
    assert rows["plane"]["value_jump"] > 1e-3
    for leaf in ("continuous", "smooth"):
        assert rows[leaf]["value_jump"] <= 1e-5
        assert rows[leaf]["bytes"] <= rows["plane"]["budget"] and rows[leaf]["mean"] <= 1.2 * rows["plane"]["mean"]
    assert rows["smooth"]["gradient_jump"] < 1e-2 < rows["continuous"]["gradient_jump"]


def test_descents_reach_the_goal_and_cross_nothing(smoke):
    (maze,) = record_in(smoke("descent"), "descent")["results"]["maps"]
    for row in maze["rows"]:
        assert row["reached"] == 1 and row["crossings"] == 0 and 1 - 1e-9 <= row["ratio"]["median"] <= 1.03
        assert row["gradient"]["num_not_finite"] == row["gradient"]["num_zero"] == 0
    assert maze["exact_directions"]["walks"]["reached"] > 0.95


def test_trajectories_stay_valid_and_shorten(smoke):
    for row in record_in(smoke("trajectory"), "trajectory")["results"]["rows"]:
        assert row["valid"] and row["ends_exact"]
        before, after = row["cost_over_bound"]["before"], row["cost_over_bound"]["after"]
        assert 1 - 1e-9 <= after <= before * (1 + 1e-12)


def test_readme_tables_of_the_planner(smoke, tmp_path, monkeypatch):
    for name in ("table2", "race"):
        shutil.copy(smoke(name) / f"{name}.json", tmp_path)
    marked = "".join(f"<!-- table:{name} -->\nold\n<!-- /table -->\n" for name in ("table2", "heuristics", "race"))
    monkeypatch.setattr(readme_tables, "RESULTS", tmp_path)
    text = readme_tables.render(marked)
    assert "old" not in text
    row = next(row for row in record_in(tmp_path, "table2")["results"]["rows"] if row["heuristic"] == "PLR")
    line = next(line for line in text.splitlines() if line.startswith("| single door | 0.08 |"))
    assert f" {statistics.median(row['nodes']):,.0f} ({max(row['nodes']):,}) " in line
    assert f" {statistics.median(row['seconds']):.3f} ({max(row['seconds']):.3f}) " in line


def test_readme_table_of_teams_has_a_row_for_each_of_theirs(smoke):
    results = record_in(smoke("teams"), "teams")["results"]
    sections = ("first", "half_a_minute", "den520d", "dbcbs_16", "unseen")
    lines = readme_tables.teams(results).splitlines()
    num_rows = sum(len(results[section]["rows"]) for section in sections)
    assert len([line for line in lines if line.startswith("|")]) == 2 + num_rows
    assert any(line.startswith("| crowd, improved for 0.5 s | 6 | 0/1 |") for line in lines)


def test_runs_of_teams_that_found_no_path_are_counted():
    problem = scenes.crowd(2)
    found, failed = (_plans.planned(problem, 1.0, BLOptions(time_limit=seconds)) for seconds in (60.0, 1e-9))
    assert (found["failures"], failed["failures"], failed["first"]) == (0, 1, None)
    row = {"scene": "crowd", **_plans.middle([found, failed])}
    assert row["failures"] == 1 and row["runs"] == 2 and row["valid"] and row["ratio"] == found["ratio"]
    assert row["status"] == "SOLVED, TIME_LIMIT"
    none = {"scene": "crowd", **_plans.middle([failed, failed])}
    assert none["valid"] is None and none["ratio"] is None
    with_path, without = _plans.table_of({"rows": [row, none]}).splitlines()[2:]
    assert with_path.split()[:4] == ["crowd", "valid", "2", "1/2"]
    assert without.split()[:4] == ["crowd", "TIME_LIMIT", "2", "2/2"] and without.split()[-1] == "-"


@pytest.mark.parametrize("scene, size", [("door", 4), ("crowd", 6), ("four_rooms", 2)])
def test_two_teams_share_a_workspace_but_no_starts_and_goals(scene, size):
    known, problem = _plans.two_teams(scene, size, 0)
    assert known.workspace is problem.workspace and known.robots == problem.robots
    for ours, theirs in ((problem.starts, known.starts), (problem.goals, known.goals)):
        assert not (ours == theirs).all(axis=1).any()


@pytest.mark.parametrize("name", ["continuity", "descent", "trajectory", "placement", "refinement"])
def test_readme_tables_of_gradients(name, smoke, monkeypatch):
    results = record_in(smoke(name), name)["results"]
    rows = results["rows"] if "rows" in results else results["maps"][0]["rows"]
    monkeypatch.setattr(_gradient_tables, "_SHOWN", rows[0].get("budget"))
    lines = getattr(_gradient_tables, name)(results).splitlines()
    assert len([line for line in lines if line.startswith("|")]) == 2 + len(rows)


@pytest.mark.parametrize(
    "name", [*SMOKED, "benchmark", "proofs", "solve", "compare_summaries", "hostile_files"]
)  # whose sections have tests of their own
def test_committed_results_are_those_of_a_full_run(name):
    record = json.loads((ROOT / "experiments" / "results" / f"{name}.json").read_text())
    assert record["experiment"] == name and not record["smoke"]


def test_the_readme_holds_the_committed_results(monkeypatch):
    monkeypatch.setattr(sys, "argv", ["readme_tables", "--check"])
    readme_tables.main()


def test_damaged_files_are_tried_at_the_smallest(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["hostile_files", "--smoke", "--mutations", "2", "--output", str(tmp_path)])
    hostile_files.main()
    assert (tmp_path / "hostile_files.txt").read_text()
    assert record_in(tmp_path, "hostile_files")["smoke"]


def test_a_readme_that_is_out_of_date_is_refused(tmp_path, monkeypatch):
    readme = tmp_path / "README.md"
    readme.write_text("<!-- table:refinement -->\nold\n<!-- /table -->\n")
    monkeypatch.setattr(readme_tables, "README", readme)
    monkeypatch.setattr(sys, "argv", ["readme_tables", "--check"])
    with pytest.raises(SystemExit, match="out of date"):
        readme_tables.main()
    assert "old" in readme.read_text()
