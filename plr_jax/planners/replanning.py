"""Replanning of moving teams: after goals or walls change (``replan``), or as new goals arrive (``lifelong``)."""

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from jaxtyping import Float, Int

from plr_jax._arrays import as_number, as_numbers, require_function, require_integer, shortened
from plr_jax._problem import ROUNDING, JointPath, Problem, motion_costs, row_times, settled_pose, straight_costs
from plr_jax._progress import Progress
from plr_jax._types import ArrayLike
from plr_jax.collision.motions import motions_apart
from plr_jax.planners._solution import Solution, Stats, Status, make_solution, straight_line_bound
from plr_jax.planners.driver import DEFAULTS, bl_plan, first_step
from plr_jax.planners.searches import BLOptions, require_problem_and_options
from plr_jax.planners.through_time import ROWS_PER_STEP, Motion, Timetable, plan_through_time, subdivided

NextGoalFn: TypeAlias = Callable[[int, Float[np.ndarray, "others dof"]], ArrayLike]
PlanFn: TypeAlias = Callable[[Problem], Solution]
_ATTEMPTS = 3  # most plans per robot of the team, or per waiting robot, before the whole team is planned
# For `replan`:
_MOST_STATES = 20_000  # most states expanded for one robot
# For `lifelong`, whose time is counted in rows of the timetable:
_WINDOW = 15  # rows after which waiting robots are replanned at the latest
_PATIENCE = 2 * _WINDOW  # rows for which a robot that has arrived, or waits, blocks others
_FEW_STATES = 600  # most states expanded for one robot, which otherwise goes only part of its way
_LATE = 10  # rows later than on a straight line, above which a robot is replanned
_MOST_IDLE = 5  # how often the next arrival is put off, or none is planned, before the whole team is planned


