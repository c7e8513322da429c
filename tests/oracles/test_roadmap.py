"""Roadmaps (PRM*), also on tori and with weights, compared with brute force."""

import itertools
import pickle

import networkx as nx
import numpy as np
import pytest
import shapely
from oracle_helpers import CUT, GAP, NOTHING, UNIT, Boxes, free_points, length, roadmap

from plr_jax import Box, Roadmap, Workspace
from plr_jax.oracles._roadmap import prm_star_radius

PI = np.pi
TORUS, CYLINDER = (Box((-PI, 0), (PI, 1), periodic=(True, periodic)) for periodic in (True, False))
LINE = Box([0.0], [10.0])
# One wall across the seam, one inside; motions may leave the domain, so every wall has its images.
WALLS = [(PI - 0.3, 0.2, PI + 0.2, 0.6), (-1.0, 0.3, -0.8, 0.9)]
WEIGHTS = (0.3, 2.0)


def images(domain, x):
    """Return points and their images up to two periods away, ``(images, *x.shape)``."""
    turns = itertools.product(*[range(-2, 3) if periodic else (0,) for periodic in domain.periodic])
    return np.stack([x + np.array(turn) * domain.width for turn in turns])


def walls_of(domain):
    return Boxes(*(tuple(image.ravel()) for wall in WALLS for image in images(domain, np.reshape(wall, (2, 2)))))


def nearest_images(domain, weights, a, b):
    """Return weighted distances from ``a`` to the nearest images of points ``b``, and these images."""
    candidates, rows = images(domain, b), np.arange(len(b))
    way = np.linalg.norm(weights * (a - candidates), axis=2)
    nearest = way.argmin(axis=0)
    return way[nearest, rows], candidates[nearest, rows]


def edges_of(graph):
    return {frozenset(edge) for edge in np.asarray(graph.edges).tolist()}


@pytest.fixture(
    scope="module",
    params=[
        (UNIT, (1, 1), GAP, (0.1, 0.1), 120),
        (UNIT, (1, 1), CUT, (0.1, 0.1), 60),
        (TORUS, WEIGHTS, walls_of(TORUS), (3.0, 0.9), 60),
        (CYLINDER, WEIGHTS, walls_of(CYLINDER), (3.0, 0.9), 60),
    ],
)
def case(request):
    domain, weights, walls, goal, num_samples = request.param
    return domain, np.array(weights), walls, roadmap(walls, goal, num_samples, domain, seed=4, weights=weights)


def test_roadmap_equals_brute_force(case):
    domain, weights, walls, oracle = case
    vertices, graph = oracle.graph.vertices, nx.Graph()
    for i, vertex in enumerate(vertices):
        graph.add_node(i)
        way, image = nearest_images(domain, weights, vertex, vertices[:i])
        near = (way <= oracle.radius) & walls.is_visible(np.repeat(vertex[None], i, axis=0), image)
        graph.add_weighted_edges_from((i, j, way[j]) for j in np.flatnonzero(near).tolist())
    assert edges_of(oracle.graph) == edges_of(graph)
    distances = nx.single_source_dijkstra_path_length(graph, 0)
    np.testing.assert_allclose(oracle.distances, [distances.get(v, np.inf) for v in range(len(vertices))])
    across = np.abs(vertices[oracle.graph.edges[:, 0]] - vertices[oracle.graph.edges[:, 1]]) > domain.width / 2
    assert not domain.is_periodic or across.any(axis=0).tolist() == list(domain.periodic)
    np.testing.assert_allclose(oracle(vertices), oracle.distances, rtol=0, atol=1e-9)
    assert oracle(oracle.goal[None])[0] == 0.0
    np.testing.assert_array_equal(oracle.shortest_path(oracle.goal), oracle.goal[None])


def test_queries_and_paths_equal_brute_force(case):
    domain, weights, walls, oracle = case
    x = np.random.default_rng(1).uniform(domain.lo, domain.hi, (40, 2))
    x[:5, 0] = domain.hi[0]
    found, vertices = oracle(x), oracle.graph.vertices
    np.testing.assert_array_equal(found, [oracle(point[None])[0] for point in x])
    for turns in (1, -2):  # points whole periods away are equal
        np.testing.assert_allclose(oracle(x + turns * domain.width * domain.periodic), found, atol=1e-9)
    for point, distance in zip(x, found, strict=True):
        path = oracle.shortest_path(point + 3 * domain.width * domain.periodic)
        if not walls.is_free(point[None])[0]:
            assert distance == np.inf and path.shape == (0, 2)
            continue
        way, image = nearest_images(domain, weights, point, vertices)
        seen, radius = walls.is_visible(np.repeat(point[None], len(vertices), axis=0), image), oracle.radius
        while not np.any(seen & (way <= radius)):
            radius *= 2
        assert distance == pytest.approx((way + oracle.distances)[seen & (way <= radius)].min(), abs=1e-9)
        assert (len(path) == 0) == np.isinf(distance) and domain.contains(path).all()
        legs = [nearest_images(domain, weights, a, b[None]) for a, b in itertools.pairwise(path)]
        assert np.isinf(distance) or sum(way[0] for way, _ in legs) == pytest.approx(distance, abs=1e-9)
        assert all(walls.is_visible(a[None], image)[0] for a, (_, image) in zip(path, legs, strict=False))


