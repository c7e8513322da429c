"""A table of reservations: when the paths of a team block which edges, and a robot's cheapest path in between."""

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float, Int, Shaped

from plr_jax.planners._budget import HeldMemory, SearchBudget
from plr_jax.planners.lattice.edges import Kind
from plr_jax.planners.replanning.conflicts import Conflicts

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
        self,
        kinds: Sequence[Kind],
        costs_to_go: Sequence[Float[np.ndarray, "_ _"]],
        state: Int[np.ndarray, "rows robots"],
        tolerance: float,
        budget: SearchBudget,
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

    @property
    def num_robots(self) -> int:
        """Robots of the team."""
        return self.state.shape[1]

    def gaps(self, i: int) -> Float[np.ndarray, "robots"]:
        """The least distance of each robot's position from that of one of them over time, 0 for itself."""
        gaps = np.empty(self.num_robots)
        position = self._positions(i)
        for j in range(self.num_robots):
            gaps[j] = np.hypot(*(self._positions(j) - position).T).min()
        return gaps

    def _positions(self, i: int) -> Float[np.ndarray, "rows 2"]:
        return self.kinds[self.place[i][0]].table.q[self.state[:, i], :2]

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

    def _collisions(
        self, i: int
    ) -> Iterator[tuple[Shaped[np.ndarray, "steps edges"], tuple[Int[np.ndarray, "m"], Int[np.ndarray, "m"]]]]:
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
