"""The robots of a problem, each on its lattice: joint configurations, their motions, and which of these collide."""

from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from plr_jax._problem import Problem
from plr_jax.collision.joint_motion import JointMotionTest
from plr_jax.planners.bl.lattice import Lattice

State: TypeAlias = Int[np.ndarray, "n robots"]
"""Joint configurations, as indices into the robots' lattices."""


class JointLattice(NamedTuple):
    """The product of the robots' lattices.

    Args:
        problem: The robots, their starts and their goals.
        lattices: Each robot's own.
        test: The team's motion test.
    """

    problem: Problem
    lattices: tuple[Lattice, ...]
    test: JointMotionTest

    def configurations(self, state: State) -> Float[np.ndarray, "n robots dof"]:
        """Joint configurations; round robots in a team with rectangles keep the heading of their start."""
        q = np.repeat(self.problem.starts[None], len(state), axis=0)
        for i, lattice in enumerate(self.lattices):
            q[:, i, : lattice.q.shape[1]] = lattice.q[state[:, i]]
        return q

    def move(self, state: State, primitive: UInt8[np.ndarray, "n robots"]) -> State:
        """Where joint primitives lead."""
        columns = [lattice.child[s, p] for lattice, s, p in zip(self.lattices, state.T, primitive.T, strict=True)]
        return np.stack(columns, axis=1)

    def move_costs(self, state: State, primitive: UInt8[np.ndarray, "n robots"]) -> Float[np.ndarray, "n"]:
        """What joint primitives cost."""
        columns = [lattice.cost[s, p] for lattice, s, p in zip(self.lattices, state.T, primitive.T, strict=True)]
        return np.sum(columns, axis=0)

    def collisions(
        self, i: int, j: int, state: State
    ) -> tuple[Int[np.ndarray, "m"], Bool[np.ndarray, "m primitives_i primitives_j"]]:
        """Which primitives of two robots collide with one another.

        Returns:
            The rows of ``state`` in which the robots are near enough to meet, and for each of these whether
            each primitive of the one collides with each of the other.
        """
        a, b = self.lattices[i], self.lattices[j]
        robot_a, robot_b = self.problem.robots[i], self.problem.robots[j]
        qa, qb = a.q[state[:, i]], b.q[state[:, j]]
        reach = robot_a.circumscribed_radius + robot_b.circumscribed_radius + a.stride + b.stride
        x, y = qa[:, 0] - qb[:, 0], qa[:, 1] - qb[:, 1]
        near = np.flatnonzero(x * x + y * y < reach * reach)
        motions_a = qa[near, None, None], a.end[state[near, i], :, None]
        motions_b = qb[near, None, None], b.end[state[near, j], None, :]
        return near, ~self.test.apart(i, *motions_a, j, *motions_b)
