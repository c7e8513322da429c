"""The planner for several robots at once (Section V of the paper, and searches beside it)."""

import math
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import partial

import numpy as np
from jaxtyping import Float, Int
from tqdm import tqdm

from plr_jax._problem import Problem, path_cost, straight_costs
from plr_jax._types import BoundingFn, HeuristicFn
from plr_jax.collision.team import JointMotionTest
from plr_jax.planners._heuristics import estimates, require_heuristic
from plr_jax.planners._options import SEARCHERS, BLOptions, Incumbent, SearchBudget, require_task
from plr_jax.planners._solution import Solution, Stats, Status, solution_of, straight_line_bound
from plr_jax.planners.lattice.joint import State
from plr_jax.planners.replanning import ReservationTable, num_bytes_of_table, replan_each, replan_neighborhoods
from plr_jax.planners.searches import LatticeLevel, Searches, build_level, num_bytes, work
from plr_jax.planners.sequential import sequential_path, side_by_side
from plr_jax.planners.smoothing import halved, shorten, shorten_in_corridors

_WAITING_SHARE = 1 / 4  # rows in which robots may wait, over those of a path
_NEAR_LEAST = 1.1  # cost of a path over that of the robots alone
_GAIN = 2e-3  # share of the cost below which replanning neighborhoods is not worth its time
_ROUNDING = 1e-9
_SEQUENTIAL = "sequential"


def until_arrival(state: State) -> Int[np.ndarray, "rows robots"]:
    """A path without the rows at its end in which all robots wait."""
    waits = np.all(state == state[-1], axis=1)
    return state[: len(state) + 1 - np.append(waits[::-1], False).argmin()]


# Steps, as shares of the longer side of the bounds: of the first lattice, and of the last one tried.
_COARSEST_FIRST, _POINT_STEP, _FINEST_FIRST, _FINEST = 1 / 16, 1 / 32, 1 / 512, 1 / 2048
_COARSEST = 1 / 4  # tried where memory is short
_ABREAST, _WIDEST = 4.5, 1.75  # times as wide as the workspace, robots abreast are a crowd; growth of its step
_PACKED = 1 / 2  # of the free area, covered by squares as wide as the smallest robot, one for each
_MOST_FIRST = 720_000  # motions to test for the first lattices, as of round robots
_AROUND = 1.5  # times a straight way, above which the first lattice is suspected to lack a passage
_SHORTER = 0.05  # share of the cost of all ways that a finer lattice must save to take its place
_REFINEMENT = 1.25
_WEIGHT, _WEIGHT_OF_ROBOT = 2.0, 3 / 8
_GREEDIER = 1.5  # growth of the weight from one search to the next
_LEAST_WEIGHT = 1.1  # below it, a finer lattice promises more than a smaller weight
_MOST_BYTES = 1 << 60  # that are told apart
_DEFAULT_OPTIONS = BLOptions()


def bl_plan(
    problem: Problem, heuristic: HeuristicFn | None = None, options: BLOptions = _DEFAULT_OPTIONS
) -> Solution:
    """Plan for all robots at once: search lattices until the team can reach its goals, then make its path cheap.

    A few discs among few walls may have a path at once: one goes after the other, each from corner to corner. It is
    kept where nothing cheaper is found.

    Every robot moves on a lattice, on which its start and goal are exact; robots of one kind share one. Two searches
    take turns on it, and on finer ones while none succeeds:

    - LaCAM, a lazy search over constraints, moves the whole team one step at a time: by PIBT, each robot takes its
      best free motion and pushes others out of its way. In the open, and at doors, it is over at once, for a hundred
      robots too.
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
            starts. A poor one, such as straight lines among walls, may well find
            nothing. None: each robot's cost-to-go along its lattice, alone, which takes no oracle and no PLR: the
            best choice where a plan is all that is asked for.
        options: How to search, and when to stop.

    Returns:
        The best path found, how far at the most from the best there is, and why the search ended: SOLVED if its cost
        is within ``cost_factor`` of the lower bound, and lattices were searched or cannot have a cheaper one;
        EXHAUSTED if nothing was left to search on the finest lattice (the given ``step``, or 1/2048 of the bounds),
        which proves nothing about finer ones; a limit, or INTERRUPTED. All but the first with or without a path.

    Raises:
        ValueError: If the heuristic is no function of joint configurations, or, where it is asked, returns NaN or
            another shape than ``(n,)``; or if the options are no :class:`BLOptions`.

    References:
        Barraquand and Latombe, "Robot motion planning: a distributed representation approach", 1991; Section V
        of the paper. Okumura, "LaCAM: search-based algorithm for quick multi-agent pathfinding", 2023. Li et al.,
        "Anytime multi-agent path finding via large neighborhood search", 2021.
    """
    if isinstance(heuristic, BLOptions):
        raise ValueError("The second argument of bl_plan is a heuristic: bl_plan(problem, options=BLOptions(...)).")
    if heuristic is not None:
        require_heuristic(heuristic)
    require_task(problem, options)
    began = time.perf_counter()
    run = _Run(problem, heuristic, options, began)
    try:
        try:
            status = run.in_turn()
            if status is None:
                with tqdm(desc="bl_plan", unit=" expansions", delay=3, leave=False, disable=None) as run.progress:
                    status = run.until_done()
        finally:  # interrupted or not
            run.set_out_early()
    except KeyboardInterrupt:
        status = Status.INTERRUPTED
    budget, best = run.budget, run.incumbent
    counts = budget.num_nodes, budget.num_expansions, budget.num_children_scored, budget.num_children_valid
    memory = int(min(run.num_bytes, _MOST_BYTES))
    stats = Stats(*counts, best.seconds, tuple(best.history), best.found_by, memory)
    return solution_of(problem, best.path, run.lower_bound, status, stats, run.samples, best.motions_factor)


