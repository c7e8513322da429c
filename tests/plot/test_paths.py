import numpy as np
import pytest
import shapely
from matplotlib.collections import PathCollection
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from plr_jax import DiscRobot, PointRobot, Problem, RectangleRobot, Workspace, plot, scenes
from plr_jax.plot._paths import ROBOT_COLORS, ink_on
from plr_jax.robots import footprint

# Robots of every kind and of different sizes; the headings of the round ones mean nothing.
ROBOTS = [DiscRobot(0.5), RectangleRobot(1.0, 0.4), PointRobot()]
STARTS = [(1, 1, 0), (1, 3, 0), (1, 5, 0)]
GOALS = [(8, 1, 0), (8, 3, np.pi / 2), (8, 5, 0)]
TEAM = Problem(Workspace(((0, 0), (10, 6))), ROBOTS, STARTS, GOALS)
# The disc and the point go straight; the rectangle waits during the first half of the time, then goes.
PATH = np.array([STARTS, [(8, 1, 0), (1, 3, 0), (8, 5, 0)], GOALS])
# An L of two motions, of lengths 3 and 1.
CORNER = Problem(Workspace(((0, 0), (5, 3))), [DiscRobot(0.5)], [(1, 1)], [(4, 2)])
CORNER_PATH = np.array([[(1, 1)], [(4, 1)], [(4, 2)]])


def polygons(ax, solid):
    """Robots drawn as solid bodies (True), as faded ones (False), or as dashed outlines (None)."""
    found = [patch for patch in ax.patches if type(patch) is Polygon and patch.get_closed()]
    if solid is None:
        return [p for p in found if not p.get_fill() and p.get_linestyle() not in ("-", "solid")]
    return [p for p in found if p.get_fill() and (p.get_facecolor()[3] == 1.0) == solid]


def centers(patches):
    return np.array([patch.get_xy()[:-1].mean(axis=0) for patch in patches])


def colors(patches):
    return [to_hex(patch.get_edgecolor()).upper() for patch in patches]


def numbers(ax):
    return sorted(text.get_text() for text in ax.texts)


def test_problem_shows_bodies_at_starts_outlines_at_goals():
    ax = plot.plot_problem(TEAM)
    solid, dashed = polygons(ax, True), polygons(ax, None)
    np.testing.assert_allclose(centers(solid), np.array(STARTS)[:, :2], atol=1e-12)
    np.testing.assert_allclose(centers(dashed), np.array(GOALS)[:, :2], atol=1e-12)
    assert colors(dashed) == [to_hex(body.get_facecolor()).upper() for body in solid] == list(ROBOT_COLORS[:3])
    assert numbers(ax) == ["0", "0", "1", "1", "2", "2"]
    disc, rectangle, point = (shapely.Polygon(patch.get_xy()) for patch in dashed)
    assert disc.area == pytest.approx(np.pi * 0.5**2, rel=0.003)
    assert rectangle.equals_exact(footprint(ROBOTS[1], np.array(GOALS[1])), 1e-12)
    assert 0 < point.area < 0.1


def test_bar_and_front_show_heading_of_rectangle():
    turned = Problem(TEAM.workspace, [ROBOTS[1]], [(2, 3, np.pi / 2)], [(8, 3, np.pi)])
    ax = plot.plot_problem(turned)
    (bar,) = ax.lines
    np.testing.assert_allclose(bar.get_xydata().mean(axis=0), [2, 3 + 0.5 - 0.2 * 0.4])
    (front,) = (patch for patch in ax.patches if type(patch) is Polygon and not patch.get_closed())
    np.testing.assert_allclose(front.get_xy().mean(axis=0), [8 - 0.5, 3], atol=1e-12)


@pytest.mark.parametrize("problem", [TEAM, scenes.tangle(), scenes.four_rooms(8)], ids=["team", "tangle", "rooms"])
def test_numbers_are_readable(problem):
    ax = plot.plot_problem(problem)
    ax.figure.canvas.draw()
    to_data = ax.transData.inverted()
    boxes = [shapely.box(*to_data.transform(text.get_window_extent()).ravel()) for text in ax.texts]
    bodies = [shapely.Polygon(patch.get_xy()) for patch in polygons(ax, True)]
    assert len(boxes) == 2 * len(problem.robots)
    for k, box in enumerate(boxes):
        assert not any(box.intersects(other) for other in boxes[k + 1 :])
        assert shapely.box(*ax.viewLim.extents).contains(box)
        # On its own body in an ink that contrasts with it, or on no body at all.
        under = [i for i, body in enumerate(bodies) if body.intersects(box)]
        if under:
            assert [ax.texts[k].get_text()] == [str(i) for i in under]
            assert ax.texts[k].get_color() == ink_on(ROBOT_COLORS[under[0]])


