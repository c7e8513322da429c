"""Best-first search over joint configurations (Barraquand and Latombe), with beam search for the children.

The *children* of a node are its next joint configurations: each robot makes one motion of its lattice, or stays. A
node's *successors* are the best of its children, found by beam search. Successors join the search tree one by one.
"""

import heapq
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, UInt8

from plr_jax._arrays import batches, path_from_root, ragged_indices, require_time, slices
from plr_jax._progress import Progress
from plr_jax._types import HeuristicFn
from plr_jax.planners._heuristics import require_estimates
from plr_jax.planners._solution import MemoryUse, SearchBudget, Status
from plr_jax.planners.lattice import JointLattice, State, Table

_CHUNK = 1 << 15  # joint configurations per call of the heuristic, between two checks of the clock
_PURPOSE = "the heuristic was known"  # ends the error message "The deadline passed before ..."
_INFINITE = 1e30  # larger estimates count as infinite, as sums of them could overflow float32
# Memory:
_NODE_BYTES = 350  # bytes of a node in the tree, the frontier and the set of claimed cells
_MOTION_BYTES = 16  # bytes of a motion in a robot's score table
_ESTIMATE_BYTES = 16  # bytes of a node in a robot's table of estimates
_PRIMITIVE_COPIES = 3  # arrays that hold a joint child's primitives while the beam is cut
_SCORE_BYTES = 12  # bytes of a joint child's score while the beam is cut
# Length of the first turn, in expansions: the smaller of two limits.
_EXPANSIONS = 1024  # divided by the number of robots
_EXPANSIONS_OF_PAIRS = 4096  # divided by the squared number of robots
# Batches and beams:
_BATCH = 16  # most nodes expanded at once; the batch doubles from 1 while the search makes no progress
_WIDTH = 1024  # initial beam width
_STORED_SHARE = 16  # the best 1 / 16 of the beam is stored as successors
_WIDTH_GROWTH = 8  # factor of the beam width when a node's stored successors are used up
_MAX_WIDTH = 1 << 16  # bounds the memory of a beam
_PRODUCTS = 1 << 20  # joint children scored at once, which bounds the temporary memory


class Beam(NamedTuple):
    """The ``m`` best children (next joint configurations) of each of ``n`` joint states, by ascending score."""

    step_score: Float[np.ndarray, "n m"]  # sum of the robots' terms for this step; inf for children that collide
    primitive: UInt8[np.ndarray, "n m robots"]
    num_scored: int  # children scored, including children in which only the first robots have moved
    num_valid: int  # collision-free children in which every robot has moved, over all nodes
    is_complete: Bool[np.ndarray, " n"]  # whether surely no collision-free child is missing


def best_successors(joint: JointLattice, terms: Sequence[Float[np.ndarray, "_ _"]], state: State, width: int) -> Beam:
    """Find the best next joint configurations (children) of joint states by beam search, one robot at a time.

    ``state`` has the lattice node of each robot in each joint state. A primitive is a motion to a neighboring cell,
    or a stay. ``terms[robot]`` has the score of each primitive (columns) at each node of the robot's lattice (rows),
    ``inf`` if the motion is blocked. Only the ``width`` best joint motions of the first robots are kept before the
    next robot's primitives are added.
    """
    # score[row, m]: sum of the terms in the m-th joint motion from a state. primitive[row, m]: its primitives so far.
    score = np.zeros((len(state), 1), np.float32)
    primitive = np.zeros((len(state), 1, 0), np.uint8)
    num_scored, num_valid = 0, len(state)
    is_complete = np.ones(len(state), dtype=bool)
    rows = np.arange(len(state))[:, None]
    for i, term in enumerate(terms):
        # 1. Extend each joint motion by each primitive of robot i (third axis); the score of collisions is inf.
        extended = score[:, :, None] + term[state[:, i], None]
        for j in range(i):
            # `near`: the rows in which robots j and i are near. collide[k, p, q]: whether primitive p of robot j and
            # primitive q of robot i collide in row near[k]. The primitives of robot j are (near, m); the penalty that
            # they select is (near, m, primitives of robot i).
            near, collide = joint.collisions(j, i, state)
            if collide.any():
                penalty = np.where(collide, np.float32(np.inf), np.float32(0.0))
                extended[near] += penalty[np.arange(len(near))[:, None], primitive[near, :, j]]
        num_scored += extended.size
        # 2. Keep the best joint motions, in any order. Their index is m * (number of primitives) + primitive.
        score = extended.reshape(len(state), -1)
        valid = np.count_nonzero(score < np.inf, axis=1)
        num_valid = int(valid.sum())
        best = np.broadcast_to(np.arange(score.shape[1]), score.shape)
        if width < score.shape[1]:
            is_complete &= valid <= width
            best = np.argpartition(score, width - 1, axis=1)[:, :width]
            score = np.take_along_axis(score, best, axis=1)
        parent, last = np.divmod(best, term.shape[1])
        primitive = np.concatenate([primitive[rows, parent], last[..., None].astype(np.uint8)], axis=2)
    # 3. Sort them.
    order = np.argsort(score, axis=1, kind="stable")
    return Beam(np.take_along_axis(score, order, axis=1), primitive[rows, order], num_scored, num_valid, is_complete)


