"""Best-first search over joint configurations that claims every cell of the joint space once."""

import heapq
import time
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int, UInt8

from plr_jax.planners._children import State, Team, best_children
from plr_jax.planners._estimate import Estimate
from plr_jax.planners._solution import Status

_NODE_BYTES = 350  # what a node takes in the tree, in the frontier and among the claimed cells
_KEPT = 8  # one of so many joint children that are found is kept
_WIDER = 8  # how much wider a node's children are sought when those kept are used up
_WIDEST = 1 << 16


@dataclass
class Effort:
    """What a planner may still do, and what it has done.

    Args:
        deadline: When to stop, on the clock of ``time.perf_counter``.
        max_expansions: Most expansions.
        max_memory: Most bytes of nodes and children.
    """

    deadline: float
    max_expansions: float
    max_memory: float
    num_nodes: int = 0
    num_expansions: int = 0
    num_children_scored: int = 0
    num_children_valid: int = 0
    memory: int = 0
    seconds: dict[str, float] = field(default_factory=dict)

    def exceeded(self) -> Status | None:
        """The limit that is reached, if one is."""
        if time.perf_counter() >= self.deadline:
            return Status.TIME_LIMIT
        if self.num_expansions >= self.max_expansions:
            return Status.EXPANSION_LIMIT
        return Status.MEMORY_LIMIT if self.memory >= self.max_memory else None


@dataclass
class Tree:
    """The nodes of a search: where they are, what they cost, whose children they are."""

    state: Int[np.ndarray, "capacity robots"]
    cost: Float[np.ndarray, "capacity"]
    parent: Int[np.ndarray, "capacity"]
    size: int

    @classmethod
    def of(cls, root: Int[np.ndarray, "robots"]) -> "Tree":
        """A tree of its root alone."""
        return cls(root[None].astype(np.int32), np.zeros(1), np.full(1, -1), 1)

    def add(self, state: State, cost: Float[np.ndarray, "n"], parent: int) -> range:
        """Add children of a node; their indices."""
        first, last = self.size, self.size + len(state)
        if last > len(self.cost):
            capacity = max(1024, 2 * last)
            self.state, self.cost, self.parent = (
                np.resize(column, (capacity, *column.shape[1:])) for column in (self.state, self.cost, self.parent)
            )
        self.state[first:last], self.cost[first:last], self.parent[first:last] = state, cost, parent
        self.size = last
        return range(first, last)

    def branch(self, node: int) -> State:
        """The states from the root to a node."""
        nodes = [node]
        while self.parent[nodes[-1]] >= 0:
            nodes.append(int(self.parent[nodes[-1]]))
        return self.state[nodes[::-1]]


@dataclass
class Kept:
    """The best children of an expanded node that have not been looked at."""

    score: Float[np.ndarray, "m"]
    primitive: UInt8[np.ndarray, "m robots"]
    width: int
    whole: bool

    def after(self, count: int) -> "Kept":
        """Those after the first few."""
        return Kept(self.score[count:], self.primitive[count:], self.width, self.whole)

    @property
    def num_bytes(self) -> int:
        """Memory it takes."""
        return self.score.nbytes + self.primitive.nbytes


