"""Discs that go one after the other: straight ways against Shapely, paths against an independent test."""

import numpy as np
import pytest
import shapely
from planner_helpers import ROOM, exact, hallway
from robot_helpers import AnyShape

from plr_jax import DiscRobot, PointRobot, Problem, Workspace, bl_plan, scenes, validate
from plr_jax._problem import path_cost
from plr_jax.metrics import makespan
from plr_jax.planners.sequential import CornerRoadmap, sequential_path, with_early_departures

NEEDLE = Workspace(((0, 0), (10, 10)), [[(0, 4.9), (7, 5), (0, 5.1)], [(10, 1), (8, 2), (9, 0.5)]])
L_SHAPED = Workspace(((0, 0), (10, 10)), [shapely.box(2, 2, 8, 3), shapely.box(2, 2, 3, 8), shapely.box(6, 6, 7, 9)])
MAPS = {"door": scenes.single_door().workspace, "needle": NEEDLE, "rooms": L_SHAPED, "empty": ROOM}


@pytest.mark.parametrize("name", MAPS)
def test_free_ways_agree_with_shapely(name):
    workspace, radius = MAPS[name], 0.4
    roadmap, x = CornerRoadmap(workspace, radius), workspace.sample_free(1500, seed=1)
    x = np.concatenate([x[workspace.clearance(x) >= radius], roadmap.q])
    rng = np.random.default_rng(0)
    begin, end = x[rng.integers(len(x), size=(2, 2000))]
    end[::2] = begin[::2] + rng.normal(size=end[::2].shape)  # half of the ways are short
    inside = workspace.clearance(end) >= radius
    begin, end = begin[inside], end[inside]
    distance = shapely.distance(shapely.linestrings(np.stack([begin, end], axis=1)), workspace.walls)
    clear = np.abs(distance - radius) > 1e-7
    free = roadmap.is_free(begin, end)
    np.testing.assert_array_equal(free[clear], distance[clear] > radius)
    assert name == "empty" or 0.1 < free.mean() < 0.98
    assert free[~clear].all(), "ways along walls and around corners only touch"


def test_tiny_slopes_do_not_hide_walls():
    workspace = Workspace(((-5, -5), (5, 5)), [shapely.box(-2, -1, 3, 1)])
    roadmap = CornerRoadmap(workspace, 0.4)
    for x in (0.0, 5e-324, 1e-310, -1e-250, 1e-150):
        assert not roadmap.is_free(np.array([(0.0, -4.0)]), np.array([(x, 4.0)])).any()
        assert roadmap.is_free(np.array([(-3.0, -4.0)]), np.array([(-3.0 + x, 4.0)])).all()


@pytest.mark.parametrize("name", MAPS)
def test_roadmap_corners_are_a_radius_off_walls(name):
    workspace, radius = MAPS[name], 0.4
    q, boundary = CornerRoadmap(workspace, radius).q, workspace.boundary
    assert len(q) > 3 and (workspace.clearance(q) >= radius - workspace.tolerance).all()
    touched = np.isclose(q @ boundary.normal.T - boundary.offset, radius).sum(axis=1)
    assert (touched >= (1 if name == "needle" else 2)).all()


def test_lone_disc_takes_shortest_way():
    for name, workspace in MAPS.items():
        rng = np.random.default_rng(3)
        for _ in range(4):
            ends = workspace.sample_free(200, seed=int(rng.integers(1000)))
            ends = ends[workspace.clearance(ends) >= 0.4][:2, None]
            problem = Problem(workspace, [DiscRobot(0.4)], *ends)
            path = sequential_path(problem)
            assert path is not None and validate(problem, path).valid, name
            alone = float(exact(problem)(ends[0][None])[0])
            # A corner of a quarter turn costs up to (2 - pi / 2) of the radius more than the arc.
            assert alone * (1 - 1e-3) <= path_cost(problem, path) <= alone + 5 * 0.43 * 0.4


