"""One trial of an OMPL planner, in a process of its own: ``python -m experiments.baselines.ompl_worker``.

OMPL takes a seed only before its first planner, so that trials that are to be repeatable cannot share a process.
The task comes in by standard input, messages go out by standard output, both pickled.
"""

import itertools
import os
import pickle
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Float
from ompl import base, geometric
from ompl import util as ompl_util

from experiments.baselines.ompl import Done, Found, Message, Task
from experiments.baselines.ompl_motions import Scene, configurations_of, is_always_free, is_free, is_motion_free

Send: TypeAlias = Callable[[Message], None]

_LEAST_IMPROVEMENT = 0.002  # by which a path is cheaper than the last one reported, as a share
_NUM_TIMED, _NUM_TIMINGS = 1_000, 20  # calls of Python that are timed at once, and how often; the least time counts


class _Motions(base.MotionValidator):
    """Whole motions tested by one compiled call, in place of states at a resolution."""

    def __init__(self, information: Any, kernel: Callable[..., bool], addresses: Sequence[int]):
        super().__init__(information)
        self._kernel, self._addresses = kernel, addresses

    def checkMotion(self, first: Any, last: Any) -> bool:
        return self._kernel(id(first), id(last), *self._addresses)


class _Length(base.OptimizationObjective):
    """Path length, with the distance as heuristic.

    OMPL's own objective of path length samples from an ellipsoid, which it does not know for our metric, and
    refuses; what it derives from other objectives has no heuristic.
    """

    def __init__(self, information: Any):
        super().__init__(information)
        self._distance, self.num_calls = information.distance, 0

    def stateCost(self, state: Any) -> Any:
        return base.Cost(0.0)

    def motionCost(self, first: Any, last: Any) -> Any:
        self.num_calls += 1
        return base.Cost(self._distance(first, last))

    def motionCostHeuristic(self, first: Any, last: Any) -> Any:
        return self.motionCost(first, last)


def _length(information: Any) -> Any:
    """Path length, compiled, for planners that need no heuristic: one term of a sum of objectives."""
    objective = base.MultiOptimizationObjective(information)
    objective.addObjective(base.PathLengthOptimizationObjective(information), 1.0)
    objective.lock()
    return objective


_OBJECTIVES: dict[str, Callable[[Any], Any]] = {
    "RRTstar": base.PathLengthOptimizationObjective,
    "RRTConnect": base.PathLengthOptimizationObjective,
    "AORRTC": _length,
    "BITstar": _Length,
}


# Longest motions that extend a tree, as a share of the longer side of the bounds; BIT* has no such setting. OMPL's
# default is a fifth of the joint space's extent, which grows with the team: nearly all such motions of three or
# more robots collide, and RRT-Connect then needs ten to a hundred times as long to its first path. For RRT*, which
# pays for every vertex that it keeps, longer ones are better.
_RANGES = {"RRTConnect": 0.1, "AORRTC": 0.1, "RRTstar": 0.5}


@dataclass(frozen=True)
class _Setup:
    """A problem in OMPL's terms."""

    task: Task
    scene: Scene
    information: Any
    definition: Any
    planner: Any
    objective: Any

    def path(self) -> Float[np.ndarray, "steps robots 3"]:
        """OMPL's best path so far."""
        path = self.definition.getSolutionPath()
        states = range(path.getStateCount())
        return np.array([configurations_of(path.getState(i), self.scene) for i in states])

    def is_valid(self, path: Float[np.ndarray, "steps robots 3"]) -> bool:
        """Whether all motions of a path are free. While OMPL simplifies a path, and even after, it may not be."""
        return all(is_motion_free(*motion, self.scene.address) for motion in itertools.pairwise(path))

    def samples(self) -> Float[np.ndarray, "nodes robots 3"]:
        """The vertices of the planner's graph."""
        data = base.PlannerData(self.information)
        self.planner.getPlannerData(data)
        vertices = (data.getVertex(i).getState() for i in range(data.numVertices()))
        samples = [configurations_of(state, self.scene) for state in vertices if state is not None]
        return np.array(samples).reshape(-1, *self.task.starts.shape)


