"""One trial of prioritized planning: ``python -m experiments.baselines.ompl_prioritized_worker``.

The task comes in and messages go out as with ``ompl_worker``.

OMPL's RRT-Connect plans for one robot after the other. Each robot gets a path in OMPL's space of position and time,
at speeds up to 1, among the robots that were planned for before it, which move along their paths. A robot that finds
no path in its share of the time comes first in the next order, which begins anew. All robots arrive at the same time,
a horizon: nobody has to find a way around robots at rest at their goals, though a path may well rest anywhere.
Horizons of several lengths are tried in turn. In every other attempt, OMPL's simplifier shortens each path before the
next robot is planned for.

From then on, robots are planned for again, each among all others, and their paths simplified, while that helps; then
another order begins. Replanned robots depart and arrive at random times and rest before and after, where they can:
without that, all would be on their way, and in each other's, all the time.

OMPL's distance in space and time, infinite where a robot would be too slow, guides RRT-Connect, with motions whose
mean of length and duration is at most a fifth of the bounds' longer side. Paths are simplified in the product of the
plane and the time, with nearly all weight on the plane, as OMPL's simplifier needs a metric. A whole motion is tested
at once by compiled code, exactly.

References:
    Erdmann, Lozano-Pérez: On multiple moving objects. Algorithmica 2, 1987.
    Bennewitz, Burgard, Thrun: Finding and optimizing solvable priority schemes for decoupled path planning
    techniques for teams of mobile robots. Robotics and Autonomous Systems 41, 2002.
"""

import itertools
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float
from ompl import base, geometric

from experiments.baselines.ompl import Done, Found, Task
from experiments.baselines.ompl_motions import Scene
from experiments.baselines.ompl_tracks import Track, Traffic, is_free, is_motion_free_among, row_of
from experiments.baselines.ompl_worker import Send, information_of, is_news, plane_of, require_same, serve

# Seconds for each robot in the first attempt at an order, and their growth from one attempt that fails to the next.
_SECONDS, _SECONDS_GROWTH = 0.05, 1.5
# When all robots arrive, as a multiple of the bounds' perimeter: one of these after the other. The longer it is, the
# more room there is in time, and the more to search.
_HORIZONS = (0.75, 1.5, 3.0)
_RANGE = 0.2  # mean of the length and the duration of motions that extend a tree, as a share of the longer side
_LEISURE = 1.5  # least time for a path, as a multiple of its length: near full speed, RRT-Connect hardly finds any
_MOST_DRAWS = 10  # of times at which to depart and arrive
_WORTHWHILE = 0.003  # share by which a round must have shortened the paths if there is to be another
_TIME_WEIGHT = 1e-3  # of time in the metric by which OMPL shortens paths; with 0, it would be none


