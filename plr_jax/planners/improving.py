"""A path that a search has found made cheaper: along the lattices first, then off them."""

from contextlib import suppress

import numpy as np
from jaxtyping import Float, Int

from plr_jax._problem import path_cost
from plr_jax.collision.joint_motion import JointMotionTest
from plr_jax.planners._budget import SearchBudget
from plr_jax.planners._incumbent import Incumbent
from plr_jax.planners.lattice.joint import State
from plr_jax.planners.level import LatticeLevel
from plr_jax.planners.replanning.neighborhoods import replan_each, replan_neighborhoods
from plr_jax.planners.replanning.reservations import ReservationTable, num_bytes_of_table
from plr_jax.planners.smoothing.corridor import shorten_in_corridors
from plr_jax.planners.smoothing.shortcuts import halved, shorten

_WAITING_SHARE = 1 / 4  # rows in which robots may wait, over those of a path
_NEAR_LEAST = 1.1  # cost of a path over that of the robots alone
_GAIN = 2e-3  # share of the cost below which replanning neighborhoods is not worth its time
_ROUNDING = 1e-9


class Improvement:
    """What is done to a path along the lattices of a level; each that becomes the best is offered to the incumbent.

    Args:
        level: The lattices.
        found_by: The search that found the path.
        test: The team's motion test.
        incumbent: The best path so far.
        budget: Until when.
        enough: Cost up to which a path is good enough; ``inf`` if any is, shortened once.
    """

    def __init__(
        self,
        level: LatticeLevel,
        found_by: str,
        test: JointMotionTest,
        incumbent: Incumbent,
        budget: SearchBudget,
        enough: float,
    ):
        self.level, self.found_by, self.test = level, found_by, test
        self.incumbent, self.budget, self.enough = incumbent, budget, enough
        self.problem = level.joint.problem

    def __call__(self, state: State) -> None:
        """Offer a path, then cheaper ones along the lattices, then shortened ones."""
        self._offer(state)
        # A path that costs hardly more than the robots alone has nothing to gain that shortening does not find.
        gains = np.isfinite(self.enough) or self._factor(state) > _NEAR_LEAST
        if len(self.problem.robots) > 1 and len(state) > 1 and gains:
            state = self._replanned(state)
        self._shorten(state)

    def _replanned(self, state: State) -> Int[np.ndarray, "rows robots"]:
        """Plan robots anew among the others, each alone, then neighborhoods of them while that gains."""
        waiting = np.repeat(state[-1:], int(len(state) * _WAITING_SHARE), axis=0)
        rows, tolerance = np.concatenate([state, waiting]), self.problem.workspace.tolerance
        if self.budget.memory + num_bytes_of_table(self.level.kinds, len(rows)) >= self.budget.max_memory:
            return state
        try:
            with self.incumbent.phase("replan"):
                table = ReservationTable(self.level.kinds, self.level.costs_to_go, rows, tolerance, self.budget)
        except TimeoutError:
            return state
        with suppress(TimeoutError):  # whenever that strikes, the table's paths are free of collisions
            self._replan(table)
        self._offer(table.state)
        table.held.release()
        return until_arrival(table.state)

    def _replan(self, table: ReservationTable) -> None:
        with self.incumbent.phase("replan"):
            replan_each(table)
        self._offer(table.state)
        rng = np.random.default_rng(0)
        while not self._is_enough and not self.budget.exceeded():
            before = table.cost.sum()
            with self.incumbent.phase("replan"):
                replan_neighborhoods(table, len(self.problem.robots), rng)
            self._offer(table.state)
            if before - table.cost.sum() <= _GAIN * before:
                break

    def _shorten(self, state: State) -> None:
        """Shorten a path, and offer each version, until one is good enough."""
        problem, test, factor = self.problem, self.test, self._factor(state)
        path = self._path(state)
        passes = [lambda path: shorten(problem, path, test)]
        # Shortcuts leave a lone robot little to gain.
        if len(problem.robots) > 1 or np.isfinite(self.enough):
            width = self.level.step / 2
            passes.append(lambda path: shorten_in_corridors(problem, path, test, width))
        passes.append(lambda path: shorten(problem, halved(path), test))
        for cheaper in passes:
            if np.isfinite(self.enough) and self._is_enough:
                return
            with self.incumbent.phase("shorten"):
                path = cheaper(path)
            self.incumbent.offer(path, self.found_by, factor)

    def _offer(self, state: State) -> None:
        self.incumbent.offer(self._path(state), self.found_by, self._factor(state))

    @property
    def _is_enough(self) -> bool:
        return self.incumbent.cost <= self.enough

    def _path(self, state: State) -> Float[np.ndarray, "steps robots dof"]:
        """The path of a state; one that begins with a whole turn if a robot's goal is its start but for that."""
        path = self.level.joint.configurations(state)
        if np.array_equal(path[0], self.problem.starts):
            return path
        return np.concatenate([self.problem.starts[None], path])

    def _factor(self, state: State) -> float:
        """Cost of a path over that of each robot's cheapest motions alone: no path along the lattices costs less."""
        cost, least = path_cost(self.problem, self._path(state)), self.level.least_cost
        if least > 0:
            return (1 + _ROUNDING) * cost / least
        return 1.0 if cost == 0 else float("inf")


def until_arrival(state: State) -> Int[np.ndarray, "rows robots"]:
    """A path without the rows at its end in which all robots wait."""
    waits = np.all(state == state[-1], axis=1)
    return state[: len(state) + 1 - np.append(waits[::-1], False).argmin()]
