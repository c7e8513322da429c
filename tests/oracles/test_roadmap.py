"""Roadmaps, also on tori and with weights: equal to twins by brute force; and the parts of PRM*."""

import csv
import itertools
import pickle

import networkx as nx
import numpy as np
import pytest
import shapely
from jaxtyping import TypeCheckError
from oracle_helpers import CUT, GAP, NOTHING, UNIT, Boxes, free_points, length, roadmap

from plr_jax import Box, Roadmap, Workspace, scenes
from plr_jax.oracles._roadmap import prm_star_radius

PI = np.pi
TORUS, CYLINDER = (Box((-PI, 0), (PI, 1), periodic=(True, periodic)) for periodic in (True, False))
LINE = Box([0.0], [10.0])
# One wall across the seam, one inside; motions may leave the domain, so every wall has its images.
WALLS = [(PI - 0.3, 0.2, PI + 0.2, 0.6), (-1.0, 0.3, -0.8, 0.9)]
WEIGHTS = (0.3, 2.0)


def images(domain, x):
    """All points a period or two away, the point itself among them."""
    turns = itertools.product(*[range(-2, 3) if periodic else (0,) for periodic in domain.periodic])
    return [x + np.array(turn) * domain.width for turn in turns]


def walls_of(domain):
    return Boxes(*(tuple(i.ravel()) for wall in WALLS for i in images(domain, np.reshape(wall, (2, 2)))))


def apart(domain, weights, a, b):
    """Weighted distance to the nearest image, and that image."""
    return min(
        ((np.linalg.norm(weights * (a - image)), image) for image in images(domain, b)), key=lambda pair: pair[0]
    )


def edges_of(graph):
    return {frozenset(edge) for edge in np.asarray(graph.edges).tolist()}


@pytest.fixture(
    scope="module",
    params=[
        (UNIT, (1, 1), GAP, (0.1, 0.1), 120),
        (UNIT, (1, 1), CUT, (0.1, 0.1), 60),
        (TORUS, (1, 1), walls_of(TORUS), (3.0, 0.9), 60),
        (TORUS, WEIGHTS, walls_of(TORUS), (3.0, 0.9), 60),
        (CYLINDER, WEIGHTS, walls_of(CYLINDER), (3.0, 0.9), 60),
    ],
)
def case(request):
    domain, weights, walls, goal, num_samples = request.param
    return domain, np.array(weights), walls, roadmap(walls, goal, num_samples, domain, seed=4, weights=weights)


def test_brute_force_twin(case):
    domain, weights, walls, oracle = case
    vertices, graph = oracle.graph.vertices, nx.Graph()
    graph.add_nodes_from(range(len(vertices)))
    for i, j in itertools.combinations(range(len(vertices)), 2):
        way, image = apart(domain, weights, vertices[i], vertices[j])
        if way <= oracle.radius and walls.is_visible(vertices[i][None], image[None])[0]:
            graph.add_edge(i, j, weight=way)
    assert edges_of(oracle.graph) == edges_of(graph)
    distances = nx.single_source_dijkstra_path_length(graph, 0)
    np.testing.assert_allclose(oracle.distances, [distances.get(v, np.inf) for v in range(len(vertices))])
    around = np.abs(vertices[oracle.graph.edges[:, 0]] - vertices[oracle.graph.edges[:, 1]]) > domain.width / 2
    assert not domain.is_periodic or (around.sum(axis=0) > 0).tolist() == list(domain.periodic)  # across the seams
    np.testing.assert_allclose(oracle(vertices), oracle.distances, rtol=0, atol=1e-9)
    assert oracle(oracle.goal[None])[0] == 0.0 and oracle.shortest_path(oracle.goal).tolist() == [
        oracle.goal.tolist()
    ]


