"""The motions of one kind of robot as edges of a graph, and costs along it."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import csgraph as sparse_graphs
from scipy.sparse import csr_array

from plr_jax.planners.lattice.joint import JointLattice
from plr_jax.planners.lattice.motions import Ends, MotionTable, motions_with_ends
from plr_jax.robots.robot import Robot


@dataclass(frozen=True, eq=False)
class Kind:
    """Robots of a team that share a table of motions, as arrays.

    Args:
        robot: What they are.
        table: Their motions.
        members: Which robots of the team they are.
        ends: Their starts and goals.
    """

    robot: Robot
    table: MotionTable
    members: Int[np.ndarray, "robots"]
    ends: Ends

    def motions(
        self, node: Int[np.ndarray, "robots"]
    ) -> tuple[Int[np.ndarray, "robots primitives"], Float[np.ndarray, "robots primitives"]]:
        """Where the primitives of each robot lead from its node, and what they cost."""
        return motions_with_ends(self.table, self.ends, node)

    @cached_property
    def edges(self) -> "Edges":
        """Their motions as edges."""
        return Edges(self)


class Edges:
    """The motions of a kind of robot, staying among them: those that all share, then those into the ends of each.

    Attributes:
        begin, end, cost: Nodes and costs of each edge. One more, edge ``num_edges``, leads nowhere at infinite cost.
        own: For each robot the edges into its start and its goal.
        stride: Largest distance that one translates, in workspace units.
    """

    def __init__(self, kind: Kind):
        self.kind, self.num_nodes = kind, len(kind.table.q)
        begin, primitive = np.nonzero(np.isfinite(kind.table.cost))
        shared = begin, kind.table.child[begin, primitive], kind.table.cost[begin, primitive]
        self.num_shared = len(begin)
        ends = kind.ends
        own = np.nonzero((ends.begin >= 0) & np.isfinite(ends.cost))
        into_ends = ends.begin[own], ends.node[own[:2]], ends.cost[own]
        self.num_edges = self.num_shared + len(own[0])
        first = np.searchsorted(own[0], np.arange(1, len(kind.members)))
        self.own = np.split(np.arange(self.num_shared, self.num_edges), first)
        nowhere = np.zeros(1, np.intp), np.zeros(1, np.intp), np.full(1, np.inf)
        columns = zip(shared, into_ends, nowhere, strict=True)
        self.begin, self.end, self.cost = (np.concatenate(column) for column in columns)
        away = kind.table.q[self.end[:-1], :2] - kind.table.q[self.begin[:-1], :2]
        self.stride = float(np.hypot(*away.T).max())

    @cached_property
    def _into_nodes(self) -> Int[np.ndarray, "k nodes"]:
        """The shared edges that end in each node, filled up with ``num_edges``."""
        order = np.argsort(self.end[: self.num_shared], kind="stable")
        end = self.end[order]
        rank = np.arange(len(end)) - np.searchsorted(end, end)
        size = max(int(rank.max()) + 1, 1 + max(len(own) for own in self.own))
        into = np.full((size, self.num_nodes), self.num_edges)
        into[rank, end] = order
        return into

    def into_nodes(self, row: int) -> Int[np.ndarray, "k nodes"]:
        """The edges of one robot that end in each node, filled up with ``num_edges``."""
        into, own = self._into_nodes.copy(), self.own[row]
        into[:, self.kind.ends.cell[row]] = self.num_edges
        for node in self.kind.ends.node[row]:
            edges = own[self.end[own] == node]
            into[1 : 1 + len(edges), node] = edges  # after the one that stays
        return into

    @cached_property
    def q(self) -> tuple[Float[np.ndarray, "edges dof"], Float[np.ndarray, "edges dof"]]:
        """Where each edge begins and ends."""
        return self.kind.table.q[self.begin], self.kind.table.q[self.end]

    @cached_property
    def _by_nodes(self) -> tuple[Int[np.ndarray, "m"], Int[np.ndarray, "m"]]:
        """The edges in the order of their nodes, the cheapest of several first, and what they are ordered by."""
        key = self.begin[:-1] * self.num_nodes + self.end[:-1]
        order = np.lexsort((self.cost[:-1], key))
        return order, key[order]

    def along(self, nodes: Int[np.ndarray, "steps"]) -> Int[np.ndarray, "motions"]:
        """The edges along a path."""
        order, key = self._by_nodes
        return order[np.searchsorted(key, nodes[:-1] * self.num_nodes + nodes[1:])]

    @cached_property
    def _cheapest(self) -> Bool[np.ndarray, "edges"]:
        """Whether an edge is one that is shared, leads elsewhere, and has no cheaper one beside it."""
        order, key = self._by_nodes
        cheapest = np.zeros(len(self.begin), dtype=bool)
        cheapest[order[np.append(True, key[1:] != key[:-1])]] = True
        cheapest[self.num_shared :] = False
        return cheapest & (self.begin != self.end)

    def costs_to_go(self, rows: Int[np.ndarray, "n"]) -> Float[np.ndarray, "n nodes"]:
        """Cost of the cheapest motions from each node to the goals of some robots; ``inf`` where there are none.

        That is a lone robot's cost-to-go. It may pass the representative of its start, which it never visits.
        """
        edge, num_nodes = np.flatnonzero(self._cheapest), self.num_nodes
        begin, end, cost = [self.end[edge]], [self.begin[edge]], [self.cost[edge]]
        # Backward, each search begins at a node of its own, from which the edges into the goal lead.
        for i, row in enumerate(rows.tolist()):
            own = self.own[row][self.end[self.own[row]] == self.kind.ends.node[row, 1]]
            begin.append(np.full(len(own), num_nodes + i))
            end.append(self.begin[own])
            cost.append(self.cost[own])
        edges = np.concatenate(cost), (np.concatenate(begin), np.concatenate(end))
        graph = csr_array(edges, shape=(num_nodes + len(rows),) * 2)
        costs = sparse_graphs.dijkstra(graph, indices=num_nodes + np.arange(len(rows)))[:, :num_nodes]
        costs[np.arange(len(rows)), self.kind.ends.node[rows, 1]] = 0.0
        return costs

    def costs_to_come(self, rows: Int[np.ndarray, "n"]) -> Float[np.ndarray, "n nodes"]:
        """Cost of the cheapest motions from the starts of some robots to each node but their goals, likewise."""
        return sparse_graphs.dijkstra(self._graph, indices=self.kind.ends.node[rows, 0])

    @cached_property
    def _graph(self) -> csr_array:
        """The cheapest shared edges."""
        edge = np.flatnonzero(self._cheapest)
        return csr_array((self.cost[edge], (self.begin[edge], self.end[edge])), shape=(self.num_nodes,) * 2)


def kinds_of(joint: JointLattice) -> list[Kind]:
    """The robots of a team by the tables that they share, in the order of their first ones."""
    members: dict[int, list[int]] = {}
    for i, lattice in enumerate(joint.lattices):
        members.setdefault(id(lattice.table), []).append(i)
    kinds = []
    for alike in members.values():
        ends = Ends(*map(np.stack, zip(*(joint.lattices[i].ends for i in alike), strict=True)))
        robot, table = joint.problem.robots[alike[0]], joint.lattices[alike[0]].table
        kinds.append(Kind(robot, table, np.array(alike), ends))
    return kinds


def by_robot(kinds: Sequence[Kind], values: Sequence[Float[np.ndarray, "_ _"]]) -> list[Float[np.ndarray, "_"]]:
    """What is known of each kind's robots, as rows in the order of the team."""
    rows = {
        robot: row
        for kind, of_kind in zip(kinds, values, strict=True)
        for robot, row in zip(kind.members.tolist(), of_kind, strict=True)
    }
    return [rows[i] for i in range(len(rows))]
