"""Slices side by side; ``test_slices.py`` tests what one slice shows."""

import math

import numpy as np
import pytest
from matplotlib.image import imread

from plr_jax import Box, ClearanceSpace, plot


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


def texts(ax):
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
    assert texts(panels[0]) == [f"x ({unit})", f"y ({unit})", f"distance to the goal ({unit})"]


def test_slices_across_another_axis():
    panels = plot.slices(Ramp(), axis=0, count=2, resolution=20, label="time", unit="s")
    assert titles(panels) == ["x = 0.5", "x = 1.5"]
    assert panels[1].images[0].get_array()[0, 0] == pytest.approx(1.5 + 1 + 10, rel=0.1)
    assert tuple(panels[0].images[0].get_extent()) == (0, 1, 0, 4)
    assert texts(panels[0]) == ["y (workspace units)", "z (workspace units)", "time (s)"]


def test_nearest_slice_moves_to_goal():
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
    assert texts(panels[0])[:2] == ["coordinate 4", "angle 5 (rad)"] and panels[0].get_aspect() == "auto"


def test_saved_slices_have_white_rim(tmp_path):
    for count in (1, 4):
        panels = plot.slices(Ramp(), count=count, space=LEFT, goal=(1, 0.5, 2), resolution=30)
        panels[-1].figure.set_dpi(60)
        plot.save(panels[-1], tmp_path / "slices.png")
        picture = imread(tmp_path / "slices.png")[..., :3]
        rim = np.concatenate([picture[[0, -1]].reshape(-1, 3), picture[:, [0, -1]].reshape(-1, 3)])
        assert (rim == 1).all() and picture.std() > 0.1


class Flat(Ramp):
    domain = Box((0, 0), (1, 1))


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize(
    ("plr", "options", "message"),
    [
        (Flat(), {}, "three dimensions or more, got 2: use plot_contours"),
        (Ramp(), {"axis": 3}, "axis must be below 3 and count at most 64, got 3 and 6"),
        (Ramp(), {"axis": -1}, "axis must be an integer >= 0, got -1"),
        (Ramp(), {"count": 0}, "count must be an integer >= 1, got 0"),
        (Ramp(), {"count": 65}, "count at most 64, got 2 and 65"),
        (Ramp(), {"at": {2: 1.0}}, "at must leave out axis 2, along which slices are stacked"),
        (Ramp(), {"at": {0: 1.0}}, "must fix 1 of 3 coordinates, got 2"),
        (Turned(), {}, "must fix 3 of 5 coordinates, got 1"),
        (Turned(), {"at": {0: 5, 1: 0.5}}, "at must lie in Box"),
        (Ramp(), {"goal": (1, 1)}, r"goal must be one point of shape \(3,\)"),
        (Turned(), {"at": {0: 1, 1: 0.5}, "space": LEFT}, "Expected a space of 5 dimensions, got 3"),
        (Ramp(), {"space": ClearanceSpace(Ramp.domain, lambda q: -np.ones(len(q)), 0)}, "There is nothing to draw"),
    ],
)
def test_wrong_arguments_raise(plr, options, message):
    with pytest.raises(ValueError, match=message):
        plot.slices(plr, **options)
