"""Random buildings, compared with an independent search: distances, next links, routes, proven bounds, pairs."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from building_checks import Case, are_broken, are_wrong, wrong_of_oracle, wrong_of_pairs, wrong_of_plr
from building_helpers import BruteForce
from building_scenes import GOAL, samples, two_floors
from piece_helpers import box

from plr_jax import Building, Link, Workspace

UNREACHED = pytest.mark.filterwarnings("ignore:The goal cannot be reached:UserWarning")
HALL = Workspace(((0, 0), (10, 10)))
TOUCHING = Workspace(((0, 0), (10, 10)), [box(0, 5, 5, 10), box(5, 0, 10, 5)])  # no path passes at (5, 5)


def seeds(quick, full):
    return [*range(quick), *(pytest.param(seed, marks=pytest.mark.full) for seed in range(quick, full))]


def faults(wrong):
    """Return the counts of wrong answers that are not 0."""
    return {name: count for name, count in wrong.items() if count and name not in ("points", "traced")}


@pytest.mark.parametrize("seed", seeds(5, 300))
@pytest.mark.parametrize("num_goals", [1, 3])
def test_oracle_equals_an_independent_search(seed, num_goals):
    wrong = wrong_of_oracle(Case(seed, num_goals))
    assert wrong["points"] and not faults(wrong)


@UNREACHED
@pytest.mark.parametrize("seed", seeds(1, 100))
@pytest.mark.parametrize("num_goals", [1, 3])
def test_bounds_hold_and_routes_from_files_are_free(seed, num_goals):
    case = Case(seed, num_goals)
    plr = case.oracle.construct(max_bytes=1200 + 60 * len(case.building.links), certified=True)
    assert not faults(wrong_of_plr(case, plr))


@UNREACHED
@pytest.mark.full
@pytest.mark.parametrize("seed", range(60))
def test_goals_that_cost_something_to_use_equal_an_independent_search(seed):
    case = Case(seed, 3)
    search, goals, allowed = case.search, case.goals, case.search.allowed
    offsets = np.random.default_rng(seed).uniform(0, 0.3 * case.building.floors[0].bounds.width.max(), 3)
    oracle, field = case.building.oracle(goals, offsets=offsets), search.field(goals, offsets)
    fields = [search.field([goal], [offset]) for goal, offset in zip(goals, offsets, strict=True)]
    plr = oracle.construct(max_bytes=1200 + 60 * len(case.building.links), certified=True)
    for floor, (x, _) in enumerate(case.points):
        truth, nearest = field(floor, x), oracle.nearest_goal(floor, x)
        assert not are_wrong(oracle(floor, x), truth, allowed).any()
        of_each = np.stack([*(field(floor, x) for field in fields), np.full(len(x), np.inf)])
        assert not are_wrong(of_each[nearest, np.arange(len(x))], truth, allowed).any(), "-1 without a path"
        reached = np.isfinite(truth)
        assert not are_broken(plr.bounds(floor, x[reached]), truth[reached]).any()
        assert not reached.any() or not are_wrong(oracle[floor](x), truth, allowed).any()
        for i in np.flatnonzero(reached)[::3]:
            route = oracle.shortest_path(floor, x[i])
            end, goal = route.legs[-1], goals[nearest[i]]
            assert end[0] == goal[0] and np.abs(end[1][-1] - goal[1]).max() <= allowed
            assert abs(route.length + offsets[nearest[i]] - truth[i]) <= allowed


@UNREACHED
@pytest.mark.full
@pytest.mark.parametrize("leaf", ["plane", "continuous"])
@pytest.mark.parametrize("seed", range(4))
def test_bounds_of_other_leaves_hold(seed, leaf):
    case = Case(seed, 2)
    assert not faults(wrong_of_plr(case, case.oracle.construct(leaf, max_bytes=2500, certified=True)))


@pytest.mark.parametrize("seed", seeds(1, 60))
def test_bounds_of_pairs_hold(seed):
    assert not faults(wrong_of_pairs(Case(seed)))


def test_search_finds_distances_by_hand():
    search = BruteForce(two_floors())
    assert search.distance((1, (-5 + 19, 3 + 8)), GOAL) == pytest.approx(1 + 0.5 + np.hypot(2, 4)), "the slide"
    assert search.distance((0, (6, 0)), (0, (8.2, 8))) == pytest.approx(np.hypot(2, 8) + 0.2)
    touching = BruteForce(Building([TOUCHING]))
    assert np.isinf(touching.distance((0, (1, 1)), (0, (9, 9))))
    assert touching.distance((0, (1, 1)), (0, (5, 5))) == pytest.approx(np.hypot(4, 4))


def test_links_where_obstacles_touch_open_no_way_between_the_obstacles():
    """A link may be taken from both sides of the contact, but nobody walks through."""
    link = Link((0, (5, 5)), (1, (1, 1)), 2)
    building = Building([TOUCHING, HALL], [link])
    oracle = building.oracle(0, (9, 9))
    there_and_back = np.hypot(4, 4) + 2 + 2 + np.hypot(4, 4)
    np.testing.assert_allclose(oracle(0, [(1, 1), (5, 5), (8, 9)]), [there_and_back, np.hypot(4, 4), 1])
    assert oracle.which(0, [(1, 1), (5, 5), (8, 9)]).tolist() == [0, -1, -1]
    assert oracle.shortest_path(0, (1, 1)).links == [0, 0]
    plr, x = oracle.construct(max_bytes=800, certified=True), TOUCHING.sample_free(50, 0)
    np.testing.assert_allclose([route.length for route in plr.trace(0, x, building)], oracle(0, x), atol=1e-5)
    np.testing.assert_allclose(plr(0, x), oracle(0, x), atol=1e-4, err_msg="a file keeps the link's two sides apart")
    one_way = Building([TOUCHING, HALL], [Link(link.start, link.end, 2, both_ways=False)])
    assert np.isinf(one_way.oracle(0, (9, 9))(0, [(1, 1)]))


@pytest.mark.parametrize("gap", [1e-3, 3e-8, 1e-9])
def test_routes_end_if_a_file_merges_the_ends_of_links(gap):
    a, b, c = ((0, (5 + i * gap, 5)) for i in range(3))
    building = Building([HALL], [Link(a, b, 0, both_ways=False), Link(c, b, 0)])
    oracle = building.oracle(0, (9, 5))
    plr = oracle.construct(max_bytes=600, certified=True)
    for route in [*plr.trace(0, [(1, 5), (2, 5)], building), oracle.shortest_path(0, (1, 5))]:
        assert route.length == pytest.approx(9 - route.legs[0][1][0][0], abs=3 * gap + 1e-5)


def test_links_on_a_floor_may_be_shorter_than_walking_and_several_links_may_join_two_places():
    ends = (0, (1, 5)), (0, (9, 5))
    building = Building([HALL], [Link(*ends, 3.0), Link(*ends, 1.0, both_ways=False), Link(*ends, 20.0)])
    oracle = building.oracle(*ends[1])
    np.testing.assert_allclose(oracle(0, [(1, 5), (0, 5), (7, 5)]), [1, 2, 2])
    assert oracle.which(0, [(1, 5), (7, 5)]).tolist() == [1, -1]
    back = building.oracle(*ends[0])
    np.testing.assert_allclose(back(0, [(9, 5), (5, 5)]), [3, 4])
    assert back.shortest_path(0, (9, 5)).links == [0]


def test_nearest_of_several_goals_and_floors_that_no_path_leaves():
    building = Building([HALL, HALL, HALL], [Link((0, (1, 1)), (1, (1, 1)), 5, both_ways=False)])
    oracle = building.oracle([(1, (1, 2)), (1, (9, 9)), (0, (9, 1))])
    np.testing.assert_allclose(oracle(np.array([0, 1, 1, 2]), [(1, 1), (1, 3), (9, 8), (5, 5)]), [6, 1, 1, np.inf])
    assert oracle.which(2, [(5, 5)]).tolist() == [-2]
    assert oracle.nearest_goal([0, 1, 1, 2], [(1, 1), (1, 3), (9, 8), (5, 5)]).tolist() == [0, 0, 1, -1]
    costly = building.oracle(oracle.goals, offsets=[9, 0, 3])
    np.testing.assert_allclose(costly([0, 1], [(1, 1), (1, 3)]), [11, 10])
    assert costly.nearest_goal([0, 1, 1, 2], [(1, 1), (1, 3), (5, 9), (5, 5)]).tolist() == [2, 0, 1, -1]
    assert oracle.shortest_path(2, (5, 5)).legs == []
    assert oracle[0]([(1, 1), (9, 2)]).tolist() == [6, 1]
    with pytest.raises(ValueError, match=re.escape("No goal can be reached from floor 2.")):
        oracle[2]
    with pytest.raises(IndexError, match="floors 0 to 2"):
        oracle[3]


def test_buildings_without_corners_and_links_at_the_rim_of_floors():
    """Links at the corners of a floor far from the origin, where shifts to the plane round."""
    far = Workspace(((1e6 + 0.1, -0.7), (1e6 + 10.3, 8.9)))
    corners = far.free_space.exterior.coords[:-1]
    building = Building([HALL, far], [Link((0, (0, 0)), (1, corner), 1.0) for corner in corners])
    oracle = building.oracle(0, (3, 4))
    np.testing.assert_allclose(oracle(1, np.array(corners)), 6, atol=1e-6)
    np.testing.assert_allclose(oracle[1](far.sample_free(9, 0)), oracle(1, far.sample_free(9, 0)), atol=1e-6)
    assert oracle.shortest_path(1, far.bounds.lo).length == pytest.approx(6, abs=1e-6)


def test_large_floors_lie_apart_in_32_bits():
    """One unit of 1 between floors of 1e12 was less than the tolerance: paths crossed from floor to floor."""
    wide = Workspace(((0, 0), (1e12, 1e12)))
    building = Building([wide] * 9, [Link((0, (0, 0)), (1, (1e12, 0)), 5)])
    assert np.isinf(building.oracle(2, (5, 5))(np.arange(9), np.full((9, 2), 1e12))).sum() == 8
    floors = building.plane_floors
    lo, hi = (np.float32(corner + floors.shift) for corner in (floors.lo, floors.hi))
    assert (lo[1] - hi[0] > 1e8)[0]


def test_oracle_takes_an_index_or_an_index_for_each_point():
    building = two_floors()
    oracle, (floor, x) = building.oracle(*GOAL), samples(building, 20)
    np.testing.assert_array_equal(np.concatenate([oracle(k, x[floor == k]) for k in (0, 1)]), oracle(floor, x))
    assert np.isinf(oracle(0, [(-1, 0), (8.1, 1), (21, 5)])).all(), "in a wall, and outside"
    on_wall = np.array((8.2, 3), np.float32)
    assert float(on_wall[0]) < 8.2 and oracle.shortest_path(0, on_wall).length == pytest.approx(np.hypot(1.8, 2))


@pytest.mark.parametrize(
    ("links", "goal", "message"),
    [
        ([Link((0, (2, 2)), (2, (1, 1)), 1)], None, "The end of link 0 must be on a floor from 0 to 1, got floor 2"),
        ([Link((0, (2, 11)), (1, (1, 1)), 1)], None, "The start of link 0 must be in free space"),
        ([((0, (1, 1)), (1, (1, 1)), 2)], None, "links must be plr_jax.Link"),
        ([], (0, (1, 11)), "Goal 0 must be in free space, got (1.0, 11.0) on floor 0"),
        ([], (2, (1, 1)), "Goal 0 must be on a floor from 0 to 1, got floor 2"),
        ([], ([], None), "oracle needs a floor and a goal (x, y), or a list of pairs"),
        ([], ([(0, 1, 2)], None), "Goal 0 must be a pair (floor, (x, y))"),
    ],
)
@pytest.mark.usefixtures("unchecked_types")
def test_invalid_links_and_goals(links, goal, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        Building([HALL, HALL], links).oracle(*goal)


@pytest.mark.parametrize("offsets", [[1], [1, -1], [1, np.inf]])
def test_invalid_offsets(offsets):
    with pytest.raises(ValueError, match="offsets must be 2 finite numbers of at least 0, one per goal"):
        Building([HALL]).oracle([(0, (1, 1)), (0, (2, 2))], offsets=offsets)


@pytest.mark.parametrize("arguments", [((0, (1, 1)), (1, (1, np.nan)), 1), ((0, (1, 1)), (0, (2, 1)), -1), (0, 1, 1)])
@pytest.mark.usefixtures("unchecked_types")
def test_invalid_links_are_named(arguments):
    with pytest.raises(ValueError, match="the link from"):
        Link(*arguments)


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_invalid_places_are_named(dtype):
    oracle, x = Building([HALL]).oracle(0, (1, 1)), np.ones((2, 2), dtype)
    wrong = {
        0.0: "floor must be an integer",
        1: "floor must be at least 0",
        (0, 0, 0): "of shape (2,) as the points, got shape (3,)",
    }
    for floor, message in wrong.items():
        for as_array in (np.asarray, jnp.asarray):
            with pytest.raises(ValueError, match=re.escape(message)):
                oracle(as_array(floor), as_array(x))
    with pytest.raises(ValueError, match=r"jax\.pure_callback"):
        jax.jit(lambda x: oracle(0, x))(x)
    with pytest.raises(ValueError, match="floor must be an integer >= 0"):
        oracle["0"]
    assert np.isinf(oracle(0, [(1e300, 0)]))


@pytest.mark.usefixtures("unchecked_types")
def test_floors_are_workspaces_with_equal_squeeze():
    for arguments in ((None,), (HALL,), ([HALL], Link((0, (1, 1)), (0, (2, 2)), 1))):
        with pytest.raises(ValueError, match=r"(floors|links) must be a list, got"):
            Building(*arguments)
    for floors in ([], [HALL, Workspace(((0, 0), (1, 1)), squeeze=True)]):
        with pytest.raises(ValueError, match="one or more floors with equal squeeze"):
            Building(floors)
    with pytest.raises(ValueError, match="Workspace"):
        Building(["hall"])
