"""Cheaper paths on the lattices: robots planned anew among the others, which keep their motions."""

import time

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from plr_jax._arrays import runs
from plr_jax.collision.pairs import motions_apart
from plr_jax.planners.lacam.moves import Kind


class KindEdges:
    """The motions of a kind of robot as edges of a graph: those all share, then those into the ends of each."""

    def __init__(self, kind: Kind):
        table = kind.table
        self.kind, self.num_nodes = kind, len(table.q)
        begin, primitive = np.nonzero(np.isfinite(table.cost))
        end, cost = table.child[begin, primitive], table.cost[begin, primitive]
        self.num_shared = len(begin)
        parts = [(begin, end, cost)]
        first, self.own = self.num_shared, []
        for row in range(len(kind.members)):
            count = 0
            for which in range(2):
                rows, p = np.nonzero(table.child == kind.cell[row, which])
                other = kind.node[row, 1 - which]
                from_cell = rows < table.num_cells
                keep = from_cell | (rows == other)
                rows, p, from_cell = rows[keep], p[keep], from_cell[keep]
                entry = kind.entry[row, which, np.where(from_cell, 0, 1), p]
                free = np.isfinite(entry)
                parts.append((rows[free], np.full(free.sum(), kind.node[row, which]), entry[free]))
                count += int(free.sum())
            self.own.append(np.arange(first, first + count))
            first += count
        begin, end, cost = (np.concatenate(column) for column in zip(*parts, strict=True))
        self.begin, self.end, self.cost = np.append(begin, 0), np.append(end, 0), np.append(cost, np.inf)
        self.none = len(begin)
        order = np.argsort(self.begin[:-1], kind="stable")
        self.by_begin = order
        self.first = np.searchsorted(self.begin[:-1][order], np.arange(self.num_nodes + 1))
        self.keys = self.begin[:-1] * self.num_nodes + self.end[:-1]
        self.key_order = np.lexsort((self.cost[:-1], self.keys))
        self.sorted_keys = self.keys[self.key_order]
        self.tree = cKDTree(table.q[:, :2])
        self.entering = self._entering()

    def _entering(self) -> Int[np.ndarray, "k nodes"]:
        """The shared edges that end in each node, filled up with one that is blocked."""
        shared = np.arange(self.num_shared)
        order = np.argsort(self.end[shared], kind="stable")
        end = self.end[order]
        rank = np.arange(len(end)) - np.searchsorted(end, end)
        most = max(int(rank.max()) + 1, max((len(own) for own in self.own), default=0) + 1)
        entering = np.full((most, self.num_nodes), self.none)
        entering[rank, end] = order
        return entering

    def entering_of(self, row: int) -> Int[np.ndarray, "k nodes"]:
        """The edges that end in each node for one robot."""
        entering = self.entering.copy()
        entering[:, self.kind.cell[row]] = self.none
        for node in self.kind.node[row]:
            into = self.own[row][self.end[self.own[row]] == node]
            entering[1 : 1 + len(into), node] = into
        return entering

    def edges_of(self, nodes: Int[np.ndarray, "steps"]) -> Int[np.ndarray, "motions"]:
        """The cheapest edges along a path."""
        keys = nodes[:-1] * self.num_nodes + nodes[1:]
        return self.key_order[np.searchsorted(self.sorted_keys, keys)]

    def reach(self) -> float:
        q = self.kind.table.q
        away = q[self.end[:-1], :2] - q[self.begin[:-1], :2]
        return float(np.hypot(*away.T).max())


class Conflicts:
    """Which edges of one kind collide with those of another, found when first asked for."""

    def __init__(self, edges: list[KindEdges], tolerance: float):
        self.edges, self.tolerance = edges, tolerance
        self.known: dict[tuple[int, int], dict[int, np.ndarray]] = {
            (a, b): {} for a in range(len(edges)) for b in range(len(edges))
        }
        self.reach = [each.kind.robot.circumscribed_radius + each.reach() for each in edges]

    def of(self, a: int, edges: Int[np.ndarray, "m"], b: int) -> list[np.ndarray]:
        """Edges of kind ``b`` that collide with edges of kind ``a``."""
        known = self.known[a, b]
        wanted = edges.tolist()
        missing = np.array(sorted({edge for edge in wanted if edge not in known}), dtype=np.intp)
        for begin in range(0, len(missing), 256):
            self._find(a, missing[begin : begin + 256], b)
        return [known[edge] for edge in wanted]

    def _find(self, a: int, missing: np.ndarray, b: int) -> None:
        ours, others = self.edges[a], self.edges[b]
        q = ours.kind.table.q
        begin, end = q[ours.begin[missing]], q[ours.end[missing]]
        near = others.tree.query_ball_point(begin[:, :2], self.reach[a] + self.reach[b])
        count = np.array([len(nodes) for nodes in near])
        row = np.repeat(np.arange(len(missing)), count)
        node = np.concatenate([np.array(nodes, dtype=np.intp) for nodes in near])
        num = others.first[node + 1] - others.first[node]
        k, step = runs(num)
        row, edge = row[k], others.by_begin[others.first[node][k] + step]
        p = others.kind.table.q
        apart = motions_apart(
            ours.kind.robot,
            begin[row],
            end[row],
            others.kind.robot,
            p[others.begin[edge]],
            p[others.end[edge]],
            self.tolerance,
        )
        row, edge = row[~apart], edge[~apart]
        bounds = np.searchsorted(row, np.arange(len(missing) + 1))
        for i, motion in enumerate(missing.tolist()):
            self.known[a, b][motion] = edge[bounds[i] : bounds[i + 1]].astype(np.int32)


