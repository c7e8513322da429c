"""A table of the lattice motions (edges) that a team's paths block at each step, and replanning of robots with it.

References: Silver, "Cooperative pathfinding", 2005. Li et al., "Anytime multi-agent path finding via large
neighborhood search", 2021.
"""

from collections import defaultdict

import numpy as np
from jaxtyping import Int
from scipy.spatial import KDTree

from plr_jax._arrays import require_time, take_ragged
from plr_jax._problem import ROUNDING
from plr_jax.collision.motions import motions_apart
from plr_jax.planners._solution import MemoryUse, SearchBudget
from plr_jax.planners.lattice import JointLattice, State

# Tests of colliding edges; what is tested at a time fits into the processor's cache:
_CHUNK = 256  # most edges at a time
_PAIRS = 1 << 13  # pairs of edges at a time, about
# Memory:
_ENTRY_BYTES = 200  # bytes of an edge whose colliding edges are cached, without the colliding edges
_EDGE_BYTES = 2  # bytes of an edge, per step
_NODE_BYTES = 8  # bytes of a node while a robot is replanned, per step
# Replanning:
_GAIN = 1e-2  # rounds of replanning stop if one saves a smaller share of the cost
_NEIGHBORHOOD = 5  # robots in a neighborhood
Edges = Int[np.ndarray, " _"]


