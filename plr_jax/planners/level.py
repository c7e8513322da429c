"""The lattices of a team that have one step, and the costs along them."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from plr_jax._deadline import require_time
from plr_jax._problem import Problem
from plr_jax.collision.joint_motion import JointMotionTest
from plr_jax.planners.lattice.build import Primitive, build_lattices, num_configurations
from plr_jax.planners.lattice.edges import Kind, by_robot, kinds_of
from plr_jax.planners.lattice.joint import JointLattice
from plr_jax.robots.robot import Robot

_MOTION_BYTES = 92  # what a motion takes while its table is built
_COLUMN_BYTES = 16  # what a robot's costs to and from a node take
_TURNING = 4  # times as long as a round robot's motion one takes to test that turns
_GOALS, _NODES = 8, 1 << 19  # costs-to-go, and nodes that have one, at a time, between two looks at the clock
_SECONDS = 3e-7  # about what an edge takes to be found, or a node to be reached, which cannot be cut short


@dataclass(frozen=True, eq=False)
class LatticeLevel:
    """The lattices of one step.

    Args:
        step: Side of their cells.
        joint: The team on them.
        kinds: Its robots by the tables that they share.
        costs_to_go: Those of the robots of each kind, alone, along the lattices.
        num_bytes: About what they take.
    """

    step: float
    joint: JointLattice
    kinds: Sequence[Kind]
    costs_to_go: Sequence[Float[np.ndarray, "_ _"]]
    num_bytes: int

    @property
    def least_costs(self) -> Float[np.ndarray, "robots"]:
        """What the cheapest motions of each robot cost if it is alone; ``inf`` if it cannot reach its goal."""
        pairs = zip(by_robot(self.kinds, self.costs_to_go), self.joint.lattices, strict=True)
        return np.array([cost_to_go[lattice.start] for cost_to_go, lattice in pairs])

    @property
    def least_cost(self) -> float:
        """What they cost in all."""
        return float(self.least_costs.sum())


def build_level(
    problem: Problem, test: JointMotionTest, step: float, primitives: Sequence[Primitive]
) -> LatticeLevel | None:
    """The lattices of a step, and costs along them; None if a robot cannot reach its goal on them.

    Raises:
        TimeoutError: If the deadline of the test passes first.
    """
    joint = JointLattice(problem, tuple(build_lattices(problem, step, primitives, test.deadline)), test)
    kinds = kinds_of(joint)
    for kind in kinds:
        require_time(test.deadline, "the edges of the lattices were known", _SECONDS * kind.table.child.size)
        _ = kind.edges  # found when first asked for
    costs = [_costs_to_go(kind, test.deadline) for kind in kinds]
    level = LatticeLevel(step, joint, kinds, costs, int(num_bytes(problem, step, len(primitives))))
    return level if np.isfinite(level.least_cost) else None


def num_bytes(problem: Problem, step: float, num_primitives: int) -> float:
    """About what the lattices of a step take if all is free, so that those too large are not begun."""
    total = 0.0
    for (robot, _), count in _kinds(problem).items():
        nodes = num_configurations(problem.workspace, robot, step) + 2 * count
        total += nodes * (_MOTION_BYTES * (1 + num_primitives) + _COLUMN_BYTES * count)
    return total


def work(problem: Problem, step: float, num_primitives: int) -> float:
    """About how many motions have to be tested to build the lattices of a step; one that turns counts as several."""
    each = (
        (_TURNING if robot.dof == 3 else 1) * num_configurations(problem.workspace, robot, step)
        for robot, _ in _kinds(problem)
    )
    return (1 + num_primitives) * sum(each)


def _kinds(problem: Problem) -> Counter[tuple[Robot, float]]:
    """The robots that share a table, with the weight of their turns, and how many there are."""
    return Counter(zip(problem.robots, problem.rotation_weights.tolist(), strict=True))


def _costs_to_go(kind: Kind, deadline: float) -> Float[np.ndarray, "robots nodes"]:
    rows, costs, num_nodes = np.arange(len(kind.members)), [], len(kind.table.q)
    size = int(np.clip(_NODES // num_nodes, 1, _GOALS))
    for begin in range(0, len(rows), size):
        require_time(deadline, "the costs-to-go were known", _SECONDS * num_nodes)
        costs.append(kind.edges.costs_to_go(rows[begin : begin + size]))
    return np.concatenate(costs)
