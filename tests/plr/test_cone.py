"""Leaves that are cones: their size, values, bounds and goals, their sources in files, and families of goals."""

import pickle
import tracemalloc
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from piece_helpers import TEN, box, general_workspace, lattice_workspace, points_of, random_pieces
from plr_helpers import UNIT, leaf_by_search, points
from portable_helpers import case
from shapely import Polygon

from plr_jax import Box, NearestGoal, VisibilityGraph, Workspace, from_bytes, scenes
from plr_jax._types import Sources
from plr_jax.plr import construct
from plr_jax.plr._file import body_of_leaves
from plr_jax.plr.certificate import LeafFunctions
from plr_jax.plr.coding import BitReader, BitWriter
from plr_jax.plr.container import Layer
from plr_jax.plr.leaves import leaf_model, leaf_names
from plr_jax.plr.leaves.cone import family, search
from plr_jax.plr.leaves.cone.codec import StoredCones, StoredSources, read_cones, store_sources, write_cones
from plr_jax.plr.tree import Cells, tree_of_axes


def mean_error(plr, oracle, x):
    return np.abs(np.asarray(plr(x), float) - oracle(x)).mean()


def test_cones_of_a_maze_are_small_and_accurate(maze):
    x = maze.workspace.sample_free(5000, 0)
    small, few = (construct(maze, UNIT, leaf="cone", **limit) for limit in ({"max_bytes": 260}, {"max_leaves": 20}))
    assert small.num_bytes <= 260 and few.num_leaves <= 20
    assert mean_error(small, maze, x) < 1e-5 < mean_error(few, maze, x) < 0.1


@pytest.mark.full
def test_cones_among_clutter_take_little_memory():
    """All pairs of 400 corners and triangles of free space once took a gigabyte."""
    free = np.ones((60, 60), bool)
    free[3::6, 3::6] = False
    workspace = Workspace.from_mask(free)
    oracle = VisibilityGraph(workspace, (1, 1))
    construct(oracle, workspace.bounds, max_leaves=1)
    tracemalloc.start()
    construct(oracle, workspace.bounds, leaf="cone", max_leaves=1)
    assert tracemalloc.get_traced_memory()[1] < 300e6
    tracemalloc.stop()


def test_values_and_gradients_are_those_of_cones_around_sources():
    goal = np.array([0.25, 0.5])
    oracle = VisibilityGraph(Workspace(UNIT, [box(0.4, 0, 0.5, 0.7)]), goal)
    plr = construct(oracle, UNIT, leaf="cone", max_bytes=300)
    offset, apex = plr._coefficients[:, 0], plr._coefficients[:, 1:]
    away = np.linalg.norm(apex[:, None] - oracle.sources.points, axis=2)
    np.testing.assert_allclose(away.min(axis=1), 0, atol=1e-7)
    np.testing.assert_allclose(offset, oracle.sources.distances[away.argmin(axis=1)], atol=1e-6)
    x = np.concatenate([[goal, goal + 1e-7], points(500, 0)]).astype(np.float32).astype(float)
    leaf = leaf_by_search(plr, x)
    leg = x - apex[leaf]
    length = np.hypot(*leg.T)
    np.testing.assert_allclose(np.asarray(plr(x)), offset[leaf] + length, atol=1e-6)
    np.testing.assert_allclose(plr.values_in_leaves(leaf, x), offset[leaf] + length, rtol=1e-14)
    gradient = np.asarray(jax.vmap(jax.grad(plr))(jnp.asarray(x, jnp.float32)))
    far = length > 0.01
    np.testing.assert_allclose(gradient[far], leg[far] / length[far, None], atol=1e-4)
    assert plr(x)[0] == 0 and gradient[0].tolist() == [0, 0] and np.isfinite(gradient[1]).all()
    hessian = np.asarray(jax.jit(jax.vmap(jax.jacrev(jax.grad(plr))))(jnp.asarray(x, jnp.float32)))
    expected = (np.eye(2) - gradient[:, :, None] * gradient[:, None]) / np.maximum(length, 0.01)[:, None, None]
    np.testing.assert_allclose(hessian[far], expected[far], rtol=1e-4, atol=1e-4)
    assert not hessian[0].any() and np.isfinite(hessian[1]).all()


