"""The best dyadic partition, against all dyadic partitions."""

from dataclasses import dataclass
from functools import cache
from itertools import product

import numpy as np
import pytest

from plr_jax.plr import best_partition
from plr_jax.plr.best_partition import PriceSearch, cost_if_halved
from plr_jax.plr.certificate import Proof
from plr_jax.plr.growth import Limits, grow
from plr_jax.plr.tree import Cells


@pytest.fixture(autouse=True)
def boxes_of_all_shapes_in_small_batches(monkeypatch):
    """Allow all boxes of up to three splits along each axis, and judge few boxes at once."""
    monkeypatch.setattr(best_partition, "BOXES_PER_BATCH", 20)
    monkeypatch.setattr(best_partition, "MAX_ASPECT_BITS", 3)


DEPTH = 3


@cache
def random_costs(seed):
    """Return a cost for every box of up to three splits along each axis: random, smaller for smaller boxes."""
    rng, costs = np.random.default_rng(seed), {}
    for d0, d1 in product(range(DEPTH + 1), repeat=2):
        for p0, p1 in product(range(2**d0), range(2**d1)):
            costs[d0, d1, p0, p1] = float(rng.random() ** 2 * 3.0 ** -(d0 + d1))
    return costs


@dataclass(frozen=True, eq=False)
class FakeBoxes:
    """Boxes with the costs of a table. ``asked`` collects the boxes whose cost was needed."""

    costs: dict
    cells: Cells
    asked: list

    @property
    def integral(self):
        keys = np.concatenate([self.cells.depth, self.cells.position], axis=1)
        return np.array([self.costs[tuple(key)] for key in keys.tolist()])

    @property
    def peak(self):
        return np.zeros(len(self.cells))

    def __getitem__(self, index):
        return FakeBoxes(self.costs, self.cells[index], self.asked)

    def append(self, *others):
        return FakeBoxes(self.costs, self.cells.append(*(other.cells for other in others)), self.asked)

    def halves(self, parent, axis, is_upper):
        cells = self.cells[parent].halves(axis, is_upper)
        self.asked.extend(map(tuple, np.concatenate([cells.depth, cells.position], axis=1).tolist()))
        return FakeBoxes(self.costs, cells, self.asked)


@cache
def least_costs(seed, max_depth=2 * DEPTH):
    """Return the least cost of all trees of each number of leaves, from all numbers of leaves in the two halves."""
    costs = random_costs(seed)

    @cache
    def least(d0, d1, p0, p1):
        best = np.full(4**DEPTH + 1, np.inf)
        best[1] = costs[d0, d1, p0, p1]
        if d0 + d1 == max_depth:
            return best
        pairs = []
        if d0 < DEPTH:
            pairs.append((least(d0 + 1, d1, 2 * p0, p1), least(d0 + 1, d1, 2 * p0 + 1, p1)))
        if d1 < DEPTH:
            pairs.append((least(d0, d1 + 1, p0, 2 * p1), least(d0, d1 + 1, p0, 2 * p1 + 1)))
        for lower, upper in pairs:
            for number in np.flatnonzero(np.isfinite(lower)):
                both = lower[number] + upper[: len(best) - number]
                best[number:] = np.minimum(best[number:], both)
        return best

    return least(0, 0, 0, 0)


def limits_for(**given):
    none = {"max_depth": 60, "max_axis_depth": DEPTH, "max_leaves": 10**9, "max_bytes": np.inf, "tolerance": 0.0}
    return Limits(**(none | given), proof=Proof.NONE, frame_bytes=13)


def size(levels, tree):
    return 10 + 3 * len(tree)


def best_boxes(root, **given):
    price_search = PriceSearch(root, limits_for(**given), size)
    tree = grow(price_search.first(), price_search.next, limits_for(**given))
    first, *others = (level.boxes[box] for level, box in zip(price_search.levels, tree.leaves, strict=False))
    return first.append(*others)


def search(costs, **given):
    """Return cost, number of leaves and boxes of the best partition, after checking that they tile the domain."""
    root = FakeBoxes(costs, Cells.root(2), [])
    found = best_boxes(root, **given)
    assert len(root.asked) == len(set(root.asked)), "a box was judged twice"
    covered = np.zeros((2**DEPTH, 2**DEPTH), int)
    for depth, position in zip(found.cells.depth, found.cells.position, strict=True):
        start, stop = position << (DEPTH - depth), (position + 1) << (DEPTH - depth)
        covered[start[0] : stop[0], start[1] : stop[1]] += 1
    assert (covered == 1).all()
    return found.integral.sum(), len(found.cells), found


@pytest.mark.parametrize("most", [1, 5, 20, 40])
@pytest.mark.parametrize("limit", ["max_leaves", "max_bytes"])
def test_partitions_are_the_best_at_some_price(most, limit):
    """Each leaf takes three bytes."""
    given, largest = {limit: most if limit == "max_leaves" else 10.0 + 3 * most}, 0
    for seed in range(8):
        least = least_costs(seed)
        cost, number, _ = search(random_costs(seed), **given)
        assert number <= most
        np.testing.assert_allclose(cost, least[number], rtol=1e-12)
        n = np.arange(1, len(least))
        n = n[n != number]
        saved = (least[number] - least[n]) / (n - number)  # per leaf
        fewer, more = saved[n < number], saved[n > number]
        assert more.max() <= fewer.min(initial=np.inf)
        next_largest = n[n > number][more.argmax()] if more.max() > 0 else np.inf
        largest += next_largest > most
    assert largest >= 7  # a price is found by halving, which may miss one whose range is narrow


@pytest.mark.parametrize("max_depth", [0, 1, 3, 6])
def test_no_partition_of_the_allowed_depth_costs_less(max_depth):
    for seed in range(4):
        cost, _, found = search(random_costs(seed), max_depth=max_depth)
        assert found.cells.depth.sum(axis=1).max() <= max_depth
        np.testing.assert_allclose(cost, least_costs(seed, max_depth).min(), rtol=1e-12)


def test_depth_of_an_axis_and_aspect_of_boxes_are_limited(monkeypatch):
    assert search(random_costs(0), max_axis_depth=1)[2].cells.depth.max() == 1
    monkeypatch.setattr(best_partition, "MAX_ASPECT_BITS", 1)
    for seed in range(4):
        assert np.ptp(search(random_costs(seed))[2].cells.depth, axis=1).max() <= 1


def test_exact_boxes_and_hopeless_halves_are_not_halved():
    """The halves along the first axis are exact, so the halves along the second axis need no halves of their own."""
    costs = {key: float(key[0] == 0) * 2.0 ** -key[1] for key in random_costs(0)}
    root = FakeBoxes(costs, Cells.root(2), [])
    assert len(best_boxes(root).cells) == 2
    assert sorted(root.asked) == [(0, 1, 0, 0), (0, 1, 0, 1), (1, 0, 0, 0), (1, 0, 1, 0)]


def test_cost_of_a_halved_peak_is_least_over_all_leaves():
    peak, price = np.append(0.0, np.geomspace(0.01, 1e4, 50)), 0.1
    more = np.arange(1, 30)[:, None]
    least = ((1 + more) * price + peak / 3.0**more).min(axis=0)
    np.testing.assert_allclose(cost_if_halved(peak, price), least, rtol=1e-12)
