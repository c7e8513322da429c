"""A team that is under way, planned from where everybody is: as few robots anew as may be."""

import math
import time
from collections.abc import Iterable, Sequence

import numpy as np

from plr_jax._arrays import as_number, require_integer, shortened
from plr_jax._problem import Problem, motion_costs
from plr_jax.planners._options import BLOptions, require_task
from plr_jax.planners._solution import Solution, Stats, Status, solution_of, straight_line_bound
from plr_jax.planners.driver import bl_plan, first_step
from plr_jax.planners.through_time import (
    ROWS_PER_STEP,
    JointPath,
    LoneRobot,
    Motion,
    Timetable,
    in_rows,
    plan_through_time,
)

_MOST_STATES = 20_000  # expanded for one robot
_ATTEMPTS = 3  # times as many robots are planned at most as the team has, before that is planned from nothing
_DEFAULT_OPTIONS = BLOptions()


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
        options: ``step``, ``primitives`` and the limit on time, which holds again for what is planned from nothing,
            under all options.
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
    require_task(problem, options)
    began = time.perf_counter()
    fixed = _require_standing(problem, standing)
    step = options.step or first_step(problem, len(options.primitives))
    path = in_rows(problem, _rest(problem, solution, at), step / ROWS_PER_STEP)
    timetable = Timetable(problem, path, deadline=began + options.time_limit)
    try:
        is_found = _replan(problem, timetable, step, options, fixed)
        status = Status.SOLVED if is_found else Status.EXHAUSTED
    except TimeoutError:
        status = Status.TIME_LIMIT
    except KeyboardInterrupt:
        status = Status.INTERRUPTED
    if status is Status.EXHAUSTED and not fixed:
        return bl_plan(problem, options=options)
    found = timetable.path if status is Status.SOLVED else None
    stats = Stats(0, seconds={"replan": time.perf_counter() - began}, found_by="replan")
    return solution_of(problem, found, straight_line_bound(problem), status, stats, problem.starts[None].copy())


def _replan(problem: Problem, timetable: Timetable, step: float, options: BLOptions, fixed: set[int]) -> bool:
    """Plan those anew whose motions do not lead to their goals any more; whether all have one that does."""
    num_robots = len(problem.robots)
    todo = [i for i in range(num_robots) if i not in fixed and not _leads_to_goal(timetable, i)]
    timetable.absent.update(todo)
    for i in fixed:
        timetable.move(i, timetable.path[:1, i])
    for i in fixed:
        todo += _in_the_way(timetable, i, timetable.path[:, i], fixed)
    for _ in range(_ATTEMPTS * num_robots):
        if not todo:
            return True
        i = todo.pop(0)
        lone = LoneRobot(timetable, i, step, options.primitives)
        motion, arrives = plan_through_time(timetable, lone, math.inf, _MOST_STATES)
        if motion is None or not arrives:
            others, timetable.absent = timetable.absent, {*range(num_robots)} - fixed
            motion, arrives = plan_through_time(timetable, lone, math.inf, _MOST_STATES)
            timetable.absent = others
            if motion is None or not arrives:
                return False
            todo += _in_the_way(timetable, i, motion, fixed)
        timetable.move(i, motion)
    return False


def _leads_to_goal(timetable: Timetable, i: int) -> bool:
    """Whether a robot's motion ends at its goal and hits no obstacle."""
    dof, q = timetable.problem.robots[i].dof, timetable.path[:, i]
    is_there = bool((q[-1, :dof] == timetable.problem.goals[i, :dof]).all())
    return is_there and bool(timetable.test.of_walls[i](q[:-1], q[1:], timetable.test.deadline).all())


def _in_the_way(timetable: Timetable, i: int, motion: Motion, fixed: set[int]) -> list[int]:
    """The robots whose motions meet one, which from now on are in nobody's way."""
    others = sorted({*timetable.meetings(i, motion)[1].tolist()} - fixed)
    timetable.absent.update(others)
    return others


def _rest(problem: Problem, solution: Solution, at: float | int) -> JointPath:
    """What is left of a solution's path at a time."""
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
    return np.concatenate([problem.starts[None], solution.path[solution.times > at]])


def _require_standing(problem: Problem, standing: Sequence[int]) -> set[int]:
    """The robots that stand, of the team, whose goals are where they start."""
    expected = f"standing must be indices of the {len(problem.robots)} robots"
    if not isinstance(standing, Iterable):
        raise ValueError(f"{expected}, as a list, got {shortened(standing)}.")
    fixed = [*standing]
    for i in fixed:
        require_integer("standing", i, 0)
        if i >= len(problem.robots):
            raise ValueError(f"{expected}, got {i}.")
        if (problem.starts[i] != problem.goals[i]).any():
            goal, start = problem.goals[i].tolist(), problem.starts[i].tolist()
            raise ValueError(f"Robot {i} is to stand still: its goal must be its start {start}, got {goal}.")
    return {*fixed}
