"""Shortest distances, paths and directions, compared with values by hand, plain graphs and published lengths."""

import csv
import itertools
import json
import math

import numpy as np
import pytest
import shapely
from exact_plane import ExactPlane
from grid_helpers import published_queries
from oracle_helpers import WALL, length
from piece_helpers import SEEDS, TEN, box, general_workspace, hard_points, random_workspace
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from plr_jax import VisibilityGraph, Workspace, scenes

UP, AROUND = math.hypot(2, 4), 2 + 2 * math.hypot(2, 4)  # from (2, 4) to the corner (4, 8) of the wall, and to (8, 4)
DIAGONAL = math.sqrt(0.5)
ORACLE = VisibilityGraph(WALL, (8, 4))


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
        *((x, math.inf, np.empty((0, 2)), (np.nan, np.nan)) for x in ((5, 4), (-1, 4), (np.nan, 1), (1e308, 1))),
    ],
)
def test_distances_paths_and_directions_around_a_wall(x, distance, path, direction):
    np.testing.assert_allclose(ORACLE(np.array([x])), [distance], atol=1e-12)
    np.testing.assert_array_equal(ORACLE.shortest_path(x), path)
    np.testing.assert_allclose(ORACLE.directions([x]), [direction], atol=1e-12)


HOLED = shapely.Polygon(box(1, 1, 9, 9), [[(2, 2), (8, 2.5), (8, 8), (2, 7)]])
POSTS = [(4, 4), (6, 4), (5, 6)], [(3, 3), (3.5, 3), (3.3, 7)]
TO_DIFFERENTIATE = {
    "overlaps": general_workspace(np.random.default_rng(0)),
    "overlaps, squeezed": general_workspace(np.random.default_rng(5), squeeze=True),
    "holes": Workspace(TEN, [shapely.MultiPolygon([HOLED, shapely.Polygon(box(8, 9.2, 9, 9.8))]), *POSTS]),
    "free space": Workspace.from_polygons([{"outer": box(0, 0, 10, 10), "holes": [*POSTS, box(3, 5, 7, 9)]}]),
    "inflated": Workspace(TEN, POSTS).inflate(0.5),
}


def with_vertices(workspace, vertices):
    """Return the workspace after all vertices of its obstacles have moved."""
    sizes = shapely.get_num_coordinates(shapely.get_rings(shapely.get_parts(workspace.obstacles))) - 1
    rings = np.concatenate([[*ring, ring[0]] for ring in np.split(vertices, np.cumsum(sizes)[:-1])])
    obstacles = shapely.set_coordinates(np.array(workspace.obstacles), rings)
    return Workspace(workspace.bounds, obstacles, squeeze=workspace.squeeze)


@pytest.mark.parametrize("name", TO_DIFFERENTIATE)
def test_vertex_gradients_equal_central_differences(name):
    """Vertices, goal and points all move at once, in random directions."""
    workspace, rng, h = TO_DIFFERENTIATE[name], np.random.default_rng(1), 3e-5
    goal, *x = workspace.sample_free(80, 3)
    vertices, x, num_same = workspace.obstacle_vertices, np.array(x), 0
    oracle = VisibilityGraph(workspace, goal)
    gradient, directions = oracle.vertex_gradient(x).toarray(), oracle.directions(x)
    for _ in range(3):
        change = rng.uniform(-1, 1, (len(vertices) + 1, 2))
        by = rng.uniform(-1, 1, x.shape)
        moved = [np.vstack([vertices, goal]) + step * change for step in (h, -h)]
        oracles = [VisibilityGraph(with_vertices(workspace, places[:-1]), places[-1]) for places in moved]
        after, before = (each(x + step * by) for each, step in zip(oracles, (h, -h), strict=True))
        turns = [gradient, *(each.vertex_gradient(x).toarray() for each in oracles)]
        is_same = np.isfinite(after) & (np.ptp(np.not_equal(turns, 0).astype(int), axis=0) == 0).all(axis=1)
        expected = (gradient @ change.ravel() - (directions * by).sum(axis=1))[is_same]
        np.testing.assert_allclose((after[is_same] - before[is_same]) / (2 * h), expected, rtol=1e-6, atol=1e-6)
        num_same += is_same.sum()
    assert num_same > 2 * np.isfinite(oracle(x)).sum() and np.count_nonzero(gradient[:, :-2]) > 40


