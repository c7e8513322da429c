"""Descent through spaces that only test configurations, at a resolution."""

import math

import numpy as np
import pytest
from space_helpers import far_from, nothing_known
from space_helpers import rectangle as box

from plr_jax import Box, MotionCost, PlaneSpace, Workspace, descend
from plr_jax._descend import MotionTests

SQUARE = Workspace(((0, 0), (2, 2)))
DOOR = Workspace(((0, 0), (10, 10)), [box(4, 0, 6, 7), box(4, 8, 6, 10)])


class OnlyTests:
    """What a space says of configurations alone."""

    def __init__(self, space):
        self.domain, self.motion_cost, self.is_free = space.domain, space.motion_cost, space.is_free


def test_a_space_that_only_tests_is_served_at_a_resolution():
    goal, starts = (8.0, 2.0), [(1.0, 1.0), (2.0, 6.0), (7.0, 9.0)]
    descent = descend(far_from(goal), OnlyTests(PlaneSpace(DOOR)), starts, goal, resolution=0.1)
    proven = descend(far_from(goal), PlaneSpace(DOOR), starts, goal)
    assert descent.reached.all()
    np.testing.assert_allclose(descent.costs, proven.costs, rtol=0.02)
    for path in descent.paths:
        at = path[:-1, None] + np.linspace(0, 1, 1000)[:, None] * np.diff(path, axis=0)[:, None]
        assert DOOR.clearance(at.reshape(-1, 2)).min() > -0.1, "a corner is cut by less than the resolution at most"


def test_a_test_of_motions_goes_the_short_way_around_and_is_as_fine_as_said():
    class Ring:
        """Angles, but those from 1 to 1.2."""

        domain, motion_cost = Box([-math.pi], [math.pi], periodic=(True,)), MotionCost([((0,), 2.0)])

        def is_free(self, q):
            return ~((q[:, 0] > 1) & (q[:, 0] < 1.2))

    motions = MotionTests(Ring(), 0.39)
    q0, q1 = np.array([[3.0], [0.5], [0.9], [2.0], [2.0]]), np.array([[-3.0], [1.5], [1.3], [2.0], [-1.0]])
    assert motions.are_free(q0, q1).tolist() == [True, False, False, True, False]
    assert motions.are_free(q0[:0], q1[:0]).shape == (0,)
    free = MotionTests(Ring(), 0.9).are_free(q0, q1)
    assert free[2], "what is thinner than the resolution may be missed: only the ends are tested"


def test_more_tests_of_one_motion_than_memory_holds_are_refused():
    space = OnlyTests(PlaneSpace(DOOR))
    x = DOOR.sample_free(2, seed=0)
    with pytest.raises(ValueError, match=r"resolution=1e-09 asks for more than 262,144 tests of one motion"):
        descend(far_from(x[0]), space, x[1:], x[0], resolution=1e-9)


def test_a_resolution_is_for_spaces_that_only_test_and_needed_there():
    space = PlaneSpace(SQUARE)
    for unlike, options in ((OnlyTests(space), {}), (space, {"resolution": 0.1}), (SQUARE, {"resolution": 0.1})):
        with pytest.raises(ValueError, match="is for a space that only tests configurations, and needed there"):
            descend(nothing_known, unlike, [(1, 1)], (1, 1), **options)
