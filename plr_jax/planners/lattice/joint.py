"""The lattices of a team: joint configurations, joint motions, and which of them collide."""

from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from plr_jax._problem import Problem
from plr_jax.collision.joint_motion import JointMotionTest
from plr_jax.planners.lattice.motions import Lattice

State: TypeAlias = Int[np.ndarray, "n robots"]
"""Joint configurations, as indices into the robots' lattices."""


class JointLattice(NamedTuple):
    """The robots of a problem, each on its lattice, and the team's motion test."""

    problem: Problem
    lattices: tuple[Lattice, ...]
    test: JointMotionTest

    def configurations(self, state: State) -> Float[np.ndarray, "n robots dof"]:
        """Joint configurations; round robots in a team with others keep the heading of their start."""
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
        """Rows in which two robots are near enough to meet, and there, which of their primitives collide."""
        a, b = self.lattices[i], self.lattices[j]
        robot_a, robot_b = self.problem.robots[i], self.problem.robots[j]
        qa, qb = a.q[state[:, i]], b.q[state[:, j]]
        reach = robot_a.circumscribed_radius + robot_b.circumscribed_radius + a.stride + b.stride
        x, y = qa[:, 0] - qb[:, 0], qa[:, 1] - qb[:, 1]
        near = np.flatnonzero(x * x + y * y < reach * reach)
        motions_a = qa[near, None, None], a.q[a.child[state[near, i]]][:, :, None]
        motions_b = qb[near, None, None], b.q[b.child[state[near, j]]][:, None, :]
        return near, ~self.test.apart(i, *motions_a, j, *motions_b)
