import numpy as np
import pytest
from plr_helpers import UNIT

from plr_jax import Box, VisibilityGraph, Workspace, construct, scenes
from plr_jax.plr.growth import ConstructionInterrupted, grow

MAZE = scenes.maze()
ORACLE = VisibilityGraph(MAZE.workspace, MAZE.goals[0])


def mean_error(plr, oracle, x):
    return np.abs(np.asarray(plr(x)) - oracle(x)).mean()


def test_corners_that_have_no_room_are_not_named_and_the_error_is_the_smaller():
    free = np.ones((42, 42), bool)
    free[3::6, 3::6] = False  # 196 corners
    workspace = Workspace.from_mask(free)
    oracle, x = VisibilityGraph(workspace, (1, 1)), workspace.sample_free(2000, 0)
    best, cones = (construct(oracle, workspace.bounds, leaf=leaf, max_bytes=160) for leaf in ("best", "cone"))
    assert best.leaf.name == "continuous" and mean_error(best, oracle, x) < 0.8 * mean_error(cones, oracle, x)
    assert construct(ORACLE, UNIT, leaf="best", max_bytes=200).leaf.name == "cone"


@pytest.mark.parametrize("limit", [{"max_bytes": 80}, {"max_leaves": 20}])  # too few for cones alone
def test_the_least_mean_error_is_taken(limit):
    x = MAZE.workspace.sample_free(20_000, 1)
    built = [construct(ORACLE, UNIT, leaf=leaf, **limit) for leaf in ("continuous", "cone")]
    best = construct(ORACLE, UNIT, leaf="best", **limit)
    assert best.to_bytes() == min(built, key=lambda plr: mean_error(plr, ORACLE, x)).to_bytes()


def test_what_has_no_corners_has_continuous_leaves_or_planes_where_there_are_too_many_axes():
    asked = []

    def norm(x):
        asked.append(len(x))
        return np.linalg.norm(x, axis=1)

    for dim, name in ((3, "continuous"), (7, "plane")):
        box = Box([-1] * dim, [1] * dim)
        asked.clear()
        best = construct(norm, box, leaf="best", max_leaves=3)
        total = sum(asked)
        assert best.leaf.name == name and best.to_bytes() == construct(norm, box, leaf=name, max_leaves=3).to_bytes()
        assert sum(asked) == 2 * total, "nothing is asked for a choice of one"


def test_an_interrupt_keeps_the_best_so_far(monkeypatch):
    def interrupted(tree, split_some, limits):
        def interrupt(now):
            raise KeyboardInterrupt

        return grow(tree, interrupt, limits)

    monkeypatch.setattr("plr_jax.plr.leaves.continuous.grow", interrupted)
    with pytest.warns(ConstructionInterrupted, match="the best one built so far"):
        assert construct(ORACLE, UNIT, leaf="best", max_bytes=80).leaf.name == "continuous"


def test_an_interrupt_while_models_are_compared_keeps_what_is_built(monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("plr_jax.plr._best._mean_error", interrupted)
    with pytest.warns(ConstructionInterrupted, match="the best one built so far"):
        assert construct(ORACLE, UNIT, leaf="best", max_bytes=80).num_leaves > 1


@pytest.mark.usefixtures("unchecked_types")
def test_a_budget_that_is_no_number_is_refused_as_of_other_leaves():
    with pytest.raises(ValueError, match="max_bytes must be an integer >= 1, got 'x'"):
        construct(ORACLE, UNIT, leaf="best", max_bytes="x")
