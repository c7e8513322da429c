"""Every experiment runs at its smallest, and its picture can be drawn from its results alone."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
COMMITTED = ["fig1", "fig2", "fig3", "fig4", "animations", "table1", "error_curve", "query"]
NAMES = [*COMMITTED, "table2", "race"]


def experiment(name, *options):
    command = [sys.executable, "-m", f"experiments.{name}", *map(str, options)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=300)


@pytest.mark.parametrize("name", NAMES)
def test_smoke_and_redraw(name, tmp_path):
    if name == "race":
        pytest.importorskip("ompl")
    ran = experiment(name, "--smoke", "--output", tmp_path)
    assert ran.returncode == 0, ran.stderr
    record = json.loads((tmp_path / f"{name}.json").read_text())
    assert record["smoke"] and record["experiment"] == name and record["results"]
    assert {"versions", "device", "cores", "dtype", "seed"} <= record.keys()
    drawn = [path for path in tmp_path.iterdir() if path.suffix != ".json"]
    assert drawn
    for path in drawn:
        path.unlink()
    assert experiment(name, "--draw", "--output", tmp_path).returncode == 0
    assert all(path.stat().st_size > 0 for path in drawn)


@pytest.mark.parametrize("name", COMMITTED)
def test_committed_results_are_those_of_a_full_run(name):
    record = json.loads((ROOT / "experiments" / "results" / f"{name}.json").read_text())
    assert record["experiment"] == name and not record["smoke"]


def test_the_readme_holds_the_committed_results():
    checked = experiment("readme_tables", "--check")
    assert checked.returncode == 0, checked.stderr
