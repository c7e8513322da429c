"""The nearest of several goals (distances, indices and paths), and the distance of each robot to its own goal."""

import pickle

import numpy as np
import pytest
from building_checks import are_broken, are_wrong
from building_helpers import BruteForce, points_of, random_floor, random_place
from piece_helpers import box

from plr_jax import Box, Building, DiscRobot, PointRobot, Problem, RectangleRobot, Workspace, construct
from plr_jax.oracles import Euclidean, NearestGoal, VisibilityGraph, exact_lower_bound, robot_distance_fns

# A room of two, and one without a goal.
ROOMS = Workspace(((0, 0), (10, 4)), [[(4, 0), (4.2, 0), (4.2, 3), (4, 3)], [(8, 0), (8.1, 0), (8.1, 4), (8, 4)]])
DOCKS = [(1.0, 1.0), (7.0, 1.0), (3.5, 3.5)]
FIRST = VisibilityGraph(ROOMS, DOCKS[0])
FNS = [FIRST, *map(FIRST.with_goal, DOCKS[1:])]
X, DOMAIN = ROOMS.sample_free(2000, 0), Box((0, 0), (10, 4))


def test_distance_index_and_path_to_the_nearest_goal():
    nearest = NearestGoal(FNS)
    assert (nearest.dim, nearest.is_lower_bound) == (2, True)
    each = np.stack([fn(X) for fn in FNS])
    np.testing.assert_array_equal(nearest(X), each.min(axis=0))
    x = [(1, 0.9), (5, 0.5), (3.9, 3.5), (9, 1), (-1, 0), (np.nan, 1)]
    assert nearest.which(x).tolist() == [0, 1, 2, -1, -1, -1]
    assert np.isinf(nearest(x)).tolist() == [False] * 3 + [True] * 3
    for point, which in zip(x, (0, 1, 2, 0, 0, 0), strict=True):
        np.testing.assert_array_equal(nearest.shortest_path(point), FNS[which].shortest_path(point))
    assert NearestGoal([FIRST, FIRST]).which(x[:1]).tolist() == [0], "of equals the first"


def test_masked_and_nan_distances_are_unreachable():
    class Masked:
        dim = 1

        def __call__(self, x):
            return np.ma.masked_array(np.where(x[:, 0] < 0, np.nan, x[:, 0]), x[:, 0] > 1)

    nearest = NearestGoal([Masked()])
    assert nearest([[0.5], [2.0], [-1.0]]).tolist() == [0.5, np.inf, np.inf]
    assert nearest.which([[2.0], [-1.0]]).tolist() == [-1, -1]
    with pytest.raises(ValueError, match="Paths need oracles with shortest_path"):
        nearest.shortest_path([0.5])


def test_visibility_graphs_of_one_workspace_have_cells():
    nearest, other = NearestGoal(FNS), VisibilityGraph(Workspace(((0, 0), (10, 4))), DOCKS[0])
    for each in (nearest, pickle.loads(pickle.dumps(nearest))):
        np.testing.assert_array_equal(each.cell_sources(DOMAIN).sources.points[:3], DOCKS)
        assert each.reach(DOMAIN) is not None, "one room has no goal"
    for fns in ([*FNS, other], [FIRST, Euclidean((1, 1))]):
        nearest = NearestGoal(fns)
        assert nearest.cell_sources is None and nearest.reach(DOMAIN) is None
        assert construct(nearest, DOMAIN, max_leaves=2).num_leaves <= 2
        with pytest.raises(ValueError, match=r"answers for whole cells.* got a NearestGoal"):
            construct(nearest, DOMAIN, max_leaves=2, certified=True)


def test_offsets_are_the_costs_of_goals():
    nearest = NearestGoal(FNS, offsets=[0, 2.5, 100])
    each = np.stack([fn(X) + offset for fn, offset in zip(FNS, (0, 2.5, 100), strict=True)])
    np.testing.assert_allclose(nearest(X), each.min(axis=0))
    np.testing.assert_array_equal(nearest.which(X), np.where(np.isinf(each).all(axis=0), -1, each.argmin(axis=0)))
    np.testing.assert_allclose(nearest([DOCKS[2]]), [np.hypot(2.5, 2.5)], err_msg="another goal is cheaper")
    plr = construct(nearest, DOMAIN, leaf="cone", max_bytes=500, certified=True)
    has_path = np.isfinite(nearest(X))
    assert not are_broken(plr.bounds(X[has_path]), nearest(X[has_path])).any()
    assert set(np.asarray(plr.which(X)[has_path]).tolist()) == {0, 1}, "nobody uses a dock that costs 100"


@pytest.mark.parametrize("offsets", [[1.0], [-1.0, 0, 0], [np.inf, 0, 0], [np.nan, 0, 0], "free"])
@pytest.mark.usefixtures("unchecked_types")
def test_invalid_offsets(offsets):
    with pytest.raises(ValueError, match="offsets must be 3 finite numbers of at least 0, one per goal"):
        NearestGoal(FNS, offsets=offsets)