def tabulate(joint: JointLattice, heuristic: HeuristicFn, deadline: float = np.inf) -> list[Table]:
    """Return, for each robot, the robot's term of the heuristic at all nodes of its lattice.

    ``TimeoutError`` after the ``deadline``, a time of ``time.perf_counter``.
    """
    size = max(len(lattice.q) for lattice in joint.lattices)
    # One column per robot, so that one call evaluates a team's PLRs. Shorter columns repeat their first rows.
    state = np.stack([np.resize(np.arange(len(lattice.q)), size) for lattice in joint.lattices], axis=1)
    values = np.empty(state.shape)
    # Shorten the chunks of large teams: a call has fewer than `16 * _CHUNK` configurations of single robots.
    for rows in slices(size, max(1, _CHUNK // (1 + len(joint.lattices) // 16))):
        require_time(deadline, _PURPOSE)
        q = joint.configurations(state[rows])
        values[rows] = require_estimates(heuristic.per_robot(q), q.shape[:2])
    return [column[: len(lattice.q)] for column, lattice in zip(values.T, joint.lattices, strict=True)]


@dataclass
class SuccessorList:
    """The best next joint configurations of one node, by ascending score; they join the search tree one by one."""

    score: Float[np.ndarray, " m"]  # cost-to-come plus weighted heuristic
    cost: Float[np.ndarray, " m"]  # cost-to-come
    state: State
    width: int  # the beam width of the search that found them
    is_complete: bool  # whether the node surely has no other successors
    num_bytes: int
    next_index: int = 0  # index of the first successor that was not considered yet


class BestFirstSearch:
    """A best-first search that adds one child of a node at a time, then queues the node again for its next child.

    Children are next joint configurations of the team; the *successors* of a node are its best children. Several
    nodes are expanded at once while the search makes no progress. The life of a node::

        frontier --pop--> node --- if it has no successors: beam search stores some (`_expand`)
          ^                |
          |                v
          |<------------ its next unclaimed successor becomes a node (`_add_child`), with its own score
          |                |
          |                v
          +------------- the node, with the score of the unclaimed successor after it. If there is none, the node
                         returns for a beam 8 times as wide, unless no child is missing or the beam is the widest.
    """

    is_weighted = True

    def __init__(self, joint: JointLattice, estimates: Sequence[Table], weight: float, budget: SearchBudget):
        self.joint, self.budget, self.memory_use = joint, budget, MemoryUse(budget)
        self.scores = []  # for each robot, by node and primitive: motion cost plus weighted term of the child
        self.least_estimate = 0.0  # least weighted heuristic of the nodes
        for lattice, estimate in zip(joint.lattices, estimates, strict=True):
            require_time(budget.deadline, _PURPOSE)
            # Nodes without an estimate are not pruned: they count as twice the largest estimate.
            is_finite = estimate < _INFINITE
            table = np.where(is_finite, estimate, 2 * estimate[is_finite].max(initial=0.0))
            self.scores.append((lattice.cost + weight * table[lattice.child]).astype(np.float32))
            self.least_estimate += weight * table[lattice.start]
        self.memory_use.add(self.num_bytes_needed(joint))
        self.max_product_bytes = 0  # bytes of the widest beams so far
        self.goal = np.array([lattice.goal for lattice in joint.lattices])
        start = np.array([lattice.start for lattice in joint.lattices], np.int32)
        self.first_turn = min(_EXPANSIONS / len(start), _EXPANSIONS_OF_PAIRS / len(start) ** 2)
        self.states, self.costs, self.parents = [start], [0.0], [-1]  # by node; the root has no parent
        self.claimed = {start.tobytes()}
        self.frontier = [(float(self.least_estimate), 0, 0)]  # score, order among equals, node
        self.successors: dict[int, SuccessorList] = {}
        self.next_widths: dict[int, int] = {}  # beam widths of nodes whose successors are used up
        self.num_pushed, self.batch_size, self.num_expansions = 0, 1, 0
        self.is_complete = True  # until a node loses children to the cut of the widest beam
        self.goal_node = 0 if np.array_equal(start, self.goal) else None  # the node at the goals
        budget.num_nodes += 1

    @staticmethod
    def num_bytes_needed(joint: JointLattice) -> int:
        return sum(_MOTION_BYTES * each.kind.child.size + _ESTIMATE_BYTES * len(each.q) for each in joint.lattices)

    def run(self, max_expansions: int, progress: Progress | None = None) -> Status | None:
        """Search until about ``max_expansions`` nodes are expanded.

        Return why the search ended, or None if another call can continue it.
        """
        last = self.num_expansions + max_expansions
        while self.goal_node is None and self.frontier and self.num_expansions < last:
            if limit := self.budget.exceeded():
                return limit
            left = self.budget.max_expansions - self.budget.num_expansions
            size = int(min(self.batch_size, len(self.frontier), left))
            batch = [heapq.heappop(self.frontier)[2] for _ in range(size)]
            nearest, before = self.least_estimate, self.num_expansions
            self._expand(batch)
            for node in batch:
                self._add_child(node)
            if progress is not None:
                progress.update(self.num_expansions - before)
            self.batch_size = 1 if self.least_estimate < nearest else min(2 * self.batch_size, _BATCH)
        if self.goal_node is not None:
            return Status.SOLVED
        return None if self.frontier else Status.EXHAUSTED

    @property
    def solution_states(self) -> State:
        """The joint states of the path that was found, from the starts on."""
        assert self.goal_node is not None
        return np.array([self.states[node] for node in path_from_root(self.parents, self.goal_node)])

    @property
    def node_states(self) -> State:
        return np.array(self.states)

    def _expand(self, nodes: list[int]) -> None:
        # 1. Group the nodes that have no successors left by the width of the beam that they need next.
        by_width: dict[int, list[int]] = {}
        for node in nodes:
            if node not in self.successors:
                by_width.setdefault(self.next_widths.get(node, _WIDTH), []).append(node)
        most = max(kind.cost.shape[1] for kind in self.joint.kinds)
        for width, of_width in by_width.items():
            for part in batches(of_width, max(1, _PRODUCTS // (width * most))):
                # 2. Reserve the memory of the widest beams so far, as later ones may be as wide.
                num_bytes = (len(part) * width) * (_PRIMITIVE_COPIES * len(self.joint.lattices) + _SCORE_BYTES * most)
                self.memory_use.add(max(0, num_bytes - self.max_product_bytes))
                self.max_product_bytes = max(self.max_product_bytes, num_bytes)
                # 3. Find successors, and keep the best of each node.
                state = np.array([self.states[node] for node in part])
                cost = np.array([self.costs[node] for node in part])
                beam = best_successors(self.joint, self.scores, state, width)
                num_valid = np.isfinite(beam.step_score).sum(axis=1)
                num_kept = np.minimum(num_valid, max(width // _STORED_SHARE, 1))
                is_complete = beam.is_complete & (num_kept == num_valid)
                # 4. Compute score, state and cost of each kept successor: `row` is its node's index in `part`.
                row, column = ragged_indices(num_kept)
                score = cost[row] + beam.step_score[row, column]
                state, move_cost = self.joint.move(state[row], beam.primitive[row, column])
                cost = cost[row] + move_cost
                self.budget.num_children_scored += beam.num_scored
                self.budget.num_children_valid += beam.num_valid
                # 5. Store the successors of each node.
                last = np.cumsum(num_kept)
                for i, node in enumerate(part):
                    best = slice(last[i] - num_kept[i], last[i])
                    kept = score[best], cost[best], state[best]
                    num_bytes = sum(values.nbytes for values in kept)
                    self.successors[node] = SuccessorList(*kept, width, bool(is_complete[i]), num_bytes)
                    self.memory_use.add(num_bytes)
                self.num_expansions += len(part)
                self.budget.num_expansions += len(part)

    def _add_child(self, node: int) -> None:
        # 1. Add the best child that is in no node yet, and queue the node again with the score of the one after it.
        successors = self.successors[node]
        is_added = False
        for child in range(successors.next_index, len(successors.score)):
            # Copied, as a view would keep the whole list in memory.
            state, score = successors.state[child].copy(), successors.score[child]
            if (cell := state.tobytes()) in self.claimed:
                continue
            if is_added:
                successors.next_index = child
                self._push(score, node)
                return
            is_added = True
            cost = float(successors.cost[child])
            self.claimed.add(cell)
            self._push(score, len(self.states))
            if np.array_equal(state, self.goal):
                self.goal_node = len(self.states)
            self.states.append(state)
            self.costs.append(cost)
            self.parents.append(node)
            self.least_estimate = min(self.least_estimate, score - cost)  # the child's weighted heuristic
            self.budget.num_nodes += 1
            self.memory_use.add(_NODE_BYTES + 8 * len(state))
        # 2. If there is no further child, a wider beam may find more, unless none is missing.
        del self.successors[node]
        self.memory_use.add(-successors.num_bytes)
        if successors.is_complete:
            return
        if successors.width >= _MAX_WIDTH:
            self.is_complete = False
        else:
            self.next_widths[node] = successors.width * _WIDTH_GROWTH
            # A cut may leave only children that collide: then the node returns with its own cost, which is at most
            # the score of any child, so that it comes before them.
            self._push(successors.score[-1] if len(successors.score) else self.costs[node], node)

    def _push(self, score: float | np.floating, node: int) -> None:
        self.num_pushed += 1
        heapq.heappush(self.frontier, (float(score), -self.num_pushed, node))  # newest first among equal scores
