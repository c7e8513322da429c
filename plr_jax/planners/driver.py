"""The planner for several robots at once (Section V of the paper, and searches beside it)."""

import time
from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int
from tqdm import tqdm

from plr_jax._problem import Problem, path_cost, straight_costs
from plr_jax._types import BoundingFn, HeuristicFn
from plr_jax.collision.joint_motion import JointMotionTest
from plr_jax.planners._budget import SearchBudget
from plr_jax.planners._heuristics import require_heuristic
from plr_jax.planners._solution import Solution, Stats, Status, solution_of, straight_line_bound
from plr_jax.planners.bl.options import BLOptions
from plr_jax.planners.lacam.timetable import Timetable, num_bytes_of_timetable, replan_each, replan_neighbors
from plr_jax.planners.lattice.build import num_configurations
from plr_jax.planners.lattice.joint import State
from plr_jax.planners.level import SearchLevel, build_level, num_bytes
from plr_jax.planners.smoothing.corridor import shorten_in_corridors
from plr_jax.planners.smoothing.shortcuts import halved, shorten

# Steps, as shares of the longer side of the bounds: of the first lattice, and of the last one tried.
_COARSEST_FIRST, _POINT_STEP, _FINEST_FIRST, _FINEST = 1 / 16, 1 / 32, 1 / 512, 1 / 2048
_COARSEST = 1 / 4  # tried where memory is short
_LARGEST_FIRST = 1 << 16  # configurations of a robot on the first lattice
_AROUND = 1.5  # times a straight way, above which the first lattice is suspected to lack a passage
_SHORTER = 0.05  # share of the cost of all ways that a finer lattice must save to take its place
_REFINEMENT = 1.25
_WEIGHT, _WEIGHT_OF_ROBOT = 2.0, 3 / 8
_WAITING = 4  # rows of a path for each one in which robots may wait besides
_GAIN = 2e-3  # share of the cost below which replanning neighbors is not worth its time
_GREEDIER = 1.5  # growth of the weight from one search to the next
_ROUNDING = 1e-9
_LEAST_WEIGHT = 1.1  # below it, a finer lattice promises more than a smaller weight
_MOST_BYTES = 1 << 60  # that are told apart
_DEFAULT_OPTIONS = BLOptions()


def bl_plan(
    problem: Problem, heuristic: HeuristicFn | None = None, options: BLOptions = _DEFAULT_OPTIONS
) -> Solution:
    """Plan for all robots at once: search lattices until the team can reach its goals, then make its path cheap.

    Every robot moves on a lattice, on which its start and goal are exact; robots of one kind share one. Two searches
    take turns on it, and on finer ones while none succeeds:

    - Lazy search over constraints moves the whole team one step at a time: each robot takes its best free motion and
      pushes others out of its way. In the open, and at doors, it is over at once, for a hundred robots too.
    - Best-first search, Barraquand and Latombe's, over cells of the joint space: a node's children are the products
      of the robots' primitives that keep clear of obstacles and of one another along the whole motion, and each cell
      is claimed once, by the first node in it. The best node by cost-to-come and weighted heuristic is expanded next,
      as in A*. It finds what takes a plan, such as a swap in a tight place.

    Then robots are planned anew along the lattices, each among the others, which keep their motions, and the path
    is shortened by straight shortcuts of one robot, and within narrow corridors about the motions of one robot, or
    of two that touch. Under a ``cost_factor``, groups of robots are planned anew together, and searches on finer
    lattices and with smaller weights go on, until a limit.

    Deterministic, but for where a time limit strikes. Ctrl-C ends it and returns the best path so far.

    Args:
        problem: What to plan.
        heuristic: Estimated cost-to-go of joint configurations ``(n, robots, dof)``, such as :func:`zero`,
            :func:`straight_line`, :func:`sum_of_distances` or a function of your own, never NaN. An infinite
            estimate prunes nothing, a negative one counts as 0. Terms (``per_robot``) are used where it offers
            them, by both searches, which is much faster than a plain function, by which best-first search goes alone.
            One that says it is a lower bound (``is_lower_bound``) bounds the cost of all paths by what it says of the
            starts. None: each robot's cost-to-go along its lattice, alone, which takes no oracle and no PLR: the best
            choice where a plan is all that is asked for.
        options: How to search, and when to stop.

    Returns:
        The best path found, how far at the most from the best there is, and why the search ended: SOLVED if its cost
        is within ``cost_factor`` of the lower bound; EXHAUSTED if nothing was left to search on the finest lattice
        (the given ``step``, or 1/2048 of the bounds), which proves nothing about finer ones; a limit, or
        INTERRUPTED, with or without a path.

    Raises:
        ValueError: If the heuristic is no function of joint configurations, or returns NaN or another shape than
            ``(n,)``; or if the options are no :class:`BLOptions`.

    References:
        Barraquand and Latombe, "Robot motion planning: a distributed representation approach", 1991; Section V
        of the paper. Okumura, "LaCAM: search-based algorithm for quick multi-agent pathfinding", 2023. Li et al.,
        "Anytime multi-agent path finding via large neighborhood search", 2021.
    """
    if heuristic is not None:
        require_heuristic(heuristic)
    if not isinstance(options, BLOptions):
        raise ValueError(f"options must be BLOptions(...), got {options!r}.")
    began = time.perf_counter()
    with tqdm(desc="bl_plan", unit=" expansions", delay=3, leave=False, disable=None) as progress:
        run = _Run(problem, heuristic, options, began, progress)
        try:
            status = run.until_done()
        except KeyboardInterrupt:
            status = Status.INTERRUPTED
    budget = run.budget
    counts = budget.num_nodes, budget.num_expansions, budget.num_children_scored, budget.num_children_valid
    stats = Stats(*counts, run.seconds, tuple(run.history), run.found_by, int(min(run.num_bytes, _MOST_BYTES)))
    return solution_of(problem, run.path, run.lower_bound, status, stats, run.samples, run.motions_factor)


