"""Proofs: bounds of pieces, leaves, classes and PLRs hold at points of all kinds, and files keep them."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from piece_helpers import TEN, WORKSPACES, box, fan_workspace, general_workspace, lattice_workspace
from plr_helpers import PROVEN, UNIT, cone

from plr_jax.geometry.box import Box
from plr_jax.geometry.workspace import Workspace
from plr_jax.oracles import Euclidean, VisibilityGraph
from plr_jax.planners import sum_of_distances
from plr_jax.plr import ConstructionInterrupted, certify, construct, from_bytes
from plr_jax.plr._plr import plr_of_leaves
from plr_jax.plr.certificate import Certificate, Proof
from plr_jax.plr.leaves import leaf_names
from plr_jax.plr.source_cache import SourceCache, distances_in_cells
from plr_jax.plr.tree import Cells, grown_domain


def check_cell_distances(oracle, domain, cache, cells, u):
    """Check distances from the sources of cells at points ``u`` of each cell, in [-1, 1]; return exact distances."""
    x, tolerance = cells.points(u, domain), 10 * oracle.workspace.tolerance
    exact = oracle(x.reshape(-1, 2)).reshape(x.shape[:2])
    clear = np.abs(oracle.workspace.clearance(x.reshape(-1, 2)).reshape(x.shape[:2])) > tolerance
    found = distances_in_cells(cache.sources(cells), x)
    np.testing.assert_allclose(found[clear], exact[clear], atol=tolerance)
    return exact


@pytest.mark.parametrize("kind", WORKSPACES)
def test_distances_in_cells_equal_the_oracle(kind, monkeypatch):
    """In cells that are asked for in any order, several times, along either axis first, in batches of any size."""
    for seed in range(2, 5):
        monkeypatch.setattr("plr_jax.plr.source_cache._PAIRS_AT_ONCE", 1 if seed == 4 else 1 << 19)
        rng, domain = np.random.default_rng(seed), (Box((0, 0), (10, 10)), Box((-3, 1), (7, 13)))[seed % 3 > 0]
        workspace = kind(rng, squeeze=seed % 2 == 0)
        oracle = VisibilityGraph(workspace, workspace.sample_free(1, seed)[0])
        cache, cells = SourceCache(domain, oracle.cell_sources(grown_domain(domain))), Cells.root(2)
        cache.sources(cells)
        for _ in range(5):
            exact = check_cell_distances(oracle, domain, cache, cells, rng.uniform(-1, 1, (30, 2)))
            assert np.isfinite(exact).any() or len(cells) < 100
            split = rng.permutation(len(cells))[: 1 + len(cells) // 2]
            both = cells[split].split(rng.integers(2, size=len(split)))
            cells = both.append(cells[rng.permutation(len(cells))])[rng.permutation(len(both) + len(cells))]


def test_cells_below_a_very_thin_wall_keep_the_corner_of_their_paths():
    """Paths turn at either corner of the wall's end; the wall is as thin as the tolerance, so their cones agree."""
    oracle = VisibilityGraph(Workspace(UNIT, [box(0.4, 0.45, 0.4 + 1e-9, 0.9)]), (0.9, 0.9))
    cache, cells = SourceCache(UNIT, oracle.cell_sources(grown_domain(UNIT))), Cells.root(2)
    rng = np.random.default_rng(0)
    for axis in (0, 1, 0, 1, 0, 1, 0, 1):
        check_cell_distances(oracle, UNIT, cache, cells, rng.uniform(-1, 1, (20, 2)))
        cells = cells.split(np.full(len(cells), axis))


