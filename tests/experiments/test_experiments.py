"""Experiments run at their smallest, one of each family; tables and pictures come from committed results alone."""

import json
import runpy
import sys
from importlib import import_module
from pathlib import Path

import pytest

from experiments import readme_tables

pytestmark = pytest.mark.full

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "experiments" / "results"
SCRIPTS = sorted({path.stem for path in (ROOT / "experiments").glob("[!_]*.py")} - {"readme_tables"})
# Of each family one of the quickest; the others run alike: python -m experiments.NAME --smoke.
FAMILIES = {
    "fig1": (),
    "trace": (),
    "benchmark": ("--only", "oracle"),
    "proofs": ("--only", "astar"),
    "solve": ("--only", "speed_map"),
    "compare_summaries": ("--only", "maze_straight_line", "maze_polygon"),
    "teams": ("--only", "unseen"),
    "portable": ("--only", "query"),
    "grid_distance": ("--only", "rooms"),
    "shaping": ("--only", "learning"),
    "costs": ("--only", "estimates"),
    "volumes": ("--only", "volumes"),
    "living": ("--only", "maps", "doors"),
    "lifelong": ("--only", "replanned"),
    "fleets": (),
    "scale": (),
}


@pytest.fixture
def run_script(monkeypatch):
    """Run an experiment's script as from the command line, but in this process, where most is compiled already."""

    def run(name, *options):
        monkeypatch.setattr(sys, "argv", [name, *map(str, options)])
        runpy.run_module(f"experiments.{name}", run_name="__main__")

    return run


@pytest.mark.parametrize("name", FAMILIES)
def test_an_experiment_of_each_family_runs_at_its_smallest(name, run_script, tmp_path):
    run_script(name, "--smoke", "--output", tmp_path, *FAMILIES[name])
    record = json.loads((tmp_path / f"{name}.json").read_text())
    assert record["smoke"] and record["experiment"] == name
    assert {"versions", "device", "cores", "dtype", "seed"} <= record.keys()
    assert set(FAMILIES[name][1:]) <= record["results"].keys() and all(record["results"].values())


def test_pictures_are_drawn_from_committed_results(run_script, tmp_path):
    (tmp_path / "fig1.json").write_text((RESULTS / "fig1.json").read_text())
    run_script("fig1", "--draw", "--output", tmp_path)
    (picture,) = tmp_path.glob("*.png")
    assert (RESULTS / picture.name).exists() and picture.stat().st_size > 10_000


def test_every_script_has_results_of_a_full_run_and_every_results_file_its_script_or_its_place_in_the_readme():
    for name in SCRIPTS:
        record, script = json.loads((RESULTS / f"{name}.json").read_text()), import_module(f"experiments.{name}")
        assert record["experiment"] == name and not record["smoke"]
        assert record["results"].keys() <= getattr(script, "SECTIONS", record["results"]).keys()
    page = (ROOT / "experiments" / "README.md").read_text()
    for path in RESULTS.iterdir():
        assert path.stem in SCRIPTS if path.suffix == ".json" else f"](results/{path.name})" in page, path.name


def test_the_readmes_hold_the_committed_results_and_one_that_is_out_of_date_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["readme_tables", "--check"])
    readme_tables.main()
    pages = readme_tables.README.read_text() + readme_tables.ALL_RESULTS.read_text()
    assert all(f"<!-- table:{name} -->" in pages for name in readme_tables.TABLES)
    old = tmp_path / "README.md"
    old.write_text("<!-- table:descent -->\nold\n<!-- /table -->\n")
    monkeypatch.setattr(readme_tables, "README", old)
    with pytest.raises(SystemExit, match="out of date"):
        readme_tables.main()
    assert "old" in old.read_text()


def test_results_with_a_path_that_is_not_valid_are_refused():
    readme_tables.require_valid("race", {"trials": [{"valid": None}, {"improved_valid": [True, True]}]})
    with pytest.raises(ValueError, match=r"race\.trials\.0\.valid: a path is not valid"):
        readme_tables.require_valid("race", {"trials": [{"valid": False}]})
