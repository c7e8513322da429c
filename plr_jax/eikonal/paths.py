"""Short paths from the nodes of a mesh to the nearest goal, through free cells: upper bounds of the cost-to-go.

Dijkstra's algorithm finds shortest paths in the graph that joins the corners of each free cell. Then, as in "Theta*:
any-angle path planning on grids" (Nash, Daniel, Koenig, Felner 2007), a node skips the next node of its path, or
takes the next node of a neighbor's path, if the straight motion there stays in free cells and costs less. If a goal's
cell is not free, motions that the space proves free join the goal to nodes near it.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csc_array
from scipy.sparse.csgraph import dijkstra

from plr_jax._arrays import parts, ragged_indices
from plr_jax.eikonal.goals import Points
from plr_jax.eikonal.mesh import Mesh
from plr_jax.eikonal.program import CellCosts
from plr_jax.plr.tree import corner_bits
from plr_jax.spaces import CellState, ConfigurationSpace, cost_bounds, pulled

# Most rounds of straightening, and the share of all costs that a round must gain for another one.
_ROUNDS, _ENOUGH = 24, 1e-4
_GAIN = 1e-9  # share of a path's cost that a change of the path must save
_AHEAD = 2.0**-44  # distance beyond a face at which the next cell is located, as a share of the domain
_ROUNDING = 1e-10  # share by which upper bounds are increased, for rounding
_EDGES_AT_ONCE = 1 << 18  # edges handled together, to bound the memory
# Most nodes, the nearest ones, that are joined to goals whose cells are not free; least number for each goal.
_NEAR_GOAL, _LEAST_NEAR_GOAL = 512, 32
Nodes: TypeAlias = Int[np.ndarray, " _"]
Costs: TypeAlias = Float[np.ndarray, " nodes"]
Edges: TypeAlias = Int[np.ndarray, " _"]
EdgeCosts: TypeAlias = Float[np.ndarray, " _"]


@dataclass(frozen=True, eq=False)
class NodePaths:
    """Paths from the corners of a mesh's cells (the nodes) to the nearest goal; all motions are proven free."""

    points: Float[np.ndarray, "nodes dim"]  # the nodes as fractions of the domain, then the goals
    cost: Costs  # of each node's path, rounded up; inf if none was found
    next: Nodes  # the second node of each path; for a goal, itself; without a path, the first goal

    @property
    def ends(self) -> Nodes:
        """The goal at the end of each node's path, as a row of ``points``; the first goal if a node has no path."""
        ends = self.next
        while (ends != ends[ends]).any():
            ends = ends[ends]
        return ends


def graph_costs(mesh: Mesh, costs: CellCosts, goals: Points, space: ConfigurationSpace) -> Costs:
    """Return the costs of shortest paths from corners of cells to the nearest goal, along edges proven free.

    Edges lie within free cells, except edges to goals whose cell is not free. Costs are ``inf`` without a path.
    """
    return _path_costs(*_FreeGraph(mesh, costs, goals, space).cheapest_edges())[: len(mesh.nodes)]


def shortest_paths(mesh: Mesh, costs: CellCosts, goals: Points, space: ConfigurationSpace) -> NodePaths:
    """Find short paths from corners of a mesh's cells (nodes) to the nearest goal; all motions are proven free."""
    graph = _FreeGraph(mesh, costs, goals, space)
    next_, leg = graph.cheapest_edges()
    cost, node = _path_costs(next_, leg), np.arange(len(next_))
    tested, bound = np.full((2, len(next_)), -1), np.full((2, len(next_)), np.inf)  # last targets, and their costs
    for _ in range(_ROUNDS):
        before = cost
        for kind in range(2):
            ahead = next_[next_] if kind == 0 else graph.next_of_neighbors(cost, next_)
            gains = graph.lower_bounds(node, ahead) + cost[ahead] < (1 - _GAIN) * cost
            straight = np.where(gains & (ahead == tested), bound, np.inf).min(axis=0)
            some = np.flatnonzero(gains & (ahead != tested).all(axis=0))
            straight[some] = bound[kind, some] = graph.upper_bounds(some, ahead[some])
            tested[kind, some] = ahead[some]
            better = straight + cost[ahead] < (1 - _GAIN) * cost
            next_, leg = np.where(better, ahead, next_), np.where(better, straight, leg)
            cost = _path_costs(next_, leg)
        is_reached = np.isfinite(cost)
        if np.sum(before[is_reached] - cost[is_reached]) <= _ENOUGH * np.sum(cost[is_reached]):
            break
    return NodePaths(graph.points, (1 + _ROUNDING) * cost, next_)


