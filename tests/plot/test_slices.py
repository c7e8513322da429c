"""Slices of functions of more than two dimensions, one at a time and side by side."""

import math

import numpy as np
import pytest
from matplotlib.collections import LineCollection
from matplotlib.image import imread

from plr_jax import Box, ClearanceSpace, PlanarArm, RectangleRobot, RigidBodySpace, Workspace, metrics, plot
from plr_jax.geometry.box import Slice

ROOM = Workspace(((0, 0), (4, 2)), [[(1, 0), (2, 0), (2, 1), (1, 1)]])
BODY = RigidBodySpace(ROOM, RectangleRobot(0.5, 0.2))
ARM = PlanarArm(Workspace(((-2, -2), (2, 2)), [[(0.5, 0.5), (1, 0.5), (1, 1), (0.5, 1)]]), [0.8, 0.6], (0, 0))


class Sum:
    """x + 10 y + 100 |theta| in two leaves, below and above theta = 0."""

    domain = BODY.domain
    leaf_boxes = [(0, 0, -math.pi), (0, 0, 0), (2, 0, 0)], [(4, 2, 0), (2, 2, math.pi), (4, 2, math.pi)]

    def __call__(self, x):
        x = np.asarray(x)
        return x[..., 0] + 10 * x[..., 1] + 100 * np.abs(x[..., 2])


class OfAngles:
    domain = ARM.domain

    def __call__(self, x):
        return np.abs(np.asarray(x)).sum(axis=-1)


def labels(ax):
    bars = [child.get_ylabel() for child in ax.child_axes]
    return ax.get_xlabel(), ax.get_ylabel(), *bars


def ticks_by_place(axis):
    texts = [label.get_text() for label in axis.get_ticklabels()]
    return {round(float(place), 6): text for place, text in zip(axis.get_ticklocs(), texts, strict=True)}


def test_slice_at_heading_shows_positions():
    ax = plot.plot_contours(Sum(), at={2: 0.5 - 4 * math.pi}, resolution=40, workspace=ROOM, goal=(3, 1, 0.2))
    values = ax.images[0].get_array()
    assert values.shape == (20, 40)
    assert values[0, 0] == pytest.approx(0.05 + 0.5 + 50)
    assert values[19, 39] == pytest.approx(3.95 + 19.5 + 50)
    assert labels(ax) == tuple(f"{name} (workspace units)" for name in ("x", "y", "distance to the goal"))
    assert ax.get_aspect() == 1.0
    (star,) = (line for line in ax.lines if line.get_marker() == "*")
    np.testing.assert_array_equal(star.get_xydata(), [[3, 1]])


def test_slice_of_position_and_heading():
    ax = plot.plot_contours(Sum(), at={1: 1.5}, resolution=40, label="time to the goal", unit="s")
    values = ax.images[0].get_array()
    assert values.shape == (40, 25)  # a full turn is longer than 4
    assert values[0, 0] == pytest.approx(4 / 25 / 2 + 15 + 100 * (math.pi - math.pi / 40))
    assert labels(ax) == ("x (workspace units)", "heading (rad)", "time to the goal (s)")
    assert ax.get_aspect() == "auto"
    ticks = ticks_by_place(ax.yaxis)
    assert ticks[round(math.pi / 2, 6)] == r"$\pi/2$" and ticks[round(-math.pi, 6)] == r"$-\pi$" and ticks[0] == "0"


def test_blocked_configurations_are_gray():
    ax = plot.plot_contours(OfAngles(), space=ARM, resolution=60)
    values, blocked = ax.images
    lines, outline = (artist for artist in ax.collections if not isinstance(artist, LineCollection))
    assert lines.get_zorder() < blocked.get_zorder() < outline.get_zorder()
    grid = Box([-math.pi] * 2, [math.pi] * 2).grid(60)
    free = ARM.is_free(grid.reshape(-1, 2)).reshape(60, 60)
    np.testing.assert_array_equal(blocked.get_array().mask, free)
    assert values.get_clim() == (0.0, pytest.approx(np.abs(grid).sum(axis=2)[free].max()))
    assert labels(ax)[:2] == ("angle 1 (rad)", "angle 2 (rad)")
    assert ax.get_aspect() == 1.0
    assert set(ticks_by_place(ax.xaxis).values()) >= {r"$-\pi$", r"$-\pi/2$", "0", r"$\pi/2$", r"$\pi$"}


