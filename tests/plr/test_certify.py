"""Proofs hold: at points of all kinds the distance is between the bounds, whatever leaves hold."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from piece_helpers import WORKSPACES, box
from plr_helpers import UNIT, cone

from plr_jax import scenes
from plr_jax._io import load, save
from plr_jax.geometry.box import Box
from plr_jax.geometry.workspace import Workspace
from plr_jax.oracles import Euclidean, VisibilityGraph
from plr_jax.planners import sum_of_distances
from plr_jax.plr import ConstructionInterrupted, certify, construct, from_bytes
from plr_jax.plr._assembly import with_certificate
from plr_jax.plr.certificate.certificate import Certificate, Proof

LEAVES = ("plane", "continuous", "smooth", "cone")
NUM_POINTS = 100_000


def critical_points(plr, oracle, n, seed=0):
    """Points anywhere, on walls and beside them, at corners, and on the borders of leaves."""
    rng, domain, workspace = np.random.default_rng(seed), plr.domain, oracle.workspace
    tolerance = workspace.tolerance
    anywhere = domain.lo + domain.width * rng.random((n // 2, 2))
    segments = workspace.boundary.segments
    start, end = segments[rng.integers(len(segments), size=n // 4)].transpose(1, 0, 2)
    share = rng.random((n // 4, 1)) * (rng.random((n // 4, 1)) < 0.8)
    hair = tolerance * 10.0 ** rng.uniform(-1, 5, (n // 4, 1)) * rng.choice([0, 1], (n // 4, 1))
    on_walls = start + share * (end - start) + hair * rng.normal(size=(n // 4, 2))
    lo, hi = plr.leaf_boxes
    leaf = rng.integers(len(lo), size=n // 4)
    share = rng.random((n // 4, 2))
    share[np.arange(n // 4), rng.integers(2, size=n // 4)] = rng.choice([0.0, 1.0], n // 4)
    hair = 10.0 ** rng.uniform(-9, -5, (n // 4, 1)) * rng.choice([0, 1], (n // 4, 1))
    on_borders = lo[leaf] + share * (hi - lo)[leaf] + domain.width * hair * rng.normal(size=(n // 4, 2))
    corners = np.concatenate([workspace.boundary.vertices, oracle.sources.points, lo, hi])
    x = np.concatenate([anywhere, on_walls, on_borders, corners])
    return np.clip(x, domain.lo, domain.hi)


def check_bounds(plr, oracle, n=NUM_POINTS, seed=0):
    """No distance is beyond its bounds; both are as wide as the proof says. Returns the largest error met."""
    x = critical_points(plr, oracle, n, seed)
    largest = 0.0
    for points in (x.astype(np.float32), x):
        exact = oracle(points.astype(np.float64))
        points = points[np.isfinite(exact)]
        exact = exact[np.isfinite(exact)]
        inside = plr.domain.contains(points.astype(np.float64))
        points, exact = points[inside], exact[inside]
        lower, upper = (np.asarray(bound, np.float64) for bound in plr.bounds(points))
        assert len(exact) > n / 20
        assert (lower <= exact).all(), (points[lower > exact][:3].tolist(), (lower - exact).max())
        assert (exact <= upper).all(), (points[upper < exact][:3].tolist(), (exact - upper).max())
        error = np.abs(np.asarray(plr(points), np.float64) - exact)
        largest = max(largest, error.max())
        assert (lower >= 0).all()
        assert (upper - lower <= 2 * plr.max_error * (1 + 1e-5) + 1e-6 * exact).all()
    assert largest <= plr.max_error
    return largest


@pytest.fixture(scope="module")
def maze():
    """The oracle of a maze."""
    problem = scenes.maze()
    return VisibilityGraph(problem.workspace, problem.goals[0])


@pytest.fixture(scope="module", params=("plane", "continuous", "cone"))
def certified(request, maze):
    """A PLR of the maze with bounds of every leaf."""
    return certify(construct(maze, UNIT, leaf=request.param, max_bytes=500), maze, leaf_bounds=True)


def test_bounds_hold_everywhere(certified, maze):
    largest = check_bounds(certified, maze)
    assert largest > certified.max_error / 3


def test_bounds_of_the_largest_error_hold_and_are_tight(certified, maze):
    plain = from_bytes(certified.to_bytes())
    plr = certify(plain, maze)
    largest = check_bounds(plr, maze, 10_000)
    assert plr.max_error / 2 < largest <= plr.max_error
    lower, upper = plr.bounds(np.array([[0.03, 0.9]]))
    value = float(plr(np.array([[0.03, 0.9]]))[0])
    np.testing.assert_allclose([value - lower[0], upper[0] - value], plr.max_error, rtol=1e-3)


@pytest.mark.parametrize(("leaf", "kind"), list(zip((*LEAVES, "cone", "plane"), WORKSPACES * 2, strict=True)))
def test_bounds_hold_among_slivers_contacts_and_parts_that_are_cut_off(leaf, kind):
    """Where the goal is a corner, or the domain is another than the bounds."""
    number = LEAVES.index(leaf)
    rng = np.random.default_rng(number)
    workspace = kind(rng, squeeze=number % 2 == 0)
    goal = workspace.sample_free(1, 0)[0] if number < 2 else workspace.boundary.vertices[7]
    domain = Box((-3, -1), (12, 14)) if number in (1, 2) else Box((1.3, 1.9), (9.1, 8))
    oracle = VisibilityGraph(workspace, goal)
    plr = construct(oracle, domain, leaf=leaf, max_leaves=40, certified=True, leaf_bounds=number % 2 == 1)
    check_bounds(plr, oracle, 10_000)


@pytest.mark.parametrize("leaf", ["plane", "cone"])
def test_bounds_hold_far_from_the_origin(leaf):
    """There 32-bit floats resolve a 60th of the room; what is rounded is in the bounds."""
    corner = np.array([1e6, -3e5])
    workspace = Workspace(
        corner + np.array([[0, 0], [10, 10.0]]), [box(4, 0, 5, 7) + corner, box(6, 8, 7, 9) + corner]
    )
    oracle = VisibilityGraph(workspace, corner + 1)
    plr = construct(oracle, workspace.bounds, leaf=leaf, max_leaves=40, certified=True)
    rng = np.random.default_rng(0)
    x = corner + 10 * rng.random((NUM_POINTS, 2))
    exact = oracle(x)
    lower, upper = plr.bounds(x)
    free = np.isfinite(exact)
    assert ((lower <= exact) & (exact <= upper))[free].all()


def test_a_proof_is_kept_in_the_file_bit_for_bit(certified, tmp_path):
    save(certified, tmp_path / "maze.plr")
    loaded = load(tmp_path / "maze.plr")
    assert loaded.to_bytes() == certified.to_bytes() == (tmp_path / "maze.plr").read_bytes()
    assert loaded.max_error == certified.max_error
    x = np.random.default_rng(0).random((500, 2))
    np.testing.assert_array_equal(loaded.bounds(x), certified.bounds(x))
    np.testing.assert_array_equal(loaded(x), certified(x))


def test_a_proof_takes_four_bytes_and_two_a_leaf(certified, maze):
    whole = certify(certified, maze)
    assert certified.num_bytes - whole.num_bytes == 2 * certified.num_leaves
    plain = construct(maze, UNIT, leaf=certified.leaf.name, max_bytes=500)
    assert plain.max_error is None and plain.band is None
    assert whole.num_bytes == plain.num_bytes + 4
    assert whole.num_leaves == plain.num_leaves
    x = np.random.default_rng(0).random((500, 2))
    np.testing.assert_array_equal(plain(x), whole(x))


def test_classes_of_leaves_have_narrow_bounds_that_hold_for_few_bytes(maze):
    plr = construct(maze, UNIT, leaf="cone", max_bytes=2048, certified=True)
    check_bounds(plr, maze, 20_000)
    assert 1900 < plr.num_bytes <= 2048
    assert certify(plr, maze).to_bytes() == plr.to_bytes()
    loaded = from_bytes(plr.to_bytes())
    assert loaded.max_error == plr.max_error
    np.testing.assert_array_equal(loaded.band, plr.band)
    one = with_certificate(plr, Certificate(plr.max_error, None, Proof.CLASSES))
    each = certify(plr, maze, leaf_bounds=True)
    assert 0 < plr.num_bytes - one.num_bytes <= one.num_bytes / 128
    x = maze.workspace.sample_free(5000, 0)
    narrow, wide, narrowest = (np.ptp(np.asarray(of.bounds(x), float), axis=0).mean() for of in (plr, one, each))
    assert narrowest < narrow < 0.6 * wide


def test_files_of_one_bound_for_all_leaves_are_read_as_they_were_written(maze):
    """As those of releases that knew no classes."""
    plr = construct(maze, UNIT, leaf="cone", max_bytes=2048, certified=True)
    one = from_bytes(with_certificate(plr, Certificate(0.25, None, Proof.CLASSES)).to_bytes())
    assert one.max_error == 0.25
    np.testing.assert_array_equal(one.band, [[-0.25], [0.25]])


@pytest.mark.parametrize("leaf", LEAVES)
def test_certified_construction_keeps_its_budget_and_its_proof(leaf, maze):
    plr = construct(maze, UNIT, leaf=leaf, max_bytes=450, certified=True, leaf_bounds=True)
    assert plr.num_bytes <= 450
    again = certify(plr, maze, leaf_bounds=True)
    assert again.to_bytes() == plr.to_bytes()
    assert plr.bounds(np.array([0.5, 0.9]))[0].shape == ()


@pytest.mark.parametrize("leaf", ["plane", "cone"])
def test_certified_construction_with_samples_beyond_their_cells(leaf, maze):
    check_bounds(construct(maze, UNIT, leaf=leaf, max_leaves=60, certified=True, margin=0.2), maze, 5_000)


@pytest.mark.parametrize("leaf", ["plane", "cone"])
def test_free_space_that_no_sample_meets_is_proven_as_well(leaf):
    """A slit of which the samples of the whole domain meet nothing; tied leaves, which need some, say so."""
    walls = [box(0, 0, 10, 4.69999), box(0, 4.70001, 10, 10), box(3, 4, 3.5, 4.700009)]
    workspace = Workspace(((0, 0), (10, 10)), walls)
    oracle = VisibilityGraph(workspace, (9.0, 4.7))
    plr = construct(oracle, workspace.bounds, leaf=leaf, max_leaves=30, certified=True)
    with pytest.raises(ValueError, match="found nothing reachable"):
        construct(oracle, workspace.bounds, leaf="continuous", max_leaves=30, certified=True)
    rng = np.random.default_rng(0)
    x = np.column_stack([10 * rng.random(20_000), 4.7 + 2e-5 * (rng.random(20_000) - 0.5)])
    exact = oracle(x)
    x, exact = x[np.isfinite(exact)], exact[np.isfinite(exact)]
    lower, upper = plr.bounds(x)
    assert len(x) > 10_000 and (lower <= exact).all() and (exact <= upper).all()


def _spike(angle, depth):
    """A spike whose tip is just beyond a border of cells, and a goal beside it."""
    tip, half = np.array([0.4, 0.25 + depth]), 0.125 * angle
    return [(0.4, tip[1]), (0.4 - half, depth), (0.4 + half, depth)], tip - (3 * angle * depth, depth * 2 / 3)


def _floating(width, length):
    """A short thin wall inside of cells, and a goal beside it."""
    return box(0.4 - width / 2, 0.4 - length, 0.4 + width / 2, 0.4 + length), (0.4 - length / 4, 0.4)


@pytest.mark.parametrize("leaf", ["plane", "cone"])
@pytest.mark.parametrize(
    ("wall", "goal"), [_spike(1e-4, 2e-5), _spike(1e-3, 1e-5), _spike(1e-5, 1e-4), _floating(5e-9, 4e-6)]
)
def test_walls_far_smaller_than_cells_count(wall, goal, leaf):
    """However little of a cell's area they take: who is behind one has to go around it."""
    workspace = Workspace(((0, 0), (1, 1)), [wall])
    oracle = VisibilityGraph(workspace, goal)
    plr = construct(oracle, workspace.bounds, leaf=leaf, max_bytes=512, certified=True, leaf_bounds=True)
    rng, size = np.random.default_rng(0), 4 * np.abs(np.array(wall)[0] - goal).max()
    x = np.array(wall)[0] + size * np.column_stack([rng.random(20_000) ** 3, 2 * rng.random(20_000) - 1])
    x = x[workspace.clearance(x) >= 0]
    exact = oracle(x)
    lower, upper = plr.bounds(x)
    assert len(x) > 5_000 and (lower <= exact).all() and (exact <= upper).all()


