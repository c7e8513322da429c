"""Reduce a path's cost robot by robot, by motions off the lattice, while the other robots keep their motions.

``shorten`` replaces motions by straight shortcuts. ``shorten_in_corridors`` lets a robot deviate to one of a few
configurations around each row of its path (its corridor); dynamic programming over the rows finds the cheapest
collision-free sequence. It also moves two robots together while they are near each other, as neither gains by making
way alone. Neither function changes the number of rows or raises the cost.
"""

from collections.abc import Iterator
from contextlib import suppress
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import csgraph, csr_array

from plr_jax._arrays import path_from_root, ragged_indices, require_time, take_ragged
from plr_jax._problem import ROUNDING, JointPath, Problem, path_cost, straight_costs
from plr_jax.collision.motions import Circles, JointMotionTest, Rows, TeamTrajectory, circles, within_reach
from plr_jax.robots import between

Corridor = Float[np.ndarray, "steps _ dof"]  # one configuration per row and place; more places with a heading
Costs = Float[np.ndarray, "motions size size"]
Robots = tuple[int, ...]
Group = tuple[Robots, slice]  # one or two robots, and rows of the path
# Shortcuts:
_LONGEST = 32  # most steps that a shortcut spans
_STRIDES = (16, 4, 1)  # motions tested in each batch: every 16th, every 4th, all
_LEAST_SAVING = 1e-4  # least share of the cost that a shortcut must save
_LEAST_ROUND_GAIN = 1e-3  # rounds stop if one saves a smaller share of the cost
# Corridors:
_STRAIGHT = 1e-9  # motions longer than a straight line by at most this share are not shortened
_CORRIDOR_GAIN = 3e-3  # corridors are narrowed if a round saves a smaller share of the cost
_NARROWINGS = 3  # how often the width is halved, at most
_REACH = 4  # two robots touch if their circumscribed discs are closer than this many corridor widths
_MARGIN = 3  # rows added before and after the rows in which two robots touch
_PLUS_PATTERN = np.array([(0, 0), (1, 0), (0, 1), (-1, 0), (0, -1)], dtype=np.float64)  # shifts, in widths


def shorten(problem: Problem, path: JointPath, test: JointMotionTest) -> JointPath:
    """Replace motions by straight shortcuts until a round saves little, or the deadline of ``test`` passes.

    A round tries each robot in turn.
    """
    # A robot is tried again after it has gained, or after a robot that blocked one of its shortcuts has moved.
    trajectory, cost = TeamTrajectory(test.robots, path), path_cost(problem, path)
    may_gain = np.ones(len(test.robots), dtype=bool)
    in_way = np.zeros((len(may_gain), len(may_gain)), dtype=bool)  # [i, j]: robot j blocked a shortcut of i
    # List all motions and possible shortcuts: from each row to each of the next `_LONGEST` rows.
    begin, rank = ragged_indices(np.minimum(np.arange(len(path))[::-1], _LONGEST))
    end = begin + 1 + rank
    gains = True
    with suppress(TimeoutError):
        while gains:
            for i in range(len(may_gain)):
                if not may_gain[i]:
                    continue
                rows, in_way[i] = _with_shortcuts(problem, trajectory, i, test, begin, end)
                may_gain[i] = len(rows) < len(path)
                if may_gain[i]:
                    q = trajectory.path[:, i].copy()
                    for first, last in pairwise(rows):  # at constant speed, between rows that stay fixed
                        fraction = np.arange(1, last - first)[:, None] / (last - first)
                        q[first + 1 : last] = between(q[first], q[last], fraction)
                    trajectory.move(i, q)
                    may_gain |= in_way[:, i]
            before, cost = cost, path_cost(problem, trajectory.path)
            gains = before - cost > _LEAST_ROUND_GAIN * before
    return trajectory.path


