"""The lattices of a team that have one step, and the two searches that take turns on them."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from tqdm import tqdm

from plr_jax._arrays import require_time
from plr_jax._problem import Problem
from plr_jax._types import SeparableHeuristic
from plr_jax.collision.team import JointMotionTest
from plr_jax.planners._heuristics import estimates, straight_line
from plr_jax.planners._options import BLOptions, HeldMemory, SearchBudget
from plr_jax.planners._solution import Status
from plr_jax.planners.best_first import BestFirstSearch, Plain, bytes_of_tables, heuristic_table, tabulate
from plr_jax.planners.lacam import LaCAM, TeamMoves
from plr_jax.planners.lattice.build import Primitive, build_lattices, num_configurations
from plr_jax.planners.lattice.joint import JointLattice, Kind, OfKinds, State, by_robot, kinds_of
from plr_jax.robots.robot import Robot

# The lattices of a team that have one step, and the costs along them.


_MOTION_BYTES = 92  # what a motion takes while its table is built
_COLUMN_BYTES = 16  # what a robot's costs to and from a node take
_TURNING = 4  # times as long as a round robot's motion one takes to test that turns
_GOALS, _NODES = 8, 1 << 19  # costs-to-go, and nodes that have one, at a time, between two looks at the clock
_SECONDS = 3e-7  # about what an edge takes to be found, or a node to be reached, which cannot be cut short


@dataclass(frozen=True, eq=False)
class LatticeLevel:
    """The lattices of one step.

    Args:
        step: Side of their cells.
        joint: The team on them.
        kinds: Its robots by the tables that they share.
        costs_to_go: Those of the robots of each kind, alone, along the lattices.
        num_bytes: About what they take.
    """

    step: float
    joint: JointLattice
    kinds: Sequence[Kind]
    costs_to_go: OfKinds
    num_bytes: int

    @property
    def least_costs(self) -> Float[np.ndarray, "robots"]:
        """What the cheapest motions of each robot cost if it is alone; ``inf`` if it cannot reach its goal."""
        pairs = zip(by_robot(self.kinds, self.costs_to_go), self.joint.lattices, strict=True)
        return np.array([cost_to_go[lattice.start] for cost_to_go, lattice in pairs])

    @property
    def least_cost(self) -> float:
        """What they cost in all."""
        return float(self.least_costs.sum())


def build_level(
    problem: Problem, test: JointMotionTest, step: float, primitives: Sequence[Primitive]
) -> LatticeLevel | None:
    """The lattices of a step, and costs along them; None if a robot cannot reach its goal on them.

    Raises:
        TimeoutError: If the deadline of the test passes first.
    """
    joint = JointLattice(problem, tuple(build_lattices(problem, step, primitives, test.deadline)), test)
    kinds = kinds_of(joint)
    for kind in kinds:
        require_time(test.deadline, "the edges of the lattices were known", _SECONDS * kind.table.child.size)
        _ = kind.edges  # found when first asked for
    costs = [_costs_to_go(kind, test.deadline) for kind in kinds]
    level = LatticeLevel(step, joint, kinds, costs, int(num_bytes(problem, step, len(primitives))))
    return level if np.isfinite(level.least_cost) else None


def num_bytes(problem: Problem, step: float, num_primitives: int) -> float:
    """About what the lattices of a step take if all is free, so that those too large are not begun."""
    total = 0.0
    for (robot, _), count in _kinds(problem).items():
        nodes = num_configurations(problem.workspace, robot, step) + 2 * count
        total += nodes * (_MOTION_BYTES * (1 + num_primitives) + _COLUMN_BYTES * count)
    return total


def work(problem: Problem, step: float, num_primitives: int) -> float:
    """About how many motions have to be tested to build the lattices of a step; one that turns counts as several."""
    of_dof = {2: 1, 3: _TURNING}
    each = (of_dof[robot.dof] * num_configurations(problem.workspace, robot, step) for robot, _ in _kinds(problem))
    return (1 + num_primitives) * sum(each)


def _kinds(problem: Problem) -> Counter[tuple[Robot, float]]:
    """The robots that share a table, with the weight of their turns, and how many there are."""
    return Counter(zip(problem.robots, problem.rotation_weights.tolist(), strict=True))


def _costs_to_go(kind: Kind, deadline: float) -> Float[np.ndarray, "robots nodes"]:
    rows, costs, num_nodes = np.arange(len(kind.members)), [], len(kind.table.q)
    size = int(np.clip(_NODES // num_nodes, 1, _GOALS))
    for begin in range(0, len(rows), size):
        require_time(deadline, "the costs-to-go were known", _SECONDS * num_nodes)
        costs.append(kind.edges.costs_to_go(rows[begin : begin + size]))
    return np.concatenate(costs)


# The first turn of each search: idle steps of LaCAM a robot; expansions of best-first search over the robots or over
# their square, whichever is less, as an expansion takes as long as there are pairs of robots.
_IDLE_STEPS, _EXPANSIONS, _EXPANSIONS_OF_PAIRS = 8, 1024, 4096
_TERM_BYTES = 8  # what a term of the heuristic takes, which is kept twice where it was asked for
_LONGER = 1.5  # growth of turns


class Searches:
    """LaCAM and best-first search, or one of them, on the lattices of a level.

    Both go by the heuristic if it has terms, and by the costs-to-go along the lattices if there is none. A heuristic
    without terms leads best-first search, beside straight lines; LaCAM then goes by the costs-to-go.

    Args:
        level: The lattices.
        heuristic: As given to the planner.
        weight: Of the heuristic in best-first search.
        options: Those of the planner.
        budget: What it may still do.

    Raises:
        TimeoutError: If the deadline passes before the heuristic is known.
    """

    def __init__(
        self, level: LatticeLevel, heuristic: Plain, weight: float, options: BLOptions, budget: SearchBudget
    ):
        self.level, self.weight, self.options, self.budget = level, weight, options, budget
        self.held = HeldMemory(budget)
        num_nodes = sum(len(lattice.q) for lattice in level.joint.lattices)
        self.held.add(level.num_bytes + _TERM_BYTES * num_nodes * (1 if heuristic is None else 2))
        self.plain: Plain = None
        terms = by_robot(level.kinds, level.costs_to_go)
        self.tables: Sequence[Float[np.ndarray, _]] = terms
        if isinstance(heuristic, SeparableHeuristic):
            self.tables = terms = tabulate(level.joint, heuristic, budget.deadline)
        elif heuristic is not None:
            problem = level.joint.problem
            estimates(heuristic, problem.starts[None].copy())  # whether it is one
            self.plain, self.tables = heuristic, tabulate(level.joint, straight_line(problem), budget.deadline)
        self.running: dict[str, LaCAM | BestFirstSearch] = {}
        if "lacam" in options.searchers:
            by_kind = [np.stack([terms[i] for i in kind.members.tolist()]) for kind in level.kinds]
            moves = TeamMoves(level.kinds, by_kind, level.joint.problem.workspace.tolerance, budget.deadline)
            self.running["lacam"] = LaCAM(level.joint, moves, budget)
        self.turn = 1.0  # length of the next one, in first ones

    def run(self, bar: tqdm) -> Status | None:
        """Let each search go on for a turn, which is half as long again as the one before.

        Returns:
            SOLVED, or the limit that is reached; EXHAUSTED if no path along the lattices is left; None for a pause.

        Raises:
            TimeoutError: If the deadline passes within a step.
        """
        joint, budget, status = self.level.joint, self.budget, None
        num_robots, finds_all = len(joint.lattices), "lacam" in self.running
        if finds_all:
            status = self.running["lacam"].run(int(self.turn * _IDLE_STEPS * num_robots), bar)
        lacks_path = status is None and "bl" in self.options.searchers
        if lacks_path and ("bl" in self.running or budget.memory + self.num_bytes_needed < self.options.max_memory):
            if "bl" not in self.running:
                table = heuristic_table(joint, self.tables, self.weight, self.plain, budget.deadline)
                self.running["bl"] = BestFirstSearch(joint, table, self.options, budget)
            expansions = min(_EXPANSIONS / num_robots, _EXPANSIONS_OF_PAIRS / num_robots**2)
            status = self.running["bl"].run(max(1, int(self.turn * expansions)), bar)
            # Cells that are larger than a configuration may hide a path.
            if status is Status.EXHAUSTED and self.options.cell_size is not None and finds_all:
                status = None
        elif not finds_all:
            return Status.MEMORY_LIMIT
        self.turn *= _LONGER
        return status

    def release(self) -> None:
        """Stop counting what the lattices and the searches hold."""
        for each in (self, *self.running.values()):
            each.held.release()

    @property
    def found(self) -> tuple[str, State]:
        """The search that has reached the goals, and its states from the starts to them."""
        return next((name, search.branch) for name, search in self.running.items() if search.found is not None)

    @property
    def state(self) -> State:
        """The nodes of the search that has more of them, or the starts before there is one."""
        starts = np.array([[lattice.start for lattice in self.level.joint.lattices]])
        return max((search.state for search in self.running.values()), key=len, default=starts)

    @property
    def num_bytes_needed(self) -> int:
        """What best-first search needs to begin, beside what is held."""
        return 0 if "bl" in self.running else bytes_of_tables(self.level.joint)
