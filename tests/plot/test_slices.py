"""Slices of functions of more than two dimensions."""

import math

import numpy as np
import pytest
from matplotlib.collections import LineCollection

from plr_jax import Box, PlanarArm, RectangleRobot, RigidBodySpace, Workspace, metrics, plot
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
