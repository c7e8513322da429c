"""The cost-to-go at the nodes of a regular grid, of second order, within milliseconds: an estimate.

Nodes are visited plane by plane. From a node a straight motion leads to the plane before, to where the cost of the
motion and the cost-to-go are least together. There, between nodes, the cost-to-go over the straight length to the goal
is a parabola along each axis: that ratio is smooth where the cost-to-go has the tip of a cone. Planes are updated along
every axis, there and back, until nothing changes. Motions that walls are in the way of are left out, so that walls may
be anywhere between nodes.

References:
    Zhao, "A fast sweeping method for eikonal equations", 2005. Falcone and Ferretti, "Semi-Lagrangian approximation
    schemes for linear and Hamilton-Jacobi equations", 2014. Fomel, Luo, Zhao, "Fast sweeping method for the factored
    eikonal equation", 2009.
"""

from collections.abc import Sequence
from functools import partial
from itertools import product
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

Offset = tuple[int, ...]
"""Steps along each axis, from a node to one of those around it."""
Nodes = Float[Array, "*shape"]
Plane = Float[Array, "*plane"]

_MOST_ROUNDS = 500
_SETTLED = 1e-5  # share by which what no longer counts as a change
_NEWTON_STEPS = 4
_LEAST_CURVATURE = 0.1  # over that of the length of a motion, where the sum is hardly convex
_TINY = 1e-6  # of a step, below which a length has no direction


class Metric(NamedTuple):
    """How motions are measured: blocks of axes, and after how many nodes each axis is periodic, if it is."""

    blocks: tuple[tuple[int, ...], ...]
    periods: tuple[int | None, ...]

    @property
    def dim(self) -> int:
        return len(self.periods)

    @property
    def periodic(self) -> tuple[bool, ...]:
        return tuple(period is not None for period in self.periods)

    def length(self, change: Sequence[Any]) -> Any:
        """Sum over blocks of the length along their axes."""
        return sum(jnp.sqrt(sum(change[axis] ** 2 for axis in block)) for block in self.blocks)

    def derivatives(self, change: Sequence[Any], axis: int) -> tuple[Any, Any]:
        """The first and the second one of the length along an axis."""
        block = next(block for block in self.blocks if axis in block)
        square = sum(change[each] ** 2 for each in block) + _TINY**2
        length = jnp.sqrt(square)
        return change[axis] / length, (square - change[axis] ** 2) / (square * length)


class Costs(NamedTuple):
    """What motions cost at points: a factor of their length, and the larger product with two vectors besides, or none.

    Those of a grid's nodes have its shape last.
    """

    factor: Array
    pulls: Array | None  # (2, dim, ...)

    def of(self, metric: Metric, change: Sequence[Any]) -> Any:
        cost = self.factor * metric.length(change)
        return cost if self.pulls is None else cost + self._products(change).max(axis=0)

    def derivatives(self, metric: Metric, change: Sequence[Any], axis: int) -> tuple[Any, Any]:
        first, second = (self.factor * each for each in metric.derivatives(change, axis))
        if self.pulls is None:
            return first, second
        return first + jnp.where(self._products(change).argmax(axis=0) == 1, *self.pulls[::-1, axis]), second

    def _products(self, change: Sequence[Any]) -> Any:
        assert self.pulls is not None
        return sum(self.pulls[:, axis] * each for axis, each in enumerate(change))


class Grid(NamedTuple):
    """What is given on a grid, in units in which nodes are about 1 apart.

    Attributes:
        spacing: Of nodes along each axis.
        goal: Where the goal is from the first node.
        costs: Of motions at each node.
        is_free: Which motions to the nodes around are free, in the order of :func:`half_offsets`.
    """

    spacing: Float[Array, "dim"]
    goal: Float[Array, "dim"]
    costs: Costs
    is_free: Bool[Array, "half *shape"]


class Swept(NamedTuple):
    """The cost-to-go on a grid.

    Attributes:
        ratio: Over the straight length to the goal, at each node; ``inf`` where no way was found.
        way: The motion from each node, along each axis, in steps of the grid.
    """

    ratio: Nodes
    way: Float[Array, "dim *shape"]


def half_offsets(dim: int) -> list[Offset]:
    """Offsets to half of the nodes around one; those to the others are their opposites."""
    return [offset for offset in product((-1, 0, 1), repeat=dim) if offset > (0,) * dim]


