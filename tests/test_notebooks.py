"""The notebooks run from start to end, use public names only, and are committed as they ran."""

import ast
import json
import os
import re
import subprocess
import venv
from pathlib import Path

import nbformat
import pytest
from page_helpers import propagate

import plr_jax

ROOT = Path(__file__).parent.parent
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
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
WARNINGS_ARE_ERRORS = """import warnings
warnings.simplefilter("error")
warnings.simplefilter("ignore", DeprecationWarning)
"""
each_notebook = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)


def without_times(text):
    """Remove numbers with a unit of time, and counts per second, which differ from run to run."""
    return re.sub(r"[\d.,]+ (?=(ns|us|ms|s|million)\b)", "", text)


@pytest.fixture(scope="module")
def jupyter(tmp_path_factory):
    """Return the program ``jupyter`` of an environment that holds only what the extra ``notebooks`` installs."""
    folder = tmp_path_factory.mktemp("environment")
    venv.create(folder, with_pip=True)
    run_alone([folder / "bin" / "pip", "install", "--quiet", f"{ROOT}[notebooks]"], folder)
    return folder / "bin" / "jupyter"


def run_alone(command, folder):
    """Run a program in a folder, without the settings by which the tests find and check the package."""
    environment = {
        name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "PLR_JAX_CHECK"))
    }
    result = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout[-5000:] + result.stderr[-5000:]


@each_notebook
@pytest.mark.full
def test_notebook_runs_and_prints_committed_output(path, jupyter, tmp_path):
    """Run it with small parameters; cells that do not depend on them must print the committed output."""
    committed = nbformat.read(path, as_version=4).cells
    notebook = nbformat.read(path, as_version=4)
    first = next(cell for cell in notebook.cells if cell.metadata == PARAMETERS)
    small = SMALL[path.name[0]]
    assert small.keys() <= {node.id for node in ast.walk(ast.parse(first.source)) if isinstance(node, ast.Name)}
    first.source = f"{WARNINGS_ARE_ERRORS}{first.source}\n" + "\n".join(f"{name} = {small[name]!r}" for name in small)
    nbformat.write(notebook, tmp_path / path.name)
    run_alone([jupyter, "execute", "--inplace", path.name], tmp_path)
    changed, compared = set(small), 0
    for cell, before in zip(nbformat.read(tmp_path / path.name, as_version=4).cells, committed, strict=True):
        if cell.cell_type != "code":
            continue
        assert not any(output.output_type == "error" or output.get("name") == "stderr" for output in cell.outputs)
        is_small = before.metadata == PARAMETERS
        is_small = is_small or any([propagate(statement, changed) for statement in ast.parse(before.source).body])
        if printed_by(cell) and not is_small:
            compared += 1
            assert without_times(printed_by(cell)) == without_times(printed_by(before))
    assert compared or path.stem == "5_inside_your_environment"  # all that it prints depends on its sizes


def printed_by(cell):
    """Return the text that a cell printed."""
    return "".join(output.text for output in cell.outputs if output.output_type == "stream")


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