def test_vertex_gradients_beside_corners_and_where_obstacles_touch():
    """A wall of two boxes, of which the upper one has the corners, and a point, goal or vertex at a corner."""
    touching = Workspace(TEN, [box(4, 0, 6, 4), box(4, 4, 6, 8)])
    at_corner, from_left, to_goal = (1.0, 0.0), np.array([2, 4]) / UP, np.array([2, -4]) / UP
    oracle = VisibilityGraph(touching, (8, 4))
    rows = oracle.vertex_gradient([(2, 4), (4, 8), (6, 8 + 1e-10), (8, 4), (5, 2), (np.nan, 1)]).toarray()
    expected = np.zeros((6, 9, 2))
    expected[0, 7], expected[:2, 6] = from_left - at_corner, at_corner - to_goal
    expected[:3, 8] = to_goal
    np.testing.assert_allclose(rows.reshape(6, 9, 2), expected, atol=1e-9)
    oracle = oracle.with_goal((6, 8))
    rows = oracle.vertex_gradient([(2, 4), (8, 4)]).toarray().reshape(2, 9, 2)
    np.testing.assert_allclose(rows[:, 7:], [[from_left - at_corner, at_corner], [(0, 0), -to_goal]], atol=1e-12)
    twice = VisibilityGraph(Workspace(TEN, [box(4, 0, 6, 8), [(4, 8), (5, 7), (5, 8)]]), (8, 4))
    (row,) = twice.vertex_gradient([(2, 4)]).toarray().reshape(1, 8, 2)
    np.testing.assert_allclose([row[[3, 4]].sum(axis=0), row[2]], [from_left - at_corner, at_corner - to_goal])


@pytest.mark.parametrize("seed", SEEDS)
def test_vertex_gradients_add_to_zero(seed):
    """Distances stay the same if the map, the goal and the point move together."""
    workspace = random_workspace(seed)
    oracle, x = VisibilityGraph(workspace, hard_points(workspace, seed + 1)[0]), hard_points(workspace, seed)
    gradient, has_path = oracle.vertex_gradient(x), np.isfinite(oracle(x))
    total = gradient.toarray().reshape(len(x), -1, 2).sum(axis=1)
    np.testing.assert_allclose(total[has_path], oracle.directions(x)[has_path], atol=1e-12)
    assert has_path.any() and not np.diff(gradient.indptr)[~has_path].any()


def test_views_along_a_wall_end_with_the_wall():
    """The goal is hidden by a contact or a thin obstacle, which the view along the wall barely meets."""
    contact = Workspace(((0, 0), (1, 1)), [[(0.5161, 1.0), (0.0496, 0.1129), (0.3428, 0.0154)]])
    post = [(0.6, 0.5), (0.6001, 0.5), (0.6001, 0.9), (0.6, 0.9)]
    thin = Workspace(((0, 0), (1, 1)), [box(0.2, 0.3, 0.6, 0.5), post])
    ends = ((0.516, 1.0), (0.66, 0.999999)), ((0.3, 0.5 + 1e-9), (0.8, 0.5 + 1e-9))
    for workspace, (x, y) in zip((contact, thin), ends, strict=True):
        there, back = (VisibilityGraph(workspace, goal)([start])[0] for start, goal in ((x, y), (y, x)))
        assert there == pytest.approx(back, abs=1e-7) and there > 1.5 * math.dist(x, y)


def test_goals_on_walls_and_corners():
    distances = {
        (5, 8): (UP + 1, math.hypot(3, 6) + 1),
        (6 + 1e-10, 4): (UP + 2 + 4, math.hypot(3, 2)),
        (6 - 1e-10, 4): (UP + 2 + 4, math.hypot(3, 2)),
        (6, 8 - 1e-10): (UP + 2, math.hypot(3, 6)),
        (4, 0): (math.hypot(2, 4), math.hypot(3, 6) + 2 + 8),
    }
    starts = np.array([(2.0, 4.0), (9.0, 2.0)])
    for goal, expected in distances.items():
        np.testing.assert_allclose(ORACLE.with_goal(goal)(starts), expected, atol=1e-8)
        for start, distance in zip(starts, expected, strict=True):
            np.testing.assert_allclose(ORACLE.with_goal(start)(np.array([goal])), [distance], atol=1e-8)


def test_contact_with_the_bounds_blocks_unless_squeezed():
    tip, start = np.array([[5.0, 0], [3, 10], [7, 10]]), np.array([[1.0, 0.0]])
    assert np.isinf(VisibilityGraph(Workspace(TEN, [tip]), (9, 0))(start)[0])
    assert VisibilityGraph(Workspace(TEN, [tip], squeeze=True), (9, 0))(start)[0] == pytest.approx(8)


def test_graph_joins_visible_corners():
    assert ORACLE.graph.vertices[0].tolist() == [8, 4]
    left, right = (ORACLE.graph.vertices.tolist().index(corner) for corner in ([4, 8], [6, 8]))
    assert {frozenset(e) for e in ORACLE.graph.edges.tolist()} == {frozenset({0, right}), frozenset({left, right})}
    np.testing.assert_allclose(ORACLE.distances[[0, right, left]], [0, UP, UP + 2])


LATTICE = np.argwhere(np.ones((11, 11))).astype(float)


