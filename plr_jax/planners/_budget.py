"""What a search may still do."""

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
        if time.perf_counter() >= self.deadline:
            return Status.TIME_LIMIT
        if self.num_expansions + 1 > self.max_expansions:
            return Status.EXPANSION_LIMIT
        return Status.MEMORY_LIMIT if self.memory >= self.max_memory else None
