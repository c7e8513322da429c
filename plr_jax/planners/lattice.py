r"""Lattices: the configurations that robots visit in a search, and the motions between them.

::

    +-------+-------+-------+       o   representative of a cell: its center if that is free, else the free sample
    |   o---|---o---|---o   |           with the largest clearance
    |    \  |  / \  |       |       #   obstacle, which leaves the cell without representative
    +-----\-+-/---\-+-------+       S   start of a robot
    |   o---|---S   |#######|       --  free motion between neighboring cells, a *primitive*
    +-------+-------+-------+

1. :class:`CellGrid` divides a robot's configuration space, periodic in the heading, into cells. It holds a
   representative for each cell and the free motions between the representatives. Equal robots share it.
2. :meth:`CellGrid.with_terminals` adds the starts and goals of these robots as *nodes*, so that the ends of every
   path are exact. For its own robot, a start or goal replaces the representative of its cell. If both lie in one
   cell, motions into the cell lead to the goal, and an additional primitive connects the two.
3. :class:`Kind` is the resulting graph of nodes and motions, in the two forms that searches need: as a table by node
   and primitive, and as lists of edges. It also finds costs-to-go and costs-to-come.
4. :class:`Lattice` is the graph as one robot sees it, and :class:`JointLattice` builds the lattices of a team.
"""

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import product
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from scipy.sparse import csgraph, csr_array

from plr_jax._arrays import batches, ragged_indices, require_time, take_ragged
from plr_jax._problem import Problem, robot_kinds, straight_costs
from plr_jax.collision.motions import JointMotionTest
from plr_jax.collision.walls import Configurations, IgnoredByCache, MotionTest, motion_test
from plr_jax.geometry.workspace import Workspace
from plr_jax.robots import Robot

# Primitives besides staying, as offsets (columns, rows, turns) in cells. Robots without a heading do not turn.
PRIMITIVES = (*((dx, dy, 0) for dx, dy in product((-1, 0, 1), repeat=2) if dx or dy), (0, 0, 1), (0, 0, -1))
# Cells and their representatives:
_SAMPLES = 7  # samples per axis in a cell whose center is blocked; more find narrower gaps
_WIDEST_TURN = np.pi / 4  # widest cell along the heading, in radians, so that even a small robot has 8 headings
_ROUNDING = 1e-9  # share of a cell by which a width may exceed whole cells: far more than a division rounds
_CHUNK = 1 << 12  # cells at a time, between two checks of the clock
_MOST_KEPT = 1 << 18  # most motions of a cached grid: their end cells and costs take 4 MB
# One call of Dijkstra's algorithm, which SciPy does not interrupt at the deadline:
_GOALS = 8  # most goals
_NODES = 1 << 19  # most nodes times goals
_SECONDS = 3e-7  # estimated time, in seconds per node
Primitives: TypeAlias = tuple[Int[np.ndarray, "n primitives"], Float[np.ndarray, "n primitives"]]  # end node and cost
Table: TypeAlias = Float[np.ndarray, " _"]  # a cost at each node of a robot's lattice
State: TypeAlias = Int[np.ndarray, "_ robots"]  # joint states: a node of each robot's lattice
Neighbors: TypeAlias = tuple[Int[np.ndarray, "*n primitives"], Bool[np.ndarray, "*n primitives"]]
Ends: TypeAlias = Float[np.ndarray, "*#n #primitives dof"]  # ends of motions
Members: TypeAlias = Int[np.ndarray, " robots"]  # indices in the team
Collisions: TypeAlias = tuple[Int[np.ndarray, " m"], Bool[np.ndarray, "m primitives_i primitives_j"]]


