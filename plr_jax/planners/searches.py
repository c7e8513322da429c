"""Lattice searches: what the planner needs of a search, which searches there are, and how they take turns.

:class:`BLOptions`, the options of the planner, has the names of the searches that shall run. A search is an object
that looks for a path of the whole team along its lattices, and can pause and continue. Its class has these members:

- ``(joint, estimates, weight, budget)``, the constructor: ``estimates`` has, for each robot, the estimated cost-to-go
  at each node of its lattice; ``weight`` is the factor of the estimates. It raises ``TimeoutError`` if time is up.
- ``run(length, progress)`` searches for a turn of about this length, with a progress bar. It returns SOLVED at the
  goals, EXHAUSTED if nothing is left to try, the limit that was reached, or None if another turn can continue the
  search. It raises ``TimeoutError`` if time is up meanwhile.
- ``first_turn``: the length of the first turn, in a unit of the search's choice.
- ``is_weighted``: whether another weight changes the search.
- ``is_complete``: whether the search, once exhausted, has tried everything.
- ``memory_use``: the :class:`MemoryUse` of the search.
- ``num_bytes_needed(joint)``, a static method: the bytes that must be free when the search begins.
- ``solution_states``: the joint states of the path that was found, from the starts on.
- ``node_states``: the joint states of all nodes, in the order of creation.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from plr_jax._arrays import as_number, require_choice, require_type, shortened
from plr_jax._problem import Problem, require_problem, robot_kinds
from plr_jax._progress import Progress
from plr_jax._types import HeuristicFn
from plr_jax.planners._solution import MemoryUse, SearchBudget, Status
from plr_jax.planners.best_first import BestFirstSearch, tabulate
from plr_jax.planners.lacam import LaCAM
from plr_jax.planners.lattice import PRIMITIVES, JointLattice, State, num_configurations

_TURN_GROWTH = 1.5  # ratio of the lengths of consecutive turns
# Memory:
_MOTION_BYTES = 92  # bytes of a motion while its table is built
_COLUMN_BYTES = 16  # bytes of costs-to-go and costs-to-come, per robot and node
_TERM_BYTES = 8  # bytes of a term of the heuristic; given heuristics are stored twice
LatticeSearch = LaCAM | BestFirstSearch
# Searches by name, in the order of their turns:
SEARCHES: dict[str, type[LatticeSearch]] = {"lacam": LaCAM, "bl": BestFirstSearch}


@dataclass(frozen=True)
class BLOptions:
    """Options of :func:`plr_jax.bl_plan`.

    Args:
        searchers: Searches that alternate until one finds a path. "lacam" moves the whole team one step at a time,
            which is fast, even for large teams. "bl", a best-first search over joint configurations, finds
            coordinated maneuvers. With both, the planner also tries to move a few discs one after the other.
        step: Side of a lattice cell, in workspace units. None: chosen for the problem, refined until it is solved.
        heuristic_weight: Factor of the heuristic in "bl", from 0 to 1e6; larger is greedier. None: 2, or 3/8 times
            the number of robots if larger. It grows by half with each finer lattice.
        cost_factor: The search stops at a path whose cost is at most this multiple of the lower bound. Until then, or
            until a limit, it continues with smaller weights and steps; 1 usually means until a limit. A factor that
            is met early ends the search and the shortening, so the path may cost more than without a factor.
        lower_bound: Known lower bound of all path costs, in workspace units, such as ``exact_lower_bound(problem)``;
            used if larger than the planner's own.
        time_limit: Seconds, positive or ``inf``. Calls of Shapely, SciPy and the heuristic are not interrupted.
        max_expansions: Largest number of search nodes expanded; deterministic, unlike the time limit.
        max_memory: Largest number of bytes of the lattices and of the search nodes.

    Raises:
        ValueError: If an option is out of range, or ``searchers`` is empty or names an unknown search.
    """

    searchers: Sequence[str] = ("lacam", "bl")
    step: float | int | None = None
    heuristic_weight: float | int | None = None
    cost_factor: float | int = float("inf")
    lower_bound: float | int = 0.0
    time_limit: float | int = 60.0
    max_expansions: float | int = float("inf")
    max_memory: float | int = 4e9

    def __post_init__(self) -> None:
        if self.step is not None:
            as_number("step", self.step, "None or a positive finite number", lambda step: 0 < step < np.inf)
        as_number("lower_bound", self.lower_bound, "a finite number of at least 0", lambda x: 0 <= x < np.inf)
        as_number("cost_factor", self.cost_factor, "a number of at least 1, or inf", lambda factor: factor >= 1)
        for name in ("time_limit", "max_expansions", "max_memory"):
            as_number(name, getattr(self, name), "a positive number or inf", lambda number: number > 0)
        if self.heuristic_weight is not None:
            expected, weight = "None or a number from 0 to 1e6", self.heuristic_weight
            weight = as_number("heuristic_weight", weight, expected, lambda weight: 0 <= weight <= 1e6)
            object.__setattr__(self, "heuristic_weight", weight)
        if not isinstance(self.searchers, tuple | list | set | frozenset) or not self.searchers:
            got = f"got {shortened(self.searchers)}"
            raise ValueError(f"searchers must be a tuple of at least one of {tuple(SEARCHES)}, {got}.")
        for name in self.searchers:
            require_choice("Each of searchers", name, [*SEARCHES])


def require_problem_and_options(problem: Problem, options: BLOptions) -> None:
    require_problem(problem)
    require_type("options", options, BLOptions, "BLOptions(...)")


@dataclass(eq=False)
class Searches:
    """Searches, given by their names, that take turns on lattices (grids of configurations) of one cell size."""

    joint: JointLattice
    heuristic: HeuristicFn | None  # None: costs along the lattices
    weight: float
    names: Sequence[str]
    budget: SearchBudget

    def __post_init__(self) -> None:
        joint, heuristic, self.memory_use = self.joint, self.heuristic, MemoryUse(self.budget)
        num_terms = sum(len(lattice.q) for lattice in joint.lattices) * (1 if heuristic is None else 2)
        self.memory_use.add(int(num_bytes(joint.problem, joint.step)) + _TERM_BYTES * num_terms)
        self.estimates = joint.costs_to_go if heuristic is None else tabulate(joint, heuristic, self.budget.deadline)
        self.running: dict[str, LatticeSearch] = {}
        self.ended_by = ""  # the search that ended, by its name
        self.turn = 1.0  # length of the next turn, as a multiple of the first

    def run(self, progress: Progress) -> Status | None:
        """Give each search a turn, longer at every call; ``progress`` counts expansions.

        Return the status of a search that ended, or None if a search can go on. If a search is exhausted, but has not
        tried everything (``is_complete`` is False), only this search ends, and the other searches continue.
        """
        can_go_on = False
        for name in self.names:
            # 1. Begin the search as soon as there is memory for it.
            if name not in self.running and self.budget.has_memory(SEARCHES[name].num_bytes_needed(self.joint)):
                self.running[name] = SEARCHES[name](self.joint, self.estimates, self.weight, self.budget)
            # 2. Let it search.
            if (search := self.running.get(name)) is not None:
                status = search.run(max(1, int(self.turn * search.first_turn)), progress)
                if status is None:
                    can_go_on = True
                elif search.is_complete or status is not Status.EXHAUSTED:
                    self.ended_by = name
                    return status
        self.turn *= _TURN_GROWTH
        nothing_left = Status.EXHAUSTED if len(self.running) == len(self.names) else Status.MEMORY_LIMIT
        return None if can_go_on else nothing_left

    def release(self) -> None:
        for search in (self, *self.running.values()):
            search.memory_use.release()

    @property
    def node_states(self) -> State:
        starts = np.array([[lattice.start for lattice in self.joint.lattices]])
        return max((search.node_states for search in self.running.values()), key=len, default=starts)

    @property
    def num_bytes_needed(self) -> int:
        """Additional memory, in bytes, for the searches that have not begun yet."""
        return sum(SEARCHES[name].num_bytes_needed(self.joint) for name in self.names if name not in self.running)


def num_bytes(problem: Problem, step: float) -> float:
    """Estimate the memory, in bytes, of lattices of cell size ``step`` if all cells are free."""
    total = 0.0
    for (robot, _), members in robot_kinds(problem).items():
        nodes = num_configurations(problem.workspace, robot, step) + 2 * len(members)
        total += nodes * (_MOTION_BYTES * (1 + len(PRIMITIVES)) + _COLUMN_BYTES * len(members))
    return total
