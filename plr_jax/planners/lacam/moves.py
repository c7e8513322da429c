"""What the robots of a team may do next from a joint configuration, and which of their motions collide."""

from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax.collision.pairs import motions_apart
from plr_jax.planners.lattice.joint import JointLattice
from plr_jax.planners.lattice.motions import Lattice, MotionTable
from plr_jax.robots.robot import Robot

Bits: TypeAlias = int
"""A set of primitives: bit ``p`` for primitive ``p``."""


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


@dataclass(frozen=True, eq=False)
class Kind:
    """Robots of a team that share a table of motions, as arrays.

    Args:
        robot: What they are.
        table: Their motions.
        members: Which robots of the team they are.
        node, cell, entry: Their starts and goals, as in :class:`plr_jax.planners.bl.lattice.End`.
        cost_to_go: Of each of them from each node.
    """

    robot: Robot
    table: MotionTable
    members: Int[np.ndarray, "robots"]
    node: Int[np.ndarray, "robots 2"]
    cell: Int[np.ndarray, "robots 2"]
    entry: Float[np.ndarray, "robots 2 2 primitives"]
    cost_to_go: Float[np.ndarray, "robots nodes"]
    reach: float

    def motions(
        self, node: Int[np.ndarray, "robots"]
    ) -> tuple[Int[np.ndarray, "robots primitives"], Float[np.ndarray, "robots primitives"]]:
        """Where the primitives of each robot lead, and what they cost."""
        child, cost = self.table.child[node], self.table.cost[node]
        rows, from_end = np.arange(len(node)), (node >= self.table.num_cells).astype(np.intp)
        for end in range(2):
            enters = (child == self.cell[:, [end]]) & (child != node[:, None])
            entry = self.entry[rows, end, from_end]
            cost = np.where(enters, entry, cost)
            child = np.where(enters, np.where(np.isfinite(entry), self.node[:, [end]], node[:, None]), child)
        return child, cost


class TeamMoves:
    """The moves of a team on its lattices, scored and tested as batches."""

    def __init__(self, joint: JointLattice, cost_to_go: list[Float[np.ndarray, "_"]]):
        self.tolerance = joint.problem.workspace.tolerance
        self.num_robots = len(joint.lattices)
        self.kinds = _kinds(joint, cost_to_go)
        self.kind_of = np.empty(self.num_robots, dtype=np.intp)
        self.row_of = np.empty(self.num_robots, dtype=np.intp)
        for k, kind in enumerate(self.kinds):
            self.kind_of[kind.members], self.row_of[kind.members] = k, np.arange(len(kind.members))
        self.reach = np.empty(self.num_robots)
        for kind in self.kinds:
            self.reach[kind.members] = kind.reach

    def __call__(self, state: Int[np.ndarray, "robots"]) -> Moves:
        """The moves from a joint configuration."""
        child: list[list[int]] = [[]] * self.num_robots
        ranked: list[list[int]] = [[]] * self.num_robots
        neighbors: list[list[tuple[int, list[Bits]]]] = [[] for _ in range(self.num_robots)]
        q, ends, xy = [], [], np.empty((self.num_robots, 2))
        for kind in self.kinds:
            node = state[kind.members]
            target, cost = kind.motions(node)
            score = kind.cost_to_go[np.arange(len(node))[:, None], target]
            score[np.isinf(cost)] = np.inf
            order, count = np.argsort(score, axis=1, kind="stable").tolist(), np.isfinite(cost).sum(axis=1).tolist()
            for i, targets, row, num_free in zip(kind.members.tolist(), target.tolist(), order, count, strict=True):
                child[i], ranked[i] = targets, row[:num_free]
            q.append(kind.table.q[node])
            ends.append(kind.table.q[target])
            xy[kind.members] = q[-1][:, :2]
        first, second = self._near(xy)
        for a, b in {*zip(self.kind_of[first].tolist(), self.kind_of[second].tolist(), strict=True)}:
            alike = (self.kind_of[first] == a) & (self.kind_of[second] == b)
            i, j = first[alike], second[alike]
            row, column = self.row_of[i], self.row_of[j]
            collide = ~motions_apart(
                self.kinds[a].robot,
                q[a][row, None, None],
                ends[a][row, :, None],
                self.kinds[b].robot,
                q[b][column, None, None],
                ends[b][column, None, :],
                self.tolerance,
            )
            meet = collide.any(axis=(1, 2))
            i, j, collide = i[meet], j[meet], collide[meet]
            for robot, other, of_robot, of_other in zip(
                i.tolist(), j.tolist(), _bits(collide), _bits(collide.swapaxes(1, 2)), strict=True
            ):
                neighbors[robot].append((other, of_robot))
                neighbors[other].append((robot, of_other))
        return Moves(child, ranked, neighbors)

    def _near(self, xy: Float[np.ndarray, "robots 2"]) -> tuple[Int[np.ndarray, "m"], Int[np.ndarray, "m"]]:
        """Robots that some primitives may bring together, by kind where kinds differ."""
        x, y = xy.T
        dx, dy, reach = x[:, None] - x, y[:, None] - y, self.reach[:, None] + self.reach
        near = dx * dx + dy * dy < reach * reach
        ahead = self.kind_of[:, None] < self.kind_of
        same = (self.kind_of[:, None] == self.kind_of) & (np.arange(len(x))[:, None] < np.arange(len(x)))
        return np.nonzero(near & (ahead | same))


def _kinds(joint: JointLattice, cost_to_go: list[Float[np.ndarray, "_"]]) -> list[Kind]:
    members: dict[int, list[int]] = {}
    for i, lattice in enumerate(joint.lattices):
        members.setdefault(id(lattice.table), []).append(i)
    kinds = []
    for alike in members.values():
        lattices = [joint.lattices[i] for i in alike]
        robot = joint.problem.robots[alike[0]]
        kinds.append(
            Kind(
                robot,
                lattices[0].table,
                np.array(alike),
                np.array([[end.node for end in lattice.ends] for lattice in lattices]),
                np.array([[end.cell for end in lattice.ends] for lattice in lattices]),
                np.array([[end.entry for end in lattice.ends] for lattice in lattices]),
                np.stack([cost_to_go[i] for i in alike]),
                robot.circumscribed_radius + _stride(lattices),
            )
        )
    return kinds


def _stride(lattices: list[Lattice]) -> float:
    """Largest distance that a primitive of some robots that share a table translates."""
    table = lattices[0].table
    longest = 0.0
    offset = table.q[table.child] - table.q[:, None]
    longest = float(np.hypot(offset[..., 0], offset[..., 1]).max())
    for lattice in lattices:
        for end in lattice.ends:
            around = np.flatnonzero((table.child == end.cell).any(axis=1))
            away = table.q[around] - table.q[end.node]
            longest = max(longest, float(np.hypot(away[:, 0], away[:, 1]).max(initial=0.0)))
    return longest


def _bits(collide: Bool[np.ndarray, "m p q"]) -> list[list[Bits]]:
    """Rows of flags as sets."""
    weights = np.array([1 << q for q in range(collide.shape[2])], dtype=object if collide.shape[2] > 62 else np.int64)
    return np.dot(collide.astype(weights.dtype), weights).tolist()