def test_queries_are_those_by_brute_force_and_paths_as_long_and_free(case):
    domain, weights, walls, oracle = case
    x = np.random.default_rng(1).uniform(domain.lo, domain.hi, (80, 2))
    x[:5, 0] = domain.hi[0]
    found = oracle(x)
    np.testing.assert_array_equal(found, [oracle(point[None])[0] for point in x])
    for turns in (1, -2):  # whole periods away is the same place
        np.testing.assert_allclose(oracle(x + turns * domain.width * domain.periodic), found, atol=1e-9)
    for point, distance in zip(x, found, strict=True):
        path = oracle.shortest_path(point + 3 * domain.width * domain.periodic)
        if not walls.is_free(point[None])[0]:
            assert distance == np.inf and path.shape == (0, 2)
            continue
        reach = [apart(domain, weights, point, vertex) for vertex in oracle.graph.vertices]
        seen = np.array([walls.is_visible(point[None], image[None])[0] for _, image in reach])
        way, radius = np.array([way for way, _ in reach]), oracle.radius
        while not np.any(seen & (way <= radius)):
            radius *= 2
        assert distance == pytest.approx((way + oracle.distances)[seen & (way <= radius)].min(), abs=1e-9)
        assert (len(path) == 0) == np.isinf(distance) and domain.contains(path).all()
        steps = [apart(domain, weights, a, b) for a, b in itertools.pairwise(path)]
        assert np.isinf(distance) or sum(way for way, _ in steps) == pytest.approx(distance, abs=1e-9)
        assert all(walls.is_visible(a[None], b[None])[0] for a, (_, b) in zip(path, steps, strict=False))


def test_another_goal_keeps_samples_and_edges(case):
    domain, weights, walls, oracle = case
    asked, goal = [], domain.lo + domain.width * [0.01, 0.05]

    def is_visible(a, b):
        asked.append(len(a))
        return walls.is_visible(a, b)

    expected, x = roadmap(walls, goal, len(oracle.distances) - 1, domain, seed=4, weights=weights), domain.grid(9)
    moved = roadmap(
        walls, oracle.goal, len(oracle.distances) - 1, domain, seed=4, weights=weights, is_visible=is_visible
    )
    asked.clear()
    other = moved.with_goal(goal + domain.width * domain.periodic)
    assert len(asked) == 1 and asked[0] < 100  # the goal's own edges
    np.testing.assert_allclose(other.goal, goal, atol=1e-12)
    np.testing.assert_array_equal(other.graph.vertices[1:], expected.graph.vertices[1:])
    assert edges_of(other.graph) == edges_of(expected.graph) and other.num_bytes == expected.num_bytes
    np.testing.assert_allclose(other(x.reshape(-1, 2)), expected(x.reshape(-1, 2)), atol=1e-9)
    with pytest.raises(ValueError, match="not free"):
        other.with_goal(walls.lo[0] + 0.02 if domain.is_periodic else (0.5, 0.5))


def test_no_answer_outside_the_domain_or_for_nan():
    oracle = roadmap(NOTHING)
    x = np.array([[1.1, 0.5], [0.5, -1e-9], [np.nan, 0.5], [0.5, np.inf], [1.0, 1.0]])
    np.testing.assert_array_equal(np.isfinite(oracle(x)), [False, False, False, False, True])
    assert oracle.shortest_path(x[2]).shape == (0, 2)
    assert oracle(np.empty((0, 2))).shape == (0,) and oracle(x.tolist()).dtype == np.float64


def test_a_point_that_sees_no_vertex_nearby_looks_farther_and_one_that_sees_none_is_unconnected():
    """In a closet in the corner, open to the right, and in a sealed chamber: too small to be hit by a sample."""
    closet = [(0.0, 0.979, 0.1, 0.98), (0.0, 0.90, 0.02, 0.979)]
    chamber = [
        (0.5, 0.5, 0.52, 0.5001),
        (0.5, 0.5, 0.5001, 0.52),
        (0.5, 0.5199, 0.52, 0.52),
        (0.5199, 0.5, 0.52, 0.52),
    ]
    oracle = roadmap(Boxes(*closet, *chamber), (0.9, 0.99), 60, seed=0)
    x = np.array([[0.001, 0.981], [0.51, 0.51]])
    way = np.linalg.norm(oracle.graph.vertices - x[0], axis=1)
    seen, seen_from_chamber = (oracle.is_visible(np.repeat(p[None], 61, 0), oracle.graph.vertices) for p in x)
    assert not np.any(seen & (way <= oracle.radius)) and seen.any() and not seen_from_chamber.any()
    found, path = oracle(x), oracle.shortest_path(x[0])
    assert np.linalg.norm(x[0] - oracle.goal) <= found[0] < 1.0 and np.isinf(found[1])
    assert length(path) == pytest.approx(found[0]) and oracle.shortest_path(x[1]).shape == (0, 2)


