"""Shortest distances, paths and directions: by hand, by a plain visibility graph, and of others; files of oracles."""

import csv
import json
import math
import pickle
import warnings

import networkx as nx
import numpy as np
import pytest
import shapely
from hypothesis import example, given
from hypothesis import strategies as st
from oracle_helpers import WALL, length
from piece_helpers import TEN, WORKSPACES, box, general_workspace, hard_points

from plr_jax import VisibilityGraph, Workspace, scenes

UP, AROUND = math.hypot(2, 4), 2 + 2 * math.hypot(2, 4)  # from (2, 4) to the corner (4, 8) of the wall, and to (8, 4)
DIAGONAL = math.sqrt(0.5)


@pytest.fixture(scope="module")
def wall():
    return VisibilityGraph(WALL, (8, 4))


@pytest.mark.parametrize(
    ("x", "distance", "path", "direction"),
    [
        ((9.0, 1.0), math.hypot(1, 3), [(9, 1), (8, 4)], (-1 / math.hypot(1, 3), 3 / math.hypot(1, 3))),
        ((2, 4), AROUND, [(2, 4), (4, 8), (6, 8), (8, 4)], (2 / UP, 4 / UP)),
        ((6, 4), 2, [(6, 4), (8, 4)], (1, 0)),
        ((4, 4), AROUND - UP + 4, [(4, 4), (4, 8), (6, 8), (8, 4)], (0, 1)),
        ((4, 8), AROUND - UP, [(4, 8), (6, 8), (8, 4)], (1, 0)),
        ((5, 8), AROUND - UP - 1, [(5, 8), (6, 8), (8, 4)], (1, 0)),
        ((6, 8), UP, [(6, 8), (8, 4)], (2 / UP, -4 / UP)),
        ((8, 4), 0, [(8, 4)], (0, 0)),
        ((5, 9), math.hypot(1, 1) + UP, [(5, 9), (6, 8), (8, 4)], (DIAGONAL, -DIAGONAL)),
        *(
            (x, math.inf, np.empty((0, 2)), (np.nan, np.nan))
            for x in ((5, 4), (-1, 4), (np.nan, 1), (np.inf, 1), (1e308, 1))
        ),
    ],
)
def test_straight_around_and_along(wall, x, distance, path, direction):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        np.testing.assert_allclose(wall(np.array([x])), [distance], atol=1e-12)
        np.testing.assert_array_equal(wall.shortest_path(x), path)
        np.testing.assert_allclose(wall.directions([x]), [direction], atol=1e-12)


def test_along_a_wall_nothing_is_seen_past_its_end():
    """On a wall behind a contact, or behind a thin obstacle, of which the view along the wall tells little."""
    contact = Workspace(((0, 0), (1, 1)), [[(0.5161, 1.0), (0.0496, 0.1129), (0.3428, 0.0154)]])
    thin = Workspace(
        ((0, 0), (1, 1)), [box(0.2, 0.3, 0.6, 0.5), [(0.6, 0.5), (0.6001, 0.5), (0.6001, 0.9), (0.6, 0.9)]]
    )
    for workspace, x, y in (
        (contact, (0.516, 1.0), (0.66, 0.999999)),
        (thin, (0.3, 0.5 + 1e-9), (0.8, 0.5 + 1e-9)),
    ):
        there, back = (VisibilityGraph(workspace, goal)([start])[0] for start, goal in ((x, y), (y, x)))
        assert there == pytest.approx(back, abs=1e-7) and there > 1.5 * math.dist(x, y)


@pytest.mark.parametrize(
    ("goal", "from_left", "from_right"),
    [
        ((5, 8), UP + 1, math.hypot(3, 6) + 1),
        ((6 + 1e-10, 4), UP + 2 + 4, math.hypot(3, 2)),
        ((6 - 1e-10, 4), UP + 2 + 4, math.hypot(3, 2)),
        ((6, 8 - 1e-10), UP + 2, math.hypot(3, 6)),
        ((4, 0), math.hypot(2, 4), math.hypot(3, 6) + 2 + 8),
    ],
)
def test_goals_on_walls_and_corners(wall, goal, from_left, from_right):
    x = np.array([[2.0, 4.0], [9.0, 2.0]])
    np.testing.assert_allclose(wall.with_goal(goal)(x), [from_left, from_right], atol=1e-8)
    for start, distance in zip(x, (from_left, from_right), strict=True):
        np.testing.assert_allclose(wall.with_goal(start)(np.array([goal])), [distance], atol=1e-8)


