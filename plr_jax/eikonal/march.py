"""Fast marching over a regular grid by scikit-fmm. Near the goals, nodes have the costs of straight motions.

Richardson extrapolation removes the error that is proportional to the grid step, where costs and walls permit.
Stencils have no diagonals, so no path passes where two obstacles touch in an edge or a corner. Reference: Sethian, "A
fast marching level set method for monotonically advancing fronts", 1996.
"""

from typing import Any, cast

import numpy as np
import skfmm
from jaxtyping import Bool, Float, Int
from scipy import ndimage

_NEARLY = 1.1  # largest factor by which the costs of nodes in a ball around a goal differ from the cost at the goal
_NO_TIME = 1e-9  # of a step, for a node on the first front
_NO_JUMP = 1.35  # costs of two nodes two steps apart do not jump up to this factor
# If costs on two grids differ by more than this share, the error does not fall as the step does.
_LARGEST_CHANGE = 0.02
IsOpen = Bool[np.ndarray, "*shape"]
Costs = Float[np.ndarray, "*shape"]
Sides = Float[np.ndarray, "dim"]


def balls(
    is_open: IsOpen,
    slowness: Costs,  # cost per unit of length at each node
    at_goal: Costs,  # cost per unit of length at the goal nearest to each node
    straight: Costs,  # cost of a free straight motion from each node to a goal; inf if none is known
    goal: Int[np.ndarray, "*shape"],  # index of the goal of this motion; -1 if none is known
    sees_nearest: IsOpen,  # whether the straight motion from each node to its nearest goal is free
    lengths: Costs,  # distance from each node to its nearest goal
    radius: float,  # of the balls around goals
    side: Sides,  # grid step along each axis
) -> tuple[Costs, float]:
    """Return the costs-to-go of grid nodes near goals, and the cost at which fast marching starts.

    The costs-to-go are costs of straight motions to a goal; nodes farther away have ``inf``.
    """
    # 1. Around a goal, straight motions are cheapest up to the least cost (`largest`) of a node that does not see its
    #    nearest goal, that lies outside the ball, or whose cost per length is another than the goal's. All nodes
    #    below that cost, and the cheapest node of each goal, get the cost of their straight motion.
    differs = (slowness > _NEARLY * at_goal) | (_NEARLY * slowness < at_goal)
    stops = is_open & (~sees_nearest | differs | (lengths >= radius))
    largest = np.minimum(straight, at_goal * lengths)[stops].min(initial=np.inf)
    near = goal >= 0
    cheapest = np.full(goal.max(initial=-1) + 1, np.inf)
    np.minimum.at(cheapest, goal[near], straight[near])
    is_cheapest = near & (straight == cheapest[goal]) if near.any() else near
    start = np.where(is_cheapest | ((straight < largest) & ~differs), straight, np.inf)
    # 2. March from one step below the largest of these costs, so that nodes on both sides of the first front have
    #    them; but no goal's cheapest node may lie beyond this front.
    inside = np.isfinite(start)
    step = float(slowness[inside].max(initial=0.0) * side.max())
    level = min(largest, float(start[inside].max(initial=0.0))) - step
    return start, max(level, float(cheapest[np.isfinite(cheapest)].max(initial=-np.inf)))