def test_with_goal_keeps_samples_and_edges(case):
    domain, weights, walls, oracle = case
    asked, goal = [], domain.lo + domain.width * [0.01, 0.05]

    def is_visible(a, b):
        asked.append(len(a))
        return walls.is_visible(a, b)

    options = {"num_samples": len(oracle.distances) - 1, "domain": domain, "seed": 4, "weights": weights}
    expected, x = roadmap(walls, goal, **options), domain.grid(9).reshape(-1, 2)
    moved = roadmap(walls, oracle.goal, **options, is_visible=is_visible)
    asked.clear()
    other = moved.with_goal(goal + domain.width * domain.periodic)
    assert len(asked) == 1 and asked[0] < 100  # only the edges of the goal are tested
    np.testing.assert_allclose(other.goal, goal, atol=1e-12)
    np.testing.assert_array_equal(other.graph.vertices[1:], expected.graph.vertices[1:])
    assert edges_of(other.graph) == edges_of(expected.graph) and other.num_bytes == expected.num_bytes
    np.testing.assert_allclose(other(x), expected(x), atol=1e-9)
    with pytest.raises(ValueError, match="not free"):
        other.with_goal(walls.lo[0] + 0.02 if domain.is_periodic else (0.5, 0.5))


def test_points_outside_the_domain_are_unreachable():
    oracle = roadmap(NOTHING)
    x = np.array([[1.1, 0.5], [0.5, -1e-9], [np.nan, 0.5], [0.5, np.inf], [1.0, 1.0]])
    np.testing.assert_array_equal(np.isfinite(oracle(x)), [False, False, False, False, True])
    assert oracle.shortest_path(x[2]).shape == (0, 2)
    assert oracle(np.empty((0, 2))).shape == (0,) and oracle(x.tolist()).dtype == np.float64


def test_points_without_near_vertices_search_farther():
    """A closet in a corner, open to the right, and a sealed chamber; both are too small to contain a sample."""
    closet = [(0.0, 0.979, 0.1, 0.98), (0.0, 0.90, 0.02, 0.979)]
    chamber = [(0.5, 0.5, 0.52, 0.5001), (0.5, 0.5, 0.5001, 0.52)]
    chamber += [(0.5, 0.5199, 0.52, 0.52), (0.5199, 0.5, 0.52, 0.52)]
    oracle = roadmap(Boxes(*closet, *chamber), (0.9, 0.99), 60, seed=0)
    x = np.array([[0.001, 0.981], [0.51, 0.51]])
    way = np.linalg.norm(oracle.graph.vertices - x[0], axis=1)
    seen, seen_from_chamber = (oracle.is_visible(np.repeat(p[None], 61, 0), oracle.graph.vertices) for p in x)
    assert not np.any(seen & (way <= oracle.radius)) and seen.any() and not seen_from_chamber.any()
    found, path = oracle(x), oracle.shortest_path(x[0])
    assert np.linalg.norm(x[0] - oracle.goal) <= found[0] < 1.0 and np.isinf(found[1])
    assert length(path) == pytest.approx(found[0]) and oracle.shortest_path(x[1]).shape == (0, 2)
    # A hallway with two vertices; none is within the radius of the point.
    assert roadmap(NOTHING, (0, 0.5), 1, Box((0, 0), (100, 1)))([(30, 0.5)]) == 30


def test_samples_depend_on_the_seed_only():
    first, again, other, more = (roadmap(GAP, num_samples=n, seed=k) for n, k in ((50, 1), (50, 1), (50, 2), (99, 1)))
    np.testing.assert_array_equal(first.graph.vertices, again.graph.vertices)
    assert not np.array_equal(first.graph.vertices, other.graph.vertices)
    np.testing.assert_array_equal(more.graph.vertices[:51], first.graph.vertices)
    assert first.num_bytes == 51 * 2 * 8 + len(first.graph.edges) * (2 * 4 + 8)


