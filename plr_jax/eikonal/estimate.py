"""An estimate of the cost-to-go on a regular grid, interpolated between its nodes.

If motions cost the same in every direction, fast marching computes the estimate (``march.py``). Otherwise, the
estimate is the cost of shortest paths along edges between nodes: if costs depend on the direction, or are sums of
norms of several groups of axes, as for a body that turns. Edges are up to three grid steps long along an axis, so
these costs are up to a few percent too high. Walls are moved to the nearest nodes.
"""

from dataclasses import dataclass
from functools import cached_property, reduce
from itertools import count, product
from math import gcd
from typing import Any

import numpy as np
from jaxtyping import Float, Int, Int8
from scipy import ndimage

from plr_jax._types import Points, Reach
from plr_jax.eikonal.goals import Costs, GoalIndex, Goals, Sides, carried_goals, nearest_goals, rolled, shortest_paths
from plr_jax.eikonal.march import IsOpen, VoxelGroups, extrapolated, has_coarse_grid, marched, start_of_march
from plr_jax.geometry.box import Box
from plr_jax.geometry.voxels import reach_of_cells
from plr_jax.oracles import GridField
from plr_jax.spaces import CellState, ConfigurationSpace, PlaneSpace, RasterCost, VoxelSpace
from plr_jax.spaces._costs import CostMap, DirectionalCost, motion_costs, point_costs, pulled
from plr_jax.spaces._raster_cost import nearest_cells

MOST_AXES = 3
# Default numbers of nodes by the number of axes.
_CELL_NODES = {1: 4_000, 2: 160_000, 3: 1_000_000}  # at centers of given cells
_NODES = {1: 4_000, 2: 160_000, 3: 200_000}  # elsewhere
_STENCIL_NODES = {1: 4_000, 2: 40_000, 3: 200_000}  # for paths over a stencil
_NODES_A_LEAF = 16  # least number of nodes for each leaf
_MOST_NODES = 1 << 24  # of a grid; each node takes about 200 bytes of memory and 3 microseconds
_MOST_STENCIL_NODES = 1 << 21  # of a grid for paths over a stencil
_MOST_GROUPS = 1 << 22  # of voxels, which lose little beside walls
_ROUND = 1e-9  # relative rounding error of a number of steps
_REACH = {1: 1, 2: 3, 3: 2}  # steps of stencil edges along an axis, by the number of axes that share a norm
_BLOCK = 8  # cells along each axis of the blocks that are classified first
_CLEAR = 1e-3  # half width, in steps, of the free box around an open node
_RADIUS = {1: 100.0, 2: 32.0, 3: 12.0}  # of balls around goals, in shortest steps, by the number of axes
_NEAR_GOALS = 4  # most goals to which each node has a straight motion
CellStates = Int8[np.ndarray, "*shape"]
Nodes = Float[np.ndarray, "*shape dim"]
# Costs of motions at points: a factor of the norm, and perhaps two vectors: the larger scalar product is added.
Rates = tuple[Float[np.ndarray, " places"], Float[np.ndarray, "2 places dim"] | None]


