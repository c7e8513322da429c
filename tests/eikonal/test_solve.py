import pickle

import jax
import numpy as np
import pytest
from eikonal_helpers import EMPTY, ROOM, BoxSpace, TwoGrounds, check_bounds
from space_helpers import rectangle

from plr_jax import (
    Box,
    LipschitzCost,
    PlaneSpace,
    RasterCost,
    RectangleRobot,
    RigidBodySpace,
    VisibilityGraph,
    VoxelSpace,
    Workspace,
    from_bytes,
    load,
    save,
    solve_eikonal,
)
from plr_jax.eikonal.bounds import MeshEstimate
from plr_jax.eikonal.estimate import GridEstimate
from plr_jax.plr.growth import ConstructionInterrupted

GOAL = (0.3, 0.4)


class FreeOnly:
    """A space that tests configurations and proves nothing."""

    def __init__(self, space):
        self.domain, self.motion_cost, self.is_free = space.domain, space.motion_cost, space.is_free


class Interrupted(FreeOnly):
    """A space that is interrupted when boxes are classified for the n-th time."""

    def __init__(self, space, calls):
        super().__init__(space)
        self.are_free, self._classify, self.left = space.are_free, space.classify, calls

    def classify(self, lo, hi):
        self.left -= 1
        if self.left == 0:
            raise KeyboardInterrupt
        return self._classify(lo, hi)


@pytest.fixture(scope="module")
def plr():
    return solve_eikonal(PlaneSpace(ROOM), GOAL, max_leaves=200)


def test_of_a_space_that_only_tests_nothing_is_proven():
    plr = solve_eikonal(FreeOnly(PlaneSpace(ROOM)), GOAL, max_leaves=600)
    x = ROOM.sample_free(2000, 0)
    distance = VisibilityGraph(ROOM, GOAL)(x)
    assert np.abs(np.asarray(plr(x)) - distance).mean() < 0.03 * distance.mean()
    assert plr.max_error is None
    with pytest.raises(ValueError, match="Nothing is proven"):
        plr.bounds(x)


@pytest.mark.full
@pytest.mark.parametrize("space", [PlaneSpace(ROOM), FreeOnly(PlaneSpace(ROOM))])
def test_estimates_alone_are_near_and_nothing_is_proven_of_them(space):
    plr = solve_eikonal(space, GOAL, max_leaves=4_096, certified=False)
    x = ROOM.sample_free(2000, 0)
    distance = VisibilityGraph(ROOM, GOAL)(x)
    assert np.abs(np.asarray(plr(x)) - distance).mean() < 0.012 * distance.mean()
    with pytest.raises(ValueError, match="Nothing is proven"):
        plr.bounds(x)
    small = solve_eikonal(space, GOAL, max_leaves=4_096, max_bytes=600, certified=False)
    assert small.num_bytes <= 600
    assert np.abs(np.asarray(small(x)) - distance).mean() < 0.05 * distance.mean()


def test_estimates_alone_are_of_few_axes_and_have_no_tolerance():
    with pytest.raises(ValueError, match=r"got 2 axes and tolerance=0\.1"):
        solve_eikonal(EMPTY, GOAL, certified=False, tolerance=0.1)
    with pytest.raises(ValueError, match=r"up to 3 axes.*got 4 axes"):
        solve_eikonal(BoxSpace(Box((0,) * 4, (1,) * 4)), np.full(4, 0.5), certified=False)


def test_an_estimate_of_a_goal_that_no_node_sees_is_refused():
    """Between two nodes, in a room that is narrower than a step of the grid."""
    walls = [(0, 0), (0.5711, 1)], [(0.5713, 0), (1, 1)], [(0, 0), (1, 0.3511)], [(0, 0.3513), (1, 1)]
    with pytest.raises(ValueError, match="must be seen from a node of the grid of 401 x 401 nodes"):
        solve_eikonal(BoxSpace(Box((0, 0), (1, 1)), *walls), (0.5712, 0.3512), certified=False)
    walls = [(0.3, 0.2), (0.5711, 0.5)], [(0.5713, 0.2), (1, 1)], [(0.3, 0.2), (1, 0.3511)], [(0.3, 0.3513), (1, 1)]
    for num in (1, 9):  # goals that are near one another are not nearest to any node, but that is no obstacle
        goals = [*np.linspace((0.1001, 0.1001), (0.1002, 0.1002), num), (0.5712, 0.3512)]
        with pytest.raises(ValueError, match=rf"must be seen .* \[0.5712, 0.3512\] \(row {num}\) is not: it is too"):
            solve_eikonal(BoxSpace(Box((0, 0), (1, 1)), *walls), goals, certified=False)


