"""The planner for several robots at once (Section V of the paper, and searches beside it)."""

import math
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace

import numpy as np
from tqdm import tqdm

from plr_jax._problem import Problem, path_cost, straight_costs
from plr_jax._types import BoundingFn, HeuristicFn
from plr_jax.collision.team import JointMotionTest
from plr_jax.planners._heuristics import require_estimates, require_heuristic
from plr_jax.planners._solution import (
    SEARCHERS,
    BLOptions,
    JointPath,
    MemoryUse,
    SearchBudget,
    Solution,
    Stats,
    Status,
    make_solution,
    require_problem_and_options,
    straight_line_bound,
)
from plr_jax.planners.best_first import BestFirstSearch, bytes_of_tables, tabulate
from plr_jax.planners.lacam import LaCAM, TeamMoves
from plr_jax.planners.lattice import PRIMITIVES, JointLattice, State, build_lattices, num_configurations
from plr_jax.planners.reservations import ReservationTable, num_bytes_of_table, replan_each, replan_neighborhoods
from plr_jax.planners.sequential import sequential_path, with_early_departures
from plr_jax.planners.shorten import shorten, shorten_in_corridors
from plr_jax.robots.robot import Robot, between

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
_WAITING_SHARE = 1 / 4  # rows in which robots may wait, over those of a path
_NEAR_LEAST = 1.1  # cost of a path over that of the robots alone
_GAIN = 2e-3  # share of the cost below which replanning neighborhoods is not worth its time
_ROUNDING = 1e-9
_SEQUENTIAL = "sequential"
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
        heuristic: Estimated cost-to-go of joint configurations ``(n, robots, dof)``, a sum over robots, such as
            :func:`zero`, :func:`straight_line` or :func:`sum_of_distances`, never NaN. Both searches go by its terms
            (``per_robot``). An infinite estimate prunes nothing, a negative one counts as 0. One that says it is a
            lower bound (``is_lower_bound``) bounds the cost of all paths by what it says of the starts. A poor one,
            such as straight lines among walls, may well find nothing. None: each robot's cost-to-go along its
            lattice, alone, which takes no oracle and no PLR: the best choice where a plan is all that is asked for.
        options: How to search, and when to stop.

    Returns:
        The best path found, how far at the most from the best there is, and why the search ended: SOLVED if its cost
        is within ``cost_factor`` of the lower bound, and lattices were searched or cannot have a cheaper one;
        EXHAUSTED if nothing was left to search on the finest lattice (the given ``step``, or 1/2048 of the bounds),
        which proves nothing about finer ones; a limit, or INTERRUPTED. All but the first with or without a path.

    Raises:
        ValueError: If the heuristic is no sum over robots, or, where it is asked, returns NaN or another shape, or if
            the options are no :class:`BLOptions`.

    References:
        Barraquand and Latombe, "Robot motion planning: a distributed representation approach", 1991; Section V
        of the paper. Okumura, "LaCAM: search-based algorithm for quick multi-agent pathfinding", 2023. Li et al.,
        "Anytime multi-agent path finding via large neighborhood search", 2021.
    """
    if isinstance(heuristic, BLOptions):
        raise ValueError("The second argument of bl_plan is a heuristic: bl_plan(problem, options=BLOptions(...)).")
    if heuristic is not None:
        require_heuristic(heuristic)
    require_problem_and_options(problem, options)
    run = Run(problem, heuristic, options, time.perf_counter())
    try:
        try:
            status = run.try_sequential_path()
            if status is None:
                with tqdm(desc="bl_plan", unit=" expansions", delay=3, leave=False, disable=None) as run.progress:
                    status = run.search_until_limit()
        finally:  # interrupted or not
            if run.path is not None and run.found_by == _SEQUENTIAL:
                # Robots that were to go one after the other set out as early as they can.
                run.path = with_early_departures(problem, run.path)
                run.history[-1] = (run.history[-1][0], path_cost(problem, run.path))
    except KeyboardInterrupt:
        status = Status.INTERRUPTED
    budget, memory = run.budget, int(min(run.num_bytes, _MOST_BYTES))
    counts = budget.num_nodes, budget.num_expansions, budget.num_children_scored, budget.num_children_valid
    stats = Stats(*counts, run.seconds, tuple(run.history), run.found_by, memory)
    return make_solution(problem, run.path, run.lower_bound, status, stats, run.samples, run.motions_factor)


class Run:
    """One call of the planner: searches on finer and finer lattices, and the best path so far.

    A path that a search has found is made cheaper along the lattices first, then off them.

    Attributes:
        path: The best path so far, None before there is one.
        cost: What it costs.
        found_by: The search that found it, or that it was shortened from.
        motions_factor: As in :class:`plr_jax.Solution`.
        history: Seconds and cost of each path that became the best one.
        seconds: By phase of the run.
    """

    progress: tqdm  # while it searches lattices

    def __init__(self, problem: Problem, heuristic: HeuristicFn | None, options: BLOptions, began: float):
        self.problem, self.heuristic, self.options = problem, heuristic, options
        self.budget = SearchBudget(began + options.time_limit, options.max_expansions, options.max_memory)
        self.test = JointMotionTest(problem.workspace, problem.robots, self.budget.deadline)
        self.lower_bound, self.accepted_cost = options.lower_bound or 0.0, math.inf
        self.path: JointPath | None = None
        self.cost, self.motions_factor, self.found_by = math.inf, math.inf, ""
        self.history: list[tuple[float, float]] = []
        self.seconds: dict[str, float] = {}
        self.began = self._mark = began
        self.samples = problem.starts[None].copy()
        self.num_bytes, self.extent = 0.0, float(problem.workspace.bounds.width.max())

    def offer(self, path: JointPath, found_by: str, motions_factor: float) -> None:
        """Take a path if it is cheaper than the best one so far."""
        seconds, cost = time.perf_counter() - self.began, path_cost(self.problem, path)
        if cost < self.cost:
            self.path, self.cost, self.found_by, self.motions_factor = path, cost, found_by, motions_factor
            self.history.append((seconds, cost))

    def end_phase(self, phase: str) -> None:
        """Count the seconds since the last phase ended."""
        now = time.perf_counter()
        self.seconds[phase] = self.seconds.get(phase, 0.0) + now - self._mark
        self._mark = now

    def try_sequential_path(self) -> Status | None:
        """Have one robot go after the other, if they can; SOLVED if the path is good accepted_cost, or none is cheaper."""
        if set(self.options.searchers) == set(SEARCHERS):  # else the result of one search by itself is wanted
            path = sequential_path(self.problem)
            self.end_phase("search")
            if path is not None:
                self.offer(path, _SEQUENTIAL, math.inf)
        self.lower_bound = max(self.lower_bound, straight_line_bound(self.problem))
        if isinstance(self.heuristic, BoundingFn) and self.heuristic.is_lower_bound:
            cost = float(require_estimates(self.heuristic(self.problem.starts[None].copy()), (1,))[0])
            self.lower_bound = max(self.lower_bound, (1 - _ROUNDING) * cost if cost < math.inf else 0.0)
        accepted_cost = (1 + _ROUNDING) * self.lower_bound
        if self.options.cost_factor < math.inf:
            self.accepted_cost = accepted_cost = self.options.cost_factor * accepted_cost
        return Status.SOLVED if self.cost <= accepted_cost else None

    def search_until_limit(self) -> Status:
        """Search, then search better, until the path is good accepted_cost or a limit is reached."""
        options, weight = self.options, self.options.heuristic_weight
        step = options.step or first_step(self.problem, self._fits)
        if weight is None:
            weight = max(_WEIGHT, _WEIGHT_OF_ROBOT * len(self.problem.robots))
        while True:
            status, step = self._search_lattices(step, weight, options)
            if status is not Status.SOLVED or self.cost <= self.accepted_cost:
                return status
            if limit := self.budget.exceeded():
                return limit
            # A finer lattice and a smaller weight, or on a given lattice best-first search alone: LaCAM would do the
            # same again.
            lighter = (1 + weight) / 2 if weight > _LEAST_WEIGHT else weight
            if options.step is None:
                step, weight = step / _REFINEMENT, lighter
            elif "lacam" in options.searchers and "bl" in options.searchers:
                options = replace(options, searchers=("bl",))
            elif "lacam" not in options.searchers and lighter < weight:
                weight = lighter
            else:
                return Status.EXHAUSTED

    def _search_lattices(self, step: float, weight: float, options: BLOptions) -> tuple[Status, float]:
        """Searches on finer and finer lattices, greedier and greedier, that take turns until one succeeds.

        Which lattice has room for robots to pass one another is not known before; one that has none would keep a
        single search busy for ever. Every round adds a lattice and lets the searches on each of the others go on.

        Returns:
            Why they ended, and the step of the lattice of the last one.
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
                if fits and (joint := self._lattices(step, may_halve=options.step is None and not running)):
                    step = joint.step
                    with suppress(TimeoutError):
                        running.append(Searches(joint, self.heuristic, weight, options, self.budget))
                        weight *= _GREEDIER
                    self.end_phase("heuristic")
                for searches in reversed(running):
                    self.progress.set_postfix(
                        step=f"{searches.joint.step:.3g}", nodes=self.budget.num_nodes, cost=f"{self.cost:.4g}"
                    )
                    try:
                        status = searches.run(self.progress)
                    except TimeoutError:
                        status = Status.TIME_LIMIT
                    finally:
                        self.end_phase("search")
                        self.samples = searches.joint.configurations(searches.node_states)
                    if status is Status.MEMORY_LIMIT:
                        self.num_bytes = max(self.num_bytes, self.budget.memory + searches.num_bytes_needed)
                    if status is Status.SOLVED:
                        for other in set(running) - {searches}:
                            other.release()
                        self._improve(searches)
                    elif status is Status.EXHAUSTED:
                        searches.release()
                        running.remove(searches)
                    if status not in (None, Status.EXHAUSTED):
                        return status, searches.joint.step
                step /= _REFINEMENT
                if not running and self.options.step is None:
                    # A lattice of places for packed robots has none to spare, as where a full ring must turn.
                    step = min(step, first_step(self.problem, self._fits, may_be_packed=False))
        finally:
            for searches in running:
                searches.release()

    def _lattices(self, step: float, may_halve: bool) -> JointLattice | None:
        """The lattices of a step; None if a robot's own goal is out of its reach on them, or time is up.

        Coarse lattices may close a passage. Where robots go a long way around, halves of the step are tried, as long
        as their lattices are small.
        """
        problem = self.problem
        straight, joint = straight_costs(problem.starts, problem.goals, problem.rotation_weights), None
        try:
            joint = build_lattices(problem, step, self.test)
            if not np.isfinite(joint.least_costs).all():
                joint = None
            while joint is not None and may_halve and (joint.least_costs > _AROUND * straight).any():
                half = joint.step / 2
                if _num_motions_to_test(problem, half) > _MOST_FIRST or self._needed(half) >= self.options.max_memory:
                    break
                finer = build_lattices(problem, half, self.test)
                # One that a robot cannot reach its goal on costs infinitely much.
                if not finer.least_costs.sum() <= (1 - _SHORTER) * joint.least_costs.sum():
                    break
                joint = finer
                self._fits(half)
            return joint
        except TimeoutError:
            return None
        finally:
            self.end_phase("lattice")

    def _improve(self, searches: "Searches") -> None:
        """Offer a path that was found, then cheaper ones along the lattices, then shortened ones till one will do."""
        found_by, state = searches.found
        path, factor = self._path(searches, state)
        self.offer(path, found_by, factor)
        # A path that costs hardly more than the robots alone has nothing to gain that shortening does not find.
        gains = self.accepted_cost < math.inf or factor > _NEAR_LEAST
        if len(self.problem.robots) > 1 and len(state) > 1 and gains:
            path, factor = self._path(searches, self._replanned(searches, state))
        for number, shortened in enumerate((shorten, shorten_in_corridors, shorten)):
            if self.cost <= self.accepted_cost < math.inf:
                return
            if number == 1 and len(self.problem.robots) == 1 and self.accepted_cost == math.inf:
                continue  # shortcuts leave a lone robot little to gain
            if number == 2:  # a row in the middle of every motion
                middle, path = between(path[:-1], path[1:], np.full((1, 1, 1), 0.5)), np.repeat(path, 2, axis=0)[:-1]
                path[1::2] = middle
            more = (searches.joint.step / 2,) if number == 1 else ()
            path = shortened(self.problem, path, self.test, *more)
            self.end_phase("shorten")
            self.offer(path, found_by, factor)

    def _replanned(self, searches: "Searches", state: State) -> State:
        """Plan robots anew among the others, each alone, then neighborhoods of them while that gains."""
        joint, budget, (found_by, _) = searches.joint, self.budget, searches.found
        waiting = np.repeat(state[-1:], int(len(state) * _WAITING_SHARE), axis=0)
        rows = np.concatenate([state, waiting])
        if budget.memory + num_bytes_of_table(joint, len(rows)) >= budget.max_memory:
            return state
        table = None
        with suppress(TimeoutError):
            table = ReservationTable(joint, rows, budget)
            # Whenever time is up from here on, the table's paths are free of collisions.
            replan_each(table)
            rng, gains = np.random.default_rng(0), True
            while gains:
                path, factor = self._path(searches, table.state)
                self.offer(path, found_by, factor)
                if self.cost <= self.accepted_cost or budget.exceeded():
                    break
                before = table.cost.sum()
                replan_neighborhoods(table, len(self.problem.robots), rng)
                gains = before - table.cost.sum() > _GAIN * before
        self.end_phase("replan")
        if table is None:
            return state
        path, factor = self._path(searches, table.state)
        self.offer(path, found_by, factor)
        table.memory_use.release()
        # Without the rows at its end in which all robots wait.
        waits = np.all(table.state == table.state[-1], axis=1)
        return table.state[: len(waits) + 1 - np.append(waits[::-1], False).argmin()]

    def _path(self, searches: "Searches", state: State) -> tuple[JointPath, float]:
        """The path of a state, and its cost over that of each robot's cheapest motions alone."""
        path, least = searches.joint.configurations(state), float(searches.joint.least_costs.sum())
        if not np.array_equal(path[0], self.problem.starts):
            # A robot's goal is its start but for whole turns: the path begins with these.
            path = np.concatenate([self.problem.starts[None], path])
        cost = path_cost(self.problem, path)
        return path, (1 + _ROUNDING) * cost / least if least > 0 else 1.0 if cost == 0 else math.inf

    def _fits(self, step: float) -> bool:
        """Whether the lattices of a step fit into memory beside what is there. What they need is reported."""
        needed = self._needed(step)
        self.num_bytes = max(self.num_bytes, needed)
        return needed < self.options.max_memory

    def _needed(self, step: float) -> float:
        return self.budget.memory + num_bytes(self.problem, step)


