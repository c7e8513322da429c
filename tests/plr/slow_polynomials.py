"""Numbers of leaves that are polynomials, from free values: by the words of ``plr_jax/plr/portable``, in fractions.

A *combination* of values is a dictionary from the groups that have them to their weights. Of the package there are
only the cells, the faces that are tied, which leaves are unreachable, and the free values, as a file holds them.
"""

from fractions import Fraction
from functools import cache
from itertools import product
from math import prod

import networkx as nx
import numpy as np

_ALONG = {  # by order: powers of t, of each end of [0, 1] and of each kind of number there
    0: {(0, 0): (1, -1), (1, 0): (0, 1)},
    1: {(0, 0): (1, 0, -3, 2), (0, 1): (0, 1, -2, 1), (1, 0): (0, 0, 3, -2), (1, 1): (0, 0, -1, 1)},
}


def polynomial_numbers(contents):
    """Coefficients by powers of the place in its cell, of every leaf; of unreachable ones 0.

    And whether the weights are exact in 64 bits, as the words say of some files: then so are these numbers.
    """
    leaves = _Leaves(contents)
    return leaves.numbers(), leaves.order == 0 and not leaves.solved


class _Leaves:
    def __init__(self, contents):
        self.cells, self.order = contents.cells, contents.leaf.order
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
        """Where functions agree: pairs of a leaf and a place in it, a fraction of it along each axis."""
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
        """The number of each node's group."""
        graph = nx.Graph()
        graph.add_nodes_from(product(range(self.num_leaves), self.corners))
        graph.add_edges_from(nodes for nodes in self.points if all(node in graph for node in nodes))
        groups = enumerate(sorted(nx.connected_components(graph), key=min))
        return dict(sorted((node, number) for number, group in groups for node in group))

    def _hanging(self):
        """Groups that hang: the leaf that each does on, and where."""
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
        """The value at a place of a leaf, from those of groups that do not hang."""
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
        """Groups that equations give up, as combinations of groups that none does."""
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
        """Value and derivatives, by fractions of the domain, as combinations of free values."""
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
        """Sums in 64 bits, from left to right."""
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
    """The sum of multiples of combinations."""
    total = {}
    for factor, combination in terms:
        for group, weight in combination.items():
            total[group] = total.get(group, 0) + factor * weight
    return {group: weight for group, weight in total.items() if weight}


def _replaced(combination, solved):
    """A combination, some of whose groups are combinations of others."""
    return _sum((weight, solved.get(group, {group: Fraction(1)})) for group, weight in combination.items())


def _at(powers, t, is_derivative):
    """A polynomial, or its derivative, at a place."""
    if is_derivative:
        return sum(i * power * t ** (i - 1) for i, power in enumerate(powers) if i)
    return sum(power * t**i for i, power in enumerate(powers))