class _Planner:
    """OMPL's RRT-Connect and simplifier in space and time, up to a horizon, for one robot after the other."""

    def __init__(self, task: Task, scenes: list[Scene], horizon: float):
        self._task, self._scenes, self.horizon = task, scenes, horizon
        timed = base.SpaceTimeStateSpace(plane_of(task), 1.0)
        timed.setTimeBounds(0.0, horizon)
        self._addresses = [0, 0]  # of what stands and of what moves, as turn_to says
        self._timed = information_of(timed, is_free, self._addresses)
        self._planner = geometric.RRTConnect(self._timed)
        self._planner.setRange(_RANGE * float((task.hi - task.lo).max()))
        # OMPL's distance in space and time is infinite where a robot would be too slow. That makes trees grow where
        # they can, but the simplifier does less in spaces that are not metric.
        times = base.TimeStateSpace()
        times.setBounds(0.0, horizon)
        metric = base.CompoundStateSpace([plane_of(task), times], [1.0, _TIME_WEIGHT])
        self._metric = information_of(metric, is_free, self._addresses)
        self._simplifier = geometric.PathSimplifier(self._metric)

    def turn_to(self, robot: int, tracks: Mapping[int, Track]) -> None:
        """Plan for a robot from now on, among all others that have tracks."""
        radii, others = self._task.sizes[:, 2], [other for other in tracks if other != robot]
        reaches = [radii[robot] + radii[other] - self._task.tolerance for other in others]
        self._start, self._goal = self._task.starts[robot, :2], self._task.goals[robot, :2]
        self._traffic = Traffic([tracks[other] for other in others], reaches)
        self._addresses[:] = self._scenes[robot].address, self._traffic.address

    def plan(self, departure: float, arrival: float, seconds: float) -> Track | None:
        """A path that leaves the start and arrives at the goal at given times."""
        definition = base.ProblemDefinition(self._timed)
        ends = (*self._start, departure), (*self._goal, arrival)
        definition.setStartAndGoalStates(*(_state(self._timed, row) for row in ends))
        self._planner.clear()
        self._planner.setProblemDefinition(definition)
        self._planner.solve(seconds)
        return _track(definition.getSolutionPath()) if definition.hasExactSolution() else None

    def shorten(self, track: Track, seconds: float) -> Track:
        """A path as OMPL's simplifier shortens it, or as it is."""
        path = geometric.PathGeometric(self._metric, [_state(self._metric, row) for row in track])
        self._simplifier.simplify(path, seconds)
        shorter = _track(path)
        # OMPL may leave a path that is not free.
        return shorter if self._is_track_free(shorter) and _length(shorter) < _length(track) else track

    def times(self, length: float, rng: np.random.Generator) -> tuple[float, float]:
        """When to depart and to arrive on a path of some length, at random if the robot may rest before and after."""
        least = min(_LEISURE * length, self.horizon)
        for _ in range(_MOST_DRAWS):
            duration = rng.uniform(least, self.horizon)
            departure = rng.uniform(0.0, self.horizon - duration)
            arrival = departure + duration
            if all(self._is_track_free(rest) for rest in self._rests(departure, arrival)):
                return departure, arrival
        return 0.0, self.horizon

    def whole(self, track: Track) -> Track:
        """A path with the rests before and after it."""
        before, after = self._rests(track[0, 2], track[-1, 2])
        return _rising(np.concatenate([before, track, after]))

    def check(self) -> None:
        """Compile everything, and refuse a version of OMPL whose states cannot be read."""
        row = np.array([*self._task.starts[0, :2], self.horizon])
        self.turn_to(0, {})
        for information in (self._timed, self._metric):
            state = _state(information, row)
            require_same(row_of(state), row)
            information.isValid(state)
        self._is_track_free(np.array([row, row]))

    def _rests(self, departure: float, arrival: float) -> tuple[Track, Track]:
        before = np.array([(*self._start, 0.0), (*self._start, departure)])
        return before, np.array([(*self._goal, arrival), (*self._goal, self.horizon)])

    def _is_track_free(self, track: Track) -> bool:
        return all(is_motion_free_among(*motion, *self._addresses) for motion in itertools.pairwise(track))


@dataclass
class _Trial:
    """The clock, and the paths reported."""

    task: Task
    send: Send
    begin: float = field(default_factory=time.perf_counter)
    best: float = np.inf

    @property
    def seconds(self) -> float:
        """Seconds since the beginning."""
        return time.perf_counter() - self.begin

    @property
    def left(self) -> float:
        """Seconds until the time limit."""
        return max(self.task.time_limit - self.seconds, 0.0)

    @property
    def is_solved(self) -> bool:
        """Whether the cost target is reached."""
        return self.best <= self.task.cost_target

    @property
    def is_over(self) -> bool:
        """Whether to stop."""
        return self.is_solved or self.left == 0

    def report(self, tracks: Mapping[int, Track]) -> None:
        """Report the paths of all robots if they are shorter than the last ones reported."""
        seconds, cost = self.seconds, _cost(tracks)
        if is_news(cost, self.best, self.task):
            self.best = cost
            self.send(Found(seconds, joint_path([tracks[robot] for robot in sorted(tracks)])))


