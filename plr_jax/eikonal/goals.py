"""The nearest of several goals, by distance or along the shortest path from a node of a grid."""

from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array, eye_array
from scipy.sparse.csgraph import dijkstra
from scipy.sparse.linalg import spsolve_triangular
from scipy.spatial import KDTree

from plr_jax._arrays import hash64
from plr_jax.geometry.box import Box
from plr_jax.geometry.graph import path_ends
from plr_jax.spaces import MotionCost

Points = Float[np.ndarray, "n dim"]
Goals = Float[np.ndarray, "goals dim"]
# Values of the nodes of a grid of any shape, and the grid's step along each axis.
Edges = list[tuple[Int[np.ndarray, " _"], Int[np.ndarray, " _"], Float[np.ndarray, " _"]]]
GoalIndex = Int[np.ndarray, "*shape"]
Costs = Float[np.ndarray, "*shape"]
Sides = Float[np.ndarray, "dim"]
Wraps = tuple[bool, ...]  # whether each axis is periodic
WhichGoal = Callable[[Points], Int[np.ndarray, " n"]]  # from points to the indices of the goals of their paths
_CHECK_BITS = 8  # of a goal's code, beside the bits of its index


def nearest_goals(
    goals: Goals, domain: Box, motion_cost: MotionCost, x: Points, count: int = 1
) -> tuple[Float[np.ndarray, "n count"], Int[np.ndarray, "n count"]]:
    """Return distances from each point to its ``count`` nearest goals, nearest first, and the indices of these goals.

    Distances are Euclidean, with each axis scaled by its cost per unit of length, and go the shorter way around
    periodic axes of ``domain``. So they are lower bounds of the motion cost. If there are fewer than ``count`` goals,
    the remaining distances are ``inf``, and the remaining indices are the number of goals.
    """
    scale = motion_cost.scale
    if len(goals) == 1:
        is_goal = np.arange(count) == 0
        distance = np.linalg.norm(scale * domain.difference(goals[0], x), axis=1)[:, None]
        return np.where(is_goal, distance, np.inf), np.where(is_goal, 0, np.ones((len(x), 1), np.int64))
    # The tree takes coordinates from 0 up to the period, exclusive; a period of 0 says that an axis is not periodic.
    period = np.where(domain.periodic, domain.width * scale, 0.0)

    def placed(points: Points) -> Points:
        q = (domain.wrapped(points) - domain.lo) * scale
        return np.where((period > 0) & (q >= period), 0.0, q)

    tree: Any = KDTree(placed(goals), boxsize=period)
    distance, index = tree.query(placed(x), list(range(1, count + 1)))
    return distance, index.astype(np.int64)