@pytest.mark.parametrize("options", [{}, {"is_visible": None, "resolution": 0.01}])
def test_batches_larger_than_memory_allows_are_cut(monkeypatch, options):
    x = free_points(GAP, 200)
    expected = roadmap(GAP, **options)(x)
    monkeypatch.setattr("plr_jax.oracles._roadmap._BATCH", 64)
    np.testing.assert_array_equal(roadmap(GAP, **options)(x), expected)


def test_seeds_and_bytes():
    first, again, other, more = (
        roadmap(GAP, num_samples=n, seed=s) for n, s in ((50, 1), (50, 1), (50, 2), (2500, 1))
    )
    np.testing.assert_array_equal(first.graph.vertices, again.graph.vertices)
    assert not np.array_equal(first.graph.vertices, other.graph.vertices)
    np.testing.assert_array_equal(more.graph.vertices[:51], first.graph.vertices)
    assert first.num_bytes == 51 * 2 * 8 + len(first.graph.edges) * (2 * 4 + 8)


def test_a_workspace_gives_the_roadmap_of_its_parts():
    workspace = Workspace(((0, 0), (1, 1)), [shapely.box(0.45, 0.0, 0.55, 0.8), shapely.box(0.45, 0.9, 0.55, 1.0)])
    short, x = Roadmap.from_workspace(workspace, (0.1, 0.1), 300, seed=2), free_points(GAP, 200)
    np.testing.assert_allclose(short(x), roadmap(GAP, seed=2)(x), rtol=1e-12)
    assert short.domain == UNIT


def test_paths_are_no_shorter_than_the_published_lengths_of_the_arena(data_dir):
    folder = data_dir / "polyanya_arena"
    workspace = scenes.read_polygons(folder / "arena_polygons.json")
    with (folder / "arena_euclid.csv").open() as file:
        rows = [{key: float(value) for key, value in row.items()} for row in csv.DictReader(file)][-1::-40]
    oracle = Roadmap.from_workspace(workspace, (rows[0]["goal_x"], rows[0]["goal_y"]), 2000)
    for row in rows:
        distance = oracle.with_goal((row["goal_x"], row["goal_y"]))([[row["start_x"], row["start_y"]]])[0]
        assert row["euclid_length"] - 1e-4 <= distance <= 1.1 * row["euclid_length"]


def motion_tests(resolution, is_free=lambda x: np.ones(len(x), bool), domain=LINE, **options):
    """The sampled test of motions of a roadmap, and the list of all configurations that it tests."""
    tested = []

    def recorded(x):
        assert domain.contains(x).all()  # nothing is free outside, where the test is not asked
        tested.append(x)
        return is_free(x)

    oracle = Roadmap(domain, recorded, [2.0], 1, resolution=resolution, **options)
    tested.clear()
    return oracle, tested


@pytest.mark.parametrize(("length", "num_inner"), [(0.0, 0), (0.4, 0), (0.5, 0), (0.6, 1), (2.0, 3), (2.1, 4)])
def test_a_motion_is_tested_evenly_at_steps_of_at_most_the_resolution(length, num_inner):
    oracle, tested = motion_tests(0.5)
    assert oracle.is_visible(np.array([[3.0]]), np.array([[3.0 + length]]))[0]
    inner = np.concatenate([np.empty((0, 1)), *tested])[:, 0]
    np.testing.assert_allclose(np.sort(inner), np.linspace(3.0, 3.0 + length, num_inner + 2)[1:-1])


def test_blocked_motions_are_told_by_few_tests():
    oracle, tested = motion_tests(0.01, lambda x: (x[:, 0] <= 4.0) | (x[:, 0] >= 5.0))
    starts = np.linspace(1.0, 4.0, 100)[:, None]
    assert not oracle.is_visible(starts, 9.0 - starts).any()  # 100 to 700 steps each
    assert sum(map(len, tested)) <= 400


def test_a_query_tests_one_motion_where_the_shortest_is_free():
    asked = []

    def is_visible(a, b):
        asked.append(len(a))
        return np.ones(len(a), bool)

    oracle, x = roadmap(NOTHING, is_visible=is_visible), free_points(NOTHING, 50)
    asked.clear()
    oracle(x)
    assert asked == [50]


