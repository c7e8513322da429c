"""Lattices: the configurations that robots visit in a search, and the motions between them.

A lattice divides a robot's configuration space into a grid of cells, periodic in the heading. A cell is represented
by a free configuration (a node): the cell's center if it is free, else the free sample with the largest clearance. A
primitive is a motion between the nodes of two neighboring cells.

Each robot's start and goal are additional nodes, so that its paths begin and end exactly there. For this robot, they
replace the nodes of their cells. If start and goal lie in one cell, motions into the cell lead to the goal, and an
additional primitive connects start and goal.
"""

import math
from collections import defaultdict
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import product
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from scipy.sparse import csgraph as sparse_graphs
from scipy.sparse import csr_array

from plr_jax._arrays import ragged_indices, require_time
from plr_jax._problem import Problem, straight_costs
from plr_jax.collision.motions import JointMotionTest
from plr_jax.collision.walls import IgnoredByCache, MotionTest, motion_test
from plr_jax.geometry.workspace import Workspace
from plr_jax.robots.robot import Robot

# Primitives besides staying, as offsets (columns, rows, turns) in cells. Robots without a heading do not turn.
_NEIGHBORS = [(dx, dy, 0) for dx, dy in product((-1, 0, 1), repeat=2) if dx or dy]
PRIMITIVES = (*_NEIGHBORS, (0, 0, 1), (0, 0, -1))
# One call of Dijkstra's algorithm, which SciPy does not interrupt at the deadline:
_GOALS = 8  # most goals
_NODES = 1 << 19  # most nodes times goals
_SECONDS = 3e-7  # estimated time, in seconds per node
# Building of a lattice:
_SAMPLES = 7  # samples per axis in a cell whose center is blocked
_WIDEST_TURN = np.pi / 4  # widest cell along the heading, in radians
_ROUNDING = 1e-9  # share of a cell by which a width may exceed whole cells
_MOST_KEPT = 1 << 18  # motions of a kind of robot up to which they are cached
_CHUNK = 1 << 12  # cells at a time, between two checks of the clock
Ends: TypeAlias = Float[np.ndarray, " n #primitives dof"]  # ends of motions
Neighbors: TypeAlias = tuple[Int[np.ndarray, "n primitives"], Bool[np.ndarray, "n primitives"]]
Configurations: TypeAlias = Float[np.ndarray, "n dof"]
State: TypeAlias = Int[np.ndarray, "_ robots"]  # joint states: for each robot, a node of its lattice
Primitives: TypeAlias = tuple[Int[np.ndarray, "n primitives"], Float[np.ndarray, "n primitives"]]  # end node and cost


class Terminals(NamedTuple):
    """Start and goal (the *terminals*) of each robot of a :class:`Kind`, and the lattice motions that end there.

    Index 0 of the second axis is the start, index 1 the goal.
    """

    node: Int[np.ndarray, "robots 2"]  # node of each terminal
    cell: Int[np.ndarray, "robots 2"]  # node of each terminal's cell, which the terminal replaces for its robot
    # Begin nodes (-1: none) and costs (inf: not free) of the motions into each terminal, by primitive. Third axis:
    # 0: motions from the nodes of cells; 1: from the robot's other terminal. No motion leads to both terminals.
    begin: Int[np.ndarray, "robots 2 2 primitives"]
    cost: Float[np.ndarray, "robots 2 2 primitives"]