_MOTION_BYTES = 92  # what a motion takes while its table is built
_COLUMN_BYTES = 16  # what a robot's costs to and from a node take
_TURNING = 4  # times as long as a round robot's motion one takes to test that turns


def num_bytes(problem: Problem, step: float) -> float:
    """About what the lattices of a step take if all is free, so that those too large are not begun."""
    total = 0.0
    for (robot, _), count in _kinds(problem).items():
        nodes = num_configurations(problem.workspace, robot, step) + 2 * count
        total += nodes * (_MOTION_BYTES * (1 + len(PRIMITIVES)) + _COLUMN_BYTES * count)
    return total


def _num_motions_to_test(problem: Problem, step: float) -> float:
    """About how many motions have to be tested to build the lattices of a step; one that turns counts as several."""
    of_dof = {2: 1, 3: _TURNING}
    each = (of_dof[robot.dof] * num_configurations(problem.workspace, robot, step) for robot, _ in _kinds(problem))
    return (1 + len(PRIMITIVES)) * sum(each)


def _kinds(problem: Problem) -> Counter[tuple[Robot, float]]:
    """The robots that share a table, with the weight of their turns, and how many there are."""
    return Counter(zip(problem.robots, problem.rotation_weights.tolist(), strict=True))


# The first turn of each search: idle steps of LaCAM a robot; expansions of best-first search over the robots or over
# their square, whichever is less, as an expansion takes as long as there are pairs of robots.
_IDLE_STEPS, _EXPANSIONS, _EXPANSIONS_OF_PAIRS = 8, 1024, 4096
_TERM_BYTES = 8  # what a term of the heuristic takes, which is kept twice where it was asked for
_LONGER = 1.5  # growth of turns