def _with_shortcuts(
    problem: Problem, trajectory: TeamTrajectory, i: int, test: JointMotionTest, begin: Rows, end: Rows
) -> tuple[list[int], Bool[np.ndarray, " robots"]]:
    """Return the rows of the path that robot ``i``'s cheapest route visits, and which robots blocked a shortcut.

    A route consists of the robot's present motions (from a row to the next) and of straight shortcuts that hit
    nothing. The motions and shortcuts to try lead from row ``begin[k]`` to row ``end[k]``.
    """
    # 1. Find shortcuts that save cost and hit no wall. No shortcut begins or ends in a row at a contact of walls, as
    #    there the path's own motions fix the side on which it passes; except at the ends of the path. A shortcut may
    #    skip such a row.
    q = trajectory.path[:, i]
    is_motion = end == begin + 1
    at_contact = test.wall_tests[i].is_at_contact(q)
    at_contact[[0, -1]] = False
    cost = straight_costs(q[begin], q[end], problem.rotation_weights[i])
    so_far = np.concatenate([[0.0], np.cumsum(cost[is_motion])])
    useful = is_motion | (cost < (1 - _LEAST_SAVING) * (so_far[end] - so_far[begin]))
    useful &= is_motion | ~(at_contact[begin] | at_contact[end])
    begin, end, cost, is_edge = begin[useful], end[useful], cost[useful], is_motion[useful]
    shortcuts = np.flatnonzero(~is_edge)
    shortcuts = shortcuts[test.wall_tests[i](q[begin[shortcuts]], q[end[shortcuts]], test.deadline)]
    # 2. Exclude shortcuts that hit another robot. Each is cut into one piece per motion that it replaces. A shortcut
    #    usually collides in many pieces or in none, so a few pieces far apart are tested first.
    is_apart, in_way = np.ones(len(shortcuts), dtype=bool), np.zeros(len(test.robots), dtype=bool)
    first_row, num_pieces = begin[shortcuts], end[shortcuts] - begin[shortcuts]
    shortcut, rank = ragged_indices(num_pieces)  # of each piece
    row = first_row[shortcut] + rank
    is_untested = np.ones(len(row), dtype=bool)
    for stride in _STRIDES:
        require_time(test.deadline, "all shortcuts were tested")
        now = np.flatnonzero(is_untested & (row % stride == 0) & is_apart[shortcut])
        is_untested[now] = False
        edge = shortcuts[shortcut[now]]
        count = num_pieces[shortcut[now], None]
        q0, q1 = (between(q[begin[edge]], q[end[edge]], (rank[now] + ahead)[:, None] / count) for ahead in (0, 1))
        near, j = trajectory.robots_near(i, circles(q0[:, None], q1[:, None]), row[now])
        meet = test.meet(i, q0[near], q1[near], trajectory, row[now[near]], j)
        is_apart[shortcut[now[near[meet]]]] = False  # pieces now[near[meet]] hit a robot
        in_way[j[meet]] = True
    # 3. Find the cheapest route along the remaining edges. An explicit entry of 0 is an edge of cost 0.
    is_edge[shortcuts[is_apart]] = True
    graph = csr_array((cost[is_edge], (begin[is_edge], end[is_edge])), shape=(len(q), len(q)))
    previous = csgraph.dijkstra(graph, indices=0, return_predecessors=True)[1]
    return path_from_root(previous, len(q) - 1), in_way


def shorten_in_corridors(problem: Problem, path: JointPath, test: JointMotionTest, width: float) -> JointPath:
    """Lower a path's cost by small shifts of configurations, of one robot or of two nearby robots at a time.

    Shifts have the length ``width``, in workspace units, which is halved when a round saves little. The function ends
    after a few halvings, or when the deadline of ``test`` passes.
    """
    trajectory, cost = TeamTrajectory(test.robots, path), path_cost(problem, path)
    narrowest = width / 2**_NARROWINGS
    diagonal = False  # rounds alternate between shifts along the axes and along the diagonals
    with suppress(TimeoutError):
        while width > narrowest:
            for robots, rows in _corridor_groups(problem, trajectory.path, width):
                q, weights = trajectory.path[rows, robots], problem.rotation_weights[list(robots)]
                least = straight_costs(q[0], q[-1], weights).sum()
                if straight_costs(q[:-1], q[1:], weights).sum() <= (1 + _STRAIGHT) * least:
                    continue  # straight motions have nothing to gain
                shortened = _shortened_in_corridors(problem, trajectory, (robots, rows), test, width, diagonal)
                for i, q_new in zip(robots, shortened, strict=True):
                    if (q_new != trajectory.path[rows, i]).any():
                        trajectory.move(i, q_new, rows)
            diagonal = not diagonal
            before, cost = cost, path_cost(problem, trajectory.path)
            if before - cost <= _CORRIDOR_GAIN * before:
                width /= 2  # narrow the corridors
    return trajectory.path


