"""A query of pairs: exact and bounded in workspaces of any kind, from each part of a file, and where walls touch."""

import csv

import jax
import numpy as np
import pytest
from pair_helpers import check_exact_and_bounded, exact, joined, two_batches
from piece_helpers import TEN, box, fan_workspace, general_workspace, lattice_workspace

from plr_jax import VisibilityGraph, Workspace, construct_pairs, scenes

pytestmark = pytest.mark.usefixtures("compiled")
ROOMS = [
    *(kind(np.random.default_rng(seed)) for kind in (general_workspace, lattice_workspace) for seed in range(4)),
    *(fan_workspace(np.random.default_rng(seed)) for seed in range(100, 104)),  # corners at contacts
]


@pytest.mark.full
@pytest.mark.parametrize("squeeze", [False, True])
def test_any_workspace_is_exact_and_bounded(squeeze):
    workspace, x, y = joined(ROOMS, squeeze=squeeze)
    x, y = np.append(x, x[:20], axis=0), np.append(y, y[-20:], axis=0)  # of rooms that are apart
    pairs = construct_pairs(workspace, max_bytes=16_384)
    reached = check_exact_and_bounded(pairs, workspace, x, y, loose=0.0 if squeeze else 0.005)
    assert squeeze or reached > 0.9  # between walls that touch nothing is certainly free


def flat_arc(height):
    """An obstacle whose top turns by less than the lattice tells."""
    top = np.stack([3 + np.linspace(0, 4, 9), 5 + height * np.sin(np.linspace(0, np.pi, 9))], axis=1)
    return Workspace(TEN, [[*top.tolist(), (7, 2), (3, 2)]])


def narrow_gap(width):
    lower, upper = [(4, 0), (6, 0), (6, 5), (4, 5)], [(4.1, 5 + width), (6, 5 + width), (6, 10), (4.1, 10)]
    return Workspace(TEN, [lower, np.add(upper, (1 / 3, 0))])


@pytest.mark.full
def test_details_that_the_lattice_does_not_tell_are_bounded():
    whole, x, y = joined([flat_arc(1e-8), flat_arc(1e-7), narrow_gap(1e-8), narrow_gap(1e-7)])
    check_exact_and_bounded(construct_pairs(whole, max_bytes=2048), whole, x, y)


def test_points_beside_walls_see_nothing_behind_contacts():
    pairs = construct_pairs(Workspace(TEN, [box(0, 0, 5, 5), box(5, 5, 10, 10)]))
    x, y = np.meshgrid(np.linspace(1, 4, 7), 1e-6 * np.array([0.5, 1, 2, 5, 10]))
    above = np.stack([x.ravel(), 5 + y.ravel()], axis=1)  # in the part that ends at the contact
    _, upper = pairs.bounds(above[:, None], 10 - above[None])
    assert np.isinf(upper).all()


@pytest.mark.full
@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_walls_shorter_than_the_lattice_is_wide_hide_no_other_walls():
    short = [(2, 2), (2 + 1e-7, 2), (2 + 1e-7, 2 + 1e-7), (2, 2 + 1e-7)]
    cut_off = [(2, 2), (3, 2), (3 + 1e-7, 2 + 1e-7), (3 + 1e-7, 3), (2, 3)]
    rooms = [Workspace(TEN, [box(4, 0, 6, 8), np.array(ring) + 1 / 3]) for ring in (short, cut_off)]
    workspace, x, y = joined(rooms, 120)
    assert check_exact_and_bounded(construct_pairs(workspace, max_bytes=1024), workspace, x, y, 1e-6) > 0.9


def triangles():
    """Return triangles that no line of sight passes far, and a wall from one side to the other."""
    rng = np.random.default_rng(14)
    angles = rng.uniform(0, 2 * np.pi, (12, 12, 1)) + np.array([0, 2.1, 4.2])
    corners = 0.5 + rng.uniform(0.1, 0.48, (12, 12, 1, 1)) * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    corners += np.stack(np.meshgrid(range(12), range(12)), axis=-1)[:, :, None]
    chosen = corners[rng.uniform(size=(12, 12)) < 0.45]
    return Workspace(((0, 0), (12, 12)), [*chosen, box(6, 0, 6.01, 12)])


