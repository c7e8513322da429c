"""Collision of a whole team along simultaneous straight motions: with the workspace, and of each two robots.

Along a path, only robots near one another are tested exactly, those of one kind in one batch.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax.collision.broad_phase import Traffic
from plr_jax.collision.pairs import motions_apart
from plr_jax.collision.walls import MotionTest, motion_test
from plr_jax.geometry.workspace import Workspace
from plr_jax.robots.robot import Robot


@dataclass(frozen=True, eq=False)
class JointMotionTest:
    """Whether straight joint motions of a team are free: of obstacles, and of collisions between robots.

    Past the deadline, on the clock of ``time.perf_counter``, tests raise ``TimeoutError``.
    """

    workspace: Workspace
    robots: Sequence[Robot]
    deadline: float = math.inf

    @cached_property
    def of_walls(self) -> tuple[MotionTest, ...]:
        """Each robot's own motion test."""
        return tuple(motion_test(self.workspace, robot, self.deadline) for robot in self.robots)

    @cached_property
    def first_equal(self) -> Int[np.ndarray, "robots"]:
        """For each robot the first that is equal to it."""
        first: dict[Robot, int] = {}
        return np.array([first.setdefault(robot, i) for i, robot in enumerate(self.robots)])

    def __call__(
        self, q0: Float[np.ndarray, "n robots dof"], q1: Float[np.ndarray, "n robots dof"]
    ) -> Bool[np.ndarray, "n"]:
        """Whether joint motions from ``q0`` to ``q1`` keep all robots clear of walls and of one another."""
        left = np.arange(len(q0))
        for i, test in enumerate(self.of_walls):
            left = left[test(q0[left, i], q1[left, i], self.deadline)]
        for i, j in combinations(range(len(self.robots)), 2):
            left = left[self.apart(i, q0[left, i], q1[left, i], j, q0[left, j], q1[left, j])]
        free = np.zeros(len(q0), dtype=bool)
        free[left] = True
        return free

    def apart(
        self,
        i: int,
        a0: Float[np.ndarray, "*#batch dof_a"],
        a1: Float[np.ndarray, "*#batch dof_a"],
        j: int,
        b0: Float[np.ndarray, "*#batch dof_b"],
        b1: Float[np.ndarray, "*#batch dof_b"],
    ) -> Bool[np.ndarray, "*batch"]:
        """Whether robots ``i`` and ``j`` keep clear of one another, as :func:`motions_apart` says."""
        return motions_apart(self.robots[i], a0, a1, self.robots[j], b0, b1, self.workspace.tolerance, self.deadline)

    def meet(
        self,
        i: int,
        begin: Float[np.ndarray, "m dof"],
        end: Float[np.ndarray, "m dof"],
        traffic: Traffic,
        motion: Int[np.ndarray, "m"],
        other: Int[np.ndarray, "m"],
    ) -> Bool[np.ndarray, "m"]:
        """Whether motions of robot ``i`` collide with others, each with one as that makes a motion of a path."""
        others_begin, others_end = traffic.path[motion, other], traffic.path[motion + 1, other]
        if not self.first_equal.any():  # all robots are equal
            return ~self.apart(i, begin, end, 0, others_begin, others_end)
        result = np.empty(len(motion), dtype=bool)
        for kind in set(self.first_equal[other].tolist()):
            alike = np.flatnonzero(self.first_equal[other] == kind)
            result[alike] = ~self.apart(i, begin[alike], end[alike], kind, others_begin[alike], others_end[alike])
        return result