@dataclass(frozen=True, eq=False)
class GridEstimate:
    """An estimate of the cost to the nearest of several goals, interpolated between the nodes of a regular grid."""

    space: ConfigurationSpace
    goals: Goals
    at_goals: Rates  # the cost of motions at the goals
    ratio: GridField  # the cost-to-go divided by a function with the same kinks at the goals: see `_divisors`
    cost: Costs  # the cost-to-go at each node; inf where no path leads to a goal
    known_goal: GoalIndex  # the goal to which the path of each node leads, -1 where unknown
    unseen: Int[np.ndarray, " unseen"]  # indices of the goals that no node sees
    is_open: IsOpen  # nodes that paths may pass
    closed_cost: Costs | None = None  # the cost-to-go beside each closed node, if nodes are groups of voxels

    def __call__(self, x: Points) -> Float[np.ndarray, " n"]:
        # 1. Interpolate the ratio, which has no kink at goals.
        ratio, is_open = self.ratio.interpolated(x)
        divisor = _divisors(self.space, self.goals, self.at_goals, x)
        cost = np.multiply(ratio, divisor, out=np.zeros(len(x)), where=divisor != 0)  # not inf * 0 at a goal
        # 2. Points whose node is closed: a group of voxels knows the cost beside its node. Other points keep the cost
        #    of nodes around them if they are free.
        if self.closed_cost is not None:
            closed = np.flatnonzero(~is_open)
            closed_cost = self.closed_cost[self._nodes(x[closed])]
            cost[closed] = np.where(np.isfinite(closed_cost), closed_cost, cost[closed])
        beside = np.flatnonzero(~is_open & np.isfinite(cost))
        cost[beside[~self.space.is_free(x[beside])]] = np.inf
        return cost

    def _nodes(self, x: Points) -> tuple[Int[np.ndarray, " n"], ...]:
        # The indices, along each axis, of the grid cell (and so the node) of each point.
        box, shape = self.ratio.bounds, np.array(self.cost.shape)
        place = ((box.wrapped(x) - box.lo) / box.width * shape).astype(np.intp)
        return tuple(np.clip(place, 0, shape - 1).T)

    def reach(self, domain: Box) -> Reach:
        """Return tests whether a box within ``domain`` holds nodes with a path to a goal, and open nodes without one.

        A node is open if paths may pass it. A node next to a node with a path counts as a node with a path.
        """
        is_reached = np.isfinite(self.cost if self.closed_cost is None else np.minimum(self.cost, self.closed_cost))
        # Points beside a node that reaches a goal may have a value.
        mode: Any = ["wrap" if wraps else "nearest" for wraps in self.space.domain.periodic]
        beside: Any = ndimage.maximum_filter(is_reached, 3, mode=mode)
        return reach_of_cells(beside, self.is_open & ~beside, self.ratio.bounds, domain)

    def which(self, x: Points) -> Int[np.ndarray, " n"]:
        """Return the index of the goal to which each point's shortest path leads.

        A point without a path gets the goal of the nearest node that has a path.
        """
        goal = self.node_goal[self._nodes(x)]
        # Less than a grid step from the nearest goal, that goal counts if the straight motion there is free.
        distance, nearest = nearest_goals(self.goals, self.space.domain, self.space.motion_cost, x)
        step = float(np.linalg.norm(self.space.motion_cost.scale * self.ratio.bounds.width / self.cost.shape))
        close = np.flatnonzero(distance[:, 0] < step)
        target = self.goals[nearest[close, 0]]
        close = close[self.space.are_free(x[close], x[close] + self.space.domain.difference(target, x[close]))]
        goal[close] = nearest[close, 0]
        return goal

    def which_reached(self, x: Points) -> Int[np.ndarray, " n"]:
        """Return the indices that :meth:`which` returns, but -1 at points where the estimate is ``inf``."""
        return np.where(np.isfinite(self(x)), self.which(x), -1)

    @cached_property
    def node_goal(self) -> GoalIndex:
        # Nodes without a path get the goal of the nearest node that has a path.
        side = self.ratio.bounds.width / self.cost.shape
        goal = carried_goals(self.cost, self.known_goal, side, self.space.domain.periodic, len(self.goals))
        if (goal < 0).all():
            return np.zeros_like(goal)
        return goal[nearest_cells(goal >= 0, side)]


def _straight_costs(space: ConfigurationSpace, rates: Rates, index: Int[np.ndarray, " n"], change: Points) -> Costs:
    factor, pulls = rates
    return factor[index] * space.motion_cost.norm(change) + pulled(None if pulls is None else pulls[:, index], change)


def _divisors(space: ConfigurationSpace, goals: Goals, at_goals: Rates, x: Points) -> Float[np.ndarray, " n"]:
    # The cost-to-go has a kink at each goal. Its quotient by the straight cost to the nearest goal has none.
    if _is_euclidean(space, goals, at_goals):
        return nearest_goals(goals, space.domain, space.motion_cost, x)[0][:, 0]
    motions = ((np.full(len(x), k), space.domain.difference(goal, x)) for k, goal in enumerate(goals))
    return reduce(np.minimum, (_straight_costs(space, at_goals, index, change) for index, change in motions))


def _is_euclidean(space: ConfigurationSpace, goals: Goals, at_goals: Rates) -> bool:
    # Whether the divisor is the distance to the nearest of several goals, without the factor of the cost at the goal:
    # this takes less time than costs.
    return len(goals) > 1 and len(space.motion_cost.blocks) == 1 and at_goals[1] is None


