"""Distances between pairs of points: exact, symmetric, bounded, differentiable, and small as a file."""

import csv
import math
import tracemalloc

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from piece_helpers import fan_workspace, general_workspace, lattice_workspace

import plr_jax
from plr_jax import Box, PairPLR, VisibilityGraph, Workspace, construct_pairs, scenes
from plr_jax.pairs.outline import Outline
from plr_jax.pairs.pair_plr import pairs_from_bytes
from plr_jax.pairs.stored import Stored
from plr_jax.plr.file.container import Header
from plr_jax.plr.partition.cells import Cells, levels_of

MAZE = scenes.maze().workspace
WALL = Workspace(((0, 0), (10, 10)), [[(4, 0), (6, 0), (6, 8), (4, 8)]])


@pytest.fixture(scope="module")
def maze():
    return construct_pairs(MAZE, max_bytes=1024)


@pytest.fixture(scope="module")
def wall():
    return construct_pairs(WALL, max_bytes=512)


def exact(workspace, x, y):
    """Distances by the oracle of each second point, of which there are few."""
    goals, which = np.unique(y, axis=0, return_inverse=True)
    oracle = VisibilityGraph(workspace, goals[0])
    result = np.empty(len(x))
    for i, goal in enumerate(goals):
        result[which == i] = oracle.with_goal(goal)(x[which == i])
    return result


def some_pairs(workspace, goals, n, seed):
    """Free points, and goals that repeat."""
    x = workspace.sample_free(goals * n, seed)
    return x, np.repeat(workspace.sample_free(goals, seed + 1), n, axis=0)


def test_the_maze_is_exact_in_a_kilobyte(maze):
    assert maze.num_bytes == len(maze.to_bytes()) <= 1024
    x, y = some_pairs(MAZE, 40, 100, seed=5)
    np.testing.assert_allclose(maze(x, y), exact(MAZE, x, y), atol=1e-6)


def test_hand_drawn_distances(wall):
    around = math.hypot(2, 4) + 2 + math.hypot(2, 4)
    x = [(2, 4), (2, 4), (2, 9), (4, 8), (4, 3), (0, 0), (4, 0), (3, 3)]
    y = [(8, 4), (2, 9), (8, 9), (6, 8), (4, 7), (10, 0), (6, 0), (3, 3)]
    expected = [around, 5, 6, 2, 4, 2 * math.hypot(4, 8) + 2, 18, 0]
    np.testing.assert_allclose(wall(np.array(x, float), np.array(y, float)), expected, rtol=1e-6)


@pytest.mark.parametrize("squeeze", [False, True])
@pytest.mark.parametrize("make", [general_workspace, lattice_workspace])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_any_workspace_is_exact_and_bounded(make, seed, squeeze):
    workspace = make(np.random.default_rng(seed), squeeze)
    pairs = construct_pairs(workspace, max_bytes=4096)
    x, y = some_pairs(workspace, 12, 40, seed)
    truth, scale = exact(workspace, x, y), workspace.bounds.width.max()
    np.testing.assert_allclose(pairs(x, y), truth, atol=3e-6 * scale)
    lower, upper = (np.asarray(bound, np.float64) for bound in pairs.bounds(x, y))
    assert (lower <= truth).all() and (upper >= truth).all()
    assert (np.asarray(lower)[np.isfinite(truth)] >= truth[np.isfinite(truth)] - 1e-4 * scale).all()
    if not squeeze:  # between walls that touch nothing is certainly free
        assert np.isfinite(upper[np.isfinite(truth)]).mean() > 0.9


def assert_exact_and_bounded(pairs, workspace, seed):
    x, y = some_pairs(workspace, 6, 40, seed)
    truth, scale = exact(workspace, x, y), workspace.bounds.width.max()
    np.testing.assert_allclose(pairs(x, y), truth, atol=3e-6 * scale)
    lower, upper = (np.asarray(bound, np.float64) for bound in pairs.bounds(x, y))
    assert (lower <= truth).all() and (upper >= truth).all()
    assert (lower[np.isfinite(truth)] >= truth[np.isfinite(truth)] - 1e-4 * scale).all()