def test_a_motion_is_tested_the_short_way_around_at_weighted_steps():
    oracle, tested = motion_tests(0.5, domain=Box([0.0], [10.0], [True]), weights=[0.5])
    assert oracle.is_visible(np.array([[9.0], [1.5]]), np.array([[2.0], [19.5]])).all()
    inner = np.concatenate(tested)[:, 0]
    np.testing.assert_allclose(np.sort(inner), [0, 0.5, 1])  # at 10 and 11; at 0.5 on the way down to -0.5


def test_each_motion_is_judged_by_its_own_configurations():
    oracle, _ = motion_tests(0.1, lambda x: (x[:, 0] <= 4.0) | (x[:, 0] >= 5.0))
    a, b = np.array([[1.0], [1], [7], [4], [6], [3]]), np.array([[3.0], [6], [2], [4], [9], [3.05]])
    np.testing.assert_array_equal(oracle.is_visible(a, b), [True, False, False, True, True, True])
    assert oracle.is_visible(a[:0], b[:0]).shape == (0,)
    np.testing.assert_array_equal(oracle.is_free(np.array([[4.5], [2], [-1], [11], [np.nan]])), [0, 1, 0, 0, 0])


def test_radius_is_that_of_prm_star():
    assert prm_star_radius(1000, 2, 0.5) == pytest.approx(2 * np.sqrt(1.5 * 0.5 / np.pi * np.log(1000) / 1000))
    expected = 2 * np.cbrt(4 / 3 * 2.0 / (4 / 3 * np.pi) * np.log(500) / 500)
    assert prm_star_radius(500, 3, 2.0) == pytest.approx(expected)
    assert roadmap(NOTHING, num_samples=299).radius == pytest.approx(prm_star_radius(300, 2, 1.0))
    assert roadmap(CUT, num_samples=1999).radius == pytest.approx(prm_star_radius(2000, 2, 0.9), rel=0.02)


@pytest.mark.parametrize("tests", [{"is_visible": NOTHING.is_visible}, {"resolution": 0.1}])
def test_a_roadmap_can_be_pickled_if_its_tests_can(tests):
    oracle, x = Roadmap(UNIT, NOTHING.is_free, (0.1, 0.1), 50, **tests), free_points(NOTHING, 40)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(oracle))(x), oracle(x))


SAMPLED = {"is_visible": None, "resolution": 0.1}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"goal": (0.5, 0.5)}, "not free; move it"),
        ({"goal": (1.5, 0.5)}, "outside the domain.*move it inside"),
        ({"goal": (np.nan, 0.5)}, "finite coordinates"),
        ({"goal": (0.1, 0.1, 0.1)}, r"shape \(2,\)"),
        ({"domain": 3.0}, "The domain must be a Box"),
        ({"num_samples": 0}, "num_samples"),
        ({"is_visible": None}, "Give is_visible"),
        ({"resolution": 0.1}, "Give is_visible"),
        ({"is_visible": None, "resolution": 0.0}, "resolution must be a positive finite number"),
        ({"is_visible": lambda a, b: np.ones((len(a), 1), bool)}, "is_visible must give one boolean"),
        ({"is_visible": lambda a, b: np.ma.masked_equal(a[:, 0] < 2, True)}, "is_visible .* some masked"),
        ({"is_free": lambda x: np.all(x < 1e-3, axis=1), "goal": (0, 0), **SAMPLED}, "shrink the domain"),
        ({"is_free": lambda x: np.ones(len(x)), **SAMPLED}, "is_free must give one boolean"),
        ({"weights": (1.0, 0.0)}, r"weights must be positive, one per axis, got \[1.0, 0.0\]"),
        ({"weights": (1.0,)}, r"weights must be one point of shape \(2,\)"),
    ],
)
def test_bad_arguments_are_refused(change, message):
    good = {
        "domain": UNIT,
        "is_free": CUT.is_free,
        "goal": (0.1, 0.1),
        "num_samples": 10,
        "is_visible": CUT.is_visible,
    }
    with pytest.raises((ValueError, TypeCheckError), match=message):
        Roadmap(**good | change)