def grid_estimate(
    space: ConfigurationSpace, cost_map: CostMap | None, goals: Goals, num_leaves: int = 0
) -> GridEstimate:  # goals must differ
    """Estimate the cost-to-go on a regular grid that is fine enough to fit a PLR of ``num_leaves`` leaves.

    The grid has at least 16 nodes per leaf, unless this exceeds the largest allowed number of nodes.
    """
    # 1. The nodes: centers of grid cells, or of voxels that stand for groups of voxels.
    domain, motion_cost, dim = space.domain, space.motion_cost, space.domain.dim
    is_isotropic = len(motion_cost.blocks) == 1 and not isinstance(cost_map, DirectionalCost)
    box, shape = _grid(space, cost_map, is_isotropic, num_leaves * _NODES_A_LEAF)
    side = box.width / shape
    groups = closed_cost = None
    if is_isotropic and isinstance(space, VoxelSpace) and space.radius == 0 and shape < space.free.shape:
        groups = VoxelGroups.of(space.free, domain, box, shape, goals)
        node, is_open, is_clear = groups.middles, groups.is_open, groups.has_part
        cells = np.zeros(shape, np.int8)  # BLOCKED; groups need no states of cells
    else:
        node = box.at((np.moveaxis(np.indices(shape), 0, -1) + 0.5) / shape)
        cells, is_open, is_clear = _open_nodes(space, box, shape)

    # 2. The costs of motions at free nodes and at the goals.
    factor, pulls = np.ones(shape), None
    is_free = is_open if groups is None else groups.has_part
    factor[is_free], pulls_of_free = point_costs(motion_cost, cost_map, node[is_free])
    at_goals = point_costs(motion_cost, cost_map, goals)
    if pulls_of_free is not None:
        pulls = np.zeros((2, *shape, dim))
        pulls[:, is_free] = pulls_of_free

    # 3. The cost of straight motions from open nodes to goals near them; inf if no motion is free. First all nodes
    #    look at their nearest goal (rank 0), then at the next ones.
    flat = node.reshape(-1, dim)
    at_nodes = factor.ravel(), None if pulls is None else pulls.reshape(2, -1, dim)
    distance, nearest = nearest_goals(goals, domain, motion_cost, flat, min(len(goals), _NEAR_GOALS))
    radius = _RADIUS[dim] * float(side.min()) / len(goals) ** (0.5 / dim)  # less, the more goals there are
    sight = radius + 2 * np.linalg.norm(side)  # largest length of such motions
    straight, known_goal = np.full(shape, np.inf), np.full(shape, -1)
    sees_nearest, is_seen = np.zeros(shape, bool), np.zeros(len(goals), bool)

    def in_sight(rows: Int[np.ndarray, " n"], goal: Any) -> tuple[Int[np.ndarray, " m"], Float[np.ndarray, "m dim"]]:
        # Of the nodes in `rows`, those from which the straight motion to a goal is short and free, and this motion.
        change = domain.difference(goals[goal], flat[rows])
        is_near = np.linalg.norm(change, axis=1) < sight
        rows, change = rows[is_near], change[is_near]
        sees = space.are_free(flat[rows], flat[rows] + change)
        return rows[sees], change[sees]

    for rank, goal_of_node in enumerate(nearest.T):
        rows = np.flatnonzero(is_open.ravel() & (distance[:, rank] <= motion_cost.scale.max() * sight))
        near, change = in_sight(rows, goal_of_node[rows])
        goal = goal_of_node[near]
        is_seen[goal] = True
        # The rate of costs is the mean of the rates at both ends, with a cost map also at the middle (Simpson's
        # rule).
        costs = _straight_costs(space, at_nodes, near, change) + _straight_costs(space, at_goals, goal, change)
        costs = costs / 2
        if cost_map is not None:
            costs = (costs + 2 * motion_costs(motion_cost, cost_map, flat[near] + change / 2, change)) / 3
        is_better = costs < straight.ravel()[near]
        straight.ravel()[near[is_better]] = costs[is_better]
        known_goal.ravel()[near[is_better]] = goal[is_better]
        if rank == 0:
            sees_nearest.ravel()[near] = True
    for goal in np.flatnonzero(~is_seen):  # other goals may be nearer to all nodes
        is_seen[goal] = len(in_sight(np.flatnonzero(is_open), goal)[0]) > 0

    # 4. The cost-to-go of all nodes, by marching from balls around goals, or by paths over a stencil.
    at_nearest = at_goals[0][nearest[:, 0]].reshape(shape)
    if is_isotropic:
        walled = np.zeros(shape, bool) if groups is not None else _walled_nodes(space, cells, is_open, node, side)
        is_open &= ~walled
        if isinstance(space, PlaneSpace) and space.workspace.squeeze and space.robot.circumscribed_radius == 0:
            # Paths may pass where obstacles touch, so the four nodes around a contact are open.
            boundary = space.workspace.boundary
            place = (boundary.vertices[boundary.contacts] - box.lo) / side - 0.5
            for corner in product((0, 1), repeat=2):
                is_open[tuple(np.clip(np.floor(place).astype(np.int64) + corner, 0, np.array(shape) - 1).T)] = True
        slowness = motion_cost.blocks[0][1] * factor
        at_goal = motion_cost.blocks[0][1] * at_nearest
        lengths = np.linalg.norm(domain.difference(goals[nearest[:, 0]], flat), axis=1).reshape(shape)
        is_in_sight = sees_nearest & (lengths < radius)
        start, level = start_of_march(is_open, slowness, side, straight, known_goal, at_goal, lengths, is_in_sight)
        cost = marched(is_open, slowness, start, level, side, domain.periodic)
        if cost_map is None:
            cost = np.minimum(cost, straight)
        known_goal = np.where(cost == straight, known_goal, -1)
        # A coarse grid would miss thin walls: those between two nodes, and those inside of a group of voxels.
        if not (domain.is_periodic or groups or walled.any()) and has_coarse_grid(is_open, is_clear, factor):
            is_beyond = is_open & (~sees_nearest | (lengths >= 2 * radius))
            cost = extrapolated(cost, is_open, slowness, float(cost[is_beyond].min(initial=np.inf)), side)
        if groups is not None:
            cost, closed_cost = groups.completed(cost, slowness)
    else:
        edges = _stencil_edges(space, cells, is_open, flat, at_nodes, side)
        paths = shortest_paths(edges, straight.ravel(), known_goal.ravel())
        cost, known_goal = (of_node.reshape(shape) for of_node in paths)

    # 5. The ratio of costs to their divisor. At a goal, where both are 0, it is the limit: the factor of the cost
    #    there, or 1 if the divisor has this factor.
    divisor = _divisors(space, goals, at_goals, flat).reshape(shape)
    limit = at_nearest.copy() if _is_euclidean(space, goals, at_goals) else np.ones(shape)
    ratio = GridField(np.divide(cost, divisor, out=limit, where=divisor > 0).T, box)
    unseen = np.flatnonzero(~is_seen)
    return GridEstimate(space, goals, at_goals, ratio, cost, known_goal, unseen, is_open, closed_cost)