def rectangles_of(ax):
    (lines,) = (c for c in ax.collections if isinstance(c, LineCollection))
    return [(*path.vertices.min(axis=0), *path.vertices.max(axis=0)) for path in lines.get_paths()]


def test_cells_that_slice_meets_are_drawn_once():
    assert rectangles_of(plot.plot_cells(Sum(), at={2: -1.0})) == [(0, 0, 4, 2)]
    assert rectangles_of(plot.plot_cells(Sum(), at={2: 0.0})) == [(0, 0, 2, 2), (2, 0, 4, 2)]
    cells = [(0, -math.pi, 4, 0), (0, 0, 2, math.pi), (2, 0, 4, math.pi)]
    assert rectangles_of(plot.plot_cells(Sum(), at={1: 2.0})) == cells
    # The seam is the lower end.
    assert rectangles_of(plot.plot_cells(Sum(), at={2: math.pi})) == [(0, 0, 4, 2)]


def test_error_grid_of_slice_is_drawn():
    grid = metrics.error_grid(lambda x: Sum()(x) + 0.25, Sum(), BODY, at={2: 0.0}, resolution=40)
    points = Slice.of(BODY.domain, {2: 0.0}).grid(40)
    free = BODY.is_free(points.reshape(-1, 3)).reshape(20, 40)
    np.testing.assert_array_equal(np.isfinite(grid), free)
    np.testing.assert_allclose(grid[free], 0.25)
    ax = plot.plot_error(grid, BODY, at={2: 0.0}, unit="s")
    assert labels(ax) == ("x (workspace units)", "y (workspace units)", "error $|L - V|$ (s)")


def test_wrong_arguments_raise():
    for draw, message in [
        (lambda: plot.plot_contours(Sum(), at={2: 0.0, 1: 1.0}), "at must fix 1 of 3 coordinates, got 2"),
        (lambda: plot.plot_contours(Sum(), at={3: 0.0}), "at must map axes to coordinates"),
        (lambda: plot.plot_contours(Sum(), at={1: 5.0}), "at must lie in Box"),
        (lambda: plot.plot_contours(Sum(), at={2: math.nan}), "finite"),
        (lambda: plot.plot_contours(OfAngles(), space=BODY), "Expected a space of 2 dimensions, got 3"),
        (lambda: plot.plot_contours(Sum(), at={2: 0.0}, space=BODY, workspace=ROOM), "either a workspace or a space"),
        (lambda: plot.plot_contours(Sum(), at={2: 0.0}, goal=(1, 1)), r"goal must be one point of shape \(3,\)"),
        (lambda: plot.plot_cells(Sum(), at={1: 1.0}, workspace=ROOM), "needs axes 0 and 1"),
    ]:
        with pytest.raises(ValueError, match=message):
            draw()


# --- slices side by side ----------------------------------------------------------------------------------


class Ramp:
    """x + 10 y + 100 z over a box of two by one by four; no answer above y = 0.9 where x < 0.5."""

    domain = Box((0, 0, 0), (2, 1, 4))

    def __call__(self, x):
        x = np.asarray(x)
        return np.where((x[..., 0] < 0.5) & (x[..., 1] > 0.9), np.inf, x[..., :3] @ [1, 10, 100])


class Turned(Ramp):
    """The same whatever the fourth and the fifth coordinate are, the latter an angle."""

    domain = Box((0, 0, 0, 0, -math.pi), (2, 1, 4, 1, math.pi), periodic=(False,) * 4 + (True,))


LEFT = ClearanceSpace(Ramp.domain, lambda q: 1.5 - q[:, 0], 1)


def titles(panels):
    return [ax.get_title() for ax in panels]


def stars(panels):
    return [[line.get_xydata().tolist() for line in ax.lines if line.get_marker() == "*"] for ax in panels]


def figure_texts(ax):
    bar = ax.figure.axes[-1]
    return [text.get_text() for text in ax.figure.texts] + [bar.get_ylabel()]


