"""LaCAM: search over joint configurations one step apart, under constraints that grow, by PIBT's steps of a team."""

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int
from tqdm import tqdm

from plr_jax.collision.team import motions_apart
from plr_jax.planners._solution import MemoryUse, SearchBudget, Status
from plr_jax.planners.lattice import JointLattice

# What the robots of a team may do next from a joint configuration, and which of their motions collide.


Bits: TypeAlias = int  # a set of primitives: bit p for primitive p
JointNode: TypeAlias = Int[np.ndarray, "robots"]  # nodes of all robots
Robots: TypeAlias = Int[np.ndarray, "m"]

_MOST = 1 << 21  # pairs of motions at a time, between two looks at the clock
_FEW_PAIRS = 64  # tested as soon as looked up
_ALIGNED = 1 / 16  # of the tolerance, within which a configuration counts as the center of a cell


class Moves(NamedTuple):
    """The motions of each robot from a joint configuration.

    Args:
        child: Where each primitive of each robot leads.
        ranked: Each robot's primitives that hit no obstacle, best first.
        neighbors: Of each robot the others that it can meet, and for each of its primitives those of the other that
            collide with it.
    """

    child: list[list[int]]
    ranked: list[list[int]]
    neighbors: list[list[tuple[int, list[Bits]]]]