class Searches:
    """LaCAM and best-first search, or one of them, on lattices.

    Both go by the heuristic, and by the costs-to-go along the lattices if there is none.

    Args:
        joint: The lattices.
        heuristic: As given to the planner.
        weight: Of the heuristic in best-first search.
        options: Those of the planner.
        budget: What it may still do.

    Raises:
        TimeoutError: If the deadline passes before the heuristic is known.
    """

    def __init__(
        self,
        joint: JointLattice,
        heuristic: HeuristicFn | None,
        weight: float,
        options: BLOptions,
        budget: SearchBudget,
    ):
        self.joint, self.weight, self.options, self.budget = joint, weight, options, budget
        self.memory_use = MemoryUse(budget)
        num_nodes = sum(len(lattice.q) for lattice in joint.lattices)
        self.memory_use.add(
            int(num_bytes(joint.problem, joint.step)) + _TERM_BYTES * num_nodes * (1 if heuristic is None else 2)
        )
        self.terms = joint.costs_to_go if heuristic is None else tabulate(joint, heuristic, budget.deadline)
        self.running: dict[str, LaCAM | BestFirstSearch] = {}
        if "lacam" in options.searchers:
            self.running["lacam"] = LaCAM(joint, TeamMoves(joint, self.terms), budget)
        self.turn = 1.0  # length of the next one, in first ones

    def run(self, bar: tqdm) -> Status | None:
        """Let each search go on for a turn, which is half as long again as the one before.

        Returns:
            SOLVED, or the limit that is reached; EXHAUSTED if no path along the lattices is left; None for a pause.

        Raises:
            TimeoutError: If the deadline passes within a step.
        """
        budget, status = self.budget, None
        num_robots, finds_all = len(self.joint.lattices), "lacam" in self.running
        if finds_all:
            status = self.running["lacam"].run(int(self.turn * _IDLE_STEPS * num_robots), bar)
        lacks_path = status is None and "bl" in self.options.searchers
        if lacks_path and ("bl" in self.running or budget.memory + self.num_bytes_needed < self.options.max_memory):
            if "bl" not in self.running:
                self.running["bl"] = BestFirstSearch(self.joint, self.terms, self.weight, budget)
            expansions = min(_EXPANSIONS / num_robots, _EXPANSIONS_OF_PAIRS / num_robots**2)
            status = self.running["bl"].run(max(1, int(self.turn * expansions)), bar)
        elif not finds_all:
            return Status.MEMORY_LIMIT
        self.turn *= _LONGER
        return status

    def release(self) -> None:
        """Stop counting what the lattices and the searches hold."""
        for each in (self, *self.running.values()):
            each.memory_use.release()

    @property
    def found(self) -> tuple[str, State]:
        """The search that has reached the goals, and its states from the starts to them."""
        return next(
            (name, search.solution_states) for name, search in self.running.items() if search.found is not None
        )

    @property
    def node_states(self) -> State:
        """The nodes of the search that has more of them, or the starts before there is one."""
        starts = np.array([[lattice.start for lattice in self.joint.lattices]])
        return max((search.node_states for search in self.running.values()), key=len, default=starts)

    @property
    def num_bytes_needed(self) -> int:
        """What best-first search needs to begin, beside what is held."""
        return 0 if "bl" in self.running else bytes_of_tables(self.joint)


def first_step(
    problem: Problem, fits: Callable[[float], bool] = lambda step: True, may_be_packed: bool = True
) -> float:
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
    if may_be_packed and len(widths) * widths.min() ** 2 > _PACKED * area:
        step = extent / max(1, math.floor(extent / widths.max() + _ROUNDING))
    while step < _COARSEST * extent and (_num_motions_to_test(problem, step) > _MOST_FIRST or not fits(step)):
        step *= _REFINEMENT
    return step
