"""Fast marching over a regular grid by scikit-fmm. Near the goals, nodes have the costs of straight motions.

The nodes of a coarse grid may be groups of voxels (:class:`VoxelGroups`), which keep narrow tunnels open and thin
walls closed. Richardson extrapolation removes the error that is proportional to the grid step, where costs and walls
permit. Stencils have no diagonals, so no path passes where two obstacles touch in an edge or a corner.

Reference: Sethian, "A fast marching level set method for monotonically advancing fronts", 1996.
"""

from itertools import product
from typing import Any, NamedTuple

import numpy as np
import skfmm
from jaxtyping import Bool, Float
from scipy import ndimage

from plr_jax.eikonal.goals import Costs, GoalIndex, Goals, Sides, Wraps, rolled, shortest_paths
from plr_jax.geometry.box import Box

_NEARLY = 1.1  # largest factor by which the costs of nodes in a ball around a goal differ from the cost at the goal
_NO_TIME = 1e-9  # of a step, for a node on the first front
_NO_JUMP = 1.35  # costs of two nodes two steps apart do not jump up to this factor
# If costs on two grids differ by more than this share, the error does not fall as the step does.
_LARGEST_CHANGE = 0.02
# The share of full groups in a cube around a group of voxels says how wide the place is.
_WIDE = 5  # groups along each axis of this cube
_RANKS = 2  # shares are rounded to so many steps
IsOpen = Bool[np.ndarray, "*shape"]
Voxels = Bool[np.ndarray, "..."]


def start_of_march(
    is_open: IsOpen,
    slowness: Costs,
    side: Sides,
    straight: Costs,
    goal: GoalIndex,
    at_nearest: Costs,
    lengths: Costs,
    is_in_sight: IsOpen,
) -> tuple[Costs, float]:
    """Return the costs-to-go of grid nodes near goals, and the cost at which fast marching starts.

    The costs-to-go are costs of straight motions to a goal; nodes farther away have ``inf``.

    Args:
        is_open: Whether paths may pass a node.
        slowness: Cost per unit of length at each node.
        side: Grid step along each axis.
        straight: Cost of a free straight motion to a goal; ``inf`` if none is known.
        goal: Index of the goal of this motion; -1 if none is known.
        at_nearest: Cost per unit of length at the nearest goal.
        lengths: Distance to the nearest goal.
        is_in_sight: Whether the nearest goal is near, and the straight motion there is free. All nodes within some
            radius are near; farther away, other motions may be cheaper than the straight one.
    """
    # 1. Around a goal, straight motions are cheapest up to the least cost (`largest`) of a node that is not in sight
    #    of its nearest goal, or whose cost per length is another than the goal's. All nodes below that cost, and the
    #    cheapest node of each goal, get the cost of their straight motion. The other nodes count with that cost or,
    #    if less, the cost of their distance at the goal's cost per length, which is known even if no straight motion
    #    is free.
    differs = (slowness > _NEARLY * at_nearest) | (_NEARLY * slowness < at_nearest)
    largest = np.minimum(straight, at_nearest * lengths)[is_open & (~is_in_sight | differs)].min(initial=np.inf)
    has_goal = goal >= 0
    cheapest = np.full(goal.max(initial=-1) + 1, np.inf)
    np.minimum.at(cheapest, goal[has_goal], straight[has_goal])
    is_cheapest = has_goal & (straight == cheapest[goal]) if has_goal.any() else has_goal
    start = np.where(is_cheapest | ((straight < largest) & ~differs), straight, np.inf)
    # 2. March from one step below the largest of these costs, so that nodes on both sides of the first front have
    #    them; but no goal's cheapest node may lie beyond this front.
    inside = np.isfinite(start)
    step = float(slowness[inside].max(initial=0.0) * side.max())
    level = min(largest, float(start[inside].max(initial=0.0))) - step
    return start, max(level, float(cheapest[np.isfinite(cheapest)].max(initial=-np.inf)))


