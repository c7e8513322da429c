import pickle

import jax
import numpy as np
import pytest
from eikonal_helpers import EMPTY, ROOM, BoxSpace, check_bounds, use_few_nodes
from space_helpers import Slow, rectangle

from plr_jax import Box, VisibilityGraph, VoxelGraph, Workspace, from_bytes, load, save, solve_eikonal
from plr_jax.eikonal import solve
from plr_jax.eikonal.bounds import MeshEstimate
from plr_jax.eikonal.estimate import GridEstimate
from plr_jax.plr.growth import ConstructionInterrupted
from plr_jax.spaces import PlaneSpace, RasterCost, VoxelSpace

GOAL = (0.3, 0.4)


@pytest.fixture(autouse=True)
def _few_nodes(monkeypatch):
    use_few_nodes(monkeypatch)


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


def test_nothing_is_proven_of_a_space_without_proofs():
    plr = solve_eikonal(FreeOnly(PlaneSpace(ROOM)), GOAL, max_leaves=100)
    x = ROOM.sample_free(2000, 0)
    distance = VisibilityGraph(ROOM, GOAL)(x)
    assert np.abs(plr.numpy()(x) - distance).mean() < 0.05 * distance.mean()
    assert plr.max_error is None
    assert solve_eikonal(FreeOnly(PlaneSpace(ROOM)), GOAL, max_leaves=50, certified=False).max_error is None
    with pytest.raises(ValueError, match="Nothing is proven"):
        plr.bounds(x)


def test_goal_that_no_grid_node_sees_raises():
    """The goal is between two nodes, in a room narrower than a step of the grid."""
    goal = (0.5712, 0.3512)
    walls = [(0, 0), (0.5711, 1)], [(0.5713, 0), (1, 1)], [(0, 0), (1, 0.3511)], [(0, 0.3513), (1, 1)]
    with pytest.raises(ValueError, match="must be seen from a node of the grid of 201 x 201 nodes"):
        solve_eikonal(BoxSpace(EMPTY.domain, *walls), goal, certified=False)
    walls = [(0.3, 0.2), (0.5711, 0.5)], [(0.5713, 0.2), (1, 1)], [(0.3, 0.2), (1, 0.3511)], [(0.3, 0.3513), (1, 1)]
    for num in (1, 9):  # goals close to one another are not nearest to any node, but are seen
        goals = [*np.linspace((0.1001, 0.1001), (0.1002, 0.1002), num), goal]
        with pytest.raises(ValueError, match=rf"must be seen .* \[0.5712, 0.3512\] \(row {num}\) is not: it is too"):
            solve_eikonal(BoxSpace(EMPTY.domain, *walls), goals, certified=False)


EXITS = np.array([(0.3, 0.4), (3.7, 0.3), (1.0, 1.5), (2.2, 2.7), (2.2, 2.7)])  # one on a wall; the last twice


@pytest.mark.parametrize(("certified", "error"), [pytest.param(False, 0.015, marks=pytest.mark.full), (True, 0.04)])
def test_nearest_of_several_goals_is_known(certified, error):
    plr = solve_eikonal(PlaneSpace(ROOM), EXITS, max_leaves=150, certified=certified)
    x = ROOM.sample_free(3_000, 0)
    distances = np.stack([VisibilityGraph(ROOM, goal)(x) for goal in EXITS])
    least = distances.min(axis=0)
    assert np.abs(plr.numpy()(x) - least).mean() < error * least.mean()
    excess = distances[plr.which(x), np.arange(len(x))] - least
    assert (excess > 1e-9).mean() < 0.03 and excess.max() < 0.1  # two steps of the grid
    assert plr.which(EXITS).tolist() == [0, 1, 2, 3, 3]
    assert plr.which([(1.5, 9.0), (np.nan, 1.0)]).tolist() == [-1, -1]
    with pytest.raises(ValueError, match="x must have"):
        plr.which([0.8, 0.8])


