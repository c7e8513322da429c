"""Draw a function of three or more dimensions as slices, side by side with one color scale: :func:`slices`."""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from plr_jax._arrays import as_finite_point, require_integer, shortened
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
from plr_jax.plot._plane import draw_values, free_points, mark_goals, require_drawable
from plr_jax.spaces import FreeTest

_MOST_SLICES = 64
_NUM_LEVELS = 12  # largest number of contour levels
_ASPECT = 1.6  # width of all slices together, divided by their height
# Inches, along x and y.
_PANEL = 1.9  # the longer side of a slice
_GAP = (0.2, 0.35)  # between slices, with room for titles
_MARGIN = (1.4, 0.45)
_LEAST = (3.2, 2.9)  # the smallest figure, with room for the label of the color bar


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
    """Draw slices of a function of three or more dimensions, side by side with one color scale.

    The result is the list of the slices' axes, all in a new figure, by ascending coordinate along ``axis``. Errors
    are raised as by :func:`plot_contours`.

    Args:
        plr: The PLR, or another function of a box.
        axis: The axis along which slices are stacked, counted from 0.
        count: Number of slices, from 1 to 64. The slices are the middles of equally thick layers of the domain.
        space: The configuration space: points that are not free, or have no value, are gray. None: points without a
            value stay blank.
        goal: A configuration, ``(dim,)``. The nearest slice is moved to contain the goal, which a star marks.
        at: For functions of more than three dimensions, coordinates of all other axes except the two that are drawn.
        label: The quantity, such as "time to the goal".
        unit: The unit, such as "s".
        resolution: Number of samples along the longer side of a slice.
    """
    domain: Box = plr.domain
    if domain.dim < 3:
        raise ValueError(f"Slices need three dimensions or more, got {domain.dim}: use plot_contours.")
    require_integer("axis", axis, 0)
    require_integer("count", count, 1)
    if axis >= domain.dim or count > _MOST_SLICES:
        expected = f"axis must be below {domain.dim} and count at most {_MOST_SLICES}"
        raise ValueError(f"{expected}, got {axis} and {count}.")
    at = {} if at is None else at
    if not isinstance(at, Mapping):
        raise ValueError(f"at must map axes to coordinates, such as {{3: 0.5}}, got {shortened(at)}.")
    if axis in at:
        raise ValueError(f"at must leave out axis {axis}, along which slices are stacked, got {dict(at)}.")
    if goal is not None:
        goal = domain.wrapped(as_finite_point("goal", goal, domain.dim))
    # 1. Space slices evenly, but move the nearest one to the goal.
    places = domain.lo[axis] + domain.width[axis] * (np.arange(count) + 0.5) / count
    if goal is not None:
        places[np.abs(places - goal[axis]).argmin()] = goal[axis]
    # 2. Evaluate a grid of points in each slice, and find values in free space.
    cuts = [Slice.of(domain, {**at, axis: float(place)}) for place in places]
    require_drawable(cuts[0], None, space)
    points = [cut.grid(resolution) for cut in cuts]
    values = [np.ma.masked_invalid(np.asarray(plr(x), dtype=np.float64)) for x in points]
    has_value = [free_points(points[i], cuts[i], None, space) & ~np.ma.getmaskarray(values[i]) for i in range(count)]
    maxima = [float(v[mask].max()) for v, mask in zip(values, has_value, strict=True) if mask.any()]
    if not maxima:
        raise ValueError("There is nothing to draw: no point in free space has a finite value.")
    # 3. Choose rows and columns. With rows = count / columns, columns * width = _ASPECT * rows * height gives
    #    columns**2 = _ASPECT * count * height / width.
    horizontal, vertical = cuts[0].axes
    same_unit = is_angle(domain, horizontal) == is_angle(domain, vertical)
    width, height = cuts[0].box.width / cuts[0].box.width.max() if same_unit else (1.0, 1.0)
    columns = int(np.clip(np.ceil(np.sqrt(_ASPECT * count * height / width)), 1, count))
    rows = -(-count // columns)
    columns = -(-count // rows)  # drop columns that stay empty
    # 4. Draw slices row by row from the top left. Ticks have numbers along the left and lower borders of the figure.
    size = np.array([columns, rows]) * (_PANEL * np.array([width, height]) + _GAP) + _MARGIN
    figure = Figure(figsize=tuple(np.maximum(size, _LEAST)), dpi=DPI, facecolor="white", layout="constrained")
    grid = figure.add_gridspec(rows, columns)
    panels = [prepare_axes(figure.add_subplot(grid[divmod(i, columns)]), cuts[0]) for i in range(count)]
    title, _, _ = axis_label(domain, axis).partition(" (")
    for i, (ax, place) in enumerate(zip(panels, places, strict=True)):
        closed = None if space is None else ~has_value[i]
        image = draw_values(ax, cuts[i], points[i], values[i], max(maxima), _NUM_LEVELS, closed)
        ax.set(xlabel="", ylabel="")
        ax.tick_params(labelleft=i % columns == 0, labelbottom=i + columns >= count)
        unit_of_axis = " rad" if is_angle(domain, axis) else ""
        ax.set_title(f"{title} = {place:.3g}{unit_of_axis}", fontsize=FONT_SIZE, color=INK, pad=4)
        if goal is not None and place == goal[axis]:
            mark_goals(ax, goal[None, [horizontal, vertical]])
    figure.supxlabel(axis_label(domain, horizontal), fontsize=FONT_SIZE, color=INK)
    figure.supylabel(axis_label(domain, vertical), fontsize=FONT_SIZE, color=INK)
    style_colorbar(figure.colorbar(image, ax=panels, shrink=0.9, aspect=30), f"{label} ({unit})")
    return panels
