"""Collision of a whole team along simultaneous straight motions: with the workspace, and of each two robots.

Along a path, only robots near one another are tested exactly, those of one kind in one batch.
"""

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
    """Whether straight joint motions of a team are free: of obstacles, and of collisions between robots."""

    workspace: Workspace
    robots: Sequence[Robot]

    @cached_property
    def of_walls(self) -> tuple[MotionTest, ...]:
        """Each robot's own motion test."""
        return tuple(motion_test(self.workspace, robot) for robot in self.robots)

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
            left = left[test(q0[left, i], q1[left, i])]
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
        return motions_apart(self.robots[i], a0, a1, self.robots[j], b0, b1, self.workspace.tolerance)

    def collisions_with_others(
        self,
        i: int,
        begin: Float[np.ndarray, "n k dof"],
        end: Float[np.ndarray, "n l dof"],
        traffic: Traffic,
        motion: Int[np.ndarray, "n"],
        excluded: Sequence[int] = (),
    ) -> tuple[Int[np.ndarray, "m"], Int[np.ndarray, "m"], Int[np.ndarray, "m"], Int[np.ndarray, "m"]]:
        """Which motions of robot ``i`` collide with whom of the others, as these go along a path.

        In each of ``n`` rows, the robot goes from every one of ``k`` configurations to every one of ``l``. Meanwhile
        the others, but those ``excluded``, go from row ``motion`` of the path to the next.

        Returns:
            Of each collision: the row, the configurations that the motion leads from and to, and the other robot.
        """
        near_row, near = traffic.near(i, begin, end, motion, excluded)
        found = [np.empty((4, 0), dtype=np.intp)]
        for kind in set(self.first_equal[near].tolist()):
            of_kind = self.first_equal[near] == kind
            row, other = near_row[of_kind], near[of_kind]
            theirs = (traffic.path[motion[row] + ahead, other][:, None, None] for ahead in (0, 1))
            apart = self.apart(i, begin[row][:, :, None], end[row][:, None], kind, *theirs)
            pair, first, last = np.nonzero(~apart)
            found.append(np.array([row[pair], first, last, other[pair]]))
        row, first, last, other = np.concatenate(found, axis=1)
        return row, first, last, other