def shortest_paths(
    edges: Edges, straight: Float[np.ndarray, " n"], goal: Int[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Return the cost of each node's shortest path over edges to a goal, and the index of this goal.

    Without a path, the cost is ``inf`` and the index -1.

    Args:
        edges: Nodes at which edges begin, nodes at which they end, and their costs. There must be no two edges from
            one node to another.
        straight: The cost of a motion from each node to a goal, with which a path may end; ``inf`` if there is none.
        goal: The index of the goal of this motion.
    """
    # 1. Goal k has the number n + k. Without such a motion, goal 0 has no edges.
    num = len(straight)
    near = np.flatnonzero(np.isfinite(straight))
    goals = np.unique(np.append(num + goal[near], num))
    begin, end, cost = map(np.concatenate, zip(*edges, (near, num + goal[near], straight[near]), strict=True))
    # 2. Dijkstra's algorithm from all goals, along edges in reverse: rows of the graph are the ends of edges. A
    #    sparse matrix has no edges of length 0.
    graph = csr_array((np.maximum(cost, np.finfo(float).tiny), (end, begin)), shape=(goals[-1] + 1,) * 2)
    result: Any = dijkstra(graph, indices=goals, min_only=True, return_predecessors=True)
    to_goals, _, source = (of_node[:num] for of_node in result)
    return to_goals, np.where(np.isfinite(to_goals), source - num, -1)


def rolled(values: np.ndarray, step: int, axis: int, wraps: bool, outside: bool | float) -> np.ndarray:
    """Return, for each grid node, the value of its neighbor before (``step`` 1) or after it (-1) along an axis.

    Unless the axis ``wraps`` around, nodes of the first or last layer have no such neighbor, and get ``outside``.
    """
    result = np.roll(values, step, axis)
    if not wraps:
        result[(slice(None),) * axis + (0 if step == 1 else -1,)] = outside
    return result


def carried_goals(cost: Costs, known_goal: GoalIndex, side: Sides, periodic: Wraps, num_goals: int) -> GoalIndex:
    """Return the index of the goal to which each grid node's cheapest path leads; -1 without a path.

    ``cost`` is the cost-to-go of each node. ``known_goal`` is the result for nodes where it is already known, and -1
    for other nodes. ``side`` is the grid step along each axis.
    """
    # 1. Nodes by ascending cost: `rank` is a node's place in this order. A path divides among the cheapest neighbors
    #    along each axis, by weights: the fall of the cost over the squared step. So it leads to smaller ranks.
    open_nodes = np.flatnonzero(np.isfinite(cost))
    order = open_nodes[np.argsort(cost.ravel()[open_nodes], kind="stable")]
    rank = np.full(cost.shape, -1)
    rank.ravel()[order] = np.arange(len(order))
    known_goal = known_goal.ravel()[order]
    neighbor, weights = [], []
    for axis, wraps in enumerate(periodic):
        before, after = (rolled(cost, step, axis, wraps, np.inf) for step in (1, -1))
        toward = np.where(before <= after, np.roll(rank, 1, axis), np.roll(rank, -1, axis))
        neighbor.append(toward.ravel()[order])
        fall = np.maximum(cost.ravel()[order] - np.minimum(before, after).ravel()[order], 0.0)
        weights.append(np.where(known_goal < 0, fall / side[axis] ** 2, 0.0))
    weights, neighbor = np.stack(weights), np.stack(neighbor)
    total = weights.sum(axis=0)
    weights = np.divide(weights, total, out=np.zeros_like(weights), where=total > 0)
    # 2. Average the bits of goals, as 1 and -1, over the parts of each path:
    #      averaged[i] = load[i] + sum over neighbors j of weight[i, j] * averaged[j],
    #    a triangular system, with the bits of known goals as the load. The signs are the bits of a goal that gets
    #    over half of the path, if one does. Else they are mostly bits of no goal: `_CHECK_BITS` more bits, a hash of
    #    the index, tell. Of two goals one always gets half, so one bit suffices.
    index, bits = np.arange(num_goals), max((num_goals - 1).bit_length(), 1)
    code = index + ((hash64(index) & np.uint64((1 << _CHECK_BITS) - 1)).astype(np.int64) << bits)
    digit = np.arange(bits + _CHECK_BITS if num_goals > 2 else 1)
    load = np.where(known_goal[:, None] < 0, 0.0, 2.0 * ((code[known_goal][:, None] >> digit) & 1) - 1)
    axis, row = np.nonzero(weights)
    # Before 1.17.1, SciPy's triangular solver takes 32-bit indices only.
    steps = csr_array((-weights[axis, row], np.array([row, neighbor[axis, row]], np.int32)), (len(order),) * 2)
    averaged = spsolve_triangular(csr_array(eye_array(len(order)) + steps), load, unit_diagonal=True)
    read = ((averaged > 0) << digit).sum(axis=1)
    decoded = read & ((1 << bits) - 1)
    is_code = (decoded < num_goals) & (code[np.minimum(decoded, num_goals - 1)] & ((1 << len(digit)) - 1) == read)
    # 3. Elsewhere follow the neighbors with the largest weights, up to a node whose bits are those of a goal, or that
    #    has no neighbor. Take the goal of this node.
    best = neighbor[weights.argmax(axis=0), np.arange(len(order))]
    ends = path_ends(np.where(is_code | (total == 0), np.arange(len(order)), best))
    goal = np.full(cost.size, -1)
    goal[order] = np.where(is_code, decoded, -1)[ends]
    return goal.reshape(cost.shape)
