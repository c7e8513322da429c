"""A query of pairs: exact and bounded in workspaces of any kind, from each part of a file, and where walls touch."""

import csv
from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from pair_helpers import exact, joined, two_batches
from piece_helpers import TEN, box, fan_workspace, general_workspace, lattice_workspace

from plr_jax import VisibilityGraph, Workspace, construct_pairs, scenes

ROOMS = [
    *(kind(np.random.default_rng(seed)) for kind in (general_workspace, lattice_workspace) for seed in range(2)),
    *(fan_workspace(np.random.default_rng(seed)) for seed in (100, 103)),  # corners at contacts
]


@cache
def pairs_of_rooms(squeeze):
    """Return pairs of all rooms, the workspace, and points that have 32 bits."""
    workspace, x, y = joined(ROOMS, n=160, squeeze=squeeze)
    x, y = np.append(x, x[:20], axis=0), np.append(y, y[-20:], axis=0)  # of rooms that are apart
    return construct_pairs(workspace, max_bytes=8192), workspace, x.astype(np.float32), y.astype(np.float32)


@pytest.mark.parametrize("squeeze", [False, pytest.param(True, marks=pytest.mark.full)])
def test_compiled_distances_are_exact_and_gradients_equal_differences(squeeze):
    pairs, workspace, x, y = pairs_of_rooms(squeeze)
    truth, scale = exact(workspace, x, y), workspace.bounds.width.max()

    @jax.jit
    @partial(jax.grad, argnums=(0, 1), has_aux=True)
    def gradients(x, y):
        distances = pairs(x, y)
        return jnp.where(jnp.isfinite(distances), distances, 0).sum(), distances

    (of_x, of_y), distances = gradients(x, y)
    np.testing.assert_allclose(distances, truth, atol=3e-6 * scale)
    np.testing.assert_allclose(pairs.numpy()(x, y), distances, rtol=0, atol=1e-6 * scale)
    assert not np.any(of_x[np.isinf(truth)]) and not np.any(of_y[np.isinf(truth)])
    x, y = (points[np.isfinite(truth)].astype(float) for points in (x, y))
    for gradient, start, end in ((of_x, x, y), (of_y, y, x)):
        ahead, behind = ([exact(workspace, start + step, end) for step in sign * np.eye(2)] for sign in (1e-5, -1e-5))
        error = np.abs(gradient[np.isfinite(truth)] - np.subtract(ahead, behind).T / 2e-5)
        assert np.median(error) < 1e-3 and (error < 1e-2).mean() > 0.97  # except where the way on changes


@pytest.mark.full
@pytest.mark.parametrize("squeeze", [False, True])
def test_compiled_bounds_contain_exact_distance(squeeze):
    pairs, workspace, x, y = pairs_of_rooms(squeeze)
    x, y = x[::8], y[::8]
    truth, scale = exact(workspace, x, y), workspace.bounds.width.max()
    lower, upper = (np.asarray(bound, float) for bound in jax.jit(pairs.bounds)(x, y))
    reached = np.isfinite(truth)
    assert (lower <= truth).all() and (truth <= upper).all()
    assert np.mean(lower[reached] >= truth[reached] - 1e-4 * scale) > 0.98  # through contacts paths would be shorter
    assert squeeze or np.isfinite(upper[reached]).mean() > 0.9  # between walls that touch nothing is certainly free


def flat_arc(height):
    """An obstacle whose top turns by less than the lattice tells."""
    top = np.stack([3 + np.linspace(0, 4, 9), 5 + height * np.sin(np.linspace(0, np.pi, 9))], axis=1)
    return Workspace(TEN, [[*top.tolist(), (7, 2), (3, 2)]])


def narrow_gap(width):
    lower, upper = [(4, 0), (6, 0), (6, 5), (4, 5)], [(4.1, 5 + width), (6, 5 + width), (6, 10), (4.1, 10)]
    return Workspace(TEN, [lower, np.add(upper, (1 / 3, 0))])


def test_details_finer_than_the_lattice_are_bounded():
    short = [(2, 2), (2 + 1e-7, 2), (2 + 1e-7, 2 + 1e-7), (2, 2 + 1e-7)]
    cut_off = [(2, 2), (3, 2), (3 + 1e-7, 2 + 1e-7), (3 + 1e-7, 3), (2, 3)]
    rooms = [Workspace(TEN, [box(4, 0, 6, 8), np.array(ring) + 1 / 3]) for ring in (short, cut_off)]
    workspace, x, y = joined([*rooms, *(kind(size) for kind in (flat_arc, narrow_gap) for size in (1e-8, 1e-7))])
    pairs, truth, scale = construct_pairs(workspace, max_bytes=2048), exact(workspace, x, y), 32
    np.testing.assert_allclose(pairs(x, y), truth, atol=3e-6 * scale)
    lower, upper = (np.asarray(bound, float) for bound in pairs.bounds(x, y))
    assert (lower <= truth).all() and (truth <= upper).all() and (truth - lower < 1e-4 * scale).all()


def test_points_see_nothing_behind_contacts():
    pairs = construct_pairs(Workspace(TEN, [box(0, 0, 5, 5), box(5, 5, 10, 10)]))
    x, y = np.meshgrid(np.linspace(1, 4, 7), 1e-6 * np.array([0.5, 1, 2, 5, 10]))
    above = np.stack([x.ravel(), 5 + y.ravel()], axis=1)  # in the part that ends at the contact
    _, upper = pairs.bounds(above[:, None], 10 - above[None])
    assert np.isinf(upper).all()


