"""Planning of one robot among the others through time, on a timetable whose rows all take the same time.

A robot may depart at any row, along a lattice motion or straight, at unit speed. A motion takes as many rows as it
needs at that speed, so robots do not move in step as in the other searches (Silver, "Cooperative pathfinding", 2005).
"""

import heapq
import math

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from plr_jax._arrays import ragged_indices, require_time
from plr_jax._problem import Problem, row_times, straight_costs
from plr_jax.collision.motions import JointMotionTest, TeamTrajectory, circles
from plr_jax.planners.lattice import Lattice, cell_grid
from plr_jax.robots.robot import between

ROWS_PER_STEP = 2.8  # a step of the lattice takes 3 rows and a diagonal one 4, close to unit speed
_WAIT = 3  # rows of a wait; each node is reached at most once in so many rows
_BATCH = 16  # states expanded at once
_ROOM = 4  # distance from walls, in radii, at which a resting robot leaves room for another to pass
_AHEAD = 32  # most waypoints that a straight motion skips
_ROUNDING = 1e-9
Rows = Int[np.ndarray, "m"]
Meetings = tuple[Int[np.ndarray, " meetings"], Int[np.ndarray, " meetings"]]
Configurations = Float[np.ndarray, "m dof"]
Motion = Float[np.ndarray, "rows dof"]
Configuration = Float[np.ndarray, "dof"]
JointPath = Float[np.ndarray, "rows robots dof"]


class Timetable:
    """A team's configurations, one row per time step; robots at rest stop blocking others after ``patience`` rows."""

    def __init__(
        self, problem: Problem, path: JointPath, patience: float | int = math.inf, deadline: float = math.inf
    ):
        self.problem, self.patience = problem, patience
        self.test = JointMotionTest(problem.workspace, problem.robots, deadline)
        moves = (path != path[-1]).any(axis=2)
        # For each robot, the row in which it comes to rest.
        self.ends = np.where(moves.any(axis=0), len(path) - moves[::-1].argmax(axis=0), 0)
        self.ignored: set[int] = set()  # robots without a planned motion, which block nobody
        self._last = len(path) - 1
        self._trajectory = TeamTrajectory(problem.robots, np.concatenate([path, path[-1:]]))

    @property
    def path(self) -> JointPath:
        return self._trajectory.path[: int(self.ends.max()) + 1]

    def move(self, i: int, q: Motion) -> None:
        """Replace robot ``i``'s motion by ``q``, of any number of rows; others must respect it from now on."""
        if len(q) > self._last + 1:
            more = np.repeat(self._trajectory.path[-1:], len(q) - self._last - 1, axis=0)
            self._last, path = len(q) - 1, np.concatenate([self._trajectory.path, more])
            self._trajectory = TeamTrajectory(self.problem.robots, path)
        whole = self._trajectory.path[:, i].copy()  # keeps the heading of a robot without one
        whole[: len(q), : q.shape[1]], whole[len(q) :, : q.shape[1]] = q, q[-1]
        self._trajectory.move(i, whole)
        self.ends[i] = len(q) - 1
        self.ignored.discard(i)

    def are_free(
        self, i: int, begin: Configurations, end: Configurations, row: Rows, count: Rows
    ) -> Bool[np.ndarray, " m"]:
        """Return whether robot ``i`` meets nobody on straight motions of ``count`` time steps from ``row`` on."""
        owner, step = ragged_indices(count)
        num_steps = count[owner, None]
        first, last = (between(begin[owner], end[owner], (step[:, None] + ahead) / num_steps) for ahead in (0, 1))
        piece, _ = self._meetings(i, first, last, row[owner] + step)
        fits = np.ones(len(begin), dtype=bool)
        fits[owner[piece]] = False
        return fits

    def meetings(self, i: int, q: Motion) -> Meetings:
        """Return the time steps at which robot ``i`` meets others, on motion ``q`` or at rest after it, and whom."""
        row = np.arange(max(self._last + 1, len(q)))
        first, last = (q[np.minimum(row + ahead, len(q) - 1)] for ahead in (0, 1))
        piece, other = self._meetings(i, first, last, row)
        return row[piece], other

    def next_free_rows(self, i: int, q: Configuration) -> Float[np.ndarray, " rows"]:
        """Return, for each row, the first row, not earlier, from which ``q`` is free for ``patience`` rows."""
        # The row is inf if there is none. Nobody blocks the place for longer than the patience.
        row = np.arange(self._last + 1 + (int(self.patience) + 1 if self.patience < math.inf else 0))
        is_taken, at = np.zeros(len(row), dtype=bool), np.repeat(q[None], len(row), axis=0)
        is_taken[self._meetings(i, at, at, row)[0]] = True
        # For each row, the next one in which `q` is taken; then the first row with enough rows before that.
        until = np.minimum.accumulate(np.where(is_taken, row, np.inf)[::-1])[::-1]
        return np.minimum.accumulate(np.where(until - row >= self.patience, row, np.inf)[::-1])[::-1]

    def _meetings(self, i: int, first: Configurations, last: Configurations, row: Rows) -> Meetings:
        # The pieces of motions, one time step each, that meet a robot, and this robot. A robot at rest blocks others
        # for `patience` rows.
        around, first_row = circles(first[:, None], last[:, None]), np.minimum(row, self._last)
        piece, j = self._trajectory.robots_near(i, around, first_row, list(self.ignored))
        is_present = row[piece] < self.ends[j] + self.patience
        piece, j = piece[is_present], j[is_present]
        meet = self.test.meet(i, first[piece], last[piece], self._trajectory, first_row[piece], j)
        return piece[meet], j[meet]


