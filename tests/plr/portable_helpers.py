"""PLRs of all kinds that readers without JAX are held against, points that are hard for them, and a slow reader."""

from functools import cache
from itertools import product

import numpy as np
from plr_helpers import chain, random_contents
from slow_polynomials import polynomial_numbers

from plr_jax import PLR, Box, Dubins, Euclidean, ReedsShepp, VisibilityGraph, construct, from_bytes, scenes
from plr_jax.plr._file import encode

TURNS = Box((-4, -4, -np.pi), (4, 4, np.pi), periodic=(False, False, True))
ASIDE = Box((-2, -4, -np.pi), (6, 3, np.pi), periodic=(False, False, True))
FAR_TURNS = Box((998, -1e3 - 4, -np.pi), (1004, -1e3 + 2, np.pi), periodic=(False, False, True))
GRID_ZONE = Box((5e5, 4e6), (5e5 + 2000.3, 4e6 + 1500.7))


def _waves(x):
    return 3 + np.sin(3 * x[:, 0]) + np.cos(2 * x[:, -1])


def _random(dim, leaf, seed=0, **options):
    return from_bytes(encode(random_contents(seed, dim, leaf, **options)))


def _maze(leaf, max_bytes):
    problem = scenes.maze()
    oracle = VisibilityGraph(problem.workspace, problem.goals[0])
    return construct(oracle, problem.workspace.bounds, leaf=leaf, max_bytes=max_bytes, certified=True)


CASES = {
    "maze of planes": lambda: _maze("plane", 512),
    "maze of values": lambda: _maze("continuous", 400),
    "maze of gradients": lambda: _maze("smooth", 300),
    "maze of cones": lambda: _maze("cone", 300),
    "cones in space": lambda: construct(Euclidean((0.3, 0.1, 2)), ((-1, -1, -1), (3, 2, 2)), leaf="cone"),
    "one leaf": lambda: construct(Euclidean((1, 2)), ((-3, -1), (2, 4)), leaf="plane", max_leaves=1),
    "one cell": lambda: construct(Euclidean((1, 2)), ((-3, -1), (2, 4)), leaf="continuous", max_leaves=1),
    "random planes on a line": lambda: _random(1, "plane", 1),
    "random planes": lambda: _random(5, "plane", 2),
    "random values": lambda: _random(3, "continuous", 3),
    "values in six dimensions": lambda: construct(
        _waves, (-np.ones(6), np.ones(6)), leaf="continuous", max_leaves=20
    ),
    "deep": lambda: _random(2, "plane", 4, cells=chain([0, 1] * 12)),
    "a third of the way": lambda: construct(_waves, ((1000.1, 0.1), (1001.1, 0.7)), max_leaves=40),
    "around": lambda: construct(_waves, Box((-0.3, 1), (3, 1.7), periodic=(False, True)), max_leaves=40),
    "smooth around": lambda: _random(2, "smooth", 6, periodic=(False, True)),
    "around twice": lambda: _random(2, "continuous", 5, periodic=(True, True)),
    "car": lambda: construct(ReedsShepp((0, 0, 0), 1), TURNS, leaf="continuous", max_leaves=100),
    "car of planes": lambda: construct(ReedsShepp((1, 0.5, 0.6), 1), ASIDE, leaf="plane", max_leaves=100),
    "car that only goes forward": lambda: construct(Dubins((0, 0, 1), 1), TURNS, leaf="continuous", max_leaves=100),
    "straight": lambda: construct(Euclidean((1, 2)), ((-3, -1), (2, 4)), leaf="plane", max_leaves=20),
    "far planes": lambda: construct(Euclidean((5e5 + 90, 4e6 + 70)), GRID_ZONE, leaf="plane", max_leaves=50),
    "far cones": lambda: construct(Euclidean((5e5 + 90, 4e6 + 70)), GRID_ZONE, leaf="cone"),
    "far around": lambda: construct(_waves, Box((1000, 3), (1003, 3.5), periodic=(False, True)), max_leaves=40),
    "far car": lambda: construct(ReedsShepp((1e3, -1e3, 2), 1), FAR_TURNS, leaf="continuous", max_leaves=100),
}


@cache
def case(name: str) -> PLR:
    """A PLR, built once."""
    return CASES[name]()


def is_far(plr):
    """Whether points of a PLR are 64-bit numbers for a program."""
    lo, hi = plr.domain.lo, plr.domain.hi
    return bool((np.maximum(np.abs(lo), np.abs(hi)) > 4 * (hi - lo)).any())