def _corridor_groups(problem: Problem, path: JointPath, width: float) -> Iterator[Group]:
    """Yield each robot with all rows of the path, and each pair of nearby robots with the rows where they are near.

    Robots are near if the gap between their circumscribed discs is less than a few times ``width``. After each group,
    the caller may move the group's robots in the group's rows of ``path``, in place. Later pairs are found on the
    changed path.
    """
    size = [robot.circumscribed_radius for robot in problem.robots]
    for i in range(len(problem.robots)):
        yield (i,), slice(0, len(path))
        for j in range(i):
            x, y = (path[:, j, :2] - path[:, i, :2]).T
            rows = np.flatnonzero(np.hypot(x, y) < size[i] + size[j] + _REACH * width)
            if len(rows):
                yield (i, j), slice(max(int(rows[0]) - _MARGIN, 0), min(int(rows[-1]) + _MARGIN + 1, len(path)))


def _shortened_in_corridors(
    problem: Problem, trajectory: TeamTrajectory, group: Group, test: JointMotionTest, width: float, diagonal: bool
) -> list[Float[np.ndarray, "rows dof"]]:
    """Return the cheapest collision-free path of each robot of ``group`` in the group's rows.

    In each row, a robot may take any configuration of its corridor (see :func:`_corridor`). The first and the last
    row stay as they are. For two robots, the sum of both costs is minimized.
    """
    require_time(test.deadline, "all corridors were searched")
    robots, rows = group
    path = trajectory.path[rows]
    first_row = np.arange(rows.start, rows.stop - 1)
    weights = problem.rotation_weights
    corridors = [_corridor(problem, path[:, i], i, width, diagonal) for i in robots]
    around = [circles(corridor[:-1], corridor[1:]) for corridor in corridors]
    # 1. Compute the costs of each robot's motions alone: entry [k, a, b] from configuration a of row k to b of row
    #    k + 1. Configuration 0 is the present one.
    costs = [straight_costs(q[:-1, :, None], q[1:, None], weights[i]) for i, q in zip(robots, corridors, strict=True)]
    through = [_least_cost_through(cost) for cost in costs]
    # Let c_i be the cost of robot i's present path, and m_i its least cost. A path of robot i of cost t can only be
    # part of a cheaper joint path if t + sum of m_k (k != i) < sum of c_k, that is, t < m_i + spare. As every path
    # has a motion from row 0, m_i is the least cost through one of these.
    least = [float(total[0].min()) for total in through]
    spare = sum(float(cost[:, 0, 0].sum()) for cost in costs) - sum(least)
    for i, corridor, region, cost, total, m_i in zip(robots, corridors, around, costs, through, least, strict=True):
        # 2. Set the costs of motions that cannot gain, or hit something, to inf. Test only motions that may gain.
        #    `region` has a circle for each row in which the reference point stays.
        present_cost = cost[:, 0, 0].copy()
        may_gain = total < (1 - ROUNDING) * (m_i + spare)
        cost[~may_gain] = np.inf
        row, first, last = np.nonzero(may_gain)
        begin, end = corridor[row, first], corridor[row + 1, last]
        # As for shortcuts, no new motion begins or ends at a contact of walls: the present motions fix the side.
        at_contact = test.wall_tests[i].is_at_contact(corridor)
        free = ~(at_contact[row, first] | at_contact[row + 1, last])
        free[free] = test.wall_tests[i](begin[free], end[free], test.deadline)
        # Test all motions of a row against each robot that is near in this row (`near_row`).
        near_row, j = trajectory.robots_near(i, region, first_row, robots)
        first_motion = np.searchsorted(row, np.arange(len(first_row) + 1))  # of each row
        tested, pair = take_ragged(first_motion, near_row)
        free[tested[test.meet(i, begin[tested], end[tested], trajectory, first_row[near_row[pair]], j[pair])]] = False
        cost[row[~free], first[~free], last[~free]] = np.inf
        # The present motions keep their costs: with them, a path always exists.
        cost[:, 0, 0] = present_cost
    # 3. Find the cheapest path by dynamic programming. With two robots, a place is a pair of configurations.
    cost = costs[0] if len(robots) == 1 else _joint_costs(robots, corridors, around, costs, test)
    places = np.unravel_index(_cheapest(cost), [corridor.shape[1] for corridor in corridors])
    return [corridor[np.arange(len(path)), place] for corridor, place in zip(corridors, places, strict=True)]


