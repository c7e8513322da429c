"""LaCAM: a depth-first search over joint configurations, in which PIBT finds each step of the whole team.

PIBT (priority inheritance with backtracking) lets robots choose in the order of their priorities. Each robot takes
its best primitive (motion to a neighboring cell, or a stay) that hits no motion chosen so far. Robots that can then
no longer stay choose next. If one of them finds no motion, the first robot gives up this primitive and tries another
one. When LaCAM returns to a joint configuration, it prescribes the motions of some robots, so that PIBT finds another
step. References: Okumura et al., Artificial Intelligence 310, 2022 (PIBT); Okumura, AAAI 2023 (LaCAM).
"""

from collections import deque
from collections.abc import Iterator, Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import batches
from plr_jax._problem import ROUNDING
from plr_jax._progress import Progress
from plr_jax.collision.motions import motions_apart
from plr_jax.planners._solution import MemoryUse, SearchBudget, Status
from plr_jax.planners.lattice import JointLattice, Table

Bits: TypeAlias = int  # a set of primitives: bit p for primitive p
JointNode: TypeAlias = Int[np.ndarray, " robots"]  # the lattice node of each robot
Robots: TypeAlias = Int[np.ndarray, " m"]
Neighbors: TypeAlias = list[list[tuple[int, list[Bits]]]]
# Collisions of the team's motions:
_MOST = 1 << 21  # pairs of motions tested at once, between two checks of the clock
_FEW_PAIRS = 64  # up to so many pairs of robots, testing is as fast as a lookup
_ALIGNED = 1 / 16  # share of the tolerance within which a configuration counts as the center of a cell
# PIBT:
_MOST_CHOICES = 100  # choices per robot in one step, after which no robot is asked to make way
_MOST_FAILURES = 8  # failures of a robot to make way, after which it is not asked again
# LaCAM:
_IDLE_STEPS = 8  # length of the first turn, in steps per robot without progress
_NODE_BYTES = 1_500  # bytes of a node
_ROBOT_BYTES = 60  # bytes of each robot of a node
_CONSTRAINT_BYTES = 100  # bytes of the constraints of one step


class Moves(NamedTuple):
    """The primitives (motions to adjacent cells) of all robots from a joint configuration, and their collisions."""

    child: list[list[int]]  # the node that each primitive of each robot leads to
    ranked: list[list[int]]  # each robot's primitives that hit no obstacle, best first
    # Of each robot: the other robots that it may hit. An entry is the other robot and, for each primitive of this
    # robot, the set of the other's primitives that collide with it; no set if none collides.
    neighbors: Neighbors