@pytest.mark.parametrize("squeeze", [False, True])
@pytest.mark.parametrize("make", [general_workspace, lattice_workspace])
def test_every_prefix_is_exact_and_bounded(make, squeeze):
    workspace = make(np.random.default_rng(3), squeeze)
    pairs = construct_pairs(workspace, max_bytes=2048)
    assert len(pairs.file_marks) == 2
    for mark in pairs.file_marks:
        assert_exact_and_bounded(pairs_from_bytes(pairs.to_bytes()[:mark]), workspace, seed=3)


def flat_arc(height):
    """An obstacle whose top turns by less than the lattice tells."""
    top = np.stack([3 + np.linspace(0, 4, 9), 5 + height * np.sin(np.linspace(0, np.pi, 9))], axis=1)
    return Workspace(((0, 0), (10, 10)), [[*top.tolist(), (7, 2), (3, 2)]])


def narrow_gap(width):
    lower, upper = [(4, 0), (6, 0), (6, 5), (4, 5)], [(4.1, 5 + width), (6, 5 + width), (6, 10), (4.1, 10)]
    return Workspace(((0, 0), (10, 10)), [lower, np.add(upper, (1 / 3, 0))])


@pytest.mark.parametrize("workspace", [flat_arc(1e-8), flat_arc(1e-7), narrow_gap(1e-8), narrow_gap(1e-7)])
def test_of_details_that_the_outline_does_not_tell_the_first_part_says_which_corners_are_joined(workspace):
    pairs = construct_pairs(workspace, max_bytes=2048)
    (mark,) = pairs.file_marks
    cut = pairs_from_bytes(pairs.to_bytes()[:mark])
    assert pairs.stored.rounding_of_outline is None and cut.stored.rounding == pairs.stored.rounding
    np.testing.assert_array_equal(cut.stored.joined, pairs.stored.joined)
    for each in (pairs, cut):
        assert_exact_and_bounded(each, workspace, seed=0)


def serpentine(corners):
    """A file, cut off before its lists, of a corridor with so many corners, each joined to none."""
    k = np.arange(corners // 2)
    points = np.concatenate([np.stack([2 * k, 3 * (k % 2)], 1), np.stack([2 * k, 10 + 3 * (k % 2)], 1)[::-1]])
    outline = Outline(np.zeros(2), 1.0, points, np.array([0, corners]), False)
    joined, listed = np.zeros((0, 2), np.int64), np.arange(corners)
    levels = levels_of(Cells.root(2))[0]
    domain = Box((0, 0), (2 * len(k), 14))
    stored = Stored(domain, outline, listed, joined, levels, 0 * listed, listed, 1e-3, 1e-3)
    return stored.to_bytes()


def test_to_load_a_file_takes_what_its_bytes_do():
    """Also where few bytes are of many corners, of which tables take hundreds of megabytes."""
    data = serpentine(8192)
    pairs_from_bytes(serpentine(64))  # what is loaded but once is there
    for size in (*Header.read(data).marks, len(data)):
        tracemalloc.start()
        pairs = pairs_from_bytes(data[:size])
        grown = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert grown < 500 * size < 2**23 and "tables" not in vars(pairs)
        assert pairs.num_corners == 8192


def test_tables_are_made_once_when_they_are_first_needed(maze):
    x, y = some_pairs(MAZE, 5, 20, seed=4)
    expected = maze(x, y)
    for ask in (lambda pairs: pairs(x, y), lambda pairs: jax.jit(pairs.__call__)(x, y)):
        pairs = pairs_from_bytes(maze.to_bytes())
        assert "tables" not in vars(pairs) and repr(pairs) == repr(maze)
        assert "tables" not in vars(pairs.with_label("new"))
        np.testing.assert_allclose(ask(pairs), expected, rtol=3e-7)
        tables = vars(pairs)["tables"]
        assert not any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree_util.tree_leaves(tables))
        ask(pairs)
        assert vars(pairs)["tables"] is tables is pairs.with_label("new").tables
    fresh = pairs_from_bytes(maze.to_bytes())
    moved = jax.tree_util.tree_map(jnp.asarray, fresh)
    np.testing.assert_allclose(moved(x, y), expected, rtol=3e-7)
    assert moved.to_bytes() == maze.to_bytes()
    paths = {jax.tree_util.keystr(path) for path, _ in jax.tree_util.tree_leaves_with_path(fresh)}
    assert {".file", ".tables.distances"} <= paths


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (
            np.random.default_rng(0).integers(0, 1000, (300, 2)),
            "300 walls of its outline cross one another too often",
        ),
        (np.stack([np.arange(60) % 7, np.zeros(60, int)], axis=1), "too often|bounds no workspace"),
        (np.array([(2000, 0), (3000, 0), (2000, 1000)]), "bounds no workspace"),
    ],
)
def test_an_outline_of_nothing_is_found_out_when_it_is_asked(points, message):
    corner = np.arange(len(points))
    outline, levels = (
        Outline(np.zeros(2), 1.0, points, np.array([0, len(points)]), False),
        levels_of(Cells.root(2))[0],
    )
    joined = np.zeros((0, 2), np.int64)
    data = Stored(Box((0, 0), (1000, 1000)), outline, corner, joined, levels, 0 * corner, corner, 0.0, 0.0).to_bytes()
    first, second = Header.read(data).marks
    assert np.isfinite(pairs_from_bytes(data[:second])(np.ones(2), np.ones(2)))
    with pytest.raises(ValueError, match=f"The file cannot be asked: .*({message})"):
        pairs_from_bytes(data[:first])(np.ones(2), np.ones(2))