def _grid(
    space: ConfigurationSpace, cost_map: CostMap | None, is_isotropic: bool, num_nodes: int
) -> tuple[Box, tuple[int, ...]]:
    """Choose a regular grid of about ``num_nodes`` nodes or more; return its box and its number of cells per axis.

    Nodes are the centers of grid cells. The grid follows the voxels of the space, or else the cells of a raster of
    costs: each voxel or raster cell is divided into an odd number of grid cells along each axis. If there are too
    many voxels or raster cells, each grid cell instead joins an odd number of them along each axis. ``is_isotropic``
    says whether motions cost the same in every direction.

    If there are neither voxels nor raster cells to follow, the outermost nodes lie on the faces of the domain. The
    grid step is then a round decimal if that fits, since walls often have round coordinates. A raster is not followed
    if it has another domain than the space, or if its costs are interpolated in the plane.
    """
    domain = space.domain
    most = _MOST_NODES if is_isotropic else _MOST_STENCIL_NODES
    # 1. The number of given cells along each axis, if nodes are at centers of cells, and the number of nodes.
    cells = None
    if isinstance(space, VoxelSpace):
        cells = np.array(space.free.shape)
        most = min(most, _MOST_GROUPS) if space.radius == 0 else most
    elif isinstance(cost_map, RasterCost) and cost_map.dim == domain.dim:
        sides = cost_map.domain.width / cost_map.values.shape[::-1]
        num_nodes = max(num_nodes, int(min(np.prod(domain.width / sides), most)))
        # Walls in the plane often lie on nodes of round steps, which interpolated costs allow.
        is_smooth = isinstance(space, PlaneSpace) and cost_map.interpolation == "bilinear"
        cells = np.array(cost_map.values.shape[::-1]) if cost_map.domain == domain and not is_smooth else None
    usual = _STENCIL_NODES if not is_isotropic else _NODES if cells is None else _CELL_NODES
    num_nodes = min(max(num_nodes, usual[domain.dim]), most)
    # 2. The centers of given cells, of their parts, or of groups of `size` cells along each axis.
    if cells is not None:
        size = next(size for size in count(1, 2) if np.prod(-(-cells // size), dtype=float) <= most)
        shape = -(-cells // size)
        if size == 1:
            shape *= 1 + 2 * round(max((num_nodes / cells.prod()) ** (1 / domain.dim) - 1, 0) / 2)
            return domain, tuple(shape.tolist())
        # Outer groups may extend beyond the domain, but their centers do not.
        side = domain.width / cells
        lo = domain.lo - (shape * size - cells) // 2 * side
        return Box(lo, lo + shape * size * side), tuple(shape.tolist())
    # 3. Else equal steps, a round decimal if that fits.
    width = domain.width * space.motion_cost.scale
    step = (width.prod() / num_nodes) ** (1 / domain.dim)
    decimal = 10.0 ** np.floor(np.log10(step)) * np.array([1.0, 2.0, 2.5, 5.0, 10.0])
    counts = width[:, None] / decimal
    fits = np.isclose(counts, np.rint(counts), rtol=_ROUND, atol=0).all(axis=0) & (counts >= 1).all(axis=0)
    fits &= (counts + 1).prod(axis=0) <= most
    if fits.any():
        step = decimal[fits][np.argmin(np.abs(np.log(decimal[fits] / step)))]
    steps = np.maximum(np.rint(width / step), 4)
    half = domain.width / steps / 2
    box = Box(domain.lo - half, domain.hi + np.where(domain.periodic, -half, half), domain.periodic)
    return box, tuple((steps + ~np.array(domain.periodic)).astype(int).tolist())


def _open_nodes(space: ConfigurationSpace, box: Box, shape: tuple[int, ...]) -> tuple[CellStates, IsOpen, IsOpen]:
    """Return, for each grid cell, its :class:`CellState`, whether its node is open, and whether its node is clear.

    The node is the center of the cell. A node is *open* if paths on the grid may pass it, and *clear* if it is open
    and lies on no wall.
    """
    domain = space.domain

    def classified(lo, hi):
        ends = (box.at(end / np.array(shape)) for end in (lo, hi))
        return space.classify(*(np.where(domain.periodic, end, np.clip(end, domain.lo, domain.hi)) for end in ends))

    # 1. Classify blocks of cells, and give their states to their cells. Then classify the cells of mixed blocks.
    blocks = np.moveaxis(np.indices([-(-n // _BLOCK) for n in shape]), 0, -1)
    lo, hi = (np.minimum((blocks.reshape(-1, len(shape)) + end) * _BLOCK, shape) for end in (0, 1))
    state = classified(lo, hi).reshape(blocks.shape[:-1])
    state = state[np.ix_(*(np.arange(n) // _BLOCK for n in shape))]
    mixed = np.argwhere(state == CellState.MIXED)
    state[tuple(mixed.T)] = classified(mixed, mixed + 1)
    is_open = state == CellState.FREE
    # 2. In a mixed cell the node is open if a small box around it is free.
    mixed = np.argwhere(state == CellState.MIXED)
    is_open[tuple(mixed.T)] = classified(mixed + 0.5 - _CLEAR, mixed + 0.5 + _CLEAR) == CellState.FREE
    is_clear = is_open.copy()
    # 3. A node on a wall is open if all free corners of that box reach one another along its sides. At a contact they
    #    do not. `joined[k, i, j]` says whether such a path leads from corner i to corner j of box k.
    wall = mixed[~is_open[tuple(mixed.T)]]
    corners = np.array(list(product((-1, 1), repeat=len(shape))))
    q = box.at((wall[:, None] + 0.5 + _CLEAR * corners) / shape)
    is_free = space.is_free(q.reshape(-1, len(shape))).reshape(q.shape[:2])
    near = is_free.any(axis=1)
    wall, q, is_free = wall[near], q[near], is_free[near]
    joined = np.repeat(np.eye(len(corners), dtype=bool)[None], len(wall), axis=0)
    for i, j in np.argwhere(np.triu(np.abs(corners[:, None] - corners).sum(axis=2) == 2)):
        joined[:, i, j] = joined[:, j, i] = space.are_free(q[:, i], q[:, j])
    joined = np.linalg.matrix_power(joined, 2 ** len(shape))  # by paths along that many sides of the box
    is_open[tuple(wall.T)] = (joined | ~is_free[:, :, None] | ~is_free[:, None]).all(axis=(1, 2))
    return state, is_open, is_clear


def _walled_nodes(space: ConfigurationSpace, cells: CellStates, is_open: IsOpen, node: Nodes, side: Sides) -> IsOpen:
    """Return a mask of nodes of the grid: of each two neighbors that a wall separates, the node nearer to the wall.

    ``node`` has the positions of the nodes, and ``side`` the grid step along each axis.
    """
    closed = np.zeros_like(is_open)
    for axis, wraps in enumerate(space.domain.periodic):
        # Motions between two open nodes need a test unless both cells are proven free.
        is_free = cells == CellState.FREE
        is_tested = is_open & rolled(is_open, -1, axis, wraps, False) & ~(is_free & np.roll(is_free, -1, axis))
        unit = np.arange(len(side)) == axis
        begin = np.argwhere(is_tested)
        step = side * unit
        q = node[tuple(begin.T)]
        is_walled = ~space.are_free(q, q + step)
        begin, q = begin[is_walled], q[is_walled]
        is_far = space.are_free(q, q + step / 2)  # then the wall is in the second half
        closed[tuple(((begin + is_far[:, None] * unit) % is_open.shape).T)] = True
    return closed


def _stencil_edges(
    space: ConfigurationSpace, cells: CellStates, is_open: IsOpen, node: Points, rates: Rates, side: Sides
) -> list[Any]:
    """Return edges between open nodes of a grid along free motions: where they begin and end, and their costs.

    An edge leads along the axes of one group of the motion cost, such as the axes of the position, also obliquely, by
    up to ``_REACH`` grid steps along each of these axes. ``rates`` are the costs of motions at nodes.
    """
    # 1. Edges from nodes whose whole stencil is free need no test.
    domain, motion_cost, shape = space.domain, space.motion_cost, is_open.shape
    factor, pulls = rates
    farthest = max(_REACH[len(axes)] for axes, _ in motion_cost.blocks)
    mode: Any = ["wrap" if wraps else "nearest" for wraps in domain.periodic]
    is_clear: Any = ndimage.minimum_filter(cells == CellState.FREE, 2 * farthest + 1, mode=mode)
    # 2. Edges between open nodes, in both directions. Of each pair of opposite offsets one is tested, without offsets
    #    that pass another node. `a` and `b` are the flat indices of both ends of edges. Costs take the mean rate of
    #    both ends.
    begin, edges = np.argwhere(is_open), []
    for axes, _ in motion_cost.blocks:
        reach = _REACH[len(axes)]
        for offset in product(range(-reach, reach + 1), repeat=len(axes)):
            if offset <= (0,) * len(axes) or gcd(*offset) > 1:
                continue
            step = np.zeros(len(shape), np.int64)
            step[list(axes)] = offset
            end = begin + step
            is_inside = (((end >= 0) & (end < shape)) | np.array(domain.periodic)).all(axis=1)
            a, b = (np.asarray(np.ravel_multi_index(tuple(x[is_inside].T), shape, mode="wrap")) for x in (begin, end))
            a, b = a[is_open.ravel()[b]], b[is_open.ravel()[b]]
            tested = a[~is_clear.ravel()[a]]
            is_free = np.ones(len(a), bool)
            is_free[~is_clear.ravel()[a]] = space.are_free(node[tested], node[tested] + step * side)
            a, b = a[is_free], b[is_free]
            change = np.broadcast_to(step * side, (len(a), len(shape)))
            for tail, head, vector in ((a, b, change), (b, a, -change)):
                mean = None if pulls is None else (pulls[:, tail] + pulls[:, head]) / 2
                cost = (factor[tail] + factor[head]) / 2 * motion_cost.norm(vector) + pulled(mean, vector)
                edges.append((tail, head, cost))
    return edges