def triangles():
    """Return triangles that no line of sight passes far, and a wall from one side to the other."""
    rng = np.random.default_rng(14)
    angles = rng.uniform(0, 2 * np.pi, (12, 12, 1)) + np.array([0, 2.1, 4.2])
    corners = 0.5 + rng.uniform(0.1, 0.48, (12, 12, 1, 1)) * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    corners += np.stack(np.meshgrid(range(12), range(12)), axis=-1)[:, :, None]
    chosen = corners[rng.uniform(size=(12, 12)) < 0.45]
    return Workspace(((0, 0), (12, 12)), [*chosen, box(6, 0, 6.01, 12)])


@pytest.mark.full
@pytest.mark.usefixtures("compiled")
def test_long_lists_are_searched_to_their_ends():
    workspace = triangles()
    pairs = construct_pairs(workspace, max_bytes=4200)
    assert np.diff(pairs.stored.lists.indptr).max() > 64
    x, y = two_batches(workspace, 800)
    for ends in (y, pairs.prepared(y)):
        np.testing.assert_allclose(pairs(x, ends), exact(workspace, x, y), atol=1e-5)
    x, y = two_batches(workspace, 3000, 5)  # over 1,024 pairs under jit, walls are tested by the boxes of groups
    np.testing.assert_allclose(jax.jit(pairs.__call__)(x, y), exact(workspace, x, y), atol=1e-5)


@pytest.mark.full
def test_lengths_in_arena_equal_published_lengths(data_dir):
    folder = data_dir / "polyanya_arena"
    pairs = construct_pairs(scenes.read_polygons(folder / "arena_polygons.json"), max_bytes=32_768)
    assert pairs.num_bytes <= 32_768
    with (folder / "arena_euclid.csv").open() as file:
        rows = list(csv.DictReader(file))
    x, y = (np.array([[float(row[f"{end}_x"]), float(row[f"{end}_y"])] for row in rows]) for end in ("start", "goal"))
    published = np.array([float(row["euclid_length"]) for row in rows])
    error = np.abs(np.asarray(pairs(x, y), np.float64) - published) / published
    assert len(rows) == 160 and error.max() < 5e-5


WIDTH = 21  # of four rooms


@pytest.mark.parametrize("kind", ["spike", "bridge"])
def test_points_beside_very_thin_walls_are_bounded(kind):
    """Glued to a box, or to two; the first is thinner than the lattice is wide."""
    along = np.linspace(6.2, 9.3, 9) if kind == "spike" else np.linspace(3.2, 6.8, 9)
    rooms, points = [], []
    for i, thickness in enumerate((1e-7 * WIDTH, 2e-6 * WIDTH)):
        low, high = 5 - thickness / 2, 5 + thickness / 2
        if kind == "spike":
            rooms.append(Workspace(TEN, [box(4, 4, 6, 6), [(5, low), (5, high), (9.5, 5)]]))
            half = thickness / 2 * (9.5 - along) / 4.5
        else:
            rooms.append(Workspace(TEN, [box(1, 4, 3, 6), box(7, 4, 9, 6), box(2, low, 8, high)]))
            half = thickness / 2 * np.ones(9)
        gaps = WIDTH * np.array([1e-6, 3e-6, 1e-4])[:, None]
        beside = np.stack([5 + side * (half + gaps) for side in (-1, 1)])
        points.append(np.stack(np.broadcast_arrays(along, beside), axis=-1).reshape(-1, 1, 2) + 11 * np.array([0, i]))
    workspace, _, _ = joined(rooms)
    pairs = construct_pairs(workspace, max_bytes=1024)
    goals = np.array([(8.0, 9.0), (8.0, 1.0), (5.0, 7.0), (0.5, 5.0)])
    for i, x in enumerate(points):
        x, y = (each.reshape(-1, 2) for each in np.broadcast_arrays(x, goals + 11 * np.array([0, i])))
        truth, aside = exact(workspace, x, y), np.abs(x[:, 1] - 5 - 11 * i)
        lower, upper = pairs.bounds(x, y)
        assert (lower <= truth).all() and (truth <= upper).all()
        found, on_one_side = np.asarray(pairs(x, y)), aside > 5e-5 * WIDTH
        # Paths pass a little in front of the ends of thin walls. From the other side of the wall they may be shorter.
        assert (found <= truth + 2e-6 * WIDTH).all()
        np.testing.assert_allclose(found[on_one_side], truth[on_one_side], atol=2e-6 * WIDTH)


def test_both_sides_are_seen_where_obstacle_touches_bounds():
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


def test_boxes_of_groups_contain_their_walls():
    walls = construct_pairs(triangles(), max_bytes=4200).tables.walls
    ends, boxes = np.asarray(walls.groups).reshape(len(walls.groups), -1, 2, 2), np.asarray(walls.boxes)
    is_wall = (np.abs(ends).max(axis=(2, 3)) < 1e29) & (ends[:, :, 0] != ends[:, :, 1]).any(axis=2)
    inside = np.abs(ends - boxes[:, None, None, :2]) <= boxes[:, None, None, 2:]
    assert len(boxes) > 4 and inside.all(axis=(2, 3))[is_wall].all()