def test_points_beside_walls_see_nothing_behind_contacts():
    gap = 1e-6
    diagonal = Workspace(((0, 0), (10, 10)), [[(0, 0), (5, 0), (5, 5), (0, 5)], [(5, 5), (10, 5), (10, 10), (5, 10)]])
    pairs = construct_pairs(diagonal)
    x, y = np.meshgrid(np.linspace(1, 4, 7), gap * np.array([0.5, 1, 2, 5, 10]))
    above = np.stack([x.ravel(), 5 + y.ravel()], axis=1)  # in the part that ends at the contact
    below = 10 - above
    _, upper = pairs.bounds(above[:, None], below[None])
    assert np.isinf(upper).all()


def test_the_budget_that_is_meant_if_none_is_given_is_told(monkeypatch):
    monkeypatch.setattr("plr_jax.pairs.construct.DEFAULT_MAX_BYTES", 50)
    with pytest.raises(ValueError, match="max_bytes=50"):
        construct_pairs(MAZE)


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize(
    "ring",
    [
        [(2, 2), (2 + 1e-7, 2), (2 + 1e-7, 2 + 1e-7), (2, 2 + 1e-7)],
        [(2, 2), (3, 2), (3 + 1e-7, 2 + 1e-7), (3 + 1e-7, 3), (2, 3)],
    ],
)
def test_walls_shorter_than_the_lattice_is_wide_hide_no_other_walls(ring):
    shifted = np.array(ring) + 1 / 3
    workspace = Workspace(((0, 0), (10, 10)), [[(4, 0), (6, 0), (6, 8), (4, 8)], shifted])
    pairs = construct_pairs(workspace, max_bytes=1024)
    x, y = some_pairs(workspace, 5, 60, seed=0)
    truth = exact(workspace, x, y)
    np.testing.assert_allclose(pairs(x, y), truth, atol=1e-5)
    lower, upper = pairs.bounds(x, y)
    assert (lower <= truth).all() and (truth <= upper).all() and np.isfinite(upper).mean() > 0.9


@pytest.mark.parametrize("seed", range(100, 104))
def test_a_corner_at_a_contact_is_seen(seed):
    workspace = fan_workspace(np.random.default_rng(seed))
    pairs = construct_pairs(workspace, max_bytes=4096)
    x, y = some_pairs(workspace, 12, 60, seed)
    truth = exact(workspace, x, y)
    np.testing.assert_allclose(pairs(x, y), truth, atol=1e-4)
    lower, upper = pairs.bounds(x, y)
    assert (lower <= truth).all() and (truth <= upper).all()


