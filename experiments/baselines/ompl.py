"""Planners of the Open Motion Planning Library, to compare with.

They get what a joint planner can be given: a metric that is our cost, and collision tests of whole motions in
compiled code.
"""

import os
import pickle
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np
from jaxtyping import Float

from plr_jax._problem import Problem, path_cost
from plr_jax._validate import validate
from plr_jax.planners._solution import Solution, Stats, Status, make_solution, straight_line_bound
from plr_jax.robots import Robot

PRIORITIZED = "prioritized"


@dataclass(frozen=True, eq=False)
class Task:
    """What a worker is asked to do; configurations have headings throughout."""

    planner: str
    seed: int
    time_limit: float
    cost_target: float
    sizes: Float[np.ndarray, "robots 3"]
    rotation_weights: Float[np.ndarray, " robots"]
    starts: Float[np.ndarray, "robots 3"]
    goals: Float[np.ndarray, "robots 3"]
    walls: Float[np.ndarray, "walls 2 2"]
    lo: Float[np.ndarray, "2"]
    hi: Float[np.ndarray, "2"]
    tolerance: float


@dataclass(frozen=True, eq=False)
class Found:
    """A worker's message: a path cheaper than the last one, and when."""

    seconds: float
    path: Float[np.ndarray, "steps robots 3"]
    cpu_seconds: float = 0.0  # of the worker's threads, where it measures them


@dataclass(frozen=True, eq=False)
class Done:
    """A worker's last message."""

    finished: bool  # the target is reached, or the planner says that it has the optimum
    seconds: float
    samples: Float[np.ndarray, "nodes robots 3"]
    num_checked: int
    num_free: int
    num_costs: int = 0  # computed in Python
    seconds_a_call: float = 0.0  # of Python from OMPL: what C++ would save
    cpu_seconds: float = 0.0


Message: TypeAlias = Found | Done


def ompl_plan(
    problem: Problem,
    planner: str = "RRTConnect",
    *,
    seed: int,
    time_limit: float | int,
    cost_target: float | int | None = None,
) -> Solution:
    """Plan with a planner of the Open Motion Planning Library (OMPL).

    The joint space is the product of the robots' planes and the rectangles' headings, and OMPL's distance in
    it, computed in C++, is the cost of a motion, summed over robots; so OMPL minimizes what our planners do. A
    whole motion is tested at once by compiled code, exactly for round robots; one that brings a turning
    rectangle within 1e-4 of its half diagonal to contact may be refused. Settings are OMPL's defaults but for
    the range, the longest motion that extends a tree: at most a tenth of the bounds' longer side for
    RRT-Connect and AORRTC and half of it for RRT*, with which teams are planned for much faster. A trial has a
    process of its own; starting it and compiling (the result is kept on disk) come before the clock starts.

    Every path is put through ``validate``. One that fails is dropped with a warning, as if it had not been
    found: a trial without other paths has failed.

    Args:
        problem: The problem.
        planner: ``"RRTstar"``; ``"RRTConnect"``, its path simplified, restarted until the time is over, the
            best kept; ``"AORRTC"``, which simplifies and restarts by itself; ``"BITstar"``; or
            ``"prioritized"``, for points and discs: one robot after the other, as ``ompl_prioritized_worker`` says.
        seed: Seed of OMPL's random numbers, from 0 to 2**32 - 2. How far a planner comes in its time still
            varies.
        time_limit: Seconds of planning, positive. A planner may take a little longer to notice.
        cost_target: Stop at the first path of at most this cost; None: plan until the time limit.

    Returns:
        The best valid path. Its status is SOLVED if the target was reached, or the planner ended by itself as it
        found nothing left to improve; or TIME_LIMIT, with or without a path. Statistics: ``num_nodes`` and the
        solution's samples are the vertices of the planner's graph at the end (of its last restart; AORRTC clears its
        own, prioritized has none); ``num_children_scored`` and ``num_children_valid`` count the motions and states
        tested, and those that were free; ``seconds`` are those of ``"compile"``, ``"plan"`` and, within the latter,
        ``"python"``: OMPL calls each test of a motion and BIT*'s costs through Python, which C++ would save. Each
        path in ``history`` is cheaper than the last by at least 0.2 %, so that the cost is within that of the
        planner's own best.

    Raises:
        RuntimeError: If the worker fails.

    References:
        Sucan, Moll, Kavraki: The Open Motion Planning Library. IEEE Robotics & Automation Magazine 19, 2012.
    """
    module = "ompl_prioritized_worker" if planner == PRIORITIZED else "ompl_worker"
    return _solution(problem, planner, _messages(task_of(problem, planner, seed, time_limit, cost_target), module))


