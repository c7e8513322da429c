"""The team planner :func:`bl_plan` (Section V of the paper): lattice searches, replanning and shortening."""

import math
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial

import numpy as np

from plr_jax._problem import ROUNDING, JointPath, Problem, makespan, motion_costs, path_cost, robot_kinds
from plr_jax._progress import Progress
from plr_jax._types import BoundingFn, HeuristicFn
from plr_jax.collision.motions import JointMotionTest
from plr_jax.planners._heuristics import require_estimates, require_heuristic
from plr_jax.planners._solution import SearchBudget, Solution, Stats, Status, make_solution, straight_line_bound
from plr_jax.planners.lattice import PRIMITIVES, JointLattice, State, num_configurations
from plr_jax.planners.reservations import ReservationTable, num_bytes_of_table, replan_each, replan_neighborhoods
from plr_jax.planners.searches import SEARCHES, BLOptions, Searches, num_bytes, require_problem_and_options
from plr_jax.planners.sequential import sequential_path, with_early_departures
from plr_jax.planners.shorten import shorten, shorten_in_corridors
from plr_jax.planners.through_time import subdivided
from plr_jax.robots import between

# Steps (cell sizes of lattices), as shares of the bounds' longer side:
_COARSEST_FIRST = 1 / 16  # coarsest first step
_FINEST_FIRST = 1 / 512  # finest first step
_POINT_STEP = 1 / 32  # first step for points
_FINEST = 1 / 2048  # finest step that is tried
_COARSEST = 1 / 4  # coarsest step, for problems that otherwise exceed the memory or the motion tests
# Choice of the steps:
_CROWD_WIDTH = 4.5  # a crowd's robots side by side are wider than this many square roots of the free area
_MAX_CROWD_GROWTH = 1.75  # largest growth of the first step for a crowd
_PACKED = 1 / 2  # share of the free area that packed robots exceed, each in a square as wide as the narrowest
_MAX_FIRST_TESTS = 720_000  # motion tests for the first lattices
_TURNING = 4  # time of a motion test with turns, over the time without
_DETOUR = 1.5  # a lattice path longer than this many straight lines suggests a passage that the lattice closes
_LEAST_SAVING = 0.05  # share of the path costs that a finer first lattice must save
_REFINEMENT = 1.25  # ratio of one step to the next
# The weight of the heuristic:
_WEIGHT = 2.0  # least default weight
_WEIGHT_PER_ROBOT = 3 / 8  # default weight per robot of the team, if that is more
_WEIGHT_GROWTH = 1.5  # from one lattice to the next finer one
_LEAST_WEIGHT = 1.1  # smaller weights help less than a finer lattice
# Improvement of a path:
_WAITING_SHARE = 1 / 4  # rows added for waiting when robots are replanned, as a share of the path's rows
_NEAR_LEAST = 1.1  # path cost over the robots' least costs up to which replanning is skipped
_GAIN = 2e-3  # replanning of neighborhoods stops if it saves a smaller share of the cost
_SEQUENTIAL = "sequential"
_FEW_LATTICES = 3  # lattices that are tried for a cheaper path than the sequential one
_SEQUENTIAL_ROWS = 100  # rows into which the sequential path is divided before it is shortened
_MAX_REPORTED_BYTES = 1 << 60
DEFAULTS = BLOptions()


