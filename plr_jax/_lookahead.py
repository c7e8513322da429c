"""Paths by lookahead: finite steps down a cost-to-go, in any space that can prove that a straight motion is free.

At each node of a path, the free steps in many directions and of several lengths are ranked by slope: the decrease of
the cost-to-go per cost of the step. Slopes are at most 1, apart from errors of the cost-to-go. Among nearly equal
slopes, the longest step is chosen, so that small local errors of the cost-to-go do no harm. A best-first search
(Barraquand and Latombe, 1991) escapes from local minima. Finished paths are made cheaper: nodes are skipped, or
shifted to where the two adjacent segments cost least.
"""

import heapq
from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.special import ndtri

from plr_jax._arrays import as_distances, as_finite_point, as_points, padded, padded_size, path_from_root
from plr_jax._types import ArrayLike, Numbers
from plr_jax.geometry.graph import first_visible_in_parts
from plr_jax.plr.sampling import lattice
from plr_jax.spaces import ConfigurationSpace, CostMap, MotionCost
from plr_jax.spaces._costs import cost_bounds, motion_costs, pulled

Field: TypeAlias = Callable[[ArrayLike], ArrayLike]
Nodes: TypeAlias = Float[np.ndarray, "_ dim"]  # configurations on paths; arrays may have different lengths
Next: TypeAlias = Int[np.ndarray, " _"]  # the next node of each node
Vertices: TypeAlias = Float[np.ndarray, "n longest dim"]
Counts: TypeAlias = Int[np.ndarray, " n"]
# Paths of `n` starts: vertices, numbers of vertices, lengths, costs, and whether each start is free (see `Descent`).
Chains: TypeAlias = tuple[Vertices, Counts, Numbers, Numbers, Bool[np.ndarray, " n"]]


def chains_of(starts: Nodes, nodes: Nodes, onward: Next, first: Next, num_goals: int = 1) -> tuple[Vertices, Counts]:
    """Return the vertices of one path per start, and the number of vertices of each path.

    Path ``i`` leads from ``starts[i]`` to the node ``first[i]``, then from each node to the node ``onward[node]``,
    until a goal. The goals are the first ``num_goals`` nodes. If this sequence of nodes reaches the index -1, there
    is no path, and the number of vertices is 0.
    """
    # Follow all paths at once. Paths that have arrived (or have no next node, -1) repeat their last node. A path's
    # vertices are the start, the nodes and the goal; if the start is the goal, it counts once.
    chain = [first]
    while (chain[-1] >= num_goals).any():
        chain.append(np.where(chain[-1] >= num_goals, onward[chain[-1]], chain[-1]))
    places = np.stack(chain, axis=1)
    vertices = np.concatenate([starts[:, None], nodes[places]], axis=1)
    counts = 2 + (places >= num_goals).sum(axis=1) - (starts == vertices[:, -1]).all(axis=1)
    return vertices, np.where(places[:, -1] >= 0, counts, 0)


_CIRCLE = 64  # directions in a plane
_PER_AXIS = 32  # directions per axis in more dimensions
# Costs of motions:
_STEP_TOLERANCE = 0.01  # relative error allowed for the costs of steps
_LAST_TOLERANCE = 0.001  # relative error allowed for the costs of final paths
_SAMPLES = 8  # samples of a motion whose cost is estimated
_LEAST_PART = 1 / 16  # parts of a motion shorter than this share may have the absolute error of such a share
_MOST_HALVINGS = 40  # largest number of times that an interval of a motion is halved
# Steps:
_LONGEST = 1 / 4  # longest step, as a share of the domain
_NUM_LENGTHS = 8  # number of lengths of steps, each half as long as the one before
_FALL = 0.1  # least fall of the field along a step, as a share of the step's cost
_LONGER = 0.01  # loss of slope that is accepted for a step twice as long
_DEARER = 0.02  # a step may cost more than its estimate by this share
# The search that leaves a local minimum:
_MOST_EXPANSIONS = 1000
_CELL = 1 / 32  # side of a cell, as a share of the domain
_CELL_STEPS = (1, 2, 4)  # lengths of steps, in sides of a cell
# Cheaper paths:
_KNOWN = 1e-3  # estimates with a smaller relative error are trusted to find the best place
_GAIN = 1e-6  # least saving of a change, as a share of the cost of the segments
_WIDEST_SHIFT = 1 / 32  # first shift of a node, as a share of the domain
_NUM_SHIFTS = 8  # number of shifts, each half as wide as the one before