@pytest.mark.full
def test_long_lists_are_searched_to_their_ends():
    workspace = triangles()
    pairs = construct_pairs(workspace, max_bytes=4200)
    assert np.bincount(pairs.stored.leaf).max() > 64
    x, y = two_batches(workspace, 800)
    for ends in (y, pairs.prepared(y)):
        np.testing.assert_allclose(pairs(x, ends), exact(workspace, x, y), atol=1e-5)


# More than 1,024 pairs at a time are tested only against the walls of boxes that they meet.
MANY = 3_000


def test_many_pairs_among_hundreds_of_corners_are_exact_and_those_of_small_batches():
    workspace = triangles()
    pairs = construct_pairs(workspace, max_bytes=32_768)
    assert pairs.num_corners > 150 and len(pairs.tables.walls.boxes) > 4
    x, y = two_batches(workspace, MANY, seed=5).astype(np.float32)
    found = np.asarray(jax.jit(pairs.__call__)(x, y))
    np.testing.assert_allclose(found, exact(workspace, x, y), atol=12 * 1e-6)
    np.testing.assert_allclose(found, pairs.numpy()(x, y), rtol=3e-7, atol=3e-7)


@pytest.mark.full
def test_many_pairs_of_a_real_map_are_bounded(data_dir):
    workspace = scenes.read_workspace(data_dir / "jupedsim" / "arena.wkt")
    pairs, width = construct_pairs(workspace), workspace.bounds.width.max()
    assert pairs.num_corners > 200 and len(pairs.tables.walls.boxes) > 8
    x, y = two_batches(workspace, MANY, seed=5)
    truth, (lower, upper) = exact(workspace, x, y), np.asarray(jax.jit(pairs.bounds)(x, y), np.float64)
    assert (lower <= truth).all() and (truth <= upper).all() and np.isfinite(upper).mean() > 0.9
    np.testing.assert_allclose(jax.jit(pairs.__call__)(x, y), truth, atol=2e-5 * width)  # some are near walls


@pytest.mark.full
def test_the_published_lengths_of_the_arena(data_dir):
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


@pytest.mark.full
@pytest.mark.parametrize("kind", ["spike", "bridge"])
def test_beside_walls_too_thin_for_sight_answers_are_finite_and_bounded(kind):
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


@pytest.mark.full
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


@pytest.mark.full
@pytest.mark.parametrize("seed", [1, 4])  # of others some have walls that are refused
def test_points_of_walls_and_contacts_are_answered_and_bounded(seed):
    rng = np.random.default_rng(seed)
    workspace = touching_workspace(rng)
    boundary, pairs = workspace.boundary, construct_pairs(workspace, max_bytes=350)
    # Vertices, points on walls, and such as are as near to one as is told from it.
    edge, share = rng.integers(len(boundary.edges), size=160), rng.uniform(size=(160, 1))
    on_walls = (boundary.segments[edge] * np.stack([share, 1 - share], axis=1)).sum(axis=1)
    points = on_walls + rng.choice([0, 3e-7, 1e-6, 1e-5], (160, 1)) * boundary.normal[edge]
    points[: len(boundary.vertices)] = boundary.vertices
    points = rng.permutation(points[workspace.is_free(points)])[:40]
    x, y = np.repeat(points[:12], 40, axis=0), np.tile(points, (12, 1))
    oracle = VisibilityGraph(workspace, x[0])
    distance = np.array([oracle.with_goal(point)(points) for point in points])
    truth = np.maximum(distance[:12], distance[:, :12].T).ravel()  # which differ where sight may go either way
    lower, upper = pairs.bounds(x, y)
    assert (lower <= truth).all() and (truth <= upper).all()
    assert np.isfinite(pairs(x, y)[np.isfinite(truth)]).all()
