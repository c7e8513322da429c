import subprocess
import sys
from dataclasses import dataclass, field

import matplotlib as mpl
import numpy as np
import pytest
import shapely
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.image import imread
from matplotlib.patches import PathPatch

from plr_jax import Box, Workspace, construct, plot
from plr_jax.plot._plane import _pieces

# A wall across the lower half of the box [0, 2] x [0, 1], and a hole that one cell surrounds.
WORKSPACE = Workspace(
    ((0, 0), (2, 1)), [[(0.9, 0.0), (1.1, 0.0), (1.1, 0.5), (0.9, 0.5)],
                       [(0.3, 0.3), (0.6, 0.3), (0.6, 0.6), (0.3, 0.6)]]
)  # fmt: skip


@dataclass
class ThreeCells:
    """Distance x + 2y on the left half, 3 on the lower right quarter, none on the upper right one."""

    domain: Box = field(default_factory=lambda: Box((0, 0), (2, 1)))
    leaf_boxes = (
        np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 0.5]]),
        np.array([[1.0, 1.0], [2.0, 0.5], [2.0, 1.0]]),
    )

    leaf_of_box = np.arange(3)

    def values_in_leaves(self, leaf, x):
        return np.choose(leaf, [x[:, 0] + 2 * x[:, 1], np.full(len(x), 3.0), np.full(len(x), np.inf)])

    def __call__(self, x):
        left = x[..., 0] + 2 * x[..., 1]
        return np.where(x[..., 0] < 1, left, np.where(x[..., 1] < 0.5, 3.0, np.inf))


def texts(ax):
    """Every label of the picture, color bars included."""
    found = []
    for axes in [*ax.figure.axes, *ax.child_axes]:
        found += [axes.get_title(), axes.get_xlabel(), axes.get_ylabel()]
    return " ".join(found)


def test_cells_are_drawn_as_closed_rectangles():
    ax = plot.plot_cells(ThreeCells())
    (lines,) = (c for c in ax.collections if isinstance(c, LineCollection))
    boxes = [(*path.vertices.min(axis=0), *path.vertices.max(axis=0)) for path in lines.get_paths()]
    assert boxes == [(0, 0, 1, 1), (1, 0, 2, 0.5), (1, 0.5, 2, 1)]
    assert all((path.vertices[0] == path.vertices[-1]).all() for path in lines.get_paths())


def test_contours_show_the_values_where_they_are_and_nothing_elsewhere():
    ax = plot.plot_contours(ThreeCells(), goal=(0.0, 0.0), resolution=20)
    values = ax.images[0].get_array()
    assert values.shape == (10, 20)
    assert values[0, 0] == pytest.approx(0.05 + 2 * 0.05)
    assert values[9, 0] == pytest.approx(0.05 + 2 * 0.95)
    assert values[0, 19] == 3.0
    assert values.mask[5:, 10:].all()
    assert values.mask.sum() == 50
    assert tuple(ax.images[0].get_extent()) == (0, 2, 0, 1)
    (star,) = (line for line in ax.lines if line.get_marker() == "*")
    np.testing.assert_array_equal(star.get_xydata(), [[0, 0]])


def test_periodic_domains_are_drawn_from_end_to_end():
    domain = Box((0, -1), (2, 1), periodic=(False, True))
    plr = construct(lambda x: 2 + x[:, 0] + np.cos(np.pi * x[:, 1]), domain, leaf="continuous", max_leaves=60)
    image = plot.plot_contours(plr, resolution=20).images[0]
    assert tuple(image.get_extent()) == (0, 2, -1, 1)
    exact = 2 + domain.grid(20)[..., 0] + np.cos(np.pi * domain.grid(20)[..., 1])
    np.testing.assert_allclose(image.get_array(), exact, atol=0.1)
    (lines,) = (c for c in plot.plot_cells(plr).collections if isinstance(c, LineCollection))
    ends = [path.vertices[:, 1] for path in lines.get_paths()]
    assert min(map(min, ends)) == -1 and max(map(max, ends)) == 1
    plot.plot_surface(plr).figure.canvas.draw()


def test_values_inside_obstacles_set_no_scale():
    right_blocked = Workspace(((0, 0), (2, 1)), [[(0.5, -1), (3, -1), (3, 2), (0.5, 2)]])
    image = plot.plot_contours(ThreeCells(), workspace=right_blocked, resolution=20).images[0]
    assert image.get_clim() == (0.0, pytest.approx(0.45 + 2 * 0.95))
    with pytest.raises(ValueError, match="no point in free space has"):
        plot.plot_contours(ThreeCells(), workspace=Workspace(((1, 0.5), (2, 1))))


