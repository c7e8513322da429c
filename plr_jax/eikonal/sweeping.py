"""The cost-to-go at the nodes of a regular grid, of second order, within milliseconds: an estimate.

Nodes are visited plane by plane. From a node a straight motion leads to the plane before, to where the cost of the
motion and the cost-to-go are least together. Between nodes of that plane the cost-to-go, over that of the straight
motion to the goal, is a parabola along each axis: this ratio is smooth where the cost-to-go has the tip of a cone.
Planes are updated along every axis, there and back, until nothing changes. Motions that meet walls are left out, so
that walls may be anywhere between nodes.

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
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

Offset = tuple[int, ...]
"""Steps along each axis, from a node to one of those around it."""
Nodes = Float[Array, "*shape"]
Plane = Float[Array, "*plane"]

_MOST_ROUNDS = 500
_SETTLED = 1e-5  # share by which what no longer counts as a change
_NEWTON_STEPS = 5
_LEAST_CURVATURE = 0.1  # over that of the length of a motion, where the sum is hardly convex
_TINY = 1e-6  # of a step, below which a length has no direction


class GridMetric(NamedTuple):
    """How motions are measured: blocks of axes, and after how many nodes each axis is periodic, if it is."""

    blocks: tuple[tuple[int, ...], ...]
    periods: tuple[int | None, ...]

    @property
    def dim(self) -> int:
        """Number of axes."""
        return len(self.periods)

    @property
    def periodic(self) -> tuple[bool, ...]:
        """Which axes are."""
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


class NodeCosts(NamedTuple):
    """What motions cost at points: a factor of their length, and the larger product with two vectors besides.

    Attributes:
        factor: Of the points' shape.
        pulls: The vectors, that shape last, ``(2, dim, ...)``; None for none.
    """

    factor: Array
    pulls: Array | None

    def of(self, metric: GridMetric, change: Sequence[Any]) -> Any:
        """What motions cost."""
        cost = self.factor * metric.length(change)
        return cost if self.pulls is None else cost + self._products(change).max(axis=0)

    def derivatives(self, metric: GridMetric, change: Sequence[Any], axis: int) -> tuple[Any, Any]:
        """The first and the second one of that along an axis of the motion."""
        first, second = (self.factor * each for each in metric.derivatives(change, axis))
        if self.pulls is None:
            return first, second
        return first + jnp.where(self._products(change).argmax(axis=0) == 1, *self.pulls[::-1, axis]), second

    def _products(self, change: Sequence[Any]) -> Any:
        assert self.pulls is not None
        changes = jnp.stack(jnp.broadcast_arrays(*change))
        missing = changes.ndim + 1 - self.pulls.ndim  # axes, of costs at a single point
        return jnp.sum(self.pulls.reshape(*self.pulls.shape, *[1] * missing) * changes, axis=1)


class CostGrid(NamedTuple):
    """What is given on a grid, in units in which nodes are about 1 apart.

    Attributes:
        spacing: Of nodes along each axis.
        goal: Where the goal is from the first node.
        straight: Costs at the goal, by which straight motions to it are measured.
        costs: Of motions at each node.
        is_free: Which motions to the nodes around are free, in the order of :func:`half_offsets`.
    """

    spacing: Float[Array, "dim"]
    goal: Float[Array, "dim"]
    straight: NodeCosts
    costs: NodeCosts
    is_free: Bool[Array, "half *shape"]


Swept = tuple[Nodes, Float[Array, "dim *shape"]]
"""The cost-to-go over that of the straight motion to the goal, at each node, ``inf`` where no way was found; and the
motion from each node, along each axis, in steps of the grid."""


def half_offsets(dim: int) -> list[Offset]:
    """Offsets to half of the nodes around one; those to the others are their opposites."""
    return [offset for offset in product((-1, 0, 1), repeat=dim) if offset > (0,) * dim]


@partial(jax.jit, static_argnames="metric")
def sweep(start: Swept, grid: CostGrid, metric: GridMetric) -> Swept:
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
        has_changed = jnp.any(jnp.isfinite(new[0]) & ~(old[0] - new[0] <= _SETTLED * new[0]))
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
    state: Swept, grid: CostGrid, is_free: dict[Offset, Bool[Array, "*shape"]], metric: GridMetric, axis: int
) -> Swept:
    """Planes across an axis, one after the other, forth and back, each updated from the one before."""

    def by_planes(values: Array) -> Array:
        return jnp.moveaxis(values, values.ndim - metric.dim + axis, 0)

    (ratio, way), costs = jax.tree.map(by_planes, (state, grid.costs))
    to_goal = [jnp.arange(n) * h - x for n, h, x in zip(state[0].shape, grid.spacing, grid.goal, strict=True)]
    across = jnp.meshgrid(*to_goal[:axis], *to_goal[axis + 1 :], indexing="ij")
    wraps = [*metric.periodic[:axis], *metric.periodic[axis + 1 :]]
    for step in (-1, 1):  # to the plane before
        sides = list(product((-1, 0, 1), repeat=metric.dim - 1))
        offsets = [(*side[:axis], step, *side[axis:]) for side in sides]

        def updated(before, here, sides=sides, offsets=offsets):
            ratio_before, costs_before = before
            (old, old_way), costs_here, may_go, x = here
            place = [*across[:axis], x, *across[axis:]]
            # What the nodes find in the plane before: at the nodes around, side by side, and second differences of
            # the ratio along each axis of the plane, at the node before and on its two sides.
            around = jnp.stack([_at(side, ratio_before, jnp.inf, wraps) for side in sides])
            around = jnp.where(may_go, around, jnp.inf)
            factor = jnp.stack([_at(side, costs_before.factor, 1.0, wraps) for side in sides])
            pulls = costs_before.pulls
            if pulls is not None:
                pulls = jnp.stack([_at(side, pulls, 0.0, wraps) for side in sides], axis=2)
            bends = []
            for each in range(len(wraps)):
                unit = tuple(int(other == each) for other in range(len(wraps)))
                back = tuple(-step for step in unit)
                bend = _at(unit, ratio_before, jnp.inf, wraps) + _at(back, ratio_before, jnp.inf, wraps)
                bend = bend - 2 * ratio_before
                bend = jnp.where(jnp.isfinite(bend), bend, 0.0)
                bends.append({0: bend, 1: _at(unit, bend, 0.0, wraps), -1: _at(back, bend, 0.0, wraps)})
            before = around, NodeCosts(factor, pulls), bends
            new, new_way = _cheapest(metric, axis, grid, place, costs_here, np.array(offsets), before)
            gains = new < old
            new = jnp.where(gains, new, old)
            return (new, costs_here), (new, jnp.where(gains, new_way, old_way))

        last = -1 if step < 0 else 0
        before = ratio[last] if metric.periodic[axis] else jnp.full_like(ratio[last], jnp.inf)
        start = before, jax.tree.map(lambda each, last=last: each[last], costs)
        may_go = jnp.stack([by_planes(is_free[each]) for each in offsets], axis=1)
        planes = (ratio, way), costs, may_go, to_goal[axis]
        _, (ratio, way) = lax.scan(updated, start, planes, reverse=step > 0)
    return jnp.moveaxis(ratio, 0, axis), jnp.moveaxis(way, 0, axis + 1)


def _cheapest(
    metric: GridMetric,
    across: int,
    grid: CostGrid,
    place: Sequence[Array],
    costs: NodeCosts,
    offsets: Int[np.ndarray, "sides dim"],
    before: tuple[Float[Array, "sides *plane"], NodeCosts, list[dict[int, Plane]]],
) -> tuple[Plane, Float[Array, "dim *plane"]]:
    """What the best motions from the nodes of a plane to the one before lead to, and these motions.

    Args:
        metric: How motions are measured.
        across: The axis across which the planes are.
        grid: The grid.
        place: Where the nodes are from the goal, along each axis.
        costs: Of motions there.
        offsets: To the nodes around in the plane before.
        before: The ratio at these, ``inf`` where no motion leads to; costs of motions there; and second differences
            of the ratio along each axis of the plane, by side.

    Returns:
        The cost-to-go over that of the straight motion to the goal, and the motions in steps along each axis.
    """
    axes, shape, spacing = range(metric.dim), jnp.shape(costs.factor), grid.spacing
    around, costs_before, bends_before = before

    def total(steps, ratio, costs_there):
        change = [spacing[axis] * steps[axis] for axis in axes]
        return ratio * grid.straight.of(metric, _to_goal(metric, spacing, place, change)) + costs_there.of(
            metric, change
        )

    # To one of the nodes.
    pulls = costs_before.pulls
    if pulls is not None and costs.pulls is not None:
        pulls = (costs.pulls[:, :, None] + pulls) / 2
    beside = NodeCosts((costs.factor + costs_before.factor) / 2, pulls)
    steps = offsets.T.reshape(metric.dim, -1, *[1] * len(shape)).astype(np.float32)
    totals = total(steps, around, beside)
    best = jnp.argmin(totals, axis=0)
    least, way = jnp.min(totals, axis=0), jnp.asarray(steps.reshape(metric.dim, -1))[:, best]

    # To between them, by Newton's method along all axes of the plane at once. Costs that depend on which way one goes
    # have kinks: where it leaves what is known to hold the best step along an axis, that is halved.
    row = {tuple(offset): number for number, offset in enumerate(offsets.tolist())}
    center = [int(offsets[0, axis]) if axis == across else 0 for axis in axes]
    middle = row[tuple(center)]
    is_known = jnp.isfinite(around[middle])
    ratio = jnp.where(is_known, around[middle], 0.0)
    at_middle = _row(beside, middle, len(shape))
    lines = {}
    for axis, bends in zip([each for each in axes if each != across], bends_before, strict=True):
        ends = {side: row[tuple(side if each == axis else center[each] for each in axes)] for side in (1, -1)}
        has = {side: jnp.isfinite(around[end]) for side, end in ends.items()}
        both = has[1] & has[-1]
        rises = {side: jnp.where(has[side], around[end] - ratio, 0.0) for side, end in ends.items()}
        # Half the bend nearer 0, or 0 if they are opposite: where ratios have a kink they are straight lines.
        lesser = {side: jnp.where(jnp.abs(bends[0]) < jnp.abs(bends[side]), bends[0], bends[side]) for side in ends}
        halves = {
            side: jnp.where(both, jnp.where(bends[0] * bends[side] > 0, lesser[side], 0.0) / 2, 0.0) for side in ends
        }
        share = 1 / jnp.maximum(has[1] + 1.0 * has[-1], 1.0)
        costs_rise = jax.tree.map(
            lambda middle, up, down, has=has, share=share: (
                share * (has[1] * (up - middle) + has[-1] * (middle - down))
            ),
            at_middle,
            *(_row(beside, end, len(shape)) for end in ends.values()),
        )
        lines[axis] = _Line(rises, halves, has, share, costs_rise)

    least_beside, most_beside = (
        jax.tree.map(lambda of, extreme=extreme: extreme(of, axis=-1 - len(shape)), beside)
        for extreme in (jnp.min, jnp.max)
    )
    # What the ratio changes by between two axes of the plane, beside what it does along each: bilinear by quadrant.
    # Where no motion leads to the node across, the ratio there is taken for the larger one beside it: it is never
    # less than that of all nodes around.
    quadrants, pair = {}, list(lines)
    for sides in product((1, -1), repeat=2) if len(pair) == 2 else ():
        at = dict(zip(pair, sides, strict=True))
        ratio_across = around[row[tuple(at.get(axis, step) for axis, step in enumerate(center))]]
        rises = [lines[axis].rises[side] for axis, side in at.items()]
        ratio_across = jnp.where(jnp.isfinite(ratio_across), ratio_across, ratio + jnp.maximum(*rises))
        quadrants[sides] = ratio_across - ratio - sum(rises)

    def twist_slope(steps, axis):
        if not quadrants:
            return 0.0
        a, b = (steps[each] for each in pair)
        up, down = (jnp.where(b > 0, quadrants[side, 1], quadrants[side, -1]) for side in (1, -1))
        own, other = (a, b) if axis == pair[0] else (b, a)
        return jnp.sign(own) * jnp.abs(other) * jnp.where(a > 0, up, down)

    def interpolated(steps):
        value, cost = ratio + (steps[pair[0]] * twist_slope(steps, pair[0]) if quadrants else 0.0), at_middle
        for axis, line in lines.items():
            value = value + line.change(steps[axis])
            cost = jax.tree.map(lambda a, b, step=steps[axis]: a + step * b, cost, line.costs_rise)
        # Where costs jump, a mean slope leads beyond those of all nodes around, and even below 0.
        return value, jax.tree.map(jnp.clip, cost, least_beside, most_beside)

    def improved(_, state):
        steps, brackets = state
        value, cost = interpolated(steps)
        change = [spacing[axis] * steps[axis] for axis in axes]
        end = _to_goal(metric, spacing, place, change)
        straight, new, closer = grid.straight.of(metric, end), list(steps), {}
        for axis, line in lines.items():
            h, (slope, bend) = spacing[axis], line.derivatives(steps[axis])
            slope = slope + twist_slope(steps, axis)
            of_end, of_cost = grid.straight.derivatives(metric, end, axis), cost.derivatives(metric, change, axis)
            first = slope * straight + h * (of_cost[0] - value * of_end[0]) + line.costs_rise.of(metric, change)
            second = bend * straight - 2 * slope * h * of_end[0] + h**2 * (value * of_end[1] + of_cost[1])
            floor = _LEAST_CURVATURE * h**2 * costs.factor / spacing[across]
            low = jnp.where(first > 0, brackets[axis][0], steps[axis])
            high = jnp.where(first > 0, steps[axis], brackets[axis][1])
            step = steps[axis] - first / jnp.maximum(second, floor)
            new[axis] = jnp.where((step >= low) & (step <= high), step, (low + high) / 2)
            closer[axis] = low, high
        return new, closer

    steps = [jnp.full(shape, float(step), costs.factor.dtype) for step in center]
    brackets = {
        axis: (jnp.where(line.has[-1], -1.0, 0.0), jnp.where(line.has[1], 1.0, 0.0)) for axis, line in lines.items()
    }
    steps, _ = lax.fori_loop(0, _NEWTON_STEPS, improved, (steps, brackets))
    value = jnp.where(is_known, total(steps, *interpolated(steps)), jnp.inf)
    way = jnp.where(value < least, jnp.stack(steps), way)
    straight = grid.straight.of(metric, _to_goal(metric, spacing, place, [0.0] * metric.dim))
    return jnp.where(straight > _TINY, jnp.minimum(least, value) / straight, jnp.inf), way


class _Line(NamedTuple):
    """What is between a node and its two neighbors along an axis: two halves of parabolas, by side, up 1 and down -1.

    Attributes:
        rises: What the ratio of the neighbor is above the node's.
        halves: Half the second difference of ratios.
        has: Whether there is a way to the neighbor.
        share: 1 over the number of neighbors with one.
        costs_rise: What costs rise by upward.
    """

    rises: dict[int, Plane]
    halves: dict[int, Plane]
    has: dict[int, Bool[Array, "*plane"]]
    share: Plane
    costs_rise: NodeCosts

    def change(self, step: Plane) -> Plane:
        """What the ratio changes by on the way."""
        rise, half = (jnp.where(step > 0, each[1], each[-1]) for each in (self.rises, self.halves))
        return jnp.abs(step) * (rise - (1 - jnp.abs(step)) * half)

    def derivatives(self, step: Plane) -> tuple[Plane, Plane]:
        """The first and the second one of that; at the node the mean of both sides."""
        up, down = (side * (self.rises[side] - (1 - 2 * jnp.abs(step)) * self.halves[side]) for side in (1, -1))
        at_node = self.share * (up * self.has[1] + down * self.has[-1])
        slope = jnp.where(step == 0, at_node, jnp.where(step > 0, up, down))
        return slope, 2 * jnp.where(step > 0, self.halves[1], self.halves[-1])


def _row(costs: NodeCosts, row: int, dim: int) -> NodeCosts:
    return jax.tree.map(lambda of: of[..., row, *[slice(None)] * dim], costs)


def _to_goal(
    metric: GridMetric, spacing: Float[Array, "dim"], place: Sequence[Array], change: Sequence[Any]
) -> list[Array]:
    """The straight motions to the goal from where others end, the short way around."""
    ends = [-x - by for x, by in zip(place, change, strict=True)]
    return [
        end if nodes is None else end - spacing[axis] * nodes * jnp.round(end / (spacing[axis] * nodes))
        for axis, (end, nodes) in enumerate(zip(ends, metric.periods, strict=True))
    ]
