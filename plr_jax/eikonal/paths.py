"""Short paths from the nodes of a mesh to the nearest goal, through free cells: upper bounds of the cost-to-go.

Dijkstra's algorithm finds shortest paths in the graph that joins the corners of each free cell. Then paths are
straightened: a path skips a node, or continues at the next node of a neighbor's path. Such a change requires that the
new straight motion stays in free cells, and that the path becomes cheaper. If a goal's cell is not free, motions that
the space proves free join the goal to nearby nodes. Reference: Nash, Daniel, Koenig, Felner, "Theta*: any-angle path
planning on grids", 2007.
"""

from collections.abc import Iterator
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csc_array

from plr_jax._arrays import parts, ragged_indices
from plr_jax.eikonal.goals import Points, nearest_goals
from plr_jax.eikonal.mesh import Mesh
from plr_jax.eikonal.program import CellCosts
from plr_jax.geometry.graph import dijkstra, path_ends
from plr_jax.plr.tree import corner_bits
from plr_jax.spaces import CellState, ConfigurationSpace
from plr_jax.spaces._costs import cost_bounds, pulled

_MOST_ROUNDS = 24  # rounds of straightening
_ENOUGH = 1e-4  # share of all costs that a round must save, else it is the last round
_GAIN = 1e-9  # share of a path's cost that a change of the path must save: more than rounding errors
_AHEAD = 2.0**-44  # distance beyond a face at which the next cell is located, as a share of the domain
_ROUNDING = 1e-10  # share by which upper bounds are increased: more than rounding errors
_EDGES_AT_ONCE = 1 << 18  # edges handled together, to bound the memory
_MOST_NEAR_GOALS = 512  # nearest nodes that are joined to goals whose cells are not free, for all goals together
_LEAST_NEAR_GOAL = 32  # the same for one goal, if there are many goals
Nodes: TypeAlias = Int[np.ndarray, " _"]
Costs: TypeAlias = Float[np.ndarray, " nodes"]
EdgeCosts: TypeAlias = Float[np.ndarray, " _"]
Edges: TypeAlias = tuple[Nodes, Nodes, EdgeCosts]  # where edges begin and end, and their costs


class NodePaths(NamedTuple):
    """Paths from the corners of a mesh's cells (the nodes) to the nearest goal; all motions are proven free."""

    points: Float[np.ndarray, "nodes dim"]  # the nodes as fractions of the domain, then the goals
    cost: Costs  # of each node's path, rounded up; inf if none was found
    next: Nodes  # the second node of each path; for a goal, itself; without a path, the first goal
    ends: Nodes  # the goal at the end of each path; without a path, the first goal

    def which(self, mesh: Mesh, costs: CellCosts, x: Points) -> Nodes:
        """Return the index of the goal to which the path from each point leads, over a corner of the point's cell."""
        # 1. The cheapest path over a corner, with straight motions to corners at the least rate.
        domain, num = mesh.domain, len(mesh.nodes)
        node = mesh.corners[mesh.locate((domain.wrapped(x) - domain.lo) / domain.width)]
        offset = domain.difference(domain.at(mesh.nodes[node]), x[:, None])
        straight = costs.motion_cost.norm(offset.reshape(-1, mesh.dim)).reshape(node.shape)
        total = self.cost[node] + straight * costs.least_rate
        best = node[np.arange(len(x)), total.argmin(axis=1)]
        # 2. The nearest goal counts if a straight motion there costs no more at the least rate, or without a path.
        distance, nearest = nearest_goals(domain.at(self.points[num:]), domain, costs.motion_cost, x)
        is_near = distance[:, 0] * costs.least_rate <= total.min(axis=1)
        return np.where(is_near | np.isinf(self.cost[best]), nearest[:, 0], self.ends[best] - num)


def graph_costs(mesh: Mesh, costs: CellCosts, goals: Points, space: ConfigurationSpace) -> Costs:
    """Return the costs of shortest paths from corners of cells to the nearest goal, along edges proven free.

    Edges lie within free cells, except edges to goals whose cell is not free. Costs are ``inf`` without a path.
    """
    return _path_costs(*_FreeGraph(mesh, costs, goals, space).cheapest_edges())[: len(mesh.nodes)]