def unit_motions(motion_cost: MotionCost) -> Float[np.ndarray, "n dof"]:
    """Return vectors of motions of cost 1 in many directions: over all axes together, and within each block of axes.

    A block is a group of axes of the :class:`MotionCost`, such as the position alone or the heading alone.
    """
    # Directions in a plane are evenly spaced. In more dimensions, they are the axes, and normally distributed points
    # divided by their norms, each with its opposite.
    changes = []
    for axes in sorted({tuple(range(motion_cost.dof)), *(axes for axes, _ in motion_cost.blocks)}):
        dim = len(axes)
        if dim == 2:
            angle = 2 * np.pi * np.arange(_CIRCLE) / _CIRCLE
            directions = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        else:
            directions = np.eye(dim)
            if dim > 2:
                num = padded_size(_PER_AXIS * dim // 2)
                directions = np.concatenate([directions, ndtri(lattice(num, np.full(dim, 0.5 / num)))])
                directions = directions[np.linalg.norm(directions, axis=1) > 1e-9]
            directions = np.concatenate([directions, -directions])
            directions = directions / np.linalg.norm(directions, axis=1, keepdims=True)
        change = np.zeros((len(directions), motion_cost.dof))
        change[:, axes] = directions / motion_cost.scale[list(axes)]
        changes.append(change / motion_cost.norm(change)[:, None])
    return np.concatenate(changes)


class PathCosts(NamedTuple):
    """The costs of straight motions in a configuration space, with or without a cost map."""

    space: ConfigurationSpace
    cost_map: CostMap | None  # factor of the motion cost; None means 1

    def estimates(self, q0: Nodes, changes: Float[np.ndarray, "n k dof"]) -> Float[np.ndarray, "n k"]:
        """Estimate, from a few samples, the costs of straight motions from ``q0[i]`` to ``q0[i] + changes[i, j]``."""
        n, k, dof = changes.shape
        motion_cost, domain = self.space.motion_cost, self.space.domain
        if self.cost_map is None:
            return motion_cost.norm(changes.reshape(-1, dof)).reshape(n, k)
        t = (np.arange(_SAMPLES) + 0.5) / _SAMPLES
        q = q0[:, None, None] + t[:, None] * changes[:, :, None]
        # Motions that leave the domain are not free, but need a finite cost.
        q = domain.wrapped(np.where(domain.periodic, q, np.clip(q, domain.lo, domain.hi))).reshape(-1, dof)
        costs = motion_costs(motion_cost, self.cost_map, q, np.repeat(changes.reshape(-1, dof), _SAMPLES, axis=0))
        return costs.reshape(n, k, _SAMPLES).mean(axis=2)

    def integrals(self, q0: Nodes, q1: Nodes, tolerance: float) -> Float[np.ndarray, " n"]:
        """Integrate the cost along straight motions from ``q0`` to ``q1``.

        The relative error is at most about ``tolerance``. Motions go the shorter way around periodic axes.
        """
        if self.cost_map is None:
            return self.space.motion_cost.lengths(q0, q1, self.space.domain)
        domain, motion_cost = self.space.domain, self.space.motion_cost
        cost = np.zeros(len(q0))
        change = domain.difference(q1, q0)
        # 1. Cut motions into intervals where they cross the seams of periodic axes, at the times t. An interval
        #    belongs to one motion, and begins and ends at fractions of it.
        seam = np.where(change < 0, domain.lo, domain.hi)
        with np.errstate(divide="ignore", invalid="ignore"):
            t = np.where(domain.periodic, (seam - domain.wrapped(q0)) / change, 0.0)
        cuts = np.sort(np.where((t > 0) & (t < 1), t, 0.0), axis=1)
        ends = np.concatenate([np.zeros((len(q0), 1)), cuts, np.ones((len(q0), 1))], axis=1)
        motion, place = np.nonzero((np.diff(ends, axis=1) > 0) & np.any(change != 0, axis=1)[:, None])
        begin, end = ends[motion, place], ends[motion, place + 1]
        # 2. Use the midpoint rule, and halve the intervals whose cost is not accurate enough.
        for halvings in range(_MOST_HALVINGS + 1):
            middle = (begin + end) / 2
            q = domain.wrapped(q0[motion] + middle[:, None] * change[motion])
            part = (end - begin)[:, None] * change[motion]
            # Bound the cost in the box around each interval, which lies in the domain up to rounding.
            lo, hi = np.maximum(q - np.abs(part) / 2, domain.lo), np.minimum(q + np.abs(part) / 2, domain.hi)
            lower, upper, pulls = cost_bounds(motion_cost, self.cost_map, lo, hi)
            norm = motion_cost.norm(part)
            lower, upper = (bound * norm + pulled(pulls, part) for bound in (lower, upper))
            leniency = np.maximum(end - begin, _LEAST_PART) / (end - begin)
            is_fine = (upper - lower <= tolerance * lower * leniency) | (halvings == _MOST_HALVINGS)
            np.add.at(cost, motion[is_fine], motion_costs(motion_cost, self.cost_map, q[is_fine], part[is_fine]))
            motion, begin, middle, end = motion[~is_fine], begin[~is_fine], middle[~is_fine], end[~is_fine]
            motion, begin, end = np.tile(motion, 2), np.append(begin, middle), np.append(middle, end)
            if not len(motion):
                break
        return cost


def by_lookahead(field: Field, costs: PathCosts, starts: ArrayLike, goal: ArrayLike) -> Chains:
    """Find a path from each start to a goal by steps down a cost-to-go ``field``, and make it cheaper.

    Return the vertices of the paths, their numbers of vertices (0: no path), lengths and costs, and whether each
    start is free.
    """
    # 1. Check the starts and the goal.
    domain = costs.space.domain
    starts, goal = (domain.settled(q, costs.space.is_free) for q in (starts, goal))
    starts, goal = as_points("starts", starts, domain.dim), as_finite_point("The goal", goal, domain.dim)
    if not costs.space.is_free(goal[None])[0]:
        raise ValueError(f"The goal must be a free configuration of the space, got {goal.tolist()}.")
    is_free = costs.space.is_free(starts)
    # 2. Step down the field. Skip nodes, shift the others, and skip again.
    nodes, onward, nodes_of_starts = _Lookahead(field, costs, goal).follow(starts[is_free])
    onward = _skip_nodes(costs, nodes, onward)
    nodes = _shift_nodes(costs, nodes, onward, nodes_of_starts)
    onward = _skip_nodes(costs, nodes, onward)
    # 3. Measure the paths.
    first = np.full(len(starts), -1)
    first[is_free] = onward[nodes_of_starts]
    vertices, counts = chains_of(starts, nodes, onward, first)
    begin, end = vertices[:, :-1].reshape(-1, domain.dim), vertices[:, 1:].reshape(-1, domain.dim)
    lengths = costs.space.motion_cost.lengths(begin, end, domain).reshape(len(starts), vertices.shape[1] - 1)
    prices = np.zeros(lengths.shape)
    moves = (counts > 0)[:, None] & (lengths > 0)
    prices[moves] = costs.integrals(begin[moves.ravel()], end[moves.ravel()], _LAST_TOLERANCE)
    # Cumulative sums do not depend on how many copies of the goal follow.
    return vertices, counts, np.cumsum(lengths, axis=1)[:, -1], np.cumsum(prices, axis=1)[:, -1], is_free


class _Lookahead:
    """Steps down a cost-to-go (the *field*) from many starts at once, and a search that escapes its local minima."""

    def __init__(self, field: Field, costs: PathCosts, goal: Float[np.ndarray, " dim"]):
        self.field, self.costs, self.goal, self.space = field, costs, goal, costs.space
        self.domain, motion_cost = costs.space.domain, costs.space.motion_cost
        directions = unit_motions(motion_cost)
        lengths = _LONGEST * float((motion_cost.scale * self.domain.width).max()) / 2.0 ** np.arange(_NUM_LENGTHS)
        self.shortest = float(lengths[-1])
        # The first candidate is the motion to the goal, the others are steps.
        self.leniency = np.append(0.0, np.repeat(_LONGER * np.arange(_NUM_LENGTHS), len(directions)))
        self.steps = (lengths[:, None, None] * directions).reshape(-1, motion_cost.dof)
        self.side = _CELL * float((motion_cost.scale * self.domain.width).max())
        self.num_cells = np.maximum(1, np.rint(motion_cost.scale * self.domain.width / self.side))
        self.cell_steps = np.concatenate([self.side * count * directions for count in _CELL_STEPS])
        self.escapes: dict[bytes, Nodes | None] = {}

    def values(self, x: Nodes) -> Float[np.ndarray, " n"]:
        x, inside = self.domain.wrapped(x), self.domain.contains(x)
        values = np.full(len(x), np.inf)
        if num := int(np.count_nonzero(inside)):
            batch = padded(x[inside], padded_size(num), x[inside][-1])
            values[inside] = as_distances("The field", self.field(batch), batch)[:num]
        return np.maximum(values, 0.0)

    def follow(self, starts: Nodes) -> tuple[Float[np.ndarray, "nodes dim"], Next, Int[np.ndarray, " n"]]:
        # Return the nodes of all paths, goal first; the index of each node's next node (-1: stuck, and the goal's
        # is 0); and the index of each start's node.
        #
        # Indices of nodes: 0 is the goal. In each round, the nodes x begin at `num`, then inner nodes of detours at
        # `inner`; the nodes x of the next round follow.
        nodes, onward = [self.goal[None]], [np.zeros(1, int)]
        x, value = starts, self.values(starts)
        num = 1
        while len(x):
            # 1. Take the best step from each node, or search for a detour out of a local minimum.
            y, status = self._step(x, value)
            detours = {}  # for stuck paths, the nodes that lead out of the local minimum
            for row in np.flatnonzero(status < 0).tolist():
                if (chain := self._escape(x[row], value[row] - _FALL * self.shortest)) is not None:
                    y[row], status[row] = chain[-1], 0
                    if len(chain) > 1:
                        detours[row] = chain[:-1]
            # 2. Find the index of the next node of each node, as if there were no detours.
            goes_on = status == 0
            inner = num + len(x)
            num = inner + sum(map(len, detours.values()))
            next_ = np.where(goes_on, num - 1 + np.cumsum(goes_on), np.where(status < 0, -1, 0))
            nodes.append(x)
            onward.append(next_)
            # 3. Lead each detour through its inner nodes to the next node. This also changes `next_` in `onward`.
            for row, detour in detours.items():
                nodes.append(detour)
                onward.append(np.append(inner + np.arange(1, len(detour)), next_[row]))
                next_[row] = inner
                inner += len(detour)
            x, value = y[goes_on], self.values(y[goes_on])
        return np.concatenate(nodes), np.concatenate(onward), np.arange(1, 1 + len(starts))

    def _step(self, x: Nodes, value: Float[np.ndarray, " n"]) -> tuple[Nodes, Int[np.ndarray, " n"]]:
        # Return the end of the best step from each node, and its status: 1 if it ends at the goal, -1 if there is no
        # step, else 0.
        num_ways = 1 + len(self.steps)
        promised = np.empty((len(x), num_ways))

        def flatness(rows: slice) -> Float[np.ndarray, "rows ways"]:
            # Return the rank of each step, best first: minus the slope, plus _LONGER for each halving of the longest
            # step. The slope is (value here - value there) / cost, from 0 to 1. Steps along which the field does not
            # fall enough have NaN.
            here, before = x[rows], value[rows, None]
            to_goal = self.domain.difference(self.goal, here)[:, None]
            change = np.concatenate([to_goal, np.broadcast_to(self.steps, (len(here), *self.steps.shape))], axis=1)
            there = here[:, None] + change
            cost = self.costs.estimates(here, change)
            after = self.values(there.reshape(-1, there.shape[2])).reshape(cost.shape)
            after[:, 0] = 0.0  # at the goal, by definition
            cost[:, 0] = self.costs.integrals(here, np.broadcast_to(self.goal, here.shape), _STEP_TOLERANCE)
            promised[rows] = cost
            with np.errstate(divide="ignore", invalid="ignore"):
                rate = np.where(np.isinf(before) | (cost == 0), 1.0, (before - after) / cost)
            falls = np.isfinite(after) & (rate >= _FALL)
            falls[:, 0] = True
            return np.where(falls, self.leniency - np.clip(rate, 0.0, 1.0), np.nan)

        def leads_to(x: Nodes, way: Int[np.ndarray, " n"]) -> Nodes:
            return np.where(way[:, None] == 0, self.goal, self.domain.wrapped(x + self.steps[np.maximum(way, 1) - 1]))

        def sees(row: Int[np.ndarray, " pairs"], way: Int[np.ndarray, " pairs"]) -> Bool[np.ndarray, " pairs"]:
            here, there = x[row], leads_to(x[row], way)
            free = self.space.are_free(here, there)
            exact = self.costs.integrals(here[free], there[free], _STEP_TOLERANCE)
            free[free] = exact <= (1 + _DEARER) * promised[row, way][free]
            return free

        way = first_visible_in_parts(flatness, len(x), num_ways, sees)[0][:, 0]
        return leads_to(x, way), np.where(way < 0, -1, np.where(way == 0, 1, 0))

    def _escape(self, x: Float[np.ndarray, " dim"], below: float) -> Nodes | None:
        """Return a path from a local minimum ``x`` of the cost-to-go to a point where it is less than ``below``.

        The path is the array of its nodes after ``x``, or None if the search fails. All minima in a cell of a grid
        over the domain share one path from the cell's center, so that the path from one start does not depend on
        other starts. The shared path is used if the straight motion from ``x`` to the center is free, and the
        cost-to-go falls below ``below`` along the path. Else the search begins at ``x``.
        """
        cell = np.minimum(np.floor((x - self.domain.lo) / self.domain.width * self.num_cells), self.num_cells - 1)
        center = self.domain.lo + (cell + 0.5) / self.num_cells * self.domain.width
        if self.space.are_free(x[None], center[None])[0]:
            # The path from the center must fall by a cell's side, at most to half of the value, to leave the minimum.
            if (key := cell.tobytes()) not in self.escapes:
                value = float(self.values(center[None])[0])
                self.escapes[key] = self._search_below(center, value - min(self.side, value / 2))
            if (chain := self.escapes[key]) is None:
                return None
            if self.values(chain[-1:])[0] < below:
                return np.concatenate([center[None], chain])
        return self._search_below(x, below)

    def _search_below(self, x: Float[np.ndarray, " dim"], below: float) -> Nodes | None:
        """Search best first for a path from ``x`` to a point where the cost-to-go is less than ``below``.

        Return the nodes of the path after ``x``, or None if the search fails. The search visits at most one node per
        cell of a grid over the domain.
        """
        nodes, parent, frontier = [x], [-1], [(0.0, 0)]  # pairs of a node's field value and its index
        claimed = set(self._cells(x[None]))
        for _ in range(_MOST_EXPANSIONS):
            if not frontier:
                return None
            _, node = heapq.heappop(frontier)
            # 1. Find configurations around the node in unclaimed cells that it sees, the lowest first.
            y = self.domain.wrapped(nodes[node] + self.cell_steps)
            values = self.values(y)
            order = np.argsort(values, kind="stable")
            order = order[np.isfinite(values[order])]
            order = order[np.array([cell not in claimed for cell in self._cells(y[order])], dtype=bool)]
            order = order[self.space.are_free(np.broadcast_to(nodes[node], y[order].shape), y[order])]
            # 2. Keep the lowest one in each cell, and claim the cell.
            lowest = len(nodes)
            for i, cell in zip(order.tolist(), self._cells(y[order]), strict=True):
                if cell not in claimed:
                    claimed.add(cell)
                    nodes.append(y[i])
                    parent.append(node)
                    heapq.heappush(frontier, (float(values[i]), len(nodes) - 1))
            # 3. If the lowest of all is low enough, return the path to it.
            if len(order) and values[order[0]] < below:
                return np.stack([nodes[node] for node in path_from_root(parent, lowest)[1:]])
        return None

    def _cells(self, x: Nodes) -> list[tuple[int, ...]]:
        cells = np.floor((x - self.domain.lo) / self.domain.width * self.num_cells)
        return list(map(tuple, cells.astype(int).tolist()))


def _skip_nodes(costs: PathCosts, nodes: Nodes, onward: Next) -> Next:
    """Shorten paths: skip a node if the straight motion from the node before it to the node after it is cheaper.

    The motion must also be free. ``onward`` and the result are the index of each node's next node; -1 marks a node
    from which no path continues.
    """
    # In each round, every node tries to skip its next node: to go straight to the node after it. A pair is tried
    # once.
    stuck = onward < 0
    onward = np.where(stuck, np.arange(len(nodes)), onward)
    leg = costs.integrals(nodes, nodes[onward], _STEP_TOLERANCE)  # cost from each node to its next node
    tried = np.full(len(nodes), -1)
    while True:
        ahead = onward[onward]
        rows = np.flatnonzero((ahead != onward) & (ahead != tried))
        if not len(rows):
            return np.where(stuck, -1, onward)
        tried[rows] = ahead[rows]
        rows = rows[costs.space.are_free(nodes[rows], nodes[ahead[rows]])]
        straight = costs.integrals(nodes[rows], nodes[ahead[rows]], _STEP_TOLERANCE)
        legs = leg[rows], leg[onward[rows]]
        better = (straight <= (1 - _GAIN) * sum(legs)) | (np.minimum(*legs) == 0)  # a segment of no cost
        onward[rows[better]], leg[rows[better]] = ahead[rows[better]], straight[better]


def _shift_nodes(costs: PathCosts, nodes: Nodes, onward: Next, first: Int[np.ndarray, " paths"]) -> Nodes:
    """Return the nodes of paths, shifted so that the segments between them cost less.

    ``onward`` is the index of the next node of each node. The goal (node 0) and the nodes with the indices ``first``,
    at the start of each path, stay in place.
    """
    # 1. Follow all paths to the last node before the goal. Each inner node is on one path only.
    nodes, motion_cost = nodes.copy(), costs.space.motion_cost
    before, index = np.full(len(onward), -1), np.zeros(len(onward), int)  # previous node, number of nodes before
    node, count = first, 0
    while len(node):
        node = node[onward[node] > 0]
        count += 1
        before[onward[node]] = node
        index[onward[node]] = count
        node = onward[node]
    # 2. Shift the nodes, by shorter and shorter distances.
    extent = float((motion_cost.scale * costs.space.domain.width).max())
    for shift in _WIDEST_SHIFT * extent / 2.0 ** np.arange(_NUM_SHIFTS):
        changes = shift * unit_motions(motion_cost)
        for parity in (0, 1, 0, 1):  # neighbors never move at once
            rows = np.flatnonzero((before >= 0) & (index % 2 == parity))
            nodes[rows] = _cheapest_places(costs, nodes[before[rows]], nodes[rows], nodes[onward[rows]], changes)
    return nodes


def _cheapest_places(costs: PathCosts, before: Nodes, x: Nodes, after: Nodes, changes: Nodes) -> Nodes:
    """Return, for each ``i``, the point through which the path from ``before[i]`` to ``after[i]`` costs least.

    The candidates are ``x[i]``, and ``x[i] + changes[j]`` for each ``j``. The path consists of two straight motions,
    which must be free. If no candidate is better, the point is ``x[i]``.
    """
    # Changes are compared by estimated costs where the estimate at x is accurate (`is_known`), else by exact costs.
    domain, k = costs.space.domain, len(changes)

    def exact(a: Nodes, x: Nodes, b: Nodes) -> Float[np.ndarray, " n"]:
        return costs.integrals(a, x, _STEP_TOLERANCE) + costs.integrals(x, b, _STEP_TOLERANCE)

    def estimated(a: Nodes, x: Nodes, b: Nodes) -> Float[np.ndarray, " n"]:
        to_x, to_b = domain.difference(x, a)[:, None], domain.difference(b, x)[:, None]
        return (costs.estimates(a, to_x) + costs.estimates(x, to_b))[:, 0]

    cost, estimate = exact(before, x, after), estimated(before, x, after)
    is_known = np.abs(estimate - cost) <= _KNOWN * cost
    best = x.copy()
    for trusted, now, through in ((True, estimate, estimated), (False, cost, exact)):
        rows = np.flatnonzero(is_known == trusted)

        def prices(part: slice, rows=rows, now=now, through=through) -> Float[np.ndarray, "part k"]:
            # Return the costs of the ways through changed places; NaN if they are not cheaper than `now`.
            y = domain.wrapped(x[rows[part], None] + changes).reshape(-1, x.shape[1])
            inside = domain.contains(y)
            a, b = (np.repeat(ends[rows[part]], k, axis=0)[inside] for ends in (before, after))
            price = np.full(len(y), np.nan)
            price[inside] = through(a, y[inside], b)
            price = price.reshape(-1, k)
            return np.where(price <= (1 - _GAIN) * now[rows[part], None], price, np.nan)

        def sees(row: np.ndarray, way: np.ndarray, rows=rows) -> Bool[np.ndarray, " pairs"]:
            y = domain.wrapped(x[rows[row]] + changes[way])
            return costs.space.are_free(before[rows[row]], y) & costs.space.are_free(y, after[rows[row]])

        way = first_visible_in_parts(prices, len(rows), k, sees)[0][:, 0]
        best[rows] = np.where(way[:, None] < 0, x[rows], domain.wrapped(x[rows] + changes[way]))
    # In the end, only exact costs count.
    return np.where((exact(before, best, after) <= (1 - _GAIN) * cost)[:, None], best, x)