def bl_plan(problem: Problem, heuristic: HeuristicFn | None = None, options: BLOptions = DEFAULTS) -> Solution:
    """Plan collision-free paths for all robots of a problem, from their starts to their goals.

    The common call is ``solution = bl_plan(problem)``. Then ``solution.path`` is an array ``(steps, robots, dof)`` or
    None, and ``solution.status`` says why the planner ended. ``options=BLOptions(time_limit=10)`` limits the seconds.

    Args:
        problem: Workspace, robots, starts and goals.
        heuristic: Estimated cost-to-go of joint configurations ``(n, robots, dof)``, as a sum over robots:
            :func:`zero`, :func:`straight_line` or :func:`sum_of_distances`. None, the best choice for a single plan:
            each robot's cost-to-go along its lattice. ``inf`` prunes nothing, and negative estimates count as 0. A
            poor heuristic, such as straight lines among walls, may prevent a solution.
        options: How to search, and when to stop.

    Returns:
        The best path found, a lower bound of all path costs, and a status. SOLVED: the cost is at most
        ``cost_factor`` (default: infinite) times the lower bound, also if a limit ended its improvement.
        EXHAUSTED: no search is left on the finest lattice (the given ``step``, or 1/2048 of the bounds), which proves
        nothing about finer lattices. MEMORY_LIMIT: the limit was reached, or best-first search found nothing after it
        left out children to save memory. Other statuses name another limit, or INTERRUPTED after Ctrl-C. Only SOLVED
        always comes with a path. The lower bound is the largest of ``options.lower_bound``, the cost of straight
        motions, and the heuristic at the starts if its ``is_lower_bound`` is true. Results are deterministic unless
        the time limit ends a search.

    Raises:
        ValueError: If an argument has a wrong type, or the heuristic returns NaN or a wrong shape.

    How it works:

    1. A few discs among few walls move one after the other, from corner to corner. This path is shortened and
       returned, unless one of the first three lattices of step 2 has a cheaper one.
    2. Robots move on finer and finer lattices (grids of configurations that include the exact starts and goals) until
       one of two searches succeeds. LaCAM moves the whole team one step at a time: each robot takes its best free
       motion and pushes others out of its way (PIBT). Best-first search finds coordinated maneuvers, such as a swap.
    3. Robots are replanned on the lattices, one by one, while all other robots keep their paths. Then straight
       shortcuts, and deviations within narrow corridors, shorten the path.
    4. With a ``cost_factor`` that is not met yet, groups of robots are replanned together, and searches continue with
       finer lattices and smaller weights.

    References: Barraquand and Latombe, "Robot motion planning: a distributed representation approach", 1991; Section
    V of the paper. Okumura, "LaCAM: search-based algorithm for quick multi-agent pathfinding", 2023. Li et al.,
    "Anytime multi-agent path finding via large neighborhood search", 2021.
    """
    if isinstance(heuristic, BLOptions):
        raise ValueError("heuristic must not be BLOptions(...): call bl_plan(problem, options=BLOptions(...)).")
    if heuristic is not None:
        require_heuristic(heuristic)
    require_problem_and_options(problem, options)
    run = Run(problem, heuristic, options, time.perf_counter())
    try:
        if (status := run.try_sequential_path()) is None:
            with Progress("bl_plan", "expansions") as progress:
                status = run.search_until_limit(progress)
            run.shorten_sequential_path()
        if run.path is not None and run.cost <= run.accepted_cost:
            status = Status.SOLVED
    except KeyboardInterrupt:
        status = Status.INTERRUPTED
    budget, memory = run.budget, int(min(run.num_bytes, _MAX_REPORTED_BYTES))
    counts = budget.num_nodes, budget.num_expansions, budget.num_children_scored, budget.num_children_valid
    stats = Stats(*counts, run.seconds, tuple(run.history), run.found_by, memory)
    solution = make_solution(problem, run.path, run.lower_bound, status, stats, run.samples)
    return replace(solution, motions_factor=run.motions_factor)