EXITS = np.array([(0.3, 0.4), (3.7, 0.3), (1.0, 1.5), (2.2, 2.7), (2.2, 2.7)])  # one on a wall; the last twice


@pytest.fixture(scope="module")
def from_exits():
    """Points of the room, and their distances to each exit."""
    x = ROOM.sample_free(20_000, 0)
    return x, np.stack([VisibilityGraph(ROOM, goal)(x) for goal in EXITS])


@pytest.mark.parametrize(("certified", "error"), [(False, 0.004), (True, 0.01)])
def test_of_several_goals_the_nearest_counts_and_is_known(from_exits, certified, error):
    plr = solve_eikonal(PlaneSpace(ROOM), EXITS, max_leaves=1_000, certified=certified)
    x, distances = from_exits
    least = distances.min(axis=0)
    assert np.abs(np.asarray(plr(x)) - least).mean() < error * least.mean()
    which = plr.which(x)
    excess = distances[which, np.arange(len(x))] - least
    assert (excess > 1e-9).mean() < 0.01 and excess.max() < 0.03  # two steps of the grid
    assert plr.which(EXITS).tolist() == [0, 1, 2, 3, 3]
    assert plr.which([(1.5, 9.0), (np.nan, 1.0)]).tolist() == [-1, -1]


def test_which_goal_is_nearest_is_not_in_files_nor_under_jit(tmp_path):
    plr = solve_eikonal(EMPTY, [(0.1, 0.1), (0.9, 0.9)], max_leaves=50)
    assert plr.with_label("two").which([[0.8, 0.8]]).tolist() == [1]
    save(plr, tmp_path / "two.plr")
    loaded, through = load(tmp_path / "two.plr"), jax.jit(lambda each: each)(plr)
    np.testing.assert_array_equal(jax.jit(lambda each, x: each(x))(plr, EXITS), plr(EXITS))
    for other in (loaded, through, solve_eikonal(EMPTY, (0.1, 0.1), max_leaves=50)):
        with pytest.raises(ValueError, match="does not store which goal is nearest"):
            other.which([[0.8, 0.8]])
    with pytest.raises(ValueError, match="x must have"):
        plr.which([0.8, 0.8])
    estimate = solve_eikonal(EMPTY, [(0.1, 0.1), (0.9, 0.9)], certified=False, max_leaves=50)
    assert pickle.loads(pickle.dumps(estimate)).which([[0.8, 0.8]]).tolist() == [1]


def test_one_goal_in_a_row_or_twice_is_one_goal():
    single, row, twice = (
        solve_eikonal(PlaneSpace(ROOM), goal, max_leaves=100) for goal in (GOAL, [GOAL], [GOAL, GOAL])
    )
    assert single.to_bytes() == row.to_bytes() == twice.to_bytes()
    assert row.which([GOAL]).tolist() == twice.which([GOAL]).tolist() == [0]


@pytest.mark.parametrize("certified", [False, True])
def test_goals_may_be_in_parts_of_space_that_no_path_joins(certified):
    """Three rooms; the walls between them are thicker than what an estimate may reach across."""
    workspace = Workspace(((0, 0), (3, 1)), [rectangle(x, 0, x + 0.2, 1) for x in (0.9, 1.9)])
    goals, x = [(0.5, 0.5), (2.5, 0.5), (2.5, 0.6)], np.array([(0.3, 0.1), (1.5, 0.5), (2.9, 0.1), (2.9, 0.9)])
    plr = solve_eikonal(PlaneSpace(workspace), goals, max_leaves=500, certified=certified)
    assert plr.which(x).tolist() == [0, -1, 1, 2]
    np.testing.assert_allclose(plr(x[[0, 2, 3]]), [np.hypot(0.2, 0.4), np.hypot(0.4, 0.4), 0.5], rtol=0.02)


@pytest.mark.full
def test_an_estimate_of_a_body_that_turns_is_of_planes():
    space, goal = RigidBodySpace(Workspace(((0, 0), (3, 2))), RectangleRobot(0.4, 0.2)), (2.0, 1.0, 3.0)
    plr = solve_eikonal(space, goal, certified=False)
    q = np.random.default_rng(0).uniform((0.4, 0.4, -3.1), (2.6, 1.6, 3.1), (500, 3))
    truth = space.motion_cost.lengths(q, np.broadcast_to(goal, q.shape), space.domain)
    assert plr.leaf.name == "plane"
    assert np.abs(np.asarray(plr(q)) - truth).mean() < 0.03 * truth.mean()


