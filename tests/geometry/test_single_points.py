"""Location of single points and free segments in a triangulation, compared with exact arithmetic."""

import numpy as np
import pytest
from exact_plane import ExactPlane
from piece_helpers import SEEDS, WORKSPACES, exact_turns, hard_points, random_workspace

from plr_jax.geometry.single_points import PointLocator


def test_located_triangles_contain_points_exactly():
    num_beside = 0
    for seed, kind in enumerate(WORKSPACES):
        workspace = kind(np.random.default_rng(seed))
        mesh, x = workspace.triangulation, hard_points(workspace, seed)
        places = [place for point in x.tolist() if (place := PointLocator(mesh).place(*point)) is not None]
        assert len(places) > len(x) / 2
        for place in places[::3]:
            turns = [min(exact_turns((place.x, place.y), corners)) for corners in mesh.triangles]
            holders = {index for index, turn in enumerate(turns) if turn >= 0}
            assert {place.triangle, place.beyond} == holders
            num_beside += len(holders) == 2
    assert num_beside > 10


def test_points_outside_free_space_are_not_located():
    workspace = WORKSPACES[0](np.random.default_rng(3))
    locator, vertices = PointLocator(workspace.triangulation), workspace.boundary.vertices
    outside = np.random.default_rng(0).uniform(-1, 11, (300, 2))
    outside = outside[~workspace.is_free(outside)]
    hostile = [*outside.tolist(), *vertices.tolist(), [np.nan, 1.0], [1.0, -np.inf], [1e308, 1.0]]
    assert len(outside) > 50 and all(locator.place(*point) is None for point in hostile)


@pytest.mark.parametrize("seed", SEEDS)
def test_free_segments_equal_exact_visibility(seed):
    workspace = random_workspace(seed)
    locator, plane = PointLocator(workspace.triangulation), ExactPlane(workspace.boundary.segments)
    x = np.random.default_rng(seed).permutation(hard_points(workspace, seed)).tolist()
    places = [place for point in x if (place := locator.place(*point)) is not None][:20]
    free = [locator.is_free_segment(a, b) for a, b in zip(places, places[::-1], strict=True)]
    assert any(is_free is not None for is_free in free)
    for a, b, is_free in zip(places, places[::-1], free, strict=True):
        assert is_free is None or is_free == plane.sees(a[:2], b[:2])
