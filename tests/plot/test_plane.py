import re
from dataclasses import dataclass, field
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
import shapely
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.image import imread

from plr_jax import Box, Workspace, construct, plot

# A wall across the lower half of the box [0, 2] x [0, 1], and a hole that one cell surrounds.
WALL, HOLE = [(0.9, 0.0), (1.1, 0.0), (1.1, 0.5), (0.9, 0.5)], [(0.3, 0.3), (0.6, 0.3), (0.6, 0.6), (0.3, 0.6)]
WORKSPACE = Workspace(((0, 0), (2, 1)), [WALL, HOLE])


@dataclass
class ThreeCells:
    """Distance x + 2y on the left half, 3 on the lower right quarter, none on the upper right one."""

    domain: Box = field(default_factory=lambda: Box((0, 0), (2, 1)))
    leaf_boxes = [(0, 0), (1, 0), (1, 0.5)], [(1, 1), (2, 0.5), (2, 1)]

    def __call__(self, x):
        left = x[..., 0] + 2 * x[..., 1]
        return np.where(x[..., 0] < 1, left, np.where(x[..., 1] < 0.5, 3.0, np.inf))


def texts(ax):
    """Every label of the picture, color bars included."""
    axes = [*ax.figure.axes, *ax.child_axes]
    return " ".join(text for each in axes for text in (each.get_title(), each.get_xlabel(), each.get_ylabel()))


def cell_outlines(ax):
    (lines,) = (c for c in ax.collections if isinstance(c, LineCollection))
    return [path.vertices for path in lines.get_paths()]


def test_cells_are_closed_rectangles():
    outlines = cell_outlines(plot.plot_cells(ThreeCells()))
    boxes = [(*corners.min(axis=0), *corners.max(axis=0)) for corners in outlines]
    assert boxes == [(0, 0, 1, 1), (1, 0, 2, 0.5), (1, 0.5, 2, 1)]
    assert all((corners[0] == corners[-1]).all() for corners in outlines)


def test_contours_show_finite_values():
    ax = plot.plot_contours(ThreeCells(), goal=(0.0, 0.0), resolution=20)
    values = ax.images[0].get_array()
    assert values.shape == (10, 20)
    np.testing.assert_allclose(values[[0, 9, 0], [0, 0, 19]], [0.05 + 2 * 0.05, 0.05 + 2 * 0.95, 3.0])
    assert values.mask[5:, 10:].all() and values.mask.sum() == 50
    assert tuple(ax.images[0].get_extent()) == (0, 2, 0, 1)
    assert "distance to the goal (workspace units)" in texts(ax)
    (star,) = (line for line in ax.lines if line.get_marker() == "*")
    np.testing.assert_array_equal(star.get_xydata(), [[0, 0]])


def test_periodic_domain_is_drawn_from_end_to_end():
    domain = Box((0, -1), (2, 1), periodic=(False, True))
    plr = construct(lambda x: 2 + x[:, 0] + np.cos(np.pi * x[:, 1]), domain, leaf="continuous", max_leaves=60)
    image = plot.plot_contours(plr, resolution=20).images[0]
    assert tuple(image.get_extent()) == (0, 2, -1, 1)
    exact = 2 + domain.grid(20)[..., 0] + np.cos(np.pi * domain.grid(20)[..., 1])
    np.testing.assert_allclose(image.get_array(), exact, atol=0.1)
    y = np.concatenate(cell_outlines(plot.plot_cells(plr)))[:, 1]
    assert y.min() == -1 and y.max() == 1


def test_values_inside_obstacles_do_not_affect_scale():
    right_blocked = Workspace(((0, 0), (2, 1)), [[(0.5, -1), (3, -1), (3, 2), (0.5, 2)]])
    image = plot.plot_contours(ThreeCells(), workspace=right_blocked, resolution=20).images[0]
    assert image.get_clim() == (0.0, pytest.approx(0.45 + 2 * 0.95))


class Rising(ThreeCells):
    def __call__(self, x):
        return 1 + x[..., 1]


@pytest.mark.parametrize(("squeeze", "is_gray"), [(False, [True, True]), (True, [True, False])])
def test_rooms_cut_off_from_goal_are_gray(squeeze, is_gray):
    # The goal is below a wall, and beside two walls that touch in a point.
    walls = [[(1, 0), (1.2, 0), (1, 1)], [(0, 1), (1, 1), (1, 1.2), (0, 1.2)], [(1, 1), (1.2, 2), (1, 2)]]
    workspace = Workspace(((0, 0), (2, 2)), walls, squeeze=squeeze)

    def draw(**goal):
        return plot.plot_contours(Rising(workspace.bounds), workspace=workspace, resolution=50, **goal)

    axes = draw(goal=(0.5, 0.5))
    shapes = [shapely.Polygon(patch.get_path().vertices) for patch in axes.patches]
    above, right = (any(shape.contains(shapely.Point(at)) for shape in shapes) for at in ((0.5, 1.6), (1.6, 0.5)))
    assert [above, right] == is_gray
    assert axes.images[0].get_clim()[1] == pytest.approx(3.0 if squeeze else 2.0, abs=0.05)
    assert not any(shape.contains(shapely.Point(0.4, 0.4)) for shape in shapes)
    assert len(draw().patches) == 2, "the walls, of which two are one"
    exits = draw(goal=[(0.5, 0.5), (0.5, 1.6), (1.6, 0.5)])
    assert len(exits.patches) == 2 and len(exits.lines[-1].get_xydata()) == 3