def marched(
    is_open: IsOpen, slowness: Costs, start: Costs, level: float, side: Sides, periodic: tuple[bool, ...]
) -> Costs:
    """Return the costs-to-go of grid nodes, by fast marching from the nodes where ``start`` is at most ``level``.

    ``start`` is the known cost-to-go of each node, ``inf`` where unknown. ``is_open`` marks the nodes that paths may
    pass. ``slowness`` is the cost per unit of length at each node, and ``side`` the grid step along each axis. Nodes
    that cannot be reached have the cost ``inf``.
    """
    # 1. The first front lies between core nodes and open nodes beside them, which get the cheapest known cost.
    is_core = start <= level
    reached, inverse_square = start.copy(), np.zeros(is_open.shape)
    for axis, wraps in enumerate(periodic):
        is_cut = np.zeros(is_open.shape, bool)
        for step in (1, -1):
            cut = is_open & np.roll(is_open, step, axis) & (is_core != np.roll(is_core, step, axis))
            if not wraps:
                cut[(slice(None),) * axis + (0 if step == 1 else -1,)] = False
            is_cut |= cut
            step_cost = side[axis] * (slowness + np.roll(slowness, step, axis)) / 2
            unknown = cut & np.isinf(start)
            reached[unknown] = np.minimum(reached, np.roll(start, step, axis) + step_cost)[unknown]
        inverse_square += np.where(is_cut, 4 / side[axis] ** 2, 0.0)
    front = inverse_square > 0
    if not front.any():
        return np.where(is_core, start, np.inf)
    # 2. scikit-fmm puts the first front halfway between nodes. A node with neighbors beyond it along some axes counts
    #    as 1 / sqrt(sum over these axes of (2 / side)**2) away from it, and its time is this distance times its
    #    slowness. So these nodes get the slowness at which the time is the difference of their known cost and the
    #    level.
    time = np.where(is_core[front], level - reached[front], reached[front] - level)
    slowness = slowness.copy()
    slowness[front] = np.maximum(time, _NO_TIME * slowness[front] * side.min()) * np.sqrt(inverse_square[front])
    # 3. March.
    travel_time = skfmm.travel_time(
        np.ma.MaskedArray(np.where(is_core, -1.0, 1.0), ~is_open),
        1 / slowness,
        dx=side.tolist(),
        order=2,
        periodic=cast(Any, list(periodic)),
    )
    return np.where(is_core, start, np.ma.filled(travel_time, np.inf) + level)


def has_coarse_grid(is_open: IsOpen, is_clear: IsOpen, factor: Costs) -> bool:
    """Return whether the coarse grid of every second node has the same walls as the grid, and no jumps of the costs.

    The grid must have an odd number of nodes along each axis, else the result is False. ``is_open`` marks the nodes
    that paths may pass; the other nodes are closed. Consider two nodes of the coarse grid that are neighbors along an
    axis. If both are open, the node between them must be open too, and the costs ``factor`` of the two must be
    similar. If one of the two is closed, the other must be closed or lie on a wall. ``is_clear`` marks the open nodes
    that lie on no wall.
    """
    if any(n % 2 == 0 for n in is_open.shape):
        return False
    for axis in range(is_open.ndim):
        # Three nodes in a row: the coarse grid has the first and the last one.
        (first, middle, last), (clear_first, _, clear_last), (cost_first, _, cost_last) = (
            (nodes[:-2:2], nodes[1::2], nodes[2::2])
            for nodes in (np.moveaxis(table, axis, 0) for table in (is_open, is_clear, factor))
        )
        jumps = np.maximum(cost_first, cost_last) > _NO_JUMP * np.minimum(cost_first, cost_last)
        hides_wall = (clear_first & ~last) | (clear_last & ~first)  # a wall between the nodes, not on the open one
        if (hides_wall | (first & last & (jumps | ~middle))).any():
            return False
    return True


def extrapolated(cost: Costs, is_open: IsOpen, slowness: Costs, level: float, side: Sides) -> Costs:
    # Remove the error proportional to the step, by Richardson extrapolation from every second node: the cost of the
    # limit is about cost + (cost - cost with twice the step). The change is interpolated to the other nodes.
    coarse = (slice(None, None, 2),) * is_open.ndim
    cost_there = cost[coarse]
    twice = marched(is_open[coarse], slowness[coarse], cost_there, level, 2 * side, (False,) * len(side))
    is_known = np.isfinite(twice) & np.isfinite(cost_there)
    change = np.subtract(cost_there, twice, out=np.zeros(twice.shape), where=is_known)
    change[np.abs(change) > _LARGEST_CHANGE * cost_there] = 0.0
    return cost + ndimage.map_coordinates(change, np.indices(cost.shape) / 2, order=1)
