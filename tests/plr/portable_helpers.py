"""Helpers for tests of readers without JAX: PLRs of all kinds, hard points, and a slow independent reader."""

from functools import cache, reduce
from itertools import product
from operator import add

import numpy as np
import pytest
from vectors import FOLDER

from plr_jax import PLR, load
from plr_jax.plr.query import evaluate_anywhere


@cache
def case(name: str) -> PLR:
    """Return the PLR of this name from ``tests/plr/vectors``, with spaces for underscores."""
    return load(FOLDER / f"{name.replace(' ', '_')}.plr")


def full(*names):
    """Return names of PLRs as parameters of full tests."""
    return [pytest.param(name, marks=pytest.mark.full) for name in names]


def is_far(plr):
    """Return whether the C and JavaScript programs of a PLR take points in 64 bits."""
    lo, hi = plr.domain.lo, plr.domain.hi
    return bool((np.maximum(np.abs(lo), np.abs(hi)) > 4 * (hi - lo)).any())


def hard_points(plr, n=2000, seed=0):
    """Return points at random, on faces of cells, at and beside corners, outside the domain, infinite and NaN."""
    rng, domain = np.random.default_rng(seed), plr.domain
    inside = rng.uniform(domain.lo, domain.hi, (n, plr.dim))
    faces = domain.lo + domain.width * rng.integers(0, 65, (n, plr.dim)) / 64
    mixed = np.where(rng.random((n, plr.dim)) < 0.5, inside, faces)
    corners = rng.permutation(list(product(*zip(domain.lo, domain.hi, strict=True))))[:16]
    of_type = np.float64 if is_far(plr) else np.float32
    beside = [np.nextafter(corners.astype(of_type), of_type(to)) for to in (-np.inf, np.inf)]
    around = inside + domain.width * rng.integers(-3, 4, (n, plr.dim))
    bad = inside[np.arange(60) % n]
    bad[np.arange(60), rng.integers(plr.dim, size=60)] = np.resize([np.nan, np.inf, -np.inf, 3e38, -3e38], 60)
    every = np.concatenate([inside, faces, mixed, corners, *beside, around, bad, 0 * corners, -0.0 * corners])
    return every.astype(of_type)


def compiled_answers(plr, x, outside="inf"):
    tables, x = plr.tables_and_points(x)
    return np.asarray(evaluate_anywhere(tables, x, outside))


def same_bits(a, b):
    """Return whether arrays of floats have equal bits; all NaN count as equal."""
    a, b = np.asarray(a), np.asarray(b)
    assert a.dtype == b.dtype and a.dtype in (np.float32, np.float64) and a.shape == b.shape
    return np.array_equal(a, b, equal_nan=True) and np.array_equal(np.signbit(a)[a == 0], np.signbit(b)[b == 0])