def test_mean_planes_equal_differences_of_cones(maze):
    cones = construct(maze, UNIT, leaf="cone", max_leaves=20)
    lo, hi = cones.leaf_boxes
    center, width = (lo + hi) / 2, hi - lo

    def cone(x):
        return cones.values_in_leaves(np.arange(cones.num_leaves), x)

    for axis, step in enumerate(np.eye(2)[:, None] * width / 2):
        slope = (cone(center + step) - cone(center - step)) / width[:, axis]
        np.testing.assert_allclose(cones.slope[:, axis], slope, atol=1e-9)
    np.testing.assert_allclose(cones.intercept + (cones.slope * center).sum(axis=1), cone(center), atol=1e-9)


@pytest.mark.parametrize("name", leaf_names())
def test_bounds_of_cone_minus_leaf_hold(name):
    """Check the bounds at random points of convex pieces of the leaf's box."""
    leaf, rng = leaf_model(name), np.random.default_rng(3)
    pieces = random_pieces(rng, 60, 1.5)
    lo, hi = pieces.min(axis=2).T - rng.random((60, 2)), pieces.max(axis=2).T + rng.random((60, 2))
    num_terms = 3 if name == "cone" else leaf.basis(np.zeros((1, 2))).shape[1]
    coefficients = rng.normal(size=(60, num_terms)) + (np.array([0, 5, 5]) if name == "cone" else 0)
    apex, offset = rng.uniform(0, 10, (60, 2)), rng.normal(size=60)
    apex[::4] = pieces.mean(axis=2).T[::4]
    low, high = leaf.cone_minus_leaf_bounds(LeafFunctions(leaf, lo, hi, coefficients), pieces, apex, offset)
    for x in points_of(rng, pieces, 400).swapaxes(0, 1):
        value = offset + np.linalg.norm(x - apex, axis=1) - leaf.values(lo, hi, coefficients, x)
        assert (low <= value + 1e-9).all() and (value <= high + 1e-9).all()
    assert (high - low < 40).all()


@pytest.mark.parametrize("kind", [general_workspace, lattice_workspace])
def test_cones_of_several_goals_know_distance_and_index_of_the_nearest(kind):
    workspace = kind(np.random.default_rng(2))
    goals = [*workspace.sample_free(4, 0), workspace.boundary.vertices[0]]
    first = VisibilityGraph(workspace, goals[0])
    oracles = [first, *map(first.with_goal, goals[1:])]
    plr = construct(NearestGoal(oracles), workspace.bounds, leaf="cone", max_bytes=2048, certified="leaves")
    assert plr.num_bytes <= 2048
    x = workspace.sample_free(5_000, 1)
    distances = np.stack([oracle(x) for oracle in oracles])
    is_reached = np.isfinite(distances).any(axis=0)
    x, distances = x[is_reached], distances[:, is_reached]
    least, (lower, upper) = distances.min(axis=0), np.asarray(plr.bounds(x), float)
    assert ((lower <= least) & (least <= upper)).all()
    error, which = np.abs(np.asarray(plr(x), float) - least), plr.which(x)
    excess = distances[which, np.arange(len(x))] - least
    resolution = 1e-6 * least.max()
    assert (excess <= 2 * resolution)[error <= resolution].all(), "another goal only where the distance ties or errs"
    assert (error <= resolution).mean() > 0.9 and error.mean() < 1e-3


def test_cones_in_files_name_the_nearest_goal():
    """Other files do not, which their readers say."""
    workspace = Workspace(TEN, [box(4, 2, 6, 8)])
    nearest = NearestGoal([VisibilityGraph(workspace, goal) for goal in ((9, 1), (1, 5), (1, 5))])
    cones, planes = (construct(nearest, Box(*TEN), leaf=leaf, max_leaves=60) for leaf in ("cone", "plane"))
    from_cones, from_planes = (from_bytes(plr.with_label("exits").to_bytes()) for plr in (cones, planes))
    x = [(1, 5), (9, 1), (2, 2), (8, 8), (11, 1), (np.nan, 1)]
    pickled, named = pickle.loads(pickle.dumps(from_cones)), from_planes.with_nearest_goal(nearest.which)
    for plr in (cones, planes, from_cones, pickled, named, from_cones.numpy()):
        assert plr.which(x).tolist() == [1, 0, 1, 0, -1, -1]
    assert jax.jit(lambda plr, x: plr.which(x))(cones, np.array(x)).tolist() == from_cones.which(x).tolist()
    f = from_cones.numpy()
    assert f.which(np.array(x * 9)).tolist()[:6] == [f.which(each) for each in x]
    one = construct(nearest.distance_fns[0], Box(*TEN), leaf="cone", max_leaves=60)
    for plr in (from_planes, one, planes.numpy()):
        with pytest.raises(ValueError, match=r"not store which .*with_nearest_goal\(oracle.which\).* trace\(plr, x"):
            plr.which(x)
    assert (one.to_bytes()[2] & 15, cones.to_bytes()[2] & 15) == (5, 6), "readers of version 5 ask for an update"