def unit_lattice_workspace(rng, squeeze=False, side=6):
    """Return unit cells blocked at random: collinear corners and point contacts everywhere."""
    blocked = np.argwhere(rng.random((side, side)) < 0.3)
    return Workspace(((0, 0), (side, side)), [box(x, y, x + 1, y + 1) for x, y in blocked], squeeze=squeeze)


def plain_distances(workspace, x, goal):
    """Return distances in the complete visibility graph."""
    if not workspace.squeeze:
        return ExactPlane(workspace.boundary.segments).distances(goal, x)
    nodes = np.vstack([goal, x, workspace.boundary.vertices])
    i, j = np.triu_indices(len(nodes), 1)
    i, j = np.compress(workspace.is_visible(nodes[i], nodes[j]), [i, j], axis=1)
    graph = csr_array((np.linalg.norm(nodes[i] - nodes[j], axis=1), (i, j)), shape=[len(nodes)] * 2)
    return dijkstra(graph, directed=False, indices=0)[1 : len(x) + 1]


@pytest.mark.parametrize("kind", [general_workspace, unit_lattice_workspace])
@pytest.mark.parametrize("seed", SEEDS)
def test_distances_equal_a_complete_visibility_graph(kind, seed):
    """The oracle leaves out edges that no shortest path can use, and only those."""
    rng, squeeze = np.random.default_rng(seed), seed % 2 == 1
    workspace = kind(rng, squeeze)
    x = rng.permutation(np.vstack([LATTICE[workspace.is_free(LATTICE)], workspace.boundary.vertices]))
    goal, *x = np.vstack([x[:10], workspace.sample_free(6, seed)])[:: -1 if seed // 2 % 2 else 1]
    oracle, x = VisibilityGraph(workspace, goal), np.array(x)
    found = oracle(x)
    np.testing.assert_allclose(found, plain_distances(workspace, x, goal), atol=1e-7)
    np.testing.assert_allclose(oracle(oracle.graph.vertices), oracle.distances, atol=1e-9)
    for start, distance in zip(x, found, strict=True):
        path = oracle.shortest_path(start)
        assert (len(path) == 0) == np.isinf(distance)
        if len(path):
            np.testing.assert_array_equal(path[[0, -1]], [start, goal])
            assert length(path) == pytest.approx(distance, abs=1e-9)
            assert workspace.is_visible(path[:-1], path[1:]).all()


@pytest.mark.parametrize(
    ("seed", "squeeze", "turn", "scale", "shift"),
    [
        (977, True, 1.0, 1.0, 50.0),
        (2286, False, 0.3, 10**-1.5, -70.0),
        (3223, True, 2.0, 10**-0.5, 30.0),
        (0, True, 4e-12, 10.0, 1.905448586686731),
        (1, False, 4e-12, 10.0, 1.905448586686731),
    ],
)
def test_distances_survive_turning_scaling_and_shifting(seed, squeeze, turn, scale, shift):
    """Off the axes, walls are collinear and touch only up to rounding."""
    workspace = unit_lattice_workspace(np.random.default_rng(seed), squeeze, side=10)
    rotation = scale * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])

    def moved(points):
        return np.asarray(points, dtype=float) @ rotation.T + scale * shift

    holes = [moved(shapely.get_coordinates(o)[:-1]) for o in workspace.obstacles]
    other = Workspace.from_polygons([{"outer": moved(box(0, 0, 10, 10)), "holes": holes}], squeeze=squeeze)
    x = np.vstack([LATTICE[workspace.is_free(LATTICE)], workspace.sample_free(10, seed)])
    for goal in x[::40]:
        expected = VisibilityGraph(workspace, goal)(x)
        np.testing.assert_allclose(VisibilityGraph(other, moved(goal))(moved(x)) / scale, expected, atol=1e-6)


