"""An estimate of the cost-to-go on a regular grid, interpolated between its nodes.

- If motions cost the same in every direction, scikit-fmm marches over the grid from the goal, to second order. Its
  stencils have no diagonals, so no path passes where two obstacles touch in an edge or a corner.
- If costs depend on the direction, or are the sum of norms of several groups of axes (as for a body that turns),
  shortest paths over edges of several steps are the estimate. They are up to a few percent too long.

Walls are moved to the nearest nodes. Many nodes cost less time than a correction for this would.

References:
    Sethian, "A fast marching level set method for monotonically advancing fronts", 1996.
"""

from dataclasses import dataclass
from itertools import product
from math import gcd, prod
from typing import Any, cast

import numpy as np
import skfmm
from jaxtyping import Bool, Float, Int8
from scipy import ndimage
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from plr_jax.geometry.box import Box
from plr_jax.oracles import GridField
from plr_jax.spaces import (
    CellState,
    ConfigurationSpace,
    CostMap,
    DirectionalCost,
    PlaneSpace,
    RasterCost,
    VoxelSpace,
    point_costs,
    pulled,
)

MOST_AXES = 3
# Default number of nodes, by the number of axes: at the centers of given cells; elsewhere, where nodes take longer to
# classify; and for shortest paths over a stencil.
_CELL_NODES, _NODES = {1: 4_000, 2: 160_000, 3: 1_000_000}, {1: 4_000, 2: 160_000, 3: 200_000}
_STENCIL_NODES = {1: 4_000, 2: 40_000, 3: 200_000}
# Least number of nodes for each leaf; and most nodes of a grid, each of which takes about 200 bytes of memory.
_NODES_A_LEAF, _MOST_NODES = 16, 1 << 24
_ROUND = 1e-9  # relative rounding error of a number of steps
_REACH = {1: 1, 2: 3, 3: 2}  # steps of stencil edges along an axis, by the number of axes that share a norm
_BLOCK = 8  # cells along each axis of the blocks that are classified first
_CLEAR = 1e-3  # half width, in steps, of the free box around an open node
# Radius of the first front in shortest steps, by the number of axes. It is smaller if costs within differ from the
# cost at the goal by more than the factor `_NEARLY`.
_RADIUS, _NEARLY = {1: 100.0, 2: 32.0, 3: 12.0}, 1.1

Points = Float[np.ndarray, "n dim"]
Shape = tuple[int, ...]
CellStates = Int8[np.ndarray, "*shape"]
IsOpen = Bool[np.ndarray, "*shape"]
Nodes = Float[np.ndarray, "*shape dim"]
Costs = Float[np.ndarray, "*shape"]
Sides = Float[np.ndarray, "dim"]


@dataclass(frozen=True, eq=False)
class GridEstimate:
    """The cost-to-go at the nodes of a grid, interpolated between them.

    Attributes:
        at_goal: Factor of the norm and pulls (see :class:`CellCosts`) of the cost of motions at the goal; pulls may
            be None.
        ratio: The cost-to-go, divided by the cost of the straight motion to the goal if all motions cost as at the
            goal.
        cost: The cost-to-go at each node; ``inf`` where no path leads to the goal.
    """

    space: ConfigurationSpace
    goal: Float[np.ndarray, "dim"]
    at_goal: tuple[float, Float[np.ndarray, "2 1 dim"] | None]
    ratio: GridField
    cost: Costs

    def __call__(self, x: Points) -> Float[np.ndarray, "n"]:
        """Return the estimate at points of the domain; ``inf`` if no adjacent node reaches the goal."""
        ratio, is_open = self.ratio.interpolated(x)
        beside = np.flatnonzero(~is_open & np.isfinite(ratio))
        ratio[beside[~self.space.is_free(x[beside])]] = np.inf
        change = self.space.domain.difference(np.broadcast_to(self.goal, x.shape), x)
        return ratio * straight_costs(self.space, self.at_goal, change)

    @property
    def largest(self) -> float:
        """The largest finite cost at a node; ``-inf`` if no node reaches the goal."""
        return float(self.cost.max(where=np.isfinite(self.cost), initial=-np.inf))


def straight_costs(
    space: ConfigurationSpace, at: tuple[float, Float[np.ndarray, "2 1 dim"] | None], change: Points
) -> Float[np.ndarray, "n"]:
    """Return the costs of straight motions, given the factor of their norm and the pulls at one configuration."""
    factor, pulls = at
    return factor * space.motion_cost.norm(change) + pulled(
        None if pulls is None else np.broadcast_to(pulls, (2, *change.shape)), change
    )