def subdivided(problem: Problem, path: JointPath, length: float) -> Float[np.ndarray, "more robots dof"]:
    count = np.maximum(_num_rows(np.diff(row_times(problem, path)), length), 1).astype(int)
    motion, step = ragged_indices(count)
    finer = between(path[motion], path[motion + 1], (step / count[motion])[:, None, None])
    finer[step == 0] = path[:-1]
    return np.concatenate([finer, path[-1:]])


def _num_rows(cost: Float[np.ndarray, "*n"], length: float) -> Float[np.ndarray, "*n"]:
    return np.ceil(cost / length - _ROUNDING)


def plan_through_time(timetable: Timetable, i: int, step: float, max_states: int) -> tuple[Motion | None, bool]:
    """Plan robot ``i``'s motion to its goal through a timetable by A*; return the motion, and whether it arrives.

    The lattice has cells of size ``step``. At the motion's end, the robot must be free to rest for ``patience`` time
    steps. If no path is found within ``max_states`` states, the motion ends at the reached place nearest to the goal
    where the robot may rest. If there is no such place, the motion is None.
    """
    problem, robot, deadline = timetable.problem, timetable.problem.robots[i], timetable.test.deadline
    length, weight = step / ROWS_PER_STEP, float(problem.rotation_weights[i])
    # 1. Find the rows that each motion takes, and the rows from each node to the goal if the robot is alone.
    start, goal = timetable.path[:1, i, : robot.dof], problem.goals[[i], : robot.dof]
    motions = cell_grid(problem.workspace, robot, weight, step, deadline)
    lattice = Lattice(motions.with_terminals(robot, np.zeros(1, int), start, goal), 0)
    child, duration, q = lattice.child, _num_rows(lattice.cost, length), lattice.q
    leads = np.isfinite(duration)
    first = np.append(0, np.cumsum(leads.sum(axis=1)))
    graph = csr_array((duration[leads], child[leads], first), shape=(len(child), len(child)))
    to_go = dijkstra(graph.T, indices=lattice.goal)
    duration[:, 0] = _WAIT
    free = timetable.next_free_rows(i, q[lattice.goal])

    # The A* value of a state: the first row in which the robot, alone from now on, can come to the goal to stay.
    def soonest(node: Int[np.ndarray, "*n"], row: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        arrival = row + to_go[node]
        return np.maximum(arrival, free[np.minimum(arrival, len(free) - 1).astype(int)])

    # 2. Search nodes and rows by A*.
    nodes, rows, parents = [lattice.start], [0], [-1]
    open_states = [(float(soonest(np.array([lattice.start]), np.zeros(1))[0]), to_go[lattice.start], 0)]
    visited, best, arrived, num_expanded = {(lattice.start, 0)}, math.inf, -1, 0
    if lattice.start == lattice.goal and free[0] == 0:
        best, arrived = 0, 0
    while open_states and open_states[0][0] < best and num_expanded < max_states:
        require_time(deadline, "a robot was planned")
        batch = [heapq.heappop(open_states)[2] for _ in range(min(len(open_states), _BATCH))]
        num_expanded += len(batch)
        begin, row = np.array([nodes[k] for k in batch]), np.array([rows[k] for k in batch])
        target, until = child[begin], row[:, None] + duration[begin]
        at_best = soonest(target, until)
        place, primitive = np.nonzero(at_best < best)
        end, when, at_best = (column[place, primitive] for column in (target, until, at_best))
        when = when.astype(int)
        keys = list(zip(end.tolist(), (when // _WAIT).tolist(), strict=True))
        new = np.array([n for n, key in enumerate(keys) if key not in visited], dtype=int)
        first, since = begin[place[new]], row[place[new]]
        for n in new[timetable.are_free(i, q[first], q[end[new]], since, when[new] - since)].tolist():
            if keys[n] not in visited:
                visited.add(keys[n])
                if end[n] == lattice.goal and at_best[n] == when[n]:
                    best, arrived = when[n], len(nodes)
                heapq.heappush(open_states, (float(at_best[n]), float(to_go[end[n]]), len(nodes)))
                for column, entry in ((nodes, end[n]), (rows, when[n]), (parents, batch[place[n]])):
                    column.append(int(entry))
    # 3. Else find a state near the goal where the robot may rest, best away from walls, so that others can pass.
    last, at, when = arrived, np.array(nodes), np.array(rows)
    if last < 0:
        is_narrow = problem.workspace.clearance(q[at, :2]) < _ROOM * robot.circumscribed_radius
        order = np.lexsort((to_go[at], is_narrow))
        for begin in range(0, len(order), _BATCH):
            batch = order[begin : begin + _BATCH]
            count = np.full(len(batch), int(min(timetable.patience, len(timetable.path))))
            may_rest = timetable.are_free(i, q[at[batch]], q[at[batch]], when[batch], count)
            if may_rest.any():
                last = int(batch[may_rest.argmax()])
                break
        else:
            return None, False
    chain = [last]
    while parents[chain[-1]] >= 0:
        chain.append(parents[chain[-1]])
    chain.reverse()
    return _straightened(timetable, i, weight, length, q[at[chain]], when[chain]), arrived >= 0


def _straightened(timetable: Timetable, i: int, weight: float, length: float, q: Configurations, row: Rows) -> Motion:
    """Return robot ``i``'s motion along waypoints ``q``, with straight motions that skip waypoints where possible.

    The result has a configuration per time step (row of the timetable). The robot arrives at each waypoint that is
    left at the latest in the waypoint's ``row``, and waits there if it arrives early and cannot go on. In a time step
    it moves by ``length``, with turns weighted by ``weight``.
    """
    walls, deadline = timetable.test.wall_tests[i], timetable.test.deadline
    parts, at, now = [q[:1]], 0, 0
    while at < len(q) - 1:
        ahead = np.arange(at + 1, min(at + _AHEAD, len(q) - 1) + 1)
        begin = np.repeat(q[[at]], len(ahead), axis=0)
        count = _num_rows(straight_costs(begin, q[ahead], weight), length).astype(int)
        early = np.flatnonzero(now + count <= row[ahead])
        early = early[walls(begin[early], q[ahead[early]], deadline)]
        ahead, count, begin = ahead[early], count[early], begin[early]
        since = np.full(len(ahead), now)
        fits = timetable.are_free(i, begin, q[ahead], since, count)
        fits &= timetable.are_free(i, q[ahead], q[ahead], since + count, row[ahead] - now - count)
        if fits.any():
            farthest = np.flatnonzero(fits)[-1]
            at, steps = int(ahead[farthest]), int(count[farthest])
            parts.append(between(parts[-1][-1:], q[[at]], np.arange(1, steps + 1)[:, None] / max(steps, 1)))
            if steps:
                parts[-1][-1] = q[at]  # without rounding
            now += steps
        else:
            wait = min(_WAIT, int(row[at]) - now)
            parts.append(np.repeat(q[[at]], wait, axis=0))
            now += wait
    return np.concatenate(parts)