@pytest.mark.parametrize("squeeze", [False, True])
def test_a_point_contact_is_passed_only_by_squeezing(squeeze):
    oracle = VisibilityGraph(Workspace(TEN, [box(3, 3, 5, 5), box(5, 5, 7, 7)], squeeze=squeeze), (1, 1))
    root2, root5 = math.sqrt(2), math.sqrt(5)
    for start, goal, expected in [
        ((4, 6), (5, 5), root2),
        ((6, 4), (5, 5), root2),
        ((4, 6), (6, 4), 2 * root2 if squeeze else 4 + 2 * root2),
        ((5, 6), (5, 4), 2 if squeeze else 5 + root5),
        ((4, 5), (6, 5), 2 if squeeze else 5 + root5),
    ]:
        for a, b in ((start, goal), (goal, start)):
            assert oracle.with_goal(b)(np.array([a]))[0] == pytest.approx(expected, abs=1e-12)
            assert length(oracle.with_goal(b).shortest_path(a)) == pytest.approx(expected, abs=1e-12)


def test_an_obstacle_that_touches_the_bounds_in_a_point_blocks_unless_squeezed():
    tip, start = np.array([[5.0, 0], [3, 10], [7, 10]]), np.array([[1.0, 0.0]])
    assert np.isinf(VisibilityGraph(Workspace(TEN, [tip]), (9, 0))(start)[0])
    assert VisibilityGraph(Workspace(TEN, [tip], squeeze=True), (9, 0))(start)[0] == pytest.approx(8)


def test_the_graph_joins_what_sees_one_another(wall):
    assert wall.graph.vertices[0].tolist() == [8, 4]
    left, right = (wall.graph.vertices.tolist().index(corner) for corner in ([4, 8], [6, 8]))
    assert {frozenset(e) for e in wall.graph.edges.tolist()} == {frozenset({0, right}), frozenset({left, right})}
    np.testing.assert_allclose(wall.distances[[0, right, left]], [0, UP, UP + 2])
    assert repr(wall) == "VisibilityGraph(goal=[8.0, 4.0], 2 corners, 2 edges)"


def test_what_follows_from_the_rest_is_not_pickled():
    oracle, x = VisibilityGraph(WALL, (8, 4)), WALL.sample_free(50, 0)
    expected = oracle(x), oracle.directions(x), oracle.sources.points
    again = pickle.loads(pickle.dumps(oracle))
    assert vars(again).keys() < vars(oracle).keys()
    for found, known in zip((again(x), again.directions(x), again.sources.points), expected, strict=True):
        np.testing.assert_array_equal(found, known)
    np.testing.assert_array_equal(again.graph.edges, oracle.graph.edges)
    np.testing.assert_array_equal(again.graph.vertices, oracle.graph.vertices)


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda wall: wall.with_goal((5, 4)), r"goal \[5.0, 4.0\] lies in an obstacle \(clearance -1\)"),
        (lambda wall: VisibilityGraph(WALL, (11, 4)), "outside the bounds"),
        (lambda wall: VisibilityGraph(WALL, (1, np.nan)), "finite"),
        (lambda wall: VisibilityGraph(WALL, (1, 2, 3)), r"goal must be one point of shape \(2,\), got shape \(3,\)"),
        (lambda wall: wall(np.zeros((5, 3))), r"\(n, 2\), got \(5, 3\)"),
        (lambda wall: wall.directions(np.zeros(2)), r"x must have shape \(n, 2\)"),
        (lambda wall: wall.between(np.zeros((2, 2)), np.zeros((3, 2))), "equally many points, got 2 and 3"),
        (lambda wall: wall.between(np.zeros((1, 2)), np.zeros((1, 3))), r"y must .*\(n, 2\)"),
        (lambda wall: VisibilityGraph(WALL, [(1, 1), (2, 2), (3, 3)]), r"one point .* shape \(3, 2\).*NearestGoal"),
        (lambda wall: wall.shortest_path(np.zeros((1, 2))), r"The start must be one point of shape \(2,\)"),
    ],
)
def test_bad_input_is_refused(wall, call, message):
    with pytest.raises(ValueError, match=message):
        call(wall)