def test_nearest_goal_is_lost_in_files_and_under_jit(tmp_path):
    goals, x = [(0.1, 0.1), (0.9, 0.9)], [[0.8, 0.8]]
    plr = solve_eikonal(EMPTY, goals, max_leaves=20)
    assert plr.with_label("two").which(x).tolist() == [1]
    save(plr, tmp_path / "two.plr")
    through, answers = jax.jit(lambda plr, x: (plr, plr(x)))(plr, EXITS)
    np.testing.assert_array_equal(answers, plr(EXITS))
    for other in (load(tmp_path / "two.plr"), through, solve_eikonal(EMPTY, (0.1, 0.1), max_leaves=20)):
        with pytest.raises(ValueError, match="does not store which goal is nearest"):
            other.which(x)
    estimate = solve_eikonal(EMPTY, goals, certified=False, max_leaves=20)
    for named in (plr, estimate):
        assert pickle.loads(pickle.dumps(named)).which(x).tolist() == [1]


def test_repeated_goals_count_once():
    single, row, twice = (solve_eikonal(EMPTY, goal, max_leaves=4) for goal in (GOAL, [GOAL], [GOAL, GOAL]))
    assert single.to_bytes() == row.to_bytes() == twice.to_bytes()
    assert row.which([GOAL]).tolist() == twice.which([GOAL]).tolist() == [0]


@pytest.mark.parametrize("certified", [False, pytest.param(True, marks=pytest.mark.full)])
def test_goals_may_be_in_separate_rooms(certified):
    """The walls between three rooms are thicker than an estimate may reach across."""
    workspace = Workspace(((0, 0), (3, 1)), [rectangle(x, 0, x + 0.2, 1) for x in (0.9, 1.9)])
    goals, x = [(0.5, 0.5), (2.5, 0.5), (2.5, 0.6)], np.array([(0.3, 0.1), (1.5, 0.5), (2.9, 0.1), (2.9, 0.9)])
    plr = solve_eikonal(PlaneSpace(workspace), goals, max_leaves=100, certified=certified)
    assert plr.which(x).tolist() == [0, -1, 1, 2]
    np.testing.assert_allclose(plr(x[[0, 2, 3]]), [np.hypot(0.2, 0.4), np.hypot(0.4, 0.4), 0.5], rtol=0.1)


def test_estimates_of_several_blocks_of_axes_are_planes():
    """Without obstacles, the straight line is the distance, up to rounding to 32 bits."""
    space = BoxSpace(EMPTY.domain, blocks=(((0,), 1.0), ((1,), 0.5)))
    plr = solve_eikonal(space, GOAL, certified=False, max_leaves=50)
    x = np.random.default_rng(0).random((500, 2))
    truth = space.straight(x, GOAL)
    assert plr.leaf.name == "plane"
    assert np.abs(plr.numpy()(x) - truth).mean() < 0.02 * truth.mean()
    assert (plr.numpy()(x) >= truth - 1e-5).all()


@pytest.mark.parametrize("num_goals", [1, 70])
def test_estimates_are_at_least_straight_lines_at_the_least_cost(num_goals):
    """Costs of a row and a column are a ten thousandth of all others. Files hold up to 64 goals."""
    values = np.full((6, 6), 1e4)
    values[2] = values[:, 4] = 1.0
    cost = RasterCost(values, ((0, 0), (6, 6)), "nearest")
    goals = [(0.5, 2.5)] * (num_goals == 1) or np.random.default_rng(0).uniform(2, 3, (num_goals, 2))
    x = np.append(np.random.default_rng(1).uniform(0, 6, (20_000, 2)), goals, axis=0)
    least = np.linalg.norm(x - goals[0], axis=1) if num_goals == 1 else np.zeros(len(x))
    plr = solve_eikonal(cost.space(), goals, cost_map=cost, max_bytes=160, certified=False)
    assert plr.num_bytes <= 160 and plr.max_error is None
    for reader in (plr, plr.numpy(), from_bytes(plr.to_bytes())):
        assert (np.asarray(reader(x)) >= least - 2e-5).all()


