"""Barraquand and Latombe's search: best-first over joint configurations, which claims every joint cell once."""

import heapq
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, UInt8
from tqdm import tqdm

from plr_jax._arrays import ragged_indices, require_time
from plr_jax._types import HeuristicFn
from plr_jax.planners._heuristics import require_estimates
from plr_jax.planners._solution import MemoryUse, SearchBudget, Status
from plr_jax.planners.lattice import JointLattice, State

_CHUNK = 1 << 15  # configurations of a robot whose estimates are asked for at a time, between two looks at the clock
_PURPOSE = "the heuristic was known"
_INFINITE = 1e30  # estimates that are too large for sums of float32 count as infinite
_NODE_BYTES = 350  # what a node takes in the tree, in the frontier and among the claimed cells
_MOTION_BYTES, _ESTIMATE_BYTES = 16, 16  # what a motion takes in the tables of a robot, and a node
_COPIES, _SCORE_BYTES = 3, 12  # of the primitives of a joint child, and what a product takes while it is cut
_BATCH = 16  # nodes expanded at once at most; it widens from one while the search makes no progress
_WIDTH = 1024  # joint children held while a product of primitives is assembled, at first
_KEPT = 16  # one of so many joint children that are found is kept
_WIDER = 8  # how much wider a node's children are sought when those kept are used up
_WIDEST = 1 << 16
_PRODUCTS = 1 << 20  # of a robot's primitives and what others do, at a time, which bounds the temporaries

Table: TypeAlias = Float[np.ndarray, "_"]  # an estimate of each configuration of a robot's lattice


class Successors(NamedTuple):
    """The best children of some joint configurations, by score, best first.

    Args:
        score: Sums of the robots' terms; ``inf`` for children that collide.
        primitive: The primitive of each robot.
        num_scored: Joint children, whole and partial, that were scored to find them.
        num_valid: How many whole children collide with nothing.
        whole: Whether no collision-free child is missing.
    """

    score: Float[np.ndarray, "n m"]
    primitive: UInt8[np.ndarray, "n m robots"]
    num_scored: int
    num_valid: int
    is_complete: Bool[np.ndarray, "n"]


def best_successors(
    joint: JointLattice, terms: Sequence[Float[np.ndarray, "_ _"]], state: State, width: int
) -> Successors:
    """The best children of joint configurations, one robot added after the other.

    The product of the first robots' primitives is cut to the ``width`` best collision-free ones before the next
    robot joins. A product that fits is not cut, so that its children are complete. The ``terms`` are the scores of
    each robot's configurations and primitives, ``inf`` where blocked.
    """
    score = np.zeros((len(state), 1), np.float32)
    primitive = np.zeros((len(state), 1, 0), np.uint8)
    num_scored, num_valid, whole = 0, len(state), np.ones(len(state), dtype=bool)
    rows = np.arange(len(state))[:, None]
    for i, term in enumerate(terms):
        extended = score[:, :, None] + term[state[:, i], None]
        for j in range(i):
            near, collide = joint.collisions(j, i, state)
            if collide.any():
                penalty = np.where(collide, np.float32(np.inf), np.float32(0.0))
                extended[near] += penalty[np.arange(len(near))[:, None], primitive[near, :, j]]
        num_scored += extended.size
        score = extended.reshape(len(state), -1)
        valid = np.count_nonzero(score < np.inf, axis=1)
        num_valid = int(valid.sum())
        kept = np.broadcast_to(np.arange(score.shape[1]), score.shape)
        if width < score.shape[1]:
            whole &= valid <= width
            kept = np.argpartition(score, width - 1, axis=1)[:, :width]
            score = np.take_along_axis(score, kept, axis=1)
        parent, own = np.divmod(kept, term.shape[1])
        primitive = np.concatenate([primitive[rows, parent], own[..., None].astype(np.uint8)], axis=2)
    order = np.argsort(score, axis=1, kind="stable")
    return Successors(np.take_along_axis(score, order, axis=1), primitive[rows, order], num_scored, num_valid, whole)