@pytest.mark.parametrize("cells", [4, 25])
def test_points_that_a_contact_of_obstacles_cuts_off_answer_inf(cells):
    """Free squares that touch in a corner, and a diagonal of obstacles that touch in corners."""
    free = np.kron(np.eye(2, dtype=bool), np.ones((cells, cells), bool))
    near, far = (np.array([(share, share)]) * 2 * cells for share in (0.44, 0.56))
    for space in (PlaneSpace(Workspace.from_mask(free, tolerance=0)), VoxelSpace(free.T)):
        plr = solve_eikonal(space, near[0], certified=False)
        assert plr(far).tolist() == [np.inf]
        assert plr([[0.1, 0.1]]) == pytest.approx(np.linalg.norm(near - 0.1), rel=1e-3)
    plr = solve_eikonal(
        PlaneSpace(Workspace.from_mask(~np.eye(cells, dtype=bool), tolerance=0)), (cells - 0.1, 0.1), certified=False
    )
    assert plr(np.array([(0.3, 0.7), (0.1, 0.9)]) * cells).tolist() == [np.inf, np.inf]


def test_an_estimate_has_leaves_where_they_serve_most():
    """A road of one cell among dear ones: its ends are as far apart as they look, also in a small file."""
    values = np.full((60, 60), 10.0)
    values[30] = 1.0
    road = RasterCost(values, ((0, 0), (60, 60)), "nearest")
    plr = solve_eikonal(road.space(), (59.5, 30.5), cost_map=road, max_bytes=1_000, certified=False)
    assert plr.num_bytes <= 1_000
    assert plr([0.5, 30.5]) == pytest.approx(59, rel=0.03)
    assert solve_eikonal(EMPTY, GOAL, certified=False).num_leaves == 2_000


@pytest.mark.parametrize("goal", [(0.7, 0.5), (0.3, 0.5), (0.5, 0.7), (0.26, 0.42)])
def test_a_goal_a_rounding_error_off_a_face_of_cells_is_like_any_other(goal):
    """Fractions of the domain such as (0.7 - 0.1) / 0.8 are not dyadic, but nearly."""
    bounds = ((0.1, 0.1), (0.9, 0.9))
    cost = RasterCost(np.ones((1, 1)), bounds)
    plr = solve_eikonal(VoxelSpace(np.ones((1, 1), bool), bounds), goal, cost_map=cost, max_leaves=100)
    x = np.random.default_rng(0).uniform(0.1, 0.9, (200, 2))
    truth, (lower, upper) = np.linalg.norm(x - goal, axis=1), plr.bounds(x)
    assert (lower <= truth + 1e-6).all() and (truth <= upper + 1e-6).all()


@pytest.mark.parametrize("max_leaves", [100, 400])
def test_an_estimate_is_within_its_bounds_however_much_costs_differ(max_leaves):
    values = np.array([[303.8, 168.5, 28.7, np.inf], [19.7, np.inf, 1.7, 2.2]])
    cost, goal = RasterCost(values, ((1000, 0), (1004, 2)), "nearest"), (1003.75, 1.75)
    plr = solve_eikonal(cost.space(), goal, cost_map=cost, max_leaves=max_leaves)
    x = np.append(np.random.default_rng(0).uniform((1000, 0), (1004, 2), (2_000, 2)), [goal], axis=0)
    x = x[cost.space().is_free(x)]
    lower, upper = plr.bounds(x)
    assert (lower <= plr(x)).all() and (plr(x) <= upper).all()


def test_walls_thinner_than_cells_leave_upper_bounds_in_volumes():
    """Two rooms and a wall of one voxel between them, with a hole of one voxel, at whose edges the path bends."""
    free = np.ones((24, 24, 24), bool)
    free[12] = False
    free[12, 12, 12] = True
    x, goal = np.array([(2.5, 12.5, 2.5)]), (22.5, 12.5, 2.5)
    truth = 2 * np.hypot(9.5, 9.5) + 1
    lower, upper = solve_eikonal(VoxelSpace(free), goal, max_leaves=500).bounds(x)
    assert 20 <= lower <= truth <= upper < 1.25 * truth
    assert solve_eikonal(VoxelSpace(free), goal, certified=False)(x) == pytest.approx(truth, rel=0.02)


