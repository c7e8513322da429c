"""An estimate of the cost-to-go on a dyadic grid: what is given at nodes, swept, and what is between them."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int, Int8

from plr_jax.eikonal.mesh import even_depth
from plr_jax.eikonal.sweeping import CostGrid, GridMetric, NodeCosts, Swept, half_offsets, sweep
from plr_jax.plr.tree import corner_bits
from plr_jax.spaces import CellState, ConfigurationSpace, CostMap, MotionCost, point_costs, pulled

MOST_AXES = 3
_COARSER = 2  # halvings: of much larger boxes, samples tell too little where there are no proofs
_NEAR = 2  # nodes, on each side of the goal, from which one goes straight to it

Fractions = Float[np.ndarray, "n dim"]
PointCosts = Callable[
    [Float[np.ndarray, "n dim"]], tuple[Float[np.ndarray, "n"], Float[np.ndarray, "2 n dim"] | None]
]
"""What motions cost at points: a factor of their length, and two vectors of which they cost the larger product."""


@dataclass(frozen=True, eq=False)
class GridEstimate:
    """The cost-to-go at the nodes of a grid, and between them.

    Attributes:
        space: The configuration space.
        depth: How often the domain is halved along each axis.
        goal: The goal, a fraction of the domain.
        straight: What a motion to the goal would cost by the costs there.
        ratio: The cost-to-go over that of the straight motion, at each node; ``inf`` where no way was found.
        way: The motion from each node, along each axis, in steps of the grid.
        box: What is known of the boxes between nodes.
    """

    space: ConfigurationSpace
    depth: Int[np.ndarray, "dim"]
    goal: Float[np.ndarray, "dim"]
    straight: Callable[[Float[np.ndarray, "n dim"]], Float[np.ndarray, "n"]]
    ratio: Float[np.ndarray, "*shape"]
    way: Float[np.ndarray, "*shape dim"]
    box: Int8[np.ndarray, "*boxes"]

    def __call__(self, x: Fractions) -> Float[np.ndarray, "n"]:
        """The estimate at fractions of the domain; ``inf`` where no node of the box around has a way.

        Multilinear in the ratio. Beside walls only nodes count to which a straight motion is free.
        """
        first, t = self._boxes(x)
        is_open = self.box[tuple(first.T)] == CellState.FREE
        total, weights = np.zeros(len(x)), np.zeros(len(x))
        for corner in corner_bits(len(self.depth)):
            node = self._node(first + corner)
            ratio = self.ratio[tuple(node.T)]
            weight = np.where(corner, t, 1 - t).prod(axis=1) * np.isfinite(ratio)
            doubtful = np.flatnonzero(~is_open & (weight > 0))
            weight[doubtful] *= self.space.are_free(
                self.space.domain.at(x[doubtful]), self.space.domain.at(self._of(node[doubtful]))
            )
            total += weight * np.where(weight > 0, ratio, 0.0)
            weights += weight
        straight = self.straight(
            self.space.domain.difference(self.space.domain.at(self.goal[None]), self.space.domain.at(x))
        )
        return np.where(weights > 0, total / np.maximum(weights, np.finfo(float).tiny) * straight, np.inf)

    def along(self, x: Fractions, strides: Sequence[int]) -> Iterator[Fractions]:
        """Where ways lead from fractions of the domain, after each of some numbers of steps; they end at the goal."""
        size = np.ldexp(1.0, -self.depth)
        for step in range(1, max(strides) + 1):
            node = self._node(np.rint(x / size).astype(np.int64))
            x = x + self.way[tuple(node.T)] * size
            x = np.where(self.space.domain.periodic, x % 1.0, np.clip(x, 0.0, 1.0))
            if step in strides:
                yield x

    def _boxes(self, x: Fractions) -> tuple[Int[np.ndarray, "n dim"], Fractions]:
        place = np.ldexp(x, self.depth)
        first = np.clip(np.floor(place).astype(np.int64), 0, np.array(self.box.shape) - 1)
        return first, np.clip(place - first, 0.0, 1.0)

    def _node(self, index: Int[np.ndarray, "n dim"]) -> Int[np.ndarray, "n dim"]:
        shape = np.array(self.ratio.shape)
        return np.where(self.space.domain.periodic, index % shape, np.clip(index, 0, shape - 1))

    def _of(self, node: Int[np.ndarray, "n dim"]) -> Fractions:
        return np.ldexp(node.astype(float), -self.depth)


def swept_estimate(
    space: ConfigurationSpace, cost_map: CostMap | None, goal: Float[np.ndarray, "dim"], max_boxes: int
) -> GridEstimate:
    """The estimate on a grid of at most so many boxes, about equally wide along every axis."""
    domain, motion = space.domain, space.motion_cost
    depth = even_depth(domain, motion.scale, max_boxes, max_boxes)
    periodic = np.array(domain.periodic)
    shape = tuple(((1 << depth) + ~periodic).tolist())
    box = _box_states(space, depth)
    x = np.ldexp(np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1).astype(float), -depth)
    q = domain.at(x)
    is_free = _free_motions(space, box, q, depth)
    may_go = np.zeros(shape, bool)
    for offset, free in zip(half_offsets(domain.dim), is_free, strict=True):
        may_go |= free
        ends = tuple((index + step) % size for index, step, size in zip(np.nonzero(free), offset, shape, strict=True))
        may_go[ends] = True

    def costs_of(q):
        return (np.ones(len(q)), None) if cost_map is None else point_costs(motion, cost_map, q)

    factor, pulls = np.ones(shape), None
    of_free, pulls_of_free = costs_of(q[may_go])
    factor[may_go] = of_free
    if pulls_of_free is not None:
        pulls = np.zeros((2, domain.dim, *shape))
        pulls[:, :, may_go] = np.moveaxis(pulls_of_free, 2, 1)
    factor_there, pulls_there = costs_of(domain.at(goal[None]))

    def straight(change):
        pulls = None if pulls_there is None else np.broadcast_to(pulls_there, (2, *change.shape))
        return factor_there * motion.norm(change) + pulled(pulls, change)

    ratio, way = _near_goal(space, depth, goal, costs_of, straight, shape)
    # In units in which nodes are about 1 apart, motions of length 1 along an axis cost 1 at the mean.
    size = domain.width * np.ldexp(1.0, -depth) * motion.scale
    unit, rate = np.exp(np.log(size).mean()), float(np.mean(of_free)) if len(of_free) else 1.0
    grid = CostGrid(
        jnp.asarray(size / unit, jnp.float32),
        jnp.asarray(goal * domain.width * motion.scale / unit, jnp.float32),
        _scaled(factor_there[0], None if pulls_there is None else pulls_there[:, 0], motion, rate),
        _scaled(factor, pulls, motion, rate),
        jnp.asarray(is_free),
    )
    blocks = tuple(axes for axes, _ in motion.blocks)
    periods = tuple(int(size) if wraps else None for size, wraps in zip(shape, periodic, strict=True))
    start = Swept(jnp.asarray(ratio, jnp.float32), jnp.asarray(np.moveaxis(way, -1, 0), jnp.float32))
    found = sweep(start, grid, GridMetric(blocks, periods))
    ratio = np.asarray(found.ratio, np.float64)
    return GridEstimate(
        space, depth, goal, straight, ratio, np.moveaxis(np.asarray(found.way, np.float64), 0, -1), box
    )


def _scaled(
    factor: Any, pulls: Float[np.ndarray, "2 dim *shape"] | None, motion: MotionCost, rate: float
) -> NodeCosts:
    """Costs in other units: of costs, and of axes."""
    if pulls is not None:
        pulls = pulls / (rate * motion.scale.reshape(-1, *[1] * (pulls.ndim - 2)))
    factor = jnp.asarray(factor / rate, jnp.float32)
    return NodeCosts(factor, None if pulls is None else jnp.asarray(pulls, jnp.float32))


def _box_states(space: ConfigurationSpace, depth: Int[np.ndarray, "dim"]) -> Int8[np.ndarray, "*boxes"]:
    """What is proven of the boxes between nodes: of the mixed ones of a coarser grid, part by part."""
    at = np.maximum(depth - _COARSER, 0)
    state = np.full(tuple(1 << at), CellState.MIXED, np.int8)
    while True:
        mixed = np.argwhere(state == CellState.MIXED)
        lo, hi = (space.domain.at(np.ldexp(mixed + float(end), -at)) for end in (0, 1))
        state[tuple(mixed.T)] = space.classify(lo, hi)
        if (at == depth).all():
            return state
        for axis in np.flatnonzero(at < depth):
            state = np.repeat(state, 2, axis=axis)
        at = np.minimum(at + 1, depth)


def _free_motions(
    space: ConfigurationSpace,
    box: Int8[np.ndarray, "*boxes"],
    q: Float[np.ndarray, "*shape dim"],
    depth: Int[np.ndarray, "dim"],
) -> Bool[np.ndarray, "half *shape"]:
    """Which motions to the nodes around are free: in a free box, or else tested."""
    domain, shape, padded = space.domain, q.shape[:-1], box
    for axis, wraps in enumerate(domain.periodic):
        width = [(int(each == axis),) * 2 for each in range(domain.dim)]
        padded = np.pad(padded, width, "wrap") if wraps else np.pad(padded, width, constant_values=CellState.BLOCKED)
    result = []
    for offset in half_offsets(domain.dim):
        free, mixed = np.zeros(shape, bool), np.zeros(shape, bool)
        for sides in product(*((0, -1) if step == 0 else ((0,) if step > 0 else (-1,)) for step in offset)):
            beside = padded[tuple(slice(1 + side, 1 + side + n) for side, n in zip(sides, shape, strict=True))]
            free |= beside == CellState.FREE
            mixed |= beside == CellState.MIXED
        at = np.nonzero(mixed & ~free)
        begin = q[at]
        free[at] = space.are_free(begin, begin + np.array(offset) * np.ldexp(domain.width, -depth))
        result.append(free)
    return np.stack(result)


def _near_goal(
    space: ConfigurationSpace,
    depth: Int[np.ndarray, "dim"],
    goal: Float[np.ndarray, "dim"],
    costs_of: PointCosts,
    straight: Callable[[Float[np.ndarray, "n dim"]], Float[np.ndarray, "n"]],
    shape: tuple[int, ...],
) -> tuple[Float[np.ndarray, "*shape"], Float[np.ndarray, "*shape dim"]]:
    """The ratio at nodes around the goal from which one goes straight to it, and these motions."""
    domain, motion, place = space.domain, space.motion_cost, np.ldexp(goal, depth)
    around = np.array(list(product(range(1 - _NEAR, _NEAR + 1), repeat=domain.dim)))
    node = np.floor(place).astype(np.int64) + around
    node = node[(((node >= 0) & (node < np.array(shape))) | domain.periodic).all(axis=1)]
    to_goal, step = place - node, np.ldexp(domain.width, -depth)
    q, change = domain.lo + step * node, step * to_goal
    free = space.are_free(q, q + change)
    node, to_goal, q, change = node[free] % np.array(shape), to_goal[free], q[free], change[free]
    factor, pulls = costs_of(q)
    here = factor * motion.norm(change) + pulled(pulls, change)  # and at the goal, of which the mean is taken
    there = straight(change)
    mean = np.divide(here, there, out=np.ones(len(q)), where=there > 0) / 2 + 0.5
    ratio, way = np.full(shape, np.inf), np.zeros((*shape, domain.dim))
    ratio[tuple(node.T)], way[tuple(node.T)] = mean, to_goal
    return ratio, way
