"""Pictures of functions of three and more dimensions: slices side by side, in one scale of colors."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.ticker import MaxNLocator

from plr_jax._arrays import as_finite_point, require_integer
from plr_jax._types import ArrayLike, FunctionOfBox
from plr_jax.geometry.box import Box, Slice
from plr_jax.plot._axes import (
    DISTANCE,
    DISTANCE_COLORS,
    DPI,
    FONT_SIZE,
    INK,
    SQUARE,
    WORKSPACE_UNITS,
    axis_label,
    dressed_axes,
    is_angle,
    style_colorbar,
)
from plr_jax.plot._plane import OBSTACLE, add_image, free_points, require_shown
from plr_jax.spaces import FreeTest

_MOST_SLICES = 64
_PANEL, _GAP, _TITLE = 1.9, 0.26, 0.24  # inches: the longer side of a slice, between two of them, and above each
_BEFORE, _AFTER, _BAR = (0.62, 0.5), (1.1, 0.1), 0.14  # around all of them, and the width of the color bar
_LOWEST, _SHORT = 1.6, 2.5  # slices above one another at the least, and a color bar whose name takes two lines
_EDGE = 0.08  # between names of axes and the edge of the picture
_WIDE = 1.6  # how much wider than high slices are together, at best
_NUM_LEVELS = 12


def slices(
    plr: FunctionOfBox,
    axis: int = 2,
    count: int = 6,
    *,
    space: FreeTest | None = None,
    goal: ArrayLike | None = None,
    at: Mapping[int, float | int] | None = None,
    label: str = DISTANCE,
    unit: str = WORKSPACE_UNITS,
    resolution: int = 240,
) -> list[Axes]:
    """Draw slices of a distance function of three or more dimensions, side by side in one scale of colors.

    Args:
        plr: The PLR, or another function of a box.
        axis: The axis across which it is cut, counted from 0.
        count: Number of slices, from 1 to 64, each in the middle of one of as many layers of the domain.
        space: The configuration space: what is not free, or has no answer, is gray.
        goal: A configuration, ``(dim,)``, marked with a star in the nearest slice, which is moved there.
        at: Of a function of more than three dimensions, coordinates by axis, counted from 0, of all axes but ``axis``
            and the two that are drawn, as in ``at={3: 0.5}``.
        label: The quantity, such as "time to the goal".
        unit: Its unit, such as "s".
        resolution: Number of samples along the longer side of a slice.

    Returns:
        The axes of the slices, from the lowest coordinate on, in a figure of their own. Without a space, points
        without an answer stay blank.

    Raises:
        ValueError: If the function has fewer than three dimensions, there is no such axis or another number of
            slices, ``at`` leaves other than two axes or leads outside the domain, the space has another dimension, or
            no point has an answer.
    """
    domain: Box = plr.domain
    if domain.dim < 3:
        raise ValueError(f"Slices need three dimensions or more, got {domain.dim}: plot_contours draws these.")
    require_integer("axis", axis, 0)
    require_integer("count", count, 1)
    if axis >= domain.dim or count > _MOST_SLICES:
        expected = f"axis must be below {domain.dim} and count at most {_MOST_SLICES}"
        raise ValueError(f"{expected}, got {axis} and {count}.")
    at = {} if at is None else at
    if axis in at:
        raise ValueError(f"at must leave out axis {axis}, across which slices are cut, got {dict(at)}.")
    if goal is not None:
        goal = domain.wrapped(as_finite_point("goal", goal, domain.dim))
    places = _places(domain, axis, count, goal)
    cuts = [_cut(plr, Slice.of(domain, {**at, axis: float(place)}), space, resolution) for place in places]
    largest = max((float(cut.values[cut.shows].max()) for cut in cuts if cut.shows.any()), default=None)
    if largest is None:
        raise ValueError("There is nothing to draw: no point has an answer in free space.")
    panels, bar = _panels(cuts[0].shown, count)
    for ax, cut, place in zip(panels, cuts, places, strict=True):
        image = _draw(ax, cut, largest, space is not None)
        ax.set_title(_title(domain, axis, place), fontsize=FONT_SIZE, color=INK, pad=4)
        if goal is not None and place == goal[axis]:
            ax.plot(*goal[list(cut.shown.axes)], "*", ms=10, mfc="white", mec=INK, mew=0.8, zorder=5, clip_on=False)
    between = " " if bar.bbox.height > _SHORT * DPI else "\n"
    style_colorbar(bar.figure.colorbar(image, cax=bar), f"{label}{between}({unit})")
    return panels


@dataclass(frozen=True, eq=False)
class _Cut:
    """A slice, the values at a grid of its points, and which of them are answers in free space."""

    shown: Slice
    points: Float[np.ndarray, "rows columns dim"]
    values: Float[np.ndarray, "rows columns"]
    shows: Bool[np.ndarray, "rows columns"]


def _cut(plr: FunctionOfBox, shown: Slice, space: FreeTest | None, resolution: int) -> _Cut:
    require_shown(shown, None, space)
    points = shown.grid(resolution)
    values = np.asarray(plr(points), dtype=np.float64)
    return _Cut(shown, points, values, np.isfinite(values) & free_points(points, shown, None, space))


def _places(domain: Box, axis: int, count: int, goal: Float[np.ndarray, "dim"] | None) -> Float[np.ndarray, "count"]:
    """Where slices are, evenly spaced but for the one at the goal."""
    places = domain.lo[axis] + domain.width[axis] * (np.arange(count) + 0.5) / count
    if goal is not None:
        places[np.abs(places - goal[axis]).argmin()] = goal[axis]
    return places


def _title(domain: Box, axis: int, place: float) -> str:
    name, _, _ = axis_label(domain, axis).partition(" (")
    return f"{name} = {place:.3g}" + (" rad" if is_angle(domain, axis) else "")


def _panels(shown: Slice, count: int) -> tuple[list[Axes], Axes]:
    """Axes for slices, row by row from the top left, and those of the color bar."""
    domain = shown.domain
    alike = is_angle(domain, shown.axes[0]) == is_angle(domain, shown.axes[1])
    box = shown.box if alike else SQUARE
    size, between = _PANEL * box.width / box.width.max(), np.array([_GAP, _GAP + _TITLE])
    columns = _columns(count, *(size + between))
    rows = -(-count // columns)
    pitch = between + size * max(1.0, _LOWEST / (rows * size[1]))
    inner = pitch * (columns, rows) - _GAP
    total = inner + _BEFORE + _AFTER
    figure = Figure(figsize=tuple(total), dpi=DPI, facecolor="white")
    panels = []
    for i in range(count):
        corner = _BEFORE + pitch * (i % columns, rows - 1 - i // columns)
        ax = dressed_axes(figure.add_axes((*(corner / total), *((pitch - between) / total))), shown)
        ax.set(xlabel="", ylabel="")
        ax.tick_params(labelleft=i % columns == 0, labelbottom=i + columns >= count)
        panels.append(ax)
    middle, edge, font = (_BEFORE + inner / 2) / total, _EDGE / total, {"fontsize": FONT_SIZE, "color": INK}
    figure.text(middle[0], edge[1], axis_label(domain, shown.axes[0]), ha="center", va="bottom", **font)
    figure.text(edge[0], middle[1], axis_label(domain, shown.axes[1]), ha="left", va="center", rotation=90, **font)
    left, bottom = _BEFORE[0] + inner[0] + _GAP / 2, _BEFORE[1]
    height = inner[1] - _TITLE
    return panels, figure.add_axes((left / total[0], bottom / total[1], _BAR / total[0], height / total[1]))


def _columns(count: int, width: float, height: float) -> int:
    """How many columns slices of a size are put into: little stays empty, and the whole is no strip."""
    columns = np.arange(1, count + 1)
    rows = -(-count // columns)
    is_strip = np.abs(np.log2(columns * width / (rows * height * _WIDE)))
    cost = is_strip + (rows * columns - count) / np.sqrt(count)
    return int(columns[cost.argmin()])


def _draw(ax: Axes, cut: _Cut, largest: float, is_known: bool) -> AxesImage:
    """Draw a slice: colors with lines between them, and what is not free or reached, if that is known."""
    values = np.ma.masked_invalid(cut.values)
    image = add_image(ax, cut.shown.box, values, DISTANCE_COLORS, 0.0, largest)
    across: Any = np.moveaxis(cut.points[..., list(cut.shown.axes)], 2, 0)
    if min(cut.values.shape) == 1:
        return image
    if cut.shows.any() and largest > 0:
        levels = MaxNLocator(_NUM_LEVELS).tick_values(0.0, largest)[1:]
        ax.contour(*across, values, levels=levels, colors="white", linewidths=0.7)
    if is_known and not cut.shows.all():
        closed = np.ma.masked_where(cut.shows, np.ones(cut.shows.shape))
        add_image(ax, cut.shown.box, closed, ListedColormap([OBSTACLE]), 0.0, 1.0).set_zorder(3)
        if cut.shows.any():
            ax.contour(*across, ~cut.shows, levels=[0.5], colors=INK, linewidths=0.6, zorder=3.5)
    return image