class SlowReader:
    """A reader that follows ``plr_jax/plr/portable/FORMAT.md``, one point at a time, in scalars of NumPy.

    A point is compared with each cell. The reader takes from the package the planes of unreachable leaves, the domain
    of a folding, and the polynomials of leaves. Those of continuous and smooth leaves were computed independently, in
    exact fractions, for the answers in ``tests/plr/vectors``.
    """

    def __init__(self, plr):
        contents = plr._contents
        self.plr, self.contents, self.folding = plr, contents, contents.folding
        self.outer, self.box, self.periodic = plr.domain, contents.domain, np.array(plr.domain.periodic)
        self.is_far, f32 = is_far(plr), np.float32
        self.origin = self.outer.lo if self.is_far else np.zeros(plr.dim)
        self.ends = _outward(self.outer.lo - self.origin, self.outer.hi - self.origin)
        of_leaves = self.origin if self.folding is None else np.zeros(plr.dim)
        lo, hi = self.box.lo - of_leaves, self.box.hi - of_leaves
        self.lo, self.hi = down, up = _outward(lo, hi)
        rest = [np.nextafter(r.astype(f32), f32(-1)) for r in (lo - down, up - hi)]
        self.rest = [np.maximum(r, f32(0)) for r in rest]
        self.scale = (1 / (hi - lo)).astype(f32)
        self.start = (1 - (lo - down) / (hi - lo)).astype(f32)
        top = 2 - 2.0**-23 - self.start.astype(float)
        self.top = top.astype(f32)
        self.top = np.where(self.top > top, np.nextafter(self.top, f32(0)), self.top)
        self.numbers = self._numbers(of_leaves + down)

    def _numbers(self, down):
        leaf, cells = self.contents.leaf, self.contents.tree.leaves
        numbers = leaf.leaf_parameters(self.box, cells, self.plr._coefficients, down)
        coefficients = leaf.coefficients(cells, self.contents.stored)
        is_own = np.isfinite(coefficients[:, 0])
        if leaf.name == "cone":
            numbers[is_own] = np.column_stack([coefficients[:, 0], coefficients[:, 1:] - down])[is_own]
        elif leaf.name == "plane":
            numbers[is_own] = self._planes(coefficients, down)[is_own]
        if self.contents.cut_off is not None:
            numbers[self.contents.cut_off, 0] = np.inf
        return numbers.astype(np.float32)

    def _planes(self, coefficients, down):
        cells, width = self.contents.tree.leaves, self.box.hi - self.box.lo
        size = np.ldexp(1.0, -cells.depth)
        low, high = self.box.lo + width * (cells.position * size), self.box.lo + width * ((cells.position + 1) * size)
        slopes = coefficients[:, 1:] * 2 / (high - low)
        total = reduce(add, (slopes * ((low + high) / 2 - down)).T, 0.0)
        return np.column_stack([coefficients[:, 0] - total, slopes])

    def __call__(self, x):
        with np.errstate(all="ignore"):
            return np.array([self._value(point) for point in x], np.float32)

    def waypoint(self, x):
        """Return the source of the leaf of each point, for PLRs of cones."""
        with np.errstate(all="ignore"):
            return np.array([self._waypoint(point) for point in x], np.float64 if self.is_far else np.float32)

    def _waypoint(self, x):
        if (z := self._placed(x)) is None:
            return np.full(len(x), np.nan)
        return (self.origin if self.is_far else self.lo) + self.numbers[self._leaf(z - self.lo), 1:]

    def _value(self, x):
        if (z := self._placed(x)) is None:
            return np.nan if np.isnan(x).any() else np.inf
        value, straight = self._leaf_value(z - self.lo), self.contents.straight
        return value if straight is None else max(value, self._straight(straight, z - self.lo))

    def _straight(self, bound, above):
        f32, period = np.float32, (self.hi - self.rest[1]) - (self.lo + self.rest[0])
        costs = []
        for goal in bound.goals.astype(f32):
            change = above - goal
            change = np.where(self.periodic, np.minimum(np.abs(change), period - np.abs(change)), change)
            squares = [reduce(add, change[group == 1] ** 2) for group in bound.groups]
            costs.append(reduce(add, np.sqrt(squares) * bound.rates.astype(f32)))
        return max(min(costs) - f32(bound.margin), f32(0))

    def _placed(self, x):
        """Return a point relative to the origin, wrapped and mirrored; None outside the domain."""
        if not np.isfinite(x[self.periodic]).all():
            return None
        if self.is_far or x.dtype == np.float64:
            lo, hi = self.outer.lo, self.outer.hi
            x = np.where(self.periodic, _wrapped(x.astype(np.float64), lo, hi, 1 / (hi - lo), 0.0), x)
        z = (x - self.origin).astype(np.float32)
        if not (self.periodic | ((self.ends[0] <= z) & (z <= self.ends[1]))).all():
            return None
        z = z if self.folding is None else self._folded(z)
        a, b = self.lo + self.rest[0], self.hi - self.rest[1]
        tolerance = np.float32(2.0**-44) * np.maximum(np.abs(a), np.abs(b))
        return np.where(self.periodic, _wrapped(z, a, b, self.scale, tolerance), z)

    def _folded(self, x):
        folding, f32 = self.folding, np.float32
        center = (folding.center - self.origin).astype(f32)
        z = (x - center) - (folding.center - self.origin - center).astype(f32)
        if folding.is_turned:
            z = np.array([reduce(add, row * z) for row in folding.axes.astype(f32)])
        for mirror, pivot in zip(folding.mirrors, folding.pivots, strict=True):
            z = np.where(mirror, -z, z) if z[pivot] < 0 else z
        hi, lo = _outward(folding.box.hi, folding.box.lo)  # rounded inward, as swapped ends
        return np.where(self.periodic, z, np.minimum(np.maximum(z, lo), hi))

    def _leaf(self, above):
        placed = np.maximum(np.minimum(above * self.scale, self.top) + self.start, np.float32(1))
        places, cells = placed.view(np.uint32).astype(int) & 0x7FFFFF, self.contents.tree.leaves
        holds = (places >> (23 - cells.depth) == cells.position).all(axis=1)
        assert holds.sum() == 1
        return int(holds.argmax())

    def _leaf_value(self, above):
        leaf, model, cells, f32 = self._leaf(above), self.contents.leaf, self.contents.tree.leaves, np.float32
        n = self.numbers[leaf]
        if model.name == "plane":
            return reduce(add, n[1:] * above, n[0])
        if model.name == "cone":
            d = above - n[1:]
            return n[0] + np.sqrt(reduce(add, d * d))
        u = above * self.scale
        u = np.where(self.start < 1, u + (self.start - f32(1)), u)
        t = u * (1 << cells.depth[leaf]).astype(f32) - cells.position[leaf].astype(f32)
        return _horner(n[len(t) :].reshape([model.num_powers] * len(t)), t)


def _horner(coefficients, t):
    if not len(t):
        return coefficients[()]
    terms = [_horner(part, t[1:]) for part in coefficients[::-1]]
    return reduce(lambda total, term: total * t[0] + term, terms)


def _wrapped(x, a, b, scale, tolerance):
    moved = np.minimum(np.maximum(x - np.floor((x - a) * scale) * (b - a), a), b)
    return np.where(np.abs(x - b) <= tolerance, a, moved)


def _outward(lo, hi):
    down, up = lo.astype(np.float32), hi.astype(np.float32)
    down = np.where(down > lo, np.nextafter(down, np.float32(-np.inf)), down)
    return down, np.where(up < hi, np.nextafter(up, np.float32(np.inf)), up)
