"""The Barraquand-Latombe planner for several robots at once (Section V of the paper)."""

import time

import numpy as np
from jaxtyping import Float, Int
from tqdm import tqdm

from plr_jax._problem import Problem, path_cost
from plr_jax._types import BoundingFn, HeuristicFn
from plr_jax.collision.joint_motion import JointMotionTest
from plr_jax.planners._heuristics import require_heuristic, straight_line
from plr_jax.planners._solution import Solution, Stats, Status, solution_of, straight_line_bound
from plr_jax.planners.bl.heuristic_table import tabulate
from plr_jax.planners.bl.options import BLOptions
from plr_jax.planners.bl.search import BestFirstSearch, SearchBudget
from plr_jax.planners.lattice.build import build_lattices, num_bytes, num_configurations
from plr_jax.planners.lattice.joint import JointLattice
from plr_jax.planners.lattice.motions import Lattice
from plr_jax.planners.smoothing.corridor import shorten_in_corridors
from plr_jax.planners.smoothing.shortcuts import halved, shorten

# Steps, as shares of the longer side of the bounds: of the first lattice, and of the last one tried.
_COARSEST_FIRST, _POINT_STEP, _FINEST_FIRST, _FINEST = 1 / 16, 1 / 32, 1 / 512, 1 / 2048
_LARGEST_FIRST = 1 << 16  # configurations of a robot on the first lattice
_REFINEMENT = 1.25
_WEIGHT, _WEIGHT_OF_ROBOT = 2.0, 3 / 8
_FIRST_TURN, _LONGER = 256, 1.5  # expansions of a new search, and their growth
_GREEDIER = 1.5  # growth of the weight from one search to the next
_ROUNDING = 1e-9
_LEAST_WEIGHT = 1.1  # below it, a finer lattice promises more than a smaller weight
_DEFAULT_OPTIONS = BLOptions()


def bl_plan(
    problem: Problem, heuristic: HeuristicFn | None = None, options: BLOptions = _DEFAULT_OPTIONS
) -> Solution:
    """Plan for all robots at once by best-first search over cells of the joint space, then shorten the path.

    Every robot moves on a lattice of its own, whose start and goal are exact. A node of the search is a joint
    configuration; its children are the products of the robots' primitives that keep clear of obstacles and of one
    another along the whole motion. Each cell of the joint space is claimed once, by the first node in it. The best
    node by cost-to-come and weighted heuristic is expanded next, as in A*. Searches on finer lattices, each greedier
    than the last, take turns with those that have not found a path. The first path found is shortened by straight
    shortcuts of one robot, and within narrow corridors about the motions of one robot, or of two that touch.

    Deterministic, but for where a time limit strikes. Ctrl-C ends it and returns the best path so far.

    Args:
        problem: What to plan.
        heuristic: Estimated cost-to-go of joint configurations ``(n, robots, dof)``, such as :func:`zero`,
            :func:`straight_line`, :func:`sum_of_distances` or a function of your own, never NaN. An infinite
            estimate prunes nothing, a negative one counts as 0. Terms (``per_robot``) are used where it offers
            them, which is much faster than a plain function. One that says it is a lower bound (``is_lower_bound``)
            bounds the cost of all paths by what it says of the starts. None: :func:`straight_line`.
        options: How to search, and when to stop.

    Returns:
        The best path found, how far at the most from the best there is, and why the search ended: SOLVED if its cost
        is within ``cost_factor`` of the lower bound; EXHAUSTED if the frontier ran empty on the finest lattice (the
        given ``step``, or 1/2048 of the bounds), which proves nothing about finer ones; a limit, or INTERRUPTED, with
        or without a path.

    Raises:
        ValueError: If the heuristic is no function of joint configurations, or returns NaN or another shape than
            ``(n,)``; or if the options are no :class:`BLOptions`.

    References:
        Barraquand and Latombe, "Robot motion planning: a distributed representation approach", 1991; Section V
        of the paper.
    """
    heuristic = straight_line(problem) if heuristic is None else heuristic
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
    stats = Stats(*counts, run.seconds, tuple(run.history))
    return solution_of(problem, run.path, run.lower_bound, status, stats, run.samples, run.motions_factor)