def main() -> None:
    """Run the task that comes in."""
    serve(_trial)


def serve(trial: Callable[[Task, Send], Done]) -> None:
    """Run a trial of the task that comes in, send its messages, and end the process."""
    messages = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # so that what libraries print does not come among the messages

    def send(message: Message) -> None:
        pickle.dump(message, messages)
        messages.flush()

    task: Task = pickle.load(sys.stdin.buffer)
    ompl_util.RNG.setSeed(task.seed + 1)  # 0 is no seed to OMPL
    ompl_util.setLogLevel(ompl_util.LOG_ERROR)
    done = trial(task, send)
    send(replace(done, seconds_a_call=_seconds_a_call(task)))
    os._exit(0)  # past the bindings' report on what they leak at exit


def _seconds_a_call(task: Task) -> float:
    """Time OMPL's calls of motion tests in Python, without the tests: it checks a path by a test of nothing."""
    information, times = information_of(plane_of(task), is_always_free, [0]), []
    path = geometric.PathGeometric(information, [information.allocState()] * _NUM_TIMED)
    for _ in range(_NUM_TIMINGS):  # the first one compiles
        begin = time.perf_counter()
        path.check()
        times.append(time.perf_counter() - begin)
    return min(times) / _NUM_TIMED


def _trial(task: Task, send: Send) -> Done:
    """Plan, and report each path that is cheaper."""
    setup = _setup(task)
    begin, cpu_begin, best, scene = time.perf_counter(), time.process_time(), np.inf, setup.scene

    def report(cost: float) -> bool:
        """Report a path of some cost, and tell whether the trial is over."""
        nonlocal best
        seconds, cpu_seconds = time.perf_counter() - begin, time.process_time() - cpu_begin
        if is_news(cost, best, task):
            path = setup.path()
            if setup.is_valid(path):
                best = cost
                send(Found(seconds, path, cpu_seconds))
        return seconds >= task.time_limit or best <= task.cost_target

    finished = _PLANS[task.planner](setup, report, begin + task.time_limit)
    seconds, cpu_seconds = time.perf_counter() - begin, time.process_time() - cpu_begin
    done = Done(finished or best <= task.cost_target, seconds, setup.samples(), scene.num_checked, scene.num_free)
    return replace(done, num_costs=getattr(setup.objective, "num_calls", 0), cpu_seconds=cpu_seconds)


def is_news(cost: float, best: float, task: Task) -> bool:
    """Whether a path is to be reported after the best one so far."""
    return 0 < cost < best * (1 - _LEAST_IMPROVEMENT) or best > task.cost_target >= cost > 0


Report: TypeAlias = Callable[[float], bool]


def _plan_by_threshold(setup: _Setup, report: Report, deadline: float) -> bool:
    """RRT* and BIT*: they return at each path below a cost threshold, and go on where they were."""
    best = np.inf
    while not report(best):
        threshold = best * (1 - _LEAST_IMPROVEMENT)
        setup.objective.setCostThreshold(base.Cost(max(threshold, min(best, setup.task.cost_target))))
        setup.planner.solve(max(deadline - time.perf_counter(), 0.0))
        cost = setup.planner.bestCost().value()
        if time.perf_counter() < deadline and not cost < best:
            return True  # it says that there is no better path
        best = min(best, cost)
    return False


def _plan_by_polling(setup: _Setup, report: Report, deadline: float) -> bool:
    """AORRTC: it plans, simplifies and restarts by itself, and adds paths to the problem as it goes."""
    over, num_paths = False, 0

    def stop() -> bool:
        nonlocal over, num_paths
        # After a solve that found none, the path nearest to the goal is there too, but it is not exact.
        if setup.definition.getSolutionCount() != num_paths and setup.definition.hasExactSolution():
            num_paths = setup.definition.getSolutionCount()
            over = report(setup.definition.getSolutionPath().length())
        return over or time.perf_counter() >= deadline

    setup.planner.solve(base.PlannerTerminationCondition(stop))
    stop()
    return time.perf_counter() < deadline