class Run:
    """A call of :func:`bl_plan`: the best path so far, and the searches that improve it."""

    def __init__(self, problem: Problem, heuristic: HeuristicFn | None, options: BLOptions, began: float):
        self.problem, self.heuristic, self.options = problem, heuristic, options
        self.budget = SearchBudget(began + options.time_limit, options.max_expansions, options.max_memory)
        self.test = JointMotionTest(problem.workspace, problem.robots, self.budget.deadline)
        self.lower_bound, self.accepted_cost = options.lower_bound, math.inf
        self.path: JointPath | None = None
        self.is_sequential_short = False  # whether the sequential path was shortened
        self.cost, self.motions_factor, self.found_by = math.inf, math.inf, ""
        self.history: list[tuple[float, float]] = []
        self.seconds: dict[str, float] = {}
        self.began = self._mark = began
        self.samples = problem.starts[None].copy()
        self.num_bytes = 0.0  # largest memory that was used or would have been needed

    def record(self, path: JointPath, found_by: str, motions_factor: float) -> None:
        """Keep a path if it is the cheapest so far.

        ``found_by`` names the search that found the path, and ``motions_factor`` is as in :class:`Solution`.
        """
        seconds, cost = time.perf_counter() - self.began, path_cost(self.problem, path)
        if cost < self.cost:
            self.path, self.cost, self.found_by, self.motions_factor = path, cost, found_by, motions_factor
            self.history.append((seconds, cost))

    def end_phase(self, phase: str) -> None:
        now = time.perf_counter()
        self.seconds[phase] = self.seconds.get(phase, 0.0) + now - self._mark
        self._mark = now

    def try_sequential_path(self) -> Status | None:
        """Record a path on which robots move one after the other, if one is found, and compute the lower bound.

        Return SOLVED if the path needs no improvement, else None.
        """
        # 1. Record the path, if there is one. A user who leaves out a default search wants to see the rest alone.
        if {*DEFAULTS.searchers} <= {*self.options.searchers}:
            if (path := sequential_path(self.problem)) is not None:
                # Early departures take up to a tenth of a second: until then, an interrupt keeps the path as it is.
                self.record(path, _SEQUENTIAL, math.inf)
                self.path = with_early_departures(self.problem, path)
                self.history[-1] = self.history[-1][0], path_cost(self.problem, self.path)  # equal but for rounding
            self.end_phase("search")
        # 2. Compute the lower bound, and the largest cost that is accepted. Without a cost factor, only a path whose
        #    cost is the lower bound needs no improvement.
        self.lower_bound = max(self.lower_bound, straight_line_bound(self.problem))
        if isinstance(self.heuristic, BoundingFn) and self.heuristic.is_lower_bound:
            cost = float(require_estimates(self.heuristic(self.problem.starts[None].copy()), (1,))[0])
            self.lower_bound = max(self.lower_bound, (1 - ROUNDING) * cost if cost < math.inf else 0.0)
        accepted_cost = (1 + ROUNDING) * self.lower_bound
        if self.options.cost_factor < math.inf:
            self.accepted_cost = accepted_cost = self.options.cost_factor * accepted_cost
        return Status.SOLVED if self.cost <= accepted_cost else None

    def shorten_sequential_path(self, factor: float = math.inf) -> bool:
        """Shorten the sequential path, on which robots move one after the other, if it is the best path so far.

        The path is shortened only once. Return whether it is the best path and costs at most ``accepted_cost``. The
        path is recorded with ``factor`` as its ``motions_factor`` (see :class:`Solution`).
        """
        if self.path is not None and self.found_by == _SEQUENTIAL and not self.is_sequential_short:
            self.is_sequential_short = True
            width = makespan(self.problem, self.path) / _SEQUENTIAL_ROWS
            self._shorten(subdivided(self.problem, self.path, width), _SEQUENTIAL, factor, width)
        return self.found_by == _SEQUENTIAL and self.cost <= self.accepted_cost

    def search_until_limit(self, progress: Progress) -> Status:
        """Search lattices until a path is cheap enough, a limit is reached or nothing is left to try.

        From one search to the next the lattice gets finer, and the weight of the heuristic falls. If the user gave a
        step, searches that ignore the weight search only once, and then only the weight falls.
        """
        weight = self.options.heuristic_weight
        names = [name for name in SEARCHES if name in self.options.searchers]
        weighted = [name for name in names if SEARCHES[name].is_weighted]
        step = self.options.step or first_step(self.problem, self._fits)
        if weight is None:
            weight = max(_WEIGHT, _WEIGHT_PER_ROBOT * len(self.problem.robots))
        while True:
            status, step = self._run_searches(step, weight, names, progress)
            if status is not Status.SOLVED or self.cost <= self.accepted_cost:
                return status
            if limit := self.budget.exceeded():
                return limit
            # Refine the lattice and lower the weight. On a given lattice, searches that ignore the weight would only
            # repeat themselves.
            lighter = (1 + weight) / 2 if weight > _LEAST_WEIGHT else weight
            if self.options.step is None:
                step, weight = step / _REFINEMENT, lighter
            elif weighted and names != weighted:
                names = weighted
            elif weighted and lighter < weight:
                weight = lighter
            else:
                return Status.EXHAUSTED

    def _run_searches(
        self, step: float, weight: float, names: Sequence[str], progress: Progress
    ) -> tuple[Status, float]:
        """Search lattices of cell size ``step`` and finer; return why this ended, and a cell size to go on with."""
        finest = self.options.step or _FINEST * float(self.problem.workspace.bounds.width.max())
        running: list[Searches] = []  # from the coarsest lattice to the finest
        is_complete = True  # whether all searches that ended had tried everything
        num_lattices = 0
        try:
            while True:
                # 1. Stop if a limit is reached or no search can be run.
                if num_lattices == _FEW_LATTICES and self.shorten_sequential_path():
                    return Status.SOLVED, step
                if limit := self.budget.exceeded():
                    return limit, step
                # A lattice without room to pass would keep one search busy forever: every round adds a lattice.
                fits = step >= finest and self._fits(step)
                if not running and not fits:
                    return (Status.EXHAUSTED if step < finest and is_complete else Status.MEMORY_LIMIT), step
                # 2. Begin searches on the next finer lattice, unless time is up meanwhile.
                if fits and (joint := self._lattices(step, may_halve=self.options.step is None and not running)):
                    step = joint.step
                    with suppress(TimeoutError):
                        running.append(Searches(joint, self.heuristic, weight, names, self.budget))
                        weight *= _WEIGHT_GROWTH
                    self.end_phase("heuristic")
                # 3. Give all searches a turn, the newest first. (The loop may remove the present entry.)
                for searches in reversed(running):
                    size = f"step={searches.joint.step:.3g}, nodes={self.budget.num_nodes}"
                    progress.update(0, f"{size}, cost={self.cost:.4g}")
                    try:
                        status = searches.run(progress)
                    except TimeoutError:
                        status = Status.TIME_LIMIT
                    finally:
                        self.end_phase("search")
                        self.samples = searches.joint.configurations(searches.node_states)
                    if status is Status.MEMORY_LIMIT:
                        self.num_bytes = max(self.num_bytes, self.budget.memory + searches.num_bytes_needed)
                    if status is Status.SOLVED:
                        # Free memory for the improvement; releasing searches twice does no harm.
                        for other in set(running) - {searches}:
                            other.release()
                        self._improve(searches)
                    elif status is Status.EXHAUSTED:
                        is_complete &= any(search.is_complete for search in searches.running.values())
                        searches.release()
                        running.remove(searches)
                    if status not in (None, Status.EXHAUSTED):
                        return status, searches.joint.step
                step /= _REFINEMENT
                num_lattices += 1
                if not running and self.options.step is None:
                    # The lattice for packed robots has no spare cell, for example if a full ring must rotate.
                    step = min(step, first_step(self.problem, self._fits, may_pack=False))
        finally:
            for searches in running:
                searches.release()

    def _lattices(self, step: float, may_halve: bool) -> JointLattice | None:
        """Build lattices of cell size ``step``; None if a goal is cut off on them or time is up.

        If ``may_halve``, the cell size is halved as long as robots make long detours and finer lattices help.
        """
        straight = motion_costs(self.problem, self.problem.starts, self.problem.goals)
        try:
            joint = JointLattice(self.problem, step, self.test)
            if not np.isfinite(joint.least_costs).all():
                return None
            # Coarse lattices may close a passage: halve the step if robots make detours and lattices stay small.
            while may_halve and (joint.least_costs > _DETOUR * straight).any():
                half = joint.step / 2
                if _num_motions_to_test(self.problem, half) > _MAX_FIRST_TESTS or not self._fits(half):
                    break
                finer = JointLattice(self.problem, half, self.test)
                if not finer.least_costs.sum() <= (1 - _LEAST_SAVING) * joint.least_costs.sum():
                    break  # also if a goal is cut off in the finer lattice, whose cost is then inf
                joint = finer
            return joint
        except TimeoutError:
            return None
        finally:
            self.end_phase("lattice")

    def _improve(self, searches: Searches) -> None:
        """Replan and shorten the path that ``searches`` found, and record each path that is the cheapest so far."""
        # 1. Replan robots one by one. If the path costs little more than the least costs, shortening alone finds what
        #    can be gained.
        state = searches.running[searches.ended_by].solution_states
        path, factor = self._recorded(searches, state)
        can_replan = len(self.problem.robots) > 1 and len(state) > 1
        if can_replan and factor > _NEAR_LEAST:
            state = self._replanned(searches, state, in_groups=False)
            path, factor = self._recorded(searches, state)
        # 2. Shorten the sequential path instead if it is still the cheapest, else this path.
        if self.shorten_sequential_path(factor):
            return
        self._shorten(path, searches.ended_by, factor, searches.joint.step / 2)
        # 3. If the cost is not accepted, replan groups of robots, too.
        if can_replan and self.accepted_cost < self.cost:
            path, factor = self._recorded(searches, self._replanned(searches, state, in_groups=True))
            self._shorten(path, searches.ended_by, factor, searches.joint.step / 2)

    def _shorten(self, path: JointPath, found_by: str, factor: float, width: float) -> None:
        """Shorten a path in three phases, and record the path after each phase.

        The phases are straight shortcuts, deviations in corridors of at most ``width``, and shortcuts on the path
        with twice as many rows. End as soon as the cost is accepted. ``found_by`` and ``factor`` are recorded with
        the path.
        """
        for phase, method in enumerate((shorten, partial(shorten_in_corridors, width=width), shorten)):
            if self.cost <= self.accepted_cost < math.inf:
                return
            if phase == 1 and len(self.problem.robots) == 1 and self.accepted_cost == math.inf:
                continue  # after shortcuts, corridors gain little for a single robot
            if phase == 2:  # add a row in the middle of every motion
                middle = between(path[:-1], path[1:], np.full((1, 1, 1), 0.5))
                path = np.insert(path, np.arange(1, len(path)), middle, axis=0)
            path = method(self.problem, path, self.test)
            self.end_phase("shorten")
            self.record(path, found_by, factor)

    def _replanned(self, searches: Searches, state: State, in_groups: bool) -> State:
        """Replan robots one by one and, if ``in_groups``, in groups until the cost is accepted or little is gained.

        ``state`` has the lattice node of each robot at each step of the path, ``(steps, robots)``. Return this array
        for the new path.
        """
        joint, budget = searches.joint, self.budget
        rows = np.concatenate([state, np.repeat(state[-1:], int(len(state) * _WAITING_SHARE), axis=0)])
        if not budget.has_memory(num_bytes_of_table(joint, len(rows))):
            return state
        table = ReservationTable(joint, rows, budget)
        with suppress(TimeoutError, MemoryError):  # the table's paths are always free of collisions
            table.reserve([*range(len(joint.lattices))])
            replan_each(table)
            self._recorded(searches, table.state)
            rng, gains = np.random.default_rng(0), in_groups
            while gains and self.cost > self.accepted_cost and not budget.exceeded():
                before = table.cost.sum()
                replan_neighborhoods(table, len(self.problem.robots), rng)
                self._recorded(searches, table.state)
                gains = before - table.cost.sum() > _GAIN * before
        self.end_phase("replan")
        table.memory_use.release()
        # Drop the rows at the end in which all robots wait, but keep one (`argmin` is the number of equal last rows).
        waits = np.all(table.state == table.state[-1], axis=1)
        return table.state[: len(waits) + 1 - np.append(waits[::-1], False).argmin()]

    def _recorded(self, searches: Searches, state: State) -> tuple[JointPath, float]:
        """Record and return the path through lattice nodes ``state``, and an upper bound of its cost ratio.

        The ratio is the cost of the path over the sum of the least costs of single robots on their lattices.
        """
        path = searches.joint.configurations(state)
        least = float(searches.joint.least_costs.sum())
        if not np.array_equal(path[0], self.problem.starts):
            path = np.concatenate([self.problem.starts[None], path])  # goals equal starts up to whole turns
        cost = path_cost(self.problem, path)
        factor = (1 + ROUNDING) * cost / least if least > 0 else 1.0 if cost == 0 else math.inf
        self.record(path, searches.ended_by, factor)
        return path, factor

    def _fits(self, step: float) -> bool:
        needed = num_bytes(self.problem, step)
        self.num_bytes = max(self.num_bytes, self.budget.memory + needed)
        return self.budget.has_memory(needed)


