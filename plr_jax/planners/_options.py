"""Options of a planner, and what is left of its limits."""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, TypeAlias

import numpy as np

from plr_jax._arrays import as_number, shortened
from plr_jax._problem import Problem
from plr_jax.planners._solution import Status

# A motion to another cell: so many columns, rows and turns away.
Primitive: TypeAlias = tuple[int, int, int]

# To the eight neighbors, and a turn either way for robots that turn.
_NEIGHBORS = [(dx, dy, 0) for dx, dy in product((-1, 0, 1), repeat=2) if dx or dy]
PRIMITIVES: tuple[Primitive, ...] = (*_NEIGHBORS, (0, 0, 1), (0, 0, -1))

SEARCHERS = ("lacam", "bl")

_LARGEST_WEIGHT = 1e6
_MOST_PRIMITIVES = 254  # beside staying, that a byte tells apart


@dataclass(frozen=True)
class BLOptions:
    """Options of :func:`plr_jax.bl_plan`.

    Args:
        searchers: Which searches take turns until one finds a path. "lacam" is LaCAM, which moves the whole team one
            step at a time: it is over at once where robots can push one another along, for large teams as well. "bl"
            is best-first search over cells of the joint space: it finds what takes a plan, as swaps in tight places.
            It alone heeds ``cell_size``, ``heuristic_weight``, ``batch``, ``branching`` and ``width``. Only where
            both are asked for, a few discs are tried one after the other before.
        primitives: Motions of a robot besides staying, as offsets ``(columns, rows, turns)`` in cells of its
            lattice. Round robots leave out those that turn.
        step: Side of a lattice's cells, in workspace units. None: chosen for each problem, and refined until the
            problem is solved.
        cell_size: Side of the cells that joint configurations claim, in workspace units; turns count by how far they
            take a robot's farthest point. None: every joint configuration of the lattices is a cell of its own.
            Larger cells make a search smaller and less complete: they want primitives long enough to leave a cell,
            as a joint configuration in a claimed cell is dropped.
        heuristic_weight: Factor of the heuristic in best-first search, from 0 to 1e6. The larger, the greedier. None:
            2, or 3/8 a robot if that is more, as many robots have more ways to stand in each other's. It grows by
            half from one lattice to the next finer one.
        batch: Most nodes of best-first search expanded at once; it widens from one node while it makes no progress.
        branching: Children that a node adds at a time.
        width: Joint children held while a product of primitives is assembled. A larger product is cut to the best.
        cost_factor: Largest cost of a path to be content with, as a multiple of the lower bound. While the best path
            costs more, the search goes on with smaller weights and steps, until a limit. 1: to the limit, as a rule.
            The bound is that of straight lines unless something better is given: ``lower_bound``, or a heuristic
            that is one, such as the exact distances.
        lower_bound: A cost below which there is no path, in workspace units. It counts where it exceeds the bound of
            straight lines and what the heuristic proves.
        time_limit: Seconds, positive or ``inf``. A call of Shapely or of the heuristic, and a search of a lattice for
            costs-to-go, are not cut short.
        max_expansions: Most expansions; deterministic, unlike the time limit.
        max_memory: Most bytes of the lattices and of the search's nodes.

    Raises:
        ValueError: If an option is out of its range, ``searchers`` names none or an unknown one, or ``primitives``
            are not 1 to 254 distinct offsets other than (0, 0, 0).
    """

    searchers: Sequence[str] = SEARCHERS
    primitives: Sequence[Primitive] = PRIMITIVES
    step: float | int | None = None
    cell_size: float | int | None = None
    heuristic_weight: float | int | None = None
    batch: int = 16
    branching: int = 1
    width: int = 1024
    cost_factor: float | int = float("inf")
    lower_bound: float | int | None = None
    time_limit: float | int = 60.0
    max_expansions: float | int = float("inf")
    max_memory: float | int = 4e9

    def __post_init__(self) -> None:
        for name in ("step", "cell_size", "lower_bound"):
            value = getattr(self, name)
            if value is not None:
                as_number(name, value, "None or a positive finite number", lambda number: 0 < number < math.inf)
        for name in ("time_limit", "max_expansions", "max_memory", "cost_factor"):
            as_number(name, getattr(self, name), "a positive number or inf", lambda number: number > 0)
        if self.heuristic_weight is not None:
            expected, weight = "None or a number from 0 to 1e6", self.heuristic_weight
            weight = as_number("heuristic_weight", weight, expected, lambda weight: 0 <= weight <= _LARGEST_WEIGHT)
            object.__setattr__(self, "heuristic_weight", weight)
        for name in ("batch", "branching", "width"):
            value = getattr(self, name)
            if not isinstance(value, int | np.integer) or isinstance(value, bool) or value < 1:
                raise ValueError(f"{name} must be an integer of at least 1, got {value!r}.")
        is_some = isinstance(self.searchers, tuple | list | set | frozenset) and len(self.searchers) > 0
        if not is_some or any(name not in SEARCHERS for name in self.searchers):
            raise ValueError(f"searchers must be some of {SEARCHERS}, at least one, got {self.searchers!r}.")
        message = f"primitives must be distinct offsets (columns, rows, turns) of integers, 1 to {_MOST_PRIMITIVES}"
        offsets: Any
        try:
            offsets = np.array(self.primitives)
        except (TypeError, ValueError):
            offsets = np.zeros(0)
        are_offsets = offsets.ndim == 2 and offsets.shape[1] == 3 and offsets.dtype.kind == "i"
        if not are_offsets or not 0 < len(offsets) <= _MOST_PRIMITIVES:
            raise ValueError(f"{message}, got {self.primitives!r}.")
        if len(np.unique(offsets, axis=0)) < len(offsets) or not offsets.any(axis=1).all():
            raise ValueError(f"{message}, none of them (0, 0, 0), got {self.primitives!r}.")


def require_task(problem: Problem, options: BLOptions) -> None:
    """``ValueError`` unless these are a problem and options."""
    if not isinstance(problem, Problem):
        expected = "problem must be a Problem, such as Problem(workspace, robots, starts, goals)"
        raise ValueError(f"{expected}, got {shortened(problem)}.")
    if not isinstance(options, BLOptions):
        raise ValueError(f"options must be BLOptions(...), got {shortened(options)}.")


@dataclass
class SearchBudget:
    """What a planner may still do, until a time of ``time.perf_counter``, and what it has done."""

    deadline: float
    max_expansions: float | int
    max_memory: float | int
    num_nodes: int = 0
    num_expansions: int = 0
    num_children_scored: int = 0
    num_children_valid: int = 0
    memory: int = 0

    def exceeded(self) -> Status | None:
        """The limit that is reached, if one is."""
        if self.num_expansions + 1 > self.max_expansions and time.perf_counter() < self.deadline:
            return Status.EXPANSION_LIMIT
        return self.spent()

    def spent(self) -> Status | None:
        """The limit of time or memory, if one of these is reached."""
        if time.perf_counter() >= self.deadline:
            return Status.TIME_LIMIT
        return Status.MEMORY_LIMIT if self.memory >= self.max_memory else None


class HeldMemory:
    """Bytes that something holds, and that count against a budget until they are released."""

    def __init__(self, budget: SearchBudget):
        self.budget, self.num_bytes = budget, 0

    def add(self, num_bytes: int) -> None:
        """Hold so many bytes more, or less."""
        self.num_bytes += num_bytes
        self.budget.memory += num_bytes

    def release(self) -> None:
        """Hold none."""
        self.add(-self.num_bytes)
