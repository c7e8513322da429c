"""Motions between configurations as tables: those that robots of one kind share, and each robot's view of them."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int


@dataclass(frozen=True, eq=False)
class MotionTable:
    """Configurations of one kind of robot, and the motions between them.

    The first primitive stays. One that leaves the lattice or hits an obstacle leads back to its own configuration at
    infinite cost. The representatives of the cells come first, ``num_cells`` of them, then starts and goals, to which
    no primitive leads.
    """

    q: Float[np.ndarray, "nodes dof"]
    child: Int[np.ndarray, "nodes primitives"]
    cost: Float[np.ndarray, "nodes primitives"]
    num_cells: int


class End(NamedTuple):
    """A robot's start or goal, which stands for its cell.

    Args:
        node: Its node.
        cell: The node of its cell's representative, which the robot never visits.
        entry: Cost of the motion to it by each primitive that leads to its cell, ``inf`` where it is not free: first
            from representatives, then from the robot's other end.
    """

    node: int
    cell: int
    entry: Float[np.ndarray, "2 primitives"]


@dataclass(frozen=True, eq=False)
class Lattice:
    """One robot's configurations and motions: those of its kind, its start and its goal in place of their cells."""

    table: MotionTable
    ends: tuple[End, End]

    @property
    def q(self) -> Float[np.ndarray, "nodes dof"]:
        """The configurations."""
        return self.table.q

    @property
    def start(self) -> int:
        """The node of the start."""
        return self.ends[0].node

    @property
    def goal(self) -> int:
        """The node of the goal."""
        return self.ends[1].node

    @property
    def num_primitives(self) -> int:
        """Primitives, staying among them."""
        return self.table.child.shape[1]

    def motions(
        self, node: Int[np.ndarray, "*batch"]
    ) -> tuple[Int[np.ndarray, "*batch primitives"], Float[np.ndarray, "*batch primitives"]]:
        """Where the primitives of some nodes lead, and what they cost."""
        child, cost = self.table.child[node], self.table.cost[node]
        from_end = (node >= self.table.num_cells).astype(int)
        for end in self.ends:
            enters, entry = (child == end.cell) & (child != node[..., None]), end.entry[from_end]
            cost = np.where(enters, entry, cost)
            child = np.where(enters, np.where(np.isfinite(entry), end.node, node[..., None]), child).astype(np.int32)
        return child, cost

    @cached_property
    def child(self) -> Int[np.ndarray, "nodes primitives"]:
        """Where the primitives of all nodes lead."""
        return self.motions(np.arange(len(self.q)))[0]

    @cached_property
    def cost(self) -> Float[np.ndarray, "nodes primitives"]:
        """What the primitives of all nodes cost."""
        return self.motions(np.arange(len(self.q)))[1]

    @cached_property
    def stride(self) -> float:
        """Largest distance that a primitive translates, in workspace units."""
        offset = self.q[self.child] - self.q[:, None]
        return float(np.hypot(offset[..., 0], offset[..., 1]).max())
