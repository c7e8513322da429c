"""What every planner returns: a path, what it costs, and why the planner ended."""

import enum
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from plr_jax._problem import Problem, makespan, motion_costs, path_cost


class Status(enum.StrEnum):
    """Why a planner ended; the value is the message."""

    SOLVED = "a path within the cost factor was found"
    EXHAUSTED = "the frontier is empty: no path, or none within the cost factor, on this lattice"
    TIME_LIMIT = "the time limit was reached"
    EXPANSION_LIMIT = "the limit on expansions was reached"
    MEMORY_LIMIT = "the memory limit was reached"
    INTERRUPTED = "interrupted by the user"


@dataclass(frozen=True)
class Stats:
    """What a planner did.

    Args:
        num_nodes: Joint configurations kept: claimed cells of BL, samples of a sampling-based planner.
        num_expansions: How often a node's children were asked for.
        num_children_scored: Children given a cost and a heuristic: joint ones, and BL's of the first robots alone.
        num_children_valid: Those found free of collision.
        seconds: Wall-clock seconds by phase.
        history: Each new best path: seconds since the start and its cost.
    """

    num_nodes: int
    num_expansions: int = 0
    num_children_scored: int = 0
    num_children_valid: int = 0
    seconds: dict[str, float] = field(default_factory=dict)
    history: tuple[tuple[float, float], ...] = ()

    @property
    def first_solution(self) -> float:
        """Seconds to the first path; ``inf`` if there is none."""
        return self.history[0][0] if self.history else float("inf")


@dataclass(frozen=True, eq=False)
class Solution:
    """The result of a planner.

    Args:
        path: Joint configurations ``(steps, robots, dof)`` from the starts to the goals, in workspace units and
            radians; robots move from one row to the next along straight lines, all at once. None if no path
            was found.
        cost: Sum of the path's motion costs, ``inf`` if there is none.
        makespan: Time that the path takes (see :func:`plr_jax.makespan`), ``inf`` if there is none.
        lower_bound: A cost below which there is no path.
        status: Why the planner ended. A path may be there whatever it says.
        stats: What the planner did.
        samples: Joint configurations of the nodes, ``(nodes, robots, dof)``, in the order of their making; of BL,
            those of its last search.
        motions_factor: Proven bound of the cost of the path that ``path`` was shortened from, over that of the
            cheapest one made of the same motions; ``inf`` where nothing is proven of that. Of BL, the motions of the
            lattices on which it was found.
    """

    path: Float[np.ndarray, "steps robots dof"] | None
    cost: float
    makespan: float
    lower_bound: float
    status: Status
    stats: Stats
    samples: Float[np.ndarray, "nodes robots dof"]
    motions_factor: float = float("inf")

    @property
    def factor(self) -> float:
        """How many times as much the path costs at the most as the best one there is, as far as is proven.

        ``inf`` if there is no path, or nothing is known but that a cost is not negative.
        """
        if self.cost == 0:
            return 1.0
        return self.cost / self.lower_bound if self.lower_bound > 0 else float("inf")

    @property
    def solved(self) -> bool:
        """Whether there is a path."""
        return self.path is not None

    def __repr__(self) -> str:
        return (
            f"Solution({self.status.name}: cost {self.cost:.4g}, lower bound {self.lower_bound:.4g}, "
            f"{self.stats.num_nodes:,} nodes, {sum(self.stats.seconds.values()):.3g} s)"
        )


def solution_of(
    problem: Problem,
    path: Float[np.ndarray, "steps robots dof"] | None,
    lower_bound: float,
    status: Status,
    stats: Stats,
    samples: Float[np.ndarray, "nodes robots dof"],
    motions_factor: float = float("inf"),
) -> Solution:
    """A solution, its costs computed from the path."""
    if path is None:
        return Solution(None, float("inf"), float("inf"), lower_bound, status, stats, samples)
    costs = path_cost(problem, path), makespan(problem, path)
    return Solution(path, *costs, lower_bound, status, stats, samples, motions_factor)


def straight_line_bound(problem: Problem) -> float:
    """The sum of the costs of the robots' straight motions to their goals: no path is cheaper."""
    return float(motion_costs(problem, problem.starts, problem.goals).sum())