def marched(is_open: IsOpen, slowness: Costs, start: Costs, level: float, side: Sides, periodic: Wraps) -> Costs:
    """Return the costs-to-go of grid nodes, by fast marching from the nodes where ``start`` is at most ``level``.

    ``start`` is the known cost-to-go of each node, ``inf`` where unknown. ``is_open`` marks the nodes that paths may
    pass. ``slowness`` is the cost per unit of length at each node, and ``side`` the grid step along each axis. Nodes
    that cannot be reached have the cost ``inf``.
    """
    # scikit-fmm puts the first front halfway between nodes. A node with neighbors beyond it along some axes counts as
    # 1 / sqrt(sum over these axes of (2 / side)**2) away from it, and its time is this distance times its slowness.
    #
    # 1. The first front lies between core nodes and open nodes beside them, which get the cheapest known cost.
    #    Each node is compared with its neighbor before it (step 1) and after it (step -1) along each axis.
    is_core = start <= level
    reached, inverse_square = start.copy(), np.zeros(is_open.shape)
    for axis, wraps in enumerate(periodic):
        is_cut = np.zeros(is_open.shape, bool)
        for step in (1, -1):
            cut = is_open & rolled(is_open, step, axis, wraps, False) & (is_core != np.roll(is_core, step, axis))
            is_cut |= cut
            step_cost = side[axis] * (slowness + np.roll(slowness, step, axis)) / 2
            unknown = cut & np.isinf(start)
            reached[unknown] = np.minimum(reached, np.roll(start, step, axis) + step_cost)[unknown]
        inverse_square += np.where(is_cut, 4 / side[axis] ** 2, 0.0)
    front = inverse_square > 0
    if not front.any():
        return np.where(is_core, start, np.inf)
    # 2. Nodes beside the front get the slowness at which their time is the difference of their known cost and the
    #    level.
    time = np.where(is_core[front], level - reached[front], reached[front] - level)
    slowness = slowness.copy()
    slowness[front] = np.maximum(time, _NO_TIME * slowness[front] * side.min()) * np.sqrt(inverse_square[front])
    # 3. March.
    time = travel_times(np.where(is_core, -1.0, 1.0), is_open, slowness, side, periodic)
    return np.where(is_core, start, time + level)


def travel_times(front: Costs, is_open: IsOpen, slowness: Costs, side: Sides, periodic: Wraps) -> Costs:
    """Return the costs of motions to grid nodes from the surface where ``front``, linear between nodes, is 0.

    Nodes that are not open have the cost ``inf``, and so have nodes that cannot be reached. ``slowness`` is the cost
    per unit of length at each node, and ``side`` the grid step along each axis.
    """
    options: Any = {"dx": side.tolist(), "order": 2, "periodic": list(periodic)}
    return np.ma.filled(skfmm.travel_time(np.ma.MaskedArray(front, ~is_open), 1 / slowness, **options), np.inf)


def has_coarse_grid(is_open: IsOpen, is_clear: IsOpen, factor: Costs) -> bool:
    """Return whether the coarse grid of every second node has the same walls as the grid, and no jumps of the costs.

    The grid must have an odd number of nodes along each axis, else the result is False. ``is_open`` marks the nodes
    that paths may pass; the other nodes are closed. ``is_clear`` marks the open nodes that lie on no wall. Consider
    two nodes of the coarse grid that are neighbors along an axis. If both are open, the node between them must be
    open too, and the costs ``factor`` of the two must be similar. If one of the two is closed, the other must be
    closed or lie on a wall.
    """
    if any(n % 2 == 0 for n in is_open.shape):
        return False
    for axis in range(is_open.ndim):
        # Three nodes in a row: the coarse grid has the first and the last one.
        nodes, clear, costs = (np.moveaxis(table, axis, 0) for table in (is_open, is_clear, factor))
        first, middle, last = nodes[:-2:2], nodes[1::2], nodes[2::2]
        jumps = np.maximum(costs[:-2:2], costs[2::2]) > _NO_JUMP * np.minimum(costs[:-2:2], costs[2::2])
        hides_wall = (clear[:-2:2] & ~last) | (clear[2::2] & ~first)  # a wall between the nodes, not on the open one
        if (hides_wall | (first & last & (jumps | ~middle))).any():
            return False
    return True


def extrapolated(cost: Costs, is_open: IsOpen, slowness: Costs, level: float, side: Sides) -> Costs:
    """Return the ``cost`` of a march without the error that is proportional to the grid step.

    This is Richardson extrapolation: in the limit of small steps, the cost is about ``cost`` plus the difference of
    ``cost`` and the cost with twice the step. The latter comes from a march over every second node, which starts from
    nodes whose ``cost`` is at most ``level``. The difference is interpolated to the other nodes.
    """
    coarse = (slice(None, None, 2),) * is_open.ndim
    cost_there = cost[coarse]
    twice = marched(is_open[coarse], slowness[coarse], cost_there, level, 2 * side, (False,) * len(side))
    is_known = np.isfinite(twice) & np.isfinite(cost_there)
    change = np.subtract(cost_there, twice, out=np.zeros(twice.shape), where=is_known)
    change[np.abs(change) > _LARGEST_CHANGE * cost_there] = 0.0
    return cost + ndimage.map_coordinates(change, np.indices(cost.shape) / 2, order=1)


