"""Paths to the goal that are read from a file of cones, against exact lengths and Shapely."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from plr_helpers import UNIT, cone

from plr_jax import Box, TraceStatus, VisibilityGraph, Workspace, construct, from_bytes, scenes, trace
from plr_jax.plr._file import DecodedFile, encode
from plr_jax.plr.leaves import leaf_model
from plr_jax.plr.leaves.cone.codec import StoredCones, StoredSources
from plr_jax.plr.tree import Cells, tree_of

GOAL = (0.1, 0.1)
WALL = np.array([(0.4, 0), (0.5, 0), (0.5, 0.7), (0.4, 0.7)])
ROOM = Workspace(UNIT, [WALL])
ARRIVED, CROSSES_WALL = TraceStatus.ARRIVED, TraceStatus.CROSSES_WALL
OUTSIDE, ELSEWHERE = TraceStatus.OUTSIDE, TraceStatus.ENDED_ELSEWHERE


@pytest.fixture(scope="module")
def plr():
    """Cones of a room with one wall, around whose top shortest paths turn."""
    return construct(VisibilityGraph(ROOM, GOAL), UNIT, leaf="cone", max_bytes=300)


def of_sources(code, parent, root_offset=None, source=0):
    """Return a file of one leaf with given sources, in hundredths of the unit square."""
    offsets = np.zeros(len(code)) if root_offset is None else np.array(root_offset)
    sources = StoredSources(0, 0, 100, np.array(code), np.array(parent), offsets)
    stored = StoredCones(sources, np.array([source]))
    return encode(DecodedFile(UNIT, leaf_model("cone"), tree_of(Cells.root(2)), stored))


def test_paths_in_a_room_with_one_wall(plr):
    """A start at a source begins with the leg from there."""
    traces = trace(plr, [[0.9, 0.1], [0.2, 0.5], GOAL])
    assert traces.status.tolist() == [ARRIVED] * 3 and traces.arrived.all() and len(traces) == 3
    assert traces.paths.shape == (3, 4, 2) and traces.counts.tolist() == [4, 2, 1]
    expected = [[[0.9, 0.1], [0.5, 0.7], [0.4, 0.7], GOAL], [[0.2, 0.5], GOAL, GOAL, GOAL], [GOAL] * 4]
    np.testing.assert_array_equal(traces.paths, expected)
    legs = np.hypot(0.4, 0.6) + 0.1 + np.hypot(0.3, 0.6)
    np.testing.assert_allclose(traces.lengths, [legs, np.hypot(0.1, 0.4), 0], rtol=1e-15)
    traces = trace(plr, [[0.5, 0.7], [0.4, 0.7]])
    assert traces.counts.tolist() == [3, 2]
    np.testing.assert_allclose(traces.lengths, np.hypot(0.3, 0.6) + np.array([0.1, 0]), rtol=1e-14)


@pytest.mark.parametrize("workspace", [None, ROOM])
def test_paths_of_batches_equal_paths_of_single_starts(plr, workspace):
    none = trace(plr, np.zeros((0, 2)), workspace)
    assert none.paths.shape == (0, 1, 2) and none.counts.shape == none.lengths.shape == none.status.shape == (0,)
    starts = np.array([[2, 0.5], [np.nan, 0.5], [0.9, 0.1], [0.5, -1e-9], [np.inf, 0], [0.2, 0.5], [0.7, 0.9]])
    many = trace(plr, starts, workspace)
    lost = ~np.isin(np.arange(7), [2, 5, 6])
    assert (many.status == np.where(lost, OUTSIDE, ARRIVED)).all() and not many.counts[lost].any()
    assert np.isnan(many.paths[lost]).all() and np.isinf(many.lengths[lost]).all()
    for row, start in enumerate(starts):
        one = trace(plr, start[None], workspace)
        assert one.status[0] == many.status[row] and one.lengths[0] == many.lengths[row]
        np.testing.assert_array_equal(one.paths[0, : one.counts[0]], many.paths[row, : many.counts[row]])


@pytest.mark.parametrize("scene", ["maze", pytest.param("thin_maze", marks=pytest.mark.full)])
def test_paths_in_mazes_are_shortest_and_cross_no_wall(scene):
    problem = getattr(scenes, scene)()
    workspace, exact = problem.workspace, VisibilityGraph(problem.workspace, problem.goals[0])
    plr, starts = construct(exact, workspace.bounds, leaf="cone", max_bytes=1024), workspace.sample_free(1_500, 0)
    traces, untested = trace(plr, starts, workspace), trace(plr, starts)
    assert traces.arrived.all() and traces.are_tested
    np.testing.assert_array_equal(traces.paths[:, 0], starts)
    np.testing.assert_array_equal(traces.paths[:, -1], np.broadcast_to(exact.goal, starts.shape))
    lengths = shapely.length(shapely.linestrings(traces.paths))
    np.testing.assert_allclose(traces.lengths, lengths, rtol=1e-12)
    core = shapely.union_all(workspace.obstacles).buffer(-1e-6, join_style="mitre")
    crosses, crosses_untested = (shapely.intersects(core, shapely.linestrings(t.paths)) for t in (traces, untested))
    assert not crosses.any() and crosses_untested.mean() < 1e-3
    ratio = lengths / exact(starts)
    assert ratio.min() > 1 - 1e-9 and ratio.mean() < 1.00001 and ratio.max() < 1.001
    same = untested.lengths == traces.lengths
    assert not same[crosses_untested].any() and np.mean(same) > 0.997


def test_legs_through_walls_are_reported(plr):
    """A PLR of another map leads through walls: in a first leg, in one between sources, or nowhere."""
    unaware = construct(VisibilityGraph(Workspace(UNIT), GOAL), UNIT, leaf="cone", max_leaves=1)
    starts = np.array([[0.9, 0.1], [0.2, 0.9], [5, 5]])
    assert trace(unaware, starts, ROOM).status.tolist() == [CROSSES_WALL, ARRIVED, OUTSIDE]
    half = Workspace(UNIT, [[(0.4, 0.3), (0.5, 0.3), (0.5, 0.7), (0.4, 0.7)]])
    shut = Workspace(UNIT, [WALL, [(0.1, 0.3), (0.4, 0.3), (0.4, 0.32), (0.1, 0.32)]])
    found = [trace(plr, [[0.9, 0.1]], workspace).status[0] for workspace in (ROOM, half, shut)]
    assert found == [ARRIVED, ARRIVED, CROSSES_WALL]
    assert trace(plr, [[0.45, 0.2]], ROOM).status.tolist() == [CROSSES_WALL]  # from within a wall


def test_starts_that_do_not_see_their_source_take_another(plr):
    speck = Workspace(UNIT, [WALL, [(0.44, 0.7005), (0.46, 0.7005), (0.46, 0.75), (0.44, 0.75)]])
    straight, around = (trace(plr, [[0.9, 0.72]], workspace).paths for workspace in (ROOM, speck))
    np.testing.assert_array_equal(straight, [[[0.9, 0.72], [0.4, 0.7], GOAL]])
    np.testing.assert_array_equal(around, [[[0.9, 0.72], [0.5, 0.7], [0.4, 0.7], GOAL]])


def test_paths_bend_where_two_walls_touch():
    """Two wedges touch at a point, above which the angle of free space exceeds 180 degrees."""
    bounds = np.array([(41.923294, 43.768486), (62.551895, 65.369339)])
    contact = np.random.default_rng(0).uniform((49, 55), (53, 57))

    def at(degrees, distance):
        return contact + distance * np.stack([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))], axis=-1)

    wedges = [[contact, *at(np.array(sides), 5.0)] for sides in ((200, 220), (300, 340))]
    room = Workspace(bounds, wedges)
    plr = construct(VisibilityGraph(room, at(345, 3.0)), room.bounds, leaf="cone", max_bytes=250)
    above_left_wedge, below_contact = at(np.array([195, 260]), 3.0)[:, None]
    along = trace(plr, above_left_wedge, room)
    assert along.arrived.all() and along.lengths[0] == pytest.approx(6, abs=1e-6)
    walls = shapely.union_all(list(map(shapely.Polygon, wedges))).buffer(-2e-6)
    assert not walls.intersects(shapely.LineString(along.paths[0]))
    # A wall of 2e-4 across the contact is crossed, and so is the contact on the straight way to it.
    wall = np.array([(-1, -1e-4), (1, -1e-4), (1, 1e-4), (-1, 1e-4)])
    shut = Workspace(bounds, [*wedges, contact + wall])
    assert trace(plr, above_left_wedge, shut).status.tolist() == [CROSSES_WALL]
    through = construct(VisibilityGraph(Workspace(bounds), at(80, 3.0)), room.bounds, leaf="cone", max_leaves=1)
    assert trace(through, below_contact, room).status.tolist() == [CROSSES_WALL]


def test_paths_end_at_roots_that_are_not_the_goal():
    plr = from_bytes(of_sources([[20, 20], [50, 50]], [0, 0], [3.0, 0.0], source=1))
    traces = trace(plr, [[0.9, 0.9], [0.2, 0.2]])
    assert traces.status.tolist() == [ELSEWHERE] * 2 and not traces.arrived.any()
    np.testing.assert_array_equal(traces.paths[0], [[0.9, 0.9], [0.5, 0.5], [0.2, 0.2]])
    np.testing.assert_allclose(traces.lengths[0], np.sqrt(2) * 0.7)
    np.testing.assert_allclose(plr([0.9, 0.9]), 3 + np.sqrt(2) * 0.7, rtol=1e-6)
    for parent in ([1, 0, 2], [1, 2, 0]):
        with pytest.raises(ValueError, match="its sources follow one another in a circle"):
            from_bytes(of_sources([[20, 20], [50, 50], [70, 10]], parent))


def test_paths_in_a_workspace_prefer_sources_that_lead_to_the_goal():
    plr, start = from_bytes(of_sources([[10, 10], [50, 50]], [0, 1], [0.0, 0.6], source=1)), [(0.9, 0.9)]
    assert trace(plr, start).status.tolist() == [ELSEWHERE]
    traces = trace(plr, start, Workspace(UNIT))
    assert traces.arrived.all() and traces.paths.tolist() == [[[0.9, 0.9], [0.1, 0.1]]]
    hidden_goal = Workspace(UNIT, [[(0.2, 0), (0.3, 0), (0.3, 0.25), (0, 0.25), (0, 0.2), (0.2, 0.2)]])
    assert trace(plr, start, hidden_goal).status.tolist() == [ELSEWHERE]


def test_waypoints_in_numpy_and_jax(plr):
    assert isinstance(plr.waypoint([0.9, 0.1]), jax.Array)
    x = np.append(ROOM.sample_free(198, seed=2), [[2, 2], [np.nan, 0.5]], axis=0)
    expected = np.asarray(plr.waypoint(x))
    np.testing.assert_allclose(expected[:-2], trace(plr, x[:-2]).paths[:, 1], atol=1e-6)
    assert np.isnan(expected[-2:]).all() and plr.waypoint(np.zeros((0, 2))).shape == (0, 2)
    np.testing.assert_array_equal(plr.waypoint(x.reshape(4, 50, 2)), expected.reshape(4, 50, 2))
    compiled = jax.jit(lambda plr, y: (plr.waypoint(y), jax.vmap(plr.waypoint)(y), jax.jacobian(plr.waypoint)(y[0])))
    batch, single, slope = compiled(plr, jnp.asarray(x))
    np.testing.assert_array_equal([batch, single], [expected] * 2)
    assert not slope.any()
    with jax.enable_x64(True):
        np.testing.assert_allclose(plr.waypoint(np.asarray([0.9, 0.1])), [0.5, 0.7], rtol=1e-7)


def test_paths_far_from_the_origin():
    shift = np.array([5e5, 4e6])
    exact = VisibilityGraph(Workspace((shift, shift + 1), [WALL + shift]), GOAL + shift)
    plr = construct(exact, Box(shift, shift + 1), leaf="cone", max_bytes=200)
    traces = trace(plr, np.array([[0.9, 0.1]]) + shift)
    np.testing.assert_allclose(traces.paths[0] - shift, [[0.9, 0.1], [0.5, 0.7], [0.4, 0.7], GOAL], atol=1e-7)


def of_model(leaf):
    return construct(cone, UNIT, leaf=leaf, max_leaves=4)


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda plr: trace(cone, [[0, 0]]), "plr must be a PLR of cones, got <function cone"),
        (lambda plr: trace(plr, [0.5, 0.5]), r"starts must have shape \(n, 2\), got \(2,\). Use starts\[None\]"),
        (lambda plr: trace(plr, [[0.5, 0.5]], UNIT), "workspace must be a Workspace or None, got Box"),
        (lambda plr: plr.waypoint([0.5, 0.5, 0.5]), r"Points must have shape \(..., 2\), got \(3,\)"),
        (lambda plr: plr.waypoint("x"), "Points must be real numbers"),
        (lambda _: of_model("plane").waypoint([0.5, 0.5]), "plane' have no sources"),
        (lambda _: trace(of_model("continuous"), [[0.5, 0.5]]), "continuous' have no sources"),
    ],
)
def test_wrong_arguments_raise(plr, call, message):
    with pytest.raises(ValueError, match=message):
        call(plr)