@pytest.mark.parametrize("name", ["four_rooms", "cross"])
def test_robots_step_aside_to_change_places(name):
    for seed, num_robots in enumerate((2, 3, 4 if name == "four_rooms" else 3)):
        problem = scenes.perturbed(getattr(scenes, name)(num_robots), seed)
        path = sequential_path(problem)
        assert path is not None
        np.testing.assert_array_equal(path, sequential_path(problem))
        assert ((path[1:] != path[:-1]).any(axis=2).sum(axis=1) == 1).all(), "one robot goes at a time"
        retimed = with_early_departures(problem, path)
        assert validate(problem, path).valid and validate(problem, retimed).valid
        assert path_cost(problem, retimed) == pytest.approx(path_cost(problem, path), rel=1e-12)
        assert makespan(problem, retimed) <= makespan(problem, path) * (1 + 1e-12)


def test_robots_with_separate_ways_go_at_once():
    rows = [(1.0, y) for y in (1.0, 3.0, 5.0)], [(9.0, y) for y in (1.0, 3.0, 5.0)]
    problem = Problem(ROOM, [DiscRobot(0.4)] * 3, *rows)
    solution = bl_plan(problem)
    assert solution.cost == pytest.approx(24) and solution.makespan == pytest.approx(8)
    assert solution.stats.found_by == "sequential" and solution.stats.num_expansions == 0


def test_robots_whose_ways_cross_keep_apart():
    problem = Problem(ROOM, [DiscRobot(0.4)] * 2, [(1, 5), (5, 1)], [(9, 5), (5, 9)])
    solution = bl_plan(problem)
    assert validate(problem, solution.path).valid and solution.cost == pytest.approx(16)
    assert 8 < solution.makespan < 10


def test_robots_at_goals_stay_or_come_back():
    still = Problem(ROOM, [DiscRobot(0.4)] * 2, [(2, 5), (5, 5)], [(2, 5), (5, 5)])
    path = sequential_path(still)
    assert path is not None
    np.testing.assert_array_equal(path, still.starts[None])
    np.testing.assert_array_equal(with_early_departures(still, path), path)
    bay = Workspace(((0, 0), (7, 2.2)), [shapely.box(0, 1, 3, 2.2), shapely.box(4.2, 1, 7, 2.2)])
    passed = Problem(bay, [DiscRobot(0.45)] * 2, [(0.6, 0.5), (3.6, 0.5)], [(6.4, 0.5), (3.6, 0.5)])
    path = sequential_path(passed)
    assert path is not None and validate(passed, path).valid
    assert path[:, 1, 1].max() > 1.3, "the second robot waits in the bay"


def test_other_problems_have_no_sequential_path():
    many = Workspace(((0, 0), (20, 2)), [shapely.box(x + 0.5, 0, x + 0.6, 0.5) for x in range(1, 19)])
    ends = [(1, 1)], [(9, 1)]
    nine = [(x, 1) for x in range(1, 10)]
    for problem in (
        scenes.tangle(),
        hallway(5),
        Problem(ROOM, [PointRobot()], *ends),
        Problem(ROOM, [AnyShape(((0, 0),), rounding=0.4)], [(1, 1, 0)], [(9, 1, 2)]),  # a disc with a heading
        Problem(ROOM, [DiscRobot(ROOM.tolerance / 5)] * 2, [(1, 1), (2, 1)], [(9, 1), (8, 1)]),
        Problem(many, [DiscRobot(0.2)], *ends),
        Problem(ROOM, [DiscRobot(0.2)] * 9, nine, [(x, 6) for x, _ in nine]),
    ):
        assert sequential_path(problem) is None


def test_discs_of_unequal_radii_pass_a_door():
    room = Workspace(((0, 0), (10, 10)), [shapely.box(4, 0, 6, 4.4), shapely.box(4, 5.6, 6, 10)])
    for radii in ((0.3, 0.55), (0.55, 0.3)):
        problem = Problem(room, list(map(DiscRobot, radii)), [(1, 5), (9, 5)], [(9, 5), (1, 5)])
        path = sequential_path(problem)
        assert path is not None and validate(problem, path).valid
        assert validate(problem, with_early_departures(problem, path)).valid
