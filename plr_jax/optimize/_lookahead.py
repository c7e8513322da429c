"""Paths of a configuration space along a cost-to-go, by lookahead over finite steps.

From each configuration, steps of many lengths and directions lead to others. The way on goes where the cost-to-go
``f`` falls most for what the step costs: ``(f(x) - f(y)) / cost(x, y)`` is 1 along cheapest paths and nowhere above,
by the principle of optimality, whether costs are lengths, times or risks. What is steeper is an error of ``f``, and
counts as 1; of steps nearly as steep the longest is taken, so that kinks and dents smaller than a step do no harm. A
step must let ``f`` fall by a share of its cost, so that a path ends after finitely many.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import as_distances, as_finite_point, as_points, padded, padded_size
from plr_jax._types import ArrayLike
from plr_jax.geometry.first_visible import first_visible_in_parts
from plr_jax.optimize._cheaper import made_cheap
from plr_jax.optimize._dents import Dents
from plr_jax.optimize._descent import Descent
from plr_jax.optimize._path_costs import STEP_TOLERANCE, PathCosts, unit_motions

_LONGEST, _NUM_LENGTHS = 1 / 4, 8  # step, as a share of the domain; lengths, each half of the one before
_FALL = 0.1  # least share of a step's cost by which the cost-to-go falls along it
_LONGER = 0.01  # by how much less steep a step may be that is twice as long
_DEARER = 0.02  # share by which a step may cost more than a few samples of the factor said
_LAST_TOLERANCE = 0.001  # of the costs of paths

Points = Float[np.ndarray, "n dim"]
Nodes = Float[np.ndarray, "nodes dim"]
Next = Int[np.ndarray, "nodes"]
Field = Callable[[ArrayLike], ArrayLike]


def by_lookahead(field: Field, costs: PathCosts, starts: ArrayLike, goal: ArrayLike) -> Descent:
    """Paths that follow a field; arguments as those of ``descend``."""
    domain = costs.space.domain
    starts, goal = as_points("starts", starts, domain.dim), as_finite_point("The goal", goal, domain.dim)
    if not costs.space.is_free(goal[None])[0]:
        raise ValueError(f"The goal {goal.tolist()} is not a free configuration of the space.")
    is_free = costs.space.is_free(starts)
    steps = _Lookahead(field, costs, goal)
    nodes, onward, first = steps.follow(starts[is_free])
    nodes, onward = made_cheap(costs, nodes, onward, first)
    # The paths from the nodes of free starts along the next nodes to the goal, node 0.
    chain = [np.full(len(starts), -1)]
    chain[0][is_free] = first
    while (chain[-1] > 0).any():
        chain.append(np.where(chain[-1] < 0, -1, onward[chain[-1]]))
    chains = np.stack(chain, axis=1)
    reached = chains[:, -1] == 0
    at_goal = (starts == nodes[0]).all(axis=1)
    vertices = nodes[chains]
    counts = np.where(reached, 1 + (chains > 0).sum(axis=1) - at_goal, 0)
    begin, end = vertices[:, :-1].reshape(-1, starts.shape[1]), vertices[:, 1:].reshape(-1, starts.shape[1])
    lengths = costs.lengths(begin, end).reshape(vertices.shape[0], vertices.shape[1] - 1)
    prices = np.zeros(lengths.shape)
    moves = reached[:, None] & (lengths > 0)
    prices[moves] = costs.integrals(begin[moves.ravel()], end[moves.ravel()], _LAST_TOLERANCE)
    return Descent.of(vertices, counts, lengths.sum(axis=1), prices.sum(axis=1), is_free)


class _Lookahead:
    """Steps from configurations to others."""

    def __init__(self, field: Field, costs: PathCosts, goal: Float[np.ndarray, "dim"]):
        self.field, self.costs, self.goal = field, costs, goal
        self.domain, motion = costs.space.domain, costs.space.motion_cost
        longest = _LONGEST * float((motion.scale * self.domain.width).max())
        lengths = longest / 2.0 ** np.arange(_NUM_LENGTHS)
        self.leniency = np.append(0.0, np.repeat(_LONGER * np.arange(_NUM_LENGTHS), len(unit_motions(motion))))
        self.shortest = float(lengths[-1])
        self.dents = Dents(self.values, costs.space, unit_motions(motion))
        self.steps = (lengths[:, None, None] * unit_motions(motion)).reshape(-1, motion.dof)

    def values(self, x: Points) -> Float[np.ndarray, "n"]:
        """The field at configurations, 0 where it is negative and ``inf`` outside the domain."""
        x, inside = self.domain.wrapped(x), self.domain.contains(x)
        values = np.full(len(x), np.inf)
        if inside.any():
            num = int(np.count_nonzero(inside))
            asked = padded(x[inside], padded_size(num), x[inside][-1])
            values[inside] = as_distances("The field", self.field(asked), asked)[:num]
        return np.maximum(values, 0.0)

    def follow(
        self, starts: Points
    ) -> tuple[Float[np.ndarray, "nodes dim"], Int[np.ndarray, "nodes"], Int[np.ndarray, "n"]]:
        """Follow the field from free starts.

        Returns:
            Configurations, the goal first; the one that each goes to next, -1 where a path is stuck; and those of the
            starts.
        """
        nodes, onward = [self.goal[None]], [np.zeros(1, int)]
        x, value, num = starts, self.values(starts), 1
        first = np.arange(1, 1 + len(starts))
        while len(x):
            y, status = self._step(x, value)
            detours = self._ways_out(x, value, y, status)
            goes_on, inner = status == 0, num + len(x)
            num = inner + sum(map(len, detours.values()))
            next_ = np.where(goes_on, num - 1 + np.cumsum(goes_on), np.where(status < 0, -1, 0))
            nodes.append(x)
            onward.append(next_)
            for row, detour in detours.items():
                numbers = inner + np.arange(len(detour))
                nodes.append(detour)
                onward.append(np.append(numbers[1:], next_[row]))
                next_[row], inner = inner, inner + len(detour)
            x, value = y[goes_on], self.values(y[goes_on])
        return np.concatenate(nodes), np.concatenate(onward), first

    def _ways_out(
        self, x: Points, value: Float[np.ndarray, "n"], y: Points, status: Int[np.ndarray, "n"]
    ) -> dict[int, Nodes]:
        """What lies between stuck configurations and the ends of their ways out of dents, by row, where it is any.

        Where there is a way, ``y`` and ``status`` become those of a step to its end.
        """
        detours = {}
        for row in np.flatnonzero(status < 0).tolist():
            chain = self.dents.way_out(x[row], value[row] - _FALL * self.shortest)
            if chain is not None:
                y[row], status[row] = chain[-1], 0
                if len(chain) > 1:
                    detours[row] = chain[:-1]
        return detours

    def _step(self, x: Points, value: Float[np.ndarray, "n"]) -> tuple[Points, Int[np.ndarray, "n"]]:
        """The best step from each of some configurations: where to; 1 if that is the goal, -1 if there is none."""
        num_ways = 1 + len(self.steps)
        promised = np.empty((len(x), num_ways))

        def flatness(rows: slice) -> Float[np.ndarray, "rows ways"]:
            here, before = x[rows], value[rows, None]
            to_goal = self.domain.difference(self.goal, here)[:, None]
            change = np.concatenate([to_goal, np.broadcast_to(self.steps, (len(here), *self.steps.shape))], axis=1)
            there = here[:, None] + change
            cost = self.costs.estimates(here, change)
            after = self.values(there.reshape(-1, there.shape[2])).reshape(cost.shape)
            after[:, 0] = 0.0  # at the goal, by definition
            cost[:, 0] = self.costs.integrals(here, np.broadcast_to(self.goal, here.shape), STEP_TOLERANCE)
            promised[rows] = cost
            with np.errstate(divide="ignore", invalid="ignore"):
                rate = np.where(np.isinf(before) | (cost == 0), 1.0, (before - after) / cost)
            falls = np.isfinite(after) & (rate >= _FALL)
            falls[:, 0] = True
            return np.where(falls, self.leniency - np.clip(rate, 0.0, 1.0), np.nan)

        def sees(row: Int[np.ndarray, "pairs"], way: Int[np.ndarray, "pairs"]) -> Bool[np.ndarray, "pairs"]:
            here, there = x[row], self._ends(x[row], way)
            free = self.costs.space.are_free(here, there)
            exact = self.costs.integrals(here[free], there[free], STEP_TOLERANCE)
            free[free] = exact <= (1 + _DEARER) * promised[row, way][free]
            return free

        way = first_visible_in_parts(flatness, len(x), num_ways, sees)[0][:, 0]
        return self._ends(x, way), np.where(way < 0, -1, np.where(way == 0, 1, 0))

    def _ends(self, x: Points, way: Int[np.ndarray, "n"]) -> Points:
        """Where ways from configurations lead; the first is that to the goal."""
        there = self.domain.wrapped(x + self.steps[np.maximum(way, 1) - 1])
        return np.where(way[:, None] == 0, self.goal, there)
