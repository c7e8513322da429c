"""Helpers for tests of readers without JAX: PLRs of all kinds, hard points, and a slow independent reader."""

from fractions import Fraction
from functools import cache, reduce
from itertools import product
from math import prod
from operator import add

import networkx as nx
import numpy as np
import pytest
from plr_helpers import chain, random_contents

from plr_jax import (
    PLR,
    Box,
    Euclidean,
    NearestGoal,
    ReedsShepp,
    VisibilityGraph,
    Workspace,
    construct,
    from_bytes,
    scenes,
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


@cache
def _maze_oracle():
    problem = scenes.maze()
    return VisibilityGraph(problem.workspace, problem.goals[0])


def _maze(leaf, max_bytes, *other_goals):
    oracle = _maze_oracle()
    if other_goals:
        oracle = NearestGoal([oracle, *map(oracle.with_goal, other_goals)])
    return construct(oracle, ((0, 0), (1, 1)), leaf=leaf, max_bytes=max_bytes, certified=True)


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
    "far planes": lambda: construct(Euclidean((5e5 + 90, 4e6 + 70)), GRID_ZONE, leaf="plane", max_leaves=50),
    "far cones": lambda: construct(
        VisibilityGraph(Workspace(GRID_ZONE), (5e5 + 90, 4e6 + 70)), GRID_ZONE, leaf="cone"
    ),
    "far around": lambda: construct(_waves, Box((1000, 3), (1003, 3.5), periodic=(False, True)), max_leaves=40),
    "far folded car": lambda: construct(ReedsShepp((1e3, -1e3, 2), 1), FAR_TURNS, leaf="continuous", max_leaves=100),
}


@cache
def case(name: str) -> PLR:
    """Return a PLR by name, built once."""
    return CASES[name]()


def cases(*quick):
    """Return the names of all PLRs as parameters of a test; all but these are left to the full tests."""
    return [pytest.param(name, marks=() if name in quick else pytest.mark.full) for name in CASES]


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

    A point is compared with each cell. The reader takes from the package only what the document leaves open: the
    planes of unreachable leaves, the domain of a folding, and the rounding of weights of polynomials that are not
    exact.
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
        contents = self.contents
        is_own = np.isfinite(contents.leaf.coefficients(contents.tree.leaves, contents.stored)[:, 0])
        numbers = contents.leaf.leaf_parameters(self.box, contents.tree.leaves, self.plr._coefficients, down)
        numbers[is_own] = self._own_numbers(down, numbers)[is_own]
        return numbers.astype(np.float32)

    def _own_numbers(self, down, numbers):
        contents, leaf = self.contents, self.contents.leaf
        if leaf.is_cell_relative:
            of_cells = np.zeros((len(contents.tree.leaves), self.plr.dim))  # the reader takes them from the cells
            own, is_exact = polynomial_numbers(contents)
            own = np.column_stack([of_cells, own])
            is_rounding = np.abs(own - numbers) <= 2.0**-48 * np.abs(numbers[np.isfinite(numbers)]).max()
            return own if is_exact else np.where(is_rounding, numbers, own)
        coefficients = leaf.coefficients(contents.tree.leaves, contents.stored)
        if leaf.name == "cone":
            return np.column_stack([coefficients[:, 0], coefficients[:, 1:] - down])
        size, position, width = (
            np.ldexp(1.0, -contents.tree.leaves.depth),
            contents.tree.leaves.position,
            self.box.hi - self.box.lo,
        )
        low, high = self.box.lo + width * (position * size), self.box.lo + width * ((position + 1) * size)
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


# The polynomials of continuous and smooth leaves from free values, as ``plr_jax/plr/portable/FORMAT.md`` defines
# them, in exact fractions.
#
# A *combination* of values is a dictionary from groups to weights. Only the cells, the tied faces, the unreachable
# leaves and the free values come from the package, as the file stores them.

_ALONG = {  # by order: for each end of [0, 1] and kind (value, derivative), the polynomial in t
    0: {(0, 0): (1, -1), (1, 0): (0, 1)},
    1: {(0, 0): (1, 0, -3, 2), (0, 1): (0, 1, -2, 1), (1, 0): (0, 0, 3, -2), (1, 1): (0, 0, -1, 1)},
}