def replan(
    problem: Problem, solution: Solution, at: float | int, options: BLOptions = DEFAULTS, standing: Sequence[int] = ()
) -> Solution:
    """Replan a moving team after a change; robots keep motions that still lead to their goals, if possible.

    Use it when goals or walls have changed, or robots have broken down::

        problem = Problem(workspace, robots, solution.path_at(time), new_goals)
        solution = replan(problem, solution, time)

    Robots that keep their routes may get other times, so all must switch to the new path at once. A robot is
    replanned if its motion does not end at its goal, or hits an obstacle or a standing robot. If such a robot finds
    no path among the other robots, robots in its way are replanned too. :func:`bl_plan` plans the whole team if the
    replanning fails or the new path costs more than ``options.cost_factor`` allows.

    Args:
        problem: The workspace as it is now, the new goals, and as starts ``solution.path_at(at)``.
        solution: The current motion of the same robots, from any planner.
        at: The time since the start of the solution's path, at least 0; after its makespan, robots are at its end.
        options: ``step``, ``time_limit``, ``lower_bound`` and ``cost_factor`` apply. If :func:`bl_plan` plans the
            whole team, all options apply, and the time limit starts again. If replanning has found a path, too, the
            cheaper one of both paths is returned.
        standing: Indices of robots that do not move; their goals must equal their starts. Other robots may make way
            and return, even if their goals are their starts. With standing robots, :func:`bl_plan` is not used.

    Returns:
        The solution from time ``at`` on, at unit speed. Its status is TIME_LIMIT if the limit was reached, or
        INTERRUPTED after Ctrl-C. With standing robots, it is EXHAUSTED if no path within the cost factor was found.
        In these cases, the path may be None.

    Raises:
        ValueError: If the solution has no finite path or other robots, the starts differ from
            ``solution.path_at(at)`` by more than the workspace's tolerance, or ``at`` or ``standing`` is invalid.
    """
    require_problem_and_options(problem, options)
    began = time.perf_counter()
    # 1. Check the standing robots.
    expected = f"standing must be indices of the {len(problem.robots)} robots"
    if not isinstance(standing, Iterable):
        raise ValueError(f"{expected}, as a list, got {shortened(standing)}.")
    for i in (robots := [*standing]):
        require_integer("standing", i, 0)
        if i >= len(problem.robots):
            raise ValueError(f"{expected}, got {i}.")
        if (problem.starts[i] != problem.goals[i]).any():
            goal, start = problem.goals[i].tolist(), problem.starts[i].tolist()
            raise ValueError(f"Robot {i} is to stand still: its goal must be its start {start}, got {goal}.")
    fixed = {*robots}
    # 2. Find the part of the path that remains at that time.
    if not isinstance(solution, Solution) or solution.path is None or solution.times is None:
        raise ValueError(f"solution must be a Solution that has a path, got {shortened(solution)}.")
    if solution.path.shape[1:] != problem.starts.shape:
        expected = f"the problem's robots, of shape {problem.starts.shape}"
        raise ValueError(f"solution must be for {expected}, got a path for {solution.path.shape[1:]}.")
    if not np.isfinite(solution.path).all():
        raise ValueError("solution must have a finite path, got one with NaN or infinity.")
    as_number("at", at, "a finite time of at least 0", lambda time: 0 <= time < np.inf)
    apart = motion_costs(problem, solution.path_at(at), problem.starts)
    if (apart > problem.workspace.tolerance).any():
        i = int(apart.argmax())
        where = f"where the solution has the robots then, solution.path_at({at:g})"
        raise ValueError(f"starts must be {where}: robot {i} is {apart[i]:.3g} away from there.")
    remaining = np.concatenate([problem.starts[None], solution.path[solution.times > at]])
    # 3. Replan robots whose motions no longer lead to their goals.
    step = options.step or first_step(problem)
    path = subdivided(problem, remaining, step / ROWS_PER_STEP)
    timetable = Timetable(problem, path, deadline=began + options.time_limit)
    try:
        status = Status.SOLVED if _replan(problem, timetable, step, fixed) else Status.EXHAUSTED
    except TimeoutError:
        status = Status.TIME_LIMIT
    except KeyboardInterrupt:
        status = Status.INTERRUPTED
    path = timetable.path if status is Status.SOLVED else None
    stats = Stats(0, seconds={"replan": time.perf_counter() - began}, found_by="replan")
    lower_bound = max(options.lower_bound, straight_line_bound(problem))
    repaired = make_solution(problem, path, lower_bound, status, stats, problem.starts[None].copy())
    # 4. If there is no path, or only one that costs too much, plan the whole team.
    if status is Status.SOLVED and repaired.cost > (1 + ROUNDING) * options.cost_factor * lower_bound:
        status = Status.EXHAUSTED
    if status is not Status.EXHAUSTED or fixed:
        return replace(repaired, status=status)
    planned = bl_plan(problem, options=options)
    if repaired.cost < planned.cost:
        return replace(repaired, lower_bound=planned.lower_bound, status=planned.status)
    return planned


def _replan(problem: Problem, timetable: Timetable, step: float, fixed: set[int]) -> bool:
    """Replan robots of a :class:`Timetable` until no motion collides and all motions end at the robots' goals.

    Return whether this worked. Robots ``fixed`` (indices) stand still. ``step`` is the cell size of the lattices.
    """
    # 1. Find the robots whose motions do not end at their goals, or hit a wall. They block nobody until replanned.
    num_robots, test = len(problem.robots), timetable.test
    todo = []
    for i in sorted({*range(num_robots)} - fixed):
        dof, q = problem.robots[i].dof, timetable.path[:, i]
        is_there = (q[-1, :dof] == problem.goals[i, :dof]).all()
        if not is_there or not test.wall_tests[i](q[:-1], q[1:], test.deadline).all():
            todo.append(i)
    timetable.ignored.update(todo)

    def make_way(i: int, motion: Motion) -> None:
        # Replan the robots that collide with this motion, and ignore them until then.
        others = sorted({*timetable.meetings(i, motion)[1].tolist()} - fixed)
        timetable.ignored.update(others)
        todo.extend(others)

    # 2. Let fixed robots stand, then let all others make way for them.
    for i in fixed:
        timetable.move(i, timetable.path[:1, i])
    for i in fixed:
        make_way(i, timetable.path[:, i])
    # 3. Replan one robot after the other. A robot that finds no path among all other robots is planned among the
    #    fixed robots alone, and robots in its way are replanned after it.
    for _ in range(_ATTEMPTS * num_robots):
        if not todo:
            return True
        i = todo.pop(0)
        motion, arrives = plan_through_time(timetable, i, step, _MOST_STATES)
        if motion is None or not arrives:
            ignored = timetable.ignored
            timetable.ignored = {*range(num_robots)} - fixed
            motion, arrives = plan_through_time(timetable, i, step, _MOST_STATES)
            timetable.ignored = ignored
            if motion is None or not arrives:
                return False
            make_way(i, motion)
        timetable.move(i, motion)
    return False


