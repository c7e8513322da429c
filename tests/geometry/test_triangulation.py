import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from plr_jax.geometry.boundary import Boundary, boundary_of
from plr_jax.geometry.triangulation import triangulation_of
from plr_jax.geometry.vectors import cross_product
from plr_jax.geometry.workspace import Workspace

TEN = ((0, 0), (10, 10))


def lattice_workspace(seed, turn=0.0):
    """Unit cells blocked at random, turned: collinear corners and point contacts everywhere."""
    blocked = np.argwhere(np.random.default_rng(seed).random((10, 10)) < 0.3)
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])

    def box(x0, y0, x1, y1):
        return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]], dtype=float) @ rotation.T

    return Workspace.from_polygons(
        [{"outer": box(0, 0, 10, 10), "holes": [box(x, y, x + 1, y + 1) for x, y in blocked]}]
    )


def check(workspace):
    """What makes half-edges a triangulation of free space between its walls."""
    mesh = workspace.triangulation
    (a, b, c), vertices = mesh.triangles.transpose(1, 0, 2), workspace.boundary.vertices
    area = cross_product(b - a, c - a) / 2
    assert (area > 0).all()
    assert area.sum() == pytest.approx(workspace.free_space.area, rel=1e-9)
    ends = np.stack([mesh.origin, np.roll(mesh.origin.reshape(-1, 3), -1, axis=1).ravel()], axis=1)
    inner = mesh.twin >= 0
    np.testing.assert_array_equal(ends[mesh.twin[inner]], ends[inner][:, ::-1])
    np.testing.assert_array_equal(mesh.wall >= 0, ~inner)
    np.testing.assert_array_equal(workspace.boundary.edges[mesh.wall[~inner]], ends[~inner])
    np.testing.assert_array_equal(np.sort(mesh.wall[~inner]), np.arange(len(workspace.boundary.edges)))
    np.testing.assert_array_equal(ends[mesh.of_wall], workspace.boundary.edges)
    assert set(mesh.origin.tolist()) == set(range(len(vertices)))


def test_a_square_is_two_triangles():
    mesh = Workspace(TEN).triangulation
    assert len(mesh.triangles) == 2 and (mesh.wall >= 0).sum() == 4
    (diagonal,) = np.unique(np.sort(np.flatnonzero(mesh.twin >= 0).reshape(1, 2)), axis=0)
    np.testing.assert_array_equal(mesh.twin[diagonal], diagonal[::-1])


def test_a_wall_that_the_delaunay_triangulation_crosses_is_put_in():
    # A long thin wall between two rows of posts, which are far nearer to one another than its ends.
    posts = [shapely.box(x, y, x + 0.1, y + 0.1) for x in range(1, 9) for y in (4.8, 5.2)]
    workspace = Workspace(TEN, [shapely.box(0.5, 5, 9.5, 5.1), *posts])
    vertices, edges = workspace.boundary.vertices, workspace.boundary.edges
    plain = shapely.get_parts(shapely.delaunay_triangles(shapely.multipoints(vertices), only_edges=True))
    sides = shapely.get_parts(shapely.linestrings(vertices[edges]))
    assert sum(shapely.equals(plain[:, None], sides).any(axis=0)) < len(sides)
    check(workspace)


@given(st.integers(0, 100_000), st.sampled_from([0.0, 0.3, 1.0]))
@settings(max_examples=30, deadline=None)
def test_free_space_is_filled_between_its_walls(seed, turn):
    check(lattice_workspace(seed, turn))


@given(st.integers(0, 100_000))
@settings(max_examples=20, deadline=None)
def test_grown_obstacles_are_triangulated(seed):
    rng = np.random.default_rng(seed)
    obstacles = [rng.uniform(0, 10, 2) + rng.uniform(-1, 1, (3, 2)) for _ in range(8)]
    check(Workspace(TEN, obstacles).inflate(0.2))


@given(st.integers(0, 100_000))
@settings(max_examples=20, deadline=None)
def test_points_are_found_in_the_triangle_that_holds_them(seed):
    workspace = lattice_workspace(seed)
    mesh, x = workspace.triangulation, workspace.sample_free(200, seed)
    x = np.concatenate([x, mesh.triangles.mean(axis=1), workspace.boundary.vertices])
    triangle = mesh.locator.find(x)
    held = shapely.dwithin(shapely.polygons(mesh.triangles)[triangle], shapely.points(x), workspace.tolerance)
    assert (triangle >= 0).all() and held.all()


def test_walls_that_cross_are_refused():
    vertices = np.array([[0.0, 0], [4, 0], [4, 4], [0, 4], [1, 1], [3, 3], [1, 3], [3, 1]])
    square = boundary_of(shapely.box(0, 0, 4, 4), 1e-9)
    assert len(square.edges) == 4
    edges = np.array([[0, 1], [1, 2], [2, 3], [3, 0], [4, 5], [6, 7]])
    with pytest.raises(ValueError, match="cross one another"):
        triangulation_of(Boundary(vertices, edges, np.roll(edges[:, 1], -1)), 1e-9)