def ring_vertices(free):
    rings = shapely.get_rings(shapely.get_parts(free))
    return np.vstack([shapely.get_coordinates(ring)[:-1] for ring in rings])


def brute_force(workspace, x, goal):
    """Distances by a plain visibility graph: every vertex of free space, every pair tested with Shapely.

    Free space is shrunk by a hair around point contacts unless squeezing is allowed.
    """
    free, hair = shapely.box(0, 0, 10, 10) - shapely.union_all(workspace.obstacles), 1e-7
    if not workspace.squeeze:
        points, count = np.unique(ring_vertices(free), axis=0, return_counts=True)
        free = free - shapely.union_all([shapely.box(*(p - hair), *(p + hair)) for p in points[count > 1]])
    nodes = np.vstack([x, [goal], np.unique(ring_vertices(free), axis=0)])
    i, j = np.triu_indices(len(nodes), 1)
    grown = free.buffer(hair / 10, join_style="mitre")
    shapely.prepare(grown)
    seen = shapely.covers(grown, shapely.linestrings(np.stack([nodes[i], nodes[j]], axis=1)))
    weight = np.linalg.norm(nodes[i] - nodes[j], axis=1)
    graph = nx.Graph()
    graph.add_nodes_from(range(len(nodes)))
    graph.add_weighted_edges_from(zip(i[seen].tolist(), j[seen].tolist(), weight[seen].tolist(), strict=True))
    distance = nx.single_source_dijkstra_path_length(graph, len(x))
    return np.array([distance.get(k, np.inf) for k in range(len(x))])


def lattice_workspace(rng, squeeze=False):
    """Unit cells blocked at random: collinear corners and point contacts everywhere."""
    blocked = np.argwhere(rng.random((10, 10)) < 0.3)
    return Workspace(TEN, [box(x, y, x + 1, y + 1) for x, y in blocked], squeeze=squeeze)


SEEDS, LATTICE = st.integers(0, 100_000), np.argwhere(np.ones((11, 11))).astype(float)


@pytest.mark.parametrize("kind", [general_workspace, lattice_workspace])
@given(SEEDS, st.booleans(), st.booleans())
def test_distances_equal_those_of_a_plain_visibility_graph_and_paths_are_as_long_and_free(kind, seed, squeeze, last):
    """Edges that no shortest path can use are left out of the graph, and only those."""
    rng = np.random.default_rng(seed)
    workspace = kind(rng, squeeze)
    x = rng.permutation(np.vstack([LATTICE[workspace.is_free(LATTICE)], workspace.boundary.vertices]))
    if not squeeze:  # the twin plugs the contacts, so it cannot answer there
        contacts = workspace.boundary.vertices[workspace.boundary.contacts]
        x = x[~(x[:, None] == contacts).all(axis=2).any(axis=1)]
    goal, *x = np.vstack([x[:10], workspace.sample_free(6, seed)])[:: -1 if last else 1]
    oracle, x = VisibilityGraph(workspace, goal), np.array(x)
    found = oracle(x)
    np.testing.assert_allclose(found, brute_force(workspace, x, goal), atol=1e-5)
    np.testing.assert_allclose(oracle(oracle.graph.vertices), oracle.distances, atol=1e-9)
    for start, distance in zip(x, found, strict=True):
        path = oracle.shortest_path(start)
        assert (len(path) == 0) == np.isinf(distance)
        if len(path):
            np.testing.assert_array_equal(path[[0, -1]], [start, goal])
            assert length(path) == pytest.approx(distance, abs=1e-9)
            assert workspace.is_visible(path[:-1], path[1:]).all()


