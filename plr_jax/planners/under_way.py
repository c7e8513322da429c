"""Teams that are under way: planned from where everybody is, or as goals keep coming."""

import math
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from jaxtyping import Float, Int
from tqdm import tqdm

from plr_jax._arrays import as_number, as_numbers, require_function, require_integer, shortened
from plr_jax._problem import Problem, motion_costs, row_times, straight_costs
from plr_jax._types import ArrayLike
from plr_jax.collision.team import motions_apart
from plr_jax.planners._solution import (
    BLOptions,
    Solution,
    Stats,
    Status,
    make_solution,
    require_problem_and_options,
    straight_line_bound,
)
from plr_jax.planners.driver import bl_plan, first_step
from plr_jax.planners.through_time import ROWS_PER_STEP, JointPath, Motion, Timetable, plan_through_time, subdivided

_DEFAULT_OPTIONS = BLOptions()

# As few robots anew as may be.

_MOST_STATES = 20_000  # expanded for one robot
_ATTEMPTS = 3  # times as many robots are planned at most as the team has, or as wait, before all start from nothing


def replan(
    problem: Problem,
    solution: Solution,
    at: float | int,
    options: BLOptions = _DEFAULT_OPTIONS,
    standing: Sequence[int] = (),
) -> Solution:
    """Plan a team that is under way: robots keep what was planned for them, as far as it still leads to their goals.

    For when a few goals or a few walls have changed, or robots have broken down. A robot is planned anew if its
    motion does not end at its goal, hits an obstacle, or meets a robot that stands: by itself, through time, among
    the others, to be at its goal soonest. One that finds no way goes as if it were alone, and those whom it meets are
    planned anew in their turn. If that goes on for too long, :func:`bl_plan` plans all from nothing.

    Paths are for robots at unit speed, that need not move in step with one another. The lattices of a workspace are
    kept from call to call, as those of :func:`bl_plan`.

    Args:
        problem: What is to be done from now on: the workspace as it is now, the goals, and as starts the joint
            configuration of the solution at the time, ``solution.path_at(at)``.
        solution: What the team was doing, of any planner: a path for the same robots.
        at: The time since the path of the solution began, at least 0; past its makespan, all robots are at its end.
        options: ``step`` and the limit on time, which holds again for what is planned from nothing, under all
            options.
        standing: Robots that do not move from now on. Their goals must be their starts. Others whose goals are their
            starts may make way and come back. Where some stand, nothing is planned from nothing.

    Returns:
        The solution from here on. Its status is EXHAUSTED if no path was found beside robots that stand, TIME_LIMIT
        if the limit was reached before.

    Raises:
        ValueError: If the solution has no path or is for other robots, the starts are not where it has the robots at
            that time, to the tolerance of the workspace, the time is negative or not finite, or robots that stand are
            none of the team or have goals elsewhere.

    References:
        Silver, "Cooperative pathfinding", 2005.
    """
    require_problem_and_options(problem, options)
    began, num_robots = time.perf_counter(), len(problem.robots)
    # 1. The robots that stand, whose goals are where they start.
    expected = f"standing must be indices of the {num_robots} robots"
    if not isinstance(standing, Iterable):
        raise ValueError(f"{expected}, as a list, got {shortened(standing)}.")
    robots = [*standing]
    for i in robots:
        require_integer("standing", i, 0)
        if i >= num_robots:
            raise ValueError(f"{expected}, got {i}.")
        if (problem.starts[i] != problem.goals[i]).any():
            goal, start = problem.goals[i].tolist(), problem.starts[i].tolist()
            raise ValueError(f"Robot {i} is to stand still: its goal must be its start {start}, got {goal}.")
    fixed = {*robots}
    # 2. What is left of the path at that time.
    if not isinstance(solution, Solution) or solution.path is None or solution.times is None:
        raise ValueError(f"solution must be a Solution that has a path, got {shortened(solution)}.")
    if solution.path.shape[1:] != problem.starts.shape:
        expected = f"the problem's robots, of shape {problem.starts.shape}"
        raise ValueError(f"solution must be one for {expected}, got a path for {solution.path.shape[1:]}.")
    as_number("at", at, "a time of at least 0", lambda time: 0 <= time < math.inf)
    apart = motion_costs(problem, solution.path_at(at), problem.starts)
    if (apart > problem.workspace.tolerance).any():
        i = int(apart.argmax())
        where = f"where the solution has the robots then, solution.path_at({at:g})"
        raise ValueError(f"starts must be {where}: robot {i} is {apart[i]:.3g} away from there.")
    rest = np.concatenate([problem.starts[None], solution.path[solution.times > at]])
    # 3. Plan those anew whose motions do not lead to their goals any more.
    step = options.step or first_step(problem)
    timetable = Timetable(
        problem, subdivided(problem, rest, step / ROWS_PER_STEP), deadline=began + options.time_limit
    )
    try:
        status = Status.SOLVED if _replan(problem, timetable, step, fixed) else Status.EXHAUSTED
    except TimeoutError:
        status = Status.TIME_LIMIT
    except KeyboardInterrupt:
        status = Status.INTERRUPTED
    if status is Status.EXHAUSTED and not fixed:
        return bl_plan(problem, options=options)
    found = timetable.path if status is Status.SOLVED else None
    stats = Stats(0, seconds={"replan": time.perf_counter() - began}, found_by="replan")
    return make_solution(problem, found, straight_line_bound(problem), status, stats, problem.starts[None].copy())