@pytest.mark.parametrize("seed", SEEDS)
def test_single_points_equal_batches_bit_for_bit(seed):
    """Points on walls, sides of triangles and vertices, beside them, outside and not finite."""
    workspace, rng = random_workspace(seed), np.random.default_rng(seed)
    x = np.concatenate([hard_points(workspace, seed), rng.uniform(-1, 11, (10, 2)), [[np.nan, 1], [1, np.inf]]])
    oracle, x = VisibilityGraph(workspace, hard_points(workspace, seed + 1)[0]), rng.permutation(x)
    whole = oracle(x)
    assert not np.isfinite(whole[~workspace.is_free(x)]).any()
    np.testing.assert_array_equal([oracle(point[None])[0] for point in x[:60]], whole[:60])
    np.testing.assert_array_equal(np.concatenate([oracle(part) for part in np.array_split(x, 9)]), whole)
    many = np.tile(x, (1500 // len(x), 1))
    np.testing.assert_array_equal(oracle(many), np.tile(whole, 1500 // len(x)))
    assert oracle(np.empty((0, 2))).shape == (0,)


@pytest.mark.parametrize("thickness", [0.001, 0.04])
@pytest.mark.parametrize("height", [1e-7, 5e-9, 1e-4])
def test_goal_just_above_a_wall_sees_through_no_wall(thickness, height):
    """A goal barely above the floor does not see the floor beyond a wall that stands on the floor."""
    far = 0.5 + thickness
    oracle = VisibilityGraph(Workspace(((0, 0), (1, 1)), [box(0.5, 0, far, 1)]), (0.1, height))
    assert np.isinf(oracle(np.array([[far, 0.0], [far + 1e-4, 0.0], [0.9, 0.5], [1.0, 0.0]]))).all()
    assert np.isfinite(oracle(np.array([[0.5, 0.0], [0.3, 0.0], [0.5, 1.0], [0.0, 0.0]]))).all()
    low = VisibilityGraph(Workspace(((0, 0), (1, 1)), [box(0.5, 0, far, 0.2)]), (0.1, height))
    np.testing.assert_allclose(low(np.array([[far, 0.0]])), np.hypot(0.4, 0.2 - height) + thickness + 0.2, atol=1e-9)


@pytest.mark.parametrize("corner", box(0.754, 0.051, 0.783, 0.197))
def test_goals_beside_a_corner_are_as_far_as_the_corner(corner):
    """A goal lies a few tolerances outside of a corner; points are asked that see the corner."""
    outward = np.sign(corner - [0.7685, 0.124])
    workspace = Workspace(((0, 0), (1, 1)), [box(0.754, 0.051, 0.783, 0.197)])
    x = np.random.default_rng(0).random((100, 2))
    x = x[((x - corner) * outward > 0).any(axis=1)]
    offsets = [(1.7, 0.85), (0.85, 1.7), (0.4, 0.3), (3, 0.99), (1.2, 1.01), (1, 0), (0, 2.5)]
    for offset, along in itertools.product(offsets, ([-1, 1], [1, -1])):  # beside either wall of the corner
        goal = corner + outward * along * np.array(offset) * workspace.tolerance
        oracle = VisibilityGraph(workspace, goal)
        np.testing.assert_allclose(oracle(x), np.linalg.norm(x - corner, axis=1), atol=1e-8)


@pytest.mark.parametrize(("width", "turn"), [(0.5, 0.0), (1, 0.3), (1.7, 0.0), (2, 0.3), (3, 0.3), (10, 0.0)])
def test_spike_about_a_tolerance_wide_blocks_all_queries(width, turn):
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


@pytest.mark.parametrize("name", ["dao/den009d", "da2/ht_store"])
def test_movingai_lengths_lie_between_straight_and_octile(data_dir, name):
    starts, goals, lengths = published_queries(data_dir / "movingai" / f"{name}.map.scen")
    workspace = scenes.read_polygons(data_dir / "movingai" / f"{name}_polygons.json")
    distance = VisibilityGraph(workspace, goals[0]).between(starts, goals)
    assert (distance >= np.linalg.norm(starts - goals, axis=1) - 1e-9).all() and len(distance) >= 70
    assert (distance <= lengths + 2e-3).all()
    # Steps in eight directions are 8.3 % longer at most, but at corners.
    assert distance.sum() > 0.92 * lengths.sum()


@pytest.mark.parametrize("file", ["cases_2.7.2.json", "cases_2021.json"])
@pytest.mark.parametrize("name", ["grid_env", "poly_env", "overlap_poly_env", "separated_env"])
def test_extremitypathfinder_lengths_and_paths(data_dir, file, name):
    data = json.loads((data_dir / "extremitypathfinder" / file).read_text())[name]
    if name == "grid_env":
        cells = [box(x, y, x + 1, y + 1) for x, y in data["blocked_cells"]]
        workspace = Workspace(((0, 0), (data["size_x"], data["size_y"])), cells, squeeze=True)
    else:
        workspace = Workspace.from_polygons([{"outer": data["boundary"], "holes": data["holes"]}], squeeze=True)
    assert data["cases"]
    for start, goal in data.get("invalid_queries", []):
        if workspace.is_free([goal])[0]:
            assert np.isinf(VisibilityGraph(workspace, goal)([start])[0])
        else:
            with pytest.raises(ValueError, match="goal"):
                VisibilityGraph(workspace, goal)
    for case in data["cases"]:
        oracle = VisibilityGraph(workspace, case["goal"])
        distance, path = oracle([case["start"]])[0], oracle.shortest_path(case["start"])
        assert distance == pytest.approx(np.inf if case["length"] is None else case["length"], abs=1e-6)
        if case["length"] is not None:
            lines = (shapely.LineString([*each, each[-1]]) for each in (path.tolist(), case["path"]))
            assert shapely.hausdorff_distance(*lines) < 1e-9
