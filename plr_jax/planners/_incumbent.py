"""The best path so far, and where the seconds went."""

import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from jaxtyping import Float

from plr_jax._problem import Problem, path_cost


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
