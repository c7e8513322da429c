import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from plr_jax.geometry.visibility import Viewpoints, visibility_of
from plr_jax.geometry.workspace import Workspace

TEN = ((0, 0), (10, 10))
NONE = np.empty(0, int)


def box(x0, y0, x1, y1):
    return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]], dtype=float)


def views_of(workspace, points):
    """A table of points in the interior of free space, which look all around."""
    views = Viewpoints(np.array(points, dtype=float), NONE, NONE)
    return visibility_of(workspace.triangulation, views)[0]


def corner_views(workspace):
    """A table of all sectors of the boundary, each looking into free space from its vertex."""
    boundary = workspace.boundary
    sector = np.arange(len(boundary.edges))
    views = Viewpoints(boundary.vertices[boundary.edges[:, 0]], sector, sector)
    return visibility_of(workspace.triangulation, views)[0]


def random_workspace(seed):
    rng = np.random.default_rng(seed)
    corners, size = rng.uniform(-0.5, 9, (6, 2)), rng.uniform(0.3, 2.5, (6, 2))
    triangles = [rng.uniform(0, 10, 2) + rng.uniform(-2, 2, (3, 2)) for _ in range(4)]
    return Workspace(TEN, [box(*c, *(c + s)) for c, s in zip(corners, size, strict=True)] + triangles)


def covered(workspace, a, b):
    """The twin: whether Shapely finds each segment in free space, a hair wider."""
    free = shapely.box(0, 0, 10, 10) - shapely.union_all(list(workspace.obstacles))
    return np.array([free.buffer(1e-9).covers(shapely.LineString(pair)) for pair in zip(a, b, strict=True)])


def test_a_wall_hides_what_is_behind_it():
    table = views_of(Workspace(TEN, [box(4, 2, 6, 8)]), [[2, 5], [5, 9]])
    x = np.array([[3.0, 5], [4, 5], [6, 5], [8, 5], [8, 9.9], [2, 0], [5, 8], [10, 10], [0, 0]])
    zero, one = np.zeros(len(x), int), np.ones(len(x), int)
    np.testing.assert_array_equal(table.sees(zero, x), [1, 1, 0, 0, 0, 1, 0, 0, 1])
    np.testing.assert_array_equal(table.sees(one, x), [0, 0, 0, 0, 1, 0, 1, 1, 0])


def test_a_corner_looks_into_its_own_sector_along_both_walls():
    workspace = Workspace(TEN, [box(4, 2, 6, 8)])
    table = corner_views(workspace)
    (v,) = np.flatnonzero((table.points == [4, 8]).all(axis=1))
    x = np.array([[4.0, 2], [4, 0], [6, 8], [10, 8], [1, 9], [8, 5], [5, 5]])
    np.testing.assert_array_equal(table.sees(np.full(len(x), v), x)[:-1], [1, 1, 1, 1, 1, 0])


@given(st.integers(0, 100_000))
@settings(max_examples=30, deadline=None)
def test_what_a_point_sees_is_what_shapely_finds_one_pair_at_a_time(seed):
    workspace = random_workspace(seed)
    points, x = workspace.sample_free(6, seed), workspace.sample_free(25, seed + 1)
    v, i = np.divmod(np.arange(6 * 25), 25)
    np.testing.assert_array_equal(views_of(workspace, points).sees(v, x[i]), covered(workspace, points[v], x[i]))


@given(st.integers(0, 100_000))
@settings(max_examples=20, deadline=None)
def test_what_a_corner_sees_is_what_shapely_finds_one_pair_at_a_time(seed):
    workspace = random_workspace(seed)
    table, x = corner_views(workspace), workspace.sample_free(10, seed)
    v, i = np.divmod(np.arange(10 * len(table.points)), 10)
    seen = table.sees(v, x[i])
    np.testing.assert_array_equal(seen, covered(workspace, table.points[v], x[i]))


def test_many_viewpoints_are_swept_in_parts(monkeypatch):
    workspace = random_workspace(3)
    whole = corner_views(workspace)
    monkeypatch.setattr("plr_jax.geometry.visibility._VIEWS", 1)
    parts = corner_views(workspace)
    np.testing.assert_array_equal(parts.key, whole.key)
    np.testing.assert_array_equal(parts.edge, whole.edge)
    np.testing.assert_array_equal(parts.first, whole.first)


@pytest.mark.parametrize("num_points", [0, 1])
def test_a_table_of_few_points(num_points):
    table = views_of(Workspace(TEN), np.full((num_points, 2), 5.0).reshape(-1, 2))
    assert len(table.first) == num_points + 1
    assert table.sees(np.zeros(num_points, int), np.zeros((num_points, 2))).all()