def _replan(problem: Problem, timetable: Timetable, step: float, fixed: set[int]) -> bool:
    """Plan those anew whose motions do not lead to their goals any more; whether all have one that does."""
    num_robots, test = len(problem.robots), timetable.test
    todo = []
    for i in sorted({*range(num_robots)} - fixed):
        dof, q = problem.robots[i].dof, timetable.path[:, i]
        is_there = (q[-1, :dof] == problem.goals[i, :dof]).all()
        if not is_there or not test.wall_tests[i](q[:-1], q[1:], test.deadline).all():
            todo.append(i)
    timetable.ignored.update(todo)

    def make_way(i: int, motion: Motion) -> None:
        """Plan robots anew whose motions meet one; until then they are in nobody's way."""
        others = sorted({*timetable.meetings(i, motion)[1].tolist()} - fixed)
        timetable.ignored.update(others)
        todo.extend(others)

    for i in fixed:
        timetable.move(i, timetable.path[:1, i])
    for i in fixed:
        make_way(i, timetable.path[:, i])
    for _ in range(_ATTEMPTS * num_robots):
        if not todo:
            return True
        i = todo.pop(0)
        motion, arrives = plan_through_time(timetable, i, step, math.inf, _MOST_STATES)
        if motion is None or not arrives:
            others, timetable.ignored = timetable.ignored, {*range(num_robots)} - fixed
            motion, arrives = plan_through_time(timetable, i, step, math.inf, _MOST_STATES)
            timetable.ignored = others
            if motion is None or not arrives:
                return False
            make_way(i, motion)
        timetable.move(i, motion)
    return False


# Robots that arrive get their next goals while the others go on.

Goals: TypeAlias = Float[np.ndarray, "robots dof"]
NextGoal: TypeAlias = Callable[[int, Float[np.ndarray, "others dof"]], ArrayLike]
Planner: TypeAlias = Callable[[Problem], Solution]

_WINDOW = 15  # rows after which robots that wait are planned again at the latest
_PATIENCE = 2 * _WINDOW  # rows for which a robot that has arrived, or waits, is in the way of others
_FEW_STATES = 600  # expanded for one robot, which else goes but part of its way for now
_LATE = 10  # rows that a robot may be later than on a straight way, before it is planned again
_MOST_IDLE = 20  # windows in a row in which nobody is on its way to its goal, likewise


@dataclass(frozen=True, eq=False)
class LifelongRun:
    """What a team did while goals kept coming.

    Args:
        problem: From where the robots began to where they are in the end: ``validate(run.problem, run.path)`` checks
            all that they did.
        path: Joint configurations ``(rows, robots, dof)``, as those of a solution.
        times: When the path reaches its rows, ``(rows,)``, from 0 on.
        robots: Who served each goal, in the order in which they were served, ``(goals,)``.
        goals: These goals, ``(goals, dof)``.
        rows: The rows of the path at which they were reached, ``(goals,)``.
        seconds: CPU seconds of each replanning, ``(replans,)``.
        num_from_nothing: How often the whole team was planned from nothing, the first time among them.
        status: SOLVED if as many goals were served as were asked for; INTERRUPTED; or why there is no path for the
            team.
    """

    problem: Problem
    path: JointPath
    times: Float[np.ndarray, "rows"]
    robots: Int[np.ndarray, "goals"]
    goals: Float[np.ndarray, "goals dof"]
    rows: Int[np.ndarray, "goals"]
    seconds: Float[np.ndarray, "replans"]
    num_from_nothing: int
    status: Status