def test_long_lists_are_searched_to_their_ends():
    rng = np.random.default_rng(14)
    angles = rng.uniform(0, 2 * np.pi, (12, 12, 1)) + np.array([0, 2.1, 4.2])
    corners = 0.5 + rng.uniform(0.1, 0.48, (12, 12, 1, 1)) * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    corners += np.stack(np.meshgrid(range(12), range(12)), axis=-1)[:, :, None]
    chosen = corners[rng.uniform(size=(12, 12)) < 0.45]
    wall = [(6, 0), (6.01, 0), (6.01, 12), (6, 12)]
    workspace = Workspace(((0, 0), (12, 12)), [*chosen, wall])
    pairs = construct_pairs(workspace, max_bytes=4200)
    assert np.bincount(pairs.stored.leaf).max() > 64
    x, y = some_pairs(workspace, 8, 100, seed=0)
    np.testing.assert_allclose(pairs(x, y), exact(workspace, x, y), atol=1e-5)


def test_symmetric_to_the_last_bit_and_zero_on_the_diagonal(maze):
    x, y = MAZE.sample_free(4000, 1), MAZE.sample_free(4000, 2)
    np.testing.assert_array_equal(maze(x, y), maze(y, x))
    np.testing.assert_array_equal(maze(x, x), np.zeros(4000))


def test_what_is_not_connected_is_infinitely_far():
    workspace = Workspace(((0, 0), (10, 4)), [[(4, 0), (6, 0), (6, 4), (4, 4)]])
    pairs = construct_pairs(workspace)
    assert np.isinf(pairs(np.array([1.0, 1]), np.array([9.0, 1])))
    lower, upper = pairs.bounds(np.array([1.0, 1]), np.array([9.0, 1]))
    assert np.isinf(lower) and np.isinf(upper)
    assert pairs(np.array([1.0, 1]), np.array([1.0, 3])) == 2


def test_outside_is_infinite_and_nan_stays(maze):
    inside = np.array([0.1, 0.1])
    for x, y in (((1.1, 0.5), inside), (inside, (0.5, -0.1)), ((np.inf, 0.5), inside)):
        assert np.isinf(maze(np.array(x), np.array(y)))
    assert np.isnan(maze(np.array([np.nan, 0.5]), inside)) and np.isnan(maze(inside, np.array([np.nan, 2.0])))
    with np.errstate(over="raise"):
        assert np.isinf(maze(np.array([1e300, 0.5]), inside))
    gradient = jax.grad(maze)(jnp.array([1.1, 0.5]), jnp.array(inside))
    np.testing.assert_array_equal(gradient, [0, 0])


def test_the_corners_of_the_domain_are_inside(maze):
    corners = np.array([(0, 0), (1, 1), (1, 0), (0, 1)], float)
    assert np.isfinite(maze(corners, np.array([0.1, 0.1]))).all()


def test_gradients_are_those_of_the_first_legs(maze):
    x, y = some_pairs(MAZE, 20, 10, seed=3)
    of_x, of_y = jax.jit(jax.vmap(jax.grad(maze, argnums=(0, 1))))(jnp.asarray(x), jnp.asarray(y))
    np.testing.assert_allclose(np.linalg.norm(of_x, axis=1), 1, atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(of_y, axis=1), 1, atol=1e-5)
    step = 1e-5
    for axis in range(2):
        shift = step * np.eye(2)[axis]
        for gradient, difference in (
            (of_x, exact(MAZE, x + shift, y) - exact(MAZE, x - shift, y)),
            (of_y, exact(MAZE, y + shift, x) - exact(MAZE, y - shift, x)),
        ):
            error = np.abs(np.asarray(gradient)[:, axis] - difference / (2 * step))
            assert np.median(error) < 1e-3 and (error < 1e-2).mean() > 0.97  # but where the way on changes


def test_gradient_is_zero_where_the_distance_is(maze):
    x = jnp.array([0.1, 0.1])
    for gradient in jax.grad(maze, argnums=(0, 1))(x, x):
        np.testing.assert_array_equal(gradient, [0, 0])