@dataclass(eq=False)
class Kind:
    """The lattice that robots of equal shape and rotation weight share, as a table of motions and as a graph.

    ``q`` has the configurations of the nodes: first a free configuration of each cell that has one, then all starts,
    then all goals. A *primitive* is a motion to a neighboring cell. Entry ``[n, p]`` of the table (``child`` and
    ``cost``) is the end node and the cost of primitive ``p`` from node ``n``. Primitive 0 stays in place. A blocked
    primitive ends at ``n`` at infinite cost. A start or goal belongs to one robot, so primitives from other nodes do
    not lead there.

    Edge ``e`` of the graph leads from node ``begin[e]`` to node ``end[e]``. First come the free motions of the table,
    then the motions into each robot's start and goal. The last edge is a dummy of infinite cost, which pads lists of
    edges.
    """

    robot: Robot
    members: Int[np.ndarray, " robots"]  # indices in the team
    q: Float[np.ndarray, "nodes dof"]
    child: Int[np.ndarray, "nodes primitives"]
    cost: Float[np.ndarray, "nodes primitives"]
    side: Float[np.ndarray, " dof"]  # side lengths of a cell
    offset: Float[np.ndarray, "primitives dof"]  # displacement of each primitive between cell centers
    terminals: Terminals

    def __post_init__(self) -> None:
        # 1. List the edges as columns (begin, end, cost): shared edges, edges into terminals, and the dummy edge.
        terminals = self.terminals
        moves = np.nonzero(np.isfinite(self.cost))  # node and primitive
        shared = moves[0], self.child[moves], self.cost[moves]
        enters = np.nonzero((terminals.begin >= 0) & np.isfinite(terminals.cost))  # sorted by robot
        into_terminals = terminals.begin[enters], terminals.node[enters[:2]], terminals.cost[enters]
        dummy = np.zeros(1, np.intp), np.zeros(1, np.intp), np.full(1, np.inf)
        self.begin, self.end, self.edge_cost = map(np.concatenate, zip(shared, into_terminals, dummy, strict=True))
        # 2. The dummy edge has the index `num_edges`. `terminal_edges` has an array of edges for each robot.
        self.num_shared, self.num_edges = len(moves[0]), len(self.begin) - 1
        first = np.searchsorted(enters[0], np.arange(1, len(self.members)))  # of each robot but the first one
        self.terminal_edges = np.split(np.arange(self.num_shared, self.num_edges), first)
        x, y = (self.q[self.end] - self.q[self.begin])[:, :2].T
        # The farthest that a motion takes the body from the motion's begin.
        self.reach = self.robot.circumscribed_radius + float(np.hypot(x, y).max())

    def motions(self, node: Int[np.ndarray, " n"], row: int | slice = slice(None)) -> Primitives:
        """Return the end node and the cost of each primitive from each node of ``node``, for robot ``members[row]``.

        Unlike in the table, motions into the cell of the robot's start or goal end at the start or goal. By default,
        ``node[i]`` is for robot ``members[i]``.
        """
        child, cost = self.child[node], self.cost[node]
        # Replace motions into the cells of the robot's terminals by motions into the terminals. Axes of `enters`:
        # index in `node`; start or goal; from a cell's node or from the other terminal; primitive.
        enters = self.terminals.begin[row] == node[:, None, None, None]
        index, *_, primitive = np.nonzero(enters)
        cost_into = np.broadcast_to(self.terminals.cost[row], enters.shape)[enters]
        terminal = np.broadcast_to(self.terminals.node[row][..., None, None], enters.shape)[enters]
        child[index, primitive] = np.where(np.isfinite(cost_into), terminal, node[index])
        cost[index, primitive] = cost_into
        return child, cost

    @cached_property
    def _shared_edges_into_nodes(self) -> Int[np.ndarray, "k nodes"]:
        # Each column lists the shared edges into a node, then dummy edges. The only shared edge into a terminal is
        # the edge that stays there.
        order = np.argsort(self.end[: self.num_shared], kind="stable")
        end, rank = ragged_indices(np.bincount(self.end[: self.num_shared]))  # of the edges in this order
        # In a terminal's column, `edges_into_nodes` needs room for the terminal edges below the edge that stays.
        size = max(int(rank.max()) + 1, 1 + max(len(edges) for edges in self.terminal_edges))
        into = np.full((size, len(self.q)), self.num_edges)
        into[rank, end] = order
        return into

    def edges_into_nodes(self, row: int) -> Int[np.ndarray, "k nodes"]:
        """Return, in column ``n``, the indices of the edges into node ``n`` that robot ``members[row]`` may use.

        The index of the dummy edge, of infinite cost, fills up the columns.
        """
        into = self._shared_edges_into_nodes.copy()
        terminal_edges = self.terminal_edges[row]
        into[:, self.terminals.cell[row]] = self.num_edges  # the robot's terminals replace these nodes
        for node in self.terminals.node[row]:
            edges = terminal_edges[self.end[terminal_edges] == node]
            into[1 : 1 + len(edges), node] = edges  # after the edge that stays in place
        return into

    @cached_property
    def _edges_and_sorted_keys(self) -> tuple[Int[np.ndarray, " m"], Int[np.ndarray, " m"]]:
        # Edges sorted by begin, end, and cost. Equal begins and ends have equal keys, of which the first is cheapest.
        key = self.begin[:-1] * len(self.q) + self.end[:-1]
        order = np.lexsort((self.edge_cost[:-1], key))
        return order, key[order]

    def edges_along(self, nodes: Int[np.ndarray, " steps"]) -> Int[np.ndarray, "motions"]:
        """Return the index of the cheapest edge from each node of a path to the next node; there must be an edge."""
        order, key = self._edges_and_sorted_keys
        return order[np.searchsorted(key, nodes[:-1] * len(self.q) + nodes[1:])]

    @cached_property
    def _cheapest_shared_edges(self) -> Int[np.ndarray, " m"]:
        # One edge per begin and end, since `csr_array` adds up the costs of several.
        order, key = self._edges_and_sorted_keys
        edge = np.sort(order[np.append(True, key[1:] != key[:-1])])
        return edge[(edge < self.num_shared) & (self.begin[edge] != self.end[edge])]

    def costs_to_go(self, rows: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n nodes"]:
        # Search along reversed edges, from an extra node per goal. Only the motions into the goal leave it. (If they
        # left the goal's own node, other robots' paths could pass it.) Paths may pass the representative of the
        # start's cell.
        num_nodes, searches = len(self.q), np.arange(len(rows))
        goals = self.terminals.node[rows, 1]
        shared = self._cheapest_shared_edges
        terminal_edges = np.concatenate([self.terminal_edges[row] for row in rows])
        search = np.repeat(searches, [len(self.terminal_edges[row]) for row in rows])  # of each terminal edge
        into_goal = self.end[terminal_edges] == goals[search]
        edge = np.append(shared, terminal_edges[into_goal])
        end = np.append(self.end[shared], num_nodes + search[into_goal])
        graph = csr_array((self.edge_cost[edge], (end, self.begin[edge])), shape=(num_nodes + len(rows),) * 2)
        costs = sparse_graphs.dijkstra(graph, indices=num_nodes + searches)[:, :num_nodes]
        costs[searches, goals] = 0.0
        return costs

    def costs_to_come(self, row: int | np.integer) -> Float[np.ndarray, " nodes"]:
        # Along shared edges, which do not enter the goal: its cost is inf unless it equals the start.
        edge = self._cheapest_shared_edges
        graph = csr_array((self.edge_cost[edge], (self.begin[edge], self.end[edge])), shape=(len(self.q),) * 2)
        return sparse_graphs.dijkstra(graph, indices=self.terminals.node[row, 0])


class Lattice:
    """The lattice of robot ``kind.members[row]``: the lattice of its :class:`Kind`, with the robot's start and goal.

    In ``child`` and ``cost``, motions into the cells of the start and goal end at the start and goal.
    """

    def __init__(self, kind: Kind, row: int):
        self.kind, self.row, self.q = kind, row, kind.q
        self.start, self.goal = kind.terminals.node[row].tolist()

    @cached_property
    def _motions(self) -> Primitives:
        return self.kind.motions(np.arange(len(self.q)), self.row)

    @property
    def child(self) -> Int[np.ndarray, "nodes primitives"]:
        return self._motions[0]

    @property
    def cost(self) -> Float[np.ndarray, "nodes primitives"]:
        return self._motions[1]


@dataclass(frozen=True, eq=False)
class JointLattice:
    """The lattices of all robots, also grouped by kind (equal shape and rotation weight), with a collision test."""

    problem: Problem
    step: float
    kinds: list[Kind]
    lattices: list[Lattice]
    test: JointMotionTest

    @cached_property
    def costs_to_go(self) -> list[Float[np.ndarray, " _"]]:
        """For each robot, an array of the least costs from the nodes of its lattice to its goal.

        Other robots are ignored.
        """
        costs = {}
        for kind in self.kinds:
            num_robots, size = len(kind.members), int(np.clip(_NODES // len(kind.q), 1, _GOALS))
            for begin in range(0, num_robots, size):
                require_time(self.test.deadline, "the costs-to-go were known", _SECONDS * len(kind.q))
                rows = np.arange(begin, min(begin + size, num_robots))
                costs.update(zip(kind.members[rows].tolist(), kind.costs_to_go(rows), strict=True))
        return [costs[i] for i in range(len(self.lattices))]

    @property
    def least_costs(self) -> Float[np.ndarray, " robots"]:
        """For each robot, the least cost on its lattice from its start to its goal; other robots are ignored."""
        return np.array([cost[lattice.start] for cost, lattice in zip(self.costs_to_go, self.lattices, strict=True)])

    def configurations(self, state: State) -> Float[np.ndarray, "n robots dof"]:
        q = np.repeat(self.problem.starts[None], len(state), axis=0)
        for i, lattice in enumerate(self.lattices):
            q[:, i, : lattice.q.shape[1]] = lattice.q[state[:, i]]
        return q

    def move(self, state: State, primitive: UInt8[np.ndarray, "n robots"]) -> tuple[State, Float[np.ndarray, " n"]]:
        columns = list(zip(self.lattices, state.T, primitive.T, strict=True))
        child = np.stack([lattice.child[s, p] for lattice, s, p in columns], axis=1)
        return child, np.sum([lattice.cost[s, p] for lattice, s, p in columns], axis=0)

    def collisions(
        self, i: int, j: int, state: State
    ) -> tuple[Int[np.ndarray, " m"], Bool[np.ndarray, "m primitives_i primitives_j"]]:
        """Return the rows of ``state`` in which robots ``i`` and ``j`` are near, and their primitives that collide.

        A row of ``state`` has a node for each robot. Robots are near if one motion of each may bring their bodies
        together. Entry ``[k, a, b]`` of the second result tells whether primitive ``a`` of robot ``i`` collides with
        primitive ``b`` of robot ``j`` in the ``k``-th row of the first result.
        """
        a, b = self.lattices[i], self.lattices[j]
        qa, qb = a.q[state[:, i]], b.q[state[:, j]]
        # 1. Robots are near if their bodies might meet in one motion from there.
        reach = a.kind.reach + b.kind.reach
        x, y = qa[:, 0] - qb[:, 0], qa[:, 1] - qb[:, 1]
        near = np.flatnonzero(x * x + y * y < reach * reach)
        # 2. Test each primitive of one robot (second axis) against each one of the other (third axis).
        motions_a = qa[near, None, None], a.q[a.child[state[near, i]]][:, :, None]
        motions_b = qb[near, None, None], b.q[b.child[state[near, j]]][:, None, :]
        return near, ~self.test.apart(i, *motions_a, j, *motions_b)


class CellGrid(NamedTuple):
    """A grid of cells over a robot's configuration space: free configurations in cells, and motions between them."""

    lo: Float[np.ndarray, " dof"]
    shape: tuple[int, ...]
    side: Float[np.ndarray, " dof"]
    offsets: Int[np.ndarray, "primitives dof"]  # displacement of each primitive, in cells
    test: MotionTest
    rotation_weight: float
    q: Float[np.ndarray, "cells dof"]  # the representatives
    free: Bool[np.ndarray, " cells"]  # whether the cell has a representative
    child: Int[np.ndarray, "cells primitives"]
    cost: Float[np.ndarray, "cells primitives"]

    def with_terminals(
        self, robot: Robot, members: Int[np.ndarray, " robots"], starts: Configurations, goals: Configurations
    ) -> Kind:
        """Add the starts and goals of robots as nodes, and return the lattice of these robots.

        All these robots have the shape ``robot``. ``members`` are their indices in the team, in the order of the rows
        of ``starts`` and ``goals``.
        """
        # Arrays of terminals hold all starts, then all goals. Rolled by `num_robots`, they hold the other terminal of
        # the same robot.
        num_robots = len(starts)
        poses = np.concatenate([starts, goals])
        # The cells of the terminals; outside the grid, the nearest cells.
        index = np.floor((poses - self.lo) / self.side).astype(np.intp)
        modes = ("clip", "clip", "wrap")[: len(self.shape)]
        cells = np.asarray(np.ravel_multi_index(tuple(index.T), self.shape, mode=modes))
        differ = straight_costs(starts, goals, 1.0) > 0
        # 1. A start or goal represents its cell if nothing else does. Test all motions from and to this cell. Change
        #    copies of the arrays, since the grid may be cached.
        motions = self
        occupied, first = np.unique(cells, return_index=True)
        missing = ~self.free[occupied]
        if missing.any():
            motions = self._replace(**{name: getattr(self, name).copy() for name in ("q", "free", "child", "cost")})
            new = occupied[missing]
            motions.q[new], motions.free[new] = poses[first[missing]], True
            around, is_possible = motions.neighbors(new, np.concatenate([self.offsets, -self.offsets]))
            motions.connect(np.union1d(new, around[is_possible]))
        # 2. Add a primitive between a start and a goal in the same cell.
        if (differ & (cells[:num_robots] == cells[num_robots:])).any():
            motions = motions._replace(
                offsets=np.append(motions.offsets, np.zeros_like(motions.offsets[:1]), axis=0),
                child=np.append(motions.child, np.arange(len(motions.q))[:, None], axis=1),
                cost=np.append(motions.cost, np.full((len(motions.q), 1), np.inf), axis=1),
            )
        # 3. Build the table: a row per representative, then a row per terminal. `nodes[cell]` is the node of a cell.
        free, offsets = motions.free, motions.offsets
        nodes, terminal_nodes = np.cumsum(free) - 1, int(free.sum()) + np.arange(len(poses))
        child = np.where(np.isfinite(motions.cost), nodes[motions.child], nodes[:, None])[free]
        target, is_possible = motions.neighbors(cells, offsets)
        cost = motions.costs(is_possible, poses[:, None], motions.q[target])
        child_of_terminals = np.where(np.isfinite(cost), nodes[target], terminal_nodes[:, None])
        cost[:, 0] = 0.0  # the terminal stays in place
        q, cost = np.concatenate([motions.q[free], poses]), np.concatenate([motions.cost[free], cost])
        child = np.concatenate([child, child_of_terminals], dtype=np.int32)
        # 4. Find the motions into terminals: each primitive from the node of the previous cell (`into`), or from the
        #    robot's other terminal if that is in the previous cell (`across`).
        #
        #             previous cell             terminal's cell
        #        [ node or other terminal ] ---> [ terminal ]
        #
        #    A goal equal to the start, up to whole turns, is the same node.
        terminal_nodes[:num_robots][~differ] += num_robots
        other_poses, other_nodes, other_cells = (np.roll(x, num_robots, 0) for x in (poses, terminal_nodes, cells))
        same_cell = cells == other_cells
        previous, enters = motions.neighbors(cells, -offsets)
        crosses = enters & (previous == other_cells[:, None])
        crosses[:, -1] |= same_cell & (terminal_nodes != other_nodes)  # by the primitive of step 2
        into = motions.costs(enters, motions.q[previous], poses[:, None])
        across = motions.costs(crosses, other_poses[:, None], poses[:, None])
        # Motions into a cell with start and goal lead to the goal, or if that is blocked, to the start.
        to_goal = np.isfinite(into[num_robots:])
        enters &= ~same_cell[:, None] | np.concatenate([~to_goal, to_goal])
        begin = np.where(enters, nodes[previous], -1), np.where(crosses, other_nodes[:, None], -1)
        # 5. Turn rows of starts, then goals, into a row per robot with a column for each of the two.
        columns = terminal_nodes, nodes[cells], np.stack(begin, axis=1), np.stack([into, across], axis=1)
        terminals = Terminals(*(np.stack(np.split(column, 2), axis=1) for column in columns))
        return Kind(robot, members, q, child, cost, self.side, offsets * self.side, terminals)

    def neighbors(self, cells: Int[np.ndarray, " n"], offsets: Int[np.ndarray, "primitives dof"]) -> Neighbors:
        """Return the cell at each offset from each given cell, and whether a motion between these two may be free.

        A motion may be free if the two cells differ and the cell at the offset has a free configuration. Where an
        offset leads out of the grid, the flag is False. Cells are row-major indices; offsets count cells along each
        axis.
        """
        target = np.stack(np.unravel_index(cells, self.shape), axis=1)[:, None] + offsets
        target[..., 2:] %= np.array(self.shape)[2:]
        exists = ((target >= 0) & (target < self.shape)).all(axis=2)
        cell = np.asarray(np.ravel_multi_index(tuple(np.moveaxis(target, 2, 0)), self.shape, mode="clip"))
        return cell, exists & self.free[cell] & (cell != cells[:, None])

    def costs(
        self, possible: Bool[np.ndarray, "n primitives"], begin: Ends, end: Ends, deadline: float = math.inf
    ) -> Float[np.ndarray, "n primitives"]:
        """Return the cost of the straight motion from ``begin[i, p]`` to ``end[i, p]``, for each ``i`` and ``p``.

        The cost is ``inf`` if the motion is not ``possible`` or hits an obstacle. The arguments are broadcast.
        """
        begin, end = (np.broadcast_to(q, (*possible.shape, q.shape[2]))[possible] for q in (begin, end))
        cost = np.full(possible.shape, np.inf)
        free = self.test(begin, end, deadline)
        cost[possible] = np.where(free, straight_costs(begin, end, self.rotation_weight), np.inf)
        return cost

    def connect(self, cells: Int[np.ndarray, " n"], deadline: float = math.inf) -> None:
        """Test all motions from the given cells (indices), and write their end cells and costs into the grid."""
        child, is_possible = self.neighbors(cells, self.offsets)
        at_contact = self.test.is_at_contact(self.q)  # only a start or goal can be, and no motion may pass through it
        is_possible &= (self.free & ~at_contact)[cells, None] & ~at_contact[child]
        cost = self.costs(is_possible, self.q[cells][:, None], self.q[child], deadline)
        cost[:, 0] = np.where(self.free[cells], 0.0, np.inf)
        self.child[cells], self.cost[cells] = child, cost


def num_configurations(workspace: Workspace, robot: Robot, step: float) -> float:
    turns = 2 * math.pi * max(1 / _WIDEST_TURN, robot.circumscribed_radius / step) if robot.dof == 3 else 1
    return turns * math.prod(max(1.0, side / step) for side in workspace.bounds.width.tolist())


def robot_kinds(problem: Problem) -> dict[tuple[Robot, float], list[int]]:
    """Group robots by shape and rotation weight; return the indices of the robots with each such pair."""
    kinds = defaultdict(list)
    for i, kind in enumerate(zip(problem.robots, problem.rotation_weights.tolist(), strict=True)):
        kinds[kind].append(i)
    return kinds


def build_lattices(problem: Problem, step: float, test: JointMotionTest) -> JointLattice:
    """Build the lattices of all robots of a problem; robots of equal shape and rotation weight share arrays.

    Cells are at most ``step`` wide, in workspace units. A turn from a cell to the next one moves no point of a robot
    by more than ``step``, and is at most an eighth of a full turn.
    """
    kinds = []
    for (robot, weight), members in robot_kinds(problem).items():
        starts, goals = (q[members, : robot.dof] for q in (problem.starts, problem.goals))
        motions = cell_grid(problem.workspace, robot, weight, step, test.deadline)
        kinds.append(motions.with_terminals(robot, np.array(members), starts, goals))
    lattices = {i: Lattice(kind, row) for kind in kinds for row, i in enumerate(kind.members.tolist())}
    return JointLattice(problem, step, kinds, [lattices[i] for i in range(len(problem.robots))], test)


def cell_grid(workspace: Workspace, robot: Robot, weight: float, step: float, deadline: float = math.inf) -> CellGrid:
    """Return the grid of cells, at most ``step`` wide, of one robot, with the motions between cells.

    ``weight`` is the robot's rotation weight. Small grids are cached.
    """
    is_small = num_configurations(workspace, robot, step) * (1 + len(PRIMITIVES)) <= _MOST_KEPT
    build = _cached_cell_grid if is_small else _build_cell_grid
    return build(workspace, robot, weight, step, IgnoredByCache(deadline))


def _build_cell_grid(workspace: Workspace, robot: Robot, weight: float, step: float, deadline: float) -> CellGrid:
    # 1. Divide the bounds into cells at most a step wide. Headings are centered on the axes, the most frequent
    #    directions of hallways.
    lo, width = workspace.bounds.lo, workspace.bounds.width
    shape = np.maximum(1, np.ceil(width / step - _ROUNDING)).astype(int)
    side = width / shape
    if robot.dof == 3:
        turn = min(step / robot.circumscribed_radius, _WIDEST_TURN)
        per_quarter = int(np.ceil(np.pi / 2 / turn - _ROUNDING))  # cells per quarter of a full turn
        shape, side = np.append(shape, 4 * per_quarter), np.append(side, np.pi / 2 / per_quarter)
        lo = np.append(lo, -side[2] / 2)
    test = motion_test(workspace, robot, deadline)
    axes = [first + (np.arange(n) + 0.5) * width for first, n, width in zip(lo, shape, side, strict=True)]
    q = np.stack([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")], axis=1)
    offsets = np.array([(0, 0, 0), *(p for p in PRIMITIVES if robot.dof == 3 or p[2] == 0)])[:, : robot.dof]
    child = np.empty((len(q), len(offsets)), dtype=np.intp)
    free, cost = np.empty(len(q), dtype=bool), np.empty(child.shape)
    motions = CellGrid(lo, tuple(shape.tolist()), side, offsets, test, weight, q, free, child, cost)
    per_position = len(q) // (shape[0] * shape[1])  # adjacent cells of equal position, one per heading
    size = max(1, _CHUNK // per_position) * per_position  # whole positions
    chunks = [slice(begin, min(begin + size, len(q))) for begin in range(0, len(q), size)]

    def stands_free(q: Configurations) -> Bool[np.ndarray, " n"]:
        return test(q, q, deadline) & ~test.is_at_contact(q)

    # 2. Choose representatives: a sample if the center is blocked and the robot might fit into the cell. (Clearance
    #    grows by at most the distance from the center, which is at most half a diagonal of the cell.)
    along = (np.arange(_SAMPLES) + 0.5) / _SAMPLES - 0.5
    pattern, half_diagonal = np.array(list(product(along, along))) * side[:2], np.hypot(*side[:2]) / 2
    for cells in chunks:
        require_time(deadline, "the lattice was built")
        representatives = q[cells]  # a view of the centers, which samples may replace
        is_free = stands_free(representatives)
        clearance = np.repeat(workspace.clearance(representatives[::per_position, :2]), per_position)
        blocked = np.flatnonzero(~is_free & (clearance + half_diagonal >= robot.inscribed_radius))
        samples = np.repeat(representatives[blocked], len(pattern), axis=0)
        samples[:, :2] += np.tile(pattern, (len(blocked), 1))
        is_sample_free = stands_free(samples)
        score = np.full(len(samples), -np.inf)
        score[is_sample_free] = workspace.clearance(samples[is_sample_free, :2])
        best = np.arange(len(blocked)) * len(pattern) + score.reshape(-1, len(pattern)).argmax(axis=1)
        representatives[blocked], is_free[blocked] = samples[best], is_sample_free[best]
        motions.free[cells] = is_free
    # 3. Test the motions between representatives.
    for cells in chunks:
        require_time(deadline, "the lattice was built")
        motions.connect(np.arange(cells.start, cells.stop), deadline)
    return motions


_cached_cell_grid = lru_cache(maxsize=8)(_build_cell_grid)
