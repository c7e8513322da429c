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
each_notebook = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)


def code_cells(path):
    return [cell for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "code"]


def outputs(path):
    return [output for cell in code_cells(path) for output in cell.outputs]


def test_there_are_three():
    assert [path.name[0] for path in NOTEBOOKS] == ["1", "2", "3"]


@each_notebook
def test_runs_from_start_to_end(path, tmp_path):
    notebook = nbformat.read(path, as_version=4)
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
    assert all(cell["metadata"] == {} for cell in raw["cells"])
    text = re.sub(r'"image/png": "[^"]*"', "", path.read_text())
    assert re.findall(r"/(?:home|root|tmp|work|Users)/\S*", text) == []