class _Run:
    """One call of the planner: searches on finer and finer lattices, and the best path so far."""

    def __init__(self, problem: Problem, heuristic: HeuristicFn | None, options: BLOptions, began: float, bar: tqdm):
        self.problem, self.heuristic, self.options, self.began = problem, heuristic, options, began
        self.budget = SearchBudget(began + options.time_limit, options.max_expansions, options.max_memory)
        self.test = JointMotionTest(problem.workspace, problem.robots)
        self.lower_bound = max(
            straight_line_bound(problem), options.lower_bound or 0.0, _proven_cost(heuristic, problem)
        )
        self.motions_factor = float("inf")
        self.path: Float[np.ndarray, "steps robots dof"] | None = None
        self.cost = float("inf")
        self.history: list[tuple[float, float]] = []
        self.seconds: dict[str, float] = {}
        self.samples = problem.starts[None].copy()
        self.found_by, self.num_bytes = "", 0.0
        self.mark, self.progress = began, bar

    def until_done(self) -> Status:
        """Search, then search better, until the path is good enough or a limit is reached."""
        step, weight = self.options.step or self._first_step(), self.options.heuristic_weight
        if weight is None:
            weight = max(_WEIGHT, _WEIGHT_OF_ROBOT * len(self.problem.robots))
        while True:
            status, step = self._take_turns(step, weight)
            if status is not Status.SOLVED or self._is_good_enough():
                return status
            limit = self.budget.exceeded()
            if limit:
                return limit
            if self.options.step is not None and "lacam" in self.options.searchers:
                # On the same lattice, lazy search would do the same again.
                if "bl" not in self.options.searchers:
                    return Status.EXHAUSTED
                self.options = replace(self.options, searchers=("bl",))
            elif weight > _LEAST_WEIGHT:
                weight = (1 + weight) / 2
            elif self.options.step is not None:
                return Status.EXHAUSTED
            if self.options.step is None:
                step /= _REFINEMENT

    def _take_turns(self, step: float, weight: float) -> tuple[Status, float]:
        """Searches on finer and finer lattices, greedier and greedier, that take turns until one succeeds.

        Which lattice has room for robots to pass one another is not known before; one that has none would keep a
        single search busy for ever. Every round adds a lattice and lets the searches on each of the others go on.

        Returns:
            Why they ended, and the step of the one that did.
        """
        finest = self.options.step or _FINEST * float(self.problem.workspace.bounds.width.max())
        levels: list[SearchLevel] = []
        while True:
            limit = self.budget.exceeded()
            if limit:
                return limit, step
            fits = step >= finest and self._fits(step)
            if not levels and not fits:
                return (Status.EXHAUSTED if step < finest else Status.MEMORY_LIMIT), step
            if fits and (level := self._level(step, weight, may_halve=self.options.step is None and not levels)):
                levels.append(level)
                step, weight = level.step, weight * _GREEDIER
            for level in reversed(levels):
                status = self._run(level)
                if status is Status.SOLVED:
                    self.budget.memory = 0
                    self._offer_found(level)
                elif status is Status.EXHAUSTED:
                    levels.remove(level)
                    self.budget.memory -= level.memory
                if status not in (None, Status.EXHAUSTED):
                    return status, level.step
            step /= _REFINEMENT

    def _level(self, step: float, weight: float, may_halve: bool) -> SearchLevel | None:
        """The lattices of a step; None if a robot's own goal is out of its reach on them, or time is up.

        Coarse lattices may close a passage. Where robots go a long way around, halves of the step are tried.
        """
        try:
            level = self._build(step)
            while level is not None and may_halve and self._goes_around(level):
                finer = self._build(level.step / 2)
                if finer is None or finer.least_cost > (1 - _SHORTER) * level.least_cost:
                    break
                level = finer
            self._end_phase("lattice")
            if level is not None:
                self.num_bytes = max(self.num_bytes, self._needed(level.step))
                level.num_bytes = int(num_bytes(self.problem, level.step, len(self.options.primitives)))
                self.budget.memory += level.num_bytes
                level.begin(self.heuristic, weight, self.options, self.budget)
        except TimeoutError:
            return None
        finally:
            self._end_phase("heuristic")
        return level

    def _build(self, step: float) -> SearchLevel | None:
        return build_level(self.problem, self.test, step, self.options, self.budget.deadline)

    def _goes_around(self, level: SearchLevel) -> bool:
        """Whether a robot's way along its lattice is much longer than straight, and a finer lattice is not large."""
        problem, step = self.problem, level.step / 2
        straight = straight_costs(problem.starts, problem.goals, problem.rotation_weights)
        is_small = all(num_configurations(problem.workspace, each, step) <= _LARGEST_FIRST for each in problem.robots)
        fits = self._needed(step) < self.options.max_memory
        return is_small and fits and bool((level.least_costs > _AROUND * straight).any())

    def _run(self, level: SearchLevel) -> Status | None:
        """Let the searches on some lattices go on for a turn."""
        self.progress.set_postfix(step=f"{level.step:.3g}", nodes=self.budget.num_nodes, cost=f"{self.cost:.4g}")
        try:
            return level.run(self.options, self.budget, self.progress)
        finally:
            self.samples = level.joint.configurations(level.state)
            self._end_phase("search")

    def _offer_found(self, level: SearchLevel) -> None:
        """Offer a path that was found on some lattices, then cheaper ones along them, then shortened ones."""
        name, state = level.found
        self._offer(level, state, name)
        if len(self.problem.robots) > 1 and len(state) > 1:
            state = self._replanned(level, state, name)
        self._shorten(level.joint.configurations(state), level.step)

    def _replanned(self, level: SearchLevel, state: State, name: str) -> Int[np.ndarray, "rows robots"]:
        """Plan robots anew among the others, alone, then together with neighbors while that gains."""
        waiting = np.repeat(state[-1:], len(state) // _WAITING, axis=0)
        rows, tolerance = np.concatenate([state, waiting]), self.problem.workspace.tolerance
        if self.budget.memory + num_bytes_of_timetable(level.kinds, len(rows)) >= self.options.max_memory:
            return state
        try:
            timetable = Timetable(level.kinds, level.costs_to_go, rows, tolerance, self.budget.deadline)
        except TimeoutError:
            return state
        finally:
            self._end_phase("replan")
        replan_each(timetable)
        self._end_phase("replan")
        self._offer(level, timetable.state, name)
        rng = np.random.default_rng(0)
        while not self._is_good_enough() and not self.budget.exceeded():
            before = timetable.cost.sum()
            replan_neighbors(timetable, len(self.problem.robots), rng)
            self._end_phase("replan")
            self._offer(level, timetable.state, name)
            if before - timetable.cost.sum() <= _GAIN * before:
                break
        num_rows = 1 + len(timetable.state) - int(np.all(timetable.state == timetable.state[-1], axis=1)[::-1].sum())
        return timetable.state[:num_rows]

    def _offer(self, level: SearchLevel, state: State, name: str) -> None:
        """Offer a path along lattices, and if it becomes the best, say how far from the best of its motions it is.

        The cheapest motions of each robot alone cost no more than those of any path.
        """
        path, before, least = level.joint.configurations(state), self.cost, level.least_cost
        if not np.array_equal(path[0], self.problem.starts):  # a goal that is the start but for a whole turn
            path = np.concatenate([self.problem.starts[None], path])
        self._record(path)
        if self.cost < before:
            self.motions_factor = (1 + _ROUNDING) * self.cost / least if least > 0 else 1.0
            self.found_by = name

    def _shorten(self, path: Float[np.ndarray, "steps robots dof"], step: float) -> None:
        """Shorten a path, and keep each version that is the best yet, until one is good enough."""
        problem, test, deadline = self.problem, self.test, self.budget.deadline
        if not np.array_equal(path[0], problem.starts):
            path = np.concatenate([problem.starts[None], path])
        shortened = [lambda path: shorten(problem, path, test, deadline)]
        # Shortcuts leave a lone robot little to gain.
        if len(problem.robots) > 1 or self.options.cost_factor < float("inf"):
            shortened.append(lambda path: shorten_in_corridors(problem, path, test, step / 2, deadline))
        shortened.append(lambda path: shorten(problem, halved(path), test, deadline))
        for cheaper in shortened:
            if np.isfinite(self.options.cost_factor) and self._is_good_enough():
                return
            path = cheaper(path)
            self._end_phase("shorten")
            self._record(path)

    def _is_good_enough(self) -> bool:
        # A path of no cost is, whatever the factor: infinitely many times zero is no number.
        return self.cost == 0 or self.cost <= self.options.cost_factor * self.lower_bound * (1 + _ROUNDING)

    def _record(self, path: Float[np.ndarray, "steps robots dof"]) -> None:
        cost = path_cost(self.problem, path)
        if cost < self.cost:
            self.path, self.cost = path, cost
            self.history.append((time.perf_counter() - self.began, cost))

    def _end_phase(self, name: str) -> None:
        """Count the seconds since the last phase ended."""
        now = time.perf_counter()
        self.seconds[name] = self.seconds.get(name, 0.0) + now - self.mark
        self.mark = now

    def _fits(self, step: float) -> bool:
        """Whether the lattices of a step fit into memory beside what is there."""
        self.num_bytes = max(self.num_bytes, self._needed(step))
        return self._needed(step) < self.options.max_memory

    def _needed(self, step: float) -> float:
        return self.budget.memory + num_bytes(self.problem, step, len(self.options.primitives))

    def _first_step(self) -> float:
        """A step to begin with: the coarsest one tried if memory is short."""
        step, coarsest = _first_step(self.problem), _COARSEST * float(self.problem.workspace.bounds.width.max())
        while step < coarsest and not self._fits(step):
            step *= _REFINEMENT
        return step


def _proven_cost(heuristic: HeuristicFn | None, problem: Problem) -> float:
    """What a heuristic proves of the cost of any path: its value at the starts, if it is a lower bound, else 0."""
    if not (isinstance(heuristic, BoundingFn) and heuristic.is_lower_bound):
        return 0.0
    cost = float(heuristic(problem.starts[None].copy())[0])
    return (1 - _ROUNDING) * cost if np.isfinite(cost) else 0.0


def _first_step(problem: Problem) -> float:
    """A lattice about as fine as the smallest robot is large, but not one that takes long to build."""
    extent = float(problem.workspace.bounds.width.max())
    sizes = [min(robot.circumscribed_radius, robot.breadth) or _POINT_STEP * extent for robot in problem.robots]
    step = float(np.clip(min(sizes), _FINEST_FIRST * extent, _COARSEST_FIRST * extent))
    while max(num_configurations(problem.workspace, robot, step) for robot in problem.robots) > _LARGEST_FIRST:
        step *= _REFINEMENT
    return step
