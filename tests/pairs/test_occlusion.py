"""What hides points: all walls between boxes and corners, hardly any others."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely

from plr_jax.pairs import occlusion
from plr_jax.pairs.occlusion import NearWalls, near_entries


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
