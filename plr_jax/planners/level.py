"""The lattices of one step, and the searches that take turns on them."""

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from tqdm import tqdm

from plr_jax._problem import Problem
from plr_jax._types import HeuristicFn, SeparableHeuristic
from plr_jax.collision.joint_motion import JointMotionTest
from plr_jax.planners._budget import SearchBudget
from plr_jax.planners._heuristics import estimates
from plr_jax.planners._solution import Status
from plr_jax.planners.bl.heuristic_table import tabulate, weighted
from plr_jax.planners.bl.options import BLOptions
from plr_jax.planners.bl.search import BestFirstSearch
from plr_jax.planners.lacam.moves import TeamMoves
from plr_jax.planners.lacam.search import LazySearch
from plr_jax.planners.lattice.build import build_lattices, num_configurations
from plr_jax.planners.lattice.edges import Kind, kinds_of
from plr_jax.planners.lattice.joint import JointLattice, State
from plr_jax.planners.lattice.motions import Lattice

_PATIENCE, _BEST_FIRST_TURN = 8, 1024  # steps without gain times, and expansions over, the number of robots
_MOTION_BYTES = 80  # what a motion takes while its table is built
_COLUMN_BYTES = 16  # what a robot's costs to and from a node take
_SEARCH_BYTES = 16  # what a motion takes in the tables of each robot for best-first search
_LONGER = 1.5
_GOALS = 8  # costs-to-go at a time, between two looks at the clock


@dataclass(eq=False)
class SearchLevel:
    """The lattices of one step, and the searches on them.

    Args:
        step: Side of their cells.
        joint: The team on them.
        kinds: Its robots by the tables that they share.
        costs_to_go: Those of the robots of each kind, alone, along the lattices.
        heuristic: Of each robot by node, without a weight; of a ``plain`` one, that of straight lines.
        plain: A heuristic that is no sum over robots.
        weight: Of the heuristic in best-first search.
        lazy: The lazy search, if it takes part.
        best_first: Best-first search, once it has begun.
        turn: Length of the next turn, in first ones.
        num_bytes: About what the lattices take.
    """

    step: float
    joint: JointLattice
    kinds: Sequence[Kind]
    costs_to_go: Sequence[Float[np.ndarray, "_ _"]]
    heuristic: Sequence[Float[np.ndarray, "_"]] = ()
    plain: HeuristicFn | None = None
    weight: float = 1.0
    lazy: LazySearch | None = None
    best_first: BestFirstSearch | None = None
    turn: float = 1.0
    num_bytes: int = 0

    @property
    def least_costs(self) -> Float[np.ndarray, "robots"]:
        """What the cheapest motions of each robot cost if it is alone; ``inf`` if it cannot reach its goal."""
        costs = of_robots(self.kinds, self.costs_to_go)
        pairs = zip(costs, self.joint.lattices, strict=True)
        return np.array([cost_to_go[lattice.start] for cost_to_go, lattice in pairs])

    @property
    def least_cost(self) -> float:
        """What they cost in all."""
        return float(self.least_costs.sum())

    @property
    def memory(self) -> int:
        """What the lattices and the searches hold."""
        return self.num_bytes + sum(search.memory for search in (self.lazy, self.best_first) if search is not None)

    def begin(self, heuristic: HeuristicFn | None, weight: float, options: BLOptions, budget: SearchBudget) -> None:
        """Evaluate the heuristic, and get the searches ready. Without one, the costs-to-go along the lattices are it.

        Raises:
            TimeoutError: If the deadline passes first.
        """
        costs = of_robots(self.kinds, self.costs_to_go)
        self.weight, self.heuristic, scores = weight, costs, costs
        if isinstance(heuristic, SeparableHeuristic):
            self.heuristic = scores = tabulate(self.joint, heuristic, budget.deadline)
        elif heuristic is not None:
            self.plain, self.heuristic = heuristic, tabulate(self.joint, heuristic, budget.deadline)
            estimates(heuristic, self.joint.problem.starts[None].copy())  # whether it is one
        if "lacam" in options.searchers:
            by_kind = [np.stack([scores[i] for i in kind.members.tolist()]) for kind in self.kinds]
            moves = TeamMoves(self.kinds, by_kind, self.joint.problem.workspace.tolerance)
            self.lazy = LazySearch(self.joint, moves, scores, budget)

    def run(self, options: BLOptions, budget: SearchBudget, bar: tqdm) -> Status | None:
        """Let each search go on for a turn, which is half as long again as the one before.

        Returns:
            SOLVED, or the limit that is reached; EXHAUSTED if no path along the lattices is left; None for a pause.
        """
        num_robots, status = len(self.joint.lattices), None
        if self.lazy is not None:
            status = self.lazy.run(int(self.turn * _PATIENCE * num_robots), bar)
        has_room = self._has_room(options, budget)
        if self.lazy is None and not has_room:
            return Status.MEMORY_LIMIT
        if status is None and "bl" in options.searchers and has_room:
            if self.best_first is None:
                self.best_first = self._best_first(options, budget)
            status = self.best_first.run(max(1, int(self.turn * _BEST_FIRST_TURN / num_robots)), bar)
            # Cells that are larger than a configuration may hide a path.
            if status is Status.EXHAUSTED and options.cell_size is not None and self.lazy is not None:
                status = None
        self.turn *= _LONGER
        return status

    @property
    def found(self) -> tuple[str, State]:
        """The search that has reached the goals, and its states from the starts to them."""
        for name, search in (("lacam", self.lazy), ("bl", self.best_first)):
            if search is not None and search.found is not None:
                return name, search.branch
        raise AssertionError("No search has reached the goals.")

    @property
    def state(self) -> State:
        """The nodes of the search that has more of them, or the starts before there is one."""
        states = [search.state for search in (self.lazy, self.best_first) if search is not None]
        return max(states, key=len, default=np.array([[lattice.start for lattice in self.joint.lattices]]))

    def _has_room(self, options: BLOptions, budget: SearchBudget) -> bool:
        """Whether the tables of best-first search fit into memory, or are there already."""
        needed = _SEARCH_BYTES * sum(lattice.table.child.size for lattice in self.joint.lattices)
        return self.best_first is not None or budget.memory + needed < options.max_memory

    def _best_first(self, options: BLOptions, budget: SearchBudget) -> BestFirstSearch:
        estimate = weighted(self.joint, self.heuristic, self.weight, self.plain)
        cells = [
            claimed_cells(lattice, robot.circumscribed_radius, options.cell_size)
            for lattice, robot in zip(self.joint.lattices, self.joint.problem.robots, strict=True)
        ]
        search = BestFirstSearch(self.joint, estimate, cells, options, budget)
        search.hold(_SEARCH_BYTES * sum(lattice.table.child.size for lattice in self.joint.lattices))
        return search