def test_slices_are_evenly_spaced_with_one_color_scale():
    panels = plot.slices(Ramp(), count=4, resolution=20)
    assert titles(panels) == ["z = 0.5", "z = 1.5", "z = 2.5", "z = 3.5"]
    for ax, z in zip(panels, (0.5, 1.5, 2.5, 3.5), strict=True):
        (image,) = ax.images
        assert image.get_array().shape == (10, 20) and image.get_array()[0, 0] == pytest.approx(0.05 + 0.5 + 100 * z)
        assert image.get_array().mask.sum() == 5
        assert image.get_clim() == (0.0, pytest.approx(1.95 + 9.5 + 350))
        assert tuple(image.get_extent()) == (0, 2, 0, 1) and ax.get_aspect() == 1
    unit = "workspace units"
    assert figure_texts(panels[0]) == [f"x ({unit})", f"y ({unit})", f"distance to the goal ({unit})"]


def test_slice_nearest_goal_is_moved_through_goal():
    panels = plot.slices(Ramp(), count=4, goal=(1.5, 0.25, 1.1), resolution=20)
    assert titles(panels) == ["z = 0.5", "z = 1.1", "z = 2.5", "z = 3.5"]
    assert stars(panels) == [[], [[[1.5, 0.25]]], [], []]


def test_blocked_or_unreachable_points_are_gray():
    for ax in plot.slices(Ramp(), count=2, space=LEFT, resolution=20):
        values, closed = ax.images
        expected = np.zeros((10, 20), bool)
        expected[:, 15:] = expected[9, :5] = True
        np.testing.assert_array_equal(~closed.get_array().mask, expected)
        assert values.get_clim() == (0.0, pytest.approx(1.45 + 9.5 + 300))


def test_other_coordinates_of_more_dimensions_are_given():
    panels = plot.slices(Turned(), axis=4, count=2, at={2: 1.0, 3: 0.5}, goal=(1, 0.5, 1, 0.5, 7 * math.pi / 2))
    assert titles(panels) == ["angle 5 = -1.57 rad", "angle 5 = 1.57 rad"]
    assert stars(panels) == [[[[1, 0.5]]], []]
    panels = plot.slices(Turned(), axis=1, count=1, at={0: 1.0, 2: 1.0}, resolution=16)
    assert titles(panels) == ["coordinate 2 = 0.5"]
    assert figure_texts(panels[0])[:2] == ["coordinate 4", "angle 5 (rad)"] and panels[0].get_aspect() == "auto"


def test_saved_slices_have_white_rim(tmp_path):
    panels = plot.slices(Ramp(), count=3, space=LEFT, goal=(1, 0.5, 2), resolution=30)
    panels[-1].figure.set_dpi(60)
    plot.save(panels[-1], tmp_path / "slices.png")
    picture = imread(tmp_path / "slices.png")[..., :3]
    rim = np.concatenate([picture[[0, -1]].reshape(-1, 3), picture[:, [0, -1]].reshape(-1, 3)])
    assert (rim == 1).all() and picture.std() > 0.1


class Flat(Ramp):
    domain = Box((0, 0), (1, 1))


@pytest.mark.usefixtures("unchecked_types")
def test_wrong_arguments_of_slices_raise():
    for plr, options, message in [
        (Flat(), {}, "three dimensions or more, got 2: use plot_contours"),
        (Ramp(), {"axis": 3}, "axis must be below 3 and count at most 64, got 3 and 6"),
        (Ramp(), {"axis": -1}, "axis must be an integer >= 0, got -1"),
        (Ramp(), {"count": 0}, "count must be an integer >= 1, got 0"),
        (Ramp(), {"count": 65}, "count at most 64, got 2 and 65"),
        (Ramp(), {"at": {2: 1.0}}, "at must leave out axis 2, along which slices are stacked"),
        (Turned(), {"at": 0.5}, r"at must map axes to coordinates, such as \{3: 0.5\}, got 0.5"),
        (Turned(), {"at": [0.5]}, r"at must map axes to coordinates, .* got \[0.5\]"),
        (Ramp(), {"at": {0: 1.0}}, "must fix 1 of 3 coordinates, got 2"),
        (Ramp(), {"goal": (1, 1)}, r"goal must be one point of shape \(3,\)"),
        (Turned(), {"at": {0: 1, 1: 0.5}, "space": LEFT}, "Expected a space of 5 dimensions, got 3"),
        (Ramp(), {"space": ClearanceSpace(Ramp.domain, lambda q: -np.ones(len(q)), 0)}, "There is nothing to draw"),
    ]:
        with pytest.raises(ValueError, match=message):
            plot.slices(plr, **options)