def _plan_by_restarts(setup: _Setup, report: Report, deadline: float) -> bool:
    """RRT-Connect: plan and simplify, again and again from the start."""
    simplifier = geometric.PathSimplifier(setup.information, setup.definition.getGoal(), setup.objective)
    over = False
    while not over and time.perf_counter() < deadline:
        setup.planner.clear()
        setup.definition.clearSolutionPaths()
        setup.planner.solve(max(deadline - time.perf_counter(), 0.0))
        if setup.definition.hasExactSolution():
            path = setup.definition.getSolutionPath()
            over = report(path.length())
            simplifier.simplify(path, max(deadline - time.perf_counter(), 0.0))
            over = report(path.length()) or over
    return False


_PLANS: dict[str, Callable[[_Setup, Report, float], bool]] = {
    "RRTstar": _plan_by_threshold,
    "BITstar": _plan_by_threshold,
    "AORRTC": _plan_by_polling,
    "RRTConnect": _plan_by_restarts,
}


def _setup(task: Task) -> _Setup:
    """The problem in OMPL's terms, everything compiled."""
    scene, space = Scene(task.sizes, task.walls, task.tolerance), _space(task)
    information = information_of(space, is_free, [scene.address])
    ends = [_state(space, task, q) for q in (task.starts, task.goals)]
    for state, q in zip(ends, (task.starts, task.goals), strict=True):
        require_same(np.exp(1j * configurations_of(state, scene)), np.exp(1j * q))
        information.isValid(state)  # compiles, and so does the next line
        is_motion_free(q, q, scene.address)
    definition = base.ProblemDefinition(information)
    definition.setStartAndGoalStates(*ends)
    objective = _OBJECTIVES[task.planner](information)
    definition.setOptimizationObjective(objective)
    planner = getattr(geometric, task.planner)(information)
    planner.setProblemDefinition(definition)
    if task.planner in _RANGES:
        longest = _RANGES[task.planner] * float((task.hi - task.lo).max())
        planner.setRange(min(longest, 0.2 * space.getMaximumExtent()))
    planner.setup()
    return _Setup(task, scene, information, definition, planner, objective)


def information_of(space: Any, kernel: Callable[..., bool], addresses: Sequence[int]) -> Any:
    """A space with compiled tests.

    Args:
        space: OMPL's state space.
        kernel: Tells of the ``id``s of two states, and addresses, whether the motion is free.
        addresses: Looked up anew for each test.

    Returns:
        OMPL's information on the space.
    """
    information = base.SpaceInformation(space)
    information.setStateValidityChecker(lambda state: kernel(id(state), id(state), *addresses))
    information.setMotionValidator(_Motions(information, kernel, addresses))
    information.setup()
    return information


def require_same(read: Any, written: Any) -> None:
    """Refuse a version of OMPL whose states read back otherwise than they were written."""
    if not np.allclose(read, written):
        raise RuntimeError("This version of OMPL keeps states in another way; please use ompl 2.0.1.")


def plane_of(task: Task) -> Any:
    """The positions within the bounds."""
    plane, bounds = base.RealVectorStateSpace(2), base.RealVectorBounds(2)
    for axis in range(2):
        bounds.setLow(axis, float(task.lo[axis]))
        bounds.setHigh(axis, float(task.hi[axis]))
    plane.setBounds(bounds)
    return plane


def _space(task: Task) -> Any:
    """A position for each robot, then a heading for each rectangle: its metric is our cost."""
    parts, weights = [plane_of(task) for _ in task.sizes], [1.0] * len(task.sizes)
    for weight in task.rotation_weights[task.sizes[:, 0] > 0]:
        parts.append(base.SO2StateSpace())
        weights.append(max(float(weight), 1e-6))  # 0 would make no metric
    space = base.CompoundStateSpace(parts, weights)
    space.setup()
    return space


def _state(space: Any, task: Task, q: Float[np.ndarray, "robots 3"]) -> Any:
    """A joint configuration as a state."""
    state = space.allocState()
    headings = q[task.sizes[:, 0] > 0, 2]
    space.copyFromReals(state, [*q[:, :2].ravel().tolist(), *headings.tolist()])
    space.enforceBounds(state)
    return state


if __name__ == "__main__":
    main()