@pytest.mark.full
@given(SEEDS, st.booleans(), st.floats(0, 6.28), st.floats(-3, 3), st.floats(-100, 100))
@example(977, True, 1.0, 0.0, 50.0)
@example(2286, False, 0.3, -1.5, -70.0)
@example(3223, True, 2.0, -0.5, 30.0)
@example(0, True, 4e-12, 1.0, 1.905448586686731)
@example(1, False, 4e-12, 1.0, 1.905448586686731)
def test_distances_survive_turning_scaling_and_shifting(seed, squeeze, turn, log_scale, shift):
    """Off the axes what was collinear, or touched, is so up to rounding only."""
    workspace, scale = lattice_workspace(np.random.default_rng(seed), squeeze), 10**log_scale
    rotation = scale * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])

    def moved(points):
        return np.asarray(points, dtype=float) @ rotation.T + scale * shift

    holes = [moved(shapely.get_coordinates(o)[:-1]) for o in workspace.obstacles]
    other = Workspace.from_polygons([{"outer": moved(box(0, 0, 10, 10)), "holes": holes}], squeeze=squeeze)
    free = workspace.sample_free(10, seed)
    x = np.vstack([LATTICE[workspace.is_free(LATTICE)][seed % 7 :: 7], free])
    goal = x[seed % len(x)]
    expected = VisibilityGraph(workspace, goal)(x)
    np.testing.assert_allclose(VisibilityGraph(other, moved(goal))(moved(x)) / scale, expected, atol=1e-6)
    found = VisibilityGraph(other, moved(free[0]))(moved(free[1:])) / scale
    np.testing.assert_allclose(found, brute_force(workspace, free[1:], free[0]), atol=1e-5)


@pytest.mark.full
@given(SEEDS, st.booleans())
@example(30254, False)  # a free space at which GEOS fails to find triangles to draw points from
def test_contacts_are_reached_from_the_nearest_side(seed, squeeze):
    workspace = lattice_workspace(np.random.default_rng(seed), squeeze)
    contacts = workspace.boundary.vertices[workspace.boundary.contacts]
    goal = workspace.sample_free(1, seed)[0]
    oracle = VisibilityGraph(workspace, goal)
    beside = contacts[:, None] + 1e-4 * np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]])
    around = oracle(beside.reshape(-1, 2)).reshape(-1, 4).min(axis=1)
    np.testing.assert_allclose(oracle(contacts), around, atol=2e-4)
    few = beside[:2].reshape(-1, 2)
    few = few[workspace.is_free(few)]
    np.testing.assert_allclose(oracle(few), brute_force(workspace, few, goal), atol=1e-5)
    for contact, distance in zip(contacts, oracle(contacts), strict=True):
        assert oracle.with_goal(contact)(goal[None])[0] == pytest.approx(distance)


def test_batches_of_any_size_give_the_same_answers():
    workspace = general_workspace(np.random.default_rng(7))
    oracle, x = (
        VisibilityGraph(workspace, workspace.sample_free(1, 0)[0]),
        np.random.default_rng(0).uniform(-1, 11, (5000, 2)),
    )
    whole = oracle(x)
    for num_parts in (97, 2000):
        parts = np.array_split(x, num_parts)
        np.testing.assert_array_equal(whole, np.concatenate([oracle(part) for part in parts]))
    assert not np.isfinite(whole[~workspace.is_free(x)]).any() and oracle(np.empty((0, 2))).shape == (0,)