class CellGrid(NamedTuple):
    """A grid of cells over a robot's configuration space: a representative per cell, and motions between them.

    Cells are numbered in row-major order: by column, row and, if the robot turns, heading.
    """

    lo: Float[np.ndarray, " dof"]
    shape: tuple[int, ...]
    side: Float[np.ndarray, " dof"]  # of a cell
    offsets: Int[np.ndarray, "primitives dof"]  # displacement of each primitive, in cells; primitive 0 stays in place
    test: MotionTest
    rotation_weight: float
    q: Float[np.ndarray, "cells dof"]  # the representatives
    free: Bool[np.ndarray, " cells"]  # whether the cell has a representative
    child: Int[np.ndarray, "cells primitives"]  # the cell to which each primitive leads
    cost: Float[np.ndarray, "cells primitives"]  # `inf` for a blocked primitive

    def choose_representatives(self, cells: Int[np.ndarray, " n"], deadline: float) -> None:
        """Choose a representative for each of ``cells`` (a free configuration in it), and write it into the grid.

        Before the call, the field ``q`` must hold the centers of the cells. In ``cells``, all headings of a position
        must follow one another.
        """
        q = self.q[cells]

        def stands_free(q: Configurations) -> Bool[np.ndarray, " n"]:
            return self.test(q, q, deadline) & ~self.test.is_at_contact(q)

        # 1. Find the blocked centers beside which the robot might still fit. From the center to a place in the cell,
        #    clearance grows by at most their distance, which is at most half a diagonal.
        is_free = stands_free(q)
        num_headings = math.prod(self.shape[2:])
        clearance = np.repeat(self.test.workspace.clearance(q[::num_headings, :2]), num_headings)
        half_diagonal = np.hypot(*self.side[:2]) / 2
        blocked = np.flatnonzero(~is_free & (clearance + half_diagonal >= self.test.robot.inscribed_radius))
        # 2. In their cells, test a regular pattern of samples with the heading of the center.
        along = (np.arange(_SAMPLES) + 0.5) / _SAMPLES - 0.5
        pattern = np.array(list(product(along, along))) * self.side[:2]
        samples = np.repeat(q[blocked], len(pattern), axis=0)
        samples[:, :2] += np.tile(pattern, (len(blocked), 1))
        is_sample_free = stands_free(samples)
        # 3. Choose the free sample with the largest clearance, if any.
        score = np.full(len(samples), -np.inf)
        score[is_sample_free] = self.test.workspace.clearance(samples[is_sample_free, :2])
        best = np.arange(len(blocked)) * len(pattern) + score.reshape(-1, len(pattern)).argmax(axis=1)
        q[blocked], is_free[blocked] = samples[best], is_sample_free[best]
        self.q[cells], self.free[cells] = q, is_free

    def connect(self, cells: Int[np.ndarray, " n"], deadline: float = math.inf) -> None:
        """Test all motions from the given cells (indices), and write their end cells and costs into the grid."""
        child, is_possible = self.neighbors(cells, self.offsets)
        at_contact = self.test.is_at_contact(self.q)  # only a start or goal can be, and no motion may pass through it
        is_possible &= (self.free & ~at_contact)[cells, None] & ~at_contact[child]
        cost = self.costs(is_possible, self.q[cells][:, None], self.q[child], deadline)
        cost[:, 0] = np.where(self.free[cells], 0.0, np.inf)
        self.child[cells], self.cost[cells] = child, cost

    def neighbors(self, cells: Int[np.ndarray, "*n"], offsets: Int[np.ndarray, "primitives dof"]) -> Neighbors:
        """Return the cells at ``offsets`` from ``cells``, and whether each is another cell with a representative."""
        target = np.stack(np.unravel_index(cells, self.shape), axis=-1)[..., None, :] + offsets
        target[..., 2:] %= np.array(self.shape)[2:]  # headings are periodic
        exists = ((target >= 0) & (target < self.shape)).all(axis=-1)
        cell = np.asarray(np.ravel_multi_index(tuple(np.moveaxis(target, -1, 0)), self.shape, mode="clip"))
        return cell, exists & self.free[cell] & (cell != cells[..., None])

    def costs(
        self, possible: Bool[np.ndarray, "*n primitives"], begin: Ends, end: Ends, deadline: float = math.inf
    ) -> Float[np.ndarray, "*n primitives"]:
        """Return the cost of the straight motion from ``begin[i, p]`` to ``end[i, p]``, for each ``i`` and ``p``.

        The cost is ``inf`` if the motion is not ``possible`` or hits an obstacle. The arguments are broadcast.
        """
        begin, end = (np.broadcast_to(q, (*possible.shape, q.shape[-1]))[possible] for q in (begin, end))
        cost = np.full(possible.shape, np.inf)
        free = self.test(begin, end, deadline)
        cost[possible] = np.where(free, straight_costs(begin, end, self.rotation_weight), np.inf)
        return cost

    def with_terminals(self, robot: Robot, members: Members, starts: Configurations, goals: Configurations) -> "Kind":
        """Add the starts and goals of robots as nodes, and return the lattice of these robots.

        All these robots have the shape ``robot``. ``members`` are their indices in the team, in the order of the rows
        of ``starts`` and ``goals``.
        """
        # Arrays of terminals have the axes (2, robots): row 0 holds the starts, row 1 the goals. Reversed (`[::-1]`),
        # they hold the other terminal of the same robot. A goal may equal the start, up to whole turns.
        poses = np.stack([starts, goals])
        is_distinct = straight_costs(starts, goals, 1.0) > 0
        # 1. Find the terminals' cells. Outside the grid, these are the nearest cells.
        index = np.floor((poses - self.lo) / self.side).astype(np.intp)
        modes = ("clip", "clip", "wrap")[: len(self.shape)]
        cells = np.asarray(np.ravel_multi_index(tuple(np.moveaxis(index, 2, 0)), self.shape, mode=modes))
        is_shared = cells[0] == cells[1]
        # 2. Extend the grid, so that each of these cells has a representative. If a start and a goal are in one cell,
        #    add the primitive that connects them: it has no offset, and is blocked between representatives.
        grid = self._with_representatives(cells.ravel(), poses.reshape(cells.size, -1))
        if (is_distinct & is_shared).any():
            offsets = np.append(grid.offsets, np.zeros_like(grid.offsets[:1]), axis=0)
            child = np.append(grid.child, np.arange(len(grid.q))[:, None], axis=1)
            cost = np.append(grid.cost, np.full((len(grid.q), 1), np.inf), axis=1)
            grid = grid._replace(offsets=offsets, child=child, cost=cost)
        # 3. Number the nodes: representatives, then starts, then goals. The node of cell c is `nodes[c]`.
        nodes = np.cumsum(grid.free) - 1
        own_nodes = int(grid.free.sum()) + np.arange(cells.size).reshape(cells.shape)
        # 4. Build the table, a row per node. Primitives lead to representatives. Blocked primitives stay in place, at
        #    infinite cost.
        target, is_possible = grid.neighbors(cells, grid.offsets)
        cost = grid.costs(is_possible, poses[:, :, None], grid.q[target])
        child = np.where(np.isfinite(cost), nodes[target], own_nodes[:, :, None])
        cost[:, :, 0] = 0.0
        child_of_cells = np.where(np.isfinite(grid.cost), nodes[grid.child], nodes[:, None])
        q = np.concatenate([grid.q[grid.free], *poses])
        child = np.concatenate([child_of_cells[grid.free], *child], dtype=np.int32)
        cost = np.concatenate([grid.cost[grid.free], *cost])
        # 5. Find the motions into terminals, which come from the previous cell of each primitive: from its node
        #    (`into`), or from the other terminal if that lies there (`across`).
        #
        #             previous cell             terminal's cell
        #        [ node or other terminal ] ---> [ terminal ]
        #
        previous, enters = grid.neighbors(cells, -grid.offsets)
        crosses = enters & (previous == cells[::-1, :, None])
        crosses[:, :, -1] |= is_distinct & is_shared  # by the primitive within cells
        into = grid.costs(enters, grid.q[previous], poses[:, :, None])
        across = grid.costs(crosses, poses[::-1, :, None], poses[:, :, None])
        # 6. In a cell with start and goal, motions lead to the goal or, if that is blocked, to the start. If both are
        #    equal, they are one node, that of the goal.
        enters &= ~is_shared[:, None] | np.stack([~np.isfinite(into[1]), np.isfinite(into[1])])
        terminal_nodes = np.where(is_distinct, own_nodes, own_nodes[1])
        begin = np.where(enters, nodes[previous], -1), np.where(crosses, terminal_nodes[::-1, :, None], -1)
        columns = terminal_nodes, nodes[cells], np.stack(begin, axis=2), np.stack([into, across], axis=2)
        terminals = Terminals(*(np.stack([*column], axis=1) for column in columns))  # a row per robot
        return Kind(robot, members, q, child, cost, self.side, grid.offsets * self.side, terminals)

    def _with_representatives(self, cells: Int[np.ndarray, " n"], q: Configurations) -> "CellGrid":
        """Return the grid in which ``q[i]`` represents the cell ``cells[i]`` if this cell had no representative."""
        occupied, first = np.unique(cells, return_index=True)
        is_missing = ~self.free[occupied]
        if not is_missing.any():
            return self
        # Change copies, since the grid may be cached.
        grid = self._replace(**{name: getattr(self, name).copy() for name in ("q", "free", "child", "cost")})
        new = occupied[is_missing]
        grid.q[new], grid.free[new] = q[first[is_missing]], True
        # Test all motions from and to these cells.
        around, is_possible = grid.neighbors(new, np.concatenate([self.offsets, -self.offsets]))
        grid.connect(np.union1d(new, around[is_possible]))
        return grid