@pytest.mark.parametrize(("squeeze", "is_gray"), [(False, [True, True]), (True, [True, False])])
def test_rooms_without_a_way_to_the_goal_are_gray_and_set_no_scale(squeeze, is_gray):
    # The goal is below a wall, and beside two walls that touch in a point.
    walls = [[(1, 0), (1.2, 0), (1, 1)], [(0, 1), (1, 1), (1, 1.2), (0, 1.2)], [(1, 1), (1.2, 2), (1, 2)]]
    workspace = Workspace(((0, 0), (2, 2)), walls, squeeze=squeeze)
    plr = construct(lambda x: 1 + x[:, 1], workspace.bounds, max_leaves=1)
    axes = plot.plot_contours(plr, workspace=workspace, goal=(0.5, 0.5), resolution=50)
    shapes = [shapely.Polygon(patch.get_path().vertices) for patch in axes.patches]
    above, right = (any(shape.contains(shapely.Point(at)) for shape in shapes) for at in ((0.5, 1.6), (1.6, 0.5)))
    assert [above, right] == is_gray
    assert axes.images[0].get_clim()[1] == pytest.approx(3.0 if squeeze else 2.0, abs=0.05)
    assert not any(shape.contains(shapely.Point(0.4, 0.4)) for shape in shapes)
    every = plot.plot_contours(plr, workspace=workspace, resolution=50)
    assert len(every.patches) == 2, "the walls, of which two are one"
    exits = plot.plot_contours(plr, workspace=workspace, goal=[(0.5, 0.5), (0.5, 1.6), (1.6, 0.5)], resolution=50)
    assert len(exits.patches) == 2 and len(exits.lines[-1].get_xydata()) == 3


def test_obstacles_cover_the_blocked_region_and_only_that():
    ax = plot.plot_workspace(WORKSPACE, unit="m")
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("x (m)", "y (m)")
    patches = [patch for patch in ax.patches if isinstance(patch, PathPatch)]
    assert len(patches) == 2
    blocked = np.array([(1.0, 0.2), (0.45, 0.45)])
    free = np.array([(0.5, 0.2), (1.0, 0.7), (1.5, 0.5)])
    covered = np.any([patch.get_path().contains_points(np.vstack([blocked, free])) for patch in patches], axis=0)
    np.testing.assert_array_equal(covered, [True, True, False, False, False])


def test_an_obstacle_around_a_room_keeps_the_room_open():
    ring = Workspace.from_polygons(
        [
            {"outer": [(0, 0), (9, 0), (9, 9), (0, 9)], "holes": [[(2, 2), (7, 2), (7, 7), (2, 7)]]},
            {"outer": [(4, 4), (5, 4), (5, 5), (4, 5)], "holes": []},
        ]
    )
    (patch,) = plot.plot_workspace(ring).patches
    assert patch.get_path().contains_point((3, 3))
    assert len(patch.get_path().to_polygons()) == 2


def test_error_picture_shows_the_errors_and_marks_missing_answers():
    errors = np.array([[0.0, 0.1, np.nan, 0.3], [np.inf, 0.2, np.nan, 0.0]])
    ax = plot.plot_error(errors, WORKSPACE)
    image, unanswered = ax.images
    np.testing.assert_array_equal(image.get_array().mask, ~np.isfinite(errors))
    smallest, largest = image.get_clim()
    assert largest == pytest.approx(0.3, rel=0.01) and smallest == 1e-3 * largest
    colored = np.where(errors == 0, smallest, errors)
    np.testing.assert_array_equal(image.get_array().filled(9.0)[np.isfinite(errors)], colored[np.isfinite(errors)])
    np.testing.assert_array_equal(unanswered.get_array().mask, ~np.isposinf(errors))
    assert "max 0.3, mean 0.12" in texts(ax)
    assert plot.plot_error(errors, WORKSPACE, largest=0.5).images[0].get_clim() == (0.0005, 0.5)
    assert len(plot.plot_error(np.nan_to_num(errors, posinf=0.0), WORKSPACE).images) == 1


def test_a_picture_of_no_error_at_all_is_refused():
    with pytest.raises(ValueError, match="no error is finite"):
        plot.plot_error(np.full((2, 2), np.nan), WORKSPACE)
    with pytest.raises(ValueError, match=r"errors must be numbers .*, and some are masked"):
        plot.plot_error(np.ma.masked_less([[0.1, 0.2]], 0.15), WORKSPACE)