class Timetable:
    """The paths of a team on its lattices, and which edges they block at which time."""

    def __init__(self, kinds: list[Kind], state: Int[np.ndarray, "steps robots"], tolerance: float):
        self.edges = [KindEdges(kind) for kind in kinds]
        self.conflicts = Conflicts(self.edges, tolerance)
        self.state = state.copy()
        self.steps = len(state) - 1
        self.place = {int(i): (k, row) for k, kind in enumerate(kinds) for row, i in enumerate(kind.members)}
        self.blocked = [np.zeros((self.steps, len(edges.begin)), dtype=np.uint16) for edges in self.edges]
        self.cost = np.array([self._cost(i) for i in range(state.shape[1])])
        for i in range(state.shape[1]):
            self.add(i, 1)

    def _motions(self, i: int) -> Int[np.ndarray, "motions"]:
        return self.edges[self.place[i][0]].edges_of(self.state[:, i])

    def _cost(self, i: int) -> float:
        return float(self.edges[self.place[i][0]].cost[self._motions(i)].sum())

    def add(self, i: int, sign: int) -> None:
        """Block what the path of a robot collides with, or unblock it."""
        a = self.place[i][0]
        motions = self._motions(i)
        for b, blocked in enumerate(self.blocked):
            hits = self.conflicts.of(a, motions, b)
            count = np.array([len(hit) for hit in hits])
            flat = np.concatenate(hits) + np.repeat(np.arange(self.steps) * blocked.shape[1], count)
            blocked.reshape(-1)[flat] += np.uint16(sign % 65536)

    def replan(self, i: int) -> bool:
        """The cheapest path of a robot that is not in the timetable; whether there is one."""
        k, row = self.place[i]
        edges, blocked = self.edges[k], self.blocked[k]
        entering = edges.entering_of(row)
        source, cost = edges.begin[entering], edges.cost[entering]
        start, goal = edges.kind.node[row]
        value = np.full((self.steps + 1, edges.num_nodes), np.inf)
        value[0, start] = 0.0
        for t in range(self.steps):
            through = value[t][source] + cost
            through[blocked[t][entering] > 0] = np.inf
            through.min(axis=0, out=value[t + 1])
        if not np.isfinite(value[-1, goal]):
            return False
        node = goal
        self.state[-1, i] = goal
        for t in range(self.steps - 1, -1, -1):
            into = entering[:, node]
            through = np.where(blocked[t][into] > 0, np.inf, value[t][source[:, node]] + cost[:, node])
            node = source[through.argmin(), node]
            self.state[t, i] = node
        self.cost[i] = value[-1, goal]
        return True


def improve(
    timetable: Timetable, least: Float[np.ndarray, "robots"], deadline: float, seed: int = 0, log=None
) -> None:
    rng = np.random.default_rng(seed)
    num_robots = len(least)
    order = np.argsort(least - timetable.cost)
    while True:
        before = timetable.cost.sum()
        for i in order.tolist():
            if time.perf_counter() > deadline:
                return
            timetable.add(i, -1)
            assert timetable.replan(i)
            timetable.add(i, 1)
        if log:
            log("sweep", timetable.cost.sum() / least.sum())
        order = np.argsort(least - timetable.cost)
        if before - timetable.cost.sum() < 1e-2 * before:
            break
    size = 4
    while time.perf_counter() < deadline:
        excess = np.maximum(timetable.cost - least, 1e-9)
        i = int(rng.choice(num_robots, p=excess / excess.sum()))
        # those near it on its way
        q = [
            timetable.edges[timetable.place[j][0]].kind.table.q[timetable.state[:, j], :2] for j in range(num_robots)
        ]
        gap = np.array([np.hypot(*(q[i] - q[j]).T).min() if j != i else 0 for j in range(num_robots)])
        near = np.argsort(gap + rng.uniform(0, 1.0, num_robots))[: 3 * size]
        group = np.unique(np.append(rng.choice(near, min(size, len(near)) - 1, replace=False), i))
        rng.shuffle(group)
        state, cost = timetable.state[:, group].copy(), timetable.cost[group].copy()
        for j in group.tolist():
            timetable.add(j, -1)
        done = []
        good = True
        for j in group.tolist():
            if not timetable.replan(j):
                good = False
                break
            timetable.add(j, 1)
            done.append(j)
            if timetable.cost[done].sum() + least[np.setdiff1d(group, done)].sum() > cost.sum():
                good = False
                break
        if not good or timetable.cost[group].sum() > cost.sum() + 1e-9:
            for j in done:
                timetable.add(j, -1)
            timetable.state[:, group], timetable.cost[group] = state, cost
            for j in group.tolist():
                timetable.add(j, 1)