def shortest_paths(mesh: Mesh, costs: CellCosts, goals: Points, space: ConfigurationSpace) -> NodePaths:
    """Find short paths from corners of a mesh's cells (nodes) to the nearest goal; all motions are proven free."""
    graph = _FreeGraph(mesh, costs, goals, space)
    next_, leg = graph.cheapest_edges()
    cost = _path_costs(next_, leg)
    # For each kind of change (row) and each node: the target that was tested last, and the cost of the motion to it.
    tested, cost_to_tested = np.full((2, len(next_)), -1), np.full((2, len(next_)), np.inf)
    for _ in range(_MOST_ROUNDS):
        before = cost
        for kind in range(2):
            # 1. Choose a target for each node: kind 0 skips the next node, kind 1 follows a neighbor's path.
            target = graph.next_of_neighbors(cost, next_) if kind else next_[next_]
            may_save = graph.lower_bounds(np.arange(len(next_)), target) + cost[target] < (1 - _GAIN) * cost
            # 2. Find the cost of the straight motion there: look it up, else test the motion.
            straight = np.where(may_save & (target == tested), cost_to_tested, np.inf).min(axis=0)
            new = np.flatnonzero(may_save & (target != tested).all(axis=0))
            straight[new] = cost_to_tested[kind, new] = graph.upper_bounds(new, target[new])
            tested[kind, new] = target[new]
            # 3. Change all paths that become cheaper. By the costs before this change, a new edge leads to a node
            #    of less cost, and no old edge to a node of more cost. So a cycle would consist of old edges only, and
            #    old edges form no cycle.
            is_better = straight + cost[target] < (1 - _GAIN) * cost
            next_, leg = np.where(is_better, target, next_), np.where(is_better, straight, leg)
            cost = _path_costs(next_, leg)
        is_reached = np.isfinite(cost)
        if np.sum(before[is_reached] - cost[is_reached]) <= _ENOUGH * np.sum(cost[is_reached]):
            break
    return NodePaths(graph.points, (1 + _ROUNDING) * cost, next_, path_ends(next_))


def _path_costs(next_: Nodes, leg: Costs) -> Costs:
    # `leg` is the cost of the edge from each node to the next node of its path. Pointer doubling: after k rounds,
    # `next_` is the node 2**k edges ahead, and `cost` the cost of the path to it. A goal's edge to itself costs 0.
    cost = leg
    while (next_ != next_[next_]).any():
        cost, next_ = cost + cost[next_], next_[next_]
    return cost


