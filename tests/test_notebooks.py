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
SMALL = {
    "1_a_first_plr": """
MAX_BYTES = CONE_BYTES = 512
NUM_POINTS = NUM_QUERIES = 2_000
RESOLUTION = 20
BUDGETS = dict.fromkeys(["plane", "continuous", "smooth", "cone"], [512])
""",
    "2_a_floor_plan": """
NUM_POINTS, NUM_SAMPLES, RESOLUTION = 1_000, 200, 32
BYTES = (512, 1024)
""",
    "3_a_team": """
PLR_BYTES, NUM_CONFIGURATIONS, NUM_TESTS = 512, 4_000, 500
TIME_LIMIT, RESOLUTION, SECONDS = 0.1, 20, 1.0
""",
    "4_your_own_robot": """
CAR_BYTES = COST_BYTES = 512
NUM_POSES = NUM_CONFIGURATIONS = 2_000
NUM_CELLS, NUM_PIXELS, RESOLUTION = 200, 120, 20
""",
    "5_inside_your_environment": """
NUM_ENVIRONMENTS, NUM_STEPS, SIZE, BLOCKED, RESOLUTION = 8, 10, 6, 0.2, 4
""",
    "6_pedestrians": """
MAX_BYTES, NUM_POINTS, NUM_PAIRS, NUM_AGENTS, RESOLUTION = 512, 500, 12, 3, 40
""",
    "7_cost_distance": """
SIDE, BOUND_SIDE, PLR_BYTES = 40, 20, 512
""",
}
PARAMETERS = {"tags": ["parameters"]}
each_notebook = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)


def assigned(code):
    """Return the names that statements of the outermost level assign to."""
    targets = [target for node in ast.parse(code).body if isinstance(node, ast.Assign) for target in node.targets]
    return {node.id for target in targets for node in ast.walk(target) if isinstance(node, ast.Name)}


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
    names, changed, compared = {"__name__": "__main__"}, assigned(SMALL[path.stem]), 0
    with plt.rc_context():
        for cell in (cell for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "code"):
            source = cell.source
            if cell.metadata == PARAMETERS:
                assert assigned(SMALL[path.stem]) <= assigned(source)
                source += SMALL[path.stem]
            *statements, last = ast.parse(source).body
            is_shown = isinstance(last, ast.Expr)
            exec(compile(ast.Module(statements if is_shown else [*statements, last], []), path.name, "exec"), names)
            shown = eval(compile(ast.Expression(last.value), path.name, "eval"), names) if is_shown else None
            assert shown is None or shown._repr_html_()
            said = capsys.readouterr()
            assert said.err == ""
            is_small = cell.metadata == PARAMETERS
            is_small = is_small or any([propagate(statement, changed) for statement in ast.parse(source).body])
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
    assert [path.name[0] for path in NOTEBOOKS] == ["1", "2", "3", "4", "5", "6", "7"]
