"""Best-first search over joint configurations that claims every cell of the joint space once."""

import heapq
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped, UInt8
from tqdm import tqdm

from plr_jax.planners._solution import Status
from plr_jax.planners.bl.heuristic_table import HeuristicTable
from plr_jax.planners.bl.joint_lattice import JointLattice, State
from plr_jax.planners.bl.successors import best_successors

_NODE_BYTES = 350  # what a node takes in the tree, in the frontier and among the claimed cells
_KEPT = 16  # one of so many joint children that are found is kept
_WIDER = 8  # how much wider a node's children are sought when those kept are used up
_WIDEST = 1 << 16


@dataclass
class SearchBudget:
    """What a planner may still do, and what it has done.

    Args:
        deadline: When to stop, on the clock of ``time.perf_counter``.
        max_expansions: Most expansions, never exceeded.
        max_memory: Most bytes of lattices, nodes and children.
    """

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


@dataclass
class SearchTree:
    """The nodes of a search: where they are, what they cost, whose children they are."""

    state: Int[np.ndarray, "capacity robots"]
    cost: Float[np.ndarray, "capacity"]
    parent: Int[np.ndarray, "capacity"]
    size: int

    @classmethod
    def of(cls, root: Int[np.ndarray, "robots"]) -> "SearchTree":
        """A tree of its root alone."""
        return cls(root[None].astype(np.int32), np.zeros(1), np.full(1, -1), 1)

    def add(self, state: Int[np.ndarray, "robots"], cost: float, parent: int) -> int:
        """Add a child of a node; its index."""
        node = self.size
        if node == len(self.cost):
            capacity = max(1024, 2 * node)
            self.state, self.cost, self.parent = (
                np.resize(column, (capacity, *column.shape[1:])) for column in (self.state, self.cost, self.parent)
            )
        self.state[node], self.cost[node], self.parent[node] = state, cost, parent
        self.size = node + 1
        return node

    def branch(self, node: int) -> State:
        """The states from the root to a node."""
        nodes = [node]
        while self.parent[nodes[-1]] >= 0:
            nodes.append(int(self.parent[nodes[-1]]))
        return self.state[nodes[::-1]]


@dataclass
class SuccessorList:
    """The best successors of an expanded node, best first, and how far they have been looked at.

    Args:
        score: Cost-to-come and weighted heuristic.
        cost: Cost-to-come.
        state: Where they are.
        cell: The joint cell of each, as bytes.
        width: How wide they were sought.
        whole: Whether the node has no others.
        at: The first that has not been looked at.
    """

    score: Float[np.ndarray, "m"]
    cost: Float[np.ndarray, "m"]
    state: State
    cell: Shaped[np.ndarray, "m"]
    width: int
    whole: bool
    at: int = 0

    @property
    def num_bytes(self) -> int:
        """Memory it takes."""
        return sum(column.nbytes for column in (self.score, self.cost, self.state, self.cell))