@pytest.mark.parametrize("seed", [*range(3), *(pytest.param(seed, marks=pytest.mark.full) for seed in range(3, 60))])
@pytest.mark.filterwarnings("ignore:The goal cannot be reached:UserWarning")
def test_offsets_equal_an_independent_search(seed):
    rng = np.random.default_rng(seed)
    floor = random_floor(rng, squeeze=bool(rng.random() < 0.3), origins=[0])
    building, width = Building([floor]), floor.bounds.width.max()
    goals = [random_place(rng, [floor], []) for _ in range(rng.integers(1, 7))]
    offsets = np.where(rng.random(len(goals)) < 0.3, 0.0, width * rng.uniform(0, 0.5, len(goals)))
    search, first = BruteForce(building), VisibilityGraph(floor, goals[0][1])
    nearest = NearestGoal([first, *(first.with_goal(goal) for _, goal in goals[1:])], offsets=offsets)
    x = points_of(building, 0, seed, 100)
    truth = search.field(goals, offsets)(0, x)
    assert not are_wrong(nearest(x), truth, search.allowed).any()
    plr = construct(nearest, floor.bounds, leaf="cone", max_bytes=1000, certified=True)
    has_path = np.isfinite(truth)
    assert not are_broken(plr.numpy().bounds(x[has_path]), truth[has_path]).any()


def test_paths_to_a_goal_do_not_pass_another_goal_where_obstacles_touch():
    """The first goal is at the contact and costs 50, so that from below the cheap goal above is out of reach."""
    touching = Workspace(((0, 0), (10, 10)), [box(0, 5, 5, 10), box(5, 0, 10, 5)])
    first = VisibilityGraph(touching, (5, 5))
    nearest = NearestGoal([first, first.with_goal((9, 9))], offsets=[50, 0])
    plr = construct(nearest, touching.bounds, leaf="cone", max_bytes=500, certified=True)
    x = np.array([(1.0, 1.0), (9.0, 8.0), (4.0, 1.0)])
    assert nearest(x) == pytest.approx([50 + np.hypot(4, 4), 1, 50 + np.hypot(1, 4)])
    assert not are_broken(plr.bounds(x), nearest(x)).any()


CORNER = Workspace(((0, 0), (10, 10)), [[(4, 0), (6, 0), (6, 5), (4, 5)]])


def test_disc_goes_around_a_corner_at_its_radius():
    problem = Problem(CORNER, [DiscRobot(1.0)], [(1.0, 1.0)], [(9.0, 1.0)])
    (distance,) = robot_distance_fns(problem)
    # A tangent to each rounded corner, an arc from its direction to the horizontal, and the flat between them.
    tangent = np.sqrt(3**2 + 4**2 - 1)
    arc = np.arctan2(4, 3) + np.arcsin(1 / 5)
    expected = 2 * (tangent + arc) + 2
    assert 0.998 * expected <= distance(problem.starts)[0] <= expected
    (of_center,) = robot_distance_fns(problem, inflated=False)
    np.testing.assert_allclose(of_center(problem.starts), 2 * np.hypot(3, 4) + 2)


def test_goal_of_a_disc_may_touch_a_wall():
    problem = Problem(CORNER, [DiscRobot(0.3)], [(1.0, 1.0)], [(3.7, 2.0)])
    (distance,) = robot_distance_fns(problem)
    np.testing.assert_allclose(distance(np.array([[1.0, 1.0]])), np.hypot(2.7, 1), atol=1e-6)


def test_teams_of_several_shapes():
    workspace = Workspace(((0, 0), (10, 10)))
    robots = [PointRobot(), DiscRobot(0.5), RectangleRobot(2.0, 1.0)]
    problem = Problem(workspace, robots, [(1, 1, 0), (1, 4, 0), (2, 8, 0)], [(9, 1, 0), (9, 4, 0), (8, 8, 0)])
    lengths = [f(start[None, :2])[0] for f, start in zip(robot_distance_fns(problem), problem.starts, strict=True)]
    np.testing.assert_allclose(lengths, [8, 8, 6])
    assert exact_lower_bound(problem) == sum(lengths)


def test_disc_fits_a_passage_exactly_as_wide():
    lower, upper = [(4, 0), (6, 0), (6, 4.5), (4, 4.5)], [(4, 5.5), (6, 5.5), (6, 16), (4, 16)]
    workspace = Workspace(((0, 0), (10, 20)), [lower, upper])
    problem = Problem(workspace, [DiscRobot(0.5)] * 2, [(2, 5), (8, 12)], [(8, 5), (5, 18)])
    (through, _) = robot_distance_fns(problem)
    np.testing.assert_allclose(through(problem.starts[:1]), 6, rtol=1e-9)
    slot = Problem(Workspace(((0, 0), (10, 1))), [DiscRobot(0.5)], [(0.5, 0.5)], [(9.5, 0.5)])
    np.testing.assert_allclose(robot_distance_fns(slot)[0](slot.starts), 9, rtol=1e-9)