@pytest.mark.full
@pytest.mark.parametrize("kind", WORKSPACES)
@given(SEEDS, st.booleans())
def test_single_points_have_the_distances_of_batches(kind, seed, squeeze):
    """On walls, sides of triangles and vertices, beside them, outside and nowhere; all to the bit."""
    workspace = kind(np.random.default_rng(seed), squeeze)
    rng = np.random.default_rng(seed)
    x = np.concatenate([hard_points(workspace, seed), rng.uniform(-1, 11, (10, 2)), [[np.nan, 1], [1, np.inf]]])
    oracle, x = VisibilityGraph(workspace, hard_points(workspace, seed + 1)[0]), rng.permutation(x)
    whole = oracle(x)
    np.testing.assert_array_equal([oracle(point[None])[0] for point in x[:60]], whole[:60])
    np.testing.assert_array_equal(np.concatenate([oracle(part) for part in np.array_split(x, 50)]), whole)
    places = [oracle._pairs.locator.place(*point) for point in workspace.sample_free(20, seed).tolist()]
    assert None not in places  # so the comparison is with single points


def test_directions_are_those_of_the_shortest_path_and_of_the_gradient():
    problem = scenes.thin_maze()
    oracle, x = VisibilityGraph(problem.workspace, problem.goals[0]), problem.workspace.sample_free(200, 0)
    directions, step = oracle.directions(x), 1e-6
    for point, direction in zip(x, directions, strict=True):
        path = oracle.shortest_path(point)
        np.testing.assert_allclose(direction, (path[1] - point) / np.linalg.norm(path[1] - point), atol=1e-9)
    inner = problem.workspace.is_visible(x, x + step * directions)
    np.testing.assert_allclose((oracle(x) - oracle(x + step * directions))[inner] / step, 1, atol=1e-6)
    assert inner.mean() > 0.9


@pytest.mark.parametrize("thickness", [0.001, 0.04])
@pytest.mark.parametrize("height", [1e-7, 5e-9, 1e-4])
def test_no_wall_is_seen_through_along_the_wall_it_stands_on(thickness, height):
    """A viewpoint barely above the floor must not see the floor beyond a wall that stands on it."""
    far = 0.5 + thickness
    oracle = VisibilityGraph(Workspace(((0, 0), (1, 1)), [box(0.5, 0, far, 1)]), (0.1, height))
    assert np.isinf(oracle(np.array([[far, 0.0], [far + 1e-4, 0.0], [0.9, 0.5], [1.0, 0.0]]))).all()
    assert np.isfinite(oracle(np.array([[0.5, 0.0], [0.3, 0.0], [0.5, 1.0], [0.0, 0.0]]))).all()
    low = VisibilityGraph(Workspace(((0, 0), (1, 1)), [box(0.5, 0, far, 0.2)]), (0.1, height))
    np.testing.assert_allclose(low(np.array([[far, 0.0]])), np.hypot(0.4, 0.2 - height) + thickness + 0.2, atol=1e-9)


@pytest.mark.parametrize("corner", box(0.754, 0.051, 0.783, 0.197))
@pytest.mark.parametrize("offset", [(1.7, 0.85), (0.85, 1.7), (0.4, 0.3), (3, 0.99), (1.2, 1.01), (1, 0), (0, 2.5)])
def test_goals_beside_the_end_of_a_wall(corner, offset):
    """A few tolerances from a corner outside of its obstacle, a goal is as far as the corner from what sees that."""
    outward = np.sign(corner - [0.7685, 0.124])
    workspace = Workspace(((0, 0), (1, 1)), [box(0.754, 0.051, 0.783, 0.197)])
    x = np.random.default_rng(0).random((2000, 2))
    x = x[((x - corner) * outward > 0).any(axis=1)]  # these see the corner
    for along in ([-1, 1], [1, -1]):  # above the one wall of the corner, or beside the other one
        goal = corner + outward * along * np.array(offset) * workspace.tolerance
        oracle = VisibilityGraph(workspace, goal)
        np.testing.assert_allclose(oracle(x), np.linalg.norm(x - corner, axis=1), atol=1e-8)


