"""Distances between any two places of a building."""

import jax
import numpy as np
import pytest
from building_scenes import samples, two_floors

from plr_jax import Building, Link, Workspace, construct_pairs, load, save

BUILDING = two_floors()
FLOOR, X = samples(BUILDING, 60)
PAIRS = construct_pairs(BUILDING, max_bytes=2500)


def test_distances_and_bounds_in_both_directions():
    some, all_places = (FLOOR[::12, None], X[::12, None]), (FLOOR[None], X[None])
    ends = FLOOR[::12], X[::12]
    there = np.array([BUILDING.oracle(floor, x)(FLOOR, X) for floor, x in zip(*ends, strict=True)])
    back = np.array([BUILDING.oracle(floor, x)(*ends) for floor, x in zip(FLOOR, X, strict=True)]).T
    assert np.abs(there - back).max() > 1, "the slide leads one way"
    in_numpy = PAIRS.numpy()
    for a, b, truth in ((all_places, some, there), (some, all_places, back)):
        np.testing.assert_allclose(PAIRS(a, b), truth, atol=2e-5)
        lower, upper = map(np.asarray, PAIRS.bounds(a, b))
        assert (lower <= truth + 1e-9).all() and (truth <= upper + 1e-9).all()
        assert np.isfinite(upper).mean() > 0.9
        np.testing.assert_allclose(jax.jit(PAIRS)(a, b), PAIRS(a, b), atol=2e-5)
        np.testing.assert_allclose(in_numpy(a, b), truth, atol=2e-5)
        lower, upper = in_numpy.bounds(a, b)
        assert (lower <= truth + 1e-9).all() and (truth <= upper + 1e-9).all()


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize(
    "points", [[(0, 1), (3, 4)], ((1, 1), (1, 1)), np.ones((3, 2)), np.ones((2, 2), int), 0, (0,)]
)
def test_points_without_floors_are_refused(points):
    for pairs in (PAIRS, PAIRS.bounds, PAIRS.numpy()):
        for ends in ((points, (0, (1, 1))), ((0, (1, 1)), points)):
            with pytest.raises(ValueError, match=r"Places must be \(floor, points\)"):
                pairs(*ends)
    traced = tuple(map(np.asarray, points)) if isinstance(points, list | tuple) else np.asarray(points)
    with pytest.raises(ValueError, match=r"Places must be \(floor, points\)"):
        jax.jit(PAIRS)(traced, (0, np.ones(2)))


@pytest.mark.full
def test_places_inside_vmap():
    floor, x = np.array([0, 1]), np.array([(1.0, 1.0), (2.0, 5.0)])
    there = PAIRS((floor, x), (0, (9, 1)))
    np.testing.assert_allclose(
        jax.vmap(lambda k, x: PAIRS((k, x), (0, np.array((9.0, 1)))))(floor, x), there, atol=2e-5
    )


def test_links_may_be_shorter_than_straight_lines_in_sight():
    hall = Workspace(((0, 0), (30, 10)))
    building = Building([hall], [Link((0, (2, 5)), (0, (28, 5)), 0, both_ways=False)])
    pairs = construct_pairs(building)
    few = pairs((0, [(1.0, 5.0), (29.0, 5.0), (3.0, 5.0)]), (0, [(29.0, 5.0), (1.0, 5.0), (4.0, 5.0)]))
    np.testing.assert_allclose(few, [2, 28, 1], atol=1e-5)
    many = np.tile(few, 400)
    start, end = np.tile([(1, 5), (29, 5), (3, 5)], (400, 1)), np.tile([(29, 5), (1, 5), (4, 5)], (400, 1))
    np.testing.assert_allclose(pairs((0, start), (0, end)), many, atol=1e-5)


def test_file_holds_places_and_links(tmp_path):
    save(PAIRS, path := tmp_path / "building.pairs")
    assert path.stat().st_size == PAIRS.num_bytes <= 2500
    loaded = load(path)
    np.testing.assert_array_equal(loaded((0, X[:50]), (1, (1.0, 5.0))), PAIRS((0, X[:50]), (1, (1.0, 5.0))))
    assert loaded.to_bytes() == PAIRS.to_bytes()
    with pytest.raises(ValueError, match="links"):
        loaded.plane.js_module()
    with pytest.raises(ValueError, match="links"):
        loaded.plane.prepared(X[:2])
