"""Files of earlier releases are read, with the answers of the release that wrote them."""

import json

import numpy as np
import pytest
from release_files import FILES, FOLDER, SINCE_0_3, answers, from_hex

import plr_jax
from plr_jax import scenes

RELEASES = sorted(FOLDER.iterdir())
TABLES = {path: json.loads((path / "answers.json").read_text()) for path in RELEASES}
CASES = [(release, kind) for release, table in TABLES.items() for kind in table]
named = {"ids": lambda value: getattr(value, "name", value)}


@pytest.mark.parametrize(("release", "kind"), CASES, **named)
def test_files_give_the_answers_of_the_release_that_wrote_them(release, kind):
    """Answers are equal bit for bit. Bounds may be tighter, but must still enclose the answers."""
    table = {
        name: np.array(from_hex(values)) for name, values in TABLES[release][kind].items() if name != "arguments"
    }
    arguments = [np.array(from_hex(each)) for each in TABLES[release][kind]["arguments"]]
    arguments = [each.astype(int) if each.ndim == 1 else each for each in arguments]  # floors, or points
    found = answers(kind, plr_jax.load(release / f"{kind}.plr"), arguments)
    assert found.keys() == table.keys() and np.isfinite(found["answer"]).any()
    np.testing.assert_array_equal(found["answer"], table["answer"])
    if "lower" in table:
        assert np.all((table["lower"] <= found["lower"]) & (found["lower"] <= found["answer"]))
        assert np.all((found["answer"] <= found["upper"]) & (found["upper"] <= table["upper"]))


@pytest.mark.parametrize("release", RELEASES, **named)
def test_scenes_and_solutions_of_releases_are_read(release):
    problem, solution = scenes.load(release / "scene.json"), plr_jax.Solution.load(release / "solution.json")
    now = scenes.single_door()
    assert problem.robots == now.robots and problem.workspace.bounds == now.workspace.bounds
    np.testing.assert_array_equal([problem.starts, problem.goals], [now.starts, now.goals])
    x = now.workspace.bounds.lo + np.random.default_rng(0).random((200, 2)) * now.workspace.bounds.width
    np.testing.assert_array_equal(problem.workspace.is_free(x), now.workspace.is_free(x))
    report = plr_jax.validate(problem, solution.path)
    assert report.valid and report.cost == pytest.approx(solution.cost, rel=1e-12)


def test_files_of_all_kinds_and_releases_are_tested():
    assert {path.name for path in RELEASES} >= {"0.2.0", "0.3.0"}
    for release, table in TABLES.items():
        assert table.keys() == (FILES if release.name == "0.2.0" else FILES | SINCE_0_3).keys()
