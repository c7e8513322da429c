import numpy as np
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from piece_helpers import general_workspace

from plr_jax.geometry.visibility import Viewpoints, visibility_of

NONE = np.empty(0, int)


def views_of(workspace, points):
    """Return a table of points in the interior of free space, which look all around."""
    views = Viewpoints(np.array(points, dtype=float).reshape(-1, 2), NONE, NONE)
    return visibility_of(workspace.triangulation, views)[0]


def corner_views(workspace):
    """Return a table of all sectors of the boundary, each looking into free space from its vertex."""
    boundary = workspace.boundary
    sector = np.arange(len(boundary.edges))
    views = Viewpoints(boundary.vertices[boundary.edges[:, 0]], sector, sector)
    return visibility_of(workspace.triangulation, views)[0]


def check_seen(workspace, table, x):
    """Check which points a table sees against Shapely: segments in free space, a hair wider."""
    v, i = np.divmod(np.arange(len(x) * len(table.points)), len(x))
    free = shapely.box(0, 0, 10, 10) - shapely.union_all(list(workspace.obstacles))
    sights = shapely.linestrings(np.stack([table.points[v], x[i]], axis=1))
    np.testing.assert_array_equal(table.sees(v, x[i]), shapely.covers(free.buffer(1e-9), sights))


@settings(max_examples=6)
@given(st.integers(0, 100_000))
def test_visible_points_equal_those_of_shapely(seed):
    workspace = general_workspace(np.random.default_rng(seed))
    check_seen(workspace, views_of(workspace, workspace.sample_free(8, seed)), workspace.sample_free(25, seed + 1))
    check_seen(workspace, corner_views(workspace), workspace.sample_free(10, seed))


def test_sweep_in_parts_equals_sweep_at_once(monkeypatch):
    workspace = general_workspace(np.random.default_rng(3))
    whole = corner_views(workspace)
    monkeypatch.setattr("plr_jax.geometry.visibility._VIEWS", 1)
    parts = corner_views(workspace)
    for name in ("key", "edge", "first"):
        np.testing.assert_array_equal(getattr(parts, name), getattr(whole, name))