@dataclass(frozen=True, eq=False)
class LifelongRun:
    """Result of :func:`lifelong`: the motions of a team, and the goals that it served.

    Args:
        problem: The problem from the first row of ``path`` to its last, for ``validate(run.problem, run.path)``.
        path: Joint configurations ``(rows, robots, dof)``, as in a :class:`Solution`.
        times: Time at which the path reaches each row, ``(rows,)``, from 0 on.
        robots: The index of the robot that served each goal, ``(goals,)``, in the order of service.
        goals: The served goals, ``(goals, dof)``.
        rows: The index of the row of ``path`` in which each goal was reached, ``(goals,)``.
        seconds: CPU seconds of each replanning, ``(replans,)``.
        num_from_nothing: How often the whole team was planned, including the first time.
        status: SOLVED if ``num_goals`` goals were served, INTERRUPTED, or the reason why the team has no path.
    """

    problem: Problem
    path: JointPath
    times: Float[np.ndarray, " rows"]
    robots: Int[np.ndarray, " goals"]
    goals: Float[np.ndarray, "goals dof"]
    rows: Int[np.ndarray, " goals"]
    seconds: Float[np.ndarray, " replans"]
    num_from_nothing: int
    status: Status


def lifelong(
    problem: Problem, next_goal: NextGoalFn, num_goals: int, options: BLOptions = DEFAULTS, plan: PlanFn | None = None
) -> LifelongRun:
    """Run a team whose goals keep coming: a robot that arrives gets its next goal, while the other robots go on.

    :func:`bl_plan` plans the team once. Afterwards, each robot with a new goal is planned by itself while the other
    robots keep their motions. A robot that finds no path waits near its goal, or where it is, and is replanned later.
    If robots still find no path, the whole team is planned again. A robot whose next goal is where it stands serves
    this goal when the next robot arrives. Ctrl-C, or a team that cannot be planned, ends the function early; it then
    returns the run so far. Results are deterministic unless a time limit is reached.

    Args:
        problem: The robots, their starts, and their first goals.
        next_goal: A function of a robot's index and the goals of all other robots, ``(robots - 1, dof)``, that
            returns the robot's next goal, ``(dof,)``. The goal must be free and reachable. If it overlaps another
            robot's goal, the robot stays near its place until the other robot gets another goal, or the two robots
            swap places.
        num_goals: Number of goals to serve, at least 1. Goals reached at the same time may add a few more.
        options: Options of :func:`bl_plan`; the time limit applies to each replanning. Ignored if ``plan`` is given.
        plan: A planner, such as :func:`bl_plan`, that plans the whole team whenever a robot arrives. None: robots are
            planned one by one, as described above.

    Raises:
        ValueError: If ``num_goals`` is invalid, or a goal has a wrong shape, is not free, or is cut off by obstacles.

    Reference: Li et al., "Lifelong multi-agent path finding in large-scale warehouses", 2021.
    """
    require_problem_and_options(problem, options)
    require_integer("num_goals", num_goals, 1)
    require_function("next_goal", next_goal)
    require_function("plan", plan or bl_plan)
    team = _LifelongTeam(problem, options, plan)
    with Progress("lifelong", "goals", num_goals) as progress:
        try:
            status = team.plan_from_nothing()
            while status is Status.SOLVED and len(team.served) < num_goals:
                arrived = team.advance()
                progress.update(len(arrived))
                for i in arrived:
                    team.assign(i, next_goal(i, np.delete(team.requested_goals, i, axis=0)))
                status = team.replan()
        except KeyboardInterrupt:
            status = Status.INTERRUPTED
    return team.result(status)


