"""Outlines of free space: on a lattice that holds all points, read back as written, moved by a distance."""

import numpy as np
import pytest
import shapely
from piece_helpers import TEN, WORKSPACES, box

from plr_jax import Workspace
from plr_jax.pairs.construct import outline_of
from plr_jax.pairs.outline import read_outline
from plr_jax.plr.coding import BitReader, BitWriter


def outline(workspace):
    width = float(workspace.bounds.width.max())
    return outline_of(workspace.boundary, workspace.bounds.lo, width, workspace.tolerance, workspace.squeeze)


@pytest.mark.parametrize("squeeze", [False, True])
@pytest.mark.parametrize("kind", WORKSPACES)
@pytest.mark.parametrize("seed", range(3))
def test_the_outline_is_the_boundary_of_free_space_and_is_read_as_it_was_written(kind, seed, squeeze):
    workspace = kind(np.random.default_rng(seed), squeeze)
    found, vertex = outline(workspace)
    boundary, finest = workspace.boundary, 10 * 2.0**-24
    np.testing.assert_allclose(found.positions, boundary.vertices[vertex], atol=finest)
    ends = np.sort(found.moved_walls(0.0).reshape(-1, 2, 2).round(5), axis=0)
    np.testing.assert_allclose(ends, np.sort(boundary.segments.round(5), axis=0), atol=2e-5)
    x = np.random.default_rng(seed).uniform(0, 10, (500, 2))
    clear = shapely.distance(shapely.boundary(workspace.free_space), shapely.points(x)) > 1e-4
    np.testing.assert_array_equal(found.contains(x)[clear], workspace.is_free(x)[clear])
    body = BitWriter()
    found.write(body)
    again = read_outline(BitReader(body.to_bytes()), found.origin)
    for name in ("step", "points", "first", "may_squeeze"):
        np.testing.assert_array_equal(getattr(again, name), getattr(found, name))


def test_walls_that_move_back_grow_free_space_and_others_shrink_it():
    found, _ = outline(Workspace(TEN, [box(4, 4, 6, 6)]))
    for distance in (0.25, -0.5):
        moved = {tuple(point) for point in found.moved_points(distance).tolist()}
        inner, outer = box(*[4 + distance] * 2, *[6 - distance] * 2), box(*[-distance] * 2, *[10 + distance] * 2)
        assert moved == {tuple(point) for point in [*inner.tolist(), *outer.tolist()]}


@pytest.mark.parametrize("squeeze", [False, True])
def test_walls_that_touch_part_only_where_paths_may_squeeze_through(squeeze):
    found, _ = outline(Workspace(TEN, [box(2, 2, 5, 5), box(5, 5, 8, 8)], squeeze=squeeze))
    assert found.may_squeeze == squeeze
    at_contact = (found.positions == 5).all(axis=1)
    moved = found.moved_points(0.1)[at_contact]
    assert at_contact.sum() == 2 and (np.ptp(moved, axis=0).max() > 0.1) == squeeze