class _FreeGraph:
    """A graph of the corners of cells and the goals, whose edges are straight motions that are proven free."""

    def __init__(self, mesh: Mesh, costs: CellCosts, goals: Points, space: ConfigurationSpace):
        self.mesh, self.costs = mesh, costs
        self.points = np.append(mesh.nodes, goals, axis=0)
        self.goals = len(mesh.nodes) + np.arange(len(goals))
        goal_cells = mesh.locate(goals)
        edges = list(self._edges_in_cells(goal_cells))
        is_free = mesh.state[goal_cells] == CellState.FREE
        edges += [self._edges_to(goal, space) for goal in self.goals[~is_free].tolist()]
        begin, end, cost = (np.concatenate(column) for column in zip(*edges, strict=True))
        order = np.argsort(begin, kind="stable")
        self.begin, self.end, self.cost = begin[order], end[order], cost[order]
        # The first edge of each node that has edges, then the number of edges.
        self.first = np.append(np.flatnonzero(np.diff(self.begin, prepend=-1)), len(self.end))

    def _changes(self, begin: Nodes, end: Nodes) -> Float[np.ndarray, "edges dim"]:
        change = self.points.take(end, axis=0) - self.points.take(begin, axis=0)  # faster than indexing
        return (change - np.rint(change) * self.mesh.domain.periodic) * self.mesh.domain.width

    def _edges_to(self, goal: int, space: ConfigurationSpace) -> Edges:
        """Return edges from nearby nodes (corners of cells) to a goal whose cell is not free.

        The ``space`` proves that the motion along each edge is free. ``goal`` is the goal's index in ``points``.
        """
        num, motion_cost = len(self.mesh.nodes), self.costs.motion_cost
        change = self._changes(np.arange(num), np.full(num, goal))
        most = max(_MOST_NEAR_GOALS // len(self.goals), _LEAST_NEAR_GOAL)
        near = np.argsort(motion_cost.norm(change), kind="stable")[:most]
        q = self.mesh.domain.at(self.points[near])
        free = np.flatnonzero(space.are_free(q, q + change[near]))
        near, q = near[free], q[free]
        change = change[near]
        lo, hi = np.minimum(q, q + change), np.maximum(q, q + change)
        _, upper, pulls = cost_bounds(motion_cost, self.costs.cost_map, lo, hi)
        cost = motion_cost.norm(change) * upper + pulled(pulls, change)
        return near.astype(np.int32), np.full(len(near), goal, np.int32), cost

    def _edges_in_cells(self, goal_cells: Nodes) -> Iterator[Edges]:
        """Yield the edges within free cells; ``goal_cells`` are the cells of the goals.

        The nodes of a free cell are its corners (``+``), and the corners of smaller free cells on its faces (``o``),
        which *hang* on the cell. Goals in the cell count as hanging nodes. No edge joins two hanging nodes::

            +-------+---+
            |       |   |
            |       o---+
            |       |   |
            +-------+---+
        """
        mesh = self.mesh
        is_free = mesh.state == CellState.FREE
        # 1. Find the hanging nodes of each free cell.
        nodes, cells = [self.goals[is_free[goal_cells]]], [goal_cells[is_free[goal_cells]]]
        faces = mesh.open_faces[is_free[mesh.open_faces.lower] & is_free[mesh.open_faces.upper]]
        for cell, other, end in ((faces.lower, faces.upper, 1), (faces.upper, faces.lower, 0)):
            is_smaller = np.any(mesh.cells.depth[cell] > mesh.cells.depth[other], axis=1, keepdims=True)
            face, corner = np.nonzero(is_smaller & (corner_bits(mesh.dim).T[faces.axis] == end))
            node, owner = mesh.corners[cell[face], corner], other[face]
            t = mesh.within(owner, self.points[node])
            touches = ((t >= 0) & (t <= 1)).all(axis=1)  # where long cells cross, some corners lie beyond
            nodes.append(node[touches])
            cells.append(owner[touches])
        by_cell = np.unique(np.concatenate(cells) * len(self.points) + np.concatenate(nodes))
        owner, hanging = np.divmod(by_cell, len(self.points))

        # 2. List the nodes of all cells: `num` corners for each cell, then the hanging nodes of each cell. The
        #    hanging nodes of cell c have the places from `first_hanging[c]` up to `first_hanging[c + 1]`.
        num = mesh.corners.shape[1]
        nodes_of_cells = np.append(mesh.corners, hanging)
        first_hanging = mesh.corners.size + np.searchsorted(owner, np.arange(len(mesh.state) + 1))

        # 3. List the fans, each of all edges from one node in one cell: a corner has edges to all nodes of the cell
        #    (and to itself, removed below), a hanging node to the corners.
        fan_node = np.append(mesh.corners[is_free], hanging)
        fan_cell = np.append(np.repeat(np.flatnonzero(is_free), num), owner)
        fan_size = num + np.append(np.repeat(np.diff(first_hanging)[is_free], num), np.zeros_like(owner))
        order = np.argsort(fan_node, kind="stable")
        fan_node, fan_cell, fan_size = fan_node[order], fan_cell[order], fan_size[order]

        # 4. For some nodes at a time, bound the edges' costs. An edge in several cells has the least of its bounds.
        for some in parts(np.bincount(fan_node, fan_size, len(self.points)).astype(np.int64), _EDGES_AT_ONCE):
            fans = slice(*np.searchsorted(fan_node, [some.start, some.stop]))
            fan, place = ragged_indices(fan_size[fans])
            begin, cell = fan_node[fans][fan], fan_cell[fans][fan]
            end = nodes_of_cells[np.where(place < num, cell * num + place, first_hanging[cell] + place - num)]
            begin, end, cell = (column[begin != end] for column in (begin, end, cell))
            change = self._changes(begin, end)
            half = np.ldexp(change / mesh.domain.width, mesh.cells.depth[cell]) / 2
            middle = mesh.within(cell, self.points[begin]) + half  # of each motion, in local coordinates of its cell
            cost = self.costs.of_motions(change, cell, middle)
            order = np.lexsort((cost, end, begin))
            order = order[np.diff(begin[order] * len(self.points) + end[order], prepend=-1) != 0]
            yield begin[order].astype(np.int32), end[order].astype(np.int32), cost[order]

    def cheapest_edges(self) -> tuple[Nodes, Costs]:
        """Return, for each node, the next node on its shortest path to a goal, and the cost of the edge between them.

        A goal's next node is the goal itself. Without a path, the next node is the first goal, and the cost ``inf``.
        """
        num = len(self.points)
        # An edge from a to b is in column a and row b: it is reversed, as Dijkstra's algorithm starts at the goals.
        # So a node's predecessor is the next node of its path.
        graph = csc_array((self.cost, self.end, np.searchsorted(self.begin, np.arange(num + 1))), (num, num)).tocsr()
        cost, previous = dijkstra(graph, self.goals)
        next_ = np.where(previous < 0, self.goals[0], previous)
        next_[self.goals] = self.goals
        return next_, np.where(np.isfinite(cost), cost - cost[next_], np.inf)

    def next_of_neighbors(self, cost: Costs, next_: Nodes) -> Nodes:
        # For each node, return the next node of a neighbor's path: of all neighbors, the one for which the cost of
        # that next node, plus a lower bound of the cost of the motion to it, is least. The motion may cross walls.
        best = next_.copy()
        counts = np.diff(self.first)
        for some in parts(counts, _EDGES_AT_ONCE):
            edges = slice(self.first[some.start], self.first[some.stop])
            begin, target = self.begin[edges], next_[self.end[edges]]
            total = self.lower_bounds(begin, target) + cost[target]
            least = np.minimum.reduceat(total, self.first[some] - edges.start)
            is_best = np.flatnonzero(total == np.repeat(least, counts[some]))
            best[begin[is_best]] = target[is_best]
        return best

    def lower_bounds(self, begin: Nodes, end: Nodes) -> EdgeCosts:
        return self.costs.motion_cost.norm(self._changes(begin, end)) * self.costs.least_rate

    def upper_bounds(self, begin: Nodes, end: Nodes) -> EdgeCosts:
        """Return upper bounds of the costs of straight motions from nodes ``begin`` to nodes ``end``.

        The bound is ``inf`` for a motion that leaves the free cells.
        """
        # Walk from cell to cell. A motion takes the time t from 0 to 1; `velocity` is its change per unit of time, in
        # fractions of the domain. Its cell at t is the cell of its place at t + ahead: at a face, the cell that it
        # enters counts.
        #     within   local coordinates in this cell at t + ahead
        #     speed    their change per unit of time
        #     to_face  time from t + ahead to the cell's face, for each axis
        #     step     time from t to the first face, or to the end of the motion
        #     middle   local coordinates at t + step / 2
        mesh = self.mesh
        change = self._changes(begin, end)
        velocity = change / mesh.domain.width
        velocity[np.abs(velocity) < _AHEAD] = 0.0  # else steps along a face would be rounding errors
        ahead = _AHEAD / np.maximum(np.abs(velocity).max(axis=1, initial=0.0), _AHEAD)
        total, t = np.zeros((2, len(begin)))
        moving = np.flatnonzero(self.costs.motion_cost.norm(change) > 0)
        while len(moving):
            position = self.points[begin[moving]] + np.minimum(t + ahead, 1.0)[moving, None] * velocity[moving]
            position = np.where(mesh.domain.periodic, position % 1.0, position)
            cell = mesh.locate(position)
            is_free = mesh.state[cell] == CellState.FREE
            total[moving[~is_free]] = np.inf
            moving, position, cell = moving[is_free], position[is_free], cell[is_free]
            within = mesh.local(cell, position)
            speed = np.ldexp(velocity[moving], mesh.cells.depth[cell])
            # The face ahead is at 1 along axes of positive speed, at 0 along axes of negative speed.
            to_face = np.divide((speed > 0) - within, speed, out=np.full_like(speed, np.inf), where=speed != 0)
            step = np.minimum(t[moving] + ahead[moving] + np.maximum(to_face.min(axis=1), 0.0), 1.0) - t[moving]
            middle = within + speed * (step / 2 - ahead[moving])[:, None]
            total[moving] += self.costs.of_motions(step[:, None] * change[moving], cell, middle)
            t[moving] += step
            moving = moving[t[moving] < 1.0]
        return total