def grid_estimate(
    space: ConfigurationSpace, cost_map: CostMap | None, goal: Float[np.ndarray, "dim"], num_leaves: int = 0
) -> GridEstimate:
    """Estimate the cost-to-go on a grid of some 160,000 nodes in the plane, 200,000 to a million in space.

    Nodes are the centers of voxels, or of the cells of a :class:`RasterCost` that fills the domain. If these are few,
    each cell is divided into an odd number of parts along each axis. For ``num_leaves`` leaves there are at least 16
    nodes each, up to rounding.
    """
    domain, motion, dim = space.domain, space.motion_cost, space.domain.dim
    is_isotropic = len(motion.blocks) == 1 and not isinstance(cost_map, DirectionalCost)
    box, shape = _grid(space, cost_map, is_isotropic, num_leaves * _NODES_A_LEAF)
    side = box.width / shape
    node = box.at((np.moveaxis(np.indices(shape), 0, -1) + 0.5) / shape)
    cells, is_open = _open_nodes(space, box, shape)

    # 1. The costs of motions at open nodes and at the goal.
    factor, pulls = np.ones(shape), None
    at_goal: tuple[float, Any] = (1.0, None)
    if cost_map is not None:
        factor[is_open], pulls_of_open = point_costs(motion, cost_map, node[is_open])
        factor_there, pulls_there = point_costs(motion, cost_map, goal[None])
        at_goal = float(factor_there[0]), pulls_there
        if pulls_of_open is not None:
            pulls = np.zeros((2, *shape, dim))
            pulls[:, is_open] = pulls_of_open

    # 2. The cost of straight motions from open nodes near the goal; inf if the motion is not free.
    to_goal = domain.difference(np.broadcast_to(goal, (prod(shape), dim)), node.reshape(-1, dim))
    lengths = np.linalg.norm(to_goal, axis=1).reshape(shape)
    radius = _RADIUS[dim] * float(side.min())
    near = np.argwhere(is_open & (lengths < radius + 2 * np.linalg.norm(side)))
    change = to_goal.reshape(*shape, dim)[tuple(near.T)]
    sees = space.are_free(node[tuple(near.T)], node[tuple(near.T)] + change)
    near, change = tuple(near[sees].T), change[sees]
    straight = np.full(shape, np.inf)
    here = factor[near], None if pulls is None else pulls[(slice(None), *near)]
    straight[near] = here[0] * motion.norm(change) + pulled(here[1], change)
    straight[near] = (straight[near] + straight_costs(space, at_goal, change)) / 2

    # 3. The cost-to-go of all nodes.
    if is_isotropic:
        _close_beside_walls(space, cells, is_open, node, side)
        if isinstance(space, PlaneSpace) and space.workspace.squeeze and space.robot.circumscribed_radius == 0:
            # Paths may pass where obstacles touch, so the four nodes around a contact are open.
            boundary = space.workspace.boundary
            place = (boundary.vertices[boundary.contacts] - box.lo) / side - 0.5
            for corner in product((0, 1), repeat=2):
                is_open[tuple(np.clip(np.floor(place).astype(np.int64) + corner, 0, np.array(shape) - 1).T)] = True
        cost = _marched(space, is_open, factor, at_goal[0], straight, lengths, radius, side)
        if cost_map is None:
            cost = np.minimum(cost, straight)
    else:
        cost = _over_stencil(space, cells, is_open, node, (factor, pulls), straight, side)
    of_straight = straight_costs(space, at_goal, to_goal).reshape(shape)
    ratio = np.divide(cost, of_straight, out=np.ones(shape), where=of_straight > 0)
    return GridEstimate(space, goal, at_goal, GridField(ratio.T, box), cost)


