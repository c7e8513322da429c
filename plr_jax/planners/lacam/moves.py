"""What the robots of a team may do next from a joint configuration, and which of their motions collide."""

import math
from collections.abc import Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax.collision.pairs import motions_apart
from plr_jax.planners.lattice.edges import Kind

Bits: TypeAlias = int
"""A set of primitives: bit ``p`` for primitive ``p``."""

_WORD = 62  # bits of a NumPy integer that are safe to use
_MOST = 1 << 21  # pairs of motions at a time, between two looks at the clock


class Moves(NamedTuple):
    """The motions of each robot from a joint configuration.

    Args:
        child: Where each primitive of each robot leads.
        ranked: Each robot's primitives that hit no obstacle, best first.
        neighbors: Of each robot the others that it can meet, and for each of its primitives those of the other that
            collide with it.
    """

    child: list[list[int]]
    ranked: list[list[int]]
    neighbors: list[list[tuple[int, list[Bits]]]]


class TeamMoves:
    """The moves of a team on its lattices, all robots scored at once by their heuristic, near ones tested at once.

    Args:
        kinds: The robots.
        heuristic: Estimated costs-to-go of each kind's robots, by node, ``inf`` where unknown.
        tolerance: That of the workspace.
        deadline: On the clock of ``time.perf_counter``; a call that passes it raises ``TimeoutError``.
    """

    def __init__(
        self,
        kinds: Sequence[Kind],
        heuristic: Sequence[Float[np.ndarray, "_ _"]],
        tolerance: float,
        deadline: float = math.inf,
    ):
        self.kinds, self.heuristic, self.tolerance, self.deadline = kinds, heuristic, tolerance, deadline
        self.num_robots = sum(len(kind.members) for kind in kinds)
        self.kind, self.row, self.reach = np.zeros((3, self.num_robots))
        for k, kind in enumerate(kinds):
            self.kind[kind.members], self.row[kind.members] = k, np.arange(len(kind.members))
            self.reach[kind.members] = kind.robot.circumscribed_radius + kind.edges.stride
        self.kind, self.row = self.kind.astype(np.intp), self.row.astype(np.intp)

    def __call__(self, state: Int[np.ndarray, "robots"]) -> Moves:
        """The moves from a joint configuration."""
        child: list[list[int]] = [[]] * self.num_robots
        ranked: list[list[int]] = [[]] * self.num_robots
        neighbors: list[list[tuple[int, list[Bits]]]] = [[] for _ in range(self.num_robots)]
        places, ends, position = [], [], np.empty((self.num_robots, 2))
        for kind, estimate in zip(self.kinds, self.heuristic, strict=True):
            node = state[kind.members]
            target, cost = kind.motions(node)
            score = np.where(np.isfinite(cost), estimate[np.arange(len(node))[:, None], target], np.inf)
            order = np.argsort(score, axis=1, kind="stable").tolist()
            num_free = np.isfinite(cost).sum(axis=1).tolist()
            for i, targets, best, count in zip(kind.members.tolist(), target.tolist(), order, num_free, strict=True):
                child[i], ranked[i] = targets, best[:count]
            places.append(kind.table.q[node])
            ends.append(kind.table.q[target])
            position[kind.members] = places[-1][:, :2]
        for a, b, i, j in self._near(position):
            motions_a = places[a][self.row[i]][:, None, None], ends[a][self.row[i]][:, :, None]
            motions_b = places[b][self.row[j]][:, None, None], ends[b][self.row[j]][:, None]
            robots = self.kinds[a].robot, self.kinds[b].robot
            collide = ~motions_apart(robots[0], *motions_a, robots[1], *motions_b, self.tolerance, self.deadline)
            meet = collide.any(axis=(1, 2))
            bits = _bits(collide[meet]), _bits(collide[meet].swapaxes(1, 2))
            for robot, other, ours, theirs in zip(i[meet].tolist(), j[meet].tolist(), *bits, strict=True):
                neighbors[robot].append((other, ours))
                neighbors[other].append((robot, theirs))
        return Moves(child, ranked, neighbors)

    def estimates(self, state: Int[np.ndarray, "robots"]) -> Float[np.ndarray, "robots"]:
        """The heuristic of each robot."""
        values = np.empty(self.num_robots)
        for kind, estimate in zip(self.kinds, self.heuristic, strict=True):
            values[kind.members] = estimate[np.arange(len(kind.members)), state[kind.members]]
        return values

    def _near(
        self, position: Float[np.ndarray, "robots 2"]
    ) -> list[tuple[int, int, Int[np.ndarray, "m"], Int[np.ndarray, "m"]]]:
        """Pairs of robots that primitives may bring together: two kinds, and some robots of each, at a time."""
        x, y = position.T
        dx, dy, reach = x[:, None] - x, y[:, None] - y, self.reach[:, None] + self.reach
        order = self.kind * self.num_robots + np.arange(self.num_robots)
        first, second = np.nonzero((dx * dx + dy * dy < reach * reach) & (order[:, None] < order))
        pairs = self.kind[first] * len(self.kinds) + self.kind[second]
        found = []
        for pair in np.unique(pairs).tolist():
            a, b = divmod(pair, len(self.kinds))
            size = max(1, _MOST // (self.kinds[a].table.child.shape[1] * self.kinds[b].table.child.shape[1]))
            alike = np.flatnonzero(pairs == pair)
            for begin in range(0, len(alike), size):
                some = alike[begin : begin + size]
                found.append((a, b, first[some], second[some]))
        return found


def _bits(flags: Bool[np.ndarray, "m p q"]) -> list[list[Bits]]:
    """Rows of flags as sets."""
    if flags.shape[2] <= _WORD:
        return np.dot(flags.astype(np.int64), 1 << np.arange(flags.shape[2])).tolist()
    packed = np.packbits(flags, axis=2, bitorder="little")
    return [[int.from_bytes(row, "little") for row in rows] for rows in packed]
