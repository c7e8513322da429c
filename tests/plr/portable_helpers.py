"""Helpers for tests of readers without JAX: PLRs of all kinds, hard points, and a slow independent reader."""

from functools import cache, reduce
from itertools import product
from operator import add

import numpy as np
import pytest
from plr_helpers import chain, random_contents
from vectors import FOLDER

from plr_jax import (
    PLR,
    Box,
    Euclidean,
    NearestGoal,
    ReedsShepp,
    VisibilityGraph,
    VoxelSpace,
    Workspace,
    construct,
    from_bytes,
    load,
    scenes,
    solve_eikonal,
)
from plr_jax.plr._file import encode

TURNS = Box((-4, -4, -np.pi), (4, 4, np.pi), periodic=(False, False, True))
ASIDE = Box((-2, -4, -np.pi), (6, 3, np.pi), periodic=(False, False, True))
FAR_TURNS = Box((998, -1e3 - 4, -np.pi), (1004, -1e3 + 2, np.pi), periodic=(False, False, True))
GRID_ZONE = Box((5e5, 4e6), (5e5 + 2000.3, 4e6 + 1500.7))


def _waves(x):
    return 3 + np.sin(3 * x[:, 0]) + np.cos(2 * x[:, -1])


def _random(dim, leaf, seed=0, **options):
    return from_bytes(encode(random_contents(seed, dim, leaf, **options)))


def _maze(leaf, max_bytes, *other_goals):
    problem = scenes.maze()
    oracle = VisibilityGraph(problem.workspace, problem.goals[0])
    if other_goals:
        oracle = NearestGoal([oracle, *map(oracle.with_goal, other_goals)])
    return construct(oracle, ((0, 0), (1, 1)), leaf=leaf, max_bytes=max_bytes, certified=True)


def _straight():
    return solve_eikonal(VoxelSpace(np.ones((6, 5, 4), bool)), (1.3, 2.0, 0.5), max_leaves=40)


CASES = {
    "maze of planes": lambda: _maze("plane", 512),
    "maze of values": lambda: _maze("continuous", 400),
    "maze of gradients": lambda: _maze("smooth", 300),
    "maze of cones": lambda: _maze("cone", 300),
    "cones of exits": lambda: _maze("cone", 300, (0.1, 0.1), (0.9, 0.1)),
    "cones in space": lambda: _random(3, "cone", 7),
    "one leaf": lambda: construct(Euclidean((1, 2)), ((-3, -1), (2, 4)), leaf="plane", max_leaves=1),
    "random planes on a line": lambda: _random(1, "plane", 1),
    "random planes": lambda: _random(5, "plane", 2),
    "random values": lambda: _random(3, "continuous", 3),
    "values in six dimensions": lambda: construct(_waves, (-np.ones(6), np.ones(6)), leaf="continuous", max_leaves=4),
    "deep": lambda: _random(2, "plane", 4, cells=chain([0, 1] * 12)),
    "around": lambda: construct(_waves, Box((-0.3, 1), (3, 1.7), periodic=(False, True)), max_leaves=40),
    "smooth around": lambda: _random(2, "smooth", 6, periodic=(False, True)),
    "around twice": lambda: _random(2, "continuous", 5, periodic=(True, True)),
    "folded car": lambda: construct(ReedsShepp((0, 0, 0), 1), TURNS, leaf="continuous", max_leaves=100),
    "folded car of planes": lambda: construct(ReedsShepp((1, 0.5, 0.6), 1), ASIDE, leaf="plane", max_leaves=100),
    "straight bound": _straight,
    "far planes": lambda: construct(Euclidean((5e5 + 90, 4e6 + 70)), GRID_ZONE, leaf="plane", max_leaves=50),
    "far cones": lambda: construct(
        VisibilityGraph(Workspace(GRID_ZONE), (5e5 + 90, 4e6 + 70)), GRID_ZONE, leaf="cone"
    ),
    "far around": lambda: construct(_waves, Box((1000, 3), (1003, 3.5), periodic=(False, True)), max_leaves=40),
    "far folded car": lambda: construct(ReedsShepp((1e3, -1e3, 2), 1), FAR_TURNS, leaf="continuous", max_leaves=100),
}


@cache
def case(name: str) -> PLR:
    """Return a PLR by name: its stored file if there is one, else built."""
    path = FOLDER / f"{name.replace(' ', '_')}.plr"
    return load(path) if path.exists() else CASES[name]()


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


def same_bits(a, b):
    """Return whether arrays of floats have equal bits; all NaN count as equal."""
    a, b = np.asarray(a), np.asarray(b)
    assert a.dtype == b.dtype and a.dtype in (np.float32, np.float64) and a.shape == b.shape
    return np.array_equal(a, b, equal_nan=True) and np.array_equal(np.signbit(a)[a == 0], np.signbit(b)[b == 0])


class SlowReader:
    """A reader that follows ``plr_jax/plr/portable/FORMAT.md``, one point at a time, in scalars of NumPy.

    A point is compared with each cell. The reader takes from the package the planes of unreachable leaves, the domain
    of a folding, and the polynomials of continuous and smooth leaves. Those polynomials were computed independently,
    in exact fractions, for the answers in ``tests/plr/vectors``.
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
        return self._leaf_value(z - self.lo)

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
        leaf, name, cells, f32 = self._leaf(above), self.contents.leaf.name, self.contents.tree.leaves, np.float32
        n = self.numbers[leaf]
        if name == "plane":
            return reduce(add, n[1:] * above, n[0])
        if name == "cone":
            d = above - n[1:]
            return n[0] + np.sqrt(reduce(add, d * d))
        u = above * self.scale
        u = np.where(self.start < 1, u + (self.start - f32(1)), u)
        t = u * (1 << cells.depth[leaf]).astype(f32) - cells.position[leaf].astype(f32)
        return _horner(n[len(t) :].reshape([2 if name == "continuous" else 4] * len(t)), t)


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
    return (
        np.where(down > lo, np.nextafter(down, np.float32(-np.inf)), down),
        np.where(up < hi, np.nextafter(up, np.float32(np.inf)), up),
    )