class _Run:
    """One call of the planner: searches on finer and finer lattices, and the best path so far.

    A path that a search has found is made cheaper along the lattices first, then off them.
    """

    progress: tqdm  # while it searches lattices

    def __init__(self, problem: Problem, heuristic: HeuristicFn | None, options: BLOptions, began: float):
        self.problem, self.heuristic, self.options = problem, heuristic, options
        self.budget = SearchBudget(began + options.time_limit, options.max_expansions, options.max_memory)
        self.test = JointMotionTest(problem.workspace, problem.robots, self.budget.deadline)
        self.lower_bound, self.enough = options.lower_bound or 0.0, math.inf
        self.incumbent = Incumbent(problem, began)
        self.samples = problem.starts[None].copy()
        self.num_bytes, self.extent = 0.0, float(problem.workspace.bounds.width.max())

    def in_turn(self) -> Status | None:
        """Have one robot go after the other, if they can; SOLVED if the path is good enough, or none is cheaper."""
        if set(self.options.searchers) == set(SEARCHERS):  # else what one of them finds by itself is asked for
            with self.incumbent.phase("search"):
                path = sequential_path(self.problem)
            if path is not None:
                self.incumbent.offer(path, _SEQUENTIAL, math.inf)
        self.lower_bound = max(self.lower_bound, straight_line_bound(self.problem))
        if isinstance(self.heuristic, BoundingFn) and self.heuristic.is_lower_bound:
            cost = float(estimates(self.heuristic, self.problem.starts[None].copy())[0])
            self.lower_bound = max(self.lower_bound, (1 - _ROUNDING) * cost if cost < math.inf else 0.0)
        enough = (1 + _ROUNDING) * self.lower_bound
        if self.options.cost_factor < math.inf:
            self.enough = enough = self.options.cost_factor * enough
        return Status.SOLVED if self.incumbent.cost <= enough else None

    def until_done(self) -> Status:
        """Search, then search better, until the path is good enough or a limit is reached."""
        options, weight = self.options, self.options.heuristic_weight
        step = options.step or first_step(self.problem, len(options.primitives), self._fits)
        if weight is None:
            weight = max(_WEIGHT, _WEIGHT_OF_ROBOT * len(self.problem.robots))
        while True:
            status, step = self._take_turns(step, weight, options)
            if status is not Status.SOLVED or self.incumbent.cost <= self.enough:
                return status
            if limit := self.budget.exceeded():
                return limit
            following = _harder(step, weight, options)
            if following is None:
                return Status.EXHAUSTED
            step, weight, options = following

    def set_out_early(self) -> None:
        """Have robots that were to go one after the other go as early as they can, if that is the best path."""
        path = self.incumbent.path
        if path is not None and self.incumbent.found_by == _SEQUENTIAL:
            self.incumbent.retime(side_by_side(self.problem, path))

    def _take_turns(self, step: float, weight: float, options: BLOptions) -> tuple[Status, float]:
        """Searches on finer and finer lattices, greedier and greedier, that take turns until one succeeds.

        Which lattice has room for robots to pass one another is not known before; one that has none would keep a
        single search busy for ever. Every round adds a lattice and lets the searches on each of the others go on.

        Returns:
            Why they ended, and the step of the one that did.
        """
        finest = self.options.step or _FINEST * self.extent
        running: list[Searches] = []
        try:
            while True:
                if limit := self.budget.exceeded():
                    return limit, step
                fits = step >= finest and self._fits(step)
                if not running and not fits:
                    return (Status.EXHAUSTED if step < finest else Status.MEMORY_LIMIT), step
                if fits and (level := self._level(step, may_halve=options.step is None and not running)):
                    step = level.step
                    with self.incumbent.phase("heuristic"), suppress(TimeoutError):
                        running.append(Searches(level, self.heuristic, weight, options, self.budget))
                        weight *= _GREEDIER
                for searches in reversed(running):
                    status = self._search_on(searches)
                    if status is Status.SOLVED:
                        for other in set(running) - {searches}:
                            other.release()
                        self._improve(searches)
                    elif status is Status.EXHAUSTED:
                        searches.release()
                        running.remove(searches)
                    if status not in (None, Status.EXHAUSTED):
                        return status, searches.level.step
                step /= _REFINEMENT
        finally:
            for searches in running:
                searches.release()

    def _level(self, step: float, may_halve: bool) -> LatticeLevel | None:
        """The lattices of a step; None if a robot's own goal is out of its reach on them, or time is up.

        Coarse lattices may close a passage. Where robots go a long way around, halves of the step are tried.
        """
        build = partial(build_level, self.problem, self.test, primitives=self.options.primitives)
        with self.incumbent.phase("lattice"), suppress(TimeoutError):
            level = build(step=step)
            while level is not None and may_halve and self._goes_around(level):
                finer = build(step=level.step / 2)
                if finer is None or finer.least_cost > (1 - _SHORTER) * level.least_cost:
                    break
                level = finer
                self._fits(level.step)
            return level
        return None

    def _goes_around(self, level: LatticeLevel) -> bool:
        """Whether a robot's way along its lattice is much longer than straight, and a finer lattice is not large."""
        problem, step = self.problem, level.step / 2
        straight = straight_costs(problem.starts, problem.goals, problem.rotation_weights)
        is_small = work(problem, step, len(self.options.primitives)) <= _MOST_FIRST
        fits = self._needed(step) < self.options.max_memory
        return is_small and fits and bool((level.least_costs > _AROUND * straight).any())

    def _search_on(self, searches: Searches) -> Status | None:
        """Let the searches on some lattices go on for a turn."""
        step, cost = searches.level.step, self.incumbent.cost
        self.progress.set_postfix(step=f"{step:.3g}", nodes=self.budget.num_nodes, cost=f"{cost:.4g}")
        try:
            with self.incumbent.phase("search"):
                status = searches.run(self.progress)
        except TimeoutError:
            status = Status.TIME_LIMIT
        finally:
            self.samples = searches.level.joint.configurations(searches.state)
        if status is Status.MEMORY_LIMIT:
            self.num_bytes = max(self.num_bytes, self.budget.memory + searches.num_bytes_needed)
        return status

    def _improve(self, searches: Searches) -> None:
        """Offer a path that was found, then cheaper ones along the lattices, then shortened ones till one will do."""
        problem, test, level, (_, state) = self.problem, self.test, searches.level, searches.found
        path, found_by, factor = self._path(searches, state)
        self.incumbent.offer(path, found_by, factor)
        # A path that costs hardly more than the robots alone has nothing to gain that shortening does not find.
        gains = self.enough < math.inf or factor > _NEAR_LEAST
        if len(problem.robots) > 1 and len(state) > 1 and gains:
            path, _, factor = self._path(searches, self._replanned(searches, state))
        passes = [
            lambda path: shorten(problem, path, test),
            lambda path: shorten_in_corridors(problem, path, test, level.step / 2),
            lambda path: shorten(problem, halved(path), test),
        ]
        if len(problem.robots) == 1 and self.enough == math.inf:
            del passes[1]  # shortcuts leave a lone robot little to gain
        for cheaper in passes:
            if self.incumbent.cost <= self.enough < math.inf:
                return
            with self.incumbent.phase("shorten"):
                path = cheaper(path)
            self.incumbent.offer(path, found_by, factor)

    def _replanned(self, searches: Searches, state: State) -> Int[np.ndarray, "rows robots"]:
        """Plan robots anew among the others, each alone, then neighborhoods of them while that gains."""
        level, budget = searches.level, self.budget
        waiting = np.repeat(state[-1:], int(len(state) * _WAITING_SHARE), axis=0)
        rows, tolerance = np.concatenate([state, waiting]), self.problem.workspace.tolerance
        if budget.memory + num_bytes_of_table(level.kinds, len(rows)) >= budget.max_memory:
            return state
        table = None
        with self.incumbent.phase("replan"), suppress(TimeoutError):
            table = ReservationTable(level.kinds, level.costs_to_go, rows, tolerance, budget)
            # Whenever time is up from here on, the table's paths are free of collisions.
            replan_each(table)
            self.incumbent.offer(*self._path(searches, table.state))
            rng = np.random.default_rng(0)
            while self.incumbent.cost > self.enough and not budget.exceeded():
                before = table.cost.sum()
                replan_neighborhoods(table, len(self.problem.robots), rng)
                self.incumbent.offer(*self._path(searches, table.state))
                if before - table.cost.sum() <= _GAIN * before:
                    break
        if table is None:
            return state
        self.incumbent.offer(*self._path(searches, table.state))
        table.held.release()
        return until_arrival(table.state)

    def _path(self, searches: Searches, state: State) -> tuple[Float[np.ndarray, "steps robots dof"], str, float]:
        """The path of a state, who found it, and its cost over that of each robot's cheapest motions alone."""
        path, least = searches.level.joint.configurations(state), searches.level.least_cost
        if not np.array_equal(path[0], self.problem.starts):
            # A robot's goal is its start but for whole turns: the path begins with these.
            path = np.concatenate([self.problem.starts[None], path])
        cost = path_cost(self.problem, path)
        factor = (1 + _ROUNDING) * cost / least if least > 0 else 1.0 if cost == 0 else math.inf
        return path, searches.found[0], factor

    def _fits(self, step: float) -> bool:
        """Whether the lattices of a step fit into memory beside what is there. What they need is reported."""
        self.num_bytes = max(self.num_bytes, self._needed(step))
        return self._needed(step) < self.options.max_memory

    def _needed(self, step: float) -> float:
        return self.budget.memory + num_bytes(self.problem, step, len(self.options.primitives))