def test_no_goal_is_nearest_in_a_closed_room():
    workspace = Workspace(TEN, [Polygon(box(4, 2, 6, 8), [box(4.2, 2.2, 5.8, 7.8)])])
    nearest = NearestGoal([VisibilityGraph(workspace, goal) for goal in ((9, 1), (1, 5))])
    plr = construct(nearest, Box(*TEN), leaf="cone", max_leaves=60)
    f, x = plr.numpy(), [(5.0, 5.0), (1.0, 5.0)]
    traced = jax.jit(lambda plr, x: plr.which(x))(plr, np.array(x))
    for answers in (plr.which(x), f.which(np.array(x)), f.which(np.array(x * 9))[:2], traced):
        assert answers.tolist() == [-1, 1]
    assert [f.which(each) for each in x] == [-1, 1]


def test_invalid_stored_goals_raise():
    exits, planes = case("cones of exits"), case("maze of planes")
    for plr, width, message in (
        (planes, 2, "names goals, but its leaves have no sources"),
        (exits, 3, "end too early"),
        (exits, 21, "goals of 21 bits"),
    ):
        body = body_of_leaves(plr._contents).write(np.array([width]), 6)
        layer = Layer(plr.container.last.leaf_code, body.to_bytes())
        with pytest.raises(ValueError, match=message):
            from_bytes(replace(plr.container, layers=(layer,), names_goals=True).to_bytes())


def test_cones_of_an_unreachable_domain_raise():
    oracle = VisibilityGraph(Workspace(TEN, [box(4, 0, 6, 10)]), (1, 5))
    with pytest.raises(ValueError, match="nothing reachable"):
        construct(oracle, ((7, 0), (10, 10)), leaf="cone")


def test_leaves_prefer_visible_sources_without_a_worse_proof(maze, monkeypatch):
    x, plrs = maze.workspace.sample_free(10_000, seed=0), []
    for choose in (search.prefer_visible_sources, lambda tree, options, fits: tree.source):
        monkeypatch.setattr(search, "prefer_visible_sources", choose)
        plrs.append(construct(maze, UNIT, leaf="cone", max_bytes=261, certified=True))
    plr, before = plrs
    assert plr.num_leaves == before.num_leaves and before.num_bytes <= 261 and plr.num_bytes <= 261
    assert plr.max_error <= before.max_error * (1 + 1e-6)
    sources = (each.stored.sources.points[each.stored.source[each.numpy().leaf(x)]] for each in plrs)
    hidden, hidden_before = (1 - maze.workspace.is_visible(x, source).mean() for source in sources)
    assert hidden < min(0.001, 0.4 * hidden_before) and mean_error(plr, maze, x) < 1.5 * mean_error(before, maze, x)


# Sources in files.


LATTICES = {"integers": 1.0, "hundredths": 0.01, "quarters": 0.25, "thirds": 1 / 3, "none": None}