def _grid(
    space: ConfigurationSpace, cost_map: CostMap | None, is_isotropic: bool, num_nodes: int
) -> tuple[Box, Shape]:
    """Return a box and its number of cells along each axis; the cell centers are the nodes of the grid.

    There are about ``num_nodes``, but not fewer than the default for this dimension. Without a raster, the first and
    the last nodes lie on the domain's faces, and steps are round decimals if these fit: walls often have round
    coordinates.
    """
    domain = space.domain
    # 1. The centers of given cells, unless these are too many.
    cells = None
    if isinstance(space, VoxelSpace):
        cells = np.array(space.free.shape)
    elif isinstance(cost_map, RasterCost) and cost_map.dim == domain.dim:
        sides = cost_map.domain.width / cost_map.values.shape[::-1]
        num_nodes = max(num_nodes, int(min(np.prod(domain.width / sides), _MOST_NODES)))
        cells = np.array(cost_map.values.shape[::-1]) if cost_map.domain == domain else None
    usual = _STENCIL_NODES if not is_isotropic else _NODES if cells is None else _CELL_NODES
    num_nodes = max(num_nodes, usual[domain.dim])
    if cells is not None and cells.prod() <= _MOST_NODES:
        refinement = 1 + 2 * round(max((num_nodes / cells.prod()) ** (1 / domain.dim) - 1, 0) / 2)
        return domain, tuple((cells * refinement).tolist())
    # 2. Equal steps, a round decimal if that fits.
    width = domain.width * space.motion_cost.scale
    step = (width.prod() / (num_nodes if cells is None else _MOST_NODES)) ** (1 / domain.dim)
    decimal = 10.0 ** np.floor(np.log10(step)) * np.array([1.0, 2.0, 2.5, 5.0, 10.0])
    counts = width[:, None] / decimal
    fits = np.isclose(counts, np.rint(counts), rtol=_ROUND, atol=0).all(axis=0) & (counts >= 1).all(axis=0)
    if fits.any():
        step = decimal[fits][np.argmin(np.abs(np.log(decimal[fits] / step)))]
    steps = np.maximum(np.rint(width / step), 4)
    half = domain.width / steps / 2
    box = Box(domain.lo - half, domain.hi + np.where(domain.periodic, -half, half), domain.periodic)
    return box, tuple((steps + ~np.array(domain.periodic)).astype(int).tolist())


