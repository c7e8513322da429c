import contextlib

import numpy as np
import pytest
import shapely
from piece_helpers import SEEDS, TEN, box, exact_turns

from plr_jax.geometry.boundary import Boundary, as_polygon
from plr_jax.geometry.triangulation import triangulation_of
from plr_jax.geometry.vectors import cross_product
from plr_jax.geometry.workspace import Workspace


def lattice_workspace(seed, turn=0.0):
    """Return a turned grid of cells blocked at random: collinear corners and point contacts everywhere."""
    blocked = np.argwhere(np.random.default_rng(seed).random((10, 10)) < 0.3)
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    holes = [box(x, y, x + 1, y + 1) @ rotation.T for x, y in blocked]
    return Workspace.from_polygons([{"outer": box(0, 0, 10, 10) @ rotation.T, "holes": holes}])


def check(workspace):
    """Check that half-edges are a triangulation of free space between its walls."""
    mesh = workspace.triangulation
    (a, b, c), vertices = mesh.triangles.transpose(1, 0, 2), workspace.boundary.vertices
    area = cross_product(b - a, c - a) / 2
    assert (area > 0).all()
    free, beside = workspace.free_space, workspace.tolerance / 100  # of an edge, vertices may be on it
    assert area.sum() == pytest.approx(free.area, rel=1e-9, abs=beside * free.length)
    ends = np.stack([mesh.origin, np.roll(mesh.origin.reshape(-1, 3), -1, axis=1).ravel()], axis=1)
    inner = mesh.twin >= 0
    np.testing.assert_array_equal(ends[mesh.twin[inner]], ends[inner][:, ::-1])
    np.testing.assert_array_equal(mesh.wall >= 0, ~inner)
    np.testing.assert_array_equal(workspace.boundary.edges[mesh.wall[~inner]], ends[~inner])
    np.testing.assert_array_equal(np.sort(mesh.wall[~inner]), np.arange(len(workspace.boundary.edges)))
    np.testing.assert_array_equal(ends[mesh.of_wall], workspace.boundary.edges)
    assert set(mesh.origin.tolist()) == set(range(len(vertices)))


def test_walls_missing_in_delaunay_triangulation_are_inserted():
    # A long thin wall between two rows of posts, which are far nearer to one another than its ends.
    posts = [shapely.box(x, y, x + 0.1, y + 0.1) for x in range(1, 9) for y in (4.8, 5.2)]
    workspace = Workspace(TEN, [shapely.box(0.5, 5, 9.5, 5.1), *posts])
    vertices, edges = workspace.boundary.vertices, workspace.boundary.edges
    plain = shapely.get_parts(shapely.delaunay_triangles(shapely.multipoints(vertices), only_edges=True))
    sides = shapely.get_parts(shapely.linestrings(vertices[edges]))
    assert sum(shapely.equals(plain[:, None], sides).any(axis=0)) < len(sides)
    check(workspace)


@pytest.mark.parametrize("seed", SEEDS)
def test_triangles_fill_free_space_and_points_are_located(seed):
    workspace, rng = lattice_workspace(seed, turn=(0.0, 0.3, 1.0)[seed % 3]), np.random.default_rng(seed)
    check(workspace)
    mesh, tolerance = workspace.triangulation, workspace.tolerance
    x = np.concatenate([workspace.sample_free(200, seed), workspace.boundary.vertices])
    triangle, _ = mesh.locator.find(x)
    assert (triangle >= 0).all()
    assert shapely.dwithin(shapely.polygons(mesh.triangles)[triangle], shapely.points(x), tolerance).all()
    # Points about a tolerance from walls are placed in a triangle that contains them exactly.
    edge = rng.integers(len(workspace.boundary.edges), size=40)
    start, end = workspace.boundary.segments[edge].transpose(1, 0, 2)
    share, height = rng.choice([0, 1e-10, 0.5, 1], (40, 1)), rng.choice([-0.99, -0.5, 0, 0.5, 2], (40, 1))
    x = start + share * (end - start) + height * tolerance * workspace.boundary.normal[edge]
    places = mesh.place(x)
    assert (np.linalg.norm(places.x - x, axis=1) <= 1.01 * tolerance).all()
    for point, corners, on_side in zip(places.x, mesh.triangles[places.triangle], places.on_side, strict=True):
        turns = exact_turns(point, corners)
        assert min(turns) >= 0 and all(side for turn, side in zip(turns, on_side, strict=True) if turn == 0)