class Search:
    """Barraquand and Latombe's search: the best node of the frontier adds its best children in unclaimed cells.

    A node adds only a few children at a time, and returns to the frontier with the score of its next one
    (partial expansion). Several nodes are expanded at once while the search makes no progress.

    Args:
        team: The robots.
        estimate: The weighted heuristic.
        cells: Of each robot, the claimed cell that each configuration belongs to.
        batch: Most nodes expanded at once.
        branching: Children that a node adds at a time.
        width: Joint children kept while a product is assembled.
        effort: Limits, and what has been done.
    """

    def __init__(
        self,
        team: Team,
        estimate: Estimate,
        cells: Sequence[Int[np.ndarray, "_"]],
        batch: int,
        branching: int,
        width: int,
        effort: Effort,
    ):
        self.team, self.estimate, self.cells, self.effort = team, estimate, cells, effort
        self.batch, self.branching, self.width = batch, branching, width
        self.goal = np.array([lattice.goal for lattice in team.lattices])
        start = np.array([lattice.start for lattice in team.lattices])
        self.tree = Tree.of(start)
        self.nearest = self.estimate(team, start[None])[0]
        self.claimed = {self._cells_of(start[None])[0].tobytes()}
        self.frontier = [(float(self.nearest), 0, 0)]
        self.kept: dict[int, Kept] = {}
        self.wider: dict[int, int] = {}
        self.pushed, self.size = 0, 1
        self.found = 0 if np.array_equal(start, self.goal) else None
        effort.num_nodes += 1

    def run(self, num_expansions: int) -> Status | None:
        """Search on until the goals are reached, the frontier is empty, a limit is reached, or so much is done.

        Args:
            num_expansions: Expansions after which to pause.

        Returns:
            SOLVED, EXHAUSTED or the limit; None for a pause.
        """
        pause = self.effort.num_expansions + num_expansions
        while self.found is None and self.frontier and self.effort.num_expansions < pause:
            limit = self.effort.exceeded()
            if limit:
                return limit
            batch = [heapq.heappop(self.frontier)[2] for _ in range(min(self.size, len(self.frontier)))]
            nearest = self.nearest
            self._expand(batch)
            for node in batch:
                self._add_children(node)
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
            if node not in self.kept:
                by_width.setdefault(self.wider.get(node, self.width), []).append(node)
        for width, alike in by_width.items():
            state = self.tree.state[alike]
            children = best_children(self.team, self.estimate.terms, state, width)
            score, primitive = self.estimate.rescored(self.team, state, children)
            num_valid = np.isfinite(score).sum(axis=1)
            for row, node in enumerate(alike):
                count = min(int(num_valid[row]), max(width // _KEPT, self.branching))
                whole = bool(children.whole[row]) and count == num_valid[row]
                self._keep(
                    node, Kept(self.tree.cost[node] + score[row, :count], primitive[row, :count], width, whole)
                )
            self.effort.num_expansions += len(alike)
            self.effort.num_children_scored += children.num_scored
            self.effort.num_children_valid += int(num_valid.sum())

    def _keep(self, node: int, children: Kept) -> None:
        self.kept[node] = children
        self.effort.memory += children.num_bytes

    def _add_children(self, node: int) -> None:
        """Add a node's next children in unclaimed cells, and return it to the frontier."""
        kept, missing = self.kept[node], self.branching
        state, at = self.tree.state[node], 0
        while at < len(kept.score) and missing:
            ahead = slice(at, at + missing)
            primitive, score = kept.primitive[ahead], kept.score[ahead]
            parents = np.repeat(state[None], len(score), axis=0)
            child, cost = self.team.move(parents, primitive), self.team.move_costs(parents, primitive)
            rows = self._claim(child)
            self._push(child[rows], self.tree.cost[node] + cost[rows], score[rows], node)
            missing -= len(rows)
            at += len(score)
        if at < len(kept.score):
            self.kept[node] = kept.after(at)
            self._return(kept.score[at], node)
        else:
            del self.kept[node]
            self.effort.memory -= kept.num_bytes
            if not kept.whole and kept.width < _WIDEST:
                self.wider[node] = kept.width * _WIDER
                # The cut may have left children that all collide: then look again at once.
                self._return(kept.score[-1] if len(kept.score) else self.tree.cost[node], node)

    def _claim(self, child: State) -> list[int]:
        """Claim the cells of children; the rows whose cells were free to claim."""
        rows = []
        for row, cells in enumerate(self._cells_of(child)):
            key = cells.tobytes()
            if key not in self.claimed:
                self.claimed.add(key)
                rows.append(row)
        return rows

    def _cells_of(self, state: State) -> State:
        return np.stack([cells[column] for cells, column in zip(self.cells, state.T, strict=True)], axis=1)

    def _push(self, child: State, cost: Float[np.ndarray, "n"], score: Float[np.ndarray, "n"], parent: int) -> None:
        """Make children nodes of the frontier."""
        for row, node in enumerate(self.tree.add(child, cost, parent)):
            self._return(score[row], node)
            if np.array_equal(child[row], self.goal):
                self.found = node
        self.nearest = min(self.nearest, (score - cost).min(initial=np.inf))
        self.effort.num_nodes += len(child)
        self.effort.memory += len(child) * (_NODE_BYTES + 8 * child.shape[1])

    def _return(self, score: float | np.floating, node: int) -> None:
        """Put a node into the frontier; among equals the newest comes first."""
        self.pushed += 1
        heapq.heappush(self.frontier, (float(score), -self.pushed, node))