def test_jit_vmap_and_shapes_agree(maze):
    x, y = (jnp.asarray(MAZE.sample_free(60, seed).reshape(3, 20, 2)) for seed in (1, 2))
    expected = maze(x, y)
    assert expected.shape == (3, 20) and maze(x, y[0, 0]).shape == (3, 20) and maze(x[0, 0], y[0, 0]).shape == ()
    np.testing.assert_allclose(jax.jit(maze.__call__)(x, y), expected, rtol=3e-7)
    np.testing.assert_allclose(jax.vmap(jax.vmap(maze))(x, y), expected, atol=1e-6)
    np.testing.assert_allclose(jax.jit(lambda pairs, x, y: pairs(x, y))(maze, x, y), expected, rtol=3e-7)
    np.testing.assert_allclose(maze(np.asarray(x, np.float64), np.asarray(y)), expected, atol=1e-6)


def test_large_batches_are_answered_as_small_ones(maze):
    x, y = MAZE.sample_free(70_000, 1), MAZE.sample_free(70_000, 2)
    every = np.asarray(maze(x, y))
    np.testing.assert_allclose(jax.jit(maze.__call__)(x, y), every, rtol=3e-7, atol=3e-7)
    for part in (slice(0, 100), slice(65_500, 65_600), slice(69_990, 70_000)):
        np.testing.assert_allclose(every[part], maze(x[part], y[part]), atol=3e-7)


def test_far_from_the_origin_it_is_as_exact():
    far = np.array([5e5, 4e6])
    workspace = Workspace((far, far + 10), [far + np.array(p.exterior.coords) for p in WALL.obstacles])
    pairs = construct_pairs(workspace)
    x, y = some_pairs(workspace, 5, 50, seed=1)
    np.testing.assert_allclose(pairs(x, y), exact(workspace, x, y), atol=1e-5)


def test_one_goal_is_an_ordinary_plr(maze):
    goal = scenes.maze().goals[0]
    plr = maze.to(goal)
    assert isinstance(plr, plr_jax.PLR) and plr.leaf.name == "cone"
    x = MAZE.sample_free(5000, 3)
    error = np.abs(np.asarray(plr(x)) - VisibilityGraph(MAZE, goal)(x))
    assert error.mean() < 1e-5 and error.max() < 0.02
    assert plr_jax.from_bytes(plr.to_bytes()).num_bytes == plr.num_bytes
    for wrong in ((2.0, 2.0), (np.nan, 0.0), (1.0,)):
        with pytest.raises(ValueError, match=r"goal|Goal"):
            maze.to(wrong)


def test_the_published_lengths_of_the_arena(data_dir):
    folder = data_dir / "polyanya_arena"
    workspace = scenes.read_polygons(folder / "arena_polygons.json")
    pairs = construct_pairs(workspace, max_bytes=32_768)
    assert pairs.num_bytes <= 32_768
    with (folder / "arena_euclid.csv").open() as file:
        rows = list(csv.DictReader(file))
    x, y = (np.array([[float(row[f"{end}_x"]), float(row[f"{end}_y"])] for row in rows]) for end in ("start", "goal"))
    published = np.array([float(row["euclid_length"]) for row in rows])
    error = np.abs(np.asarray(pairs(x, y), np.float64) - published) / published
    assert len(rows) == 160 and error.max() < 5e-5


def test_a_smaller_budget_gives_a_coarser_partition():
    sizes = [construct_pairs(MAZE, max_bytes=size) for size in (200, 400, 800)]
    assert [pairs.num_bytes <= size for pairs, size in zip(sizes, (200, 400, 800), strict=True)] == [True] * 3
    assert sizes[0].num_leaves < sizes[1].num_leaves < sizes[2].num_leaves


def test_the_same_workspace_gives_the_same_bytes():
    assert construct_pairs(WALL, max_bytes=300).to_bytes() == construct_pairs(WALL, max_bytes=300).to_bytes()