def _num_motions_to_test(problem: Problem, step: float) -> float:
    times = {2: 1, 3: _TURNING}  # by degrees of freedom
    kinds = robot_kinds(problem)
    tests = (times[robot.dof] * num_configurations(problem.workspace, robot, step) for robot, _ in kinds)
    return (1 + len(PRIMITIVES)) * sum(tests)


def first_step(problem: Problem, fits: Callable[[float], bool] = lambda step: True, may_pack: bool = True) -> float:
    """Choose the cell size of the first lattices: about the size of the smallest robot, or larger.

    Cells are larger for a crowd. With ``may_pack``, robots that fill most of the free area get cells as wide as
    the widest robot. Cells are enlarged until few enough motions must be tested and ``fits(step)`` is true, which
    says whether lattices of cell size ``step`` fit into the memory limit.
    """
    # 1. Cells about as large as the smallest robot give it room to pass. Points have size 0.
    extent, area = float(problem.workspace.bounds.width.max()), problem.workspace.free_space.area
    size = min(min(robot.circumscribed_radius, robot.breadth) or _POINT_STEP * extent for robot in problem.robots)
    # 2. A crowd needs larger cells, as gaps narrower than a step stay closed.
    widths = np.array([robot.breadth for robot in problem.robots])
    wide = size * float(np.clip((widths.sum() / math.sqrt(area) / _CROWD_WIDTH) ** 2, 1.0, _MAX_CROWD_GROWTH))
    # Larger cells must not close a door for the centers of robots.
    if wide > size and problem.workspace.free_space.buffer(-(widths.max() + wide) / 2).geom_type == "Polygon":
        size = wide
    step = float(np.clip(size, _FINEST_FIRST * extent, _COARSEST_FIRST * extent))
    # 3. Robots that fill most of the free area may move between cells of one robot each, as in a sliding puzzle.
    if may_pack and len(widths) * widths.min() ** 2 > _PACKED * area:
        step = extent / max(1, math.floor(extent / widths.max() + ROUNDING))
    # 4. Enlarge the cells while the lattices do not fit or their motions take long to test.
    while step < _COARSEST * extent and (_num_motions_to_test(problem, step) > _MAX_FIRST_TESTS or not fits(step)):
        step *= _REFINEMENT
    return step