def num_configurations(workspace: Workspace, robot: Robot, step: float) -> float:
    """Return about how many cells of size ``step`` the grid of a robot has."""
    turns = 2 * math.pi * max(1 / _WIDEST_TURN, robot.circumscribed_radius / step) if robot.dof == 3 else 1
    return turns * math.prod(max(1.0, side / step) for side in workspace.bounds.width.tolist())


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
    # 2. Begin with a grid of centers, without motions.
    axes = [first + (np.arange(n) + 0.5) * width for first, n, width in zip(lo, shape, side, strict=True)]
    q = np.stack([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")], axis=1)
    offsets = np.array([(0, 0, 0), *(p for p in PRIMITIVES if robot.dof == 3 or p[2] == 0)])[:, : robot.dof]
    free, child = np.empty(len(q), dtype=bool), np.empty((len(q), len(offsets)), dtype=np.intp)
    test = motion_test(workspace, robot, deadline)
    grid = CellGrid(lo, tuple(shape.tolist()), side, offsets, test, weight, q, free, child, np.empty(child.shape))
    # 3. Choose the representatives, then test the motions between them; a chunk has all headings of its positions.
    num_headings = math.prod(grid.shape[2:])
    for choose_or_connect in (grid.choose_representatives, grid.connect):
        for cells in batches(np.arange(len(q)), max(1, _CHUNK // num_headings) * num_headings):
            require_time(deadline, "the lattice was built")
            choose_or_connect(cells, deadline)
    return grid


_cached_cell_grid = lru_cache(maxsize=8)(_build_cell_grid)


class Terminals(NamedTuple):
    """The *terminals* of each robot, its start and its goal, and the motions that end at them.

    Axes of the arrays: the robot; start (0) or goal (1); motions from nodes of cells (0) or from the robot's other
    terminal (1); the primitive. No motion leads to both terminals.
    """

    node: Int[np.ndarray, "robots 2"]  # node of each terminal
    cell: Int[np.ndarray, "robots 2"]  # node of each terminal's cell, which the terminal replaces for its robot
    begin: Int[np.ndarray, "robots 2 2 primitives"]  # node in which each motion begins; -1: there is no motion
    cost: Float[np.ndarray, "robots 2 2 primitives"]  # `inf`: the motion hits an obstacle


@dataclass(eq=False)
class Kind:
    """The lattice motions of robots of equal shape and rotation weight, as a table and as edges of a graph.

    Nodes are the representatives of cells, then starts and goals.

    The table (``child`` and ``cost``) has a row per node and a column per primitive. Primitive 0 stays in place, and
    a blocked primitive leads back to its node at infinite cost. All robots share the table, so none of its primitives
    leads to a start or goal: ``terminals`` has such motions, and :meth:`motions` joins both for given robots.

    The edges ``i`` of the graph lead from node ``begin[i]`` to node ``end[i]`` and cost ``edge_cost[i]``::

        | shared: free motions of the table | into the terminals of robot 0, 1, ... | dummy |
        0                            num_shared                               num_edges

    The dummy edge has infinite cost. It pads lists of edges.
    """

    robot: Robot
    members: Members
    q: Float[np.ndarray, "nodes dof"]
    child: Int[np.ndarray, "nodes primitives"]
    cost: Float[np.ndarray, "nodes primitives"]
    side: Float[np.ndarray, " dof"]  # side lengths of a cell
    offset: Float[np.ndarray, "primitives dof"]  # displacement of each primitive between cell centers
    terminals: Terminals

    def __post_init__(self) -> None:
        # 1. List the edges as columns (begin, end, cost): shared ones, those into terminals, and the dummy edge.
        terminals = self.terminals
        moves = np.nonzero(np.isfinite(self.cost))  # node and primitive
        shared = moves[0], self.child[moves], self.cost[moves]
        enters = np.nonzero((terminals.begin >= 0) & np.isfinite(terminals.cost))  # sorted by robot
        into_terminals = terminals.begin[enters], terminals.node[enters[:2]], terminals.cost[enters]
        dummy = np.zeros(1, np.intp), np.zeros(1, np.intp), np.full(1, np.inf)
        self.begin, self.end, self.edge_cost = map(np.concatenate, zip(shared, into_terminals, dummy, strict=True))
        # 2. Find the first edge into the terminals of each robot, and the end of the last robot's edges.
        self.num_shared, self.num_edges = len(moves[0]), len(self.begin) - 1
        self.first_terminal_edge = self.num_shared + np.searchsorted(enters[0], np.arange(len(self.members) + 1))
        # 3. Find the farthest that a motion takes the body from the motion's begin.
        x, y = (self.q[self.end] - self.q[self.begin])[:, :2].T
        self.reach = self.robot.circumscribed_radius + float(np.hypot(x, y).max())

    def motions(self, node: Int[np.ndarray, " n"], row: int | slice = slice(None)) -> Primitives:
        """Return the end node and the cost of each primitive from each node of ``node``, for robot ``members[row]``.

        Unlike in the table, motions into the cell of the robot's start or goal end at the start or goal. By default,
        ``node[i]`` is for robot ``members[i]``.
        """
        child, cost = self.child[node], self.cost[node]
        # 1. Find the motions into the robot's terminals that begin in the given nodes. Axes of `enters`: index in
        #    `node`; start or goal; from a cell's node or from the other terminal; primitive.
        enters = self.terminals.begin[row] == node[:, None, None, None]
        index, *_, primitive = np.nonzero(enters)
        cost_into = np.broadcast_to(self.terminals.cost[row], enters.shape)[enters]
        terminal = np.broadcast_to(self.terminals.node[row][..., None, None], enters.shape)[enters]
        # 2. They replace the motions into the cells of the terminals.
        child[index, primitive] = np.where(np.isfinite(cost_into), terminal, node[index])
        cost[index, primitive] = cost_into
        return child, cost

    @cached_property
    def _shared_edges_into_nodes(self) -> Int[np.ndarray, "k nodes"]:
        # Each column lists the shared edges into a node, then dummy edges. The only shared edge into a terminal is to
        # stay there. Below, its column has room for the terminal edges of a robot, which `edges_into_nodes` adds.
        #
        #     node 0   node 1   ...   terminal
        #     edge     edge           edge that stays
        #     edge     dummy          dummy: room for a terminal edge
        #     dummy    dummy          dummy: room for a terminal edge
        #
        end, rank = ragged_indices(np.bincount(self.end[: self.num_shared]))  # of the edges sorted by their ends
        size = 1 + max(int(rank.max()), int(np.diff(self.first_terminal_edge).max()))
        into = np.full((size, len(self.q)), self.num_edges)
        into[rank, end] = np.argsort(self.end[: self.num_shared], kind="stable")
        return into

    def edges_into_nodes(self, row: int) -> Int[np.ndarray, "k nodes"]:
        """Return, in column ``n``, the indices of the edges into node ``n`` that robot ``members[row]`` may use.

        The index of the dummy edge, of infinite cost, fills up the columns.
        """
        into = self._shared_edges_into_nodes.copy()
        terminal_edges = np.arange(*self.first_terminal_edge[row : row + 2])
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
        # One edge per begin and end, without edges that stay: `csr_array` adds up the costs of several.
        order, key = self._edges_and_sorted_keys
        edge = np.sort(order[np.append(True, key[1:] != key[:-1])])
        return edge[(edge < self.num_shared) & (self.begin[edge] != self.end[edge])]

    def costs_to_go(self, rows: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n nodes"]:
        """Return the least cost from each node to the goals of robots ``members[rows]``, by Dijkstra's algorithm."""
        # One search per goal along reversed edges. Each begins in an extra node, which only the reversed motions into
        # the goal leave: if they left the goal's own node, paths of other robots could pass it. Paths may pass the
        # representative of the start's cell.
        #
        #     extra node of goal k ---> previous nodes ---> ... along reversed shared edges
        #
        num_nodes, searches = len(self.q), np.arange(len(rows))
        goals = self.terminals.node[rows, 1]
        # 1. Find the edges into each goal.
        terminal_edges, search = take_ragged(self.first_terminal_edge, rows)
        into_goal = self.end[terminal_edges] == goals[search]
        # 2. Build the graph of reversed edges, and search from all extra nodes.
        shared = self._cheapest_shared_edges
        edge = np.append(shared, terminal_edges[into_goal])
        end = np.append(self.end[shared], num_nodes + search[into_goal])
        graph = csr_array((self.edge_cost[edge], (end, self.begin[edge])), shape=(num_nodes + len(rows),) * 2)
        costs = csgraph.dijkstra(graph, indices=num_nodes + searches)[:, :num_nodes]
        costs[searches, goals] = 0.0
        return costs

    def costs_to_come(self, row: int | np.integer) -> Float[np.ndarray, " nodes"]:
        """Return the least cost from the start of robot ``members[row]`` to each node, along shared edges.

        Shared edges do not enter the goal, so the goal's cost is ``inf`` unless the goal is the start.
        """
        edge = self._cheapest_shared_edges
        graph = csr_array((self.edge_cost[edge], (self.begin[edge], self.end[edge])), shape=(len(self.q),) * 2)
        return csgraph.dijkstra(graph, indices=self.terminals.node[row, 0])


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


class JointLattice:
    """The lattices of all robots, grouped by kind (robots of equal shape and rotation weight), and a motion test.

    A *joint state* has a node for each robot, and a joint motion a primitive for each robot. Cells are at most
    ``step`` wide, in workspace units. A turn from a cell to the next one moves no point of a robot by more than
    ``step``, and is at most an eighth of a full turn. Robots of one kind share arrays.
    """

    def __init__(self, problem: Problem, step: float, test: JointMotionTest):
        self.problem, self.step, self.test = problem, step, test
        self.kinds: list[Kind] = []
        for (robot, weight), members in robot_kinds(problem).items():
            starts, goals = (q[members, : robot.dof] for q in (problem.starts, problem.goals))
            grid = cell_grid(problem.workspace, robot, weight, step, test.deadline)
            self.kinds.append(grid.with_terminals(robot, np.array(members), starts, goals))
        lattices = {i: Lattice(kind, row) for kind in self.kinds for row, i in enumerate(kind.members.tolist())}
        self.lattices = [lattices[i] for i in range(len(problem.robots))]

    @cached_property
    def costs_to_go(self) -> list[Table]:
        """For each robot, a table of the least costs from the nodes of its lattice to its goal.

        Other robots are ignored.
        """
        costs = {}
        for kind in self.kinds:
            # A batch has the goals of one call of Dijkstra's algorithm.
            for rows in batches(np.arange(len(kind.members)), int(np.clip(_NODES // len(kind.q), 1, _GOALS))):
                require_time(self.test.deadline, "the costs-to-go were known", _SECONDS * len(kind.q))
                costs.update(zip(kind.members[rows].tolist(), kind.costs_to_go(rows), strict=True))
        return [costs[i] for i in range(len(self.lattices))]

    @property
    def least_costs(self) -> Float[np.ndarray, " robots"]:
        """For each robot, the least cost on its lattice from its start to its goal; other robots are ignored."""
        return np.array([cost[lattice.start] for cost, lattice in zip(self.costs_to_go, self.lattices, strict=True)])

    def configurations(self, state: State) -> Float[np.ndarray, "n robots dof"]:
        """Return the joint configurations of joint states; a robot without a heading keeps that of its start."""
        q = np.repeat(self.problem.starts[None], len(state), axis=0)
        for i, lattice in enumerate(self.lattices):
            q[:, i, : lattice.q.shape[1]] = lattice.q[state[:, i]]
        return q

    def move(self, state: State, primitive: UInt8[np.ndarray, "n robots"]) -> tuple[State, Float[np.ndarray, " n"]]:
        """Return the joint states to which the robots' primitives (motions or stays) lead, and their total costs."""
        columns = list(zip(self.lattices, state.T, primitive.T, strict=True))
        child = np.stack([lattice.child[s, p] for lattice, s, p in columns], axis=1)
        return child, np.sum([lattice.cost[s, p] for lattice, s, p in columns], axis=0)

    def collisions(self, i: int, j: int, state: State) -> Collisions:
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
