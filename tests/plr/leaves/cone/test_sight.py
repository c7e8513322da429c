"""Sources in sight: chosen where they cost little, never at the expense of what is proven, as far as bytes allow."""

import numpy as np
import pytest
from plr_helpers import UNIT

from plr_jax import VisibilityGraph, Workspace, construct, scenes
from plr_jax.plr._location import leaf_of
from plr_jax.plr.leaves.cone import best

GOAL = (0.1, 0.1)
WALL = [(0.4, 0), (0.5, 0), (0.5, 0.7), (0.4, 0.7)]


def own_sources(tree, options, fits):
    return tree.source


@pytest.fixture(scope="module")
def maze():
    problem = scenes.maze()
    return VisibilityGraph(problem.workspace, problem.goals[0])


def share_in_sight(plr, workspace, x):
    source = plr.stored.sources.points[plr.stored.source[leaf_of(plr, x)]]
    return workspace.is_visible(x, source).mean()


@pytest.mark.parametrize("max_bytes", [261, 661])
def test_more_points_see_their_source_and_no_proof_is_worse(maze, max_bytes, monkeypatch):
    workspace = maze.workspace
    x = workspace.sample_free(20_000, seed=0)
    plr = construct(maze, workspace.bounds, leaf="cone", max_bytes=max_bytes, certified=True)
    monkeypatch.setattr(best, "sources_in_sight", own_sources)
    before = construct(maze, workspace.bounds, leaf="cone", max_bytes=max_bytes, certified=True)
    assert plr.num_leaves == before.num_leaves and before.num_bytes <= max_bytes and plr.num_bytes <= max_bytes
    assert plr.max_error <= before.max_error * (1 + 1e-6)
    hidden, hidden_before = (1 - share_in_sight(each, workspace, x) for each in (plr, before))
    assert hidden < 0.25 * hidden_before
    error, error_before = (np.abs(np.asarray(each(x)) - maze(x)).mean() for each in (plr, before))
    assert error < 1.5 * error_before


def test_only_as_many_changes_are_made_as_fit(maze, monkeypatch):
    trees, changed = [], []
    choose = best.sources_in_sight

    def with_few(*arguments):
        trees.append(arguments[0])
        for most in (0, 3, 10**9):
            changed.append(
                choose(*arguments[:2], lambda source, most=most: (source != trees[0].source).sum() <= most)
            )
        return changed[-1]

    monkeypatch.setattr(best, "sources_in_sight", with_few)
    construct(maze, maze.workspace.bounds, leaf="cone", max_leaves=200)
    counts = [(source != trees[0].source).sum() for source in changed]
    assert counts[:2] == [0, 3] and counts[2] > 5
    few, many = (np.flatnonzero(source != trees[0].source) for source in changed[1:])
    assert np.isin(few, many).all() and (changed[1][few] == changed[2][few]).all()


def test_where_all_is_in_sight_nothing_changes(monkeypatch):
    exact = VisibilityGraph(Workspace(((0, 0), (1, 1))), GOAL)
    calls = []
    choose = best.sources_in_sight
    monkeypatch.setattr(best, "sources_in_sight", lambda *arguments: calls.append(choose(*arguments)) or calls[-1])
    plr = construct(exact, UNIT, leaf="cone", max_bytes=128)
    assert calls[0].tolist() == [0] and plr.num_leaves == 1