class VoxelGroups(NamedTuple):
    """Groups of voxels: cubes of ``size`` (odd) voxels along each axis, each of which is a node of a coarse grid.

    A node stands for one *part* of its group's free voxels: all voxels that are connected, through faces within the
    group, to the free voxel ``x`` nearest to the middle of the group::

        # # # | . . .      If no face joins the parts of two neighbor groups, one of their nodes is closed (paths may
        . x . | . x .      not pass it): the node in the more spacious region, so that tunnels stay open, or else the
        # # # | # # #      node of the smaller part. The node of a group with a goal stays open, and the group's ``x``
                           is then the goal's voxel.
    """

    box: Box  # of all groups; it may extend beyond the voxels
    size: int
    free: Voxels  # whether each voxel of the groups is free
    part: Voxels  # whether each voxel belongs to the part of its group
    has_part: IsOpen  # whether each group has a free voxel
    is_open: IsOpen
    middles: Float[np.ndarray, "*shape dim"]  # of the voxels ``x``, or of groups without a free voxel

    @classmethod
    def of(cls, free: Voxels, domain: Box, box: Box, shape: tuple[int, ...], goals: Goals) -> "VoxelGroups":
        """Divide voxels, of which some are ``free``, into groups, and choose the node of each group: see the class.

        ``shape`` is the number of groups along each axis, and ``box`` contains all groups. The node of a group that
        holds one of the ``goals`` stays open (paths may pass it).
        """
        # 1. Pad the voxels so that groups fill the box. Find the groups in which all voxels are free, and the groups
        #    in which any voxel is free.
        dim, side = free.ndim, domain.width / free.shape
        size = round(float((box.width / side / shape)[0]))
        before = np.rint((domain.lo - box.lo) / side).astype(int)
        after = np.array(shape) * size - free.shape - before
        free = np.pad(free, list(zip(before, after, strict=True)))
        is_full, has_part = free, free  # reduced axis by axis, since NumPy reduces one axis in the least time
        for axis in range(dim):
            split = (*is_full.shape[:axis], shape[axis], size, *is_full.shape[axis + 1 :])
            is_full = np.logical_and.reduce(is_full.reshape(split), axis + 1)
            has_part = np.logical_or.reduce(has_part.reshape(split), axis + 1)
        # 2. The voxel `x` of each group that is not full (`mixed`, one in each row): the first voxel by `order`. A
        #    goal's voxel has -1, free voxels have their squared distance from the middle, and blocked voxels a larger
        #    number.
        mixed = np.nonzero(has_part & ~is_full)
        goal_voxel = tuple(np.floor((goals - box.lo) / side).astype(int).clip(0, np.array(free.shape) - 1).T)
        holds_goal = np.zeros(free.shape, bool)
        holds_goal[goal_voxel] = free[goal_voxel]
        is_free, is_goal = (_blocks(voxels, size)[mixed].reshape(-1, size**dim) for voxels in (free, holds_goal))
        offset = np.array(list(product(range(size), repeat=dim)))
        from_middle = np.sum((offset - size // 2) ** 2, axis=1)
        order = np.where(is_free, from_middle, size**2 * dim)
        order[is_goal] = -1
        nearest = order.argmin(axis=1)
        # 3. The part of each group: the voxels that are joined to x.
        joined = np.zeros(order.shape, bool)
        joined[np.arange(len(order)), nearest] = True
        across_faces = ndimage.generate_binary_structure(dim, 1)[None]  # within a row, not from row to row
        block = (-1, *(size,) * dim)
        joined = ndimage.binary_propagation(joined.reshape(block), across_faces, is_free.reshape(block))
        part = free.copy()
        part_blocks = _blocks(part, size)  # a view: to write a block writes voxels
        part_blocks[mixed] = joined
        middles = np.moveaxis(np.indices(shape), 0, -1) * size + size / 2
        middles[mixed] += offset[nearest] - size // 2
        # 4. Close one of each two neighbor nodes whose parts no face joins: the node of higher rank. The whole part
        #    of a rank is the width of the place, its fraction the share of voxels outside the part; goals stay open.
        rank = np.rint(_RANKS * ndimage.uniform_filter(is_full.astype(np.float32), _WIDE, mode="constant"))
        rank[mixed] += 1 - joined.mean(axis=tuple(range(1, dim + 1)))
        rank[tuple(along // size for along in goal_voxel)] = -1.0
        is_open = has_part.copy()
        for axis in range(dim):
            lower_groups, upper_groups = ((slice(None),) * axis + (end,) for end in (slice(-1), slice(1, None)))
            # The last layer of voxels in each lower group meets the first layer in the upper group. An array of
            # layers has the dim axes of groups, then the dim - 1 axes of voxels in a layer.
            last, first = (np.moveaxis(part_blocks, dim + axis, 0)[end] for end in (-1, 0))
            touch = (last[lower_groups] & first[upper_groups]).any(axis=tuple(range(dim, 2 * dim - 1)))
            is_walled = is_open[lower_groups] & is_open[upper_groups] & ~touch
            is_wider = rank[lower_groups] > rank[upper_groups]
            is_open[lower_groups] &= ~(is_walled & is_wider)
            is_open[upper_groups] &= ~(is_walled & ~is_wider)
        return cls(box, size, free, part, has_part, is_open, box.lo + middles * side)

    def completed(self, cost: Costs, slowness: Costs) -> tuple[Costs, Costs]:
        """Return the costs of all open nodes, and costs of the groups' other voxels, from the ``cost`` of a march.

        Other voxels are those for which the group's node does not stand. A march misses nodes to which only other
        voxels lead: it begins again in each region of such nodes, at the node nearest to the goal. The second result
        has, for each group, the least cost of its other voxels: ``inf`` if there are none, or no path leads there.
        """
        missed_cost, others = self._costs_across_faces(cost, slowness)
        labeled: Any = ndimage.label(self.is_open & np.isfinite(missed_cost))
        region, num = labeled
        if not num:
            return cost, others
        cost = cost.copy()
        for index, box in enumerate(ndimage.find_objects(region), 1):
            is_inside = region[box] == index
            least = float(missed_cost[box][is_inside].min())
            start = np.where(is_inside & (missed_cost[box] == least), least, np.inf)
            costs = marched(is_inside, slowness[box], start, least, self.box.width / cost.shape, (False,) * cost.ndim)
            cost[box] = np.where(is_inside, np.minimum(costs, missed_cost[box]), cost[box])
        return cost, self._costs_across_faces(cost, slowness)[1]

    def _costs_across_faces(self, cost: Costs, slowness: Costs) -> tuple[Costs, Costs]:
        """Return two costs-to-go for each group: the least cost of a voxel in its part, and of any of its voxels.

        Only voxels of unknown cost count; if there are none with a path, the cost is ``inf``. A voxel's cost is known
        if the voxel belongs to a group's *part* (the voxels for which the group's node stands) and the node has a
        finite ``cost``. Paths lead from voxels of known cost across faces through free voxels of unknown cost.
        """
        # 1. The voxels of unknown cost.
        dim, size, shape = self.free.ndim, self.size, np.array(self.free.shape)
        is_known = self.part.copy()
        _blocks(is_known, size)[...] &= np.isfinite(cost)[(..., *(None,) * dim)]  # writes into `is_known`
        voxel = np.argwhere(self.free & ~is_known)
        flat = np.asarray(np.ravel_multi_index(tuple(voxel.T), self.free.shape))
        num, side = len(voxel), self.box.width / shape
        group = tuple((voxel // size).T)
        # 2. Across each face of these voxels, either begin at the node of a group of known cost, by the straight
        #    motion from the middle of the group, or lead an edge to another voxel of unknown cost.
        start, edges = np.full(num, np.inf), []
        for axis, step in product(range(dim), (-1, 1)):
            beside = voxel + step * (np.arange(dim) == axis)
            inside = np.flatnonzero((beside[:, axis] >= 0) & (beside[:, axis] < shape[axis]))
            starts = inside[is_known[tuple(beside[inside].T)]]
            away = (voxel[starts] - beside[starts] // size * size - size // 2) * side
            node = tuple((beside[starts] // size).T)
            start[starts] = np.minimum(start[starts], cost[node] + slowness[node] * np.linalg.norm(away, axis=1))
            target = np.asarray(np.ravel_multi_index(tuple(beside[inside].T), self.free.shape))
            place = np.searchsorted(flat, target)
            joined = np.flatnonzero(flat[np.minimum(place, num - 1)] == target)  # targets in `flat`, which ascends
            edges.append((place[joined], inside[joined], side[axis] * slowness[group][inside[joined]]))
        # 3. Shortest paths, as if all starts were motions to one goal.
        distance, _ = shortest_paths(edges, start, np.zeros(num, int))
        missed_cost, others = np.full(cost.shape, np.inf), np.full(cost.shape, np.inf)
        in_part = np.flatnonzero(self.part[tuple(voxel.T)])
        np.minimum.at(missed_cost, tuple(voxel[in_part].T // size), distance[in_part])
        np.minimum.at(others, group, distance)
        return missed_cost, others


def _blocks(voxels: Voxels, size: int) -> Voxels:
    # A view with the axes of groups first, then the axes of voxels within a group. From (8, 6) voxels and size 2:
    # (4, 2, 3, 2), then (4, 3, 2, 2).
    parts = [n for num in voxels.shape for n in (num // size, size)]
    axes = range(2 * voxels.ndim)
    return voxels.reshape(parts).transpose(*axes[::2], *axes[1::2])