@partial(jax.jit, static_argnames="metric")
def sweep(start: Swept, grid: Grid, metric: Metric) -> Swept:
    """The cost-to-go everywhere, from where it is known."""
    is_free = {}
    for offset, free in zip(half_offsets(metric.dim), grid.is_free, strict=True):
        back = tuple(-step for step in offset)
        is_free |= {offset: free, back: _at(back, free, False, metric.periodic)}

    def swept_once(state):
        old, rounds, _ = state
        new = old
        for axis in range(metric.dim):
            new = _swept_along(new, grid, is_free, metric, axis)
        has_changed = jnp.any(jnp.isfinite(new.ratio) & ~(old.ratio - new.ratio <= _SETTLED * new.ratio))
        return new, rounds + 1, has_changed

    state = start, 0, jnp.array(True)
    return lax.while_loop(lambda state: state[2] & (state[1] < _MOST_ROUNDS), swept_once, state)[0]


def _at(offset: Offset, values: Array, fill: Any, periodic: Sequence[bool]) -> Array:
    """Of each node the value of the one at an offset; the grid's axes are the last ones."""
    first = values.ndim - len(offset)
    for axis, step, wraps in zip(range(first, values.ndim), offset, periodic, strict=True):
        if step:
            moved, end = jnp.roll(values, -step, axis), [slice(None)] * axis + [-1 if step > 0 else 0]
            values = moved if wraps else moved.at[tuple(end)].set(fill)
    return values


def _swept_along(
    state: Swept, grid: Grid, is_free: dict[Offset, Bool[Array, "*shape"]], metric: Metric, axis: int
) -> Swept:
    """Planes across an axis, one after the other, forth and back, each updated from the one before."""

    def by_planes(values: Array | None) -> Array | None:
        return None if values is None else jnp.moveaxis(values, values.ndim - metric.dim + axis, 0)

    (ratio, way), costs = jax.tree.map(by_planes, (tuple(state), grid.costs))
    to_goal = [jnp.arange(n) * h - x for n, h, x in zip(state.ratio.shape, grid.spacing, grid.goal, strict=True)]
    across = jnp.meshgrid(*to_goal[:axis], *to_goal[axis + 1 :], indexing="ij")
    wraps = [*metric.periodic[:axis], *metric.periodic[axis + 1 :]]
    for step in (-1, 1):  # to the plane before
        sides = list(product((-1, 0, 1), repeat=metric.dim - 1))
        offsets = [(*side[:axis], step, *side[axis:]) for side in sides]

        def updated(before, here, sides=sides, offsets=offsets):
            ratio_before, costs_before = before
            (old, old_way), costs_here, may_go, x = here
            known = {}
            for side, offset, free in zip(sides, offsets, may_go, strict=True):
                reached = jnp.where(free, _at(side, ratio_before, jnp.inf, wraps), jnp.inf)
                known[offset] = reached, jax.tree.map(lambda of, side=side: _at(side, of, 0.0, wraps), costs_before)
            place = [*across[:axis], x, *across[axis:]]
            new, new_way = _cheapest(metric, axis, grid.spacing, place, costs_here, known)
            gains = new < old
            new = jnp.where(gains, new, old)
            return (new, costs_here), (new, jnp.where(gains, new_way, old_way))

        last = -1 if step < 0 else 0
        before = ratio[last] if metric.periodic[axis] else jnp.full_like(ratio[last], jnp.inf)
        start = before, jax.tree.map(lambda each, last=last: each[last], costs)
        planes = (ratio, way), costs, [by_planes(is_free[each]) for each in offsets], to_goal[axis]
        _, (ratio, way) = lax.scan(updated, start, planes, reverse=step > 0)
    return Swept(jnp.moveaxis(ratio, 0, axis), jnp.moveaxis(way, 0, axis + 1))


