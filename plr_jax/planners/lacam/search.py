"""Lazy search over constraints (LaCAM): joint configurations one step apart, until all robots are at their goals."""

import time
from collections import deque
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int

from plr_jax.planners._solution import Status
from plr_jax.planners.lacam.moves import TeamMoves
from plr_jax.planners.lacam.pibt import StepSearch

Constraints = tuple[tuple[int, int], ...]


@dataclass(eq=False)
class Node:
    """A joint configuration of the search."""

    state: Int[np.ndarray, "robots"]
    parent: "Node | None"
    priority: Float[np.ndarray, "robots"]
    order: list[int]
    constraints: deque[Constraints] = field(default_factory=lambda: deque([()]))


class LazySearch:
    """A depth-first search that asks each joint configuration for one more step whenever it comes by."""

    def __init__(self, moves: TeamMoves, start, goal, cost_to_go):
        self.moves = moves
        self.goal = goal
        self.cost_to_go = cost_to_go
        far = np.array([table[s] for table, s in zip(cost_to_go, start, strict=True)])
        priority = far / (1 + far.max())
        self.root = Node(start, None, priority, np.argsort(-priority, kind="stable").tolist())
        self.nodes = {start.tobytes(): self.root}
        self.open = [self.root]
        self.found = self.root if np.array_equal(start, goal) else None
        self.num_steps = 0
        self.base = priority

    def run(self, deadline: float) -> Status | None:
        while self.open and self.found is None:
            if time.perf_counter() > deadline:
                return Status.TIME_LIMIT
            node = self.open[-1]
            if not node.constraints:
                self.open.pop()
                continue
            constraints = node.constraints.popleft()
            moves = self.moves(node.state)
            depth = len(constraints)
            if depth < len(node.order):
                robot = node.order[depth]
                node.constraints.extend((*constraints, (robot, p)) for p in moves.ranked[robot])
            self.num_steps += 1
            step = StepSearch(moves).step(node.order, constraints)
            if step is None:
                continue
            state = np.array([moves.child[i][p] for i, p in enumerate(step)])
            known = self.nodes.get(state.tobytes())
            if known is not None:
                self.open.append(known)
                continue
            arrived = state == self.goal
            priority = np.where(arrived, self.base, node.priority + 1)
            child = Node(state, node, priority, np.argsort(-priority, kind="stable").tolist())
            self.nodes[state.tobytes()] = child
            self.open.append(child)
            if arrived.all():
                self.found = child
        return Status.SOLVED if self.found else Status.EXHAUSTED

    @property
    def branch(self):
        node, states = self.found, []
        while node is not None:
            states.append(node.state)
            node = node.parent
        return np.array(states[::-1])