def hard_points(plr, n=2000, seed=0):
    """Points at random, on faces of cells, at corners and beside them, outside, around, infinite and NaN."""
    rng, domain = np.random.default_rng(seed), plr.domain
    inside = rng.uniform(domain.lo, domain.hi, (n, plr.dim))
    faces = domain.lo + domain.width * rng.integers(0, 65, (n, plr.dim)) / 64
    mixed = np.where(rng.random((n, plr.dim)) < 0.5, inside, faces)
    corners = np.array(list(product(*zip(domain.lo, domain.hi, strict=True))))
    of_type = np.float64 if is_far(plr) else np.float32
    beside = [np.nextafter(corners.astype(of_type), of_type(to)) for to in (-np.inf, np.inf)]
    around = inside + domain.width * rng.integers(-3, 4, (n, plr.dim))
    bad = inside[np.arange(60) % n]
    bad[np.arange(60), rng.integers(plr.dim, size=60)] = np.resize([np.nan, np.inf, -np.inf, 3e38, -3e38], 60)
    every = np.concatenate([inside, faces, mixed, corners, *beside, around, bad, 0 * corners, -0.0 * corners])
    return every.astype(of_type)


def same_bits(a, b):
    """Whether arrays of floats are equal to the bit, any NaN like any other."""
    a, b = np.asarray(a), np.asarray(b)
    assert a.dtype == b.dtype and a.dtype in (np.float32, np.float64) and a.shape == b.shape
    return np.array_equal(a, b, equal_nan=True) and np.array_equal(np.signbit(a)[a == 0], np.signbit(b)[b == 0])


