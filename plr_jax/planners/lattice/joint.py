"""The lattices of a team: the motions of each kind of robot as edges, joint motions, and which of them collide."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from scipy.sparse import csgraph as sparse_graphs
from scipy.sparse import csr_array

from plr_jax._arrays import runs
from plr_jax._problem import Problem
from plr_jax.collision.team import JointMotionTest
from plr_jax.robots.robot import Robot

# Motions between configurations as tables: those that robots of one kind share, and each robot's view of them.


@dataclass(frozen=True, eq=False)
class MotionTable:
    """Configurations of one kind of robot, and the motions between them.

    The first primitive stays. One that leaves the lattice or hits an obstacle leads back to its own configuration at
    infinite cost. The representatives of the cells come first, ``num_cells`` of them, then starts and goals, to which
    no primitive leads. From the center of a cell whose side is ``side``, a primitive leads ``offset`` away.
    """

    q: Float[np.ndarray, "nodes dof"]
    child: Int[np.ndarray, "nodes primitives"]
    cost: Float[np.ndarray, "nodes primitives"]
    num_cells: int
    side: Float[np.ndarray, "dof"]
    offset: Float[np.ndarray, "primitives dof"]

    @cached_property
    def stride(self) -> float:
        """Largest distance that a motion translates, in workspace units."""
        return _longest(self.q[:, None], self.q[self.child])


def _longest(begin: Float[np.ndarray, "*#n dof"], end: Float[np.ndarray, "*#n dof"]) -> float:
    """Largest distance between positions, 0 if there is none."""
    return float(np.hypot(end[..., 0] - begin[..., 0], end[..., 1] - begin[..., 1]).max(initial=0.0))


class Ends(NamedTuple):
    """The start and the goal of a robot, or of each of several, which stand for their cells.

    Args:
        node: Their nodes.
        cell: The nodes of their cells' representatives, which the robot never visits.
        begin: Where the motions to them by each primitive begin, -1 where none does: first the motions from
            representatives, then those from the robot's other end. No motion leads to both.
        cost: What these motions cost, ``inf`` where they are not free.
    """

    node: Int[np.ndarray, "*robots 2"]
    cell: Int[np.ndarray, "*robots 2"]
    begin: Int[np.ndarray, "*robots 2 2 primitives"]
    cost: Float[np.ndarray, "*robots 2 2 primitives"]


OfKinds: TypeAlias = Sequence[Float[np.ndarray, "_ _"]]  # of each kind, a row of numbers a robot
Leads: TypeAlias = tuple[Int[np.ndarray, "n primitives"], Float[np.ndarray, "n primitives"]]


def motions_with_ends(table: MotionTable, ends: Ends, node: Int[np.ndarray, "n"]) -> Leads:
    """Where the primitives of nodes lead one robot, or each its own of several, and what they cost.

    Motions to a start or a goal take the place of those to its cell.
    """
    child, cost = table.child[node], table.cost[node]
    enters = ends.begin == node[:, None, None, None]
    row, *_, primitive = np.nonzero(enters)
    entry = np.broadcast_to(ends.cost, enters.shape)[enters]
    end = np.broadcast_to(ends.node[..., None, None], enters.shape)[enters]
    child[row, primitive] = np.where(np.isfinite(entry), end, node[row])
    cost[row, primitive] = entry
    return child, cost


class Lattice:
    """One robot's configurations and motions: those of its kind, its start and its goal in place of their cells.

    Attributes:
        q: The configurations.
        start, goal: The nodes of its ends.
        num_primitives: Primitives, staying among them.
    """

    def __init__(self, table: MotionTable, ends: Ends):
        self.table, self.ends, self.q, self.num_primitives = table, ends, table.q, table.child.shape[1]
        self.start, self.goal = (int(node) for node in ends.node)

    @property
    def child(self) -> Int[np.ndarray, "nodes primitives"]:
        """Where the primitives of all nodes lead."""
        return self._motions[0]

    @property
    def cost(self) -> Float[np.ndarray, "nodes primitives"]:
        """What the primitives of all nodes cost."""
        return self._motions[1]

    @cached_property
    def _motions(self) -> Leads:
        return motions_with_ends(self.table, self.ends, np.arange(len(self.q)))

    @cached_property
    def stride(self) -> float:
        """Largest distance that a primitive translates, in workspace units; those to the ends' own cells count."""
        leads = (self.ends.begin >= 0) & np.isfinite(self.ends.cost)
        end = np.broadcast_to(self.ends.node[:, None, None], leads.shape)[leads]
        return max(self.table.stride, _longest(self.q[self.ends.begin[leads]], self.q[end]))


State: TypeAlias = Int[np.ndarray, "n robots"]  # joint configurations, as indices into the robots' lattices


