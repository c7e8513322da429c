"""Levels of the boxes of a family: each once, halves beneath, and the best trees below beside a recursion."""

from itertools import pairwise

import numpy as np
import pytest

from plr_jax import VisibilityGraph, scenes
from plr_jax.plr.certificate.certificate import Proof
from plr_jax.plr.growth.levels import BoxLevel, expand, prune
from plr_jax.plr.growth.limits import check_limits
from plr_jax.plr.leaves.cone.boxes import fitted_boxes
from plr_jax.plr.leaves.cone.family.start import Start
from plr_jax.plr.leaves.cone.family.trees import Cut, member_trees
from plr_jax.plr.partition.cells import tree_of_levels

MAZE = scenes.maze().workspace
PRICES = 2.0 ** -np.arange(7, 12)
SHARE = 0.01
GAIN = 4.0  # prices that a box must cost to be halved


@pytest.fixture(scope="module")
def family():
    """Levels of boxes of two goals, and which box each goal starts at."""
    first = VisibilityGraph(MAZE, (0.06, 0.07))
    oracles, start = [first, first.with_goal((0.9, 0.9))], Start.of(1.0, 13, 8)
    limits = check_limits(2, 0.5, True, lambda dim, leaves: leaves, 8, None, 10_000, None, Proof.NONE, 13)
    lo, hi = start.lowest.boxes(MAZE.bounds)
    found, key, node_of = first.family_sources(first.shared_cells(MAZE.bounds, lo, hi), oracles)
    cells = start.lowest[np.zeros(found.num_cells, int)]
    levels = [BoxLevel.of(fitted_boxes(MAZE.bounds, 1e-8, cells, found), key)]
    expand(levels, np.ones(len(key), bool), float(PRICES[-1]), SHARE, limits, GAIN, 1.0)
    return start, levels, node_of


def test_each_box_is_there_once_and_halves_are_half(family):
    _, levels, _ = family
    assert len(levels) > 5
    for level, below in pairwise(levels):
        assert len(np.unique(below.key)) == len(below.key) == len(below.boxes.cells)
        axis, side, box = np.nonzero(level.child >= 0)
        half, cells = below.boxes.cells[level.child[axis, side, box]], level.boxes.cells
        expected = cells[box].halves(axis, side == 1)
        np.testing.assert_array_equal(half.depth, expected.depth)
        np.testing.assert_array_equal(half.position, expected.position)
    assert (levels[-1].child < 0).all()


def test_no_half_is_left_to_be_looked_at(family):
    """Below the start all boxes above the price were halved along both axes, or along one that costs less."""
    _, levels, _ = family
    below = np.arange(len(levels[0].key))
    for level in levels[:-1]:
        depth = level.boxes.cells.depth
        dear = (level.costs(SHARE) > GAIN * PRICES[-1]) & (depth[:, 0] == depth[:, 1])
        children = level.child[:, :, below[dear[below]]]
        assert (children != -1).all() and (children >= 0).any(axis=(0, 1)).all()
        below = np.unique(level.child[:, :, below])
        below = below[below >= 0]


def test_the_best_trees_are_those_of_a_recursion(family):
    _, levels, _ = family
    prunings = prune(levels, PRICES, SHARE, GAIN)
    costs = [level.costs(SHARE) for level in levels]
    for p, price in enumerate(PRICES):
        memo = {}

        def best(depth, box, price=price, memo=memo):
            if (depth, box) not in memo:
                ways = [costs[depth][box] + price]
                if costs[depth][box] > GAIN * price:
                    halves = [each for each in levels[depth].child[:, :, box].tolist() if each[0] >= 0]
                    ways += [sum(best(depth + 1, half) for half in both) for both in halves]
                memo[depth, box] = min(ways)
            return memo[depth, box]

        for depth, level in enumerate(levels[:4]):
            np.testing.assert_allclose(
                prunings.total[depth][p], [best(depth, box) for box in range(len(level.key))], rtol=1e-12
            )


def test_trees_are_walked_with_the_leaves_and_totals_that_were_counted(family):
    start, levels, node_of = family
    prunings = prune(levels, PRICES, SHARE, GAIN)
    total, count = (column[0][:, node_of] for column in (prunings.total, prunings.count))
    top = start.best(total, count, np.full((2, 1), -2), PRICES)
    nothing = np.zeros(2, int)
    trees = member_trees(start, top, levels, prunings, node_of, Cut(np.arange(2), np.array([1, 3]), nothing))
    for goal, (tree, price) in enumerate(zip(trees, (1, 3), strict=True)):
        assert len(tree.cells) == count[price, goal, 0]
        assert np.ldexp(1.0, -tree.cells.depth.sum(axis=1)).sum() == 1
        again = tree_of_levels(tree.levels, 2).leaves
        np.testing.assert_array_equal(again.depth, tree.cells.depth)
        np.testing.assert_array_equal(again.position, tree.cells.position)
        cost = sum(levels[d].costs(SHARE)[box] for d, box in zip(tree.depth, tree.box, strict=True))
        np.testing.assert_allclose(cost + PRICES[price] * len(tree.cells), total[price, goal, 0])