def test_values_beyond_bounds_of_workspace_are_covered():
    room = Workspace(((0.5, 0.25), (1.5, 1.0)), [])
    ax = plot.plot_contours(Rising(Box((0, 0), (2, 1))), workspace=room, resolution=40)
    (frame,) = ax.patches
    assert frame.get_path().contains_points([(0.2, 0.5), (1.0, 0.1), (1.8, 0.9)]).all()
    assert not frame.get_path().contains_points([(0.6, 0.3), (1.0, 0.95)]).any()


def test_obstacles_cover_only_blocked_region():
    ax = plot.plot_workspace(WORKSPACE, unit="m")
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("x (m)", "y (m)")
    assert len(ax.patches) == 2
    points = np.array([(1.0, 0.2), (0.45, 0.45), (0.5, 0.2), (1.0, 0.7), (1.5, 0.5)])
    covered = np.any([patch.get_path().contains_points(points) for patch in ax.patches], axis=0)
    np.testing.assert_array_equal(covered, [True, True, False, False, False])


def test_obstacle_around_room_leaves_room_open():
    ring = Workspace.from_polygons([shapely.box(0, 0, 9, 9) - shapely.box(2, 2, 7, 7), shapely.box(4, 4, 5, 5)])
    (patch,) = plot.plot_workspace(ring).patches
    assert patch.get_path().contains_point((3, 3))
    assert len(patch.get_path().to_polygons()) == 2


def test_error_picture_marks_missing_answers():
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


SOLID = ThreeCells(domain=Box((0, 0, 0), (1, 1, 1)))
UNANSWERED_QUARTER = Workspace(((1, 0.5), (2, 1)))


def test_undrawable_input_raises():
    for draw, message in [
        (lambda: plot.plot_cells(SOLID), "A picture has two axes, so at must fix 1 of 3 coordinates, got 0"),
        (lambda: plot.plot_contours(SOLID), "A picture has two axes, so at must fix 1 of 3 coordinates, got 0"),
        (lambda: plot.plot_contours(ThreeCells(), workspace=UNANSWERED_QUARTER), "no point in free space has"),
        (lambda: plot.plot_error(np.full((2, 2), np.nan), WORKSPACE), "no error is finite"),
        (lambda: plot.plot_error(np.ma.masked_less([[0.1]], 1), WORKSPACE), "numbers .*, and some are masked"),
    ]:
        with pytest.raises(ValueError, match=message):
            draw()


def test_saved_pictures_are_opaque_and_complete(tmp_path):
    """The page is white and the ink dark, whatever the theme of the reader, and nothing is cut off."""
    before = dict(mpl.rcParams)
    pictures = {
        "contours": plot.plot_contours(ThreeCells(), workspace=WORKSPACE, resolution=60),
        "cells": plot.plot_cells(ThreeCells(), workspace=WORKSPACE),
        "error": plot.plot_error(np.array([[0.0, 0.00123], [0.00254, 0.00377]]), WORKSPACE),
    }
    assert dict(mpl.rcParams) == before
    for name, ax in pictures.items():
        ax.figure.set_dpi(60)
        plot.save(ax, tmp_path / "picture.png")
        pixels = imread(tmp_path / "picture.png")
        assert (pixels[..., 3:] == 1.0).all() and (pixels[0, 0] == 1.0).all()
        assert pixels[..., :3].min() < 0.25
        page, content = ax.figure.bbox, ax.figure.get_tightbbox().transformed(ax.figure.dpi_scale_trans)
        assert content.x0 >= page.x0 and content.y0 >= page.y0, name
        assert content.x1 <= page.x1 and content.y1 <= page.y1, name


def test_pictures_are_drawn_on_given_axes():
    flat = Figure().add_subplot()
    assert plot.plot_error(np.array([[0.1]]), WORKSPACE, flat) is flat
    assert flat.get_xlim() == (0, 2)
    ax = plot.plot_contours(ThreeCells(), resolution=20)
    assert plot.plot_cells(ThreeCells(), ax) is ax
    assert plot.plot_workspace(WORKSPACE, ax) is ax


def test_no_module_imports_pyplot():
    sources = Path(plot.__file__).parent.parent.rglob("*.py")
    assert not [path for path in sources if re.search(r"^ *(import|from) .*pyplot", path.read_text(), re.MULTILINE)]
