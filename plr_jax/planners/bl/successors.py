"""Joint configurations and their children: products of the robots' primitives, scored and checked together."""

from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from plr_jax._problem import Problem
from plr_jax.collision.joint_motion import JointMotionTest
from plr_jax.planners.bl.lattice import Lattice

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


class Successors(NamedTuple):
    """The best children of some joint configurations, by score, best first.

    Args:
        score: Sums of the robots' terms; ``inf`` for children that collide.
        primitive: The primitive of each robot.
        num_scored: Joint children, whole and partial, that were scored to find them.
        num_valid: Of the whole ones, how many collide with nothing.
        whole: Whether no collision-free child is missing.
    """

    score: Float[np.ndarray, "n m"]
    primitive: UInt8[np.ndarray, "n m robots"]
    num_scored: int
    num_valid: int
    whole: Bool[np.ndarray, "n"]


def best_successors(
    joint: JointLattice, terms: tuple[Float[np.ndarray, "_ _"], ...], state: State, width: int
) -> Successors:
    """The best children of joint configurations, one robot added after the other.

    The product of the first robots' primitives is cut to the ``width`` best collision-free ones before the next
    robot joins. A product that fits is not cut, so that its children are complete. The ``terms`` are each robot's, of
    its configurations' primitives, ``inf`` where blocked.
    """
    score = np.zeros((len(state), 1), np.float32)
    primitive = np.zeros((len(state), 1, 0), np.uint8)
    num_scored, num_valid, whole = 0, len(state), np.ones(len(state), dtype=bool)
    rows = np.arange(len(state))[:, None]
    for i, term in enumerate(terms):
        extended = score[:, :, None] + term[state[:, i], None]
        for j in range(i):
            near, collide = joint.collisions(j, i, state)
            if collide.any():
                penalty = np.where(collide, np.float32(np.inf), np.float32(0.0))
                extended[near] += penalty[np.arange(len(near))[:, None], primitive[near, :, j]]
        num_scored += extended.size
        score = extended.reshape(len(state), -1)
        valid = np.count_nonzero(score < np.inf, axis=1)
        num_valid = int(valid.sum())
        kept = np.broadcast_to(np.arange(score.shape[1]), score.shape)
        if width < score.shape[1]:
            whole &= valid <= width
            kept = np.argpartition(score, width - 1, axis=1)[:, :width]
            score = np.take_along_axis(score, kept, axis=1)
        parent, own = np.divmod(kept, term.shape[1])
        primitive = np.concatenate([primitive[rows, parent], own[..., None].astype(np.uint8)], axis=2)
    order = np.argsort(score, axis=1, kind="stable")
    return Successors(np.take_along_axis(score, order, axis=1), primitive[rows, order], num_scored, num_valid, whole)
