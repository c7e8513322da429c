"""What a search may still do, and the memory that counts against it."""

import time
from dataclasses import dataclass

from plr_jax.planners._solution import Status


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
