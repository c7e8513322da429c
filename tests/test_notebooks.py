"""The notebooks run from start to end, use public names only, and are committed as they ran."""

import ast
import json
import re
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

import plr_jax

NOTEBOOKS = sorted((Path(__file__).parent.parent / "notebooks").glob("*.ipynb"))
LARGEST = 900_000
# What the first cell of a notebook says, small: its values go over those of the cell, whose names they share.
SMALL = {
    "1_a_first_plr": """
MAX_BYTES = 512
CONE_BYTES = 1024
NUM_POINTS = 2_000
NUM_QUERIES = 10_000
RESOLUTION = 40
BUDGETS = {"plane": [256, 512], "continuous": [256], "smooth": [256], "cone": [256]}
""",
    "2_a_floor_plan": """
NUM_POINTS = 2_000
BYTES = (512, 1024)
NUM_SAMPLES = 200
RESOLUTION = 64
""",
    "3_a_team": """
PLR_BYTES = 1024
NUM_CONFIGURATIONS = 10_000
NUM_TESTS = 1_000
NUM_TRAINING = 3_000
NUM_RETIMINGS, NUM_ITERATIONS = 1, 50
TIME_LIMIT = 1.0
RESOLUTION, SECONDS = 40, 1.0
""",
    "4_your_own_robot": """
CAR_BYTES = 1024
NUM_POSES = 2_000
NUM_CELLS = 600
NUM_CONFIGURATIONS = 2_000
RESOLUTION = 40
""",
}
PARAMETERS = {"tags": ["parameters"]}
each_notebook = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)


def code_cells(path):
    return [cell for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "code"]


def outputs(path):
    return [output for cell in code_cells(path) for output in cell.outputs]


def assigned(code):
    """Names that statements of the outermost level assign to."""
    targets = [target for node in ast.parse(code).body if isinstance(node, ast.Assign) for target in node.targets]
    return {node.id for target in targets for node in ast.walk(target) if isinstance(node, ast.Name)}


def test_there_are_four():
    assert [path.name[0] for path in NOTEBOOKS] == ["1", "2", "3", "4"]


@each_notebook
def test_runs_from_start_to_end(path, tmp_path):
    notebook = nbformat.read(path, as_version=4)
    first = next(cell for cell in notebook.cells if cell.metadata == PARAMETERS)
    small = SMALL[path.stem]
    assert assigned(small) <= assigned(first.source)
    first.source += small
    resources = {"metadata": {"path": str(tmp_path)}}
    NotebookClient(notebook, kernel_name="python3", timeout=300, resources=resources).execute()
    ran = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert all(cell.execution_count for cell in ran)
    warned = [output.text for cell in ran for output in cell.outputs if output.get("name") == "stderr"]
    assert warned == []


@each_notebook
def test_uses_public_names_only(path):
    for cell in code_cells(path):
        for node in ast.walk(ast.parse(cell.source)):
            if isinstance(node, ast.Attribute):
                assert not node.attr.startswith("_"), ast.unparse(node)
                if isinstance(node.value, ast.Name) and node.value.id == "plr_jax":
                    assert node.attr in plr_jax.__all__
            elif isinstance(node, ast.Import):
                assert not any("._" in alias.name for alias in node.names), ast.unparse(node)
            elif isinstance(node, ast.ImportFrom):
                assert "._" not in node.module, ast.unparse(node)
                assert not any(alias.name.startswith("_") for alias in node.names), ast.unparse(node)


@each_notebook
def test_is_committed_as_it_ran(path):
    cells = code_cells(path)
    assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1))
    kinds = {output.output_type for output in outputs(path)}
    assert "error" not in kinds
    assert "stderr" not in {output.get("name") for output in outputs(path)}
    assert sum("image/png" in output.get("data", {}) for output in outputs(path)) >= 3


@each_notebook
def test_is_small_and_clean(path):
    assert path.stat().st_size <= LARGEST
    raw = json.loads(path.read_text())
    nbformat.validate(raw)
    assert (raw["nbformat"], raw["nbformat_minor"]) == (4, 5)
    assert raw["metadata"]["kernelspec"]["name"] == "python3"
    codes = [cell["metadata"] for cell in raw["cells"] if cell["cell_type"] == "code"]
    assert codes == [PARAMETERS] + [{}] * (len(codes) - 1)
    assert all(cell["metadata"] == {} for cell in raw["cells"] if cell["cell_type"] != "code")
    text = re.sub(r'"image/png": "[^"]*"', "", path.read_text())
    assert re.findall(r"/(?:home|root|tmp|work|Users)/\S*", text) == []
