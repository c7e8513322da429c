"""Pictures of functions of three and more dimensions: slices side by side, in one scale of colors."""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from plr_jax._arrays import as_finite_point, require_integer
from plr_jax._types import ArrayLike, FunctionOfBox
from plr_jax.geometry.box import Box, Slice
from plr_jax.plot._axes import (
    DISTANCE,
    DPI,
    FONT_SIZE,
    INK,
    WORKSPACE_UNITS,
    axis_label,
    is_angle,
    prepare_axes,
    style_colorbar,
)
from plr_jax.plot._plane import draw_values, free_points, mark_goal, require_drawable
from plr_jax.spaces import FreeTest

_MOST_SLICES = 64
# Inches: the longer side of a slice, gaps between slices with their titles, the margin, and the least picture, which
# has room for the name of its color bar.
_PANEL, _GAP, _MARGIN, _LEAST = 1.9, (0.2, 0.35), (1.4, 0.45), (3.2, 2.9)
_WIDE = 1.6  # how much wider than high slices are together
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
    # 1. Where slices are: evenly spaced, but for the one at the goal.
    places = domain.lo[axis] + domain.width[axis] * (np.arange(count) + 0.5) / count
    if goal is not None:
        places[np.abs(places - goal[axis]).argmin()] = goal[axis]

    # 2. Values at a grid of points of each, and which of them are answers in free space.
    cuts = [Slice.of(domain, {**at, axis: float(place)}) for place in places]
    require_drawable(cuts[0], None, space)
    points = [cut.grid(resolution) for cut in cuts]
    values = [np.ma.masked_invalid(np.asarray(plr(each), dtype=np.float64)) for each in points]
    shows = [
        free_points(each, cut, None, space) & ~np.ma.getmaskarray(of)
        for each, cut, of in zip(points, cuts, values, strict=True)
    ]
    largest = max((float(of[seen].max()) for of, seen in zip(values, shows, strict=True) if seen.any()), default=None)
    if largest is None:
        raise ValueError("There is nothing to draw: no point has an answer in free space.")

    # 3. Slices row by row from the top left, the whole about as wide as the page of a paper.
    horizontal, vertical = cuts[0].axes
    same_unit = is_angle(domain, horizontal) == is_angle(domain, vertical)
    width, height = cuts[0].box.width / cuts[0].box.width.max() if same_unit else (1.0, 1.0)
    columns = int(np.clip(np.ceil(np.sqrt(_WIDE * count * height / width)), 1, count))
    rows = -(-count // columns)
    columns = -(-count // rows)  # no more than that takes
    size = np.array([columns, rows]) * (_PANEL * np.array([width, height]) + _GAP) + _MARGIN
    figure = Figure(figsize=tuple(np.maximum(size, _LEAST)), dpi=DPI, facecolor="white", layout="constrained")
    grid = figure.add_gridspec(rows, columns)
    panels = [prepare_axes(figure.add_subplot(grid[divmod(i, columns)]), cuts[0]) for i in range(count)]
    title, _, _ = axis_label(domain, axis).partition(" (")
    for i, (ax, place) in enumerate(zip(panels, places, strict=True)):
        closed = None if space is None else ~shows[i]
        image = draw_values(ax, cuts[i], points[i], values[i], largest, _NUM_LEVELS, closed)
        ax.set(xlabel="", ylabel="")
        ax.tick_params(labelleft=i % columns == 0, labelbottom=i + columns >= count)
        unit_of_axis = " rad" if is_angle(domain, axis) else ""
        ax.set_title(f"{title} = {place:.3g}{unit_of_axis}", fontsize=FONT_SIZE, color=INK, pad=4)
        if goal is not None and place == goal[axis]:
            mark_goal(ax, goal[[horizontal, vertical]])
    figure.supxlabel(axis_label(domain, horizontal), fontsize=FONT_SIZE, color=INK)
    figure.supylabel(axis_label(domain, vertical), fontsize=FONT_SIZE, color=INK)
    style_colorbar(figure.colorbar(image, ax=panels, shrink=0.9, aspect=30), f"{label} ({unit})")
    return panels