def test_an_interrupted_proof_leaves_the_plr_without_one(maze, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    whole = construct(maze, UNIT, max_leaves=20, certified=True)
    monkeypatch.setattr("plr_jax.plr._construct.certificate_of", interrupt)
    with pytest.warns(ConstructionInterrupted, match="nothing is proven"):
        plr = construct(maze, UNIT, max_leaves=20, certified=True)
    assert plr.max_error is None
    np.testing.assert_array_equal(plr.leaf_boxes, whole.leaf_boxes)


def test_proofs_end_where_bounds_cannot_get_better(maze, monkeypatch):
    """Then they are as they were found so far, and hold."""
    plr = construct(maze, UNIT, max_leaves=20)
    tight = certify(plr, maze, leaf_bounds=True)
    monkeypatch.setattr("plr_jax.plr.certificate.bounds._MOST_PIECES", 10)
    loose = certify(plr, maze, leaf_bounds=True)
    assert np.ptp(loose.band, axis=0).sum() > np.ptp(tight.band, axis=0).sum()
    check_bounds(loose, maze, 5_000)


def test_bounds_under_jit_with_the_plr_closed_over_or_as_an_argument(certified):
    x = jnp.asarray(np.random.default_rng(0).random((300, 2)), jnp.float32)
    expected = certified.bounds(x)
    np.testing.assert_allclose(jax.jit(certified.bounds)(x), expected, rtol=1e-6)
    np.testing.assert_allclose(jax.jit(lambda plr, x: plr.bounds(x))(certified, x), expected, rtol=1e-6)
    one_by_one = jax.vmap(certified.bounds)(x)
    np.testing.assert_allclose(one_by_one, expected, rtol=1e-6)
    assert jax.tree_util.tree_map(lambda leaf: leaf, certified).max_error == certified.max_error


def test_bounds_have_the_slope_of_what_is_answered(certified):
    x = jnp.array([0.3, 0.85])
    slope = jax.grad(certified)(x)
    for bound in range(2):
        np.testing.assert_array_equal(jax.grad(lambda x, bound=bound: certified.bounds(x)[bound])(x), slope)
    np.testing.assert_array_equal(jax.vmap(jax.grad(certified.lower))(x[None]), slope[None])


def test_lower_bounds_stack_with_lower_bounds_alone(certified):
    for fns in ([], [certified.lower, certified]):
        with pytest.raises(ValueError, match="Lower bounds of PLRs can be stacked"):
            certified.lower.stack(fns)


def test_a_lower_bound_is_an_argument_of_compiled_functions(certified):
    x = jnp.array([[0.3, 0.85], [0.7, 0.2]])
    np.testing.assert_array_equal(jax.jit(lambda lower, x: lower(x))(certified.lower, x), certified.lower(x))


def test_masked_points_are_not_answered(certified):
    x = np.ma.masked_invalid([[0.3, np.nan], [0.3, 0.85]])
    for answer in (certified(x), certified.bounds(x)[0], certified.lower(x)):
        np.testing.assert_array_equal(np.isnan(answer), [True, False])


def test_bounds_outside_the_domain_and_of_nan(certified):
    lower, upper = certified.bounds(np.array([[2.0, 0.5], [np.nan, 0.5], [0.5, -1e-3]]))
    np.testing.assert_array_equal(lower, [np.inf, np.nan, np.inf])
    np.testing.assert_array_equal(upper, [np.inf, np.nan, np.inf])


def test_lower_bounds_stack_into_an_admissible_heuristic(certified, maze):
    other = certify(construct(maze.with_goal((0.9, 0.9)), UNIT, max_leaves=30), maze.with_goal((0.9, 0.9)))
    fns = [certified.lower, other.lower]
    assert [fn.dim for fn in fns] == [2, 2]
    x = maze.workspace.sample_free(400, 0)
    q = x.reshape(200, 2, 2)
    heuristic = sum_of_distances(fns)
    exact = maze(q[:, 0]) + maze.with_goal((0.9, 0.9))(q[:, 1])
    found = np.asarray(heuristic(q))
    assert (found <= exact).all()
    assert (exact - found).mean() < certified.max_error + other.max_error
    np.testing.assert_allclose(
        found, np.asarray(fns[0](q[:, 0]), float) + np.asarray(fns[1](q[:, 1]), float), atol=1e-6
    )
    stacked = certified.lower.stack(fns)(q)
    np.testing.assert_array_equal(stacked[:, 0], np.asarray(certified.bounds(q[:, 0])[0], float))
    np.testing.assert_array_equal(stacked[:, 1], np.asarray(other.bounds(q[:, 1])[0], float))


def test_lower_bounds_far_from_the_origin_stack_too():
    corner = np.array([1e6, -3e5])
    workspace = Workspace(corner + np.array([[0, 0], [10, 10.0]]), [box(4, 0, 5, 7) + corner])
    oracle = VisibilityGraph(workspace, corner + 1)
    plr = construct(oracle, workspace.bounds, max_leaves=40, certified=True, leaf_bounds=True)
    q = workspace.sample_free(300, 0)[:, None]
    stacked = plr.lower.stack([plr.lower])(q)
    np.testing.assert_array_equal(stacked[:, 0], np.asarray(plr.bounds(q[:, 0])[0], float))
    assert (stacked[:, 0] <= oracle(q[:, 0])).all()


def test_an_open_room_is_exact():
    """Without corners the distance is one cone, up to what a query rounds."""
    oracle = VisibilityGraph(Workspace(((0, 0), (1, 1))), (0.3, 0.4))
    plr = construct(oracle, UNIT, leaf="cone", max_leaves=5, certified=True)
    assert plr.num_leaves == 1
    assert plr.max_error < 1e-6
    check_bounds(plr, oracle, 1000)


def test_what_cannot_be_proven_is_refused(maze):
    plr = construct(maze, UNIT, max_leaves=20)
    with pytest.raises(ValueError, match="certified=True"):
        plr.bounds(np.zeros((1, 2)))
    with pytest.raises(ValueError, match="certified=True"):
        plr.lower  # noqa: B018
    with pytest.raises(ValueError, match="answers for whole cells"):
        certify(plr, Euclidean((0.5, 0.5)))
    with pytest.raises(ValueError, match="answers for whole cells"):
        construct(cone, UNIT, certified=True)
    with pytest.raises(ValueError, match="in the plane"):
        certify(construct(cone, Box([0], [1]), max_leaves=4), maze)
    with pytest.raises(ValueError, match="Only a PLR"):
        getattr(certify, "__wrapped__", certify)(maze, maze)  # by annotations, as outside of the tests
    with pytest.raises(ValueError, match="certified must be True or False"):
        construct(maze, UNIT, certified="yes")
    with pytest.raises(ValueError, match="leaf_bounds=True needs certified=True"):
        construct(maze, UNIT, leaf_bounds=True)


def test_a_leaf_that_answers_inf_where_the_goal_is_reached_cannot_be_certified():
    """A PLR built where all but a corner was cut off, certified by an oracle that reaches everywhere."""
    thick = Workspace(((0, 0), (8, 8)), [box(1, 0, 8, 8), box(0, 1, 8, 8)])
    plr = construct(VisibilityGraph(thick, (0.5, 0.5)), thick.bounds, max_leaves=100)
    assert plr.num_unreachable
    with pytest.raises(ValueError, match="answers inf, although some of its points reach the goal"):
        certify(plr, VisibilityGraph(Workspace(thick.bounds), (0.5, 0.5)))


def test_a_certificate_is_not_carried_over_to_other_values(certified):
    """Leaves whose numbers were changed are certified anew or not at all."""
    from plr_jax.plr._assembly import with_stored

    changed = with_stored(certified, certified.stored)
    assert changed.max_error is None and changed.band is None
