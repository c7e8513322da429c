"""Paths made cheaper within their surroundings: vertices left out, and shifted to where their two legs cost least."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax.geometry.first_visible import first_visible_in_parts
from plr_jax.optimize._path_costs import STEP_TOLERANCE, PathCosts, unit_motions

_KNOWN = 1e-3  # share of the cost of legs, up to which an estimate of it that is off tells which place is best
_GAIN = 1e-6  # share of the cost of legs by which they must become cheaper
_WIDEST, _NUM_SHIFTS = 1 / 32, 8  # of vertices, as a share of the domain; each half of the one before

Points = Float[np.ndarray, "nodes dim"]
Next = Int[np.ndarray, "nodes"]


def made_cheap(costs: PathCosts, nodes: Points, onward: Next, first: Int[np.ndarray, "paths"]) -> tuple[Points, Next]:
    """Cheaper paths in the place of some.

    Args:
        costs: Of motions, and the space.
        nodes: Configurations, the goal first.
        onward: The one that each goes to next, straight; of the goal itself, -1 where there is none. No two go to
            the same but to the goal.
        first: Where paths begin.

    Returns:
        The configurations, some of them shifted, but none that a path begins at, and which each goes to next.
    """
    onward = _pulled_straight(costs, nodes, onward)
    nodes = _shifted(costs, nodes, onward, first)
    return nodes, _pulled_straight(costs, nodes, onward)


def _pulled_straight(costs: PathCosts, nodes: Points, onward: Next) -> Next:
    """The next nodes of paths after they go to the next but one straight away, where that is free and cheaper."""
    stuck = onward < 0
    onward = np.where(stuck, np.arange(len(nodes)), onward)
    leg = costs.integrals(nodes, nodes[onward], STEP_TOLERANCE)
    tried = np.full(len(nodes), -1)
    while True:
        ahead = onward[onward]
        which = np.flatnonzero((ahead != onward) & (ahead != tried))
        if not len(which):
            return np.where(stuck, -1, onward)
        tried[which] = ahead[which]
        which = which[costs.space.are_free(nodes[which], nodes[ahead[which]])]
        straight = costs.integrals(nodes[which], nodes[ahead[which]], STEP_TOLERANCE)
        legs = leg[which], leg[onward[which]]
        better = (straight <= (1 - _GAIN) * sum(legs)) | (np.minimum(*legs) == 0)  # two nodes at one place are one
        which, straight = which[better], straight[better]
        onward[which], leg[which] = ahead[which], straight


def _shifted(costs: PathCosts, nodes: Points, onward: Next, first: Int[np.ndarray, "paths"]) -> Points:
    """The nodes after those between two others are moved to where the legs from and to these cost least."""
    nodes, motion, domain = nodes.copy(), costs.space.motion_cost, costs.space.domain
    before, number = _neighbors(onward, first)
    extent = float((motion.scale * domain.width).max())
    for shift in _WIDEST * extent / 2.0 ** np.arange(_NUM_SHIFTS):
        changes = shift * unit_motions(motion)
        for parity in (0, 1, 0, 1):  # of two neighbors one stays
            which = np.flatnonzero((before >= 0) & (number % 2 == parity))
            nodes[which] = _best_places(costs, nodes[before[which]], nodes[which], nodes[onward[which]], changes)
    return nodes


def _neighbors(onward: Next, first: Int[np.ndarray, "paths"]) -> tuple[Next, Next]:
    """Of each node between two others of a path that reaches the goal the one before, and its number, from 1.

    -1 for other nodes.
    """
    before, number = np.full(len(onward), -1), np.zeros(len(onward), int)
    node, count = first, 0
    while len(node):
        node, count = node[onward[node] > 0], count + 1
        before[onward[node]], number[onward[node]] = node, count
        node = onward[node]
    return before, number


def _best_places(
    costs: PathCosts, before: Points, x: Points, after: Points, changes: Float[np.ndarray, "k dim"]
) -> Points:
    """Configurations, or others beside them, of which estimates are cheapest, where motions through these are."""
    domain, k = costs.space.domain, len(changes)
    cost, estimate = (costs_through(costs, before, x, after) for costs_through in (_through, _about))
    is_known = np.abs(estimate - cost) <= _KNOWN * cost

    def cheapest(
        rows: Int[np.ndarray, "rows"], now: Float[np.ndarray, "n"], costs_through: Callable[..., np.ndarray]
    ) -> Points:
        def prices(some: slice) -> Float[np.ndarray, "some k"]:
            y = domain.wrapped(x[rows[some], None] + changes).reshape(-1, x.shape[1])
            inside = domain.contains(y)
            a, b = (np.repeat(ends[rows[some]], k, axis=0)[inside] for ends in (before, after))
            price = np.full(len(y), np.nan)
            price[inside] = costs_through(costs, a, y[inside], b)
            price = price.reshape(-1, k)
            return np.where(price <= (1 - _GAIN) * now[rows[some], None], price, np.nan)

        def sees(row: Int[np.ndarray, "pairs"], way: Int[np.ndarray, "pairs"]) -> Bool[np.ndarray, "pairs"]:
            y = domain.wrapped(x[rows[row]] + changes[way])
            return costs.space.are_free(before[rows[row]], y) & costs.space.are_free(y, after[rows[row]])

        way = first_visible_in_parts(prices, len(rows), k, sees)[0][:, 0]
        return np.where(way[:, None] < 0, x[rows], domain.wrapped(x[rows] + changes[way]))

    best = x.copy()
    for known, now, costs_through in ((True, estimate, _about), (False, cost, _through)):
        rows = np.flatnonzero(is_known == known)
        best[rows] = cheapest(rows, now, costs_through)
    is_cheaper = _through(costs, before, best, after) <= (1 - _GAIN) * cost
    return np.where(is_cheaper[:, None], best, x)


def _through(costs: PathCosts, a: Points, x: Points, b: Points) -> Float[np.ndarray, "nodes"]:
    return costs.integrals(a, x, STEP_TOLERANCE) + costs.integrals(x, b, STEP_TOLERANCE)


def _about(costs: PathCosts, a: Points, x: Points, b: Points) -> Float[np.ndarray, "nodes"]:
    to_x, to_b = (costs.space.domain.difference(y, z)[:, None] for y, z in ((x, a), (b, x)))
    return (costs.estimates(a, to_x) + costs.estimates(x, to_b))[:, 0]