def random_sources(rng, dim, count, lattice):
    """Return sources, some of the first of which are goals, with distances along a tree."""
    step = LATTICES[lattice]
    points = np.unique(rng.integers(-300, 300, (count, dim)), axis=0).astype(float)
    points = points * step if step else points + rng.random(points.shape)
    points = rng.permutation(points)
    count = len(points)
    parents = np.array([rng.integers(max(i, 1)) for i in range(count)])
    parents[: 1 + count // 10] = np.arange(1 + count // 10)
    return sources_along(points, parents)


def sources_along(points, parents):
    distances = np.linalg.norm(points - points[parents], axis=1)
    for i in np.flatnonzero(parents < np.arange(len(points))):
        distances[i] += distances[parents[i]]
    return Sources(points, distances, parents)


def bits_of(domain, cones):
    body = BitWriter()
    write_cones(body, domain, cones)
    return body


@pytest.mark.parametrize("lattice", LATTICES)
@given(st.integers(0, 100_000), st.integers(1, 5), st.sampled_from([1, 2, 17, 60]))
def test_sources_are_read_as_written(lattice, seed, dim, count):
    rng = np.random.default_rng(seed)
    sources = random_sources(rng, dim, count, lattice)
    points, distances = sources.points, sources.distances
    domain = Box(points.min(axis=0) - rng.random(dim), points.max(axis=0) + 10 * rng.random(dim) + 0.1)
    stored, index = store_sources(sources, domain)
    width = domain.width.max()
    rounding = 1e-13 * (1 + np.abs(points).max()) if LATTICES[lattice] else 2.0**-25 * width
    far = (1 + np.arange(len(points))) * 2 * rounding * np.sqrt(dim) + 1e-12 * (1 + distances)
    assert (np.abs(stored.offsets[index] - distances) <= far).all()
    stored = replace(stored, root_offset=stored.is_root * rng.integers(9, size=len(points)) / 8)
    source = index[rng.integers(len(points), size=int(rng.integers(1, 80)))]
    body = bits_of(domain, StoredCones(stored, source))
    reader = BitReader(body.to_bytes())
    found = read_cones(reader, domain, len(source))
    assert reader.at_end()
    np.testing.assert_array_equal(found.source, source)
    for name in ("code", "parent", "root_offset", "points", "offsets"):
        np.testing.assert_array_equal(getattr(found.sources, name), getattr(stored, name))
    assert np.abs(found.sources.points[index] - points).max() <= rounding
    assert len(np.unique(index)) == len(points)
    np.testing.assert_array_equal(found.sources.parent[index], index[sources.parents])


def test_equal_sources_are_stored_once():
    points = np.array([[0.0, 0], [0, 0], [1, 1], [1, 1 + 1e-15]])
    distances, domain = np.array([0, 0, 2**0.5, 2**0.5]), Box((0, 0), (2, 2))
    sources = Sources(points, distances, np.array([0, 1, 0, 0]), np.array([5, 5]))
    stored, index = store_sources(sources, domain)
    assert index.tolist() == [0, 0, 1, 1] and stored.goals.tolist() == [5]
    assert stored.parent.tolist() == [0, 0] and stored.is_root.tolist() == [True, False]
    np.testing.assert_allclose(stored.offsets, [0, 2**0.5])
    # Source 1 and its parent, source 2, are stored as one source, whose parent is source 0.
    stored, index = store_sources(Sources(points[1:], distances[1:], np.array([0, 2, 0])), domain)
    assert index.tolist() == [0, 1, 1] and stored.parent.tolist() == [0, 0]


@given(st.binary(max_size=400), st.integers(1, 5), st.integers(1, 300))
def test_arbitrary_bits_are_read_or_refused(data, dim, num_leaves):
    try:
        found = read_cones(BitReader(data), Box(np.zeros(dim), np.ones(dim)), num_leaves)
    except ValueError:
        return
    assert found.source.shape == (num_leaves,) and (found.source < len(found.sources.code)).all()
    assert np.isfinite(found.sources.offsets).all() and np.isfinite(found.sources.points).all()


DOMAIN = Box((0, 0), (8, 8))
# Three sources, each the parent of the next, as a file keeps them.
SOURCES = StoredSources(0, 0, 1, np.array([[0, 0], [1, 4], [2, 7]]), np.array([0, 0, 1]), np.zeros(3))


def bytes_of(**changes):
    return bits_of(DOMAIN, StoredCones(replace(SOURCES, **changes), np.zeros(4, int))).to_bytes()


def bytes_of_header(counts, *fraction, rest=bytes(99)):
    return BitWriter().write(np.array(counts), 20).write(np.array(fraction, int), 16).to_bytes() + rest


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (bytes_of(parent=np.array([0, 2, 1])), "circle"),
        (bytes_of(parent=np.array([0, 3, 1])), "names source 3 of 3"),
        (bytes_of(num_fine=3, exponent=201), "steps of"),
        (bytes_of(num_fine=3, exponent=-201), "steps of"),
        (bytes_of(num_fine=3, exponent=150), "too large"),
        (bytes_of(root_offset=np.array([np.nan, 0, 0])), "too large"),
        (bytes_of(root_offset=np.array([np.inf, 0, 0])), "too large"),
        (bytes_of(code=np.array([[0, 0], [1, 4], [2, 2**45]])), "coordinates of 46 bits"),
        (bytes_of_header((0, 0)), "no sources"),
        (bytes_of_header((0, 1), 0), "steps of 1 / 0"),
        (bytes_of_header((0, 2**20 - 1), 1, rest=bytes(range(1, 30))), "end too early"),  # before they are allocated
    ],
)
def test_invalid_stored_sources_raise(data, message):
    with pytest.raises(ValueError, match=message):
        read_cones(BitReader(data), DOMAIN, 4)