class TeamMoves:
    """The moves of a team on its lattices, all robots scored at once by their heuristic, near ones tested at once.

    Args:
        joint: The team. A call past the deadline of its test raises ``TimeoutError``.
        terms: Estimated costs-to-go of each robot, by node, ``inf`` where unknown.
    """

    def __init__(self, joint: JointLattice, terms: Sequence[Float[np.ndarray, "_"]]):
        self.kinds, self.terms, self.num_robots = joint.kinds, terms, len(joint.lattices)
        self.tolerance, self.deadline = joint.problem.workspace.tolerance, joint.test.deadline
        self.of_kind = [np.stack([terms[i] for i in kind.members.tolist()]) for kind in joint.kinds]
        self.kind = np.array([joint.kinds.index(lattice.kind) for lattice in joint.lattices])
        self.row = np.array([lattice.row for lattice in joint.lattices])
        self.reach = np.array([lattice.kind.reach for lattice in joint.lattices])
        self._between_cells: list[dict[tuple[int, ...], list[Bits]]] = [{} for _ in joint.kinds]

    def __call__(self, state: JointNode) -> Moves:
        """The moves from a joint configuration."""
        child, ranked, neighbors = ([[] for _ in range(self.num_robots)] for _ in range(3))
        places, ends, free, position = [], [], [], np.empty((self.num_robots, 2))
        for kind, estimate in zip(self.kinds, self.of_kind, strict=True):
            node = state[kind.members]
            target, cost = kind.motions(node)
            score = np.where(np.isfinite(cost), estimate[np.arange(len(node))[:, None], target], np.inf)
            order = np.argsort(score, axis=1, kind="stable").tolist()
            num_free = np.isfinite(cost).sum(axis=1).tolist()
            for i, targets, best, count in zip(kind.members.tolist(), target.tolist(), order, num_free, strict=True):
                child[i], ranked[i] = targets, best[:count]
            places.append(kind.q[node])
            ends.append(kind.q[target])
            position[kind.members] = places[-1][:, :2]
            free.append(np.isfinite(cost))
        for a, b, i, j in self._near(position):
            if a == b and len(i) > _FEW_PAIRS and self.kinds[a].robot.dof == 2:
                kind, away = self.kinds[a], position[j] - position[i]
                off = np.abs(ends[a] - places[a][:, None] - kind.offset).max(
                    axis=2, where=free[a][..., None], initial=0
                )
                aligned = (off < _ALIGNED * self.tolerance).all(axis=1)
                cells = np.rint(away / kind.side)
                on_grid = (np.abs(away - cells * kind.side) < _ALIGNED * self.tolerance).all(axis=1)
                on_grid &= aligned[self.row[i]] & aligned[self.row[j]]
                self._add_between_cells(a, i[on_grid], j[on_grid], cells[on_grid].astype(int), neighbors)
                i, j = i[~on_grid], j[~on_grid]
            motions_a = places[a][self.row[i]][:, None, None], ends[a][self.row[i]][:, :, None]
            motions_b = places[b][self.row[j]][:, None, None], ends[b][self.row[j]][:, None]
            robots = self.kinds[a].robot, self.kinds[b].robot
            collide = ~motions_apart(robots[0], *motions_a, robots[1], *motions_b, self.tolerance, self.deadline)
            meet = collide.any(axis=(1, 2))
            bits = _bits(collide[meet]), _bits(collide[meet].swapaxes(1, 2))
            for robot, other, ours, theirs in zip(i[meet].tolist(), j[meet].tolist(), *bits, strict=True):
                neighbors[robot].append((other, ours))
                neighbors[other].append((robot, theirs))
        return Moves(child, ranked, neighbors)

    def _add_between_cells(
        self,
        k: int,
        i: Robots,
        j: Robots,
        cells: Int[np.ndarray, "m 2"],
        neighbors: list[list[tuple[int, list[Bits]]]],
    ) -> None:
        """Add neighbors of one kind that move between centers of cells, by how many cells they are apart."""
        known, kind = self._between_cells[k], self.kinds[k]
        keys, back = (list(map(tuple, each.tolist())) for each in (cells, -cells))
        if new := list({*keys, *back} - known.keys()):
            apart, moves = (np.array(new) * kind.side)[:, None, None], kind.offset
            ours, theirs = (np.zeros_like(apart), moves[:, None]), (apart, apart + moves)
            # What places and ends are off adds up to less than half the tolerance: 3/16 of it along each axis.
            collide = ~motions_apart(kind.robot, *ours, kind.robot, *theirs, self.tolerance / 2, self.deadline)
            known.update((key, bits if any(bits) else []) for key, bits in zip(new, _bits(collide), strict=True))
        for robot, other, key, key_back in zip(i.tolist(), j.tolist(), keys, back, strict=True):
            ours = known[key]
            if ours:
                neighbors[robot].append((other, ours))
                neighbors[other].append((robot, known[key_back]))

    def estimates(self, state: JointNode) -> Float[np.ndarray, "robots"]:
        """The heuristic of each robot."""
        return np.array([term[node] for term, node in zip(self.terms, state.tolist(), strict=True)])

    def _near(self, position: Float[np.ndarray, "robots 2"]) -> Iterator[tuple[int, int, Robots, Robots]]:
        """Pairs of robots that primitives may bring together: two kinds, and some robots of each, at a time."""
        x, y = position.T
        dx, dy, reach = x[:, None] - x, y[:, None] - y, self.reach[:, None] + self.reach
        order = self.kind * self.num_robots + np.arange(self.num_robots)
        first, second = np.nonzero((dx * dx + dy * dy < reach * reach) & (order[:, None] < order))
        pairs = self.kind[first] * len(self.kinds) + self.kind[second]
        for pair in np.unique(pairs).tolist():
            a, b = divmod(pair, len(self.kinds))
            size = max(1, _MOST // (self.kinds[a].cost.shape[1] * self.kinds[b].cost.shape[1]))
            alike = np.flatnonzero(pairs == pair)
            for begin in range(0, len(alike), size):
                some = alike[begin : begin + size]
                yield a, b, first[some], second[some]


def _bits(flags: Bool[np.ndarray, "m p q"]) -> list[list[Bits]]:
    """Rows of flags as sets."""
    return np.dot(flags.astype(np.int64), 1 << np.arange(flags.shape[2])).tolist()


# One step of a whole team: priority inheritance with backtracking (PIBT).
#
# Robots choose in the order of their priorities. Each takes its best primitive that keeps clear of what others have
# chosen. Robots that have not chosen may be asked to make way: they choose next, and where one finds nothing, the
# primitive is given up. So whoever has not chosen can stay where it is, and without constraints there always is a
# step.
#
# References:
#     Okumura et al., "Priority inheritance with backtracking for iterative multi-agent path finding", 2022. There,
#     robots are points on a graph; here they have a shape, so that one may ask several others to make way.


_MOST_CHOICES = 100  # tried a robot, before nobody is asked to make way any more
_MOST_FAILURES = 8  # of a robot to make way, before it is not asked any more


class PIBT:
    """A step of the team that is being found: what robots have chosen, and what they may still choose."""

    def __init__(self, moves: Moves):
        self.moves = moves
        self.chosen = [-1] * len(moves.ranked)
        self.allowed: list[Bits] = [-1] * len(moves.ranked)
        self.num_left = _MOST_CHOICES * len(moves.ranked)
        self.num_failures = [0] * len(moves.ranked)
        self._robots: list[int] = []  # in the order in which they chose
        self._changes: list[tuple[int, Bits]] = []  # to what is allowed: whom it was, and what it was

    def find(self, order: Sequence[int], constraints: Sequence[tuple[int, int]]) -> list[int] | None:
        """The primitives of all robots; None if none were found under the constraints.

        Args:
            order: The robots, those of the highest priority first.
            constraints: Robots, and the primitives that they must choose.
        """
        in_the_way = []
        for robot, primitive in constraints:
            if not self.allowed[robot] >> primitive & 1:
                return None
            in_the_way += self._choose(robot, primitive)
        if not self._make_way(in_the_way):
            return None
        for robot in order:
            if self.chosen[robot] < 0 and not self._decide(robot):
                return None
        return self.chosen

    def _decide(self, robot: int) -> bool:
        """Choose the best primitive for which others make way; whether there is one."""
        for primitive in self.moves.ranked[robot]:
            if self.allowed[robot] >> primitive & 1:
                self.num_left -= 1
                num_chosen, num_changes = len(self._robots), len(self._changes)
                if self._make_way(self._choose(robot, primitive)):
                    return True
                self._undo(num_chosen, num_changes)
        return False

    def _choose(self, robot: int, primitive: int) -> list[int]:
        """Choose a primitive: others may no longer choose what collides with it. Those that can not even stay."""
        chosen, allowed, in_the_way = self.chosen, self.allowed, []
        chosen[robot] = primitive
        self._robots.append(robot)
        for other, collide in self.moves.neighbors[robot]:
            bits = collide[primitive]
            if bits and chosen[other] < 0:
                before = allowed[other]
                if before & bits:
                    self._changes.append((other, before))
                    allowed[other] = before & ~bits
                if not allowed[other] & 1:
                    in_the_way.append(other)
        return in_the_way

    def _make_way(self, robots: list[int]) -> bool:
        """Let those choose that cannot stay where they are; whether all of them can."""
        for robot in robots:
            if self.chosen[robot] < 0:
                if self.num_left < 0 or self.num_failures[robot] == _MOST_FAILURES:
                    return False
                if not self._decide(robot):
                    self.num_failures[robot] += 1
                    return False
        return True

    def _undo(self, num_chosen: int, num_changes: int) -> None:
        """Take back choices, the last ones first, until so many are left."""
        while len(self._changes) > num_changes:
            robot, allowed = self._changes.pop()
            self.allowed[robot] = allowed
        while len(self._robots) > num_chosen:
            self.chosen[self._robots.pop()] = -1


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

    state: JointNode
    parent: "Node | None"
    waiting: Float[np.ndarray, "robots"]
    order: list[int]
    constraints: deque[tuple[tuple[int, int], ...]]


class LaCAM:
    """Okumura's search: the newest node is asked for one more step of the team, until all are at their goals.

    A node's first step is free. Each step after that begins with more constraints: the robot next in the order of
    priorities must choose another primitive. So every step is tried in the end, but hardly ever has to be. A step to
    a node that is known puts that on top again.

    References:
        Okumura, "LaCAM: search-based algorithm for quick multi-agent pathfinding", 2023.
    """

    def __init__(self, joint: JointLattice, moves: TeamMoves, budget: SearchBudget):
        self.joint, self.moves, self.budget, self.memory_use = joint, moves, budget, MemoryUse(budget)
        self.goal = np.array([lattice.goal for lattice in joint.lattices])
        start = np.array([lattice.start for lattice in joint.lattices])
        far = np.nan_to_num(moves.estimates(start), posinf=0.0)
        self.at_rest = far / (1 + far.max())  # among robots at their goals, those go first that came from far
        self.nodes: dict[bytes, Node] = {}
        self.open: list[Node] = []
        self.found: Node | None = None
        self.least_estimate = float("inf")  # least sum of the estimates of a node
        self.num_idle = 0  # steps that brought it no nearer
        self._add(start, None)

    def run(self, max_idle: int, progress: tqdm | None = None) -> Status | None:
        """Search on until the goals are reached, nothing is left, or a limit is reached, and say which.

        None for a pause: after so many steps in a row that brought the team no nearer to its goals.
        """
        self.num_idle = 0
        while self.found is None and self.open and self.num_idle < max_idle:
            if limit := self.budget.exceeded():
                return limit
            node = self.open[-1]
            if not node.constraints:
                self.open.pop()
            else:
                # One more step of the team, under the node's next constraints.
                constraints = node.constraints.popleft()
                moves = self.moves(node.state)
                self.num_idle += 1
                self.budget.num_expansions += 1
                self.budget.num_children_scored += sum(map(len, moves.child))
                if len(constraints) < len(node.order):
                    robot = node.order[len(constraints)]
                    node.constraints.extend((*constraints, (robot, primitive)) for primitive in moves.ranked[robot])
                    self.memory_use.add(_CONSTRAINT_BYTES * len(moves.ranked[robot]))
                primitives = PIBT(moves).find(node.order, constraints)
                if primitives is not None:
                    self.budget.num_children_valid += 1
                    self._add(np.array([moves.child[i][primitive] for i, primitive in enumerate(primitives)]), node)
                if progress is not None:
                    progress.update()
        if self.found is not None:
            return Status.SOLVED
        return None if self.open else Status.EXHAUSTED

    @property
    def solution_states(self) -> Int[np.ndarray, "n robots"]:
        """States from the starts to the goals, once these are found."""
        states, node = [], self.found
        while node is not None:
            states.append(node.state)
            node = node.parent
        return np.array(states[::-1])

    @property
    def node_states(self) -> Int[np.ndarray, "n robots"]:
        """All nodes, in the order of their making."""
        return np.array([node.state for node in self.nodes.values()])

    def _add(self, state: JointNode, parent: Node | None) -> None:
        """Put a state on top, as a new node if it is not known."""
        key = state.astype(np.int32).tobytes()
        node = self.nodes.get(key)
        if node is None:
            arrived: Bool[np.ndarray, robots] = state == self.goal
            before = self.at_rest if parent is None else parent.waiting + 1
            waiting = np.where(arrived, self.at_rest, before)
            order = np.argsort(-waiting, kind="stable").tolist()
            node = self.nodes[key] = Node(state, parent, waiting, order, deque([()]))
            self.budget.num_nodes += 1
            self.memory_use.add(_NODE_BYTES + _ROBOT_BYTES * len(state))
            if arrived.all():
                self.found = node
            estimate = float(self.moves.estimates(state).sum())
            if estimate < (1 - _ROUNDING) * self.least_estimate:
                self.least_estimate, self.num_idle = estimate, 0
        self.open.append(node)
