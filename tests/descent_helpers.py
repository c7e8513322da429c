"""A helper that computes descents and checks them."""

import math

import numpy as np
import pytest
import shapely

from plr_jax import PlaneSpace, Workspace, descend
from plr_jax._descend import DescentStatus


def descended(field, space, starts, goal, **options):
    """Return a descent after checking that paths are free and have exact ends, and that lengths and statuses fit."""
    starts, goal = np.asarray(starts, float), np.asarray(goal, float)
    descent = descend(field, space, starts, goal, **options)
    in_plane = isinstance(space, Workspace)
    space = PlaneSpace(space) if in_plane else space
    free = shapely.buffer(space.workspace.free_space, 2 * space.workspace.tolerance, join_style="mitre")
    shapely.prepare(free)
    assert len(descent) == len(descent.paths) == len(descent.status) == len(starts)
    for path, start, status, length in zip(descent.paths, starts, descent.status, descent.lengths, strict=True):
        if status != DescentStatus.REACHED:
            assert path.shape == (0, space.domain.dim) and length == math.inf
            continue
        np.testing.assert_array_equal(path[0], start)
        assert (path[-1] == np.atleast_2d(goal)).all(axis=1).any()
        legs = space.domain.difference(path[1:], path[:-1])
        assert (legs != 0).any(axis=1).all()
        assert length == pytest.approx(space.motion_cost.norm(legs).sum(), abs=1e-12)
        if in_plane:
            assert len(legs) == 0 or shapely.covers(free, shapely.linestrings(path))
        else:
            samples = path[:-1, None] + np.linspace(0, 1, 200)[:, None] * legs[:, None]
            assert space.is_free(samples.reshape(-1, space.domain.dim)).all()
    np.testing.assert_array_equal(descent.reached, descent.status == DescentStatus.REACHED)
    np.testing.assert_array_equal(descent.counts, [len(path) for path in descent.paths])
    if options.get("cost_map") is None:
        np.testing.assert_array_equal(descent.costs, descent.lengths)
    return descent
