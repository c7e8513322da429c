"""Committed results are those of this code: what is quick of them is measured again."""

import base64
import json

import pytest

from experiments import table1
from experiments._runner import RESULTS
from plr_jax import (
    Box,
    BuildOptions,
    Euclidean,
    VisibilityGraph,
    construct,
    cyclic_axis,
    maximum_depth,
    metrics,
    scenes,
)

pytestmark = pytest.mark.full

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


def test_table1_has_the_bytes_and_errors_of_this_code(measured):
    rows, exact, x, distance = measured
    options = table1.papers_own(9) | table1.ours(1_024, 2_048, 6_144) | table1.cones(256, 512, 1_024)
    for row in rows:
        plr = construct(exact, exact.workspace.bounds, seed=0, **options[row["configuration"]])
        report, told = metrics.error_map(plr, lambda _: distance, x), row["seeds"][0]
        assert (told["seed"], told["bytes"]) == (0, plr.num_bytes), row["configuration"]
        assert report.max <= told["max"] * 1.001 and report.mean == pytest.approx(told["mean"], rel=0.5)


def test_fig1_is_of_the_file_of_this_code():
    results = json.loads((RESULTS / "fig1.json").read_text())["results"]
    cone = Euclidean((0.0, 0.0)), Box((0.0, 0.0), (1.0, 1.0))
    plr = construct(*cone, max_depth=6, options=BuildOptions(should_split=maximum_depth, split=cyclic_axis))
    assert base64.b64decode(results["plr_base64"]) == plr.to_bytes() and results["bytes"] == plr.num_bytes
