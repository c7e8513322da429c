"""The boxes above the start, and the best trees over them, beside a recursion."""

import numpy as np
import pytest

from plr_jax.plr.growth.levels import MAX_ASPECT_BITS
from plr_jax.plr.leaves.cone.family.start import NONE, Start

ANY = -1  # source where nothing reaches the goal


def key(cells, i):
    return (*cells.depth[i].tolist(), *cells.position[i].tolist())


@pytest.mark.parametrize("splits", [0, 1, 3, 5])
def test_all_boxes_of_so_many_splits_and_their_halves(splits):
    start = Start.of(8.0 * 2**splits, 13, 26)
    assert start.splits == splits
    place = {key(start.cells, i): i for i in range(len(start.cells))}
    shapes = [(i, n - i) for n in range(splits + 1) for i in range(n + 1) if abs(n - 2 * i) <= MAX_ASPECT_BITS]
    assert len(place) == len(start.cells) == sum(2 ** sum(shape) for shape in shapes)
    assert (start.lowest.depth.sum(axis=1) == splits).all()
    for i in range(len(start.cells)):
        a, b, x, y = key(start.cells, i)
        for side in range(2):
            assert start.child[0, side, i] == place.get((a + 1, b, 2 * x + side, y), -1)
            assert start.child[1, side, i] == place.get((a, b + 1, x, 2 * y + side), -1)


def test_depth_limits_hold_the_start():
    assert Start.of(1e9, 13, 4).splits == 4
    assert (Start.of(1e9, 1, 2).cells.depth <= 1).all()


def best_by_recursion(start, total, source, price):
    """Least total of each box, for one goal and one price, and its source if it is one leaf without an error."""
    first, memo = start.first[start.splits], {}

    def best(i):
        if i >= first:
            return total[i - first], source[i - first]
        if i not in memo:
            ways = [[best(j) for j in start.child[axis, :, i]] for axis in range(2) if start.child[axis, 0, i] >= 0]
            common = NONE
            for (_, lower), (_, upper) in ways:
                if NONE not in (lower, upper) and (lower == upper or ANY in (lower, upper)):
                    common = max(common, lower, upper)
            least = min(lower + upper for (lower, _), (upper, _) in ways)
            memo[i] = price if common != NONE else least, common
        return memo[i]

    return [best(i) for i in range(len(start.cells))]


@pytest.mark.parametrize("seed", range(4))
def test_the_best_trees_above_are_those_of_a_recursion(seed):
    rng, start = np.random.default_rng(seed), Start.of(8.0 * 2**4, 13, 26)
    lowest, price = len(start.lowest), np.array([0.5, 0.125])
    total = price[:, None, None] * rng.integers(1, 4, (2, 3, lowest))
    count = rng.integers(1, 4, (2, 3, lowest))
    # In the left half one source serves all, or nothing is reached.
    source = rng.choice([NONE, 4], (3, lowest), p=[0.7, 0.3])
    x, _ = (start.lowest.position / 2.0**start.lowest.depth).T
    source[:, x < 0.5] = rng.choice([ANY, 7], (3, int((x < 0.5).sum())))
    total[:, source != NONE] = price[:, None]
    top = start.best(total, count, source, price)
    assert (top.source != NONE).any()
    for p in range(2):
        for goal in range(3):
            expected = best_by_recursion(start, total[p, goal], source[goal], price[p])
            np.testing.assert_allclose(top.total[p, goal], [each for each, _ in expected])
            np.testing.assert_array_equal(top.source[goal], [each for _, each in expected])


def test_a_chosen_axis_and_the_leaves_are_those_of_the_halves():
    rng, start = np.random.default_rng(9), Start.of(8.0 * 2**3, 13, 26)
    price, lowest = np.array([0.25]), len(start.lowest)
    total, count = rng.random((1, 2, lowest)), rng.integers(1, 9, (1, 2, lowest))
    top = start.best(total, count, np.full((2, lowest), NONE), price)
    for goal in range(2):
        for i in range(start.first[start.splits]):
            halves = start.child[top.choice[0, goal, i], :, i]
            assert np.isclose(top.total[0, goal, i], top.total[0, goal, halves].sum())
            assert top.count[0, goal, i] == top.count[0, goal, halves].sum()