def test_surface_pieces_lie_in_the_planes_of_their_leaves_cut_to_free_space():
    first, second = _pieces(ThreeCells(), None)
    np.testing.assert_allclose(first, [[0, 0, 0], [1, 0, 1], [1, 1, 3], [0, 1, 2]])
    np.testing.assert_allclose(second[:, 2], 3.0)
    area = sum(shapely.Polygon(piece[:, :2]).area for piece in _pieces(ThreeCells(), WORKSPACE))
    # The left cell less the hole and half the wall; the lower right one less the other half.
    assert area == pytest.approx((1 - 0.09 - 0.05) + (0.5 - 0.05))
    left_blocked = Workspace(((0, 0), (2, 1)), [[(-1, -1), (1, -1), (1, 2), (-1, 2)]])
    (piece,) = _pieces(ThreeCells(), left_blocked)
    np.testing.assert_allclose(sorted(piece[:, 0]), [1, 1, 2, 2])
    for workspace in (None, WORKSPACE):
        (surface,) = plot.plot_surface(ThreeCells(), workspace=workspace).collections
        assert len(surface.get_facecolor()) == len(_pieces(ThreeCells(), workspace))


def test_a_surface_without_answers_is_refused():
    class Empty(ThreeCells):
        def values_in_leaves(self, leaf, x):
            return np.full(len(x), np.inf)

    with pytest.raises(ValueError, match="no leaf in free space has"):
        plot.plot_surface(Empty())


@pytest.mark.parametrize(
    ("draw", "message"),
    [
        (plot.plot_cells, "A picture has two axes, so at must fix 1 of 3 coordinates, got 0"),
        (plot.plot_contours, "A picture has two axes, so at must fix 1 of 3 coordinates, got 0"),
        (plot.plot_surface, "Only a 2-D PLR can be drawn as a surface, got one of 3"),
    ],
)
def test_more_than_two_dimensions_need_a_slice(draw, message):
    with pytest.raises(ValueError, match=message):
        draw(ThreeCells(domain=Box((0, 0, 0), (1, 1, 1))))


@pytest.fixture(scope="module")
def pictures():
    before = dict(mpl.rcParams)
    errors = np.array([[0.0, 0.00123], [0.00254, 0.00377]])
    pictures = {
        "contours": plot.plot_contours(ThreeCells(), workspace=WORKSPACE),
        "cells": plot.plot_cells(ThreeCells(), workspace=WORKSPACE),
        "error": plot.plot_error(errors, WORKSPACE),
        "surface": plot.plot_surface(ThreeCells(), workspace=WORKSPACE),
    }
    assert dict(mpl.rcParams) == before
    return pictures


def test_axes_and_color_bars_are_labeled_with_units(pictures):
    for name, ax in pictures.items():
        assert "x (workspace units)" in texts(ax)
        assert "y (workspace units)" in texts(ax)
        if name != "cells":
            assert "distance to the goal (workspace units)" in texts(ax) or "error" in texts(ax)
        if name != "surface":
            assert ax.get_aspect() == 1.0


def test_pictures_have_an_opaque_page_and_ink_that_contrasts_with_it_and_nothing_is_cut_off(pictures, tmp_path):
    """Legible on a dark page means: the page is ours, not the reader's."""
    for name, ax in pictures.items():
        plot.save(ax, tmp_path / "picture.png")
        pixels = imread(tmp_path / "picture.png")
        assert pixels.shape[2] == 3 or (pixels[..., 3] == 1.0).all()
        assert (pixels[0, 0, :3] == 1.0).all()
        assert pixels[..., :3].min() < 0.25
        page, content = ax.figure.bbox, ax.figure.get_tightbbox().transformed(ax.figure.dpi_scale_trans)
        assert content.x0 >= page.x0 and content.y0 >= page.y0, name
        assert content.x1 <= page.x1 and content.y1 <= page.y1, name


def test_given_axes_are_drawn_on():
    figure = Figure()
    flat, solid = figure.add_subplot(1, 2, 1), figure.add_subplot(1, 2, 2, projection="3d")
    assert plot.plot_error(np.array([[0.1]]), WORKSPACE, flat) is flat
    assert flat.get_xlim() == (0, 2)
    assert "x (workspace units)" in texts(flat)
    assert plot.plot_surface(ThreeCells(), solid) is solid
    assert len(figure.axes) == 3  # the two given and a color bar for the surface
    ax = plot.plot_contours(ThreeCells())
    assert plot.plot_cells(ThreeCells(), ax) is ax
    assert plot.plot_workspace(WORKSPACE, ax) is ax


def test_pyplot_is_not_imported():
    code = "import sys, plr_jax.plot; sys.exit('matplotlib.pyplot' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