def first_step(problem: Problem, num_primitives: int, fits: Callable[[float], bool] = lambda step: True) -> float:
    """A step to begin with, of lattices that are built soon: the coarsest one tried if they do not fit."""
    # Cells about as large as the smallest robot, whose lattices have room for it to pass.
    extent, area = float(problem.workspace.bounds.width.max()), problem.workspace.free_space.area
    sizes = [min(robot.circumscribed_radius, robot.breadth) for robot in problem.robots]
    size = min(size or _POINT_STEP * extent for size in sizes)
    # Where many robots are under way at once, wider ones, as gaps narrower than a step close for good.
    widths = np.array([robot.breadth for robot in problem.robots])
    wide = size * float(np.clip((widths.sum() / math.sqrt(area) / _ABREAST) ** 2, 1.0, _WIDEST))
    # At a door they would do so as well: none may be narrower, for the centers of robots, than such a step.
    if wide > size and problem.workspace.free_space.buffer(-(widths.max() + wide) / 2).geom_type == "Polygon":
        size = wide
    step = float(np.clip(size, _FINEST_FIRST * extent, _COARSEST_FIRST * extent))
    # Robots that are packed move from place to place, one a robot, as in a sliding puzzle: all of them, or small ones
    # would have a lattice of large ones' places. One may be as wide as the workspace, but for the tolerance.
    if len(widths) * widths.min() ** 2 > _PACKED * area:
        step = extent / max(1, math.floor(extent / widths.max() + _ROUNDING))
    while step < _COARSEST * extent and (work(problem, step, num_primitives) > _MOST_FIRST or not fits(step)):
        step *= _REFINEMENT
    return step


def _harder(step: float, weight: float, options: BLOptions) -> tuple[float, float, BLOptions] | None:
    """The search after one that found a path: a finer lattice, a smaller weight; None if there is nothing left."""
    lighter = (1 + weight) / 2 if weight > _LEAST_WEIGHT else weight
    if options.step is None:
        return step / _REFINEMENT, lighter, options
    if "lacam" in options.searchers:  # on the same lattice it would do the same again
        return (step, weight, replace(options, searchers=("bl",))) if "bl" in options.searchers else None
    return (step, lighter, options) if lighter < weight else None
