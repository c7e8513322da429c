import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from eikonal_helpers import EMPTY, ROOM, BoxSpace, check_between, check_bounds, use_few_nodes
from space_helpers import BOUNDS, Slow, random_workspace, rectangle

from plr_jax import Box, DiscRobot, RectangleRobot, VisibilityGraph, VoxelGraph, Workspace, from_bytes, solve_eikonal
from plr_jax.spaces import CellState, LipschitzCost, PlaneSpace, RasterCost, RigidBodySpace, VoxelSpace

FULL = pytest.mark.full
TOUCHING = rectangle(1, 1.5, 2, 2.25), rectangle(2, 0.75, 3, 1.5)  # in a dyadic point
ONCE, TWICE = (Workspace(BOUNDS, TOUCHING, squeeze=squeeze) for squeeze in (False, True))
THIN = Workspace(BOUNDS, [rectangle(2, 0, 2 + 1e-7, 2.6), rectangle(1, 0.4, 1.0 + 1e-7, 3)])
GAP = Workspace(BOUNDS, [rectangle(2, 0, 2.5, 1.3), rectangle(2, 1.3 + 1e-5, 2.5, 3)])
PLACES = {  # a workspace, a goal, limits, and the share of points with a known upper bound
    "goal in a corner": (ROOM, (1.0, 2.0), 400, None, 0.9),
    "goal just beside a wall": (ROOM, (0.9999999, 1.5), 400, None, 0.9),
    "goal beside a contact": (ONCE, (1.9, 1.4), 300, None, 0.5),
    "goal beside a passage": (TWICE, (1.9, 1.4), 300, 400, 0.5),
    "goal where obstacles touch": (ONCE, (2.0, 1.5), 300, 400, 0.5),
    "walls of 1e-7": (THIN, (0.3, 0.4), 400, None, 0.5),
    "gap of 1e-5": (GAP, (0.3, 0.4), 400, None, 0.3),
}


@pytest.fixture(autouse=True)
def _few_nodes(monkeypatch):
    use_few_nodes(monkeypatch)


@pytest.mark.full
@pytest.mark.parametrize(("workspace", "goal", "max_leaves", "max_bytes", "known"), PLACES.values(), ids=PLACES)
def test_bounds_contain_exact_distance_at_hard_goals(workspace, goal, max_leaves, max_bytes, known, monkeypatch):
    use_few_nodes(monkeypatch, 160_000)
    plr = solve_eikonal(PlaneSpace(workspace), goal, max_leaves=max_leaves, max_bytes=max_bytes)
    distance, lower, upper = check_bounds(plr, workspace, goal)
    is_known = np.isfinite(upper)
    assert len(distance) > 7_500 and is_known.mean() > known  # of 8,000 points, all of which reach the goal
    assert workspace is not ROOM or np.mean((upper - lower)[is_known]) < 0.3 * distance.mean()
    assert max_bytes is None or plr.num_bytes <= max_bytes


