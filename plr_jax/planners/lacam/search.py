"""Search over joint configurations one step apart, under constraints that grow as they are needed (LaCAM)."""

from collections import deque
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int
from tqdm import tqdm

from plr_jax.planners._budget import HeldMemory, SearchBudget
from plr_jax.planners._solution import Status
from plr_jax.planners.lacam.moves import TeamMoves
from plr_jax.planners.lacam.pibt import PIBT
from plr_jax.planners.lattice.joint import JointLattice, State

_NODE_BYTES, _ROBOT_BYTES = 1_500, 60  # what a node takes, and for each of its robots
_CONSTRAINT_BYTES = 100
_ROUNDING = 1e-9


@dataclass(eq=False)
class Node:
    """A joint configuration of the search.

    Args:
        state: Where the robots are.
        parent: Where they came from.
        waiting: Of each robot, steps since it was last at its goal, and for those at it less than 1: its priority.
        order: The robots by priority, the highest first.
        constraints: What to ask of the next steps from here.
    """

    state: Int[np.ndarray, "robots"]
    parent: "Node | None"
    waiting: Float[np.ndarray, "robots"]
    order: list[int] = field(init=False)
    constraints: deque[tuple[tuple[int, int], ...]] = field(default_factory=lambda: deque([()]))

    def __post_init__(self) -> None:
        self.order = np.argsort(-self.waiting, kind="stable").tolist()


class LaCAM:
    """Okumura's search: the newest node is asked for one more step of the team, until all are at their goals.

    A node's first step is free. Each step after that begins with more constraints: the robot next in the order of
    priorities must choose another primitive. So every step is tried in the end, but hardly ever has to be. A step to
    a node that is known puts that on top again.

    References:
        Okumura, "LaCAM: search-based algorithm for quick multi-agent pathfinding", 2023.
    """

    def __init__(self, joint: JointLattice, moves: TeamMoves, budget: SearchBudget):
        self.joint, self.moves, self.budget, self.held = joint, moves, budget, HeldMemory(budget)
        self.goal = np.array([lattice.goal for lattice in joint.lattices])
        start = np.array([lattice.start for lattice in joint.lattices])
        far = np.nan_to_num(moves.estimates(start), posinf=0.0)
        self.at_rest = far / (1 + far.max())  # among robots at their goals, those go first that came from far
        self.nodes: dict[bytes, Node] = {}
        self.open: list[Node] = []
        self.found: Node | None = None
        self.nearest = float("inf")  # least sum of the estimates of a node
        self.num_idle = 0  # steps that brought it no nearer
        self._add(start, None)

    def run(self, max_idle: int, progress: tqdm | None = None) -> Status | None:
        """Search on until the goals are reached, nothing is left, or a limit is reached, and say which.

        None for a pause: after so many steps in a row that brought the team no nearer to its goals.
        """
        self.num_idle = 0
        while self.found is None and self.open and self.num_idle < max_idle:
            limit = self.budget.exceeded()
            if limit:
                return limit
            node = self.open[-1]
            if node.constraints:
                self._take_step(node)
                if progress is not None:
                    progress.update()
            else:
                self.open.pop()
        if self.found is not None:
            return Status.SOLVED
        return None if self.open else Status.EXHAUSTED

    @property
    def branch(self) -> State:
        """States from the starts to the goals, once these are found."""
        states, node = [], self.found
        while node is not None:
            states.append(node.state)
            node = node.parent
        return np.array(states[::-1])

    @property
    def state(self) -> State:
        """All nodes, in the order of their making."""
        return np.array([node.state for node in self.nodes.values()])

    def _take_step(self, node: Node) -> None:
        """One more step of the team, under the node's next constraints."""
        constraints = node.constraints.popleft()
        moves = self.moves(node.state)
        self.num_idle += 1
        self.budget.num_expansions += 1
        self.budget.num_children_scored += sum(map(len, moves.child))
        if len(constraints) < len(node.order):
            robot = node.order[len(constraints)]
            node.constraints.extend((*constraints, (robot, primitive)) for primitive in moves.ranked[robot])
            self.held.add(_CONSTRAINT_BYTES * len(moves.ranked[robot]))
        primitives = PIBT(moves).find(node.order, constraints)
        if primitives is not None:
            self.budget.num_children_valid += 1
            self._add(np.array([moves.child[i][primitive] for i, primitive in enumerate(primitives)]), node)

    def _add(self, state: Int[np.ndarray, "robots"], parent: Node | None) -> None:
        """Put a state on top, as a new node if it is not known."""
        key = state.astype(np.int32).tobytes()
        node = self.nodes.get(key)
        if node is None:
            arrived: Bool[np.ndarray, robots] = state == self.goal
            before = self.at_rest if parent is None else parent.waiting + 1
            node = self.nodes[key] = Node(state, parent, np.where(arrived, self.at_rest, before))
            self.budget.num_nodes += 1
            self.held.add(_NODE_BYTES + _ROBOT_BYTES * len(state))
            if arrived.all():
                self.found = node
            estimate = float(self.moves.estimates(state).sum())
            if estimate < (1 - _ROUNDING) * self.nearest:
                self.nearest, self.num_idle = estimate, 0
        self.open.append(node)
