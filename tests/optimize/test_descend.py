import itertools
import math

import networkx as nx
import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from plr_jax import VisibilityGraph, Workspace, construct, scenes
from plr_jax.geometry.corners import find_corners
from plr_jax.optimize._descend import descend
from plr_jax.optimize._descent import DescentStatus

TEN = ((0, 0), (10, 10))
REACHED, STUCK, NOT_FREE = DescentStatus


def box(x0, y0, x1, y1):
    return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]], dtype=float)


ROOM = Workspace(TEN)
DOOR = Workspace(TEN, [box(4, 0, 6, 7), box(4, 8, 6, 10)])
TRAP = Workspace(TEN, [box(3, 2, 7, 3), box(3, 7, 7, 8), box(6, 2, 7, 8)])  # a U, open to the left
POCKET = Workspace(TEN, [box(1, 1, 4, 2), box(1, 3, 4, 4), box(1, 1, 2, 4), box(3, 1, 4, 4)])


def nothing_known(x):
    return np.zeros(len(x))


def assert_paths_hold(descent, workspace, starts, goal):
    """Ends exact, every leg within free space as Shapely has it, lengths and statuses those of the paths."""
    free = shapely.buffer(workspace.free_space, 2 * workspace.tolerance, join_style="mitre")
    shapely.prepare(free)
    assert len(descent) == len(descent.paths) == len(descent.status) == len(starts)
    for path, start, status, length in zip(descent.paths, starts, descent.status, descent.lengths, strict=True):
        if status != REACHED:
            assert path.shape == (0, 2) and length == math.inf
            continue
        np.testing.assert_array_equal(path[0], start)
        np.testing.assert_array_equal(path[-1], goal)
        legs = np.diff(path, axis=0)
        assert (legs != 0).any(axis=1).all()
        assert length == pytest.approx(np.hypot(*legs.T).sum(), abs=1e-12)
        assert len(legs) == 0 or shapely.covers(free, shapely.linestrings(path))
    np.testing.assert_array_equal(descent.reached, descent.status == REACHED)
    np.testing.assert_array_equal(descent.counts, [len(path) for path in descent.paths])


def descended(field, workspace, starts, goal):
    starts, goal = np.asarray(starts, float), np.asarray(goal, float)
    descent = descend(field, workspace, starts, goal)
    assert_paths_hold(descent, workspace, starts, goal)
    return descent


# --- drawn by hand ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("make_field", [VisibilityGraph, lambda workspace, goal: nothing_known])
def test_straight_lines_in_an_empty_room(make_field):
    goal = np.array([2.0, 3.0])
    starts = ROOM.sample_free(50, 0)
    descent = descended(make_field(ROOM, goal), ROOM, starts, goal)
    assert descent.reached.all() and (descent.counts == 2).all()
    np.testing.assert_allclose(descent.lengths, np.linalg.norm(starts - goal, axis=1), rtol=1e-12)


def test_through_the_door_by_its_corners():
    goal = (8, 2)
    descent = descended(VisibilityGraph(DOOR, goal), DOOR, [(2, 2), (2, 9.5), (8, 9), (4, 7), (6, 7), (5, 7)], goal)
    expected = [
        [(2, 2), (4, 7), (6, 7), (8, 2)],
        [(2, 9.5), (4, 8), (6, 7), (8, 2)],
        [(8, 9), (8, 2)],
        [(4, 7), (6, 7), (8, 2)],
        [(6, 7), (8, 2)],
        [(5, 7), (6, 7), (8, 2)],
    ]
    for path, vertices in zip(descent.paths, expected, strict=True):
        np.testing.assert_array_equal(path, vertices)
    # Shorter paths repeat the goal up to the length of the longest, which lengthens nothing.
    assert descent.vertices.shape == (6, 4, 2)
    np.testing.assert_array_equal(descent.vertices[2, 1:], [goal] * 3)