def _cheapest(
    metric: Metric,
    across: int,
    spacing: Float[Array, "dim"],
    place: Sequence[Array],
    costs: Costs,
    known: dict[Offset, tuple[Plane, Costs]],
) -> tuple[Plane, Float[Array, "dim *plane"]]:
    """What the best motions from the nodes of a plane to the one before lead to, and these motions.

    Args:
        metric: How motions are measured.
        across: The axis across which the planes are.
        spacing: Of nodes along each axis.
        place: Where the nodes are from the goal, along each axis.
        costs: Of motions there.
        known: At each offset to a node of the plane before: its ratio, ``inf`` where no motion leads to, and costs.

    Returns:
        The cost-to-go over the straight length to the goal, and the motions in steps along each axis.
    """
    axes = range(metric.dim)

    def change_of(steps):
        return [spacing[axis] * steps[axis] for axis in axes]

    def total(steps, ratio, costs_there):
        change, mean = change_of(steps), jax.tree.map(lambda a, b: (a + b) / 2, costs, costs_there)
        return ratio * metric.length(_from_goal(metric, spacing, place, change)) + mean.of(metric, change)

    # To one of the nodes.
    shape = jnp.shape(costs.factor)
    least, way = jnp.full(shape, jnp.inf), jnp.zeros((metric.dim, *shape))
    for offset, there in known.items():
        value = total(offset, *there)
        way = jnp.where(value < least, jnp.array(offset, way.dtype).reshape(-1, *[1] * len(shape)), way)
        least = jnp.minimum(least, value)

    # To between them, by Newton's method along all axes of the plane at once.
    center = tuple(int(next(iter(known))[axis]) if axis == across else 0 for axis in axes)
    ratio, costs_there = known[center]
    is_known = jnp.isfinite(ratio)
    ratio = jnp.where(is_known, ratio, 0.0)
    parabolas = {}
    for axis in axes:
        if axis != across:
            up, down = (tuple(side if each == axis else center[each] for each in axes) for side in (1, -1))
            parabolas[axis] = _parabola(ratio, costs_there, known[up], known[down])
    steps = [jnp.full(shape, float(step)) for step in center]

    def interpolated(steps):
        value, cost = ratio, costs_there
        for axis, (rise, bend, cost_rise, *_) in parabolas.items():
            value = value + steps[axis] * (rise + steps[axis] * bend)
            cost = jax.tree.map(lambda a, b, step=steps[axis]: a + step * b, cost, cost_rise)
        return value, cost

    for _ in range(_NEWTON_STEPS):
        (value, cost), change = interpolated(steps), change_of(steps)
        end, mean = _from_goal(metric, spacing, place, change), jax.tree.map(lambda a, b: (a + b) / 2, costs, cost)
        length, new = metric.length(end), list(steps)
        for axis, (rise, bend, cost_rise, low, high) in parabolas.items():
            h, slope = spacing[axis], rise + 2 * steps[axis] * bend
            of_length, of_cost = metric.derivatives(end, axis), mean.derivatives(metric, change, axis)
            first = slope * length + h * (value * of_length[0] + of_cost[0]) + cost_rise.of(metric, change) / 2
            second = 2 * bend * length + 2 * slope * h * of_length[0] + h**2 * (value * of_length[1] + of_cost[1])
            floor = _LEAST_CURVATURE * h**2 * costs.factor / spacing[across]
            new[axis] = jnp.clip(steps[axis] - first / jnp.maximum(second, floor), low, high)
        steps = new
    value = jnp.where(is_known, total(steps, *interpolated(steps)), jnp.inf)
    way = jnp.where(value < least, jnp.stack(steps), way)
    length = metric.length(_from_goal(metric, spacing, place, [0.0] * metric.dim))
    return jnp.where(length > _TINY, jnp.minimum(least, value) / length, jnp.inf), way


def _parabola(
    ratio: Plane, costs: Costs, up: tuple[Plane, Costs], down: tuple[Plane, Costs]
) -> tuple[Plane, Plane, Costs, Plane, Plane]:
    """Of ratios along an axis, the slope and half the bend; the slope of costs; and from where to where they hold."""
    has_up, has_down = jnp.isfinite(up[0]), jnp.isfinite(down[0])
    above, below = jnp.where(has_up, up[0] - ratio, 0.0), jnp.where(has_down, ratio - down[0], 0.0)
    both = has_up & has_down
    bend = jnp.where(both, (above - below) / 2, 0.0)
    slope = jnp.where(both, (above + below) / 2, above + below)
    weights = jnp.where(both, 0.5, 1.0) * has_up, jnp.where(both, 0.5, 1.0) * has_down
    cost_slope = jax.tree.map(lambda a, b, c: weights[0] * (a - b) + weights[1] * (b - c), up[1], costs, down[1])
    return slope, bend, cost_slope, jnp.where(has_down, -1.0, 0.0), jnp.where(has_up, 1.0, 0.0)


def _from_goal(metric: Metric, spacing: Float[Array, "dim"], place: Sequence[Array], change: Sequence[Any]) -> list[Array]:
    """Where motions end, from the goal, the short way around."""
    ends = [x + by for x, by in zip(place, change, strict=True)]
    return [
        end if nodes is None else end - spacing[axis] * nodes * jnp.round(end / (spacing[axis] * nodes))
        for axis, (end, nodes) in enumerate(zip(ends, metric.periods, strict=True))
    ]
