"""Walls between boxes and corners: all that are, and hardly any others."""

import jax.numpy as jnp
import numpy as np
import pytest
import shapely

from plr_jax.pairs import near_walls
from plr_jax.pairs.near_walls import NearWalls, near_entries


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
def test_every_wall_that_comes_near_is_told_and_few_others(leaves, corners, walls):
    boxes, leaf, listed, points, walls = random_case(leaves, leaves, corners, walls)
    margin = 1e-3
    entry, wall = near_entries(boxes, leaf, listed, points, walls, margin, len(walls))
    found = np.zeros((len(leaf), len(walls)), bool)
    found[entry, wall] = True
    assert found.sum() == len(entry) and (np.diff(entry) >= 0).all()
    apart = shapely.distance(
        hulls(boxes, leaf, points[listed])[:, None], shapely.linestrings(walls.reshape(-1, 2, 2))
    )
    assert found[apart < 0.99 * margin].all()
    assert not found[apart > 3 * margin].all()
    assert found[apart > 3 * margin].mean() < 0.01


@pytest.mark.parametrize("block", [1, 130, 1000])
def test_corners_are_looked_at_in_blocks_of_any_size(monkeypatch, block):
    case = random_case(5, 21, 7, 60)
    together = near_entries(*case, 1e-3, 60)
    monkeypatch.setattr(near_walls, "_BLOCK", block)
    np.testing.assert_array_equal(near_entries(*case, 1e-3, 60), together)
    boxes, leaf, listed, points, walls = case
    for none in ((boxes, leaf[:0], listed[:0], points, walls), (boxes, leaf, listed, points, walls[:0])):
        assert all(len(each) == 0 for each in near_entries(*none, 1e-3, 0))


def test_the_walls_of_an_entry_are_read_at_its_place():
    boxes, leaf, listed, points, walls = random_case(1, 9, 6, 400)
    walls[:, 2:] = walls[:, :2] + 0.05 * (walls[:, 2:] - walls[:, :2])
    pairs = near_entries(boxes, leaf, listed, points, walls, 1e-6, 400)
    near = NearWalls.of(boxes, leaf, listed, points, walls, 1e-6, (9, 8))
    assert (
        near is not None and NearWalls.of(boxes, leaf, listed, points, walls[:8], 1e-6, (9, 8)) is None
    )  # most are near
    place = np.arange(len(leaf)) - np.searchsorted(leaf, leaf)
    ends = np.moveaxis(np.asarray(near(*(jnp.asarray(each.astype(np.uint32)) for each in (leaf, place)))), 0, 2)
    for entry, read in enumerate(ends):
        own = walls[pairs[1][pairs[0] == entry]].astype(np.float32)
        np.testing.assert_array_equal(read[: len(own)], own)


@pytest.mark.parametrize("limit", ["_MOST_TESTS", "_MOST_PAIRS"])
def test_more_than_memory_should_hold_are_not_found(monkeypatch, limit):
    case = random_case(5, 21, 7, 60)
    entry, _ = near_entries(*case, 1e-3, 60)
    most = int(np.bincount(entry).max())
    assert near_entries(*case, 1e-3, most) is not None and near_entries(*case, 1e-3, most - 1) is None
    monkeypatch.setattr(near_walls, limit, len(entry) - 1)
    assert near_entries(*case, 1e-3, most) is None