def _open_nodes(space: ConfigurationSpace, box: Box, shape: Shape) -> tuple[CellStates, IsOpen]:
    """Return the state of each cell of a grid, and whether paths may pass through the node at its center."""
    domain = space.domain

    def classified(lo, hi):
        ends = (box.at(end / np.array(shape)) for end in (lo, hi))
        return space.classify(*(np.where(domain.periodic, end, np.clip(end, domain.lo, domain.hi)) for end in ends))

    # 1. Classify blocks of cells, then the cells of mixed blocks.
    blocks = np.moveaxis(np.indices([-(-n // _BLOCK) for n in shape]), 0, -1)
    lo, hi = (np.minimum((blocks.reshape(-1, len(shape)) + end) * _BLOCK, shape) for end in (0, 1))
    state = classified(lo, hi).reshape(blocks.shape[:-1])
    for axis, n in enumerate(shape):
        state = np.take(state, np.arange(n) // _BLOCK, axis=axis)
    mixed = np.argwhere(state == CellState.MIXED)
    state[tuple(mixed.T)] = classified(mixed, mixed + 1)
    is_open = state == CellState.FREE
    # 2. In a mixed cell the node is open if a small box around it is free.
    mixed = np.argwhere(state == CellState.MIXED)
    is_open[tuple(mixed.T)] = classified(mixed + 0.5 - _CLEAR, mixed + 0.5 + _CLEAR) == CellState.FREE
    # 3. A node on a wall is open if all free corners of that box reach one another. At a contact they do not.
    wall = mixed[~is_open[tuple(mixed.T)]]
    corners = np.array(list(product((-1, 1), repeat=len(shape))))
    q = box.at((wall[:, None] + 0.5 + _CLEAR * corners) / shape)
    is_free = space.is_free(q.reshape(-1, len(shape))).reshape(q.shape[:2])
    joined = np.repeat(np.eye(len(corners), dtype=bool)[None], len(wall), axis=0)
    for i, j in np.argwhere(np.abs(corners[:, None] - corners).sum(axis=2) == 2):
        joined[:, i, j] = space.are_free(q[:, i], q[:, j])
    for _ in range(len(shape)):
        joined = joined @ joined
    is_whole = (joined | ~is_free[:, :, None] | ~is_free[:, None]).all(axis=(1, 2))
    is_open[tuple(wall.T)] = is_whole & is_free.any(axis=1)
    return state, is_open


def _close_beside_walls(
    space: ConfigurationSpace, cells: CellStates, is_open: IsOpen, node: Nodes, side: Sides
) -> None:
    """Close one of each two neighbor nodes with a wall between them: the node nearer to the wall."""
    closed = np.zeros_like(is_open)
    for axis, wraps in enumerate(space.domain.periodic):
        other = np.roll(is_open, -1, axis)
        mixed = is_open & other & ~((cells == CellState.FREE) & (np.roll(cells, -1, axis) == CellState.FREE))
        if not wraps:
            mixed[(slice(None),) * axis + (-1,)] = False
        begin = np.argwhere(mixed)
        end, step = begin.copy(), np.zeros(len(side))
        end[:, axis] = (end[:, axis] + 1) % is_open.shape[axis]
        step[axis] = side[axis]
        q = node[tuple(begin.T)]
        walled = ~space.are_free(q, q + step)
        begin, end, q = begin[walled], end[walled], q[walled]
        is_far = space.are_free(q, q + step / 2)
        closed[tuple(np.where(is_far[:, None], end, begin).T)] = True
    is_open &= ~closed


def _marched(
    space: ConfigurationSpace,
    is_open: IsOpen,
    factor: Costs,
    at_goal: float,
    straight: Costs,
    lengths: Costs,
    radius: float,
    side: Sides,
) -> Costs:
    """Return the costs of nodes by marching from a ball around the goal, in which paths are straight."""
    # 1. Choose the ball: all its nodes see the goal, and cost about as much as the goal, except the cheapest node.
    weight = space.motion_cost.blocks[0][1]
    rate = weight * at_goal
    differs = (factor > _NEARLY * at_goal) | (_NEARLY * factor < at_goal)
    stops = is_open & (np.isinf(straight) | differs)
    begin = rate * min(radius, lengths[stops].min(initial=np.inf))
    begin = max(begin, straight.min() + rate * float(side.min()) / 2)
    is_inside = (straight < begin) & (~differs | (straight == straight.min()))
    cost = np.where(is_inside, straight, np.inf)
    if not is_inside.any() or (is_inside == is_open).all():
        return cost
    # 2. March from its surface. A jump of costs must not bring a node beyond it nearer to the front.
    phi = lengths - begin / (weight * (factor + at_goal) / 2)
    phi[differs] = np.maximum(phi, lengths - begin / rate)[differs]
    phi[np.isinf(straight)] = np.maximum(lengths, side.max())[np.isinf(straight)]
    phi = np.where(is_inside, phi, np.maximum(phi, 1e-9 * side.min()))
    periodic = cast(Any, list(space.domain.periodic))
    beyond = skfmm.travel_time(
        np.ma.MaskedArray(phi, ~is_open),
        1 / (weight * factor),
        dx=side.tolist(),
        order=2,
        periodic=periodic,
    )
    reached = ~np.ma.getmaskarray(beyond) & ~is_inside
    cost[reached] = beyond[reached] + begin
    return cost


def _over_stencil(
    space: ConfigurationSpace,
    cells: CellStates,
    is_open: IsOpen,
    node: Nodes,
    costs: tuple[Costs, Any],
    straight: Costs,
    side: Sides,
) -> Costs:
    """Return costs of shortest paths to the goal over edges of a few steps along axes that share a norm."""
    domain, motion, shape, num = space.domain, space.motion_cost, is_open.shape, is_open.size
    factor, pulls = costs
    # Edges from nodes whose whole stencil is free need no test.
    mode = ["wrap" if wraps else "nearest" for wraps in domain.periodic]
    far = [max(_REACH[len(axes)] for axes, _ in motion.blocks)] * len(shape)
    is_clear: Any = cells == CellState.FREE
    for axis, reach in enumerate(far):
        is_clear = ndimage.minimum_filter1d(is_clear, 2 * reach + 1, axis, mode=mode[axis])
    number, begin, end, cost = np.arange(num).reshape(shape), [], [], []
    for axes, _ in motion.blocks:
        reach = _REACH[len(axes)]
        for offset in product(range(-reach, reach + 1), repeat=len(axes)):
            if offset <= (0,) * len(axes) or gcd(*offset) > 1:
                continue
            step = np.zeros(len(shape), np.int64)
            step[list(axes)] = offset
            a = np.argwhere(is_open)
            b = a + step
            inside = (((b >= 0) & (b < shape)) | np.array(domain.periodic)).all(axis=1)
            a, b = a[inside], b[inside] % shape
            both = is_open[tuple(b.T)]
            a, b = tuple(a[both].T), tuple(b[both].T)
            change = np.broadcast_to(step * side, (len(a[0]), len(shape)))
            tested = np.flatnonzero(~is_clear[a])
            is_free = np.ones(len(a[0]), bool)
            q = node[a][tested]
            is_free[tested] = space.are_free(q, q + change[tested])
            a, b, change = (tuple(each[is_free] for each in a), tuple(each[is_free] for each in b), change[is_free])
            for tail, head, way in ((a, b, change), (b, a, -change)):
                mean = None if pulls is None else (pulls[(slice(None), *tail)] + pulls[(slice(None), *head)]) / 2
                begin.append(number[tail])
                end.append(number[head])
                cost.append((factor[tail] + factor[head]) / 2 * motion.norm(way) + pulled(mean, way))
    near = np.flatnonzero(np.isfinite(straight).ravel())
    begin, end = np.concatenate([*begin, near]), np.concatenate([*end, np.full(len(near), num)])
    weight = np.maximum(np.concatenate([*cost, straight.ravel()[near]]), np.finfo(float).tiny)
    graph = csr_array((weight, (end, begin)), shape=(num + 1, num + 1))
    return dijkstra(graph, indices=num)[:num].reshape(shape)