class JointLattice(NamedTuple):
    """The robots of a problem, each on its lattice, and the team's motion test."""

    problem: Problem
    lattices: tuple[Lattice, ...]
    test: JointMotionTest

    def configurations(self, state: State) -> Float[np.ndarray, "n robots dof"]:
        """Joint configurations; round robots in a team with others keep the heading of their start."""
        q = np.repeat(self.problem.starts[None], len(state), axis=0)
        for i, lattice in enumerate(self.lattices):
            q[:, i, : lattice.q.shape[1]] = lattice.q[state[:, i]]
        return q

    def move(self, state: State, primitive: UInt8[np.ndarray, "n robots"]) -> State:
        """Where joint primitives lead."""
        columns = [lattice.child[s, p] for lattice, s, p in zip(self.lattices, state.T, primitive.T, strict=True)]
        return np.stack(columns, axis=1)

    def move_costs(self, state: State, primitive: UInt8[np.ndarray, "n robots"]) -> Float[np.ndarray, "n"]:
        """What joint primitives cost."""
        columns = [lattice.cost[s, p] for lattice, s, p in zip(self.lattices, state.T, primitive.T, strict=True)]
        return np.sum(columns, axis=0)

    def collisions(
        self, i: int, j: int, state: State
    ) -> tuple[Int[np.ndarray, "m"], Bool[np.ndarray, "m primitives_i primitives_j"]]:
        """Rows in which two robots are near enough to meet, and there, which of their primitives collide."""
        a, b = self.lattices[i], self.lattices[j]
        robot_a, robot_b = self.problem.robots[i], self.problem.robots[j]
        qa, qb = a.q[state[:, i]], b.q[state[:, j]]
        reach = robot_a.circumscribed_radius + robot_b.circumscribed_radius + a.stride + b.stride
        x, y = qa[:, 0] - qb[:, 0], qa[:, 1] - qb[:, 1]
        near = np.flatnonzero(x * x + y * y < reach * reach)
        motions_a = qa[near, None, None], a.q[a.child[state[near, i]]][:, :, None]
        motions_b = qb[near, None, None], b.q[b.child[state[near, j]]][:, None, :]
        return near, ~self.test.apart(i, *motions_a, j, *motions_b)


# The motions of one kind of robot as edges of a graph, and costs along it.


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

    def motions(self, node: Int[np.ndarray, "n"]) -> Leads:
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
        leads, ends = np.nonzero(np.isfinite(kind.table.cost)), kind.ends
        shared = leads[0], kind.table.child[leads], kind.table.cost[leads]
        own = np.nonzero((ends.begin >= 0) & np.isfinite(ends.cost))
        into_ends = ends.begin[own], ends.node[own[:2]], ends.cost[own]
        nowhere = np.zeros(1, np.intp), np.zeros(1, np.intp), np.full(1, np.inf)
        self.begin, self.end, self.cost = map(np.concatenate, zip(shared, into_ends, nowhere, strict=True))
        self.num_shared, self.num_edges = len(leads[0]), len(self.begin) - 1
        first = np.searchsorted(own[0], np.arange(1, len(kind.members)))
        self.own = np.split(np.arange(self.num_shared, self.num_edges), first)
        away = kind.table.q[self.end[:-1], :2] - kind.table.q[self.begin[:-1], :2]
        self.stride = float(np.hypot(*away.T).max())

    @cached_property
    def _into_nodes(self) -> Int[np.ndarray, "k nodes"]:
        """The shared edges that end in each node, filled up with ``num_edges``."""
        order = np.argsort(self.end[: self.num_shared], kind="stable")
        end, rank = runs(np.bincount(self.end[: self.num_shared]))
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
    def _cheapest(self) -> Int[np.ndarray, "m"]:
        """The shared edges that lead elsewhere and have no cheaper one beside them."""
        order, key = self._by_nodes
        edge = np.sort(order[np.append(True, key[1:] != key[:-1])])
        return edge[(edge < self.num_shared) & (self.begin[edge] != self.end[edge])]

    def costs_to_go(self, rows: Int[np.ndarray, "n"]) -> Float[np.ndarray, "n nodes"]:
        """Cost of the cheapest motions from each node to the goals of some robots; ``inf`` where there are none.

        That is a lone robot's cost-to-go. It may pass the representative of its start, which it never visits.
        """
        # Backward, each search begins at a node of its own, from which the edges into the goal lead.
        goals, searches, shared = self.kind.ends.node[rows, 1], np.arange(len(rows)), self._cheapest
        search = np.repeat(searches, [len(self.own[row]) for row in rows])
        own = np.concatenate([self.own[row] for row in rows])
        into_goal = self.end[own] == goals[search]
        edge = np.append(shared, own[into_goal])
        begin = np.append(self.end[shared], self.num_nodes + search[into_goal])
        graph = csr_array((self.cost[edge], (begin, self.begin[edge])), shape=(self.num_nodes + len(rows),) * 2)
        costs = sparse_graphs.dijkstra(graph, indices=self.num_nodes + searches)[:, : self.num_nodes]
        costs[searches, goals] = 0.0
        return costs

    def costs_to_come(self, rows: Int[np.ndarray, "n"]) -> Float[np.ndarray, "n nodes"]:
        """Cost of the cheapest motions from the starts of some robots to each node but their goals, likewise."""
        return sparse_graphs.dijkstra(self._graph, indices=self.kind.ends.node[rows, 0])

    @cached_property
    def _graph(self) -> csr_array:
        """The cheapest shared edges."""
        edge = self._cheapest
        return csr_array((self.cost[edge], (self.begin[edge], self.end[edge])), shape=(self.num_nodes,) * 2)


def kinds_of(joint: JointLattice) -> list[Kind]:
    """The robots of a team by the tables that they share, in the order of their first ones."""
    kinds = []
    for table in {id(lattice.table): lattice.table for lattice in joint.lattices}.values():
        alike = [i for i, lattice in enumerate(joint.lattices) if lattice.table is table]
        ends = Ends(*map(np.stack, zip(*(joint.lattices[i].ends for i in alike), strict=True)))
        kinds.append(Kind(joint.problem.robots[alike[0]], table, np.array(alike), ends))
    return kinds


def by_robot(kinds: Sequence[Kind], values: OfKinds) -> list[Float[np.ndarray, "_"]]:
    """What is known of each kind's robots, as rows in the order of the team."""
    order = np.argsort(np.concatenate([kind.members for kind in kinds]))
    rows = [row for of_kind in values for row in of_kind]
    return [rows[i] for i in order]