def critical_points(plr, oracle, n, seed=0):
    """Return points anywhere, on walls and beside them, at corners, and on the borders of leaves."""
    rng, domain, workspace = np.random.default_rng(seed), plr.domain, oracle.workspace
    anywhere = domain.lo + domain.width * rng.random((n // 2, 2))
    segments = workspace.boundary.segments
    start, end = segments[rng.integers(len(segments), size=n // 4)].transpose(1, 0, 2)
    share = rng.random((n // 4, 1)) * (rng.random((n // 4, 1)) < 0.8)
    hair = workspace.tolerance * 10.0 ** rng.uniform(-1, 5, (n // 4, 1)) * rng.choice([0, 1], (n // 4, 1))
    on_walls = start + share * (end - start) + hair * rng.normal(size=(n // 4, 2))
    lo, hi = plr.leaf_boxes
    leaf = rng.integers(len(lo), size=n // 4)
    share = rng.random((n // 4, 2))
    share[np.arange(n // 4), rng.integers(2, size=n // 4)] = rng.choice([0.0, 1.0], n // 4)
    hair = 10.0 ** rng.uniform(-9, -5, (n // 4, 1)) * rng.choice([0, 1], (n // 4, 1))
    on_borders = lo[leaf] + share * (hi - lo)[leaf] + domain.width * hair * rng.normal(size=(n // 4, 2))
    corners = np.concatenate([workspace.boundary.vertices, oracle.sources.points, lo, hi])
    x = np.concatenate([anywhere, on_walls, on_borders, corners])
    x[np.abs(x) < 1e-11] = 0  # for which a query would be compiled
    return np.clip(x, domain.lo, domain.hi)


def check_within(plr, x, exact, least=5_000):
    """Check bounds at points with a finite distance; all points are asked, so that one program answers any choice."""
    is_finite = np.isfinite(exact)
    lower, upper = (np.asarray(bound, np.float64)[is_finite] for bound in plr.bounds(x))
    x, exact = x[is_finite], exact[is_finite]
    assert len(exact) > least
    assert (lower <= exact).all(), (x[lower > exact][:3].tolist(), (lower - exact).max())
    assert (exact <= upper).all(), (x[upper < exact][:3].tolist(), (exact - upper).max())
    return lower, upper


def check_bounds(plr, oracle, n=10_000):
    """Check that bounds contain all distances and are as wide as the proof says; return the largest error met."""
    x, largest = critical_points(plr, oracle, n), 0.0
    for points in (x.astype(np.float32), x):
        exact = np.where(plr.domain.contains(points.astype(np.float64)), oracle(points.astype(np.float64)), np.inf)
        lower, upper = check_within(plr, points, exact, n / 20)
        value = np.asarray(plr(points), np.float64)[np.isfinite(exact)]
        exact = exact[np.isfinite(exact)]
        largest = max(largest, np.abs(value - exact).max())
        assert (lower >= 0).all()
        assert (upper - lower <= 2 * plr.max_error * (1 + 1e-5) + 1e-6 * exact).all()
    assert largest <= plr.max_error
    return largest


SLOW = {"smooth": pytest.mark.full}


@pytest.fixture(scope="module", params=[pytest.param(leaf, marks=SLOW.get(leaf, ())) for leaf in leaf_names()])
def certified(request, maze):
    """A PLR of the maze with bounds of every leaf."""
    return construct(maze, UNIT, leaf=request.param, max_bytes=300, certified="leaves")


def test_bounds_contain_exact_distances_and_are_tight(certified, maze):
    """Bounds of leaves take two bytes each, a bound of the largest error takes four."""
    assert certified.num_bytes <= 300
    assert certify(certified, maze, leaf_bounds=True).to_bytes() == certified.to_bytes()
    assert check_bounds(certified, maze) > 0.95 * certified.max_error
    plr = certify(from_bytes(certified.to_bytes()), maze)
    assert check_bounds(plr, maze) > 0.95 * plr.max_error
    x = maze.workspace.sample_free(5000, 0)
    leaf, error = certified.numpy().leaf(x), maze(x) - certified(x)
    least, most = np.zeros((2, certified.num_leaves))
    np.minimum.at(least, leaf, error)
    np.maximum.at(most, leaf, error)
    assert np.ptp(certified.bounds(x), axis=0).mean() < 1.7 * (most - least)[leaf].mean()
    x = np.array([[0.03, 0.9]])
    np.testing.assert_allclose(np.asarray(plr.bounds(x)) - plr(x), [[-plr.max_error], [plr.max_error]], rtol=1e-3)
    assert plr.bounds(x[0])[0].shape == ()
    assert certified.num_bytes - plr.num_bytes == 2 * certified.num_leaves
    plain = plr_of_leaves(replace(certified._contents, certificate=None))
    assert plain.max_error is None and plain.band is None and plain.num_bytes + 4 == plr.num_bytes


@pytest.mark.parametrize(
    ("leaf", "kind", "goal"),
    [("plane", general_workspace, None), ("cone", lattice_workspace, 7), ("continuous", fan_workspace, 7)],
)
def test_bounds_hold_in_random_workspaces(leaf, kind, goal):
    """Among slivers, contacts and closed parts, where the goal is free or a corner, and the domain not the bounds."""
    workspace = kind(np.random.default_rng(3), squeeze=goal is None)
    oracle = VisibilityGraph(workspace, workspace.boundary.vertices[goal] if goal else workspace.sample_free(1, 0)[0])
    domain = Box((1.3, 1.9), (9.1, 8)) if leaf == "cone" else Box((-3, -1), (12, 14))
    check_bounds(construct(oracle, domain, leaf=leaf, max_leaves=40, certified="leaves" if goal else True), oracle)


@pytest.mark.full
def test_bounds_of_classes_are_narrow_and_take_few_bytes(maze):
    """A file with one bound for all leaves, as earlier releases wrote it, is read as it was written."""
    plr = construct(maze, UNIT, leaf="cone", max_bytes=2048, certified=True)
    check_bounds(plr, maze)
    assert 1900 < plr.num_bytes <= 2048
    assert certify(plr, maze).to_bytes() == plr.to_bytes()
    np.testing.assert_array_equal(from_bytes(plr.to_bytes()).band, plr.band)
    one = plr_of_leaves(replace(plr._contents, certificate=Certificate(plr.max_error, None, Proof.CLASSES)))
    one = from_bytes(one.to_bytes())
    np.testing.assert_array_equal(one.band, [[-plr.max_error], [plr.max_error]])
    each = certify(plr, maze, leaf_bounds=True)
    assert 0 < plr.num_bytes - one.num_bytes <= one.num_bytes / 128
    x = maze.workspace.sample_free(5000, 0)
    narrow, wide, narrowest = (np.ptp(np.asarray(of.bounds(x), float), axis=0).mean() for of in (plr, one, each))
    assert narrowest < narrow < 0.6 * wide


@pytest.mark.parametrize("leaf", PROVEN)
def test_bounds_hold_in_free_space_without_samples(leaf):
    """A slit that no sample of the whole domain meets; continuous leaves, which need samples, are refused."""
    walls = [box(0, 0, 10, 4.69999), box(0, 4.70001, 10, 10), box(3, 4, 3.5, 4.700009)]
    oracle = VisibilityGraph(Workspace(TEN, walls), (9.0, 4.7))
    plr = construct(oracle, TEN, leaf=leaf, max_leaves=30, certified=True)
    with pytest.raises(ValueError, match="found nothing reachable"):
        construct(oracle, TEN, leaf="continuous", max_leaves=30, certified=True)
    share = np.random.default_rng(0).random((20_000, 2))
    x = np.array([0, 4.7 - 1e-5]) + [10, 2e-5] * share
    check_within(plr, x, oracle(x), 10_000)


@pytest.mark.full
@pytest.mark.parametrize("leaf", PROVEN)
def test_bounds_hold_behind_walls_far_smaller_than_cells(leaf):
    """A spike whose tip is just beyond a border of cells, with a goal beside it."""
    tip, half = np.array([0.4, 0.2501]), 0.125e-5
    goal = tip - (3e-9, 2e-4 / 3)
    oracle = VisibilityGraph(Workspace(UNIT, [[tip, (0.4 - half, 1e-4), (0.4 + half, 1e-4)]]), goal)
    plr = construct(oracle, UNIT, leaf=leaf, max_bytes=512, certified="leaves")
    rng, size = np.random.default_rng(0), 4 * np.abs(tip - goal).max()
    x = tip + size * np.column_stack([rng.random(10_000) ** 3, 2 * rng.random(10_000) - 1])
    check_within(plr, x, np.where(oracle.workspace.clearance(x) >= 0, oracle(x), np.inf), 2_500)


@pytest.mark.full
def test_bounds_hold_among_very_thin_pieces_far_from_the_origin():
    """The map is a million widths from the origin."""
    lo = np.array([-1712.312822890455, 1126.3337144117268])
    rings = [
        [(6.250045, 3.750004), (6.24999948, 3.75000045), (6.2500332, 3.74999997)],
        [(-1.3533e-2, 6.23885898), (-8.94838e-3, 6.234926), (5.57863e-4, 6.232479), (1.859924e-3, 6.232569)],
        [(6.0036777, 0), (6.4046463, 0), (6.4046463, 0.5), (6.0036777, 0.5)],
        [(0, 1.25), (3.6574094, 7.8238205), (3.6574096, 7.8238204)],
    ]
    workspace = Workspace((lo, lo + 1e-3), [lo + 1e-4 * np.array(ring) for ring in rings])
    x = workspace.sample_free(300, seed=1)
    oracle = VisibilityGraph(workspace, x[0])
    plr = construct(oracle, workspace.bounds, leaf="cone", max_leaves=32, certified=True)
    lower, upper = plr.bounds(x)
    slack = 4 * workspace.tolerance
    assert (lower <= oracle(x) + slack).all() and (oracle(x) <= upper + slack).all()


def test_interrupted_proof_leaves_an_unproven_plr(maze, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    whole = construct(maze, UNIT, max_leaves=20, certified=True)
    monkeypatch.setattr("plr_jax.plr._construct.certificates_of", interrupt)
    with pytest.warns(ConstructionInterrupted, match="has no certificate"):
        plr = construct(maze, UNIT, max_leaves=20, certified=True)
    assert plr.max_error is None
    np.testing.assert_array_equal(plr.leaf_boxes, whole.leaf_boxes)


def test_proofs_of_few_pieces_hold(maze, monkeypatch):
    plr = construct(maze, UNIT, max_leaves=20)
    tight = certify(plr, maze, leaf_bounds=True)
    monkeypatch.setattr("plr_jax.plr.certificate._MOST_PIECES", 10)
    loose = certify(plr, maze, leaf_bounds=True)
    assert np.ptp(loose.band, axis=0).sum() > np.ptp(tight.band, axis=0).sum()
    check_bounds(loose, maze)


def test_bounds_and_slopes_under_jit(maze):
    plr = certify(construct(maze, UNIT, max_leaves=30), maze, leaf_bounds=True)
    x = jnp.asarray(np.random.default_rng(0).random((300, 2)), jnp.float32)
    answers = jax.jit(lambda plr, x: (plr.bounds(x), plr.lower(x), jax.vmap(jax.grad(plr.lower))(x)))
    bounds, lower, slope = answers(plr, x)
    np.testing.assert_allclose(bounds, plr.bounds(x), rtol=1e-6)
    np.testing.assert_array_equal(lower, bounds[0])
    leaf = plr.numpy().leaf(np.asarray(x))
    is_sloped = (np.asarray(lower) > 0) & ~plr.unreachable[leaf]  # bounds are at least 0
    assert is_sloped.sum() > 100
    np.testing.assert_allclose(slope[is_sloped], plr.slope[leaf][is_sloped], rtol=1e-5, atol=1e-6)
    assert jax.tree_util.tree_map(lambda array: array, plr).max_error == plr.max_error


def test_bounds_of_points_outside_nan_and_masked(certified):
    bounds = certified.bounds(np.array([[2.0, 0.5], [np.nan, 0.5], [0.5, -1e-3]]))
    np.testing.assert_array_equal(bounds, 2 * [[np.inf, np.nan, np.inf]])
    x = np.ma.masked_invalid([[0.3, np.nan], [0.3, 0.85]])
    for answer in (certified(x), certified.bounds(x)[0], certified.lower(x)):
        np.testing.assert_array_equal(np.isnan(answer), [True, False])


def test_lower_bounds_stack_into_an_admissible_heuristic(certified, maze):
    other_oracle = maze.with_goal((0.9, 0.9))
    other = certify(construct(other_oracle, UNIT, max_leaves=30), other_oracle)
    fns = [certified.lower, other.lower]
    assert [fn.dim for fn in fns] == [2, 2]
    q = maze.workspace.sample_free(400, 0).reshape(200, 2, 2)
    exact, found = maze(q[:, 0]) + other_oracle(q[:, 1]), np.asarray(sum_of_distances(fns)(q))
    assert (found <= exact).all()
    assert (exact - found).mean() < certified.max_error + other.max_error
    stacked = certified.lower.stack(fns)(q)
    np.testing.assert_allclose(found, stacked.sum(axis=1), atol=1e-6)
    for i, plr in enumerate((certified, other)):
        np.testing.assert_array_equal(stacked[:, i], np.asarray(plr.bounds(q[:, i])[0], float))
    for fns in ([], [certified.lower, certified]):
        with pytest.raises(ValueError, match="fns must be a list of lower bounds"):
            certified.lower.stack(fns)


def test_cones_of_an_open_room_are_exact():
    """Without corners the distance is one cone, up to what a query rounds."""
    oracle = VisibilityGraph(Workspace(UNIT), (0.3, 0.4))
    plr = construct(oracle, UNIT, leaf="cone", max_leaves=5, certified=True)
    assert plr.num_leaves == 1 and plr.max_error < 1e-6
    check_bounds(plr, oracle)


@pytest.fixture(scope="module")
def planes(maze):
    return construct(maze, UNIT, max_leaves=20)


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda plr, maze: plr.bounds(np.zeros((1, 2))), "certified=True"),
        (lambda plr, maze: plr.lower, "certified=True"),
        (lambda plr, maze: certify(plr, Euclidean((0.5, 0.5))), "answers for whole cells"),
        (lambda plr, maze: construct(cone, UNIT, certified=True), "answers for whole cells"),
        (lambda plr, maze: certify(construct(cone, Box([0], [1]), max_leaves=4), maze), "in the plane"),
        (lambda plr, maze: certify(maze, maze), "plr must be a PLR"),
        (lambda plr, maze: construct(maze, UNIT, certified="cells"), "True, False or 'leaves', got 'cells'"),
    ],
)
def test_proofs_that_are_impossible_raise(call, message, planes, maze):
    with pytest.raises(ValueError, match=message):
        call(planes, maze)


def test_leaves_that_answer_inf_at_reachable_points_cannot_be_certified():
    """A PLR built where all but a corner was cut off, certified by an oracle that reaches everywhere."""
    thick = Workspace(((0, 0), (8, 8)), [box(1, 0, 8, 8), box(0, 1, 8, 8)])
    plr = construct(VisibilityGraph(thick, (0.5, 0.5)), thick.bounds, max_leaves=100)
    assert plr.num_unreachable
    with pytest.raises(ValueError, match="got inf in the leaf from"):
        certify(plr, VisibilityGraph(Workspace(thick.bounds), (0.5, 0.5)))
