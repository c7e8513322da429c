"""What a search may still do, and the best that it has found."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from plr_jax._problem import Problem, path_cost
from plr_jax.planners._solution import Status

# The best path so far, and where the seconds went.


class Incumbent:
    """The best path that a run of the planner has found.

    Attributes:
        path: It, None before there is one.
        cost: What it costs.
        history: Seconds and cost of each path that became the best one.
        found_by: The search that found it, or that it was shortened from.
        motions_factor: As in :class:`plr_jax.planners.Solution`.
        seconds: By phase of the run.
    """

    def __init__(self, problem: Problem, began: float):
        self.problem, self.began, self._mark = problem, began, began
        self.path: Float[np.ndarray, "steps robots dof"] | None = None
        self.cost, self.motions_factor = float("inf"), float("inf")
        self.history: list[tuple[float, float]] = []
        self.found_by = ""
        self.seconds: dict[str, float] = {}

    def offer(self, path: Float[np.ndarray, "steps robots dof"], found_by: str, motions_factor: float) -> None:
        """Take a path that is cheaper."""
        cost = path_cost(self.problem, path)
        if cost < self.cost:
            self.path, self.cost, self.found_by, self.motions_factor = path, cost, found_by, motions_factor
            self.history.append((time.perf_counter() - self.began, cost))

    @contextmanager
    def phase(self, name: str) -> Iterator[None]:
        """Count the seconds since the last phase ended."""
        try:
            yield
        finally:
            now = time.perf_counter()
            self.seconds[name] = self.seconds.get(name, 0.0) + now - self._mark
            self._mark = now


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