@pytest.mark.parametrize(
    ("seed", "num_goals", "max_leaves", "max_bytes"),
    [
        (1, 1, 60, 120),
        (3, 12, 40, None),
        *(pytest.param(k, (1, 2, 12)[k % 3], 10 * k, (None, 150, 600)[k // 3], marks=FULL) for k in range(1, 9)),
    ],
)
def test_bounds_contain_exact_distance_on_random_maps(seed, num_goals, max_leaves, max_bytes):
    """Two of the goals are in one cell."""
    workspace = random_workspace(seed)
    goals = workspace.sample_free(num_goals, seed)
    goals[1:2] = goals[0] + 1e-7 * (np.mean(BOUNDS, axis=0) - goals[0])
    goals = goals[shapely.intersects_xy(workspace.free_space, *goals.T)]
    plr = solve_eikonal(PlaneSpace(workspace), goals, max_leaves=max_leaves, max_bytes=max_bytes)
    check_bounds(plr, workspace, goals, seed)


TWO_NORMS = ((0,), 2.0), ((1,), 0.5)
FOUR_AXES = ((0, 1), 2.0), ((2, 3), 0.5)


@pytest.mark.parametrize(
    ("periodic", "blocks", "num_goals", "max_leaves", "gap"),
    [
        ([False], None, 1, 20, 0.002),
        ([True], None, 1, 70, 0.01),
        ([False, False], None, 1, 100, 0.2),
        ([True, False], TWO_NORMS, 2, 100, 0.2),
        pytest.param([True] * 4, FOUR_AXES, 1, 256, 1.5, marks=pytest.mark.full),
        pytest.param([False] * 3, None, 1, 600, 0.7, marks=pytest.mark.full),
        pytest.param([True, False, False, True], None, 2, 400, 2.0, marks=pytest.mark.full),
    ],
)
def test_bounds_contain_distance_in_empty_boxes(periodic, blocks, num_goals, max_leaves, gap):
    dim, rng = len(periodic), np.random.default_rng(0)
    width = np.array([1.0, 2.0, 0.7, 1.0])[:dim]
    space = BoxSpace(Box(np.zeros(dim), width, periodic), blocks=blocks)
    goals, x = rng.random((num_goals, dim)) * width, rng.random((2000, dim)) * width
    goals[0] = 0.3 * width + (max_leaves % 3 - 1) * 1e-12  # rounding decides nothing
    plr = solve_eikonal(space, goals, max_leaves=max_leaves)
    distances = np.stack([space.straight(x, goal) for goal in goals])
    distance, lower, upper = check_between(plr, x, distances.min(axis=0))
    assert plr.max_error < np.inf and np.mean(upper - lower) < gap * distance.mean()
    excess = distances[plr.which(x), np.arange(len(x))] - distance
    assert excess.mean() < 0.1 * distance.mean() and (num_goals > 2 or np.mean(excess > 0) < 0.1)


def test_bounds_contain_cost_where_speeds_rise_evenly():
    """Fastest paths are arcs, whose times are known; the estimate is much closer to the truth than the bounds."""
    speed = lambda q: 0.5 + 3 * q[..., 1]  # noqa: E731
    space, goals = BoxSpace(Box((0, 0), (1, 2))), np.array([(0.3, 0.6), (0.8, 0.9), (0.5, 0.2)])
    plr = solve_eikonal(space, goals, cost_map=LipschitzCost(lambda q: 1 / speed(q), 12.0, 0.15), max_leaves=250)
    x = np.random.default_rng(0).uniform((0, 0.1), (1, 1), (2000, 2))  # whose arcs stay inside
    square = np.sum((x[:, None] - goals) ** 2, axis=2)
    times = np.arccosh(1 + 9 * square / (2 * speed(x)[:, None] * speed(goals))) / 3
    time, lower, upper = check_between(plr, x, times.min(axis=1))
    assert np.abs(plr.numpy()(x) - time).mean() < 0.1 * np.mean(upper - lower) < 0.015
    assert np.mean(plr.which(x) != times.argmin(axis=1)) < 0.03


SLANTED = PlaneSpace(Workspace(BOUNDS, [[(0, 2), (2, 0), (2.2, 0), (0, 2.2)]]))
NARROW = PlaneSpace(Workspace(BOUNDS, [rectangle(1.8, 0, 2, 1.4), rectangle(1.8, 1.6, 2, 3)]), DiscRobot(0.2))
CORNERS = np.eye(2, dtype=bool)
CUT_OFF = {  # a space, a goal, cells, bytes, which points reach the goal, and the share of others that may be finite
    "slanted wall": (SLANTED, (3, 2.5), 300, None, lambda x: x.sum(axis=1) > 2, 0.001),
    "narrow door": (NARROW, (0.5, 1), 200, None, lambda x: x[:, 0] < 1.8, 0),
    "corners": (VoxelSpace(CORNERS), (0.5, 0.5), 150, None, lambda x: x[:, 0] < 1, 1e-3),
    "voxel": (VoxelSpace(CORNERS[:, :, None] & CORNERS), (0.5,) * 3, 500, None, lambda x: x[:, 0] < 1, 1e-3),
    "few bytes": (SLANTED, (3, 2.5), 300, 100, lambda x: x.sum(axis=1) > 2, 0.6),
}


@pytest.mark.parametrize(
    "place", [*list(CUT_OFF)[:3], *(pytest.param(k, marks=pytest.mark.full) for k in ("voxel", "few bytes"))]
)
@pytest.mark.filterwarnings("ignore:The goal cannot be reached", "ignore:In up to about")
def test_points_that_are_cut_off_answer_inf_and_have_no_upper_bound(place):
    space, goal, max_leaves, max_bytes, reaches, most = CUT_OFF[place]
    plr = solve_eikonal(space, goal, max_leaves=max_leaves, max_bytes=max_bytes).numpy()
    x = np.random.default_rng(0).uniform(space.domain.lo, space.domain.hi, (20_000, space.domain.dim))
    x = x[space.is_free(x)]
    is_reached, is_finite, (lower, upper) = reaches(x), np.isfinite(plr(x)), plr.bounds(x)
    assert 0.1 < is_reached.mean() < 0.95 and is_finite[is_reached].all() and np.isfinite(lower[is_reached]).all()
    assert np.isinf(upper[~is_reached]).all() and np.isfinite(upper[is_reached]).mean() > 0.2
    assert is_finite[~is_reached].mean() <= most


def test_both_ends_of_periodic_axes_answer_the_same():
    space, goal = BoxSpace(Box((-2, 0), (2, 1), (True, False)), [(-0.7, 0.0), (-0.4, 0.6)]), (1.7, 0.3)
    plr = solve_eikonal(space, goal, max_leaves=100, max_bytes=400)
    y = np.linspace(0, 1, 301)
    ends = (np.column_stack([np.full(301, x), y]) for x in (-2.0, 2, 6))
    first, *others = (np.stack([plr(end), *plr.bounds(end)]) for end in ends)
    np.testing.assert_array_equal(others, [first] * 2)
    # Unrolled, with the goal in the middle, it is a room of the plane: paths do not pass the seam on the far side.
    unrolled = Workspace(((-1.3, 0), (3.7, 1)), [rectangle(3.3, 0, 3.6, 0.6), rectangle(-0.7, 0, -0.4, 0.6)])
    x = unrolled.sample_free(2000, 0)
    x = x[np.abs(x[:, 0] - 1.7) < 1.9]
    distance = VisibilityGraph(unrolled, goal)(x)
    lower, upper = (np.asarray(bound) for bound in plr.bounds(x))
    assert (lower <= distance + 1e-9).all()
    near = np.abs(x[:, 0] - 1.7) < 0.5  # where no way around is shorter
    assert (distance[near] <= upper[near] + 1e-9).all() and np.isfinite(upper).mean() > 0.9


@pytest.mark.parametrize(
    ("width", "corner", "blocks", "num_goals", "max_bytes"),
    [
        ((6, 5, 4), 5e6, None, 1, None),
        ((6, 5, 4), 0.0, (((0, 2), 1.0), ((1,), 3.0)), 3, 300),
        *(pytest.param((4, 3), 0.0, None, goals, 300, marks=pytest.mark.full) for goals in (1, 8)),
        pytest.param((4,), 7.0, None, 2, None, marks=pytest.mark.full),
    ],
)
@pytest.mark.parametrize("is_periodic", [False, True])
def test_answers_and_lower_bounds_are_at_least_straight_in_every_reader(
    width, corner, blocks, num_goals, max_bytes, is_periodic
):
    """Without obstacles, the lower bound is the distance, up to rounding to 32 bits."""
    rng, lo, dim = np.random.default_rng(0), np.full(len(width), corner), len(width)
    space = BoxSpace(Box(lo, lo + width, [is_periodic] + [False] * (dim - 1)), blocks=blocks)
    goals, x = (lo + rng.random((n, dim)) * width for n in (num_goals, 1000))
    plr = solve_eikonal(space, goals, max_leaves=60, max_bytes=max_bytes)
    x = np.append(x, goals, axis=0)
    distance = np.min([space.straight(x, goal) for goal in goals], axis=0)
    again = from_bytes(plr.to_bytes())
    for answer, lower in ((f(x), f.bounds(x)[0]) for f in (plr, plr.numpy(), again)):
        assert (np.asarray(lower, float) <= distance).all() and (lower <= answer).all()
        np.testing.assert_allclose(lower, distance, rtol=4e-6, atol=1e-4)
    np.testing.assert_array_equal(again.lower(x), plr.bounds(x)[0])


@pytest.mark.parametrize(("width", "rate"), [(1e20, 1e-10), pytest.param(1e-14, 1.0, marks=pytest.mark.full)])
def test_lower_bounds_hold_for_huge_and_tiny_lengths(width, rate):
    """Squares of the lengths exceed 32 bits."""
    cost = RasterCost(np.full((2, 2), rate), ((0, 0), (width, width)))
    goal = np.array([0.3, 0.4]) * width
    plr = solve_eikonal(cost.space(), goal, cost_map=cost, max_leaves=40)
    x = np.append(np.random.default_rng(0).random((1000, 2)) * width, goal[None], axis=0)
    distance = rate * np.linalg.norm(x - goal, axis=1)
    for lower in (plr.bounds(x)[0], plr.numpy().bounds(x)[0]):
        assert (np.asarray(lower, float) <= distance * (1 + 1e-12)).all()


def test_bounds_obey_strict_promotion_of_ranks_and_types():
    plr = solve_eikonal(VoxelSpace(np.ones((6, 5, 4), bool)), (1.3, 2, 1), max_leaves=10)
    x = np.random.default_rng(0).random((20, 3), np.float32)
    expected = plr.bounds(x)
    with jax.numpy_dtype_promotion("strict"), jax.numpy_rank_promotion("raise"):
        np.testing.assert_array_equal(plr.bounds(x), expected)
        lower, slope = jax.jit(jax.value_and_grad(plr.lower))(jnp.array([1.3, 2, 1]))  # at the goal
    assert lower == 0 and np.isfinite(slope).all()


@pytest.mark.full
def test_bounds_contain_distance_around_a_box_in_space(monkeypatch):
    """The obstacle is as high as the domain: the distance follows from the plane and the height by Pythagoras."""
    use_few_nodes(monkeypatch, 20_000)
    plane = Workspace(((0, 0), (1, 1)), [rectangle(0.3, 0.2, 0.7, 0.6)])
    space = BoxSpace(Box(np.zeros(3), np.array([1, 1, 0.5])), [(0.3, 0.2, 0.0), (0.7, 0.6, 0.5)])
    goal = np.array([0.1, 0.3, 0.2])
    x = np.column_stack([plane.sample_free(2000, 0), np.random.default_rng(0).uniform(0, 0.5, 2000)])
    distance = np.hypot(VisibilityGraph(plane, goal[:2])(x[:, :2]), x[:, 2] - goal[2])
    _, _, upper = check_between(solve_eikonal(space, goal, max_leaves=500), x, distance)
    assert np.isfinite(upper).mean() > 0.3


@pytest.mark.full
def test_estimates_in_space_do_not_lead_through_thin_walls():
    """Walls of one voxel, with doors at alternating ends; a coarse mesh cannot tell on which side of a wall it is."""
    free = np.ones((20, 20, 20), bool)
    for i, k in enumerate(range(2, 19, 3)):
        free[k] = False
        free[k, :, 0 if i % 2 else -1] = True
    space, goal = VoxelSpace(free, bounds=((0, 0, 0), (1, 1, 1))), np.array([0.025, 0.525, 0.025])
    x = (np.argwhere(free) + 0.5) / 20
    distance = VoxelGraph(free, goal, bounds=space.domain)(x)
    found = solve_eikonal(space, goal, max_leaves=600).numpy()(x)
    assert np.mean(found < 0.7 * distance) < 0.1


def test_bounds_contain_cost_of_refracted_paths():
    """By Fermat's principle, from many crossings of the level; the goal is below the level."""
    goal, level, dear, cross = (0.2, 0.1), 0.37, 3.0, np.linspace(-1, 2, 2_001)
    plr = solve_eikonal(EMPTY, goal, cost_map=Slow((-9, level), (9, 9), dear), max_leaves=120)
    rng = np.random.default_rng(0)
    x = np.concatenate([rng.random((600, 2)), np.column_stack([rng.random(60), level + rng.normal(0, 1e-7, 60)])])
    below = np.hypot(cross - goal[0], level - goal[1])
    beyond = [(below + dear * np.hypot(cross - px, py - level)).min() for px, py in x]
    distance = np.where(x[:, 1] >= level, beyond, np.linalg.norm(x - goal, axis=1))
    _, lower, _ = check_between(plr, x, distance, 1e-6)
    assert np.mean(distance - lower) < 0.2 * distance.mean()


def test_tight_bounds_hold_at_faces_of_cells():
    """On a line both bounds are exact except for the rounding of queries."""
    for lo, goal in ((3.0, 3.5), (-7.0, -6.6)):
        plr = solve_eikonal(BoxSpace(Box([lo], [lo + 1])), (goal,), max_leaves=16)
        faces = np.concatenate(plr.leaf_boxes).ravel()
        x = np.append(faces, goal)[:, None] + np.linspace(-1e-6, 1e-6, 401)
        x = np.clip(x, lo, lo + 1).reshape(-1, 1)
        _, lower, upper = check_between(plr, x, np.abs(x[:, 0] - goal), 0)
        assert np.mean(upper - lower) < 0.1


def test_cells_flush_with_walls_have_upper_bounds():
    """Queries may round into the cell across a face; cells in the wall hold no free point."""
    plane = Workspace(((0, 0), (1, 1)), [rectangle(0.25, 0.25, 0.5, 0.75)])
    space, goal = BoxSpace(Box((0, 0), (1, 1)), [(0.25, 0.25), (0.5, 0.75)]), (0.1, 0.3)
    plr = solve_eikonal(space, goal, max_leaves=100)
    _, _, upper = check_bounds(plr, plane, goal)
    lo, hi = plr.leaf_boxes
    is_free = space.classify(lo, hi) == CellState.FREE
    assert np.isfinite(plr.bounds((lo + hi)[is_free] / 2)[1]).all()
    assert np.isfinite(upper).mean() > 0.8


def test_bounds_hold_if_most_cells_are_blocked():
    space = BoxSpace(Box((0, 0), (1, 1)), [(0.0, 0.0), (1.0, 0.97)])
    plr = solve_eikonal(space, (0.5, 0.99), max_leaves=80)
    x = np.random.default_rng(0).uniform((0, 0.97), (1, 1), (3000, 2))
    check_between(plr, x, np.linalg.norm(x - (0.5, 0.99), axis=1))
    assert (space.classify(*plr.leaf_boxes) == CellState.BLOCKED).any()


def test_bounds_contain_cost_of_a_turning_body():
    space, goal = RigidBodySpace(Workspace(((0, 0), (3, 2))), RectangleRobot(0.4, 0.2)), np.array([2.0, 1.0, 3.0])
    q = np.random.default_rng(0).uniform((0.4, 0.4, -3.1), (2.6, 1.6, 3.1), (500, 3))
    truth = space.motion_cost.lengths(q, np.tile(goal, (500, 1)), space.domain)  # all straight motions are free
    _, lower, upper = check_between(solve_eikonal(space, goal, max_leaves=200), q, truth)
    assert lower.mean() > 0.6 * truth.mean() and np.isfinite(upper).mean() > 0.9


def test_bounds_contain_distance_of_discs():
    workspace, goal, radius = Workspace(BOUNDS, [rectangle(1.9, 0, 2.1, 1.5)]), (0.6, 0.6), 0.3
    plr = solve_eikonal(PlaneSpace(workspace, DiscRobot(radius)), goal, max_leaves=150)
    x = workspace.inflate(radius).sample_free(1000, 0)
    # Inflated corners are polygons inside of the arcs that a disc follows.
    below, above = (VisibilityGraph(workspace.inflate(share * radius), goal)(x) for share in (1, 1.005))
    lower, upper = plr.numpy().bounds(x)
    assert (lower <= above + 1e-9).all() and (upper >= below - 1e-9).all() and np.isfinite(upper).mean() > 0.8


@pytest.mark.parametrize(
    ("workspace", "goal"),
    [(TWICE, (2.0, 1.5)), (ROOM, (4.0, 3.0)), (ROOM, (2.3, 0.0)), (ROOM, (1.37, 1.0))],
    ids=["in a passage", "in a corner of the domain", "where a wall meets the domain", "on a wall"],
)
@pytest.mark.filterwarnings("ignore:At .* of the corners of cells")  # few leaves
def test_bounds_hold_if_goals_touch_walls(workspace, goal):
    plr = solve_eikonal(PlaneSpace(workspace), goal, max_leaves=60)
    assert np.isfinite(check_bounds(plr, workspace, goal, n=1000)[2]).mean() > 0.5