def test_a_trap_is_left():
    goal = np.array([9.0, 5.0])
    exact = VisibilityGraph(TRAP, goal)
    starts = np.array([[5.0, 5.0], [5.9, 5.0], [5.9, 3.1], [1.0, 5.0]])
    descent = descended(lambda x: np.linalg.norm(x - goal, axis=1), TRAP, starts, goal)
    assert descent.reached.all()
    np.testing.assert_allclose(descent.lengths, exact(starts), rtol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_bumps_do_not_trap(seed):
    """Corners closer than the field's error: it would lead in circles around the ends of the walls."""
    problem = scenes.thin_maze()
    workspace, goal = problem.workspace, problem.goals[0]
    exact, rng = VisibilityGraph(workspace, goal), np.random.default_rng(seed)
    starts = workspace.sample_free(100, seed)
    descent = descended(lambda x: exact(x) + rng.uniform(-0.2, 0.2, len(x)), workspace, starts, goal)
    assert descent.reached.all()
    assert (descent.lengths <= exact(starts) + 2 * 0.2 * 8).all()


def test_statuses():
    goal = (8, 8)
    starts = [(5, 5), (2.5, 2.5), (1.5, 1.5), (-1, 5), (np.nan, 5), (8, 8), (2, 2)]
    descent = descended(VisibilityGraph(POCKET, goal), POCKET, starts, goal)
    expected = [REACHED, STUCK, NOT_FREE, NOT_FREE, NOT_FREE, REACHED, STUCK]
    assert descent.status.tolist() == expected
    assert "goal" in descent.status[0].value and "2 of 7" in repr(descent)
    np.testing.assert_array_equal(descent.paths[5], [(8, 8)])
    assert descent.lengths[5] == 0 and np.isnan(descent.vertices[1]).all()


def test_from_within_a_pocket_to_a_goal_within():
    descent = descended(nothing_known, POCKET, [(2.2, 2.2), (5, 5)], (2.5, 2.5))
    assert descent.status.tolist() == [REACHED, STUCK]


@pytest.mark.parametrize("goal", [(4, 7), (6, 7), (5, 7), (6, 3), (10, 10), (6, 8), (4 + 1e-10, 7)])
def test_goals_on_corners_and_walls(goal):
    starts = np.concatenate([DOOR.sample_free(100, 1), [(4, 7), (6, 8), (0, 0), (10, 10), (4, 3)]])
    exact = VisibilityGraph(DOOR, goal)
    np.testing.assert_allclose(descended(exact, DOOR, starts, goal).lengths, exact(starts), atol=1e-8)


@pytest.mark.parametrize("squeeze", [True, False])
def test_between_obstacles_that_touch(squeeze):
    workspace = Workspace(TEN, [box(0, 4, 5, 5), box(5, 5, 9, 6)], squeeze=squeeze)
    goal, starts = (4, 8), np.array([[7.0, 2.0], [5.5, 4.5], [1.0, 1.0]])
    exact = VisibilityGraph(workspace, goal)
    descent = descended(exact, workspace, starts, goal)
    np.testing.assert_allclose(descent.lengths, exact(starts), rtol=1e-9)
    assert (5.0, 5.0) in set(map(tuple, descent.paths[0].tolist())) or not squeeze


def test_a_field_without_answers_does_no_harm():
    goal, starts = (8, 2), DOOR.sample_free(50, 0)
    blind = descended(lambda x: np.full(len(x), np.inf), DOOR, starts, goal)
    np.testing.assert_allclose(blind.lengths, VisibilityGraph(DOOR, goal)(starts), rtol=1e-12)


def test_a_masked_field_has_no_answer_there():
    starts = DOOR.sample_free(50, 0)
    exact = VisibilityGraph(DOOR, (8, 2))
    masked = descended(lambda x: np.ma.masked_invalid(np.full(len(x), np.nan)), DOOR, starts, (8, 2))
    np.testing.assert_allclose(masked.lengths, exact(starts), rtol=1e-12)


def test_a_field_that_computes_in_place_moves_no_corner():
    def in_place(x):
        x -= (8, 2)
        return np.hypot(*x.T)

    starts = DOOR.sample_free(50, seed=0)
    descent = descend(in_place, DOOR, starts, (8, 2))
    np.testing.assert_array_equal(descent.vertices, descended(nothing_known, DOOR, starts, (8, 2)).vertices)


def test_no_starts_and_no_corners():
    assert len(descended(nothing_known, DOOR, np.empty((0, 2)), (8, 2))) == 0
    assert descend(nothing_known, ROOM, np.empty((0, 2)), (8, 2)).vertices.shape[0] == 0


@pytest.mark.parametrize(
    ("field", "starts", "goal", "message"),
    [
        (nothing_known, np.zeros(2), (8, 2), r"starts must have shape \(n, 2\).*starts\[None\]"),
        (nothing_known, np.zeros((1, 3)), (8, 2), "starts must have shape"),
        (nothing_known, [(1, 1)], (8, 2, 0), "The goal must be one point"),
        (nothing_known, [(1, 1)], (5, 2), "The goal .* not in free space"),
        (lambda x: x, [(1, 1)], (8, 2), "one number a point"),
        (lambda x: np.full(len(x), -np.inf), [(1, 1)], (8, 2), "-inf at .*use inf"),
        (lambda x: np.full(len(x), np.nan), [(1, 1)], (8, 2), "NaN at .*use inf"),
    ],
)
def test_a_callers_mistakes(field, starts, goal, message):
    with pytest.raises(ValueError, match=message):
        descend(field, DOOR, starts, goal)


# --- PLRs ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("scene", [scenes.maze, scenes.thin_maze])
@pytest.mark.parametrize("max_bytes", [1024, 6144])
def test_with_a_plr_as_short_as_can_be(scene, max_bytes):
    problem = scene()
    workspace, goal = problem.workspace, problem.goals[0]
    exact = VisibilityGraph(workspace, goal)
    starts = workspace.sample_free(500, 3)
    plr = construct(exact, workspace.bounds, max_bytes=max_bytes)
    descent = descended(plr, workspace, starts, goal)
    np.testing.assert_allclose(descent.lengths, exact(starts), rtol=1e-9)
    again = descend(plr, workspace, starts, goal)
    np.testing.assert_array_equal(again.vertices, descent.vertices)
    # One start alone goes the same way as in a batch.
    np.testing.assert_array_equal(descend(plr, workspace, starts[7:8], goal).paths[0], descent.paths[7])


def test_arena(data_dir):
    workspace = scenes.read_polygons(data_dir / "polyanya_arena" / "arena_polygons.json")
    goal, starts = np.array([1.0, 11.0]), workspace.sample_free(500, 0)
    exact = VisibilityGraph(workspace, goal)
    descent = descended(construct(exact, workspace.bounds, max_bytes=6144), workspace, starts, goal)
    assert descent.reached.all()
    assert np.median(descent.lengths / exact(starts)) < 1.001


def test_a_good_field_saves_tests(monkeypatch, data_dir):
    workspace = scenes.read_polygons(data_dir / "polyanya_arena" / "arena_polygons.json")
    goal, tests = np.array([1.0, 11.0]), []
    is_visible = Workspace.is_visible

    def counted(self, a, b):
        tests.append(len(a))
        return is_visible(self, a, b)

    monkeypatch.setattr(Workspace, "is_visible", counted)
    descend(nothing_known, workspace, np.empty((0, 2)), goal)
    blind = sum(tests)
    exact = VisibilityGraph(workspace, goal)
    tests.clear()
    descend(exact, workspace, np.empty((0, 2)), goal)
    assert sum(tests) < blind


# --- any obstacles ---------------------------------------------------------------------------------------

HALL = ((-1, -1), (12, 12))
COORDINATE = st.integers(0, 40).map(lambda i: i / 4)


@st.composite
def obstacles(draw):
    """Up to five convex ones."""
    hulls = []
    for _ in range(draw(st.integers(0, 5))):
        x, y = draw(st.integers(0, 32)) / 4, draw(st.integers(0, 32)) / 4
        offsets = draw(st.lists(st.tuples(st.integers(0, 12), st.integers(0, 12)), min_size=3, max_size=6))
        hull = shapely.convex_hull(shapely.multipoints(np.array(offsets) / 4 + (x, y)))
        if hull.geom_type == "Polygon":
            hulls.append(hull)
    return hulls


@settings(max_examples=30, deadline=None)
@given(obstacles(), st.tuples(COORDINATE, COORDINATE), st.integers(0, 2**16), st.floats(0, 3))
def test_every_start_with_a_way_reaches_the_goal(obstacles, goal, seed, error):
    workspace = Workspace(HALL, obstacles)
    goal = np.array(goal)
    if not workspace.is_free(goal[None])[0]:
        return
    exact, rng = VisibilityGraph(workspace, goal), np.random.default_rng(seed)
    starts = np.concatenate([workspace.sample_free(20, seed), rng.uniform(-1.5, 12.5, (5, 2))])
    distance = exact(starts)
    descent = descended(exact, workspace, starts, goal)
    np.testing.assert_allclose(descent.lengths, distance, rtol=1e-7, atol=1e-7)
    bumpy = descended(lambda x: exact(x) + rng.uniform(-error, error, len(x)), workspace, starts, goal)
    np.testing.assert_array_equal(bumpy.reached, np.isfinite(distance))
    assert (bumpy.lengths >= distance - 1e-7).all()


@settings(max_examples=25, deadline=None)
@given(obstacles(), st.tuples(COORDINATE, COORDINATE), st.integers(0, 2**16))
def test_without_a_field_as_short_as_a_complete_visibility_graph_or_longer(obstacles, goal, seed):
    workspace = Workspace(HALL, obstacles)
    goal = np.array(goal)
    if not workspace.is_free(goal[None])[0]:
        return
    starts = workspace.sample_free(3, seed)
    points = np.concatenate([find_corners(workspace)[0].without(goal).with_goal(goal).points, starts])
    pairs = np.array(list(itertools.combinations(range(len(points)), 2)))
    pairs = pairs[workspace.is_visible(points[pairs[:, 0]], points[pairs[:, 1]])]
    graph = nx.Graph()
    graph.add_weighted_edges_from((a, b, math.dist(points[a], points[b])) for a, b in pairs.tolist())
    distance = nx.single_source_dijkstra_path_length(graph, 0) if 0 in graph else {0: 0.0}
    shortest = np.array([distance.get(len(points) - 3 + i, math.inf) for i in range(3)])
    descent = descended(nothing_known, workspace, starts, goal)
    np.testing.assert_array_equal(descent.reached, np.isfinite(shortest))
    assert (descent.lengths >= shortest - 1e-9).all()


def test_many_points_are_searched_in_parts(monkeypatch):
    monkeypatch.setattr("plr_jax.geometry.first_visible._CHUNK", 64)
    goal, starts = (8, 2), DOOR.sample_free(300, 0)
    exact = VisibilityGraph(DOOR, goal)
    np.testing.assert_allclose(descended(exact, DOOR, starts, goal).lengths, exact(starts), rtol=1e-12)


def test_of_a_disc_by_the_inflated_workspace():
    inflated = DOOR.inflate(0.4)
    goal = (8, 2)
    exact = VisibilityGraph(inflated, goal)
    starts = inflated.sample_free(200, 0)
    np.testing.assert_allclose(descended(exact, inflated, starts, goal).lengths, exact(starts), rtol=1e-9)
