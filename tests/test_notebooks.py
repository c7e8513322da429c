"""The notebooks run from start to end, use public names only, and are committed as they ran."""

import ast
import json
import re
from pathlib import Path

import nbformat
import pytest
from matplotlib import pyplot as plt
from page_helpers import propagate

import plr_jax

NOTEBOOKS = sorted((Path(__file__).parent.parent / "notebooks").glob("*.ipynb"))
LARGEST = 900_000
# Small values of the parameters that the first cell of a notebook sets, for quick runs.
LEAVES = ["plane", "continuous", "smooth", "cone"]
SMALL = {
    "1": {"MAX_BYTES": 512, "CONE_BYTES": 512, "NUM_POINTS": 2_000, "NUM_QUERIES": 2_000, "RESOLUTION": 20}
    | {"BUDGETS": {leaf: [512] for leaf in LEAVES}},
    "2": {"NUM_POINTS": 1_000, "BYTES": (512, 1024), "NUM_SAMPLES": 200, "RESOLUTION": 32},
    "3": {"PLR_BYTES": 512, "NUM_CONFIGURATIONS": 4_000, "NUM_TESTS": 500}
    | {"TIME_LIMIT": 0.1, "RESOLUTION": 20, "SECONDS": 1.0},
    "4": {"CAR_BYTES": 512, "NUM_POSES": 2_000, "NUM_CONFIGURATIONS": 2_000, "NUM_CELLS": 200, "NUM_PIXELS": 120}
    | {"COST_BYTES": 512, "RESOLUTION": 20},
    "5": {"NUM_ENVIRONMENTS": 8, "NUM_STEPS": 10, "SIZE": 6, "BLOCKED": 0.2, "RESOLUTION": 4},
    "6": {"MAX_BYTES": 512, "NUM_POINTS": 500, "NUM_PAIRS": 12, "NUM_AGENTS": 3, "RESOLUTION": 40},
    "7": {"SIDE": 40, "BOUND_SIDE": 20, "PLR_BYTES": 512},
    "8": {"NUM_POINTS": 50, "NUM_STEPS": 3, "NUM_MAPS": 4, "NUM_MEASURED": 100, "FIT_STEPS": 3}
    | {"MAX_BYTES": 256, "RESOLUTION": 30},
}
PARAMETERS = {"tags": ["parameters"]}
each_notebook = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)


def without_times(text):
    """Remove numbers with a unit of time, and counts per second, which differ from run to run."""
    return re.sub(r"[\d.,]+ (?=(ns|us|ms|s|million)\b)", "", text)


def show():
    """Draw all open figures, and close them, as a notebook does."""
    for number in plt.get_fignums():
        plt.figure(number).draw_without_rendering()
    plt.close("all")


@each_notebook
@pytest.mark.full
@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.filterwarnings("error", "ignore::DeprecationWarning")
def test_notebook_runs_and_prints_committed_output(path, tmp_path, monkeypatch, capsys):
    """Run it with small parameters; cells that do not depend on them must print the committed output."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(plt, "show", show)
    plt.switch_backend("agg")
    small = SMALL[path.name[0]]
    names, changed, compared = {"__name__": "__main__"}, set(small), 0
    with plt.rc_context():
        for cell in (cell for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "code"):
            *statements, last = ast.parse(cell.source).body
            is_shown = isinstance(last, ast.Expr)
            exec(compile(ast.Module(statements if is_shown else [*statements, last], []), path.name, "exec"), names)
            shown = eval(compile(ast.Expression(last.value), path.name, "eval"), names) if is_shown else None
            assert shown is None or shown._repr_html_()
            if cell.metadata == PARAMETERS:
                assert small.keys() <= names.keys()
                names |= small
            said = capsys.readouterr()
            assert said.err == ""
            is_small = cell.metadata == PARAMETERS
            is_small = is_small or any([propagate(statement, changed) for statement in ast.parse(cell.source).body])
            if said.out and not is_small:
                compared += 1
                printed = "".join(output.text for output in cell.outputs if output.output_type == "stream")
                assert without_times(said.out) == without_times(printed)
    assert compared or path.stem == "5_inside_your_environment"  # all that it prints depends on its sizes


@each_notebook
def test_notebook_uses_public_names_only(path):
    cells = nbformat.read(path, as_version=4).cells
    for node in (node for cell in cells if cell.cell_type == "code" for node in ast.walk(ast.parse(cell.source))):
        if isinstance(node, ast.Attribute):
            assert not node.attr.startswith("_"), ast.unparse(node)
            if isinstance(node.value, ast.Name) and node.value.id == "plr_jax":
                assert node.attr in plr_jax.__all__
        elif isinstance(node, ast.Import | ast.ImportFrom):
            names = [getattr(node, "module", None) or "", *(alias.name for alias in node.names)]
            assert not any("._" in f".{name}" for name in names), ast.unparse(node)


@each_notebook
def test_notebook_is_committed_small_and_clean(path):
    text = path.read_text()
    raw = json.loads(text)
    nbformat.validate(raw)
    assert path.stat().st_size <= LARGEST
    assert (raw["nbformat"], raw["nbformat_minor"]) == (4, 5)
    assert raw["metadata"]["kernelspec"]["name"] == "python3"
    cells = [cell for cell in raw["cells"] if cell["cell_type"] == "code"]
    assert [cell["execution_count"] for cell in cells] == list(range(1, len(cells) + 1))
    outputs = [output for cell in cells for output in cell["outputs"]]
    assert not any(output["output_type"] == "error" or output.get("name") == "stderr" for output in outputs)
    assert sum("image/png" in output.get("data", {}) for output in outputs) >= 3
    assert [cell["metadata"] for cell in cells] == [PARAMETERS] + [{}] * (len(cells) - 1)
    assert all(cell["metadata"] == {} for cell in raw["cells"] if cell["cell_type"] != "code")
    assert re.findall(r"/(?:home|root|tmp|work|Users)/\S*", re.sub(r'"image/png": "[^"]*"', "", text)) == []


def test_notebooks_are_numbered():
    assert [path.name[0] for path in NOTEBOOKS] == list(SMALL)