@pytest.mark.full
def test_where_costs_vary_the_estimate_is_far_nearer_than_the_bounds():
    """The speed is linear, so that paths are arcs."""
    speed = lambda q: 0.5 + 3 * q[:, 1]  # noqa: E731
    space, goal = BoxSpace(Box((0, 0), (1, 2))), np.array([0.3, 0.6])
    plr = solve_eikonal(space, goal, cost_map=LipschitzCost(lambda q: 1 / speed(q), 12.0, 0.15), max_leaves=600)
    x = np.random.default_rng(0).uniform((0, 0.1), (1, 1), (1000, 2))  # whose arcs stay inside
    truth = np.arccosh(1 + 9 * np.sum((x - goal) ** 2, axis=1) / (2 * speed(x) * speed(goal[None]))) / 3
    lower, upper = plr.bounds(x)
    assert (lower <= truth).all() and (truth <= upper).all()
    assert np.abs(np.asarray(plr(x)) - truth).mean() < 0.02 * np.mean(upper - lower) < 0.01 * truth.mean()


def test_files_keep_what_is_proven_and_where_nothing_is(tmp_path):
    plr = solve_eikonal(PlaneSpace(ROOM), GOAL, max_leaves=60)
    save(plr, tmp_path / "file.plr")
    x = ROOM.sample_free(2000, 0)
    for other in (load(tmp_path / "file.plr"), from_bytes(plr.to_bytes())):
        np.testing.assert_array_equal(np.stack(other.bounds(x)), np.stack(plr.bounds(x)))
        assert other.max_error == plr.max_error == np.inf
    assert np.isinf(plr.bounds(x)[1]).any()


def test_a_leaf_a_cell_or_fewer_leaves_in_so_many_bytes_always_the_same(plr):
    few, more, again = (
        solve_eikonal(PlaneSpace(ROOM), GOAL, max_leaves=200, max_bytes=most) for most in (150, 500, 150)
    )
    assert few.num_bytes <= 150 < more.num_bytes <= 500
    assert few.to_bytes() == again.to_bytes()
    assert plr.to_bytes() == solve_eikonal(PlaneSpace(ROOM), GOAL, max_leaves=200).to_bytes()
    check_bounds(few, ROOM, GOAL)
    x = ROOM.sample_free(2000, 0)
    assert np.asarray(few.bounds(x)[0]).mean() < np.asarray(plr.bounds(x)[0]).mean()


@pytest.mark.parametrize("max_leaves", [1, 2, 5, 17])
def test_few_leaves_are_enough(max_leaves):
    plr = solve_eikonal(PlaneSpace(ROOM), (1.0, 1.0), max_leaves=max_leaves)
    assert 1 <= plr.num_leaves <= max_leaves
    check_bounds(plr, ROOM, (1.0, 1.0))
    plr = solve_eikonal(EMPTY, GOAL, max_leaves=max_leaves)
    assert plr.num_leaves <= max_leaves and np.isfinite(plr.max_error)


def test_a_tolerance_ends_it_early():
    few, more = (solve_eikonal(EMPTY, GOAL, max_leaves=2000, tolerance=tolerance) for tolerance in (0.03, 0.01))
    assert 4 <= few.num_leaves < more.num_leaves < 1500


def test_interrupts_keep_what_there_is():
    with pytest.warns(ConstructionInterrupted, match=r"Interrupted at \d+ of 600 cells"):
        plr = solve_eikonal(Interrupted(PlaneSpace(ROOM), 6), GOAL, max_leaves=600)
    assert 30 < plr.num_leaves < 600
    check_bounds(plr, ROOM, GOAL)
    with pytest.raises(KeyboardInterrupt):  # before there is anything
        solve_eikonal(Interrupted(PlaneSpace(ROOM), 1), GOAL, max_leaves=600)


def test_costs_that_32_bits_do_not_hold_and_meshes_that_memory_does_not_are_refused():
    tiny = RasterCost([[1e-30]], ((0, 0), (1e-3, 1e-3)))
    with pytest.raises(ValueError, match=r"Costs must come to 1e-30 somewhere"):
        solve_eikonal(tiny.space(), (3e-4, 3e-4), cost_map=tiny, max_leaves=20)
    with pytest.raises(ValueError, match="would need about"):
        solve_eikonal(EMPTY, (0.1, 0.1), max_leaves=10**20, tolerance=1)


@pytest.mark.parametrize("answer", [None, [1], np.full(64, 7)])
def test_what_a_space_says_of_boxes_is_checked(answer):
    class Wrong(FreeOnly):
        are_free = PlaneSpace(ROOM).are_free

        def classify(self, lo, hi):
            return answer

    with pytest.raises(ValueError, match="classify must return one CellState per box"):
        solve_eikonal(Wrong(PlaneSpace(ROOM)), GOAL, max_leaves=64)