DIAGONAL = np.kron(np.eye(2, dtype=bool), np.ones((4, 4), bool))  # free squares that touch in a corner
IN_PLANE, IN_VOXELS = PlaneSpace(Workspace.from_mask(DIAGONAL, tolerance=0)), VoxelSpace(DIAGONAL)


@pytest.mark.parametrize("space", [IN_PLANE, pytest.param(IN_VOXELS, marks=pytest.mark.full)])
def test_points_behind_contacts_answer_inf(space):
    near, far = (space.domain.at(np.full((1, 2), share)) for share in (0.44, 0.56))
    plr = solve_eikonal(space, near[0], certified=False, max_leaves=300)
    assert plr(far).tolist() == [np.inf]
    assert plr([[0.1, 0.1]]) == pytest.approx(np.linalg.norm(near - 0.1), rel=1e-2)


def test_estimates_refine_leaves_where_they_serve_most(monkeypatch):
    """A road of one cell leads through expensive cells."""
    assert solve._MAX_LEAVES == {1: 2_000, 2: 2_000, 3: 4_000}  # as documented
    monkeypatch.setattr(solve, "_MAX_LEAVES", {2: 30})
    values = np.full((60, 60), 10.0)
    values[30] = 1.0
    road = RasterCost(values, ((0, 0), (60, 60)), "nearest")
    plr = solve_eikonal(road.space(), (59.5, 30.5), cost_map=road, max_bytes=1_000, certified=False)
    assert 500 < plr.num_bytes <= 1_000
    assert plr([0.5, 30.5]) == pytest.approx(59, rel=0.03)
    assert solve_eikonal(EMPTY, GOAL, certified=False).num_leaves == 30


@pytest.mark.parametrize("goal", [(0.7, 0.5), pytest.param((0.26, 0.42), marks=pytest.mark.full)])
def test_bounds_hold_if_goals_lie_on_faces_up_to_rounding(goal):
    """Fractions of the domain such as (0.7 - 0.1) / 0.8 are nearly dyadic."""
    bounds = ((0.1, 0.1), (0.9, 0.9))
    cost = RasterCost(np.ones((1, 1)), bounds)
    plr = solve_eikonal(VoxelSpace(np.ones((1, 1), bool), bounds), goal, cost_map=cost, max_leaves=50)
    x = np.random.default_rng(0).uniform(0.1, 0.9, (200, 2))
    truth, (lower, upper) = np.linalg.norm(x - goal, axis=1), plr.bounds(x)
    assert (lower <= truth + 1e-6).all() and (truth <= upper + 1e-6).all()


@pytest.mark.full
def test_estimates_lie_within_bounds_where_costs_vary_widely():
    values = np.array([[303.8, 168.5, 28.7, np.inf], [19.7, np.inf, 1.7, 2.2]])
    cost, goal = RasterCost(values, ((1000, 0), (1004, 2)), "nearest"), (1003.75, 1.75)
    plr = solve_eikonal(cost.space(), goal, cost_map=cost, max_leaves=100).numpy()
    x = np.append(np.random.default_rng(0).uniform((1000, 0), (1004, 2), (2_000, 2)), [goal], axis=0)
    x = x[cost.space().is_free(x)]
    lower, upper = plr.bounds(x)
    assert (lower <= plr(x)).all() and (plr(x) <= upper).all()