class _LifelongTeam:
    """State of a lifelong run: the team's planned motions, its goals, and a record of the motions made so far."""

    def __init__(self, problem: Problem, options: BLOptions, plan: PlanFn | None):
        # The problem's goals are the possible ones: unlike the requested goals, they never overlap.
        self.problem, self.options, self.plan = problem, options, plan
        self.path = problem.starts[None]  # from now on
        has_axis = np.arange(problem.dof) < np.array([[robot.dof] for robot in problem.robots])
        self.requested_goals = np.where(has_axis, problem.goals, problem.starts)  # robots without a heading keep it
        self.step = options.step or first_step(problem)
        self.length = self.step / ROWS_PER_STEP
        self.served: list[tuple[int, int, Float[np.ndarray, " dof"]]] = []  # robot, row and goal
        self._done, self._num_rows = [problem.starts[None]], 0  # parts of the path until now, and its motions
        self._seconds: list[float] = []
        self._since = np.zeros(len(problem.robots))  # row at which each robot got its goal
        self._hurried = np.full(len(problem.robots), -_WINDOW)  # row of each robot's last replan for lateness
        self._num_from_nothing = 0
        self._num_idle = 0  # how often the next planned arrival was put off, or none was planned
        self._due = np.inf  # row of the next planned arrival

    def plan_from_nothing(self) -> Status:
        """Plan the whole team without regard to its present plan; return SOLVED, or why there is no path."""
        plan = self.plan or (lambda problem: bl_plan(problem, options=self.options))
        solution = plan(replace(self.problem, starts=self.path[0]))
        self._num_from_nothing += 1
        self._num_idle = 0
        if solution.path is None or solution.status is Status.INTERRUPTED:
            return solution.status
        self.path = solution.path if self.plan else subdivided(self.problem, solution.path, self.length)
        return Status.SOLVED

    def advance(self) -> list[int]:
        """Move the team until a robot arrives or replanning is due; return the indices of the robots that arrive."""
        # 1. Find the next row in which a robot arrives, else the last row, or the present one if all robots are at
        #    their goals. A robot that is at its goal now is served with the next one that arrives, so that no other
        #    robot starves.
        is_there = (self.path == self.requested_goals).all(axis=2)
        arrivals = np.flatnonzero(is_there[:, ~is_there[0]].any(axis=1))
        arrival = int(arrivals[0]) if len(arrivals) else 0 if is_there[0].all() else len(self.path) - 1
        # 2. Move the team to this row, or to the row in which waiting robots are replanned at the latest.
        row = arrival if self.plan else min(arrival, _WINDOW)
        self._done.append(self.path[1 : row + 1])
        self._num_rows += row
        self.path = self.path[row:]
        # 3. Serve the robots that are at their goals now, unless the next one arrives later.
        arrived = [] if len(arrivals) and row < arrival else np.flatnonzero(is_there[row]).tolist()
        self.served += [(i, self._num_rows, self.requested_goals[i].copy()) for i in arrived]
        return arrived

    def assign(self, i: int, goal: ArrayLike) -> None:
        expected = f"numbers of shape ({self.problem.dof},)"
        if (shape := as_numbers(f"The next goal of robot {i}", goal, expected).shape) != (self.problem.dof,):
            raise ValueError(f"The next goal of robot {i} must be {expected}, got shape {shape}.")
        robot = self.problem.robots[i]
        # Without the heading if the robot has none.
        self.requested_goals[i, : robot.dof] = settled_pose(self.problem.workspace, robot, goal)[: robot.dof]
        self._since[i] = self._num_rows
        self._due, self._num_idle = np.inf, 0

    def replan(self) -> Status:
        """Replan the team's motions from its present configurations to its goals; return SOLVED, or why this failed.

        Some requested goals are replaced: see :meth:`_possible_goals`.
        """
        began = time.process_time()
        if ((goals := self._possible_goals()) != self.problem.goals).any():
            self.problem = replace(self.problem, starts=self.path[0], goals=goals)
        try:
            status = self.plan_from_nothing() if self.plan else self._replan_waiting()
        except TimeoutError:
            status = Status.TIME_LIMIT
        self._seconds.append(time.process_time() - began)
        return status

    def result(self, status: Status) -> LifelongRun:
        """Return the run so far: a path from the first starts to the present configurations, and the goals served."""
        path = np.concatenate(self._done)
        problem = replace(self.problem, starts=path[0], goals=path[-1])
        robots, rows = (np.array([entry[k] for entry in self.served], dtype=np.intp) for k in (0, 1))
        goals = np.array([goal for *_, goal in self.served]).reshape(-1, problem.dof)
        times, seconds = row_times(problem, path), np.array(self._seconds)
        return LifelongRun(problem, path, times, robots, goals, rows, seconds, self._num_from_nothing, status)

    def _possible_goals(self) -> Float[np.ndarray, "robots dof"]:
        """Return each robot's requested goal, or its previous goal if bodies would overlap at the requested one."""
        # Going back to a previous goal may cause another overlap, so all new goals are then tested again. This ends,
        # since previous goals never overlap, and a goal that went back stays.
        robots, tolerance = self.problem.robots, self.problem.workspace.tolerance
        size = np.array([robot.circumscribed_radius for robot in robots])
        goals, before = self.requested_goals.copy(), self.problem.goals
        new = np.flatnonzero((goals != before).any(axis=1)).tolist()
        while new:
            i = new.pop()
            near = np.flatnonzero(np.hypot(*(goals - goals[i])[:, :2].T) < size + size[i])
            q = goals[:, None]
            pairs = ((robots[i], q[i], q[i], robots[j], q[j], q[j]) for j in near.tolist() if j != i)
            if not all(motions_apart(*pair, tolerance).all() for pair in pairs):
                goals[i] = before[i]
                new = np.flatnonzero((goals != before).any(axis=1)).tolist()
        return goals

    def _replan_waiting(self) -> Status:
        """Replan robots whose motions soon end short of their goals, robots in their way, and the most delayed robot.

        Plan the whole team if this takes too many attempts. Return SOLVED, or why there is no path.
        """
        problem = self.problem
        timetable = Timetable(problem, self.path, _PATIENCE, time.perf_counter() + self.options.time_limit)
        # 1. Count how often the next arrival was put off, or none is planned. Robots that wait, or stand at their
        #    goals, do not arrive.
        waits = (self.path[-1] != self.requested_goals).any(axis=1)
        due = self._num_rows + np.where(waits | (timetable.ends == 0), np.inf, timetable.ends).min()
        self._num_idle += due > self._due or due == np.inf
        self._due = due
        # 2. Replan the robots whose motions soon end before their goals, in the order in which they got their goals.
        todo = np.flatnonzero(waits & (timetable.ends <= _WINDOW))
        todo = todo[np.argsort(self._since[todo], kind="stable")].tolist()
        num_left = 0 if self._num_idle > _MOST_IDLE else _ATTEMPTS * len(todo)
        while todo:
            if not num_left:
                return self.plan_from_nothing()
            i = todo.pop(0)
            num_left -= 1
            motion, _ = plan_through_time(timetable, i, self.step, _FEW_STATES)
            if motion is None:
                # The robot stays in place. Robots that would have passed there are replanned.
                motion = self.path[:1, i, : problem.robots[i].dof]
                row, other = timetable.meetings(i, motion)
                todo += sorted({*other[row < _PATIENCE].tolist()} - {*todo})
            timetable.move(i, motion)
        # 3. Replan the robot that arrives latest, compared to its straight line. Keep the plan if it is no slower.
        is_bound = (timetable.path[-1] == self.requested_goals).all(axis=1)
        straight = straight_costs(self.path[0], self.requested_goals, problem.rotation_weights) / self.length
        late = np.where(is_bound & (self._num_rows >= self._hurried + _WINDOW), timetable.ends - straight, 0.0)
        i = int(late.argmax())
        if late[i] > _LATE:
            self._hurried[i] = self._num_rows
            motion, arrives = plan_through_time(timetable, i, self.step, _FEW_STATES)
            if motion is not None and arrives and len(motion) <= timetable.ends[i]:
                timetable.move(i, motion)
        self.path = timetable.path
        return Status.SOLVED
