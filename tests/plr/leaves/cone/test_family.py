"""A family's boxes: above those that all start at, below them, and the best trees, beside recursions."""

from itertools import pairwise

import numpy as np
import pytest

from plr_jax import VisibilityGraph, Workspace, scenes
from plr_jax.plr.best_partition import MAX_ASPECT_BITS, PriceSearch, Thrift
from plr_jax.plr.certificate import Proof
from plr_jax.plr.leaves import leaf_model
from plr_jax.plr.leaves.base import check_limits
from plr_jax.plr.leaves.cone import search
from plr_jax.plr.sampling import sample_pattern

MAZE = scenes.maze().workspace
# A wall behind which one corner serves all, and a room of its own that no goal reaches.
CORNER = Workspace(((0, 0), (1, 1)), [[(0.5, 0.25), (0.52, 0.25), (0.52, 0.75), (0.5, 0.75)]])


def limits_of(max_leaves=None, max_depth=None, max_axis_depth=None):
    limits = check_limits(leaf_model("cone"), 2, max_depth, max_leaves, None, None, Proof.NONE, 13)
    return limits


def task_of(workspace, oracle, limits):
    return search.family_task(oracle, workspace.bounds, limits, sample_pattern(2, 96, 0, 0))


def levels_of_family(monkeypatch, workspace, goals, max_leaves):
    """What the search is given: levels of boxes, the box that each starts at, and how many splits are above."""
    first = VisibilityGraph(workspace, goals[0])
    oracles = [first, *(first.with_goal(goal) for goal in goals[1:])]
    given = []
    monkeypatch.setattr(search, "best_cones", lambda *arguments: given.append(arguments) or [])
    task = task_of(workspace, first, limits_of(max_leaves))
    task(oracles)
    return given[0][0], given[0][1], len(task.halves)


@pytest.mark.parametrize(("splits", "limits"), [(0, (8,)), (3, (64,)), (5, (256,)), (4, (10**6, 4))])
def test_all_cells_of_so_many_splits_and_their_halves(splits, limits):
    task = task_of(MAZE, VisibilityGraph(MAZE, (0.06, 0.07)), limits_of(*limits))
    assert len(task.halves) == splits == len(task.tops) - 1
    for number, cells in enumerate(task.tops):
        shapes = [(i, number - i) for i in range(number + 1) if abs(number - 2 * i) <= MAX_ASPECT_BITS]
        assert len(np.unique(cells.hashes())) == len(cells) == len(shapes) * 2**number
        assert (cells.depth.sum(axis=1) == number).all()
    for (cells, below), child in zip(pairwise(task.tops), task.halves, strict=True):
        axis, side, box = np.nonzero(child >= 0)
        half, expected = below[child[axis, side, box]], cells[box].halves(axis, side == 1)
        np.testing.assert_array_equal(half.depth, expected.depth)
        np.testing.assert_array_equal(half.position, expected.position)


@pytest.mark.parametrize("workspace", [MAZE, CORNER], ids=["maze", "corner"])
def test_boxes_above_the_start_are_leaves_where_one_source_serves_all(workspace, monkeypatch):
    levels, roots, splits = levels_of_family(monkeypatch, workspace, [(0.06, 0.07), (0.9, 0.93)], 8 * 2**5)
    assert splits == 5 and len(roots) == 2
    found = 0
    for level, below in pairwise(levels):
        for box in range(len(level.key)):
            sources = [
                set(below.boxes.source[both][below.boxes.source[both] >= 0])
                for both in level.child[:, :, box]
                if both[0] >= 0 and (below.boxes.error[both] == 0).all()
            ]
            is_one = any(len(each) <= 1 for each in sources)
            assert level.boxes.error[box] == (0.0 if is_one else np.inf)
            found += is_one
    assert found


def test_trees_are_those_of_a_recursion_and_boxes_are_there_once(monkeypatch):
    levels, roots, _ = levels_of_family(monkeypatch, MAZE, [(0.06, 0.07), (0.9, 0.93)], 8 * 2**3)
    search = PriceSearch(levels, roots, limits_of(64), lambda member, tree: 0, thrift=Thrift(1.2, 4, 0.99))
    forest = search.first()
    while (larger := search.next(forest)) is not None:
        forest = larger
    for level, below in pairwise(levels[3:]):
        assert len(np.unique(below.key)) == len(below.key) == len(below.boxes.cells)
        axis, side, box = np.nonzero(level.child >= 0)
        half, expected = (
            below.boxes.cells[level.child[axis, side, box]],
            level.boxes.cells[box].halves(axis, side == 1),
        )
        np.testing.assert_array_equal(half.position, expected.position)
    for member, tree in enumerate(forest.trees):
        assert 32 < len(tree) <= 64
        share, costs = 0.01 / 64, [level.costs(0.01 / 64) for level in levels]
        found = search._tree_alone(member, tree.price, share)
        memo = {}

        def best(depth, box, price=tree.price, costs=costs, memo=memo):
            if (depth, box) not in memo:
                ways = [costs[depth][box] + price]
                if costs[depth][box] > price:
                    halves = [each for each in levels[depth].child[:, :, box].tolist() if each[0] >= 0]
                    ways += [sum(best(depth + 1, half) for half in both) for both in halves]
                memo[depth, box] = min(ways)
            return memo[depth, box]

        total = sum(float(cost[box].sum()) for cost, box in zip(costs, found.leaves, strict=False))
        np.testing.assert_allclose(total + tree.price * len(found), best(0, int(roots[member])), rtol=1e-12)
