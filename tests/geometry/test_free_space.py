"""Free space as tables, beside what a workspace answers of NumPy's points, and Shapely."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely

from plr_jax import FreeSpace, Workspace, scenes
from plr_jax.geometry import free_space as cells_module

NEEDLE = [(2, 2), (8, 2.001), (2, 2.002)]
TOUCHING = [[(2, 5), (4, 5), (4, 7), (2, 7)], [(4, 7), (6, 7), (6, 9), (4, 9)]]
ROUND = [(9 + 2 * np.cos(a), 5 + 2 * np.sin(a)) for a in np.linspace(0, 2 * np.pi, 60, endpoint=False)]
FAR = np.array([4096.0, -8192.0])
BOUNDS = ((0, 0), (12, 10))
WORKSPACES = {
    "empty": lambda: Workspace(BOUNDS),
    "full": lambda: Workspace(BOUNDS, [NEEDLE, *TOUCHING, ROUND]),
    "round room": lambda: Workspace.from_polygons([{"outer": ROUND}]),
    "narrow": lambda: Workspace(((0, 0), (100, 1)), [[(50, 0), (51, 0), (51, 0.5), (50, 0.5)]]),
    "far": lambda: Workspace((FAR, FAR + np.array([12, 10])), [np.array(NEEDLE) + FAR]),
    "inflated": lambda: scenes.maze().workspace.inflate(0.01),
}


@pytest.fixture(scope="module")
def maze():
    return scenes.maze().workspace


@jax.jit
def answers(tables, x):
    """Clearance, its gradient, and what is free."""
    clearance, pull = jax.vjp(tables.clearance, x)
    return clearance, pull(jnp.ones_like(clearance))[0], tables.is_free(x)


def exact_in_32_bits(x):
    return np.asarray(x, np.float32).astype(np.float64)


def some_points(workspace, n=2000):
    """Points in the bounds and a little outside, beside walls and corners, and at corners."""
    rng, bounds, vertices = np.random.default_rng(0), workspace.bounds, workspace.boundary.vertices
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


def are_sides_apart(workspace, x):
    """Whether behind the nearest point of a wall there is the other side of it, and not yet what is behind that."""
    ways = shapely.shortest_line(shapely.points(x), workspace.free_space.boundary)
    foot = shapely.get_coordinates(ways).reshape(-1, 2, 2)[:, 1]
    length = np.linalg.norm(foot - x, axis=1, keepdims=True)
    behind = foot + (foot - x) / np.where(length > 0, length, 1) * 2e-6 * workspace.bounds.width.max()
    return (workspace.clearance(behind) < 0) == (workspace.clearance(x) >= 0)


@pytest.mark.parametrize(
    "build",
    [
        pytest.param(build, id=name, marks=[] if name == "full" else pytest.mark.full)
        for name, build in WORKSPACES.items()
    ],
)
def test_clearance_is_that_of_the_workspace_its_gradient_that_by_steps(build):
    workspace = build()
    x, tables, width = some_points(workspace), workspace.tables, workspace.bounds.width.max()
    found, gradient, is_free = (np.asarray(answer) for answer in answers(tables, x))
    close = 1e-6 * width + 4e-7 * np.abs(workspace.bounds.lo).max()  # far away, corners themselves are coarser
    expected, apart = workspace.clearance(x), are_sides_apart(workspace, x)
    np.testing.assert_allclose(found[apart], expected[apart], atol=close)
    np.testing.assert_allclose(np.abs(found), np.abs(expected), atol=close)
    assert apart[: len(x) // 3].mean() > 0.9  # of those anywhere: to some of them a tip is nearest

    assert isinstance(tables, FreeSpace) and 0 < is_free.sum() < len(x)
    assert is_free[apart & workspace.is_free(x)].all()
    assert not is_free[apart & (expected < -2 * float(tables.tolerance))].any()

    x, gradient, step = x[:300], gradient[:300], 1e-6 * width
    by_steps = [workspace.clearance(x + e) - workspace.clearance(x - e) for e in step * np.eye(2)]
    by_steps = np.stack(by_steps, axis=1) / (2 * step)
    is_smooth = np.abs(np.linalg.norm(by_steps, axis=1) - 1) < 1e-6  # no kink within a step
    is_smooth &= np.abs(expected[:300]) > 1e-4 * width
    assert is_smooth.mean() > 0.7 and np.isfinite(gradient).all()
    # Some may be so near the middle between two walls that rounding decides.
    assert (np.abs(gradient - by_steps).max(axis=1)[is_smooth] < 1e-2).mean() > 0.98


@pytest.mark.full
def test_tables_can_be_made_while_a_function_is_traced_and_points_have_any_shape():
    workspace = Workspace(BOUNDS, [NEEDLE])
    x = exact_in_32_bits(np.random.default_rng(0).uniform((0, 0), (12, 10), (4, 5, 2)))

    @jax.jit
    def traced(x):
        one_by_one = jax.vmap(jax.vmap(workspace.clearance))
        return (
            workspace.clearance(x),
            one_by_one(x),
            workspace.is_free(x),
            jax.vmap(jax.grad(workspace.clearance))(x[0]),
        )

    whole, single, is_free, gradient = traced(x)
    expected = workspace.clearance(x.reshape(-1, 2)).reshape(4, 5)
    for found in (whole, single):
        np.testing.assert_allclose(found, expected, atol=1e-5)
    np.testing.assert_array_equal(is_free, expected >= 0)
    np.testing.assert_allclose(np.linalg.norm(gradient, axis=1), 1, rtol=1e-5)


@pytest.mark.full
def test_numbers_that_are_not_finite_and_points_far_outside(maze):
    x = np.array([[np.nan, 0.5], [0.5, np.inf], [-np.inf, np.nan], [9, 0.5], [0.5, -7], [5, 5], [-3e6, 1]])
    found, gradient, is_free = (np.asarray(answer) for answer in answers(maze.tables, x))
    assert np.isnan(found[:3]).all() and not is_free.any()
    x, found, true = x[3:], found[3:], maze.clearance(x[3:])
    assert (found <= 0.9999999 * true).all() and (found >= 1.2 * true).all()
    toward = -np.sign(x - np.clip(x, 0, 1))
    assert (np.sign(gradient[3:]) == toward)[toward != 0].all()


def test_numpy_points_are_answered_without_tables():
    workspace = Workspace(BOUNDS)
    x = np.array([[0.5, 0.05], [0.5, 0.2]])
    assert isinstance(workspace.is_free(x), np.ndarray) and workspace.clearance(x).dtype == np.float64
    assert "tables" not in vars(workspace)


@pytest.mark.full
def test_tables_place_points_of_numpy_in_64_bits(maze):
    origin = np.array([5e5, 4e6])
    far = Workspace((origin, origin + 1), [origin + np.array(wall.exterior.coords) for wall in maze.obstacles])
    x = maze.sample_free(500, 0)
    np.testing.assert_allclose(far.tables.clearance(x + origin), maze.clearance(x), atol=1e-6)
    assert far.tables.is_free(x + origin).all()


def test_wrong_shapes_are_named(maze):
    for fn in (maze.is_free, maze.clearance, maze.tables.is_free):
        with pytest.raises(ValueError, match=r"shape \(\.\.\., 2\), got \(2, 3\)"):
            fn(jnp.zeros((2, 3)))


@pytest.mark.full
def test_memory_is_bounded_where_every_edge_is_the_nearest_somewhere():
    """All edges of a round room are nearly as near its middle, and of a round obstacle as the far outside."""
    angle = np.linspace(0, 2 * np.pi, 2000, endpoint=False)
    workspace = Workspace.from_polygons([{"outer": np.stack([np.cos(angle), np.sin(angle)], axis=1)}])
    assert sum(array.nbytes for array in jax.tree.leaves(workspace.tables)) < 2000 * len(angle)
    x = exact_in_32_bits(np.random.default_rng(0).normal(0, 0.3, (500, 2)))
    np.testing.assert_allclose(workspace.tables.clearance(x), workspace.clearance(x), atol=2e-6)


def test_few_pairs_at_once_change_nothing(monkeypatch, maze):
    expected = cells_module.near_edges(maze.boundary.segments, np.full(2, -1.0), 3.0, 6)
    monkeypatch.setattr(cells_module, "_AT_ONCE", 7)
    found = cells_module.near_edges(maze.boundary.segments, np.full(2, -1.0), 3.0, 6)
    for each, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(each, other)


@pytest.mark.full
def test_a_published_map(data_dir):
    workspace = scenes.read_polygons(data_dir / "movingai/dao/den520d_polygons.json")
    x = exact_in_32_bits(workspace.sample_free(3000, 0))
    found = workspace.tables.clearance(x)
    np.testing.assert_allclose(found, workspace.clearance(x), atol=1e-6 * workspace.bounds.width.max())
    assert workspace.tables.is_free(x).all()


@pytest.mark.full
def test_no_shapes_and_types_are_promoted():
    tables, x = Workspace(BOUNDS, [TOUCHING[0]]).tables, jnp.array([(1.0, 6.0), (3.5, 6.0)])
    with jax.numpy_rank_promotion("raise"), jax.numpy_dtype_promotion("strict"):
        np.testing.assert_allclose(tables.clearance(x), [1, -0.5])
        np.testing.assert_array_equal(tables.is_free(x), [True, False])
