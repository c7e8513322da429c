"""Occluders: they hide nothing that sees one another, and most of what does not."""

import jax.numpy as jnp
import numpy as np
import pytest
import shapely

from plr_jax import Box, Workspace, scenes
from plr_jax._arrays import padded
from plr_jax.pairs.occluders import occluders_of
from plr_jax.pairs.query import is_across_occluder


def ends_of(workspace, depth=1e-5):
    """Both ends of the occluders of a workspace."""
    rows = occluders_of(workspace.free_space, workspace.bounds, depth, 1000)
    middle = (workspace.bounds.lo + workspace.bounds.hi) / 2
    return rows[:, :4].reshape(-1, 2, 2) + middle


def test_they_lie_inside_obstacles_and_hide_most_of_what_is_hidden():
    workspace = scenes.floor_plan().workspace
    ends = ends_of(workspace)
    assert 8 < len(ends) < 128
    solid = shapely.box(*workspace.bounds.lo, *workspace.bounds.hi).difference(workspace.free_space).buffer(-0.9e-5)
    assert shapely.covers(solid, shapely.linestrings(ends)).all()
    x, y = workspace.sample_free(2_000, seed=8).reshape(2, -1, 2)
    hidden = ~workspace.is_visible(x, y)
    lines = shapely.linestrings(np.stack([x, y], axis=1))
    told = shapely.intersects(shapely.union_all(shapely.linestrings(ends)), lines)
    assert not (told & ~hidden).any() and told.sum() > 0.8 * hidden.sum()


def test_there_are_none_without_obstacles_and_of_none_that_are_deep_enough():
    empty = Workspace(Box((0, 0), (1, 1)))
    assert len(ends_of(empty)) == len(ends_of(scenes.thin_maze().workspace, depth=0.01)) == 0


@pytest.mark.usefixtures("unchecked_types")
def test_rounding_puts_no_point_behind_an_occluder_that_is_beyond_its_end():
    workspace = scenes.floor_plan().workspace
    rows = occluders_of(workspace.free_space, workspace.bounds, 1e-5, 1000).astype(np.float32)
    rng = np.random.default_rng(0)
    for row in rows[:8]:
        a, b = row[:4].reshape(2, 2)
        near, far = rng.uniform(0.001, 1, (2, 2000, 1)).cumsum(axis=0)
        noise = 24e-7 * rng.normal(size=(2, 2000, 2)) * rng.integers(0, 20, (2000, 1))  # of a width of 24
        x, y = (
            (b + share * (b - a) + each).astype(np.float32) for share, each in zip((near, far), noise, strict=True)
        )
        group = jnp.asarray(padded(row[None], 16)[None])
        assert not is_across_occluder(group, x, y).any() and not is_across_occluder(group, y, x).any()
        middle, across = (a + b) / 2, np.array([a[1] - b[1], b[0] - a[0]])
        assert is_across_occluder(group, (middle - across)[None], (middle + across)[None]).all()