def _path_costs(next_: Nodes, leg: Costs) -> Costs:
    # leg: cost of the edge from each node to the next node of its path.
    cost = leg
    while (next_ != next_[next_]).any():
        cost, next_ = cost + cost[next_], next_[next_]
    return cost


class _FreeGraph:
    """A graph of the corners of cells and the goals, whose edges are straight motions that are proven free."""

    def __init__(self, mesh: Mesh, costs: CellCosts, goals: Points, space: ConfigurationSpace):
        self.mesh, self.costs, num = mesh, costs, len(mesh.nodes)
        self.points, self.goals = np.append(mesh.nodes, goals, axis=0), num + np.arange(len(goals))
        homes = mesh.locate(goals)
        edges = list(self._edges(homes))
        for goal in self.goals[mesh.state[homes] != CellState.FREE]:
            # Nodes near the goal from which the straight motion is free, and upper bounds of its cost.
            change = self._changes(np.arange(num), np.full(num, goal))
            most = max(_NEAR_GOAL // len(goals), _LEAST_NEAR_GOAL)
            near = np.argsort(costs.motion_cost.norm(change), kind="stable")[:most]
            q, change = mesh.domain.at(self.points[near]), change[near]
            free = np.flatnonzero(space.are_free(q, q + change))
            q, change, straight = q[free], change[free], costs.motion_cost.norm(change[free])
            if costs.cost_map is not None:
                box = np.minimum(q, q + change), np.maximum(q, q + change)
                _, upper, pulls = cost_bounds(costs.motion_cost, costs.cost_map, *box)
                straight = straight * upper + pulled(pulls, change)
            edges.append((near[free].astype(np.int32), np.full(len(free), goal, np.int32), straight))
        begin, end, cost = (np.concatenate(column) for column in zip(*edges, strict=True))
        order = np.argsort(begin, kind="stable")
        self.begin, self.end, self.cost = begin[order], end[order], cost[order]
        self.first = np.flatnonzero(np.diff(self.begin, prepend=-1))  # the first edge of each node

    def _changes(self, begin: Edges, end: Edges) -> Float[np.ndarray, "edges dim"]:
        change = self.points[end] - self.points[begin]
        return (change - np.where(self.mesh.domain.periodic, np.rint(change), 0.0)) * self.mesh.domain.width

    def _edges(self, homes: Nodes) -> Iterator[tuple[Edges, Edges, EdgeCosts]]:
        """Yield the edges within free cells, as both ends and cost; ``homes`` are the cells of goals."""
        mesh = self.mesh
        is_free = mesh.state == CellState.FREE
        nodes, cells = [self.goals[is_free[homes]]], [homes[is_free[homes]]]
        for axis, bits in enumerate(corner_bits(mesh.dim).T):  # corners of a cell that hang on a larger cell
            faces = mesh.open_faces[mesh.open_faces.axis == axis]
            for cell, other, end in ((faces.lower, faces.upper, 1), (faces.upper, faces.lower, 0)):
                hangs = (
                    (mesh.cells.depth[cell] > mesh.cells.depth[other]).any(axis=1) & is_free[cell] & is_free[other]
                )
                on_face = mesh.corners[cell[hangs]][:, bits == end]
                owner = np.repeat(other[hangs], on_face.shape[1])
                t = mesh.within(owner, self.points[on_face.ravel()])
                touches = ((t >= 0) & (t <= 1)).all(axis=1)  # where long cells cross, some corners lie beyond
                nodes.append(on_face.ravel()[touches])
                cells.append(owner[touches])
        hanging = np.unique(np.concatenate(cells) * len(self.points) + np.concatenate(nodes))
        cell, node = np.divmod(hanging, len(self.points))
        num, free = mesh.corners.shape[1], np.flatnonzero(is_free)
        in_cells = np.append(mesh.corners, node)  # corners of all cells, then hanging nodes by cell
        first = mesh.corners.size + np.searchsorted(cell, np.arange(len(mesh.state) + 1))
        # Corners have edges to all nodes of a cell, hanging nodes to its corners.
        begin, owner = np.append(mesh.corners[free], node), np.append(np.repeat(free, num), cell)
        count = num + np.append(np.repeat(np.diff(first)[free], num), np.zeros_like(cell))
        order = np.argsort(begin, kind="stable")
        begin, owner, count = begin[order], owner[order], count[order]
        for some in parts(np.bincount(begin, count, len(self.points)).astype(np.int64), _EDGES_AT_ONCE):
            rows = slice(*np.searchsorted(begin, [some.start, some.stop]))
            row, place = ragged_indices(count[rows])
            a, c = begin[rows][row], owner[rows][row]
            b = in_cells[np.where(place < num, c * num + place, first[c] + place - num)]
            a, b, c = (column[a != b] for column in (a, b, c))
            change = self._changes(a, b)
            middle = mesh.within(c, self.points[a]) + np.ldexp(change / mesh.domain.width, mesh.cells.depth[c]) / 2
            cost = self.costs.of_motions(change, c, middle)
            order = np.lexsort((cost, b, a))
            order = order[np.diff(a[order] * len(self.points) + b[order], prepend=-1) != 0]  # the cheapest of several
            yield a[order].astype(np.int32), b[order].astype(np.int32), cost[order]

    def cheapest_edges(self) -> tuple[Nodes, Costs]:
        """Return the second node of each node's shortest path to a goal, and the cost of the edge to it."""
        num = len(self.points)
        graph = csc_array((self.cost, self.end, np.searchsorted(self.begin, np.arange(num + 1))), (num, num))
        cost, previous, _ = dijkstra(graph, indices=self.goals, return_predecessors=True, min_only=True)
        next_ = np.where(previous < 0, self.goals[0], previous)
        next_[self.goals] = self.goals
        leg = np.where(np.isfinite(cost), cost - cost[next_], np.inf)
        leg[self.goals] = 0.0
        return next_, leg

    def next_of_neighbors(self, cost: Costs, next_: Nodes) -> Nodes:
        # The node after a neighbor on its path: of all neighbors, the cheapest way on if walls are ignored.
        best, bounds = next_.copy(), np.append(self.first, len(self.end))
        counts = np.diff(bounds)
        for some in parts(counts, _EDGES_AT_ONCE):
            edges = slice(bounds[some.start], bounds[some.stop])
            begin, ahead = self.begin[edges], next_[self.end[edges]]
            total = self.lower_bounds(begin, ahead) + cost[ahead]
            least = np.minimum.reduceat(total, self.first[some] - edges.start)
            is_best = np.flatnonzero(total == np.repeat(least, counts[some]))
            best[begin[is_best]] = ahead[is_best]
        return best

    def lower_bounds(self, begin: Edges, end: Edges) -> EdgeCosts:
        return self.costs.motion_cost.norm(self._changes(begin, end)) * self.costs.least_rate

    def upper_bounds(self, begin: Edges, end: Edges) -> EdgeCosts:
        """Return upper bounds of the costs of straight motions; ``inf`` for a motion that leaves the free cells."""
        x = self.points[begin]
        change = self._changes(begin, end)
        mesh, total, t = self.mesh, np.zeros(len(x)), np.zeros(len(x))
        length, rate = self.costs.motion_cost.norm(change), change / mesh.domain.width
        rate[np.abs(rate) < _AHEAD] = 0.0  # else steps along a face would be rounding errors
        ahead = _AHEAD / np.maximum(np.abs(rate).max(axis=1, initial=0.0), _AHEAD)
        moving = np.flatnonzero(length > 0)
        while len(moving):
            position = x[moving] + np.minimum(t[moving] + ahead[moving], 1.0)[:, None] * rate[moving]
            position = np.where(mesh.domain.periodic, position % 1.0, position)
            cell = mesh.locate(position)
            is_free = mesh.state[cell] == CellState.FREE
            total[moving[~is_free]] = np.inf
            moving, position, cell = moving[is_free], position[is_free], cell[is_free]
            within, speed = mesh.local(cell, position), np.ldexp(rate[moving], mesh.cells.depth[cell])
            with np.errstate(divide="ignore", invalid="ignore"):
                to_face = np.where(speed > 0, (1 - within) / speed, np.where(speed < 0, -within / speed, np.inf))
            step = np.minimum(t[moving] + ahead[moving] + np.maximum(to_face.min(axis=1), 0.0), 1.0) - t[moving]
            middle = within + speed * (step / 2 - ahead[moving])[:, None]
            total[moving] += self.costs.of_motions(step[:, None] * change[moving], cell, middle)
            t[moving] += step
            moving = moving[t[moving] < 1.0]
        return total