def lifelong(
    problem: Problem,
    next_goal: NextGoal,
    num_goals: int,
    options: BLOptions = _DEFAULT_OPTIONS,
    plan: Planner | None = None,
) -> LifelongRun:
    """Let a team serve goals that keep coming: a robot that arrives gets its next one, the others go on.

    The team is planned by :func:`bl_plan` once. From then on, each robot that has a new goal is planned by itself,
    through time, among the motions of the others. A robot that rests at its goal is in the way of others for some
    rows only, as it has another goal then. One that finds no way for now goes as near to its goal as it may rest, and
    is planned again and again, those first that have had their goals for longest. Where it cannot make way for those
    that are to pass, these go another way. Whoever is latest is planned again as well. If all that leads nowhere, the
    team is planned from nothing.

    Deterministic, but for where a time limit strikes. It shows progress; Ctrl-C ends it and returns what was done.

    Args:
        problem: The robots, where they begin, and their first goals.
        next_goal: A function of a robot and the goals of all others ``(robots - 1, dof)`` that returns the robot's
            next goal, ``(dof,)``, in free space that it can reach. If it overlaps another robot's goal, the robot
            stays about where it is until that one has another, or changes places with it.
        num_goals: How many are to be served, at least 1. The last ones may be served at once, a few more in all.
        options: As those of :func:`bl_plan`; the limit on time holds for each replanning.
        plan: Plan the whole team anew by this, such as :func:`bl_plan`, whenever a robot arrives. None: as above.

    Returns:
        What the team did.

    Raises:
        ValueError: If ``num_goals`` is no integer of at least 1, or a goal is not ``(dof,)``, free, and within
            reach.

    References:
        Li et al., "Lifelong multi-agent path finding in large-scale warehouses", 2021. Silver, "Cooperative
        pathfinding", 2005.
    """
    require_problem_and_options(problem, options)
    require_integer("num_goals", num_goals, 1)
    require_function("next_goal", next_goal)
    if plan is not None:
        require_function("plan", plan)
    team = _LifelongTeam(problem, options, plan)
    with tqdm(total=num_goals, desc="lifelong", unit=" goals", delay=3, leave=False, disable=None) as progress:
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
    """Where the robots are, where they are going, and what they have done.

    Attributes:
        problem: The team, and goals that are apart: those that are wanted, or were before.
        wanted: The goals that the robots have been given.
        path: What is planned for them from now on.
        served: The goals that were served: by whom, at which row, and which.
    """

    def __init__(self, problem: Problem, options: BLOptions, plan: Planner | None):
        self.problem, self.options, self.plan = problem, options, plan
        self.requested_goals, self.path = problem.starts.copy(), problem.starts[None]
        for i, robot in enumerate(problem.robots):
            self.requested_goals[i, : robot.dof] = problem.goals[i, : robot.dof]
        self.step = options.step or first_step(problem)
        self.length = self.step / ROWS_PER_STEP
        self.served: list[tuple[int, int, Float[np.ndarray, dof]]] = []
        self._done, self._num_rows, self._seconds = [problem.starts[None]], 0, []
        self._since = np.zeros(len(problem.robots))  # the row at which each got its goal
        self._hurried = np.full(len(problem.robots), -_WINDOW)  # the row at which each was planned to be sooner
        self._num_from_nothing, self._num_idle = 0, 0

    def plan_from_nothing(self) -> Status:
        """Plan the whole team; SOLVED if it has a path."""
        plan = self.plan or (lambda problem: bl_plan(problem, options=self.options))
        solution = plan(self._current_problem(self.problem.goals))
        self._num_from_nothing, self._num_idle = self._num_from_nothing + 1, 0
        if solution.path is None or solution.status is Status.INTERRUPTED:
            return solution.status
        self.path = solution.path if self.plan else subdivided(self.problem, solution.path, self.length)
        return Status.SOLVED

    def advance(self) -> list[int]:
        """Let the robots move until some arrive, or those that wait are to be planned again; who arrives."""
        is_there = (self.path == self.requested_goals).all(axis=2)
        arrivals = np.flatnonzero(is_there.any(axis=1))
        row = int(arrivals[0]) if len(arrivals) else len(self.path) - 1
        row = row if self.plan else min(row, _WINDOW)
        self._done.append(self.path[1 : row + 1])
        self._num_rows, self.path = self._num_rows + row, self.path[row:]
        arrived = np.flatnonzero(is_there[row]).tolist()
        self.served += [(i, self._num_rows, self.requested_goals[i].copy()) for i in arrived]
        return arrived

    def assign(self, i: int, goal: ArrayLike) -> None:
        """Give a robot its next goal."""
        expected = f"numbers of shape ({self.problem.dof},)"
        goal = as_numbers(f"The next goal of robot {i}", goal, expected)
        if goal.shape != (self.problem.dof,):
            raise ValueError(f"The next goal of robot {i} must be {expected}, got shape {goal.shape}.")
        dof = self.problem.robots[i].dof  # the heading of a robot that has none is ignored
        self.requested_goals[i, :dof], self._since[i] = goal[:dof], self._num_rows

    def replan(self) -> Status:
        """Plan those that have new goals, or wait; SOLVED if all can go on."""
        began = time.process_time()
        goals = self._possible_goals()
        if (goals != self.problem.goals).any():
            self.problem = self._current_problem(goals)
        try:
            status = self.plan_from_nothing() if self.plan else self._replan_waiting()
        except TimeoutError:
            status = Status.TIME_LIMIT
        self._seconds.append(time.process_time() - began)
        return status

    def result(self, status: Status) -> LifelongRun:
        """What was done."""
        path = np.concatenate(self._done)
        problem = Problem(
            self.problem.workspace, self.problem.robots, path[0], path[-1], self.problem.rotation_weight
        )
        robots, rows = (np.array([each[k] for each in self.served], dtype=np.intp) for k in (0, 1))
        goals = np.array([goal for *_, goal in self.served]).reshape(-1, problem.dof)
        times, seconds = row_times(problem, path), np.array(self._seconds)
        return LifelongRun(problem, path, times, robots, goals, rows, seconds, self._num_from_nothing, status)

    def _current_problem(self, goals: Goals) -> Problem:
        """The problem from where the robots are; a goal that is not free, or out of reach, is refused."""
        problem = self.problem
        return Problem(problem.workspace, problem.robots, self.path[0], goals, problem.rotation_weight)

    def _possible_goals(self) -> Goals:
        """The wanted goals, but for robots whose goals overlap others: those keep the ones that they had."""
        robots, tolerance = self.problem.robots, self.problem.workspace.tolerance
        size = np.array([robot.circumscribed_radius for robot in robots])
        goals, before = self.requested_goals.copy(), self.problem.goals
        new = np.flatnonzero((goals != before).any(axis=1)).tolist()
        while new:
            i = new.pop()
            offset = goals[:, :2] - goals[i, :2]
            near = np.flatnonzero(np.hypot(offset[:, 0], offset[:, 1]) < size + size[i])
            q = goals[:, None]
            pairs = ((robots[i], q[i], q[i], robots[j], q[j], q[j]) for j in near.tolist() if j != i)
            if not all(motions_apart(*pair, tolerance).all() for pair in pairs):
                goals[i] = before[i]
                new = np.flatnonzero((goals != before).any(axis=1)).tolist()
        return goals

    def _replan_waiting(self) -> Status:
        """Plan robots among the others that have new goals, or are soon to rest short of theirs."""
        problem, deadline = self.problem, time.perf_counter() + self.options.time_limit
        timetable = Timetable(problem, self.path, _PATIENCE, deadline)
        waits = (self.path[-1] != self.requested_goals).any(axis=1)
        self._num_idle = self._num_idle + 1 if waits.all() else 0
        todo = np.flatnonzero(waits & (timetable.ends <= _WINDOW))
        todo = todo[np.argsort(self._since[todo], kind="stable")].tolist()
        left = 0 if self._num_idle > _MOST_IDLE else _ATTEMPTS * len(todo)
        while todo:
            if not left:
                return self.plan_from_nothing()
            i, left = todo.pop(0), left - 1
            motion, _ = self._search(timetable, i)
            if motion is None:
                # It stays where it is, and who would have passed there goes another way.
                motion = self.path[:1, i, : problem.robots[i].dof]
                row, other = timetable.meetings(i, motion)
                todo += sorted({*other[row < _PATIENCE].tolist()} - {*todo})
            timetable.move(i, motion)
        # Plan the robot again that is to be at its goal latest, over its straight way, if it gets there sooner.
        is_bound = (timetable.path[-1] == self.requested_goals).all(axis=1)
        straight = straight_costs(self.path[0], self.requested_goals, problem.rotation_weights) / self.length
        late = np.where(is_bound & (self._num_rows >= self._hurried + _WINDOW), timetable.ends - straight, 0.0)
        i = int(late.argmax())
        if late[i] > _LATE:
            self._hurried[i] = self._num_rows
            motion, arrives = self._search(timetable, i)
            if motion is not None and arrives and len(motion) <= timetable.ends[i]:
                timetable.move(i, motion)
        self.path = timetable.path
        return Status.SOLVED

    def _search(self, timetable: Timetable, i: int) -> tuple[Motion | None, bool]:
        """A motion of a robot among the others, and whether it leads to the goal."""
        return plan_through_time(timetable, i, self.step, _PATIENCE, _FEW_STATES)
