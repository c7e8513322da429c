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


def motions_with_ends(
    table: MotionTable, ends: Ends, node: Int[np.ndarray, "n"]
) -> tuple[Int[np.ndarray, "n primitives"], Float[np.ndarray, "n primitives"]]:
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


@dataclass(frozen=True, eq=False)
class Lattice:
    """One robot's configurations and motions: those of its kind, its start and its goal in place of their cells."""

    table: MotionTable
    ends: Ends

    @property
    def q(self) -> Float[np.ndarray, "nodes dof"]:
        """The configurations."""
        return self.table.q

    @property
    def start(self) -> int:
        """The node of the start."""
        return int(self.ends.node[0])

    @property
    def goal(self) -> int:
        """The node of the goal."""
        return int(self.ends.node[1])

    @property
    def num_primitives(self) -> int:
        """Primitives, staying among them."""
        return self.table.child.shape[1]

    @property
    def child(self) -> Int[np.ndarray, "nodes primitives"]:
        """Where the primitives of all nodes lead."""
        return self._motions[0]

    @property
    def cost(self) -> Float[np.ndarray, "nodes primitives"]:
        """What the primitives of all nodes cost."""
        return self._motions[1]

    @cached_property
    def _motions(self) -> tuple[Int[np.ndarray, "nodes primitives"], Float[np.ndarray, "nodes primitives"]]:
        return motions_with_ends(self.table, self.ends, np.arange(len(self.q)))

    @cached_property
    def stride(self) -> float:
        """Largest distance that a primitive translates, in workspace units."""
        offset = self.q[self.child] - self.q[:, None]
        return float(np.hypot(offset[..., 0], offset[..., 1]).max())