@pytest.mark.parametrize(
    ("x", "distance", "message"),
    [(0.0, 1e39, "Scale them down"), (1e19, 0.0, r"Cones need distances and domains within 1e\+18")],
)
def test_sources_too_large_for_floats_raise(x, distance, message):
    with pytest.raises(ValueError, match=message):
        sources = Sources(np.array([[x, 0.0], [x, 0]]), np.array([0.0, distance]), np.zeros(2, int))
        store_sources(sources, Box((0, 0), (8 + 2 * x, 8)))


@pytest.mark.parametrize("width", [2.0**26, 1e17])
def test_sources_of_wide_domains_are_read_as_written(width):
    sources = sources_along(width * np.array([[0.25, 0.3], [0.5, 0.7], [0.9, 1.0]]), np.array([0, 0, 1]))
    domain = Box([0, 0], [width, width])
    stored, index = store_sources(sources, domain)
    cones = StoredCones(stored, index[[2, 0, 1, 1]])
    found = read_cones(BitReader(bits_of(domain, cones).to_bytes()), domain, 4)
    np.testing.assert_array_equal(found.source, cones.source)
    np.testing.assert_allclose(found.sources.points[index], sources.points, atol=2.0**-25 * width)
    np.testing.assert_allclose(found.sources.offsets[index], sources.distances, rtol=1e-6)


# Cones of a family of goals.


def test_boxes_take_the_best_source_of_their_halves():
    workspace, lattice = scenes.maze().workspace, family.Lattice(3)
    oracle = VisibilityGraph(workspace, (0.06, 0.07))
    cells = Cells(np.full((64, 2), 3), np.stack(np.divmod(np.arange(64), 8), axis=1))
    samples = oracle.shared_samples(*cells.boxes(UNIT))
    fits = family.fit_boxes(lattice, family.goal_samples(oracle, samples), 0.0)
    error = np.linalg.norm(samples.x[:, None] - oracle.sources.points, axis=2) + oracle.sources.distances
    error = np.abs(error - oracle(samples.x)[:, None])
    mixed = 0
    for shape, number in [(each, i) for each in lattice.first for i in range(1 << sum(each))]:
        box = lattice.first[shape] + number
        place = np.stack([number >> shape[1], number & ((1 << shape[1]) - 1)])
        inside = (cells.position >> (3 - np.array(shape)) == place).all(axis=1) & (samples.weight > 0)
        source, halves = fits.source[box], lattice.child[:, box][lattice.child[:, box] >= 0]
        mean = samples.weight[inside] @ error[inside] / 64
        np.testing.assert_allclose(fits.integral[box], mean[source], atol=1e-15)
        np.testing.assert_allclose(fits.largest[box], error[inside, source].max(initial=0.0), atol=1e-15)
        assert mean[source] <= mean[fits.source[halves]].min(initial=np.inf) + 1e-15
        mixed += fits.is_mixed[box]
    assert mixed > 20 and (fits.integral[fits.is_mixed] > 0).any()


@pytest.mark.parametrize("max_depth", [3, 4, 60])
def test_best_tree_has_the_least_cost(max_depth):
    lattice, rng = family.Lattice(2), np.random.default_rng(5)
    depth = np.repeat([sum(shape) for shape in lattice.first], [1 << sum(shape) for shape in lattice.first])
    costs = rng.random(lattice.num_boxes) * 3.0**-depth

    def least(box):
        ways = [costs[box] + price]
        if depth[box] < max_depth:
            ways += [least(lower) + least(upper) for lower, upper in lattice.child[:, box] if lower >= 0]
        return min(ways)

    for price in (1.0, 0.1, 0.01, 0.0):
        tree = family.best_tree(lattice, costs, price, max_depth)
        np.testing.assert_allclose(costs[tree.box].sum() + price * len(tree.box), least(0), rtol=1e-12)
        assert tree_of_axes(tree.axes, 2).leaves.depth.sum(axis=1).tolist() == depth[tree.box].tolist()
