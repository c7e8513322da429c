"""Roadmaps on tori and cylinders, and with weights: equal to twins by brute force."""

import itertools

import networkx as nx
import numpy as np
import pytest
from oracle_helpers import GAP, NOTHING, UNIT, Boxes, roadmap

from plr_jax.geometry.box import Box
from plr_jax.oracles import Roadmap
from plr_jax.plr import construct

PI = np.pi
TORUS = Box((-PI, 0), (PI, 1), periodic=(True, True))
CYLINDER = Box((-PI, 0), (PI, 1), periodic=(True, False))
GOAL = np.array([3.0, 0.9])
# One wall across the seam, one inside; motions may leave the domain, so every wall has its images.
WALLS = [(PI - 0.3, 0.2, PI + 0.2, 0.6), (-1.0, 0.3, -0.8, 0.9)]
PERIOD = np.array([2 * PI, 0])
WEIGHTS = np.array([0.3, 2.0])


def images(domain, x):
    """All points a period or two away, the point itself among them."""
    turns = itertools.product(*[range(-2, 3) if periodic else (0,) for periodic in domain.periodic])
    return [x + np.array(turn) * domain.width for turn in turns]


def walls_of(domain):
    corners = [np.reshape(wall, (2, 2)) for wall in WALLS]
    return Boxes(*(tuple(image.ravel()) for wall in corners for image in images(domain, wall)))


def apart(domain, weights, a, b):
    """Weighted distance to the nearest image, and that image."""
    lengths, nearest = zip(
        *((np.linalg.norm(weights * (a - image)), image) for image in images(domain, b)), strict=True
    )
    return min(lengths), nearest[int(np.argmin(lengths))]


@pytest.fixture(scope="module", params=[(TORUS, np.ones(2)), (TORUS, WEIGHTS), (CYLINDER, WEIGHTS)])
def case(request):
    domain, weights = request.param
    walls = walls_of(domain)
    return domain, weights, walls, roadmap(walls, GOAL, 60, domain, seed=4, weights=weights)


def test_brute_force_twin(case):
    domain, weights, walls, oracle = case
    vertices, graph = oracle.graph.vertices, nx.Graph()
    graph.add_nodes_from(range(len(vertices)))
    for i, j in itertools.combinations(range(len(vertices)), 2):
        length, image = apart(domain, weights, vertices[i], vertices[j])
        if length <= oracle.radius and walls.is_visible(vertices[i][None], image[None])[0]:
            graph.add_edge(i, j, weight=length)
    assert {frozenset(e) for e in oracle.graph.edges.tolist()} == {frozenset(e) for e in graph.edges}
    distances = nx.single_source_dijkstra_path_length(graph, 0)
    np.testing.assert_allclose(oracle.distances, [distances.get(v, np.inf) for v in range(len(vertices))])
    around = np.abs(vertices[oracle.graph.edges[:, 0]] - vertices[oracle.graph.edges[:, 1]]) > domain.width / 2
    assert (around.sum(axis=0) > 0).tolist() == list(domain.periodic)  # edges do cross the seams


def test_queries_are_those_by_brute_force(case):
    domain, weights, walls, oracle = case
    x = np.random.default_rng(1).uniform(domain.lo, domain.hi, (80, 2))
    x[:5, 0] = PI
    for point, found in zip(x, oracle(x), strict=True):
        if not walls.is_free(point[None])[0]:
            assert found == np.inf
            continue
        reach = [apart(domain, weights, point, vertex) for vertex in oracle.graph.vertices]
        seen = np.array([walls.is_visible(point[None], image[None])[0] for _, image in reach])
        length, radius = np.array([length for length, _ in reach]), oracle.radius
        while not np.any(seen & (length <= radius)):
            radius *= 2
        assert found == pytest.approx((length + oracle.distances)[seen & (length <= radius)].min(), abs=1e-9)


def test_whole_periods_away_is_the_same_place(case):
    domain, _, _, oracle = case
    x = np.random.default_rng(2).uniform(domain.lo, domain.hi, (200, 2))
    for turns in (1, -2):
        away = x + turns * domain.width * domain.periodic
        np.testing.assert_allclose(oracle(away), oracle(x), atol=1e-9)
        path, again = oracle.shortest_path(x[0]), oracle.shortest_path(away[0])
        np.testing.assert_allclose(again, path, atol=1e-9)
    lower = np.column_stack([np.full(200, -PI), x[:, 1]])
    np.testing.assert_array_equal(oracle(lower + PERIOD), oracle(lower))


