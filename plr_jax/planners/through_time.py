"""Planning of one robot among other robots through time, on a timetable whose rows are equally far apart in time.

A robot may depart at any row, along a lattice motion or straight, at unit speed. A motion takes as many rows as it
needs at that speed. In the other searches, all robots make one lattice motion in each step. Reference: Silver,
"Cooperative pathfinding", 2005.
"""

import heapq

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csgraph, csr_array

from plr_jax._arrays import IndexPairs, batches, path_from_root, ragged_indices, require_time
from plr_jax._problem import JointPath, Problem, row_times, straight_costs
from plr_jax.collision.motions import Booleans, JointMotionTest, Rows, TeamTrajectory, circles
from plr_jax.planners.lattice import Lattice, cell_grid
from plr_jax.robots import between

ROWS_PER_STEP = 2.8  # a step of the lattice takes 3 rows and a diagonal one 4, close to unit speed
_WAIT = 3  # rows of a wait; each node is reached at most once in so many rows
_BATCH = 16  # states expanded at once
_ROOM = 4  # distance from walls, in radii, at which a resting robot leaves room for another to pass
_AHEAD = 32  # most waypoints that a straight motion skips
_ROUNDING = 1e-9
Configurations = Float[np.ndarray, "m dof"]
Motion = Float[np.ndarray, "rows dof"]


class Timetable:
    """A team's configurations, one row per time step; robots at rest stop blocking others after ``patience`` rows.

    ``path`` has the configurations, ``ends`` the row in which each robot comes to rest.
    """

    def __init__(self, problem: Problem, path: JointPath, patience: float | int = np.inf, deadline: float = np.inf):
        self.problem, self.patience = problem, patience
        self.test = JointMotionTest(problem.workspace, problem.robots, deadline)
        # For each robot, the row in which it comes to rest, the one after the last row that differs from its end.
        moves = (path != path[-1]).any(axis=2)
        self.ends = np.where(moves.any(axis=0), len(path) - moves[::-1].argmax(axis=0), 0)
        self.ignored: set[int] = set()  # robots without a planned motion, which block nobody
        self._last = len(path) - 1
        # The last row occurs twice, so that a motion begins in each row up to the last.
        self._trajectory = TeamTrajectory(problem.robots, np.concatenate([path, path[-1:]]))

    @property
    def path(self) -> JointPath:
        return self._trajectory.path[: int(self.ends.max()) + 1]

    def move(self, i: int, q: Motion) -> None:
        """Replace robot ``i``'s motion by ``q``, of any number of rows; other robots must avoid it from now on."""
        if len(q) > self._last + 1:
            more = np.repeat(self._trajectory.path[-1:], len(q) - self._last - 1, axis=0)
            self._last = len(q) - 1
            self._trajectory = TeamTrajectory(self.problem.robots, np.concatenate([self._trajectory.path, more]))
        whole = self._trajectory.path[:, i].copy()  # keeps the heading of a robot without one
        whole[: len(q), : q.shape[1]], whole[len(q) :, : q.shape[1]] = q, q[-1]
        self._trajectory.move(i, whole)
        self.ends[i] = len(q) - 1
        self.ignored.discard(i)

    def are_free(self, i: int, begin: Configurations, end: Configurations, row: Rows, count: Rows) -> Booleans:
        """Return whether robot ``i`` meets no other robot on each straight motion from ``begin[k]`` to ``end[k]``.

        The motion begins in row ``row[k]`` of the timetable and takes ``count[k]`` time steps.
        """
        # Cut motions into pieces of one time step each, and test these.
        motion, step = ragged_indices(count)
        num_steps = count[motion, None]
        first, last = (between(begin[motion], end[motion], (step[:, None] + ahead) / num_steps) for ahead in (0, 1))
        piece, _ = self._meetings(i, first, last, row[motion] + step)
        is_free = np.ones(len(begin), dtype=bool)
        is_free[motion[piece]] = False
        return is_free

    def meetings(self, i: int, q: Motion) -> IndexPairs:
        """Return all collisions with other robots if robot ``i`` follows ``q`` from row 0 on, and then rests.

        The results are two arrays with an entry for each collision: its time step, and the other robot's index.
        """
        row = np.arange(max(self._last + 1, len(q)))
        first, last = (q[np.minimum(row + ahead, len(q) - 1)] for ahead in (0, 1))
        piece, other = self._meetings(i, first, last, row)
        return row[piece], other

    def next_free_rows(self, i: int, q: Float[np.ndarray, " dof"]) -> Float[np.ndarray, " rows"]:
        """Return, for each row, the first row at or after it in which robot ``i`` may come to rest at ``q``.

        The robot may come to rest if no other robot meets it at ``q`` for ``patience`` rows. The result is ``inf`` if
        there is no such row.
        """
        # Robots at rest block `q` for `patience` rows after the last row.
        row = np.arange(self._last + 1 + (int(self.patience) + 1 if self.patience < np.inf else 0))
        stay = np.repeat(q[None], len(row), axis=0)
        is_taken = np.zeros(len(row), dtype=bool)
        is_taken[self._meetings(i, stay, stay, row)[0]] = True
        # For each row, the next one in which `q` is taken; then the next row with enough rows before that.
        until = np.minimum.accumulate(np.where(is_taken, row, np.inf)[::-1])[::-1]
        return np.minimum.accumulate(np.where(until - row >= self.patience, row, np.inf)[::-1])[::-1]

    def _meetings(self, i: int, first: Configurations, last: Configurations, row: Rows) -> IndexPairs:
        # The pieces of motions, one time step each, that meet a robot, and this robot. A robot at rest blocks others
        # for `patience` rows.
        first_row = np.minimum(row, self._last)
        around = circles(first[:, None], last[:, None])
        piece, j = self._trajectory.robots_near(i, around, first_row, list(self.ignored))
        is_present = row[piece] < self.ends[j] + self.patience
        piece, j = piece[is_present], j[is_present]
        meet = self.test.meet(i, first[piece], last[piece], self._trajectory, first_row[piece], j)
        return piece[meet], j[meet]