@pytest.mark.parametrize("width", [0.5, 1, 1.7, 2, 3, 10])
@pytest.mark.parametrize("turn", [0.0, 0.3])
def test_a_spike_about_a_tolerance_wide_is_a_wall_for_all_that_is_asked(width, turn):
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    thin = width * 4e-9
    spike, foot = np.array([[0.4, -1], [0.4 + thin, -1], [0.4, 0.7]]), box(0.3, -1, 0.5, -0.9)
    workspace = Workspace(((-2, -2), (2, 2)), [spike @ rotation.T, foot @ rotation.T])
    x, y = np.array([[[0.1, 0.3], [0.1, 0.6]], [[0.8, 0.3], [0.8, 0.9]]]) @ rotation.T
    oracle, around = VisibilityGraph(workspace, y[0]), [0.5 + np.hypot(0.4, 0.4), np.hypot(0.7, 0.3)]
    assert workspace.is_visible(x, y).tolist() == [False, True]
    np.testing.assert_allclose(oracle.between(x, y), around, atol=1e-8)
    np.testing.assert_allclose([oracle(x)[0], oracle.with_goal(y[1])(x)[1]], around, atol=1e-8)


def test_polyanya_arena_lengths(data_dir):
    folder = data_dir / "polyanya_arena"
    with open(folder / "arena_euclid.csv") as file:
        columns = ("start_x", "start_y", "goal_x", "goal_y", "euclid_length")
        rows = np.array([[float(row[c]) for c in columns] for row in csv.DictReader(file)])
    assert len(rows) == 160
    oracle = VisibilityGraph(scenes.read_polygons(folder / "arena_polygons.json"), rows[0, 2:4])
    found = [oracle.with_goal(row[2:4])(row[None, :2])[0] for row in rows]
    np.testing.assert_allclose(found, rows[:, 4], rtol=0, atol=1e-4)


@pytest.mark.parametrize("name", ["dao/den009d", "dao/den101d", "dao/den312d", "da2/ht_store"])
def test_movingai_lengths_lie_between_straight_and_octile(data_dir, name):
    scenario = scenes.read_scen(data_dir / "movingai" / f"{name}.map.scen")
    workspace = scenes.read_polygons(data_dir / "movingai" / f"{name}_polygons.json")
    distance = VisibilityGraph(workspace, scenario.goals[0]).between(scenario.starts, scenario.goals)
    assert (distance >= np.linalg.norm(scenario.starts - scenario.goals, axis=1) - 1e-9).all() and len(distance) >= 70
    assert (distance <= scenario.octile_lengths + 2e-3).all()
    # Steps in eight directions are 8.3 % longer at most, but at corners.
    assert distance.sum() > 0.92 * scenario.octile_lengths.sum()


def environment(data, name):
    if name == "grid_env":
        cells = [box(x, y, x + 1, y + 1) for x, y in data["blocked_cells"]]
        return Workspace(((0, 0), (data["size_x"], data["size_y"])), cells, squeeze=True)
    return Workspace.from_polygons([{"outer": data["boundary"], "holes": data["holes"]}], squeeze=True)


@pytest.mark.parametrize("file", ["cases_2.7.2.json", "cases_2021.json"])
@pytest.mark.parametrize("name", ["grid_env", "poly_env", "overlap_poly_env", "separated_env"])
def test_extremitypathfinder_lengths_and_paths(data_dir, file, name):
    data = json.loads((data_dir / "extremitypathfinder" / file).read_text())[name]
    workspace = environment(data, name)
    assert data["cases"]
    for case in data["cases"]:
        oracle = VisibilityGraph(workspace, case["goal"])
        distance, path = oracle(np.array([case["start"]]))[0], oracle.shortest_path(case["start"])
        if case["length"] is None:
            assert np.isinf(distance) and len(path) == 0
            continue
        assert distance == pytest.approx(case["length"], abs=1e-6)
        lines = (shapely.LineString([*each, each[-1]]) for each in (path.tolist(), case["path"]))
        assert shapely.hausdorff_distance(*lines) < 1e-9
    for start, goal in data.get("invalid_queries", []):
        if workspace.is_free(np.array([goal]))[0]:
            assert np.isinf(VisibilityGraph(workspace, goal)(np.array([start]))[0])
        else:
            with pytest.raises(ValueError, match="goal"):
                VisibilityGraph(workspace, goal)