def test_what_is_refused(maze):
    for wrong in (np.zeros((3, 3)), [[0, 0]], None):
        with pytest.raises(ValueError, match="Workspace"):
            construct_pairs(wrong)
    with pytest.raises(ValueError, match="alone take"):
        construct_pairs(MAZE, max_bytes=50)
    with pytest.raises(ValueError, match="max_bytes"):
        construct_pairs(MAZE, max_bytes=0)
    with pytest.raises(ValueError, match="wide"):
        construct_pairs(Workspace(((0, 0), (1e20, 1e20))))
    with pytest.raises(ValueError, match=r"shape \(\.\.\., 2\)"):
        maze(np.zeros((4, 3)), np.zeros(2))
    with pytest.raises(ValueError, match="real"):
        maze(np.zeros((4, 2), complex), np.zeros(2))


def test_properties(maze):
    assert isinstance(maze, PairPLR) and maze.domain == Box((0, 0), (1, 1))
    assert maze.num_corners == 12 and maze.num_leaves == len(maze.stored.cells)
    assert len(levels_of(maze.stored.cells)[0]) == len(maze.stored.levels)
    assert "num_corners=12" in repr(maze) and maze.resident_bytes > maze.num_bytes


def test_walls_too_thin_for_32_bits_are_refused():
    def with_wall(thickness):
        return Workspace(((0, 0), (10, 10)), [[(5, 0), (5 + thickness, 0), (5 + thickness, 8), (5, 8)]])

    with pytest.raises(ValueError, match="thinner than"):
        construct_pairs(with_wall(1e-5))
    pairs = construct_pairs(with_wall(1e-3))
    x, y = np.array([[4.0, 1.0]]), np.array([[6.0, 1.0]])
    around = VisibilityGraph(with_wall(1e-3), y[0])(x)
    np.testing.assert_allclose(pairs(x, y), around, rtol=1e-6)
    assert pairs.bounds(x, y)[0] <= around


BOXES = {
    "spike": [[(0.4, 0.4), (0.6, 0.4), (0.6, 0.6), (0.4, 0.6)]],
    "bridge": [[(x, 0.4), (x + 0.2, 0.4), (x + 0.2, 0.6), (x, 0.6)] for x in (0.1, 0.7)],
}


def sliver(kind, thickness):
    """A wall thinner than sight resolves, glued to a box, or to two."""
    low, high = 0.5 - thickness / 2, 0.5 + thickness / 2
    wall = [(0.5, low), (0.5, high), (0.95, 0.5)]
    if kind == "bridge":
        wall = [(0.2, low), (0.8, low), (0.8, high), (0.2, high)]
    return Workspace(((0, 0), (1, 1)), [*BOXES[kind], wall])


@pytest.mark.parametrize("kind", BOXES)
@pytest.mark.parametrize("thickness", [1e-7, 2e-6])
def test_beside_walls_too_thin_for_sight_answers_are_finite_and_bounded(kind, thickness):
    workspace = sliver(kind, thickness)
    pairs = construct_pairs(workspace, max_bytes=400)
    along = {"spike": np.linspace(0.62, 0.93, 9), "bridge": np.linspace(0.32, 0.68, 9)}[kind]
    half = thickness / 2 * ((0.95 - along) / 0.45 if kind == "spike" else np.ones(len(along)))
    beside = [np.stack([along, 0.5 + side * (half + gap)], 1) for side in (-1, 1) for gap in (1e-6, 3e-6, 1e-4)]
    goals = np.array([(0.8, 0.9), (0.8, 0.1), (0.5, 0.7), (0.05, 0.5)])
    x, y = (each.reshape(-1, 2) for each in np.broadcast_arrays(np.concatenate(beside)[:, None], goals))
    truth = exact(workspace, x, y)
    lower, upper = pairs.bounds(x, y)
    assert (lower <= truth).all() and (truth <= upper).all()
    found, on_one_side = np.asarray(pairs(x, y)), np.abs(x[:, 1] - 0.5) > 5e-5
    assert (found <= truth + 1e-6).all()  # the distance on the other side of the wall, where that is less
    np.testing.assert_allclose(found[on_one_side], truth[on_one_side], atol=1e-6)