def test_path_is_line_with_body_at_end():
    ax = plot.plot_path(TEAM, PATH)
    lines = [line for line in ax.lines if line.get_color() in ROBOT_COLORS]
    assert [line.get_color() for line in lines] == list(ROBOT_COLORS[:3])
    np.testing.assert_allclose([line.get_xydata() for line in lines], PATH[:, :, :2].swapaxes(0, 1))
    np.testing.assert_allclose(centers(polygons(ax, True)), np.array(GOALS)[:, :2], atol=1e-12)
    assert numbers(ax) == ["0", "1", "2"]


def test_faded_bodies_are_evenly_spaced_in_time():
    ax = plot.plot_path(CORNER, CORNER_PATH, num_poses=4)
    np.testing.assert_allclose(centers(polygons(ax, False)), [(1, 1), (2, 1), (3, 1), (4, 1)], atol=1e-12)
    assert len(polygons(plot.plot_path(CORNER, CORNER_PATH, num_poses=0), False)) == 0
    waits = np.array([[(1, 1), (9, 1)], [(3, 1), (9, 1)], [(3, 1), (9, 3)]])
    pair = Problem(Workspace(((0, 0), (10, 4))), [DiscRobot(0.4)] * 2, waits[0], waits[-1])
    faded = centers(polygons(plot.plot_path(pair, waits, num_poses=4), False))
    np.testing.assert_allclose(faded, [(1, 1), (2, 1), (3, 1), (9, 1), (9, 2)], atol=1e-12)


def test_part_of_path_ends_where_next_begins():
    first = plot.plot_path(CORNER, CORNER_PATH, end=0.5)
    second = plot.plot_path(CORNER, CORNER_PATH, begin=0.5)
    np.testing.assert_allclose(first.lines[0].get_xydata(), [(1, 1), (3, 1)])
    np.testing.assert_allclose(second.lines[0].get_xydata(), [(3, 1), (4, 1), (4, 2)])
    np.testing.assert_allclose(centers(polygons(first, True)), [(3, 1)], atol=1e-12)
    np.testing.assert_allclose(centers(polygons(second, False))[0], (3, 1), atol=1e-12)
    alone = plot.plot_path(CORNER, CORNER_PATH[:1])  # one step: bodies
    np.testing.assert_allclose(centers(polygons(alone, True)), [(1, 1)], atol=1e-12)


def test_samples_are_points_in_colors_of_robots():
    samples = np.array([STARTS, GOALS, PATH[1]])
    ax = plot.plot_samples(TEAM, samples)
    (points,) = (c for c in ax.collections if isinstance(c, PathCollection))
    np.testing.assert_array_equal(points.get_offsets(), samples[..., :2].reshape(-1, 2))
    assert [to_hex(c).upper() for c in points.get_facecolors()] == list(ROBOT_COLORS[:3]) * 3
    assert len(polygons(ax, True)) == len(polygons(ax, None)) == 3
    assert len(plot.plot_samples(TEAM, samples[:0]).collections[0].get_offsets()) == 0


def test_wrong_arguments_raise():
    for arguments, message in [
        ({"path": CORNER_PATH[0]}, "A path must have shape"),
        ({"path": np.full((2, 1, 2), np.nan)}, "A path must be finite, got .* in step 0"),
        ({"begin": 0.5, "end": 0.5}, "begin and end must be shares"),
        ({"begin": -0.1}, "begin and end must be shares"),
        ({"end": float("nan")}, "begin and end must be shares"),
        ({"num_poses": -1}, "num_poses must be at least 0"),
    ]:
        with pytest.raises(ValueError, match=message):
            plot.plot_path(CORNER, **({"path": CORNER_PATH} | arguments))


def test_samples_of_other_shape_raise():
    for samples in (np.zeros((3, 2)), np.zeros((3, 2, 2)), [["a"]]):
        with pytest.raises(ValueError, match=r"Samples must .* \(n, robots, dof\) = \(n, 1, 2\)"):
            plot.plot_samples(CORNER, samples)


def test_pictures_are_drawn_on_given_axes():
    ax = Figure().add_subplot()
    assert plot.plot_problem(TEAM, ax) is ax
    assert plot.plot_path(TEAM, PATH, ax) is ax
    assert plot.plot_samples(TEAM, PATH, ax) is ax