class _Run:
    """One call of the planner: searches on finer and finer lattices, and the best path so far."""

    def __init__(self, problem: Problem, heuristic: HeuristicFn, options: BLOptions, began: float, progress: tqdm):
        self.problem, self.heuristic, self.options, self.began = problem, heuristic, options, began
        self.budget = SearchBudget(began + options.time_limit, options.max_expansions, options.max_memory)
        self.test = JointMotionTest(problem.workspace, problem.robots)
        straight = straight_line_bound(problem)
        self.lower_bound = max(straight, options.lower_bound or 0.0, _proven_cost(heuristic, problem))
        self.motions_factor = float("inf")
        self.path: Float[np.ndarray, "steps robots dof"] | None = None
        self.cost = float("inf")
        self.history: list[tuple[float, float]] = []
        self.seconds: dict[str, float] = {}
        self.samples = problem.starts[None].copy()
        self.mark, self.progress = began, progress

    def until_done(self) -> Status:
        """Search, then search better, until the path is good enough or a limit is reached."""
        step, weight = self.options.step or _first_step(self.problem), self.options.heuristic_weight
        if weight is None:
            weight = max(_WEIGHT, _WEIGHT_OF_ROBOT * len(self.problem.robots))
        while True:
            status, step = self._take_turns(step, weight)
            if status is not Status.SOLVED or self._is_good_enough():
                return status
            limit = self.budget.exceeded()
            if limit:
                return limit
            if weight > _LEAST_WEIGHT:
                weight = (1 + weight) / 2
            elif self.options.step is not None:
                return Status.EXHAUSTED
            if self.options.step is None:
                step /= _REFINEMENT

    def _take_turns(self, step: float, weight: float) -> tuple[Status, float]:
        """Searches on finer and finer lattices, greedier and greedier, that take turns until one succeeds.

        Which lattice has room for robots to pass one another is not known before; one that has none would keep a
        single search busy for ever. Every round adds a search and lets each of the others grow by half.

        Returns:
            Why they ended, and the step of the one that did.
        """
        finest = self.options.step or _FINEST * float(self.problem.workspace.bounds.width.max())
        searches: dict[float, BestFirstSearch] = {}
        turn: dict[float, int] = {}
        while True:
            limit = self.budget.exceeded()
            if limit:
                return limit, step
            needed = num_bytes(self.problem, step, self.options.primitives)
            fits = self.budget.memory + needed < self.options.max_memory
            if not searches and not (step >= finest and fits):
                return (Status.EXHAUSTED if step < finest else Status.MEMORY_LIMIT), step
            if step >= finest and fits and (search := self._search(step, weight)):
                search.hold(int(needed))
                searches[step], turn[step] = search, _FIRST_TURN
                weight *= _GREEDIER
            for size, search in reversed(list(searches.items())):
                status = self._run(search, size, turn[size])
                if status is Status.SOLVED:
                    self.budget.memory = 0
                    self._offer_found(search, size)
                elif status is Status.EXHAUSTED:
                    self.budget.memory -= searches.pop(size).memory
                if status not in (None, Status.EXHAUSTED):
                    return status, size
                turn[size] = int(_LONGER * turn[size])
            step /= _REFINEMENT

    def _offer_found(self, search: BestFirstSearch, step: float) -> None:
        """Offer a path that was found, and if it becomes the best, say how far from the best of its lattices it was.

        The cheapest motions of each robot alone cost no more than those of any path.
        """
        path, before = search.joint.configurations(search.branch), self.cost
        least = sum(lattice.least_cost() for lattice in search.joint.lattices)
        factor = (1 + _ROUNDING) * path_cost(self.problem, path) / least if least > 0 else 1.0
        try:
            self._offer(path, step)
        finally:
            if self.cost < before:
                self.motions_factor = factor

    def _run(self, search: BestFirstSearch, step: float, num_expansions: int) -> Status | None:
        """Let a search run until it has made so many expansions in all."""
        self.progress.set_postfix(step=f"{step:.3g}", nodes=self.budget.num_nodes, cost=f"{self.cost:.4g}")
        try:
            return search.run(num_expansions, self.progress)
        finally:
            self.samples = search.joint.configurations(search.state)
            self._end_phase("search")

    def _search(self, step: float, weight: float) -> BestFirstSearch | None:
        """A search about to begin; None if a robot's own goal is out of its reach on this lattice, or time is up."""
        options = self.options
        try:
            lattices = build_lattices(self.problem, step, options.primitives, self.budget.deadline)
        except TimeoutError:
            return None
        finally:
            self._end_phase("lattice")
        if not all(lattice.reaches_goal() for lattice in lattices):
            return None
        joint = JointLattice(self.problem, tuple(lattices), self.test)
        estimate = tabulate(joint, self.heuristic, weight)
        self._end_phase("heuristic")
        cells = [
            claimed_cells(lattice, robot.circumscribed_radius, options.cell_size)
            for lattice, robot in zip(lattices, self.problem.robots, strict=True)
        ]
        return BestFirstSearch(joint, estimate, cells, options, self.budget)

    def _offer(self, path: Float[np.ndarray, "steps robots dof"], step: float) -> None:
        """Keep a path if it is the best yet, then its cheaper versions, until it is good enough."""
        problem, test, deadline = self.problem, self.test, self.budget.deadline
        if not np.array_equal(path[0], problem.starts):  # a goal that is the start but for a whole turn
            path = np.concatenate([problem.starts[None], path])
        self._record(path)
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


def _proven_cost(heuristic: HeuristicFn, problem: Problem) -> float:
    """What a heuristic proves of the cost of any path: its value at the starts, if it is a lower bound, else 0."""
    if not (isinstance(heuristic, BoundingFn) and heuristic.is_lower_bound):
        return 0.0
    cost = float(heuristic(problem.starts[None].copy())[0])
    return (1 - _ROUNDING) * cost if np.isfinite(cost) else 0.0


def claimed_cells(lattice: Lattice, radius: float, cell_size: float | None) -> Int[np.ndarray, "nodes"]:
    """The cell of a robot's configuration space that each configuration of its lattice claims: a number for each.

    The robot's corners are ``radius`` from its center. Without a size of cells, every configuration is its own. The
    goal has a cell of its own, so that nothing else claims it.
    """
    nodes = np.arange(len(lattice.q))
    if cell_size is None:
        return nodes
    scale = np.array([1.0, 1.0, radius])[: lattice.q.shape[1]]
    cells = np.unique(np.floor(lattice.q * scale / cell_size), axis=0, return_inverse=True)[1].reshape(-1)
    cells[lattice.goal] = -1
    return cells


def _first_step(problem: Problem) -> float:
    """A lattice about as fine as the smallest robot is large, but not one that takes long to build."""
    extent = float(problem.workspace.bounds.width.max())
    sizes = [min(robot.circumscribed_radius, robot.breadth) or _POINT_STEP * extent for robot in problem.robots]
    step = float(np.clip(min(sizes), _FINEST_FIRST * extent, _COARSEST_FIRST * extent))
    while max(num_configurations(problem.workspace, robot, step) for robot in problem.robots) > _LARGEST_FIRST:
        step *= _REFINEMENT
    return step