def _joint_costs(
    robots: Robots, corridors: list[Corridor], around: list[Circles], costs: list, test: JointMotionTest
) -> Float[np.ndarray, "motions pairs pairs"]:
    """Return the cost of each joint motion of two robots from a row to the next, without collisions between the two.

    Entry ``[k, p, q]`` leads from pair ``p`` of configurations in row ``k`` to pair ``q`` in row ``k + 1``. The pairs
    of configurations of the two corridors are in row-major order. The cost is ``inf`` if the robots collide, or if no
    cheaper joint path has this motion; but the present motions ``[k, 0, 0]`` keep their costs. ``around`` has circles
    around the corridors, and ``costs`` the cost of each robot's motions alone.
    """
    # Entry [k, a, b, c, d]: the robots move from configurations a and b of row k to c and d of row k + 1. Then pairs
    # (a, b) and (c, d) are numbered in row-major order.
    (i, j), (a, b) = robots, corridors
    cost = costs[0][:, :, None, :, None] + costs[1][:, None, :, None, :]
    shape, size = cost.shape, cost.shape[1] * cost.shape[2]
    cost = cost.reshape(-1, size, size)
    present_cost = cost[:, 0, 0].copy()
    may_gain = _least_cost_through(cost) < (1 - ROUNDING) * present_cost.sum()
    near = within_reach(test.robots[i], around[0], test.robots[j], around[1])
    tested = np.nonzero((may_gain & near[:, None, None]).reshape(shape))
    row, a_first, b_first, a_last, b_last = tested
    apart = test.apart(i, a[row, a_first], a[row + 1, a_last], j, b[row, b_first], b[row + 1, b_last])
    cost[~may_gain] = np.inf
    cost.reshape(shape)[tuple(index[~apart] for index in tested)] = np.inf
    cost[:, 0, 0] = present_cost
    return cost


def _corridor(problem: Problem, q: Float[np.ndarray, "steps dof"], i: int, width: float, diagonal: bool) -> Corridor:
    """Return configurations to try in each row of robot ``i``'s path ``q``: the present configuration, then others.

    The other positions are shifted by ``width`` along the axes or, if ``diagonal``, along the diagonals. The other
    headings are turned so far that the body's farthest point moves by ``width``. In the first and the last row, all
    configurations equal the present configuration.
    """
    axes = np.sqrt(0.5) * np.array([[1, 1], [-1, 1]]) if diagonal else np.eye(2)
    offsets = np.zeros((len(_PLUS_PATTERN), q.shape[1]))
    offsets[:, :2] = width * _PLUS_PATTERN @ axes
    if problem.robots[i].dof == 3:
        turn = width / problem.robots[i].circumscribed_radius
        offsets = np.concatenate([offsets, [(0, 0, turn), (0, 0, -turn)]])
    corridor = q[:, None] + offsets
    corridor[[0, -1]] = q[[0, -1], None]
    return corridor


def _least_cost_through(cost: Costs) -> Costs:
    """Return the least cost of a path through each motion; the result has the same indices as ``cost``.

    Entry ``[k, a, b]`` of ``cost`` is the cost from configuration ``a`` of row ``k`` to ``b`` of row ``k + 1``. Paths
    begin at configuration 0 of the first row and end at configuration 0 of the last row.
    """
    # Dynamic programming in both directions at once. so_far[k, 0, a] is the least cost from the start to
    # configuration a of row k. so_far[k, 1, a] is the least cost from configuration a of the row k rows before the
    # last one to the end.
    # So so_far[::-1, 1][k] is from row k + 1 to the end: with n motions, this is n - 1 - k rows before the last one.
    both_ways = np.stack([cost, cost[::-1].swapaxes(1, 2)], axis=1)  # forward and backward
    so_far = np.full((len(cost), 2, cost.shape[1]), np.inf)
    so_far[0, :, 0] = 0.0
    for k in range(len(cost) - 1):
        np.minimum.reduce(so_far[k][:, :, None] + both_ways[k], axis=1, out=so_far[k + 1])
    return so_far[:, 0, :, None] + cost + so_far[::-1, 1, None]


def _cheapest(cost: Costs) -> Int[np.ndarray, " steps"]:
    # Return the configuration in each row on the cheapest path. Paths begin and end at configuration 0, as in
    # ``_least_cost_through``.
    size = cost.shape[1]
    so_far = np.full(size, np.inf)
    so_far[0] = 0.0
    previous = np.empty((len(cost), size), dtype=np.intp)
    for k, motion_costs in enumerate(cost):
        total = so_far[:, None] + motion_costs
        previous[k] = total.argmin(axis=0)
        so_far = total[previous[k], np.arange(size)]
    places = np.zeros(len(cost) + 1, dtype=np.intp)
    for k in range(len(cost) - 1, -1, -1):
        places[k] = previous[k, places[k + 1]]
    return places