def test_paths_are_as_long_as_their_distance_the_short_way(case):
    domain, weights, walls, oracle = case
    for x in np.random.default_rng(3).uniform(domain.lo, domain.hi, (20, 2)):
        path = oracle.shortest_path(x + 3 * domain.width * domain.periodic)
        if len(path):
            steps = [apart(domain, weights, a, b) for a, b in itertools.pairwise(path)]
            assert sum(length for length, _ in steps) == pytest.approx(oracle(x[None])[0])
            assert all(walls.is_visible(a[None], b[None])[0] for a, (_, b) in zip(path, steps, strict=False))
            assert domain.contains(path).all() and (path[:, 0] < PI).all()


def test_another_goal_is_another_roadmap_of_the_same_samples(case):
    domain, weights, walls, oracle = case
    goal = np.array([-3.1, 0.05])
    expected = roadmap(walls, goal, 60, domain, seed=4, weights=weights)
    x = np.random.default_rng(5).uniform(domain.lo, domain.hi, (50, 2))
    for other in (oracle.with_goal(goal), oracle.with_goal(goal + domain.width * domain.periodic)):
        np.testing.assert_allclose(other(x), expected(x), atol=1e-9)
        np.testing.assert_allclose(other.goal, goal, atol=1e-12)


def test_sampled_motions_are_tested_the_short_way_at_points_of_the_domain():
    walls = walls_of(TORUS)

    def is_free(x):
        assert ((TORUS.lo <= x) & (x < TORUS.hi)).all()
        return ~((walls.lo[:, None] < x) & (x < walls.hi[:, None])).all(axis=2).any(axis=0)

    exact = roadmap(walls, GOAL, 60, TORUS)
    sampled = Roadmap(TORUS, is_free, GOAL, 60, resolution=0.005)
    assert len(exact.graph.edges) <= len(sampled.graph.edges) <= 1.05 * len(exact.graph.edges)
    x = np.random.default_rng(6).uniform(TORUS.lo, TORUS.hi, (50, 2))
    found, expected = sampled(x), exact(x)
    np.testing.assert_array_equal(np.isinf(found), np.isinf(expected))
    free = np.isfinite(expected)
    assert np.abs(found[free] - expected[free]).mean() < 0.02


def test_on_an_empty_torus_distances_are_near_those_around():
    goal = np.array([0.05, 0.95, 0.1])
    domain = Box((0, 0, 0), (1, 1, 1), periodic=(True, True, True))
    oracle = roadmap(NOTHING, goal, 1500, domain)
    x = np.random.default_rng(3).random((200, 3))
    difference = np.abs(x - goal)
    exact = np.linalg.norm(np.minimum(difference, 1 - difference), axis=1)
    assert (oracle(x) - exact).min() >= -1e-12
    assert (oracle(x) - exact).mean() < 0.06


def test_weights_are_scaled_coordinates():
    weights = np.array([3.0, 0.5])
    stretched = Boxes(*(tuple(np.concatenate([lo * weights, hi * weights])) for lo, hi in GAP.each()))
    weighted = roadmap(GAP, num_samples=200, weights=weights)
    scaled = roadmap(stretched, weights * [0.1, 0.1], 200, Box((0, 0), weights))
    assert weighted.radius == pytest.approx(scaled.radius)
    x = np.random.default_rng(0).random((100, 2))
    np.testing.assert_allclose(weighted(x), scaled(x * weights), atol=1e-9)
    coarse = roadmap(GAP, num_samples=200, weights=weights, is_visible=None, resolution=0.02)
    twin = roadmap(stretched, weights * [0.1, 0.1], 200, Box((0, 0), weights), is_visible=None, resolution=0.02)
    np.testing.assert_allclose(coarse(x), twin(x * weights), atol=1e-9)
    np.testing.assert_array_equal(roadmap(GAP, weights=(1, 1))(x), roadmap(GAP)(x))


@pytest.mark.parametrize(
    ("weights", "message"),
    [
        ((1.0, 0.0), r"weights must be positive, one an axis, got \[1.0, 0.0\]"),
        ((1.0, -2.0), "weights must be positive"),
        ((1.0, np.inf), "weights must have finite coordinates"),
        ((1.0,), r"weights must be one point of shape \(2,\)"),
        (2.0, "weights must be one point"),
    ],
)
def test_bad_weights_are_refused(weights, message):
    with pytest.raises(ValueError, match=message):
        roadmap(NOTHING, num_samples=5, weights=weights)


def test_no_cones_of_lengths_that_are_not_euclidean():
    for oracle in (roadmap(NOTHING, weights=(1, 2)), roadmap(NOTHING, GOAL, 50, CYLINDER)):
        with pytest.raises(ValueError, match="Distances to sources are Euclidean"):
            _ = oracle.sources
    with pytest.raises(ValueError, match="use continuous leaves or planes"):
        construct(roadmap(NOTHING, weights=(1, 2)), UNIT, leaf="cone", max_leaves=5)
    assert len(roadmap(NOTHING, num_samples=5, weights=(1, 1)).sources.points) == 6