def test_roadmap_of_workspace_equals_roadmap_of_functions():
    workspace = Workspace(((0, 0), (1, 1)), [shapely.box(0.45, 0.0, 0.55, 0.8), shapely.box(0.45, 0.9, 0.55, 1.0)])
    short, x = Roadmap.from_workspace(workspace, (0.1, 0.1), 300, seed=2), free_points(GAP, 200)
    np.testing.assert_allclose(short(x), roadmap(GAP, seed=2)(x), rtol=1e-12)
    assert short.domain == UNIT and short.dim == 2


def motion_tests(resolution, is_free=lambda x: np.ones(len(x), bool), domain=LINE, **options):
    """Return a roadmap that tests motions by samples, and the list of configurations that it tests."""
    tested = []

    def recorded(x):
        assert domain.contains(x).all()  # nothing is free outside, where the test is not asked
        tested.append(x)
        return is_free(x)

    oracle = Roadmap(domain, recorded, [2.0], 1, resolution=resolution, **options)
    tested.clear()
    return oracle, tested


@pytest.mark.parametrize(("length", "num_inner"), [(0.0, 0), (0.4, 0), (0.5, 0), (0.6, 1), (2.0, 3), (2.1, 4)])
def test_motions_are_sampled_evenly_at_the_resolution(length, num_inner):
    oracle, tested = motion_tests(0.5)
    assert oracle.is_visible(np.array([[3.0]]), np.array([[3.0 + length]]))[0]
    inner = np.concatenate([np.empty((0, 1)), *tested])[:, 0]
    np.testing.assert_allclose(np.sort(inner), np.linspace(3.0, 3.0 + length, num_inner + 2)[1:-1])


def test_motions_across_the_seam_take_weighted_steps():
    oracle, tested = motion_tests(0.5, domain=Box([0.0], [10.0], [True]), weights=[0.5])
    assert oracle.is_visible(np.array([[9.0], [1.5]]), np.array([[2.0], [19.5]])).all()
    inner = np.concatenate(tested)[:, 0]
    np.testing.assert_allclose(np.sort(inner), [0, 0.5, 1])  # 9 to 12: at 10 and 11, which wrap; 1.5 to -0.5: at 0.5


def test_each_motion_depends_on_its_own_samples_only():
    oracle, _ = motion_tests(0.1, lambda x: (x[:, 0] <= 4.0) | (x[:, 0] >= 5.0))
    a, b = np.array([[1.0], [1], [7], [4], [6], [3]]), np.array([[3.0], [6], [2], [4], [9], [3.05]])
    np.testing.assert_array_equal(oracle.is_visible(a, b), [True, False, False, True, True, True])
    assert oracle.is_visible(a[:0], b[:0]).shape == (0,)
    np.testing.assert_array_equal(oracle.is_free(np.array([[4.5], [2], [-1], [11], [np.nan]])), [0, 1, 0, 0, 0])


def test_radius_equals_prm_star_formula():
    assert prm_star_radius(1000, 2, 0.5) == pytest.approx(2 * np.sqrt(1.5 * 0.5 / np.pi * np.log(1000) / 1000))
    assert prm_star_radius(500, 3, 2.0) == pytest.approx(2 * np.cbrt(2.0 / np.pi * np.log(500) / 500))
    assert roadmap(NOTHING, num_samples=299).radius == pytest.approx(prm_star_radius(300, 2, 1.0))
    assert roadmap(CUT, num_samples=999).radius == pytest.approx(prm_star_radius(1000, 2, 0.9), rel=0.03)


def test_roadmap_can_be_pickled():
    for tests in ({"is_visible": NOTHING.is_visible}, {"resolution": 0.1}):
        oracle, x = Roadmap(UNIT, NOTHING.is_free, (0.1, 0.1), 50, **tests), free_points(NOTHING, 40)
        np.testing.assert_array_equal(pickle.loads(pickle.dumps(oracle))(x), oracle(x))


def test_queries_and_blocked_motions_need_few_tests():
    asked = []
    oracle = roadmap(NOTHING, is_visible=lambda a, b: asked.append(len(a)) or np.ones(len(a), bool), num_samples=60)
    asked.clear()
    oracle(free_points(NOTHING, 50))
    assert asked == [50]
    oracle, tested = motion_tests(0.01, lambda x: (x[:, 0] <= 4.0) | (x[:, 0] >= 5.0))
    starts = np.linspace(1.0, 4.0, 100)[:, None]
    assert not oracle.is_visible(starts, 9.0 - starts).any() and sum(map(len, tested)) <= 400