def test_holes_in_thin_walls_of_volumes_have_upper_bounds(monkeypatch):
    """Two rooms and a wall of one voxel between them, with a hole of one voxel, at whose edges the path bends."""
    use_few_nodes(monkeypatch, 40_000)
    free = np.ones((12, 12, 12), bool)
    free[6] = False
    free[6, 6, 6] = True
    goal, far = (11.5, 6.5, 1.5), [[1.5, 6.5, 1.5]]
    truth = 2 * np.hypot(4.5, 4.5) + 1
    plr = solve_eikonal(VoxelSpace(free), goal, max_leaves=300)
    lower, upper = plr.bounds(far)
    assert 8 <= lower <= truth <= upper < 1.4 * truth
    assert plr(far) == pytest.approx(truth, rel=0.1)
    x = np.argwhere(free) + 0.5
    length = VoxelGraph(free, goal)(x)
    lower, upper = plr.numpy().bounds(x)
    straight = np.linalg.norm(x - goal, axis=1)
    assert (lower <= length + 1e-9).all() and lower.mean() > 0.5 * length.mean()
    assert (upper >= straight - 1e-6).all() and np.isfinite(upper).all() and np.mean(upper <= length + 1.5) > 0.9


def test_builds_obey_byte_limits_and_repeat_exactly():
    few, again, full = (solve_eikonal(PlaneSpace(ROOM), GOAL, max_leaves=99, max_bytes=n) for n in (100, 100, None))
    assert few.num_bytes <= 100 < full.num_bytes and few.to_bytes() == again.to_bytes()
    check_bounds(few, ROOM, GOAL, n=1000)
    x = ROOM.sample_free(1000, 0)
    lower, upper = full.bounds(x)
    assert np.mean(few.bounds(x)[0]) < np.mean(lower)
    copy = from_bytes(full.to_bytes())
    np.testing.assert_array_equal(copy.bounds(x), (lower, upper))
    assert copy.max_error == full.max_error == np.inf and np.isinf(upper).any()


@pytest.mark.parametrize("max_leaves", [1, pytest.param(17, marks=pytest.mark.full)])
def test_few_leaves_are_enough(max_leaves):
    plr, empty = (solve_eikonal(s, (0.9, 0.9), max_leaves=max_leaves) for s in (PlaneSpace(ROOM), EMPTY))
    assert plr.num_leaves <= max_leaves and empty.num_leaves <= max_leaves and np.isfinite(empty.max_error)
    check_bounds(plr, ROOM, (0.9, 0.9), n=1000)


def test_tolerance_ends_refinement_early():
    few, more = (solve_eikonal(EMPTY, GOAL, max_leaves=900, tolerance=tolerance) for tolerance in (0.04, 0.02))
    assert 4 <= few.num_leaves < more.num_leaves < 600


def test_interrupted_builds_return_the_latest_plr():
    with pytest.warns(ConstructionInterrupted, match=r"Interrupted at \d+ of 300 cells"):
        plr = solve_eikonal(Interrupted(PlaneSpace(ROOM), 6), GOAL, max_leaves=300)
    assert 20 < plr.num_leaves < 300
    check_bounds(plr, ROOM, GOAL)
    with pytest.raises(KeyboardInterrupt):  # before the first solution
        solve_eikonal(Interrupted(PlaneSpace(ROOM), 1), GOAL, max_leaves=300)


@pytest.mark.parametrize("answer", [None, [1], np.full(64, 7)])
def test_invalid_answers_of_classify_raise(answer):
    space = FreeOnly(PlaneSpace(ROOM))
    space.are_free, space.classify = PlaneSpace(ROOM).are_free, lambda lo, hi: answer
    with pytest.raises(ValueError, match="classify must return one CellState per box"):
        solve_eikonal(space, GOAL, max_leaves=64)


def test_too_few_bytes_for_open_cells_raise(monkeypatch):
    """The estimate is far outside of its bounds, and a leaf meets cells in which it is infinite."""

    def estimates(estimate, x):
        return np.where(x.max(axis=1) > 0.3, np.inf, np.sin(40 * x).sum(axis=1))

    for kind in (MeshEstimate, GridEstimate):
        monkeypatch.setattr(kind, "__call__", estimates)
    is_warned = pytest.warns(UserWarning, match=r"At \d\d\.\d% .* estimate was more than a tenth outside of")
    with is_warned, pytest.raises(ValueError, match=r"some leaves answer inf, .* Allow more max_bytes"):
        solve_eikonal(EMPTY, (0.1, 0.1), max_leaves=64, max_bytes=76)