def cpu_history(
    problem: Problem, planner: str, seed: int, time_limit: float, cost_target: float
) -> list[tuple[float, float]]:
    """Return CPU seconds and costs of a planner's valid paths, and then its CPU seconds at the end, with cost inf."""
    history = []
    for message in _messages(task_of(problem, planner, seed, time_limit, cost_target), "ompl_worker"):
        path = None if isinstance(message, Done) else _as_valid(problem, planner, message.path)
        if path is not None or isinstance(message, Done):
            history.append((message.cpu_seconds, np.inf if path is None else path_cost(problem, path)))
    return history


def _solution(problem: Problem, planner: str, messages: Iterable[Message]) -> Solution:
    """What a worker's messages amount to."""
    path, cost, history, seconds = None, np.inf, [], {"plan": 0.0}
    done = Done(False, 0.0, np.zeros((0, len(problem.robots), 3)), 0, 0)
    for message in messages:
        if isinstance(message, Done):
            done = message
        else:
            seconds["plan"] = message.seconds
            candidate = _as_valid(problem, planner, message.path)
            if candidate is not None and path_cost(problem, candidate) < cost:
                path, cost = candidate, path_cost(problem, candidate)
                history.append((message.seconds, cost))
    seconds["plan"] = max(seconds["plan"], done.seconds)
    seconds["python"] = (done.num_checked + done.num_costs) * done.seconds_a_call
    status = Status.SOLVED if done.finished and path is not None else Status.TIME_LIMIT
    samples = done.samples[..., : problem.dof]
    stats = Stats(len(samples), 0, done.num_checked, done.num_free, seconds, tuple(history))
    return make_solution(problem, path, straight_line_bound(problem), status, stats, samples)


def _as_valid(
    problem: Problem, planner: str, path: Float[np.ndarray, "steps robots 3"]
) -> Float[np.ndarray, "steps robots dof"] | None:
    """A path of OMPL's as one of ours, its headings at the ends as given; None if it is not valid."""
    path = path[..., : problem.dof].copy()
    path[0], path[-1] = problem.starts, problem.goals
    report = validate(problem, path)
    if report.valid:
        return path
    warnings.warn(f"A path of OMPL's {planner} is not valid and was dropped: {report.message}", stacklevel=5)
    return None


def _messages(task: Task, module: str) -> Iterator[Message]:
    """Run a task in a process of its own, which ends with the iteration."""
    package = str(Path(__file__).parents[2])
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([package, *filter(None, [os.getenv("PYTHONPATH")])])}
    with tempfile.TemporaryFile() as errors:
        worker = subprocess.Popen(
            [sys.executable, "-m", f"experiments.baselines.{module}"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=errors,
            env=environment,
            start_new_session=True,  # Ctrl-C is ours to handle
        )
        assert worker.stdin is not None and worker.stdout is not None
        try:
            with worker.stdin:
                pickle.dump(task, worker.stdin)
            message = None
            while not isinstance(message, Done):
                message = pickle.load(worker.stdout)
                yield message
        except (EOFError, BrokenPipeError):
            errors.seek(0)
            last = errors.read().decode(errors="replace").strip()[-2000:]
            raise RuntimeError(f"OMPL's worker failed with exit code {worker.wait()}: {last}") from None
        finally:
            worker.kill()
            worker.wait()
            worker.stdout.close()


def task_of(
    problem: Problem, planner: str, seed: int, time_limit: float | int, cost_target: float | int | None
) -> Task:
    """A problem as a task; without a cost target, one that no path costs less than."""
    headings = np.zeros((len(problem.robots), 3 - problem.dof))
    starts, goals = (np.hstack([q, headings]) for q in (problem.starts, problem.goals))
    for q in (starts, goals):
        q[[robot.dof == 2 for robot in problem.robots], 2] = 0.0
    workspace = problem.workspace
    return Task(
        planner=planner,
        seed=int(seed),
        time_limit=float(time_limit),
        cost_target=0.0 if cost_target is None else float(cost_target),
        sizes=np.array([_size(robot) for robot in problem.robots]),
        rotation_weights=problem.rotation_weights,
        starts=starts,
        goals=goals,
        walls=workspace.boundary.segments,
        lo=workspace.bounds.lo,
        hi=workspace.bounds.hi,
        tolerance=workspace.tolerance,
    )


def _size(robot: Robot) -> tuple[float, float, float]:
    """Half length, half width and radius."""
    half = robot.half_sides
    if half is None or (half.any() and (robot.rounding > 0 or robot.dof == 2)):
        raise ValueError(f"OMPL planners take points, discs and rectangles, got {robot!r}.")
    return float(half[0]), float(half[1]), robot.rounding
