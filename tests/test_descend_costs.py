"""What motions cost, a factor of their lengths integrated; and steps of cost one."""

import math

import numpy as np
import pytest

from plr_jax import MotionCost, RectangleRobot, RigidBodySpace, Workspace
from plr_jax._descend import PathCosts, unit_motions

SQUARE = Workspace(((0, 0), (2, 2)))


def test_integrals_across_a_seam_ask_within_the_domain():
    space = RigidBodySpace(SQUARE, RectangleRobot(0.2, 0.1), rotation_weight=1.0)
    lo, hi = space.domain.lo, space.domain.hi

    class Inside:
        """A factor of the heading, 1 + |heading|, that refuses what is outside the domain."""

        def __call__(self, q):
            assert ((q >= lo) & (q <= hi)).all()
            return 1 + np.abs(q[:, 2])

        def bounds(self, lo_, hi_):
            assert (lo_ >= lo).all() and (hi_ <= hi).all()
            ends = np.abs(np.stack([lo_[:, 2], hi_[:, 2]]))
            least = np.where(lo_[:, 2] * hi_[:, 2] <= 0, 0.0, ends.min(axis=0))
            return 1 + least, 1 + ends.max(axis=0)

    q0, q1 = np.array([[1.0, 1.0, math.pi - 0.5]]), np.array([[1.0, 1.0, -math.pi + 0.5]])
    # A turn of 1 over headings whose sizes run from pi - 0.5 up to pi and down again.
    expected = 1 * (1 + math.pi - 0.25)
    np.testing.assert_allclose(PathCosts(space, Inside()).integrals(q0, q1, 1e-3), expected, rtol=1e-6)
    np.testing.assert_allclose(PathCosts(space, Inside()).integrals(q1, q0, 1e-3), expected, rtol=1e-6)


@pytest.mark.parametrize(
    ("motion", "num_axes_alone"),
    [
        (MotionCost((((0, 1), 1.0),)), 4),
        (MotionCost((((0, 1), 1.0), ((2,), 0.3))), 6),
        (MotionCost((((0,), 2.0),)), 2),
    ],
)
def test_unit_motions_cost_one_and_are_as_many_as_their_opposites(motion, num_axes_alone):
    steps = unit_motions(motion)
    np.testing.assert_allclose(motion.norm(steps), 1.0, rtol=1e-12)
    rounded = {tuple(step) for step in np.round(steps, 9) + 0.0}
    assert rounded == {tuple(-np.array(step) + 0.0) for step in rounded}
    assert sum(np.count_nonzero(step) == 1 for step in rounded) == num_axes_alone