class ReservationTable:
    """The path of each robot on its lattice, and how many robots block each edge (lattice motion) at each step.

    A robot blocks an edge in a step if its own motion in this step collides with the edge; :meth:`reserve` counts it.
    ``state[t, i]`` is the lattice node of robot ``i`` after ``t`` steps.
    """

    def __init__(self, joint: JointLattice, state: State, budget: SearchBudget):
        self.joint, self.kinds, self.state, self.budget = joint, joint.kinds, state.copy(), budget
        self.memory_use = MemoryUse(budget)
        self.memory_use.add(num_bytes_of_table(joint, len(state)))
        self._costs_to_come: dict[int, np.ndarray] = {}
        self._colliding_edges: defaultdict[tuple[int, int], dict[int, Edges]] = defaultdict(dict)  # by pair of kinds
        self._chunk = defaultdict(lambda: 1)  # by pair of kinds: edges tested at a time, adapted to their neighbors
        self.kind = [self.kinds.index(lattice.kind) for lattice in joint.lattices]  # of each robot, as an index
        # Counts of robots by step and edge, for each kind. -1 is added to undo reservations, so the type is signed;
        # it has room for twice as many robots.
        count_type = np.min_scalar_type(-2 * state.shape[1])
        self.blocked = [np.zeros((len(state) - 1, kind.num_edges + 1), count_type) for kind in self.kinds]
        # For each kind, a tree of the node positions, the edges sorted by begin node, and the index of each node's
        # first edge among them.
        self._near: list[tuple[KDTree, Edges, Edges]] = []
        for kind in self.kinds:
            begin = kind.begin[: kind.num_edges]
            order = np.argsort(begin, kind="stable")
            first = np.searchsorted(begin[order], np.arange(len(kind.q) + 1))
            self._near.append((KDTree(kind.q[:, :2]), order, first))
        self.cost, self.least_costs = np.zeros(state.shape[1]), joint.least_costs  # of robots in the team, and alone
        for i, kind in enumerate(lattice.kind for lattice in joint.lattices):
            self.cost[i] = kind.edge_cost[kind.edges_along(self.state[:, i])].sum()

    def reserve(self, robots: list[int], change: int = 1) -> None:
        """Count that the robots with these indices block, in each step, all edges that collide with their motions.

        An edge is a lattice motion that a robot might make.

        ``change=-1`` undoes this. ``TimeoutError`` or ``MemoryError`` if time or memory runs out.
        """
        for i in robots:
            a = self.kind[i]
            motions = self.kinds[a].edges_along(self.state[:, i])
            for b, blocked in enumerate(self.blocked):
                colliding = self.collisions(a, motions, b)
                step = np.repeat(np.arange(len(motions)), [len(edges) for edges in colliding])
                blocked[step, np.concatenate(colliding)] += change  # correct, as no pair of indices occurs twice

    def collisions(self, a: int, edges: Edges, b: int) -> list[Edges]:
        """Return, for each edge of kind ``a`` in ``edges``, all edges of kind ``b`` that collide with it.

        Kinds are groups of robots of equal shape and rotation weight; ``a`` and ``b`` are indices in ``kinds``. Edges
        are given and returned as indices among the edges of their kind. ``TimeoutError`` or ``MemoryError`` if time
        or memory runs out.
        """
        ours, others = self.kinds[a], self.kinds[b]
        tree, order, first = self._near[b]
        colliding = self._colliding_edges[a, b]  # answers are cached
        missing = np.array(sorted({*edges.tolist()} - colliding.keys()), dtype=np.intp)
        while len(missing):
            require_time(self.budget.deadline, "all collisions were found")
            if not self.budget.has_memory():
                raise MemoryError("The memory limit was reached before all collisions were found.")
            part, missing = np.split(missing, [self._chunk[a, b]])
            # 1. Find edges that may collide. No motion takes a body farther than `reach` from the motion's begin.
            begin, end = ours.q[ours.begin[part]], ours.q[ours.end[part]]
            near = tree.query_ball_point(begin[:, :2], ours.reach + others.reach)
            row_of_node = np.repeat(np.arange(len(part)), [len(nodes) for nodes in near])
            index, place = take_ragged(first, np.concatenate(near).astype(int))
            row, edge = row_of_node[place], order[index]  # part[row] may collide with `edge`
            # Next time, take as many edges as give about `_PAIRS` pairs, judged by this part.
            self._chunk[a, b] = int(np.clip(_PAIRS * len(part) // max(1, len(row)), 1, _CHUNK))
            # 2. Test these pairs, and cache the colliding edges of each edge.
            motions = others.q[others.begin[edge]], others.q[others.end[edge]]
            pairs = ours.robot, begin[row], end[row], others.robot, *motions
            apart = motions_apart(*pairs, self.joint.problem.workspace.tolerance, self.budget.deadline)
            row, edge = row[~apart], edge[~apart].astype(np.int32)
            groups = [group.copy() for group in np.split(edge, np.searchsorted(row, np.arange(1, len(part))))]
            colliding.update(zip(part.tolist(), groups, strict=True))
            self.memory_use.add(sum(_ENTRY_BYTES + group.nbytes for group in groups))
        return [colliding[edge] for edge in edges.tolist()]

    def replan(self, i: int, max_cost: float) -> bool:
        """Move robot ``i`` to its cheapest free path that costs at most ``max_cost``; return whether there is one.

        The caller must have undone the robot's reservations. The result is also False if time or memory runs out.
        """
        lattice, blocked = self.joint.lattices[i], self.blocked[self.kind[i]]
        kind, row, start, goal = lattice.kind, lattice.row, lattice.start, lattice.goal
        # 1. Leave out nodes through which every path costs more than `max_cost`, even without other robots.
        if i not in self._costs_to_come:
            self._costs_to_come[i] = kind.costs_to_come(row)
            self.memory_use.add(self._costs_to_come[i].nbytes)
        least = self._costs_to_come[i] + self.joint.costs_to_go[i]
        least[[start, goal]] = 0.0  # always keep both
        nodes = np.flatnonzero(least <= max_cost * (1 + ROUNDING))
        index = np.full(len(least), len(nodes))  # of each node among `nodes`; `len(nodes)` for nodes left out
        index[nodes] = np.arange(len(nodes))
        # 2. Dynamic programming: reached[step, n] is the least cost to be at nodes[n] after so many steps. The last
        #    column stands for all nodes left out, at infinite cost. Columns of `into`: the edges into each node,
        #    filled up by the dummy edge, whose cost is infinite.
        into = kind.edges_into_nodes(row)[:, nodes]
        begin, cost = index[kind.begin[into]], kind.edge_cost[into]
        reached = np.full((len(self.state), len(nodes) + 1), np.inf)
        reached[0, index[start]] = 0.0
        for step in range(len(blocked)):
            arriving = np.where(blocked[step][into], np.inf, reached[step][begin] + cost)
            arriving.min(axis=0, out=reached[step + 1, :-1])
            if self.budget.spent():
                return False
        n = index[goal]
        if not reached[-1, n] <= max_cost * (1 + ROUNDING):
            return False
        # 3. Go back from the goal along the edges of least cost.
        self.cost[i] = reached[-1, n]
        self.state[-1, i] = goal
        for step in range(len(blocked) - 1, -1, -1):
            arriving = np.where(blocked[step][into[:, n]], np.inf, reached[step][begin[:, n]] + cost[:, n])
            n = begin[arriving.argmin(), n]
            self.state[step, i] = nodes[n]
        return True


def num_bytes_of_table(joint: JointLattice, num_rows: int) -> int:
    num_edges, num_nodes = sum(kind.num_edges for kind in joint.kinds), max(len(kind.q) for kind in joint.kinds)
    return num_rows * (num_edges * _EDGE_BYTES + num_nodes * _NODE_BYTES)


def replan_each(table: ReservationTable) -> None:
    """Replan, one by one, the robots whose paths cost more than they would without other robots.

    The robot with the largest extra cost comes first. Such rounds over all robots repeat until a round saves little,
    or time or memory runs out.
    """
    while True:
        before = table.cost.sum()
        for i in np.argsort(table.least_costs - table.cost).tolist():
            if table.budget.spent():
                return
            if table.cost[i] > table.least_costs[i] * (1 + ROUNDING):
                table.reserve([i], -1)
                table.replan(i, float(table.cost[i]))
                table.reserve([i])
        if before - table.cost.sum() <= _GAIN * before:
            return


def replan_together(table: ReservationTable, robots: list[int]) -> bool:
    """Replan the robots with the indices ``robots`` one after the other; return whether their total cost fell.

    If their total cost would rise, or a robot finds no path, all keep their old paths. New paths of equal total cost
    replace the old paths, although the result is then False.
    """
    state, cost = table.state[:, robots].copy(), table.cost[robots].copy()
    table.reserve(robots, -1)
    reserved = []
    try:
        for index, i in enumerate(robots):
            spent, needed = table.cost[robots[:index]].sum(), table.least_costs[robots[index + 1 :]].sum()
            if not table.replan(i, cost.sum() - spent - needed):
                return False
            table.reserve([i])
            reserved.append(i)
        return bool(table.cost[robots].sum() < (1 - ROUNDING) * cost.sum())
    finally:
        # Unless all robots found paths, restore the old ones. Also after an error of `reserve`, since the caller uses
        # `table.state`, which must be free of collisions. (Edges that collide with old paths are cached, so reserving
        # these takes no tests.)
        if len(reserved) < len(robots):
            table.reserve(reserved, -1)
            table.state[:, robots], table.cost[robots] = state, cost
            table.reserve(robots)


def replan_neighborhoods(table: ReservationTable, count: int, rng: np.random.Generator) -> None:
    """Replan ``count`` groups: a random robot with a detour, and the four robots that come nearest to it.

    A robot has a detour if its path costs more than it would without other robots. The probability that a robot is
    chosen is proportional to this extra cost. Distances to other robots are multiplied by random factors from 1 to 2,
    so that groups vary. Stop early if no robot has a detour, or time or memory runs out.
    """
    for _ in range(count):
        loss = np.maximum(table.cost - table.least_costs, 0.0)
        if table.budget.spent() or loss.sum() <= ROUNDING * table.least_costs.sum():
            return
        i = int(rng.choice(len(loss), p=loss / loss.sum()))
        places = [lattice.q[nodes, :2] for lattice, nodes in zip(table.joint.lattices, table.state.T, strict=True)]
        # The least distances from robot i at equal steps.
        gap = np.array([np.hypot(*(place - places[i]).T).min() for place in places]) * rng.uniform(1, 2, len(loss))
        replan_together(table, rng.permutation(np.argsort(gap, kind="stable")[:_NEIGHBORHOOD]).tolist())