def test_points_near_a_contact_snap_to_it():
    workspace = Workspace(TEN, [box(2, 2, 5, 5), box(5, 5, 8, 8)])
    mesh, near = workspace.triangulation, workspace.tolerance * np.array([[0.5, -0.5], [-0.9, 0.1], [3, -3]])
    places = mesh.place(np.array([5.0, 5.0]) + near)
    assert (places.x == 5).all(axis=1).tolist() == [True, True, False]
    across = mesh.place(np.array([[6.0, 4.0], [4.0, 6.0]]))
    squeezes = [mesh.are_joined(across[:1], across[1:], workspace.tolerance, squeeze)[0] for squeeze in (False, True)]
    assert squeezes == [False, True]
    for row in range(2):  # the contact is reached from either side
        assert mesh.are_joined(places[:1], across[[row]], workspace.tolerance, False)[0]


def nearly_degenerate(seed):
    """Return walls and gaps 1e-13 to 1e-7 wide that share corners and sides, at any scale and distance."""
    rng = np.random.default_rng(seed)
    obstacles = []

    def point():
        known = rng.choice(np.concatenate(obstacles)) if obstacles and rng.random() < 0.5 else rng.uniform(0, 1, 2)
        return known if rng.random() < 0.7 else rng.integers(0, 9, 2) / 8

    while len(obstacles) < 6:
        a, b, thin = point(), point(), 10.0 ** rng.uniform(-13, -7)
        aside = thin * (b - a)[::-1] * [-1, 1]
        bent = [a, a + (b - a) / 2 + aside, b, point()]
        ring = np.array(([a, b, b + aside], [a, b, b + aside, a + aside], [a, b, point()], bent)[rng.integers(4)])
        if shapely.Polygon(ring).is_valid and (np.abs(a - b) > 1e-6).all():
            obstacles.append(ring)
    scale, shift = 10.0 ** rng.integers(-3, 7), rng.choice([0, 1, 1e3, 1e8]) * rng.normal(size=2)
    kept = []
    for ring in obstacles:
        with contextlib.suppress(ValueError):  # a ring that is no polygon after rounding
            kept.append(as_polygon("It", scale * (ring + shift)))
    return Workspace(scale * (np.array([[0, 0], [1, 1]]) + shift), kept)


@pytest.mark.parametrize("seed", [*SEEDS, *range(24, 36)])
def test_nearly_degenerate_walls_are_triangulated(seed):
    check(nearly_degenerate(seed))


def test_wall_thinner_than_rounding_vanishes():
    x, y = (3.96908577907, 2.33828255806), (1.6957386179, 1.69573861793)
    workspace = Workspace(((0, 0), (2.79592852977, 2.79592852977)), [[(x[0], y[0]), (x[0], y[1]), (x[1], y[1])]])
    check(workspace)
    assert len(workspace.boundary.edges) == 4


def test_crossing_walls_raise():
    vertices = np.array([[0.0, 0], [4, 0], [4, 4], [0, 4], [1, 1], [3, 3], [1, 3], [3, 1]])
    edges = np.array([[0, 1], [1, 2], [2, 3], [3, 0], [4, 5], [6, 7]])
    with pytest.raises(ValueError, match="cross one another"):
        triangulation_of(Boundary(vertices, edges, np.roll(edges[:, 1], -1)), 1e-9)