class BestFirstSearch:
    """Barraquand and Latombe's search: the best node of the frontier adds its best children in unclaimed cells.

    A node adds only a few children at a time, and returns to the frontier with the score of its next one
    (partial expansion). Several nodes are expanded at once while the search makes no progress.

    Args:
        joint: The robots' lattices.
        estimate: The weighted heuristic.
        cells: Of each robot, the claimed cell that each configuration belongs to.
        batch: Most nodes expanded at once.
        branching: Children that a node adds at a time.
        width: Joint children kept while a product is assembled.
        budget: Limits, and what has been done.
    """

    def __init__(
        self,
        joint: JointLattice,
        estimate: HeuristicTable,
        cells: Sequence[Int[np.ndarray, "_"]],
        batch: int,
        branching: int,
        width: int,
        budget: SearchBudget,
    ):
        self.joint, self.estimate, self.cells, self.budget = joint, estimate, cells, budget
        self.batch, self.branching, self.width = batch, branching, width
        self.goal = np.array([lattice.goal for lattice in joint.lattices])
        start = np.array([lattice.start for lattice in joint.lattices])
        self.tree = SearchTree.of(start)
        self.nearest = self.estimate(joint, start[None])[0]
        self.claimed = {self._cells_of(start[None])[0].tobytes()}
        self.frontier = [(float(self.nearest), 0, 0)]
        self.successors: dict[int, SuccessorList] = {}
        self.wider: dict[int, int] = {}
        self.pushed, self.size, self.num_expansions = 0, 1, 0
        self.found = 0 if np.array_equal(start, self.goal) else None
        self.memory = 0
        budget.num_nodes += 1

    def run(self, num_expansions: int, progress: tqdm | None = None) -> Status | None:
        """Search on until the goals are reached, the frontier is empty, a limit is reached, or so much is done.

        Args:
            num_expansions: Expansions of this search, those of earlier runs included, after which to pause.
            progress: Told of every expansion.

        Returns:
            SOLVED, EXHAUSTED or the limit; None for a pause.
        """
        while self.found is None and self.frontier and self.num_expansions < num_expansions:
            limit = self.budget.exceeded()
            if limit:
                return limit
            left = self.budget.max_expansions - self.budget.num_expansions
            batch = [heapq.heappop(self.frontier)[2] for _ in range(int(min(self.size, len(self.frontier), left)))]
            nearest, before = self.nearest, self.num_expansions
            self._expand(batch)
            for node in batch:
                self._add_children(node)
            if progress is not None:
                progress.update(self.num_expansions - before)
            self.size = 1 if self.nearest < nearest else min(2 * self.size, self.batch)
        if self.found is not None:
            return Status.SOLVED
        return None if self.frontier else Status.EXHAUSTED

    @property
    def branch(self) -> State:
        """States from the starts to the goals, once these are found."""
        assert self.found is not None
        return self.tree.branch(self.found)

    @property
    def state(self) -> State:
        """All nodes, in the order of their making."""
        return self.tree.state[: self.tree.size]

    def _expand(self, nodes: list[int]) -> None:
        """Find the best children of nodes that have none kept."""
        by_width: dict[int, list[int]] = {}
        for node in nodes:
            if node not in self.successors:
                by_width.setdefault(self.wider.get(node, self.width), []).append(node)
        for width, alike in by_width.items():
            state = self.tree.state[alike]
            children = best_successors(self.joint, self.estimate.terms, state, width)
            score, primitive = self.estimate.rescored(self.joint, state, children)
            num_valid = np.isfinite(score).sum(axis=1)
            num_kept = np.minimum(num_valid, min(width, max(width // _KEPT, self.branching)))
            whole = children.whole & (num_kept == num_valid)
            self._keep(alike, score, primitive, num_kept, whole, width)
            self.num_expansions += len(alike)
            self.budget.num_expansions += len(alike)
            self.budget.num_children_scored += children.num_scored
            self.budget.num_children_valid += children.num_valid

    def _keep(
        self,
        nodes: list[int],
        score: Float[np.ndarray, "n m"],
        primitive: UInt8[np.ndarray, "n m robots"],
        num_kept: Int[np.ndarray, "n"],
        whole: Bool[np.ndarray, "n"],
        width: int,
    ) -> None:
        """Keep the first children of each node."""
        row = np.repeat(np.arange(len(nodes)), num_kept)
        last = np.cumsum(num_kept)
        column = np.arange(len(row)) - (last - num_kept)[row]
        parent, primitive = np.array(nodes)[row], primitive[row, column]
        cost = self.tree.cost[parent] + self.joint.move_costs(self.tree.state[parent], primitive)
        score = self.tree.cost[parent] + score[row, column]
        state = self.joint.move(self.tree.state[parent], primitive)
        cell = self._cells_of(state)
        for i, node in enumerate(nodes):
            own = slice(last[i] - num_kept[i], last[i])
            self.successors[node] = SuccessorList(score[own], cost[own], state[own], cell[own], width, bool(whole[i]))
            self.hold(self.successors[node].num_bytes)

    def _cells_of(self, state: State) -> Shaped[np.ndarray, "n"]:
        """Joint cells, each as bytes."""
        columns = [cells[column] for cells, column in zip(self.cells, state.T, strict=True)]
        cells = np.stack(columns, axis=1, dtype=np.int32)
        return cells.view(f"V{cells.shape[1] * cells.itemsize}")[:, 0]

    def _add_children(self, node: int) -> None:
        """Claim the cells of a node's next children, and return it to the frontier by the score of the one after."""
        successors, missing = self.successors[node], self.branching
        while (child := self._next_unclaimed(successors)) is not None and missing:
            self.claimed.add(successors.cell[child].tobytes())
            self._push(successors, child, node)
            successors.at, missing = child + 1, missing - 1
        if child is not None:
            self._return(successors.score[child], node)
            return
        del self.successors[node]
        self.hold(-successors.num_bytes)
        if not successors.whole and successors.width < _WIDEST:
            self.wider[node] = successors.width * _WIDER
            # A cut may leave nothing but children that collide: then look again at once.
            self._return(successors.score[-1] if len(successors.score) else self.tree.cost[node], node)

    def _next_unclaimed(self, successors: SuccessorList) -> int | None:
        """The best child whose cell is free to claim."""
        for child in range(successors.at, len(successors.score)):
            if successors.cell[child].tobytes() not in self.claimed:
                return child
        return None

    def _push(self, successors: SuccessorList, child: int, parent: int) -> None:
        """Make a child a node of the frontier."""
        state, cost, score = successors.state[child], successors.cost[child], successors.score[child]
        node = self.tree.add(state, cost, parent)
        self._return(score, node)
        if np.array_equal(state, self.goal):
            self.found = node
        self.nearest = min(self.nearest, score - cost)
        self.budget.num_nodes += 1
        self.hold(_NODE_BYTES + 8 * len(state))

    def _return(self, score: float | np.floating, node: int) -> None:
        """Put a node into the frontier; among equals the newest comes first."""
        self.pushed += 1
        heapq.heappush(self.frontier, (float(score), -self.pushed, node))

    def hold(self, num_bytes: int) -> None:
        """Count memory that is taken, or given back."""
        self.memory += num_bytes
        self.budget.memory += num_bytes
