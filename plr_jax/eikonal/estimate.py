"""An estimate of the cost-to-go on a dyadic grid: what is given at nodes, swept, and what is between them."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int, Int8

from plr_jax.eikonal.mesh import even_depth
from plr_jax.eikonal.sweeping import CostGrid, GridMetric, NodeCosts, half_offsets, sweep
from plr_jax.plr.tree import corner_bits
from plr_jax.spaces import CellState, ConfigurationSpace, CostMap, point_costs, pulled

MOST_AXES = 3
_COARSER = 2  # halvings: of much larger boxes, samples tell too little where there are no proofs
_NEAR = 2  # nodes, on each side of the goal, from which one goes straight to it

Fractions = Float[np.ndarray, "n dim"]


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
        place = np.ldexp(x, self.depth)
        first = np.clip(np.floor(place).astype(np.int64), 0, np.array(self.box.shape) - 1)
        t = np.clip(place - first, 0.0, 1.0)
        is_open = self.box[tuple(first.T)] == CellState.FREE
        total, weights = np.zeros(len(x)), np.zeros(len(x))
        for corner in corner_bits(len(self.depth)):
            node = self._node(first + corner)
            ratio = self.ratio[tuple(node.T)]
            weight = np.where(corner, t, 1 - t).prod(axis=1) * np.isfinite(ratio)
            doubtful = np.flatnonzero(~is_open & (weight > 0))
            end = np.ldexp(node[doubtful].astype(float), -self.depth)
            weight[doubtful] *= self.space.are_free(self.space.domain.at(x[doubtful]), self.space.domain.at(end))
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

    def _node(self, index: Int[np.ndarray, "n dim"]) -> Int[np.ndarray, "n dim"]:
        shape = np.array(self.ratio.shape)
        return np.where(self.space.domain.periodic, index % shape, np.clip(index, 0, shape - 1))


def swept_estimate(
    space: ConfigurationSpace, cost_map: CostMap | None, goal: Float[np.ndarray, "dim"], max_boxes: int
) -> GridEstimate:
    """The estimate on a grid of at most so many boxes, about equally wide along every axis."""
    domain, motion, dim = space.domain, space.motion_cost, space.domain.dim
    depth = even_depth(domain, motion.scale, max_boxes, max_boxes)
    shape = tuple(((1 << depth) + ~np.array(domain.periodic)).tolist())
    # 1. What is proven of the boxes between nodes: of the mixed ones of a coarser grid, part by part.
    at = np.maximum(depth - _COARSER, 0)
    box = np.full(tuple(1 << at), CellState.MIXED, np.int8)
    while True:
        mixed = np.argwhere(box == CellState.MIXED)
        box[tuple(mixed.T)] = space.classify(*(domain.at(np.ldexp(mixed + float(end), -at)) for end in (0, 1)))
        if (at == depth).all():
            break
        for axis in np.flatnonzero(at < depth):
            box = np.repeat(box, 2, axis=axis)
        at = np.minimum(at + 1, depth)
    # 2. Which motions to the nodes around are free: in a free box, or else tested.
    q = domain.at(
        np.ldexp(np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1).astype(float), -depth)
    )
    padded = box
    for axis, wraps in enumerate(domain.periodic):
        width = [(int(each == axis),) * 2 for each in range(dim)]
        padded = np.pad(padded, width, "wrap") if wraps else np.pad(padded, width, constant_values=CellState.BLOCKED)
    is_free, may_go = [], np.zeros(shape, bool)
    for offset in half_offsets(dim):
        free, mixed = np.zeros(shape, bool), np.zeros(shape, bool)
        for sides in product(*((0, -1) if step == 0 else ((0,) if step > 0 else (-1,)) for step in offset)):
            beside = padded[tuple(slice(1 + side, 1 + side + n) for side, n in zip(sides, shape, strict=True))]
            free |= beside == CellState.FREE
            mixed |= beside == CellState.MIXED
        tested = np.nonzero(mixed & ~free)
        free[tested] = space.are_free(q[tested], q[tested] + np.array(offset) * np.ldexp(domain.width, -depth))
        is_free.append(free)
        may_go |= free
        ends = tuple((index + step) % size for index, step, size in zip(np.nonzero(free), offset, shape, strict=True))
        may_go[ends] = True

    # 3. What motions cost at nodes from or to which one may go, and at the goal: a factor of their length, and two
    #    vectors of which they cost the larger product.
    def costs_of(q):
        return (np.ones(len(q)), None) if cost_map is None else point_costs(motion, cost_map, q)

    factor, pulls = np.ones(shape), None
    of_free, pulls_of_free = costs_of(q[may_go])
    factor[may_go] = of_free
    if pulls_of_free is not None:
        pulls = np.zeros((2, dim, *shape))
        pulls[:, :, may_go] = np.moveaxis(pulls_of_free, 2, 1)
    factor_there, pulls_there = costs_of(domain.at(goal[None]))

    def straight(change):
        pulls = None if pulls_there is None else np.broadcast_to(pulls_there, (2, *change.shape))
        return factor_there * motion.norm(change) + pulled(pulls, change)

    # 4. The ratio at nodes around the goal from which one goes straight to it, and these motions.
    place, step = np.ldexp(goal, depth), np.ldexp(domain.width, -depth)
    node = np.floor(place).astype(np.int64) + np.array(list(product(range(1 - _NEAR, _NEAR + 1), repeat=dim)))
    node = node[(((node >= 0) & (node < np.array(shape))) | domain.periodic).all(axis=1)]
    to_goal = place - node
    begin, change = domain.lo + step * node, step * to_goal
    free = space.are_free(begin, begin + change)
    node, to_goal, begin, change = node[free] % np.array(shape), to_goal[free], begin[free], change[free]
    factor_here, pulls_here = costs_of(begin)
    here = factor_here * motion.norm(change) + pulled(
        pulls_here, change
    )  # and at the goal, of which the mean is taken
    there = straight(change)
    ratio, way = np.full(shape, np.inf, np.float32), np.zeros((dim, *shape), np.float32)
    ratio[tuple(node.T)] = np.divide(here, there, out=np.ones(len(node)), where=there > 0) / 2 + 0.5
    way[:, *node.T] = to_goal.T
    # 5. Sweep, in units in which nodes are about 1 apart, and motions of length 1 along an axis cost 1 at the mean.
    size = step * motion.scale
    unit, rate = np.exp(np.log(size).mean()), float(np.mean(of_free)) if len(of_free) else 1.0

    def scaled(factor: Any, pulls: Float[np.ndarray, "2 dim *shape"] | None) -> NodeCosts:
        if pulls is not None:
            pulls = pulls / (rate * motion.scale.reshape(-1, *[1] * (pulls.ndim - 2)))
        factor = jnp.asarray(factor / rate, jnp.float32)
        return NodeCosts(factor, None if pulls is None else jnp.asarray(pulls, jnp.float32))

    grid = CostGrid(
        jnp.asarray(size / unit, jnp.float32),
        jnp.asarray(goal * domain.width * motion.scale / unit, jnp.float32),
        scaled(factor_there[0], None if pulls_there is None else pulls_there[:, 0]),
        scaled(factor, pulls),
        jnp.asarray(np.stack(is_free)),
    )
    blocks = tuple(axes for axes, _ in motion.blocks)
    periods = tuple(int(size) if wraps else None for size, wraps in zip(shape, domain.periodic, strict=True))
    found = sweep((jnp.asarray(ratio), jnp.asarray(way)), grid, GridMetric(blocks, periods))
    ratio, way = (np.asarray(each, np.float64) for each in found)
    return GridEstimate(space, depth, goal, straight, ratio, np.moveaxis(way, 0, -1), box)