def run(task: Task, send: Send) -> Done:
    """Plan, and report each path that is cheaper."""
    scenes = [Scene(size[None], task.walls, task.tolerance) for size in task.sizes]
    perimeter = 2 * float((task.hi - task.lo).sum())
    planners = [_Planner(task, scenes, horizon * perimeter) for horizon in _HORIZONS]
    for planner in planners:
        planner.check()
    trial = _Trial(task, send)
    _search(trial, planners)
    checked, free = sum(scene.num_checked for scene in scenes), sum(scene.num_free for scene in scenes)
    return Done(trial.is_solved, trial.seconds, np.zeros((0, *task.starts.shape)), checked, free)


def _search(trial: _Trial, planners: list[_Planner]) -> None:
    """Plan in one order after the other: a robot that has failed comes first in the next."""
    rng, num_robots = np.random.default_rng(trial.task.seed), len(trial.task.sizes)
    order, attempt = rng.permutation(num_robots).tolist(), 0
    while not trial.is_over:
        planner = planners[attempt % len(planners)]
        # Unshortened paths are there first. On the shortest ones, robots are slow and crowd at doors; on others, they
        # need more of the open space.
        tracks, failed = _plan_in_order(planner, order, _SECONDS * _SECONDS_GROWTH**attempt, attempt % 2 == 1, trial)
        if failed is None:
            trial.report(tracks)
            _improve(planner, tracks, trial, rng)
            order, attempt = rng.permutation(num_robots).tolist(), 0
        else:
            order.remove(failed)
            order.insert(0, failed)
            attempt += 1


def _plan_in_order(
    planner: _Planner, order: list[int], seconds: float, shortened: bool, trial: _Trial
) -> tuple[dict[int, Track], int | None]:
    """Plan for each robot among those before it; also the one that has failed, if any."""
    tracks = {}
    for robot in order:
        planner.turn_to(robot, tracks)
        track = planner.plan(0.0, planner.horizon, min(seconds, trial.left))
        if track is None:
            return tracks, robot
        tracks[robot] = planner.shorten(track, trial.left) if shortened else track
    return tracks, None


def _improve(planner: _Planner, tracks: dict[int, Track], trial: _Trial, rng: np.random.Generator) -> None:
    """Shorten one path after the other among all others, then plan each anew, as long as that is worthwhile."""
    before = np.inf
    while not trial.is_over and _cost(tracks) < before * (1 - _WORTHWHILE):
        before = _cost(tracks)
        for anew in (False, True):
            for robot in rng.permutation(len(tracks)).tolist():
                planner.turn_to(robot, tracks)
                track = _plan_anew(planner, tracks[robot], trial, rng) if anew else tracks[robot]
                track = planner.shorten(track, trial.left)
                tracks[robot] = min(planner.whole(track), tracks[robot], key=_length)
                trial.report(tracks)
                if trial.is_over:
                    return


def _plan_anew(planner: _Planner, track: Track, trial: _Trial, rng: np.random.Generator) -> Track:
    """Another path, with rests before and after it so that it is out of the way of others for a time, if there is."""
    found = planner.plan(*planner.times(_length(track), rng), min(_SECONDS, trial.left))
    return track if found is None else found


def joint_path(tracks: list[Track]) -> Float[np.ndarray, "steps robots 3"]:
    """Tracks that end at the same time as a path on which all robots move at once."""
    times = np.unique(np.concatenate([track[:, 2] for track in tracks]))
    path = np.zeros((len(times), len(tracks), 3))
    for robot, track in enumerate(tracks):
        for axis in range(2):
            path[:, robot, axis] = np.interp(times, track[:, 2], track[:, axis])
    return path


def _cost(tracks: Mapping[int, Track]) -> float:
    return sum(map(_length, tracks.values()))


def _length(track: Track) -> float:
    return float(np.hypot(*np.diff(track[:, :2], axis=0).T).sum())


def _track(path: Any) -> Track:
    return _rising(np.array([row_of(path.getState(i)) for i in range(path.getStateCount())]))


def _rising(rows: Track) -> Track:
    """Rows but for those at the time of the row before."""
    return rows[np.append(True, np.diff(rows[:, 2]) > 0)]


def _state(information: Any, row: Any) -> Any:
    state = information.allocState()
    information.getStateSpace().copyFromReals(state, [float(number) for number in row])
    return state


if __name__ == "__main__":
    serve(run)