def build_level(
    problem: Problem, test: JointMotionTest, step: float, options: BLOptions, deadline: float
) -> SearchLevel | None:
    """The lattices of a step, and costs along them; None if a robot cannot reach its goal.

    Raises:
        TimeoutError: If the deadline passes first.
    """
    joint = JointLattice(problem, tuple(build_lattices(problem, step, options.primitives, deadline)), test)
    kinds = kinds_of(joint)
    level = SearchLevel(step, joint, kinds, [_costs_to_go(kind, deadline) for kind in kinds])
    return level if np.isfinite(level.least_cost) else None


def num_bytes(problem: Problem, step: float, num_primitives: int) -> float:
    """About what the lattices of a step take if all is free, so that those too large are not begun."""
    kinds = set(zip(problem.robots, problem.rotation_weights.tolist(), strict=True))
    tables = sum(num_configurations(problem.workspace, robot, step) for robot, _ in kinds)
    columns = sum(num_configurations(problem.workspace, robot, step) for robot in problem.robots)
    return _MOTION_BYTES * (1 + num_primitives) * tables + _COLUMN_BYTES * columns


def of_robots(kinds: Sequence[Kind], costs: Sequence[Float[np.ndarray, "_ _"]]) -> list[Float[np.ndarray, "_"]]:
    """Costs by kind as those of each robot, in the order of the team."""
    of_robot = {
        robot: row
        for kind, rows in zip(kinds, costs, strict=True)
        for robot, row in zip(kind.members.tolist(), rows, strict=True)
    }
    return [of_robot[i] for i in range(len(of_robot))]


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


def _costs_to_go(kind: Kind, deadline: float) -> Float[np.ndarray, "robots nodes"]:
    rows, costs = np.arange(len(kind.members)), []
    for begin in range(0, len(rows), _GOALS):
        if time.perf_counter() > deadline:
            raise TimeoutError("The deadline passed before the costs-to-go were known.")
        costs.append(kind.edges.costs_to_go(rows[begin : begin + _GOALS]))
    return np.concatenate(costs)
