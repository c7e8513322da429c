"""Every experiment runs at its smallest, and its picture can be drawn from its results alone."""

import json
import shutil
import statistics
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

from experiments import _gradient_tables

ROOT = Path(__file__).parent.parent
COMMITTED = [
    *("fig1", "fig2", "fig3", "fig4", "animations", "table1", "error_curve", "table2", "race"),
    *("continuity", "descent", "trajectory", "refinement"),
]


def experiment(name, *options):
    command = [sys.executable, "-m", f"experiments.{name}", *map(str, options)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=300)


@pytest.fixture(scope="module")
def smoke(tmp_path_factory):
    """The folder into which an experiment at its smallest has written; it runs once."""

    @cache
    def folder_of(name):
        if name == "race":
            pytest.importorskip("ompl")
        folder = tmp_path_factory.mktemp(name)
        ran = experiment(name, "--smoke", "--output", folder)
        assert ran.returncode == 0, ran.stderr
        return folder

    return folder_of


def record_in(folder, name):
    return json.loads((folder / f"{name}.json").read_text())


@pytest.mark.parametrize("name", COMMITTED)
def test_smoke_and_redraw(name, smoke):
    folder = smoke(name)
    record = record_in(folder, name)
    assert record["smoke"] and record["experiment"] == name and record["results"]
    assert {"versions", "device", "cores", "dtype", "seed"} <= record.keys()
    drawn = [path for path in folder.iterdir() if path.suffix != ".json"]
    assert drawn
    for path in drawn:
        path.unlink()
    assert experiment(name, "--draw", "--output", folder).returncode == 0
    assert all(path.stat().st_size > 0 for path in drawn)


def test_table2_solves_with_every_heuristic_and_all_paths_are_valid(smoke):
    results = record_in(smoke("table2"), "table2")["results"]
    rows = {(row["scene"], row["heuristic"]): row for row in results["rows"]}
    assert len(rows) == 2 * 5
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
        assert 1 <= row["cost_over_bound"]["after"] <= row["cost_over_bound"]["before"]


def test_readme_tables_of_the_planner(smoke, tmp_path):
    for name in ("table2", "race"):
        shutil.copy(smoke(name) / f"{name}.json", tmp_path)
    marked = "".join(f"<!-- table:{name} -->\nold\n<!-- /table -->\n" for name in ("table2", "heuristics", "race"))
    script = (
        "import sys; from pathlib import Path; from experiments import readme_tables as tables;"
        "tables.RESULTS = Path(sys.argv[1]); print(tables.render(sys.argv[2]))"
    )
    command = [sys.executable, "-c", script, str(tmp_path), marked]
    text = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    assert "old" not in text
    row = next(row for row in record_in(tmp_path, "table2")["results"]["rows"] if row["heuristic"] == "PLR")
    line = next(line for line in text.splitlines() if line.startswith("| single door | 0.08 |"))
    assert f" {statistics.median(row['nodes']):,.0f} ({max(row['nodes']):,}) " in line
    assert f" {statistics.median(row['seconds']):.3f} ({max(row['seconds']):.3f}) " in line


@pytest.mark.parametrize("name", ["continuity", "descent", "trajectory", "refinement"])
def test_readme_tables_of_gradients(name, smoke, monkeypatch):
    results = record_in(smoke(name), name)["results"]
    rows = results["rows"] if "rows" in results else results["maps"][0]["rows"]
    monkeypatch.setattr(_gradient_tables, "_SHOWN", rows[0].get("budget"))
    lines = getattr(_gradient_tables, name)(results).splitlines()
    assert len([line for line in lines if line.startswith("|")]) == 2 + len(rows)


@pytest.mark.parametrize("name", [*COMMITTED, "benchmark"])  # whose sections have tests of their own
def test_committed_results_are_those_of_a_full_run(name):
    record = json.loads((ROOT / "experiments" / "results" / f"{name}.json").read_text())
    assert record["experiment"] == name and not record["smoke"]


def test_the_readme_holds_the_committed_results():
    checked = experiment("readme_tables", "--check")
    assert checked.returncode == 0, checked.stderr