class TeamMoves:
    """A function from a joint configuration to the :class:`Moves` of the team; ``TimeoutError`` if time is up."""

    def __init__(self, joint: JointLattice, terms: Sequence[Table]):
        self.kinds, self.terms, self.num_robots = joint.kinds, terms, len(joint.lattices)  # terms by robot and node
        self.tolerance, self.deadline = joint.problem.workspace.tolerance, joint.test.deadline
        self.of_kind = [np.stack([terms[i] for i in kind.members.tolist()]) for kind in joint.kinds]
        self.kind = np.array([joint.kinds.index(lattice.kind) for lattice in joint.lattices])
        self.row = np.array([lattice.row for lattice in joint.lattices])
        self.reach = np.array([lattice.kind.reach for lattice in joint.lattices])
        self._between_cells: list[dict[tuple[int, ...], list[Bits]]] = [{} for _ in joint.kinds]

    def __call__(self, state: JointNode) -> Moves:
        """Return all robots' motions from a joint configuration, and the pairs of motions that collide.

        ``state`` has the lattice node of each robot.
        """
        # 1. Find each robot's motions. `places`, `ends` and `free` have an array per kind: configurations
        #    (robots, dof), end configurations (robots, primitives, dof), and which primitives hit no obstacle.
        child, ranked, neighbors = ([[] for _ in range(self.num_robots)] for _ in range(3))
        places, ends, free = [], [], []
        position = np.empty((self.num_robots, 2))
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
            # 2. For robots of one kind, whole cells apart and with the usual motions of the lattice, only the number
            #    of cells between them decides which motions collide: look these up.
            if a == b and len(i) > _FEW_PAIRS and self.kinds[a].robot.dof == 2:
                kind = self.kinds[a]
                away = position[j] - position[i]
                misalignment = np.abs(ends[a] - places[a][:, None] - kind.offset)
                misalignment = misalignment.max(axis=2, where=free[a][..., None], initial=0)
                aligned = (misalignment < _ALIGNED * self.tolerance).all(axis=1)
                cells = np.rint(away / kind.side)
                on_grid = (np.abs(away - cells * kind.side) < _ALIGNED * self.tolerance).all(axis=1)
                on_grid &= aligned[self.row[i]] & aligned[self.row[j]]
                self._look_up(a, i[on_grid], j[on_grid], cells[on_grid].astype(int), neighbors)
                i, j = i[~on_grid], j[~on_grid]
            # 3. Test all motions of all other pairs (axes: pairs, primitives of i, primitives of j).
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

    def _look_up(self, k: int, i: Robots, j: Robots, cells: Int[np.ndarray, "m 2"], neighbors: Neighbors) -> None:
        # The key of `known_bits` is the number of cells, along each axis, from a first robot to a second one. The
        # value has, for each primitive of the first robot, the primitives of the second robot that collide with it.
        # The opposite key has, for each primitive of the second robot, the colliding primitives of the first robot.
        known_bits, kind = self._between_cells[k], self.kinds[k]
        keys, back = (list(map(tuple, offsets.tolist())) for offsets in (cells, -cells))
        # 1. Test the motions for new keys, from the origin and from the center of the other robot's cell.
        if new := list({*keys, *back} - known_bits.keys()):
            begin = (np.array(new) * kind.side)[:, None, None]
            motions = np.zeros_like(begin), kind.offset[:, None]
            others = begin, begin + kind.offset
            # Misalignments add up to at most 3/16 of the tolerance along each axis: half of it covers them.
            collide = ~motions_apart(kind.robot, *motions, kind.robot, *others, self.tolerance / 2, self.deadline)
            known_bits.update((key, bits if any(bits) else []) for key, bits in zip(new, _bits(collide), strict=True))
        # 2. Look up all pairs.
        for robot, other, key, key_back in zip(i.tolist(), j.tolist(), keys, back, strict=True):
            if ours := known_bits[key]:
                neighbors[robot].append((other, ours))
                neighbors[other].append((robot, known_bits[key_back]))

    def estimates(self, state: JointNode) -> Float[np.ndarray, " robots"]:
        return np.array([term[node] for term, node in zip(self.terms, state.tolist(), strict=True)])

    def _near(self, position: Float[np.ndarray, "robots 2"]) -> Iterator[tuple[int, int, Robots, Robots]]:
        """Yield pairs of robots that may meet in one step, grouped by kinds (robots of equal shape).

        Each item is ``(a, b, first, second)``: the indices ``a <= b`` of two kinds, and the indices of ``m`` pairs of
        robots. Robot ``first[k]`` is of kind ``a``, robot ``second[k]`` of kind ``b``.
        """
        x, y = position.T
        dx, dy = x[:, None] - x, y[:, None] - y
        reach = self.reach[:, None] + self.reach
        # Each pair occurs once, first the robot of the kind with the smaller index.
        order = self.kind * self.num_robots + np.arange(self.num_robots)
        first, second = np.nonzero((dx * dx + dy * dy < reach * reach) & (order[:, None] < order))
        pairs = self.kind[first] * len(self.kinds) + self.kind[second]
        for pair in np.unique(pairs).tolist():
            a, b = divmod(pair, len(self.kinds))
            size = max(1, _MOST // (self.kinds[a].cost.shape[1] * self.kinds[b].cost.shape[1]))
            for chunk in batches(np.flatnonzero(pairs == pair), size):
                yield a, b, first[chunk], second[chunk]


def _bits(flags: Bool[np.ndarray, "m p q"]) -> list[list[Bits]]:
    """Return flags packed into integers: bit ``q`` of entry ``[m][p]`` is ``flags[m, p, q]``."""
    return np.dot(flags.astype(np.int64), 1 << np.arange(flags.shape[2])).tolist()


class PIBT:
    """A search for one collision-free step of the team: the motions chosen so far, and the motions still allowed."""

    def __init__(self, moves: Moves):
        self.moves = moves
        self.chosen = [-1] * len(moves.ranked)  # the primitive of each robot; -1: none yet
        self.allowed: list[Bits] = [-1] * len(moves.ranked)  # -1 has all bits set
        self.num_left = _MOST_CHOICES * len(moves.ranked)
        self.num_failures = [0] * len(moves.ranked)
        self._robots: list[int] = []  # robots that have chosen, in order
        self._changes: list[tuple[int, Bits]] = []  # robots, and their allowed primitives before each change

    def find(self, order: Sequence[int], constraints: Sequence[tuple[int, int]]) -> list[int] | None:
        """Return the primitive of each robot in a collision-free step of the team, or None if no step was found.

        Each constraint is a robot and the primitive prescribed for it. The other robots choose in the given order.
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
        """Choose the best motion of a robot for which all robots in its way find motions, too.

        Return whether there is such a motion.
        """
        for primitive in self.moves.ranked[robot]:
            if self.allowed[robot] >> primitive & 1:
                self.num_left -= 1
                num_chosen, num_changes = len(self._robots), len(self._changes)
                if self._make_way(self._choose(robot, primitive)):
                    return True
                # Undo the choices made since then.
                while len(self._changes) > num_changes:
                    other, allowed = self._changes.pop()
                    self.allowed[other] = allowed
                while len(self._robots) > num_chosen:
                    self.chosen[self._robots.pop()] = -1
        return False

    def _choose(self, robot: int, primitive: int) -> list[int]:
        # Return the robots that can then no longer stay in place.
        chosen, allowed, in_the_way = self.chosen, self.allowed, []
        chosen[robot] = primitive
        self._robots.append(robot)
        for other, collide in self.moves.neighbors[robot]:
            if (bits := collide[primitive]) and chosen[other] < 0:
                if (before := allowed[other]) & bits:
                    self._changes.append((other, before))
                    allowed[other] = before & ~bits
                if not allowed[other] & 1:
                    in_the_way.append(other)
        return in_the_way

    def _make_way(self, robots: list[int]) -> bool:
        """Let each of ``robots`` that has no motion yet choose a motion; return whether all found one."""
        for robot in robots:
            if self.chosen[robot] < 0:
                if self.num_left < 0 or self.num_failures[robot] == _MOST_FAILURES:
                    return False
                if not self._decide(robot):
                    self.num_failures[robot] += 1
                    return False
        return True


class Node(NamedTuple):
    """A joint state that the search has reached, with the steps of the team that are still to try from this state."""

    state: JointNode
    parent: "Node | None"
    priority: Float[np.ndarray, " robots"]  # steps since the start, or since the goal was left, plus a share below 1
    order: list[int]  # robots by priority, the highest first
    constraints: deque[tuple[tuple[int, int], ...]]  # of each step to try: prescribed robots and their primitives


class LaCAM:
    """A depth-first search over joint configurations: from the newest node, the whole team makes one more step.

    PIBT finds the motions of this step. When a node is expanded again, the motions of some robots are prescribed, at
    first of one robot, later of two robots, and so on. PIBT then finds the motions of all other robots.
    """

    is_weighted = False  # PIBT ranks motions by estimates alone, and a weight keeps their order
    is_complete = True  # in the end, constraints prescribe each step of the whole team

    def __init__(self, joint: JointLattice, estimates: Sequence[Table], weight: float, budget: SearchBudget):
        self.joint, self.budget, self.memory_use = joint, budget, MemoryUse(budget)
        self.moves = TeamMoves(joint, estimates)
        self.goal = np.array([lattice.goal for lattice in joint.lattices])
        start = np.array([lattice.start for lattice in joint.lattices])
        self.first_turn: float = _IDLE_STEPS * len(start)
        far = np.nan_to_num(self.moves.estimates(start), posinf=0.0)
        self.rest_priority = far / (1 + far.max())  # at the start and the goal: below 1, largest if the way is long
        self.nodes: dict[bytes, Node] = {}
        self.open: list[Node] = []
        self.goal_node: Node | None = None
        self.least_estimate = float("inf")  # least sum of estimates over the nodes
        self.num_idle = 0  # steps since the least estimate fell
        self._add(start, None)

    @staticmethod
    def num_bytes_needed(joint: JointLattice) -> int:
        return 0

    def run(self, max_idle: int, progress: Progress | None = None) -> Status | None:
        """Search until the goals are reached, or ``max_idle`` steps in a row bring no progress.

        Return why the search ended, or None if another call can continue it.
        """
        self.num_idle = 0
        while self.goal_node is None and self.open and self.num_idle < max_idle:
            if limit := self.budget.exceeded():
                return limit
            node = self.open[-1]
            if not node.constraints:
                self.open.pop()
            else:
                # 1. Take the next constraints, which prescribe the motions of the first robots in the node's order.
                constraints = node.constraints.popleft()
                moves = self.moves(node.state)
                self.num_idle += 1
                self.budget.num_expansions += 1
                self.budget.num_children_scored += sum(map(len, moves.child))
                # 2. Queue the same constraints with each motion of the next robot (breadth-first search).
                if len(constraints) < len(node.order):
                    robot = node.order[len(constraints)]
                    node.constraints.extend((*constraints, (robot, primitive)) for primitive in moves.ranked[robot])
                    self.memory_use.add(_CONSTRAINT_BYTES * len(moves.ranked[robot]))
                # 3. Let PIBT choose the motions of all other robots.
                if (primitives := PIBT(moves).find(node.order, constraints)) is not None:
                    self.budget.num_children_valid += 1
                    self._add(np.array([moves.child[i][primitive] for i, primitive in enumerate(primitives)]), node)
                if progress is not None:
                    progress.update()
        if self.goal_node is not None:
            return Status.SOLVED
        return None if self.open else Status.EXHAUSTED

    @property
    def solution_states(self) -> Int[np.ndarray, "steps robots"]:
        states, node = [], self.goal_node
        while node is not None:
            states.append(node.state)
            node = node.parent
        return np.array(states[::-1])

    @property
    def node_states(self) -> Int[np.ndarray, "nodes robots"]:
        return np.array([node.state for node in self.nodes.values()])

    def _add(self, state: JointNode, parent: Node | None) -> None:
        """Put the node of a joint state on the stack, and create the node if the state is new.

        A new node gets the order in which its robots choose motions.
        """
        key = state.astype(np.int32).tobytes()
        if (node := self.nodes.get(key)) is None:
            arrived: Bool[np.ndarray, " robots"] = state == self.goal
            before = self.rest_priority if parent is None else parent.priority + 1
            priority = np.where(arrived, self.rest_priority, before)
            order = np.argsort(-priority, kind="stable").tolist()
            node = self.nodes[key] = Node(state, parent, priority, order, deque([()]))
            self.budget.num_nodes += 1
            self.memory_use.add(_NODE_BYTES + _ROBOT_BYTES * len(state))
            if arrived.all():
                self.goal_node = node
            if (estimate := float(self.moves.estimates(state).sum())) < (1 - ROUNDING) * self.least_estimate:
                self.least_estimate = estimate
                self.num_idle = 0
        self.open.append(node)