def polynomial_numbers(contents):
    """Return each leaf's polynomial coefficients, by powers of local coordinates; 0 for unreachable leaves.

    Also return whether all weights, and so these numbers, are exact in 64 bits, as the format says for some files.
    """
    leaves = _Leaves(contents)
    return leaves.numbers(), leaves.order == 0 and not leaves.solved


class _Leaves:
    def __init__(self, contents):
        self.cells, self.order = contents.tree.leaves, contents.leaf.order
        self.partition, self.values = contents.stored.partition, contents.stored.decode()
        self.dim, self.num_leaves = self.cells.dim, len(self.cells)
        self.corners = list(product((0, 1), repeat=self.dim))
        self.kinds = self.corners if self.order else [(0,) * self.dim]
        self.reachable = np.flatnonzero(~self.partition.unreachable).tolist()
        self.depth, self.position = self.cells.depth.tolist(), self.cells.position.tolist()
        self.points = self._points_of_faces()
        self.group = self._groups()
        self.members = {}
        for node, group in self.group.items():
            self.members.setdefault(group, []).append(node)
        self.on = self._hanging()
        self.level = {group: self._level(*nodes[0]) for group, nodes in self.members.items()}
        self.solved = self._solved()
        free = {self.group[leaf, corner] for leaf in self.reachable for corner in self.corners}
        free -= self.on.keys() | self.solved.keys()
        self.free = sorted(free, key=lambda group: (self.level[group], group))
        assert len(self.free) == len(self.values)

    def _points_of_faces(self):
        """Return the points where functions agree, each as two pairs of a leaf and a place in it, from 0 to 1."""
        faces, tied = self.partition.faces, self.partition.tied
        points = []
        for axis, *leaves in sorted(np.stack([faces.axis, faces.lower, faces.upper], axis=1)[tied].tolist()):
            lows, highs = ([self._ends(leaf)[side] for leaf in leaves] for side in (0, 1))
            ends = list(zip(map(max, *lows), map(min, *highs), strict=True))
            ends[axis] = (None,)
            for point in product(*ends):
                points.append([(leaf, self._place(leaf, point, 1 - side)) for side, leaf in enumerate(leaves)])
        return points

    def _ends(self, leaf):
        cell = list(zip(self.position[leaf], self.depth[leaf], strict=True))
        return [[Fraction(position + end, 2**depth) for position, depth in cell] for end in (0, 1)]

    def _place(self, leaf, point, across):
        cell = zip(point, self.depth[leaf], self.position[leaf], strict=True)
        return tuple(Fraction(across) if x is None else x * 2**depth - position for x, depth, position in cell)

    def _groups(self):
        """Return the number of each node's group."""
        graph = nx.Graph()
        graph.add_nodes_from(product(range(self.num_leaves), self.corners))
        graph.add_edges_from(nodes for nodes in self.points if all(node in graph for node in nodes))
        groups = enumerate(sorted(nx.connected_components(graph), key=min))
        return dict(sorted((node, number) for number, group in groups for node in group))

    def _hanging(self):
        """Return, for each hanging group, the leaf on which it hangs, and the place there."""
        on = {}
        for side in (0, 1):
            for nodes in self.points:
                here, there = nodes[side], nodes[1 - side]
                if here in self.group and there not in self.group:
                    on.setdefault(self.group[here], there)
        return on

    def _level(self, leaf, corner):
        cell = zip(self.position[leaf], corner, self.depth[leaf], strict=True)
        return sum(Fraction(position + end, 2**depth).denominator.bit_length() - 1 for position, end, depth in cell)

    def _interpolated(self, leaf, t):
        """Return the value at a place in a leaf, as a combination of groups that do not hang."""
        terms = []
        for corner in self.corners:
            weight = prod(along if end else 1 - along for along, end in zip(t, corner, strict=True))
            if weight:  # another corner may itself depend on this place
                terms.append((weight, self._value(leaf, corner)))
        return _sum(terms)

    def _value(self, leaf, corner):
        return self._value_of(self.group[leaf, corner])

    @cache  # noqa: B019
    def _value_of(self, group):
        return self._interpolated(*self.on[group]) if group in self.on else {group: Fraction(1)}

    def _solved(self):
        """Return the groups that equations eliminate, as combinations of the other groups."""
        solved = {}
        for lower, upper in self.points:
            if lower in self.group and upper in self.group:
                continue
            row = _sum([(1, self._interpolated(*lower)), (-1, self._interpolated(*upper))])
            row = _replaced(row, solved)
            if row:
                pivot = max(row, key=lambda group: (self.level[group], abs(row[group]), -group))
                scale = -row.pop(pivot)
                solution = {group: weight / scale for group, weight in row.items()}
                solved = {group: _replaced(other, {pivot: solution}) for group, other in solved.items()}
                solved[pivot] = solution
        return solved

    @cache  # noqa: B019
    def _numbers_of(self, group):
        """Return a group's value and derivatives (by fractions of the domain) as combinations of free values."""
        if self.order == 0:
            return [_replaced(self._value_of(group), self.solved)]
        return self._of_cubic(*self.on[group]) if group in self.on else self._of_mean(group)

    def _of_mean(self, group):
        numbers = []
        for kind in self.kinds:
            terms, total = [], 0
            for leaf, corner in self.members[group]:
                size = self._size(leaf, kind)
                total += size
                for other in self.corners:
                    if all(is_in or a == b for a, b, is_in in zip(corner, other, kind, strict=True)):
                        sign = prod(1 if end else -1 for end, is_in in zip(other, kind, strict=True) if is_in)
                        terms.append((sign * size * size, _replaced(self._value(leaf, other), self.solved)))
            numbers.append(_sum((Fraction(weight, total), value) for weight, value in terms))
        return numbers

    def _of_cubic(self, leaf, t):
        numbers = []
        for derivative in self.kinds:
            terms = []
            for corner in self.corners:
                for i, kind in enumerate(self.kinds):
                    along = zip(self._along(corner, kind), t, derivative, strict=True)
                    weight = prod(_at(*each) for each in along) * self._size(leaf, derivative)
                    if weight:
                        number = self._numbers_of(self.group[leaf, corner])[i]
                        terms.append((weight / self._size(leaf, kind), number))
            numbers.append(_sum(terms))
        return numbers

    def _along(self, corner, kind):
        return [_ALONG[self.order][both] for both in zip(corner, kind, strict=True)]

    def _size(self, leaf, kind):
        return prod(2**depth for depth, is_in in zip(self.depth[leaf], kind, strict=True) if is_in)

    def numbers(self):
        """Return each leaf's coefficients, summed in 64 bits from left to right."""
        coefficients = np.zeros((self.num_leaves, (2, 4)[self.order] ** self.dim))
        for leaf in self.reachable:
            for corner in self.corners:
                for kind, of in zip(self.kinds, self._numbers_of(self.group[leaf, corner]), strict=True):
                    number = 0.0
                    for group, value in zip(self.free, self.values.tolist(), strict=True):
                        if group in of:
                            number += float(of[group] / self._size(leaf, kind)) * value
                    for i, powers in enumerate(product(*self._along(corner, kind))):
                        coefficients[leaf, i] += number * prod(powers)
        return coefficients


def _sum(terms):
    """Return the sum of weighted combinations."""
    total = {}
    for factor, combination in terms:
        for group, weight in combination.items():
            total[group] = total.get(group, 0) + factor * weight
    return {group: weight for group, weight in total.items() if weight}


def _replaced(combination, solved):
    """Return a combination in which solved groups are replaced by their combinations."""
    return _sum((weight, solved.get(group, {group: Fraction(1)})) for group, weight in combination.items())


def _at(powers, t, is_derivative):
    """Return the value of a polynomial, or of its derivative, at ``t``."""
    if is_derivative:
        return sum(i * power * t ** (i - 1) for i, power in enumerate(powers) if i)
    return sum(power * t**i for i, power in enumerate(powers))