def test_nothing_is_proven_of_leaves_that_answer_inf_for_open_cells(monkeypatch):
    def estimates(estimate, x):
        return np.where(x.max(axis=1) > 0.3, np.inf, np.sin(40 * x).sum(axis=1))

    for kind in (MeshEstimate, GridEstimate):
        monkeypatch.setattr(kind, "__call__", estimates)
    with pytest.raises(ValueError, match=r"some leaves answer inf, .* Allow more max_bytes"):
        solve_eikonal(EMPTY, (0.1, 0.1), max_leaves=64, max_bytes=76)


def of_bounds(answer):
    """A cost map that answers so of bounds over boxes."""
    cost_map = TwoGrounds(0.5, 2.0)
    cost_map.bounds = answer
    return {"space": EMPTY, "cost_map": cost_map, "max_leaves": 20}


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize(
    ("changed", "message"),
    [
        (
            {"goal": (1.5, 1.5)},
            r"goal must be a free configuration.*1\.5\] is not: it is in an obstacle, or too close",
        ),
        ({"goal": (9.0, 1.5)}, r"goal must be a free configuration.* is not: it does not lie in the domain Box\(\["),
        ({"goal": (0.3,)}, "goal must have 2 coordinates, like the space, or be rows of these, got 1"),
        ({"goal": [(0.3, 0.4, 0.0)] * 2}, r"or be rows of these, got shape \(2, 3\)"),
        ({"goal": np.zeros((0, 2))}, r"got shape \(0, 2\)"),
        ({"goal": [[[0.3, 0.4]]]}, r"got shape \(1, 1, 2\)"),
        *(
            (
                {"goal": [GOAL, wrong], "certified": proven},
                rf"free configuration of the space, .*{wrong[1]}\] \(row 1\)",
            )
            for wrong in ((1.5, 1.5), (9.0, 1.5), (0.3, np.nan))
            for proven in (True, False)
        ),
        ({"goal": (np.nan, 0.4)}, "goal"),
        ({"max_leaves": 0}, "max_leaves must be"),
        ({"max_bytes": 0}, "max_bytes must be"),
        ({"max_leaves": 100, "max_bytes": 20}, r"max_bytes=20 is too small: one leaf takes \d+ bytes"),
        ({"tolerance": -1.0}, "tolerance must be"),
        ({"seed": -1}, "seed must be"),
        ({"cost_map": 2.0}, "cost_map must be a CostMap, such as RasterCost, got 2.0"),
        *(
            ({"space": space}, "space must be a configuration space with .* such as PlaneSpace")
            for space in (ROOM, None, PlaneSpace, lambda q: True)
        ),
        *(
            (of_bounds(lambda lo, hi, b=b: np.outer(b, np.ones(len(lo)))), "lower nowhere above upper, got .* over")
            for b in ((0.0, 1.0), (-1.0, 1.0), (2.0, 1.0), (1.0, np.inf), (np.nan, 1.0), (1.0, np.nan))
        ),
        *(
            (of_bounds(lambda lo, hi, b=b: b), f"bounds('s answer)? must {message}")
            for b, message in (
                (3.0, "be two arrays"),
                ("low and high", "be"),
                ((np.ones(1), np.ones(2)), "give one number per point"),
            )
        ),
    ],
)
def test_bad_arguments_are_refused(changed, message):
    with pytest.raises(ValueError, match=message):
        solve_eikonal(**{"space": PlaneSpace(ROOM), "goal": GOAL} | changed)


@pytest.mark.full
def test_the_estimate_is_far_nearer_than_the_bounds_and_knows_walls_thinner_than_cells():
    walls = [[(x, y), (x + 0.01, y), (x + 0.01, y + 1.2), (x, y + 1.2)] for x, y in ((0.6, 0.0), (1.3, 0.3))]
    workspace, goal = Workspace(((0, 0), (2, 1.5)), walls), np.array([1.9, 0.2])
    plr = solve_eikonal(PlaneSpace(workspace), goal, max_leaves=2_000)
    x = workspace.sample_free(4_000, 0)
    distance = VisibilityGraph(workspace, goal)(x)
    below = distance - np.asarray(plr.bounds(x)[0])
    assert (below >= 0).all()
    error = np.abs(np.asarray(plr(x)) - distance).mean()
    assert error < 0.01 * distance.mean() and error < 0.1 * below.mean()