def test_from_where_an_obstacle_touches_the_bounds_both_sides_are_seen():
    workspace = Workspace(((0, 0), (1024, 1024)), [[(489, 684), (805, 112), (0, 319)]])
    pairs = construct_pairs(workspace)
    x, y = np.array([0.0, 319.0]), np.array([(489.0, 684.0), (805.0, 112.0), (0.0, 700.0), (0.0, 100.0)])
    truth = VisibilityGraph(workspace, x)(y)
    np.testing.assert_allclose(truth, np.linalg.norm(y - x, axis=1))
    np.testing.assert_allclose(pairs(x, y), truth, rtol=1e-6)
    np.testing.assert_allclose(pairs(y, x), truth, rtol=1e-6)
    lower, upper = pairs.bounds(x, y)
    assert (lower <= truth).all() and (truth <= upper).all()
    across = np.array([(1.0, 700.0)]), np.array([(1.0, 100.0)])  # what touches is no gap
    np.testing.assert_allclose(pairs(*across), exact(workspace, *across), rtol=1e-6)


def touching_workspace(rng):
    """Triangles on a lattice, of which corners touch walls and bounds, and a sliver across them."""
    rings = rng.integers(0, 9, (4, 3, 2)) / 8
    turn = np.linalg.det(rings[:, 1:] - rings[:, :1])
    start, end = rng.uniform(0.05, 0.95, (2, 2))
    aside = 10 ** rng.uniform(-7, -3) * np.array([start[1] - end[1], end[0] - start[0]])
    return Workspace(((0, 0), (1, 1)), [*rings[np.abs(turn) > 1e-9], [start - aside, start + aside, end]])


def corners_and_points_of_walls(workspace, rng, count):
    """Free points: vertices, points on walls, and such as are as near to one as is told from it."""
    boundary = workspace.boundary
    edge, share = rng.integers(len(boundary.edges), size=4 * count), rng.uniform(size=(4 * count, 1))
    on_walls = (boundary.segments[edge] * np.stack([share, 1 - share], axis=1)).sum(axis=1)
    beside = on_walls + rng.choice([0, 3e-7, 1e-6, 1e-5], (4 * count, 1)) * boundary.normal[edge]
    beside[: len(boundary.vertices)] = boundary.vertices
    return rng.permutation(beside[workspace.is_free(beside)])[:count]


@pytest.mark.parametrize("seed", [1, 2, 4])  # of others some have walls that are refused
def test_points_of_walls_and_contacts_are_answered_and_bounded(seed):
    rng = np.random.default_rng(seed)
    workspace = touching_workspace(rng)
    pairs = construct_pairs(workspace, max_bytes=350)
    points = corners_and_points_of_walls(workspace, rng, 40)
    x, y = np.repeat(points[:12], 40, axis=0), np.tile(points, (12, 1))
    truth = np.maximum(exact(workspace, x, y), exact(workspace, y, x))  # which differ where sight may go either way
    lower, upper = pairs.bounds(x, y)
    assert (lower <= truth).all() and (truth <= upper).all()
    assert np.isfinite(pairs(x, y)[np.isfinite(truth)]).all()


def test_no_shapes_and_types_are_promoted(wall):
    x, y = jnp.array([(2.0, 4.0), (2.0, 9.0)]), jnp.array([(8.0, 4.0), (8.0, 9.0)])
    plr = wall.to((8.0, 4.0))
    with jax.numpy_rank_promotion("raise"), jax.numpy_dtype_promotion("strict"):
        expected = [2 * math.hypot(2, 4) + 2, 6]
        np.testing.assert_allclose(wall(x, y), expected, rtol=1e-6)
        np.testing.assert_allclose(wall(x - 10, y[0], outside="clamp") >= 0, True)
        lower, upper = wall.bounds(x, y)
        assert (lower <= np.array(expected)).all() and (upper >= np.array(expected)).all()
        np.testing.assert_allclose(plr.waypoint(x[:1]), [(4, 8)], atol=1e-5)