def subdivided(problem: Problem, path: JointPath, length: float) -> Float[np.ndarray, "more robots dof"]:
    """Divide each motion of a path into equal parts that take at most the time ``length`` at unit speed.

    The rows of the path stay.
    """
    count = np.maximum(_num_rows(np.diff(row_times(problem, path)), length), 1).astype(int)
    motion, step = ragged_indices(count)
    finer = between(path[motion], path[motion + 1], (step / count[motion])[:, None, None])
    finer[step == 0] = path[:-1]
    return np.concatenate([finer, path[-1:]])


def _num_rows(cost: Float[np.ndarray, "*n"], length: float) -> Float[np.ndarray, "*n"]:
    return np.ceil(cost / length - _ROUNDING)


def plan_through_time(timetable: Timetable, i: int, step: float, max_states: int) -> tuple[Motion | None, bool]:
    """Plan robot ``i``'s motion to its goal through a timetable by A*; return the motion, and whether it arrives.

    The lattice has cells of size ``step``. At the motion's end, the robot must be free to rest for
    ``timetable.patience`` time steps. If no path is found after about ``max_states`` expanded states, the motion ends
    at a reached configuration where the robot may rest: one far from walls if possible, and near the goal. If the
    robot may rest nowhere, the motion is None.
    """
    problem, robot, deadline = timetable.problem, timetable.problem.robots[i], timetable.test.deadline
    length = step / ROWS_PER_STEP  # of a motion that takes one row
    weight = float(problem.rotation_weights[i])
    # 1. Build the robot's lattice. Find the rows that each motion takes (inf: blocked), and the rows `to_go` from
    #    each node to the goal if the robot is alone.
    start, goal = timetable.path[:1, i, : robot.dof], problem.goals[[i], : robot.dof]
    motions = cell_grid(problem.workspace, robot, weight, step, deadline)
    lattice = Lattice(motions.with_terminals(robot, np.zeros(1, int), start, goal), 0)
    child, q = lattice.child, lattice.q
    duration = _num_rows(lattice.cost, length)
    is_free = np.isfinite(duration)
    first = np.append(0, np.cumsum(is_free.sum(axis=1)))  # of each node's motions
    graph = csr_array((duration[is_free], child[is_free], first), shape=(len(child), len(child)))
    to_go = csgraph.dijkstra(graph.T, indices=lattice.goal)
    duration[:, 0] = _WAIT
    free_from = timetable.next_free_rows(i, q[lattice.goal])  # by row: the next row from which the goal is free

    # The A* value of a state: the first row in which the robot, alone from now on, can come to the goal to stay.
    def soonest(node: Int[np.ndarray, "*n"], row: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        arrival = row + to_go[node]
        return np.maximum(arrival, free_from[np.minimum(arrival, len(free_from) - 1).astype(int)])

    # 2. Search by A*, a batch of states at a time. A state is a node and a row, and the index of its parent.
    nodes, rows, parents = [lattice.start], [0], [-1]
    open_states = [(float(soonest(np.array([lattice.start]), np.zeros(1))[0]), to_go[lattice.start], 0)]
    visited = {(lattice.start, 0)}  # nodes, and rows divided by _WAIT
    # Row of the earliest arrival so far, and its state.
    best, arrived = (0, 0) if lattice.start == lattice.goal and free_from[0] == 0 else (np.inf, -1)
    num_expanded = 0
    while open_states and open_states[0][0] < best and num_expanded < max_states:
        require_time(deadline, "a robot was planned")
        batch = [heapq.heappop(open_states)[2] for _ in range(min(len(open_states), _BATCH))]
        num_expanded += len(batch)
        # Find motions that may lead to an earlier arrival: `k` is the index of the parent in the batch.
        begin, since = np.array([nodes[state] for state in batch]), np.array([rows[state] for state in batch])
        end, until = child[begin], since[:, None] + duration[begin]
        arrival = soonest(end, until)
        k, primitive = np.nonzero(arrival < best)
        end, until, arrival = (column[k, primitive] for column in (end, until, arrival))
        until = until.astype(int)
        # Keep the motions to states that are not visited yet, on which the robot meets nobody.
        keys = list(zip(end.tolist(), (until // _WAIT).tolist(), strict=True))
        new = np.array([n for n, key in enumerate(keys) if key not in visited], dtype=int)
        begin, since = begin[k[new]], since[k[new]]
        for n in new[timetable.are_free(i, q[begin], q[end[new]], since, until[new] - since)].tolist():
            if keys[n] not in visited:
                visited.add(keys[n])
                if end[n] == lattice.goal and arrival[n] == until[n]:
                    best, arrived = until[n], len(nodes)
                heapq.heappush(open_states, (float(arrival[n]), float(to_go[end[n]]), len(nodes)))
                nodes.append(int(end[n]))
                rows.append(int(until[n]))
                parents.append(batch[k[n]])
    # 3. Else find a state near the goal where the robot may rest, best away from walls, so that others can pass.
    last = arrived
    node, row = np.array(nodes), np.array(rows)
    if last < 0:
        is_narrow = problem.workspace.clearance(q[node, :2]) < _ROOM * robot.circumscribed_radius
        for state in batches(np.lexsort((to_go[node], is_narrow)), _BATCH):  # by `is_narrow`, then by `to_go`
            count = np.full(len(state), int(min(timetable.patience, len(timetable.path))))
            if (may_rest := timetable.are_free(i, q[node[state]], q[node[state]], row[state], count)).any():
                last = int(state[may_rest.argmax()])
                break
        else:
            return None, False
    # 4. Follow the path from the start to this state.
    chain = path_from_root(parents, last)
    return _straightened(timetable, i, weight, length, q[node[chain]], row[chain]), arrived >= 0


def _straightened(timetable: Timetable, i: int, weight: float, length: float, q: Configurations, row: Rows) -> Motion:
    """Return robot ``i``'s motion along waypoints ``q``, with straight motions that skip waypoints where possible.

    The result has a configuration per time step (row of the timetable). The robot reaches each waypoint ``q[k]`` that
    is not skipped in row ``row[k]`` or earlier, and waits there if it cannot go on yet. In a time step it moves by
    ``length``, with turns weighted by ``weight``.
    """
    walls, deadline = timetable.test.wall_tests[i], timetable.test.deadline
    parts = [q[:1]]
    at, now = 0, 0  # waypoint and row that the motion has reached
    while at < len(q) - 1:
        # 1. Find straight motions to later waypoints that arrive in time and hit no wall.
        ahead = np.arange(at + 1, min(at + _AHEAD, len(q) - 1) + 1)
        begin = np.repeat(q[[at]], len(ahead), axis=0)
        count = _num_rows(straight_costs(begin, q[ahead], weight), length).astype(int)
        early = np.flatnonzero(now + count <= row[ahead])
        early = early[walls(begin[early], q[ahead[early]], deadline)]
        ahead, count, begin = ahead[early], count[early], begin[early]
        # 2. Keep the motions on which the robot meets nobody, also while it waits at the end until the waypoint's
        #    row.
        since = np.full(len(ahead), now)
        is_possible = timetable.are_free(i, begin, q[ahead], since, count)
        is_possible &= timetable.are_free(i, q[ahead], q[ahead], since + count, row[ahead] - now - count)
        # 3. Go to the farthest of these waypoints, else wait. The wait ends at the latest in the waypoint's row, from
        #    which the lattice motion to the next waypoint is possible.
        if is_possible.any():
            farthest = np.flatnonzero(is_possible)[-1]
            at, steps = int(ahead[farthest]), int(count[farthest])
            parts.append(between(parts[-1][-1:], q[[at]], np.arange(1, steps + 1)[:, None] / max(steps, 1)))
            if steps:
                parts[-1][-1] = q[at]  # without rounding
        else:
            steps = min(_WAIT, int(row[at]) - now)
            parts.append(np.repeat(q[[at]], steps, axis=0))
        now += steps
    return np.concatenate(parts)
