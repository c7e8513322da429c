"""Fixtures of the tests of refinement, its losses, and faces."""

import numpy as np
import pytest
from plr_helpers import UNIT, points, walled

from plr_jax import construct
from plr_jax.plr.sampling.face_samples import sample_faces


@pytest.fixture(scope="session")
def wall():
    """A PLR of the walled square, and points of finite distance."""
    x = points(20_000, 1)
    distance = walled(x)
    free = np.isfinite(distance)
    return construct(walled, UNIT, max_leaves=60), x[free], distance[free]


@pytest.fixture(scope="session")
def wall_faces(wall):
    return sample_faces(wall[0], walled)
