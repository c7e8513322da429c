"""Robots planned anew among the others: each in turn, then neighborhoods of robots together.

References:
    Li et al., "Anytime multi-agent path finding via large neighborhood search", 2021.
"""

from collections.abc import Sequence

import numpy as np

from plr_jax.planners.replanning.reservations import ReservationTable

_ROUNDING = 1e-9
_GAIN = 1e-2  # share of the cost below which another round is not worth its time
_NEIGHBORHOOD = 5  # robots


def replan_each(table: ReservationTable) -> None:
    """Replan each robot in turn, those first that lose most, until that gains little."""
    while True:
        before = table.cost.sum()
        for i in np.argsort(table.least - table.cost).tolist():
            if table.budget.spent():
                return
            if table.cost[i] > table.least[i] * (1 + _ROUNDING):
                table.release(i)
                table.replan(i, float(table.cost[i]))
                table.reserve(i)
        if before - table.cost.sum() <= _GAIN * before:
            return


def replan_together(table: ReservationTable, robots: Sequence[int]) -> bool:
    """Replan robots one after the other, as if those to come were not there; whether that costs less.

    If it costs more, all keep their paths. Paths that cost the same are taken over.
    """
    robots = list(robots)
    state, cost = table.state[:, robots].copy(), table.cost[robots].copy()
    for i in robots:
        table.release(i)
    num_reserved = 0
    try:
        for done, i in enumerate(robots):
            spent, needed = table.cost[robots[:done]].sum(), table.least[robots[done + 1 :]].sum()
            if not table.replan(i, cost.sum() - spent - needed):
                break
            table.reserve(i)
            num_reserved += 1
        else:
            return bool(table.cost[robots].sum() < (1 - _ROUNDING) * cost.sum())
    finally:
        if num_reserved < len(robots):
            for i in robots[:num_reserved]:
                table.release(i)
            table.state[:, robots], table.cost[robots] = state, cost
            for i in robots:
                table.reserve(i)
    return False


def replan_neighborhoods(table: ReservationTable, count: int, rng: np.random.Generator) -> None:
    """Replan so many neighborhoods: a robot that loses, chosen at random, and those that come nearest to it."""
    for _ in range(count):
        loss = np.maximum(table.cost - table.least, 0.0)
        if table.budget.spent() or loss.sum() <= _ROUNDING * table.least.sum():
            return
        i = int(rng.choice(table.num_robots, p=loss / loss.sum()))
        gap = table.gaps(i) * rng.uniform(1, 2, table.num_robots)
        neighborhood = np.argsort(gap, kind="stable")[:_NEIGHBORHOOD]
        replan_together(table, rng.permutation(neighborhood).tolist())
