"""Free space as tables, beside Shapely and a search of all edges."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely

from plr_jax import FreeSpace, Workspace, scenes
from plr_jax.geometry import free_space as cells_module

NEEDLE = [(2, 2), (8, 2.001), (2, 2.002)]
TOUCHING = [[(2, 5), (4, 5), (4, 7), (2, 7)], [(4, 7), (6, 7), (6, 9), (4, 9)]]
ROUND = [(6 + 2 * np.cos(a), 5 + 2 * np.sin(a)) for a in np.linspace(0, 2 * np.pi, 60, endpoint=False)]
FAR = np.array([4096.0, -8192.0])
BOUNDS = ((0, 0), (12, 10))
WORKSPACES = {
    "empty": lambda: Workspace(BOUNDS),
    "needle": lambda: Workspace(BOUNDS, [NEEDLE]),
    "touching": lambda: Workspace(BOUNDS, TOUCHING),
    "round hole": lambda: Workspace(BOUNDS, [ROUND]),
    "round room": lambda: Workspace.from_polygons([{"outer": ROUND}]),
    "narrow": lambda: Workspace(((0, 0), (100, 1)), [[(50, 0), (51, 0), (51, 0.5), (50, 0.5)]]),
    "far": lambda: Workspace((FAR, FAR + np.array([12, 10])), [np.array(NEEDLE) + FAR]),
    "maze": lambda: scenes.maze().workspace,
    "floor plan": lambda: scenes.floor_plan().workspace,
    "inflated": lambda: scenes.maze().workspace.inflate(0.01),
}


@pytest.fixture(scope="module", params=WORKSPACES)
def workspace(request):
    return WORKSPACES[request.param]()


def exact_in_32_bits(x):
    return np.asarray(x, np.float32).astype(np.float64)


def some_points(workspace, n=4000, seed=0):
    """Points in the bounds and a little outside, beside walls and corners, and at corners."""
    rng, bounds, vertices = np.random.default_rng(seed), workspace.bounds, workspace.boundary.vertices
    away = 0.1 * bounds.width.max()
    anywhere = rng.uniform(bounds.lo - away, bounds.hi + away, (n, 2))
    beside = vertices[rng.integers(0, len(vertices), n)] + rng.normal(0, 1e-3 * away, (n, 2))
    # Where the nearest point changes from an edge to its end: beside the normal there, on both sides of the edge.
    edge, end = rng.integers(0, len(workspace.boundary.segments), n), rng.integers(0, 2, n)
    first, last = np.moveaxis(workspace.boundary.segments[edge], 1, 0)
    along = (last - first) / np.linalg.norm(last - first, axis=1, keepdims=True)
    off, out = rng.choice([-1, 1], (n, 1)) * 10.0 ** rng.uniform(-8, -3, (n, 1)), rng.uniform(-3, 3, (n, 1))
    normal = np.where(end[:, None], last, first) + away * (off * along + out * along[:, ::-1] * [-1, 1])
    normal = np.clip(normal, bounds.lo - away, bounds.hi + away)
    return exact_in_32_bits(np.concatenate([anywhere, beside, normal, vertices]))


def by_all_edges(workspace, x):
    """Signed distance by Shapely, one point and one edge at a time."""
    lines = shapely.linestrings(workspace.boundary.segments)
    distance = shapely.distance(shapely.points(x)[:, None], lines).min(axis=1)
    return np.where(shapely.intersects_xy(workspace.free_space, *x.T), distance, -distance)


def are_sides_apart(workspace, x):
    """Whether behind the nearest point of a wall there is the other side of it, and not yet what is behind that."""
    ways = shapely.shortest_line(shapely.points(x), workspace.free_space.boundary)
    foot = shapely.get_coordinates(ways).reshape(-1, 2, 2)[:, 1]
    length = np.linalg.norm(foot - x, axis=1, keepdims=True)
    behind = foot + (foot - x) / np.where(length > 0, length, 1) * 2e-6 * workspace.bounds.width.max()
    return (workspace.clearance(behind) < 0) == (workspace.clearance(x) >= 0)


def test_clearance_is_that_of_shapely_and_of_all_edges(workspace):
    x = some_points(workspace)
    found = np.asarray(workspace.tables.clearance(jnp.asarray(x)), np.float64)
    width = workspace.bounds.width.max()
    far = 4e-7 * np.abs(workspace.bounds.lo).max()  # where the corners themselves are coarser
    expected, apart = workspace.clearance(x), are_sides_apart(workspace, x)
    np.testing.assert_allclose(found[apart], expected[apart], atol=1e-6 * width + far)
    np.testing.assert_allclose(np.abs(found), np.abs(expected), atol=1e-6 * width + far)
    assert apart[: len(x) // 3].mean() > 0.9  # of those anywhere: to some of them a tip is nearest
    x, found = x[apart], found[apart]
    np.testing.assert_allclose(found[::20], by_all_edges(workspace, x[::20]), atol=1e-6 * width + far)


def test_free_is_what_is_free_or_nearly(workspace):
    x, tables = some_points(workspace), workspace.tables
    x = x[are_sides_apart(workspace, x)]
    is_free, clearance = np.asarray(tables.is_free(jnp.asarray(x))), workspace.clearance(x)
    assert isinstance(tables, FreeSpace) and 0 < is_free.sum() < len(x)
    assert is_free[workspace.is_free(x)].all()
    assert not is_free[clearance < -2 * float(tables.tolerance)].any()


def test_gradient_is_a_unit_vector_away_from_walls(workspace):
    x = some_points(workspace, 300)[:300]
    clearance = workspace.clearance(x)
    step = 1e-6 * workspace.bounds.width.max()
    by_steps = [workspace.clearance(x + e) - workspace.clearance(x - e) for e in step * np.eye(2)]
    by_steps = np.stack(by_steps, axis=1) / (2 * step)
    is_smooth = np.abs(np.linalg.norm(by_steps, axis=1) - 1) < 1e-6  # no kink within a step
    is_smooth &= np.abs(clearance) > 1e-4 * workspace.bounds.width.max()
    assert is_smooth.mean() > 0.7
    gradient = np.asarray(jax.vmap(jax.grad(workspace.clearance))(jnp.asarray(x)))
    assert np.isfinite(gradient).all()
    close = np.abs(gradient - by_steps).max(axis=1)[is_smooth] < 1e-2
    assert close.mean() > 0.98  # the others are so near the middle between two walls that rounding decides


def test_tables_can_be_made_while_a_function_is_traced():
    workspace, x = Workspace(BOUNDS, [NEEDLE]), jnp.full((5, 2), 1.5)
    first = jax.jit(workspace.clearance)(x)
    np.testing.assert_array_equal(jax.jit(workspace.clearance)(x[:3]), first[:3])
    assert jax.jit(workspace.is_free)(x).all()
    gradient = jax.jit(jax.vmap(jax.grad(workspace.clearance)))(x)
    np.testing.assert_array_equal(gradient, jax.vmap(jax.grad(workspace.clearance))(x))


def test_jit_vmap_and_any_shape_agree():
    workspace = scenes.maze().workspace
    x = jnp.asarray(some_points(workspace, 60)[:120].reshape(4, -1, 2))
    for fn in (workspace.is_free, workspace.clearance):
        expected = np.asarray(fn(x))
        assert expected.shape == x.shape[:-1]
        same = np.testing.assert_array_equal if expected.dtype == bool else np.testing.assert_allclose
        same(jax.jit(fn)(x), expected)
        same(jax.vmap(fn)(x), expected)
        same(np.array([fn(each) for each in x[0, :5]]), expected[0, :5])
    by_argument = jax.jit(lambda tables, x: tables.clearance(x))(workspace.tables, x)
    np.testing.assert_allclose(by_argument, workspace.clearance(x))


def test_numbers_that_are_not_finite_and_points_far_outside():
    workspace = scenes.maze().workspace
    bad = jnp.array([[jnp.nan, 0.5], [0.5, jnp.inf], [-jnp.inf, jnp.nan]])
    assert np.isnan(workspace.clearance(bad)).all() and not workspace.is_free(bad).any()
    x = np.array([[9, 0.5], [0.5, -7], [5, 5], [-3e6, 1]])
    found = np.asarray(workspace.clearance(jnp.asarray(x)))
    true = workspace.clearance(x)
    assert (found <= 0.9999999 * true).all() and (found >= 1.2 * true).all()
    gradient = np.asarray(jax.vmap(jax.grad(workspace.clearance))(jnp.asarray(x)))
    toward = -np.sign(x - np.clip(x, 0, 1))
    assert (np.sign(gradient) == toward)[toward != 0].all()


def test_numpy_points_are_answered_as_before():
    workspace = scenes.maze().workspace
    x = np.array([[0.5, 0.05], [0.5, 0.2]])
    assert isinstance(workspace.is_free(x), np.ndarray) and workspace.clearance(x).dtype == np.float64
    assert "tables" not in vars(workspace)


def test_tables_place_points_of_numpy_in_64_bits():
    origin = np.array([5e5, 4e6])
    near = scenes.maze().workspace
    walls = [origin + np.array(wall.exterior.coords) for wall in near.obstacles]
    far = Workspace((origin, origin + 1), walls)
    x = near.sample_free(500, 0)
    np.testing.assert_allclose(far.tables.clearance(x + origin), near.clearance(x), atol=1e-6)
    assert far.tables.is_free(x + origin).all()


def test_wrong_shapes_are_named():
    workspace = scenes.maze().workspace
    for fn in (workspace.is_free, workspace.clearance, workspace.tables.is_free):
        with pytest.raises(ValueError, match=r"shape \(\.\.\., 2\), got \(2, 3\)"):
            fn(jnp.zeros((2, 3)))


def test_memory_is_bounded_where_every_edge_is_the_nearest_somewhere():
    """All edges of a round room are nearly as near its middle, and of a round obstacle as the far outside."""
    angle = np.linspace(0, 2 * np.pi, 2000, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    workspace = Workspace.from_polygons([{"outer": ring}])
    assert sum(array.nbytes for array in jax.tree.leaves(workspace.tables)) < 2000 * len(angle)
    x = exact_in_32_bits(np.random.default_rng(0).normal(0, 0.3, (500, 2)))
    np.testing.assert_allclose(workspace.clearance(jnp.asarray(x)), workspace.clearance(x), atol=2e-6)


def test_few_pairs_at_once_change_nothing(monkeypatch):
    boundary = scenes.floor_plan().workspace.boundary
    corner, side = boundary.vertices.min(axis=0) - 1, np.ptp(boundary.vertices, axis=0).max() + 2
    expected = cells_module.near_edges(boundary.segments, corner, side, 6)
    monkeypatch.setattr(cells_module, "_AT_ONCE", 7)
    for found, each in zip(cells_module.near_edges(boundary.segments, corner, side, 6), expected, strict=True):
        np.testing.assert_array_equal(found, each)


def test_a_published_map(data_dir):
    workspace = scenes.read_polygons(data_dir / "movingai/dao/den520d_polygons.json")
    x = exact_in_32_bits(workspace.sample_free(3000, 0))
    found = np.asarray(workspace.clearance(jnp.asarray(x)), np.float64)
    np.testing.assert_allclose(found, workspace.clearance(x), atol=1e-6 * workspace.bounds.width.max())
    assert workspace.is_free(jnp.asarray(x)).all()


def test_no_shapes_and_types_are_promoted():
    tables = Workspace(((0, 0), (10, 10)), [[(4, 0), (6, 0), (6, 8), (4, 8)]]).tables
    with jax.numpy_rank_promotion("raise"), jax.numpy_dtype_promotion("strict"):
        np.testing.assert_allclose(tables.clearance(jnp.array([(1.0, 2.0), (5.0, 7.0)])), [1, -1])
        np.testing.assert_array_equal(tables.is_free(jnp.array([(1.0, 2.0), (5.0, 7.0)])), [True, False])