def of_bounds(answer):
    """Return arguments with a cost map whose bounds over boxes are given by a function."""
    cost_map = Slow((0, 0.5), (1, 1), 2.0)
    cost_map.bounds = answer
    return {"space": EMPTY, "cost_map": cost_map, "max_leaves": 20}


FOUR_AXES = BoxSpace(Box((0,) * 4, (1,) * 4))
TINY = RasterCost([[1e-30]], ((0, 0), (1e-3, 1e-3)))


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"goal": (1.5, 1.5)}, r"a free configuration.*1\.5\] is not: it is in an obstacle, or too close"),
        ({"goal": (9.0, 1.5)}, r"goal must be a free configuration.* is not: it does not lie in the domain Box\(\["),
        ({"goal": (np.nan, 0.4)}, "goal"),
        ({"goal": (0.3,)}, "goal must have 2 coordinates, like the space, or be rows of these, got 1"),
        ({"goal": [(0.3, 0.4, 0.0)] * 2}, r"or be rows of these, got shape \(2, 3\)"),
        ({"goal": np.zeros((0, 2))}, r"got shape \(0, 2\)"),
        ({"goal": [[[0.3, 0.4]]]}, r"got shape \(1, 1, 2\)"),
        ({"goal": [GOAL, (1.5, 1.5)]}, r"free configuration of the space, .*1.5\] \(row 1\)"),
        ({"goal": [GOAL, (0.3, np.nan)], "certified": False}, r"free configuration of the space, .*nan\] \(row 1\)"),
        ({"max_leaves": 0}, "max_leaves must be"),
        ({"max_bytes": 0}, "max_bytes must be"),
        ({"max_leaves": 10, "max_bytes": 20}, r"max_bytes=20 is too small: one leaf takes \d+ bytes"),
        ({"tolerance": -1.0}, "tolerance must be"),
        ({"certified": False, "tolerance": 0.1}, r"got 2 axes and tolerance=0\.1"),
        ({"certified": False, "space": FOUR_AXES, "goal": np.full(4, 0.5)}, r"up to 3 axes.*got 4 axes"),
        ({"max_leaves": 10**20, "tolerance": 1}, "would need about"),
        ({"space": TINY.space(), "cost_map": TINY, "goal": (3e-4, 3e-4), "max_leaves": 20}, "1e-30 somewhere"),
        ({"seed": -1}, "seed must be"),
        ({"cost_map": 2.0}, "cost_map must be a CostMap, such as RasterCost, got 2.0"),
        ({"space": None}, "space must be a configuration space with .* such as PlaneSpace"),
        ({"space": PlaneSpace}, "space must be a configuration space with .* such as PlaneSpace"),
        *(
            (of_bounds(lambda lo, hi, b=b: np.outer(b, np.ones(len(lo)))), "lower nowhere above upper, got .* over")
            for b in ((0.0, 1.0), (2.0, 1.0), (1.0, np.inf), (np.nan, 1.0), (1.0, np.nan))
        ),
        (of_bounds(lambda lo, hi: 3.0), "bounds('s answer)? must be two arrays"),
        (of_bounds(lambda lo, hi: "low and high"), "bounds('s answer)? must be"),
        (of_bounds(lambda lo, hi: (np.ones(1), np.ones(2))), "bounds('s answer)? must give one number per point"),
    ],
)
def test_invalid_arguments_raise(changes, message):
    with pytest.raises(ValueError, match=message):
        solve_eikonal(**{"space": PlaneSpace(ROOM), "goal": GOAL} | changes)