class SlowReader:
    """Reads as the docstring of ``plr_jax/plr/portable`` says, one point at a time, in scalars of NumPy.

    Cells are compared one by one. Of leaves that nothing reaches and of the domain of a folding it asks the package,
    and of polynomials how their weights are rounded, which the words leave open where they are not exact.
    """

    def __init__(self, plr):
        contents = plr._contents
        self.plr, self.contents, self.folding = plr, contents, contents.folding
        self.outer, self.box = plr.domain, contents.domain
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
        contents = self.contents
        is_own = ~contents.leaf.unreachable(contents.stored)
        numbers = contents.leaf.numbers(self.box, contents.cells, self.plr._coefficients, down)
        numbers[is_own] = self._own_numbers(down, numbers)[is_own]
        return numbers.astype(np.float32)

    def _own_numbers(self, down, numbers):
        contents, leaf = self.contents, self.contents.leaf
        if leaf.is_of_cells:
            of_cells = np.zeros((len(contents.cells), self.plr.dim))  # which it reads from the cells themselves
            own, is_exact = polynomial_numbers(contents)
            own = np.column_stack([of_cells, own])
            is_rounding = np.abs(own - numbers) <= 2.0**-48 * np.abs(numbers[np.isfinite(numbers)]).max()
            return own if is_exact else np.where(is_rounding, numbers, own)
        coefficients = leaf.coefficients(contents.cells, contents.stored)
        if leaf.name == "cone":
            return np.column_stack([coefficients[:, 0], coefficients[:, 1:] - down])
        size = np.ldexp(1.0, -contents.cells.depth)
        position, width = contents.cells.position, self.box.hi - self.box.lo
        low, high = self.box.lo + width * (position * size), self.box.lo + width * ((position + 1) * size)
        rows = []
        for c, *g in zip(coefficients[:, 0], *coefficients.T[1:], strict=True):
            leaf_index, total = len(rows), 0.0
            slopes = [half * 2 / (high[leaf_index, i] - low[leaf_index, i]) for i, half in enumerate(g)]
            for i, slope in enumerate(slopes):
                total += slope * ((low[leaf_index, i] + high[leaf_index, i]) / 2 - down[i])
            rows.append([c - total, *slopes])
        return np.array(rows)

    def __call__(self, x):
        with np.errstate(all="ignore"):
            return np.array([self._value(list(point)) for point in x], np.float32)

    def waypoint(self, x):
        """The sources of leaves of cones."""
        with np.errstate(all="ignore"):
            return np.array([self._waypoint(list(point)) for point in x], np.float64 if self.is_far else np.float32)

    def _waypoint(self, x):
        z = None if any(np.isnan(x)) else self._placed(x)
        if z is None:
            return [np.nan] * len(x)
        source = self.numbers[self._leaf(z)[0], 1:]
        if self.is_far:
            return [origin + np.float64(along) for origin, along in zip(self.origin, source, strict=True)]
        return [np.float32(lo) + along for lo, along in zip(self.lo, source, strict=True)]

    def _value(self, x):
        if any(np.isnan(x)):
            return np.float32(np.nan)
        z = self._placed(x)
        if z is None:
            return np.float32(np.inf)
        leaf, above = self._leaf(z)
        value = self._leaf_value(leaf, above)
        if self.folding is not None and any(self.folding.radial):
            value = value + np.sqrt(
                _sum([along * along for along, is_in in zip(z, self.folding.radial, strict=True) if is_in])
            )
        return value

    def _placed(self, x):
        """None outside the domain."""
        f32, periodic = np.float32, self.outer.periodic
        if any(p and not np.isfinite(along) for p, along in zip(periodic, x, strict=True)):
            return None
        if self.is_far:
            x = [np.float64(along) for along in x]
        if isinstance(x[0], np.float64):
            ends = zip(periodic, x, self.outer.lo, self.outer.hi, strict=True)
            x = [_wrapped(along, lo, hi, 1 / (hi - lo), 0.0) if p else along for p, along, lo, hi in ends]
        if self.is_far:
            x = [along - origin for along, origin in zip(x, self.origin, strict=True)]
        z = [f32(along) for along in x]
        if not all(p or a <= along <= b for p, along, a, b in zip(periodic, z, *self.ends, strict=True)):
            return None
        z = z if self.folding is None else self._folded(z)
        for axis in np.flatnonzero(periodic):
            a, b = self.lo[axis] + self.rest[0][axis], self.hi[axis] - self.rest[1][axis]
            z[axis] = _wrapped(z[axis], a, b, self.scale[axis], f32(2.0**-44) * max(abs(a), abs(b)))
        return z

    def _folded(self, x):
        folding, f32 = self.folding, np.float32
        center = (folding.center - self.origin).astype(f32)
        rest = (folding.center - self.origin - center).astype(f32)
        z = [(along - c) - r for along, c, r in zip(x, center, rest, strict=True)]
        if folding.is_turned:
            z = [_sum([a * along for a, along in zip(row, z, strict=True)]) for row in folding.axes.astype(f32)]
        for mirror, pivot in zip(folding.mirrors, folding.pivots, strict=True):
            if z[pivot] < 0:
                z = [-along if is_reversed else along for along, is_reversed in zip(z, mirror, strict=True)]
        hi, lo = _outward(folding.box.hi, folding.box.lo)  # inward: as if they were lower and upper ones
        limits = zip(z, lo, hi, self.outer.periodic, strict=True)
        return [along if p else min(max(along, a), b) for along, a, b, p in limits]

    def _leaf(self, z):
        above = [along - lo for along, lo in zip(z, self.lo, strict=True)]
        places = []
        for axis, along in enumerate(above):
            placed = max(min(along * self.scale[axis], self.top[axis]) + self.start[axis], np.float32(1))
            places.append(int(placed.view(np.uint32)) & 0x7FFFFF)
        cells = self.contents.cells
        holds = (np.array(places) >> (23 - cells.depth) == cells.position).all(axis=1)
        assert holds.sum() == 1
        return int(holds.argmax()), above

    def _leaf_value(self, leaf, above):
        n, name = list(self.numbers[leaf]), self.contents.leaf.name
        if name == "plane":
            return _sum([n[0], *(slope * along for slope, along in zip(n[1:], above, strict=True))])
        if name == "cone":
            d = [along - source for along, source in zip(above, n[1:], strict=True)]
            return n[0] + np.sqrt(_sum([along * along for along in d]))
        dim, cells, t = len(above), self.contents.cells, []
        for axis, along in enumerate(above):
            u = along * self.scale[axis]
            u = u + (self.start[axis] - np.float32(1)) if self.start[axis] < 1 else u
            count, position = (np.float32(v[leaf, axis]) for v in (1 << cells.depth, cells.position))
            t.append(u * count - position)
        coefficients = np.array(n[dim:]).reshape([2 if name == "continuous" else 4] * dim)
        return _horner(coefficients, t)


def _horner(coefficients, t):
    if not t:
        return coefficients[()]
    total = None
    for part in coefficients[::-1]:
        term = _horner(part, t[1:])
        total = term if total is None else total * t[0] + term
    return total


def _sum(terms):
    total = terms[0]
    for term in terms[1:]:
        total = total + term
    return total


def _wrapped(x, a, b, scale, tolerance):
    moved = min(max(x - np.floor((x - a) * scale) * (b - a), a), b)
    return a if abs(x - b) <= tolerance else moved


def _outward(lo, hi):
    down, up = lo.astype(np.float32), hi.astype(np.float32)
    return (
        np.where(down > lo, np.nextafter(down, np.float32(-np.inf)), down),
        np.where(up < hi, np.nextafter(up, np.float32(np.inf)), up),
    )
