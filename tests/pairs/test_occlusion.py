"""What hides points: all walls between boxes and corners, hardly any others; and occluders, inside obstacles."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely

from plr_jax import Box, Workspace, scenes
from plr_jax._arrays import padded
from plr_jax.pairs import occlusion
from plr_jax.pairs.occlusion import NearWalls, is_across_occluder, near_entries, occluders_of


def random_case(seed, leaves, corners, walls):
    rng = np.random.default_rng(seed)
    lo = rng.uniform(0, 0.9, (leaves, 2))
    hi = lo + rng.uniform(0.01, 0.1, (leaves, 2))
    points = rng.uniform(0, 1, (corners, 2))
    leaf, listed = np.nonzero(rng.uniform(size=(leaves, corners)) < 0.5)
    a = rng.uniform(0, 1, (walls, 2))
    return (lo, hi), leaf, listed, points, np.hstack([a, a + rng.uniform(-0.2, 0.2, (walls, 2))])


def hulls(boxes, leaf, corner):
    lo, hi = (each[leaf] for each in boxes)
    ends = np.stack([lo, np.column_stack([hi[:, 0], lo[:, 1]]), hi, np.column_stack([lo[:, 0], hi[:, 1]]), corner], 1)
    return shapely.convex_hull(shapely.multipoints(ends))


@pytest.mark.parametrize(("leaves", "corners", "walls"), [(1, 3, 5), (3, 1, 40), (21, 7, 60), (70, 5, 33)])
def test_near_walls_are_found_and_few_others(leaves, corners, walls):
    boxes, leaf, listed, points, walls = random_case(leaves, leaves, corners, walls)
    margin = 1e-3
    entry, wall = near_entries(boxes, leaf, listed, points, walls, margin, len(walls))
    found = np.zeros((len(leaf), len(walls)), bool)
    found[entry, wall] = True
    assert found.sum() == len(entry) and (np.diff(entry) >= 0).all()
    lines = shapely.linestrings(walls.reshape(-1, 2, 2))
    apart = shapely.distance(hulls(boxes, leaf, points[listed])[:, None], lines)
    assert found[apart < 0.99 * margin].all()
    assert not found[apart > 3 * margin].all()
    assert found[apart > 3 * margin].mean() < 0.01


@pytest.mark.parametrize("block", [1, 130, 1000])
def test_blocks_of_any_size_find_the_same_walls(monkeypatch, block):
    case = random_case(5, 21, 7, 60)
    together = near_entries(*case, 1e-3, 60)
    monkeypatch.setattr(occlusion, "_BLOCK", block)
    np.testing.assert_array_equal(near_entries(*case, 1e-3, 60), together)
    boxes, leaf, listed, points, walls = case
    for none in ((boxes, leaf[:0], listed[:0], points, walls), (boxes, leaf, listed, points, walls[:0])):
        assert all(len(each) == 0 for each in near_entries(*none, 1e-3, 0))


@pytest.mark.parametrize("n", [pytest.param(40, marks=pytest.mark.full), 2000])  # all walls at once; few first
def test_corners_behind_an_inward_and_an_outward_wall_are_hidden(n):
    boxes, leaf, listed, points, walls = random_case(2, 9, 6, 400)
    walls[:, 2:] = walls[:, :2] + 0.15 * (walls[:, 2:] - walls[:, :2])
    near = NearWalls.of(boxes, leaf, listed, points, walls, 1e-6, (9, 8))
    assert NearWalls.of(boxes, leaf, listed, points, walls[:8], 1e-6, (9, 8)) is None  # most are near
    rng = np.random.default_rng(3)
    entry = rng.integers(len(leaf), size=n)
    x = boxes[0][leaf[entry]] + rng.random((n, 2)) * (boxes[1] - boxes[0])[leaf[entry]]
    corner, place = points[listed[entry]], (np.arange(len(leaf)) - np.searchsorted(leaf, leaf))[entry]

    def left_of(a, b, p):
        return np.sign((b - a)[..., 0] * (p - a)[..., 1] - (b - a)[..., 1] * (p - a)[..., 0])

    a, b, p, q = walls[:, :2], walls[:, 2:], x[:, None], corner[:, None]
    sides = left_of(p, q, a)
    crosses = (left_of(a, b, p) != left_of(a, b, q)) & (sides != left_of(p, q, b))
    expected = (crosses & (sides > 0)).any(axis=1) & (crosses & (sides < 0)).any(axis=1)
    numbers = (jnp.asarray(each.astype(np.uint32)) for each in (leaf[entry], place))
    found = jax.jit(near.hide)(*numbers, *(jnp.asarray(each, jnp.float32) for each in (x, corner)))
    np.testing.assert_array_equal(found, expected)
    assert 0.05 < expected.mean() < 0.95 and near.most > 32


@pytest.mark.parametrize("limit", ["_MOST_TESTS", "_MOST_PAIRS"])
def test_too_many_near_walls_give_none(monkeypatch, limit):
    case = random_case(5, 21, 7, 60)
    entry, _ = near_entries(*case, 1e-3, 60)
    most = int(np.bincount(entry).max())
    assert near_entries(*case, 1e-3, most) is not None and near_entries(*case, 1e-3, most - 1) is None
    monkeypatch.setattr(occlusion, limit, len(entry) - 1)
    assert near_entries(*case, 1e-3, most) is None


def ends_of(workspace, depth=1e-5):
    """Both ends of the occluders of a workspace."""
    rows = occluders_of(workspace.free_space, workspace.bounds, depth, 1000)
    middle = (workspace.bounds.lo + workspace.bounds.hi) / 2
    return rows[:, :4].reshape(-1, 2, 2) + middle


def test_occluders_lie_inside_obstacles_and_hide_most_pairs():
    workspace = scenes.floor_plan().workspace
    ends = ends_of(workspace)
    assert 8 < len(ends) < 128
    solid = shapely.box(*workspace.bounds.lo, *workspace.bounds.hi).difference(workspace.free_space).buffer(-0.9e-5)
    assert shapely.covers(solid, shapely.linestrings(ends)).all()
    x, y = workspace.sample_free(2_000, seed=8).reshape(2, -1, 2)
    hidden = ~workspace.is_visible(x, y)
    lines = shapely.linestrings(np.stack([x, y], axis=1))
    told = shapely.intersects(shapely.union_all(shapely.linestrings(ends)), lines)
    assert not (told & ~hidden).any() and told.sum() > 0.8 * hidden.sum()


def test_thin_or_absent_obstacles_yield_no_occluders():
    empty = Workspace(Box((0, 0), (1, 1)))
    assert len(ends_of(empty)) == len(ends_of(scenes.thin_maze().workspace, depth=0.01)) == 0


@pytest.mark.usefixtures("unchecked_types")
def test_occluders_hide_no_points_beyond_their_ends():
    workspace, hides = scenes.floor_plan().workspace, jax.jit(is_across_occluder)
    rows = occluders_of(workspace.free_space, workspace.bounds, 1e-5, 1000).astype(np.float32)
    rng = np.random.default_rng(0)
    for row in rows[:8]:
        a, b = row[:4].reshape(2, 2)
        near, far = rng.uniform(0.001, 1, (2, 2000, 1)).cumsum(axis=0)
        noise = 24e-7 * rng.normal(size=(2, 2000, 2)) * rng.integers(0, 20, (2000, 1))  # of a width of 24
        x, y = (b + share * (b - a) + each for share, each in zip((near, far), noise, strict=True))
        # The last segment crosses the occluder in the middle.
        middle, across = (a + b) / 2, np.array([a[1] - b[1], b[0] - a[0]])
        x, y = (np.vstack(each).astype(np.float32) for each in ((x, middle - across), (y, middle + across)))
        group = jnp.asarray(padded(row[None], 16)[None])
        for found in (hides(group, x, y), hides(group, y, x)):
            assert found[-1] and not found[:-1].any()