def tabulate(joint: JointLattice, heuristic: HeuristicFn, deadline: float = math.inf) -> list[Table]:
    """A heuristic's terms over the robots' lattices, ``ValueError`` if it returns NaN or another shape.

    A negative estimate counts as 0.

    Raises:
        TimeoutError: If the deadline, on the clock of ``time.perf_counter``, passes first.
    """
    size, chunk = max(len(lattice.q) for lattice in joint.lattices), max(1, _CHUNK // (1 + len(joint.lattices) // 16))
    # One column a robot, so that a team's PLRs answer in one call; shorter columns repeat their first rows.
    state = np.stack([np.resize(np.arange(len(lattice.q)), size) for lattice in joint.lattices], axis=1)
    values = np.empty(state.shape)
    for begin in range(0, size, chunk):
        require_time(deadline, _PURPOSE)
        q = joint.configurations(state[begin : begin + chunk])
        values[begin : begin + chunk] = require_estimates(heuristic.per_robot(q), q.shape[:2])
    return [column[: len(lattice.q)] for column, lattice in zip(values.T, joint.lattices, strict=True)]


@dataclass
class SuccessorList:
    """The best successors of an expanded node, best first, and how far they have been looked at.

    Their scores are cost-to-come and weighted heuristic. ``width`` says how wide they were sought, ``whole`` whether
    the node has no others, ``at`` which is the first that has not been looked at.
    """

    score: Float[np.ndarray, "m"]
    cost: Float[np.ndarray, "m"]
    state: State
    width: int
    is_complete: bool
    num_bytes: int
    next_index: int = 0


class BestFirstSearch:
    """Barraquand and Latombe's search: the best node of the frontier adds its best children in unclaimed cells.

    A node adds one child at a time, and returns to the frontier with the score of its next one (partial expansion).
    Several nodes are expanded at once while the search makes no progress. Every joint configuration is a cell.

    Args:
        joint: The team on its lattices.
        estimates: The terms of the heuristic: each robot's, of all its configurations. An infinite one never prunes:
            it counts as farther than all finite ones.
        weight: The factor of the heuristic.
        budget: What the search may still do.

    Attributes:
        scores: Of each robot the cost of its configurations' primitives and the weighted term of where they lead.
        states, costs, parents: For each node where it is, its cost-to-come and the node whose child it is; -1 for
            the root.
        found: The node at the goals, once there is one.

    Raises:
        TimeoutError: If the deadline passes before the scores are known.
    """

    def __init__(self, joint: JointLattice, estimates: Sequence[Table], weight: float, budget: SearchBudget):
        self.joint, self.budget, self.memory_use = joint, budget, MemoryUse(budget)
        self.scores, self.least_estimate = [], 0.0
        for lattice, estimate in zip(joint.lattices, estimates, strict=True):
            require_time(budget.deadline, _PURPOSE)
            known = estimate < _INFINITE
            table = np.where(known, estimate, 2 * estimate[known].max(initial=0.0))
            self.scores.append((lattice.cost + weight * table[lattice.child]).astype(np.float32))
            self.least_estimate += weight * table[lattice.start]
        self.memory_use.add(bytes_of_tables(joint))
        self.max_product_bytes = 0  # bytes that the widest products took so far
        self.goal = np.array([lattice.goal for lattice in joint.lattices])
        start = np.array([lattice.start for lattice in joint.lattices], np.int32)
        self.states, self.costs, self.parents = [start], [0.0], [-1]
        self.claimed = {start.tobytes()}
        self.frontier = [(float(self.least_estimate), 0, 0)]
        self.successors: dict[int, SuccessorList] = {}
        self.next_widths: dict[int, int] = {}
        self.pushed, self.batch_size, self.num_expansions = 0, 1, 0
        self.found = 0 if np.array_equal(start, self.goal) else None
        budget.num_nodes += 1

    def run(self, max_expansions: int, progress: tqdm | None = None) -> Status | None:
        """Search on until the goals are reached, the frontier is empty, or a limit is reached, and say which.

        None for a pause: after so many expansions more. ``TimeoutError`` if the deadline passes within one.
        """
        last = self.num_expansions + max_expansions
        while self.found is None and self.frontier and self.num_expansions < last:
            if limit := self.budget.exceeded():
                return limit
            left = self.budget.max_expansions - self.budget.num_expansions
            batch = [
                heapq.heappop(self.frontier)[2] for _ in range(int(min(self.batch_size, len(self.frontier), left)))
            ]
            nearest, before = self.least_estimate, self.num_expansions
            self._expand(batch)
            for node in batch:
                self._add_child(node)
            if progress is not None:
                progress.update(self.num_expansions - before)
            self.batch_size = 1 if self.least_estimate < nearest else min(2 * self.batch_size, _BATCH)
        if self.found is not None:
            return Status.SOLVED
        return None if self.frontier else Status.EXHAUSTED

    @property
    def solution_states(self) -> State:
        """States from the starts to the goals, once these are found."""
        assert self.found is not None
        node, states = self.found, [self.states[self.found]]
        while self.parents[node] >= 0:
            node = self.parents[node]
            states.append(self.states[node])
        return np.array(states[::-1])

    @property
    def node_states(self) -> State:
        """All nodes, in the order of their making."""
        return np.array(self.states)

    def _expand(self, nodes: list[int]) -> None:
        """Find the best children of nodes that have none kept."""
        by_width: dict[int, list[int]] = {}
        for node in nodes:
            if node not in self.successors:
                by_width.setdefault(self.next_widths.get(node, _WIDTH), []).append(node)
        most = max(kind.cost.shape[1] for kind in self.joint.kinds)
        for width, of_width in by_width.items():
            size = max(1, _PRODUCTS // (width * most))
            for begin in range(0, len(of_width), size):
                some = of_width[begin : begin + size]
                # Count the widest products so far as held: they may be as wide again.
                num_bytes = (len(some) * width) * (_COPIES * len(self.joint.lattices) + _SCORE_BYTES * most)
                self.memory_use.add(max(0, num_bytes - self.max_product_bytes))
                self.max_product_bytes = max(self.max_product_bytes, num_bytes)
                # The best children of these nodes, of which the first are kept.
                state = np.array([self.states[node] for node in some])
                cost = np.array([self.costs[node] for node in some])
                children = best_successors(self.joint, self.scores, state, width)
                num_valid = np.isfinite(children.score).sum(axis=1)
                num_kept = np.minimum(num_valid, max(width // _KEPT, 1))
                whole = children.is_complete & (num_kept == num_valid)
                row, column = ragged_indices(num_kept)
                score = cost[row] + children.score[row, column]
                state, move_cost = self.joint.move(state[row], children.primitive[row, column])
                cost = cost[row] + move_cost
                self.budget.num_children_scored += children.num_scored
                self.budget.num_children_valid += children.num_valid
                last = np.cumsum(num_kept)
                for i, node in enumerate(some):
                    own = slice(last[i] - num_kept[i], last[i])
                    num_bytes = sum(column[own].nbytes for column in (score, cost, state))
                    self.successors[node] = SuccessorList(
                        score[own], cost[own], state[own], width, bool(whole[i]), num_bytes
                    )
                    self.memory_use.add(num_bytes)
                self.num_expansions += len(some)
                self.budget.num_expansions += len(some)

    def _add_child(self, node: int) -> None:
        """Claim the cell of a node's next child, and return it to the frontier by the score of the one after."""
        successors, is_added = self.successors[node], False
        for child in range(successors.next_index, len(successors.score)):
            state, score = successors.state[child].copy(), successors.score[child]
            if (cell := state.tobytes()) in self.claimed:
                continue
            if is_added:
                successors.next_index = child
                self._return(score, node)
                return
            is_added, cost = True, float(successors.cost[child])
            self.claimed.add(cell)
            self._return(score, len(self.states))
            if np.array_equal(state, self.goal):
                self.found = len(self.states)
            self.states.append(state)
            self.costs.append(cost)
            self.parents.append(node)
            self.least_estimate = min(self.least_estimate, score - cost)
            self.budget.num_nodes += 1
            self.memory_use.add(_NODE_BYTES + 8 * len(state))
        del self.successors[node]
        self.memory_use.add(-successors.num_bytes)
        if not successors.is_complete and successors.width < _WIDEST:
            self.next_widths[node] = successors.width * _WIDER
            # A cut may leave nothing but children that collide: then look again at once.
            self._return(successors.score[-1] if len(successors.score) else self.costs[node], node)

    def _return(self, score: float | np.floating, node: int) -> None:
        """Put a node into the frontier; among equals the newest comes first."""
        self.pushed += 1
        heapq.heappush(self.frontier, (float(score), -self.pushed, node))


def bytes_of_tables(joint: JointLattice) -> int:
    """About what the tables of each robot's motions take that best-first search makes."""
    sizes = [(lattice.kind.child.size, len(lattice.q)) for lattice in joint.lattices]
    return sum(_MOTION_BYTES * num_motions + _ESTIMATE_BYTES * num_nodes for num_motions, num_nodes in sizes)
