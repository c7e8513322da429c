"""Robots planned anew among the others: each in turn, then neighborhoods of robots together.

References:
    Li et al., "Anytime multi-agent path finding via large neighborhood search", 2021.
"""

from collections.abc import Iterator, Sequence
from functools import cached_property
from itertools import product
from typing import TypeAlias

import numpy as np
from jaxtyping import Float, Int, Shaped
from scipy.spatial import KDTree

from plr_jax._arrays import run_members
from plr_jax.collision.team import motions_apart
from plr_jax.planners._options import HeldMemory, SearchBudget
from plr_jax.planners.lattice.joint import Kind, OfKinds, State

# Which edges of one kind of robot collide with those of another, found when first asked for, and kept.


_CHUNK, _PAIRS = 256, 1 << 13  # edges, and pairs of them, at a time: they stay in cache, and the clock is seen
_ENTRY_BYTES = 200  # what an edge takes, besides those that collide with it


EdgeList: TypeAlias = Int[np.ndarray, "_"]


class Conflicts:
    """Collisions of simultaneous motions along the edges of a team's lattices; ``held`` counts what it keeps."""

    def __init__(self, kinds: Sequence[Kind], tolerance: float, held: HeldMemory):
        self.kinds, self.tolerance, self.held = kinds, tolerance, held
        pairs = list(product(range(len(kinds)), range(len(kinds))))
        self._known: dict[tuple[int, int], dict[int, EdgeList]] = {pair: {} for pair in pairs}
        self._chunk = dict.fromkeys(pairs, 1)

    def of(self, a: int, edges: EdgeList, b: int) -> list[EdgeList]:
        """For each of some edges of kind ``a``, the edges of kind ``b`` that collide with it.

        Raises:
            TimeoutError: If time or memory is spent before all are found. What was found is kept.
        """
        known, wanted = self._known[a, b], edges.tolist()
        missing = np.array(sorted({edge for edge in wanted if edge not in known}), dtype=np.intp)
        while len(missing):
            if self.held.budget.spent():
                raise TimeoutError("Time or memory was spent before all collisions were found.")
            part, missing = np.split(missing, [self._chunk[a, b]])
            found = self._find(a, part, b)
            known.update(zip(part.tolist(), found, strict=True))
            self.held.add(sum(_ENTRY_BYTES + edges.nbytes for edges in found))
        return [known[edge] for edge in wanted]

    def _find(self, a: int, motion: EdgeList, b: int) -> list[EdgeList]:
        ours, others = self.kinds[a], self.kinds[b]
        begin, end = (q[motion] for q in ours.edges.q)
        reach = sum(kind.robot.circumscribed_radius + kind.edges.stride for kind in (ours, others))
        tree, order, first = self._near[b]
        near = tree.query_ball_point(begin[:, :2], reach)
        row = np.repeat(np.arange(len(motion)), [len(nodes) for nodes in near])
        node = np.concatenate(near).astype(int)
        index, at = run_members(first, node)
        row, edge = row[at], order[index]
        self._chunk[a, b] = int(np.clip(_PAIRS * len(motion) // max(1, len(row)), 1, _CHUNK))
        others_begin, others_end = (q[edge] for q in others.edges.q)
        motions = ours.robot, begin[row], end[row], others.robot, others_begin, others_end
        apart = motions_apart(*motions, self.tolerance, self.held.budget.deadline)
        row, edge = row[~apart], edge[~apart].astype(np.int32)
        return [part.copy() for part in np.split(edge, np.searchsorted(row, np.arange(1, len(motion))))]

    @cached_property
    def _near(self) -> list[tuple[KDTree, Int[np.ndarray, "edges"], Int[np.ndarray, "nodes_and_1"]]]:
        """Of each kind the places of its nodes, and its edges by the node where they begin."""
        found = []
        for kind in self.kinds:
            begin = kind.edges.begin[: kind.edges.num_edges]
            order = np.argsort(begin, kind="stable")
            first = np.searchsorted(begin[order], np.arange(len(kind.table.q) + 1))
            found.append((KDTree(kind.table.q[:, :2]), order, first))
        return found


# A table of reservations: when the paths of a team block which edges, and a robot's cheapest path in between.


_ROUNDING = 1e-9
_EDGE_BYTES, _NODE_BYTES = 2, 8  # what an edge takes, and a node while a robot is replanned, a step


class ReservationTable:
    """Who is where at each step, and which edges that blocks for others.

    Robots wait at no cost. So there are more steps than a path needs, which gives them time to wait.

    Attributes:
        state: The nodes of each robot, ``(steps + 1, robots)``.
        cost: What the paths of the robots cost.
        least: What they would cost if each were alone.
        held: Memory that it holds.

    Raises:
        TimeoutError: If time or memory is spent before all paths are reserved.

    References:
        Silver, "Cooperative pathfinding", 2005.
    """

    def __init__(
        self, kinds: Sequence[Kind], costs_to_go: OfKinds, state: State, tolerance: float, budget: SearchBudget
    ):
        self.kinds, self.costs_to_go, self.state, self.budget = kinds, costs_to_go, state.copy(), budget
        self.held = HeldMemory(budget)
        self.held.add(num_bytes_of_table(kinds, len(state)))
        self._costs_to_come: dict[int, Float[np.ndarray, _]] = {}
        self.conflicts = Conflicts(kinds, tolerance, self.held)
        self.place = {int(i): (k, row) for k, kind in enumerate(kinds) for row, i in enumerate(kind.members)}
        size, dtype = len(state) - 1, np.min_scalar_type(state.shape[1])
        self.blocked = [np.zeros((size, kind.edges.num_edges + 1), dtype) for kind in kinds]
        self.cost, self.least = np.zeros(state.shape[1]), np.zeros(state.shape[1])
        for i, (k, row) in self.place.items():
            self.least[i] = costs_to_go[k][row, kinds[k].ends.node[row, 0]]
            self.cost[i] = kinds[k].edges.cost[self._motions(i)].sum()
        try:
            for i in self.place:
                self.reserve(i)
        except TimeoutError:
            self.held.release()
            raise

    def gaps(self, i: int) -> Float[np.ndarray, "robots"]:
        """The least distance of each robot's position from that of one of them over time, 0 for itself."""
        positions = [self.kinds[self.place[j][0]].table.q[self.state[:, j], :2] for j in range(len(self.cost))]
        return np.array([np.hypot(*(position - positions[i]).T).min() for position in positions])

    def reserve(self, i: int) -> None:
        """Block what collides with the path of a robot; ``TimeoutError`` if time or memory is spent before."""
        for blocked, where in self._collisions(i):
            blocked[where] += 1

    def release(self, i: int) -> None:
        """Free what collides with the path of a robot, before that is planned anew."""
        for blocked, where in self._collisions(i):
            blocked[where] -= 1

    def replan(self, i: int, most: float) -> bool:
        """Give a robot whose path is released its cheapest one among the others; whether that costs at most ``most``.

        If it does not, or time is up, the robot keeps its path.
        """
        k, row = self.place[i]
        edges, blocked = self.kinds[k].edges, self.blocked[k]
        start, goal = self.kinds[k].ends.node[row].tolist()
        if i not in self._costs_to_come:
            self._costs_to_come[i] = self.kinds[k].edges.costs_to_come(np.array([row]))[0]
            self.held.add(self._costs_to_come[i].nbytes)
        least = self._costs_to_come[i] + self.costs_to_go[k][row]
        least[[start, goal]] = 0.0
        nodes = np.flatnonzero(least <= most * (1 + _ROUNDING))
        index = np.full(len(least), len(nodes))
        index[nodes] = np.arange(len(nodes))
        into = edges.into_nodes(row)[:, nodes]
        begin, cost = index[edges.begin[into]], edges.cost[into]
        # Cost-to-come by step and node; the last column stands for all nodes that lead nowhere cheap.
        reached = np.full((len(self.state), len(nodes) + 1), np.inf)
        reached[0, index[start]] = 0.0
        for step in range(len(blocked)):
            arriving = np.where(blocked[step][into], np.inf, reached[step][begin] + cost)
            arriving.min(axis=0, out=reached[step + 1, :-1])
            if self.budget.spent():
                return False
        at = index[goal]
        if not reached[-1, at] <= most * (1 + _ROUNDING):
            return False
        self.cost[i], self.state[-1, i] = reached[-1, at], goal
        for step in range(len(blocked) - 1, -1, -1):
            arriving = np.where(blocked[step][into[:, at]], np.inf, reached[step][begin[:, at]] + cost[:, at])
            at = begin[arriving.argmin(), at]
            self.state[step, i] = nodes[at]
        return True

    def _collisions(self, i: int) -> Iterator[tuple[Shaped[np.ndarray, "steps edges"], tuple[EdgeList, EdgeList]]]:
        """What is blocked for each kind, and where the path of a robot blocks it: nowhere twice."""
        motions = self._motions(i)
        for b, blocked in enumerate(self.blocked):
            colliding = self.conflicts.of(self.place[i][0], motions, b)
            step = np.repeat(np.arange(len(motions)), [len(edges) for edges in colliding])
            yield blocked, (step, np.concatenate(colliding))

    def _motions(self, i: int) -> Int[np.ndarray, "steps"]:
        """The edges of a robot's path."""
        return self.kinds[self.place[i][0]].edges.along(self.state[:, i])


def num_bytes_of_table(kinds: Sequence[Kind], num_rows: int) -> int:
    """About what a table of reservations takes, without the conflicts."""
    num_edges = sum(kind.edges.num_edges for kind in kinds)
    num_nodes = max(len(kind.table.q) for kind in kinds)
    return num_rows * (num_edges * _EDGE_BYTES + num_nodes * _NODE_BYTES)


_GAIN = 1e-2  # share of the cost below which another round is not worth its time
_NEIGHBORHOOD = 5  # robots


def replan_each(table: ReservationTable) -> None:
    """Replan each robot in turn, those first that lose most, until that gains little."""
    while True:
        before = table.cost.sum()
        for i in np.argsort(table.least - table.cost).tolist():
            if table.budget.spent():
                return
            if table.cost[i] > table.least[i] * (1 + _ROUNDING):
                table.release(i)
                table.replan(i, float(table.cost[i]))
                table.reserve(i)
        if before - table.cost.sum() <= _GAIN * before:
            return


def replan_together(table: ReservationTable, robots: Sequence[int]) -> bool:
    """Replan robots one after the other, as if those to come were not there; whether that costs less.

    If it costs more, all keep their paths. Paths that cost the same are taken over.
    """
    robots = list(robots)
    state, cost = table.state[:, robots].copy(), table.cost[robots].copy()
    for i in robots:
        table.release(i)
    reserved = []
    try:
        for done, i in enumerate(robots):
            spent, needed = table.cost[robots[:done]].sum(), table.least[robots[done + 1 :]].sum()
            if not table.replan(i, cost.sum() - spent - needed):
                return False
            table.reserve(i)
            reserved.append(i)
        return bool(table.cost[robots].sum() < (1 - _ROUNDING) * cost.sum())
    finally:
        if len(reserved) < len(robots):
            for i in reserved:
                table.release(i)
            table.state[:, robots], table.cost[robots] = state, cost
            for i in robots:
                table.reserve(i)


def replan_neighborhoods(table: ReservationTable, count: int, rng: np.random.Generator) -> None:
    """Replan so many neighborhoods: a robot that loses, chosen at random, and those that come nearest to it."""
    for _ in range(count):
        loss = np.maximum(table.cost - table.least, 0.0)
        if table.budget.spent() or loss.sum() <= _ROUNDING * table.least.sum():
            return
        i = int(rng.choice(len(loss), p=loss / loss.sum()))
        gap = table.gaps(i) * rng.uniform(1, 2, len(loss))
        neighborhood = np.argsort(gap, kind="stable")[:_NEIGHBORHOOD]
        replan_together(table, rng.permutation(neighborhood).tolist())
