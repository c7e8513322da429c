"""Draw workspaces, and functions of the plane or of a slice: as contours, as cells, or as errors."""

from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np
import shapely
from jaxtyping import Float
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Colormap, ListedColormap, LogNorm, Normalize
from matplotlib.image import AxesImage
from matplotlib.patches import PathPatch
from matplotlib.path import Path
from matplotlib.ticker import MaxNLocator

from plr_jax._arrays import as_finite_point, as_numbers
from plr_jax._types import ArrayLike, FunctionOfBox, PiecewiseFunction
from plr_jax.geometry.boundary import polygons_of
from plr_jax.geometry.box import Box, Slice
from plr_jax.geometry.workspace import Workspace, joined_parts
from plr_jax.plot import _axes
from plr_jax.spaces import FreeTest

Corners: TypeAlias = Float[np.ndarray, "_ 2"]
_CELL_COLOR = "#6e6e6e"
OBSTACLE = "#ececec"
_ERROR_COLORS = colormaps["inferno"].resampled(12)  # four colors a decade: readable, and small files
_NUM_LEVELS = 16  # of contours, at most
_ERROR_RANGE = 1e-3  # smallest error of the color scale, as a share of the largest


def plot_workspace(workspace: Workspace, ax: Axes | None = None, *, unit: str = _axes.WORKSPACE_UNITS) -> Axes:
    """Draw the obstacles and bounds of a workspace, on new axes by default, with the unit of length on the axes.

    The axes are Matplotlib's: ``ax.plot(*path.T)`` draws a path of points ``(m, 2)``.
    """
    ax = _axes.prepare_axes(ax, Slice.of(workspace.bounds, None), room_for_colorbar=False)
    ax.set(xlabel=f"x ({unit})", ylabel=f"y ({unit})")
    _add_obstacles(workspace, ax)
    return ax


def _add_obstacles(workspace: Workspace | FreeTest | None, ax: Axes) -> None:
    for polygon in blocked_polygons(workspace) if isinstance(workspace, Workspace) else ():
        ax.add_patch(PathPatch(_outline(polygon), facecolor=OBSTACLE, edgecolor=_axes.INK, linewidth=0.7, zorder=3))


def blocked_polygons(workspace: Workspace) -> tuple[shapely.Polygon, ...]:
    bounds = shapely.box(*workspace.bounds.lo, *workspace.bounds.hi)
    return polygons_of(shapely.intersection(bounds, shapely.union_all(workspace.obstacles)))


def plot_contours(
    plr: FunctionOfBox,
    ax: Axes | None = None,
    *,
    workspace: Workspace | None = None,
    space: FreeTest | None = None,
    goal: ArrayLike | None = None,
    at: Mapping[int, float | int] | None = None,
    label: str = _axes.DISTANCE,
    unit: str = _axes.WORKSPACE_UNITS,
    resolution: int = 800,
) -> Axes:
    """Draw a distance function, or another cost-to-go, as colors with contour lines.

    Args:
        plr: The PLR, or another function of a box. Points without a finite value stay blank.
        ax: Axes to draw on; a new figure by default.
        workspace: The workspace whose obstacles are drawn on top; values inside obstacles have no meaning. What lies
            beyond its bounds is gray; with a ``goal``, so are free regions that are disconnected from the goal.
        space: Instead of a workspace, a configuration space: points that are not free are gray.
        goal: A configuration, ``(dim,)``, or several, ``(k, dim)``, marked with a star.
        at: For functions of more than two dimensions, the slice: coordinates of all axes except the two that are
            drawn, such as ``{2: 0.5}``. Angles are in radians.
        label: The quantity, such as "time to the goal".
        unit: The unit, such as "s".
        resolution: Number of samples along the longer side of the domain. Contour lines need at least two samples
            along the other side.

    Raises:
        ValueError: If ``at`` does not leave two axes or is outside the domain, the workspace or space has other axes,
            or no point has a finite value.
    """
    shown = Slice.of(plr.domain, at)
    _require_drawable(shown, workspace, space)
    ax = _axes.prepare_axes(ax, shown)
    # 1. Evaluate a grid of points.
    points = shown.grid(resolution)
    values = np.ma.masked_invalid(np.asarray(plr(points), dtype=np.float64))
    tester, dim = (space, shown.domain.dim) if workspace is None else (workspace, 2)
    tested = points[..., :dim].reshape(-1, dim)
    is_free = (np.ones(len(tested), bool) if tester is None else tester.is_free(tested)).reshape(values.shape)
    # 2. Project the goals to the slice, and find what lies beyond the workspace or cannot reach them.
    cut_off: Any = []
    if workspace is not None:
        bounds = shapely.box(*workspace.bounds.lo, *workspace.bounds.hi)
        cut_off = polygons_of(shapely.box(*shown.box.lo, *shown.box.hi) - bounds)
    if goal is not None:
        given = [as_finite_point("goal", each, plr.domain.dim) for each in (goal if np.ndim(goal) == 2 else [goal])]
        goals = plr.domain.wrapped(np.reshape(given, (-1, plr.domain.dim)))[:, list(shown.axes)]
        ax.plot(*goals.T, "*", ms=11, mfc="white", mec=_axes.INK, mew=0.8, zorder=5, clip_on=False)
        if workspace is not None:
            parts = shapely.get_parts(workspace.free_space)
            is_reached = joined_parts(parts, goals, workspace.tolerance, workspace.squeeze)
            if is_reached.any() and not is_reached.all():  # if no goal is in free space, nothing is cut off
                cut_off = [*cut_off, *parts[~is_reached]]
                reached = shapely.MultiPolygon(list(parts[is_reached]))
                is_free &= shapely.intersects_xy(reached, points[..., 0], points[..., 1])
    # 3. Draw values. Those inside obstacles are covered later, so that colors reach the walls; they do not affect the
    #    color scale.
    if not (free_values := values[is_free]).count():
        raise ValueError("There is nothing to draw: no point in free space has a finite value.")
    largest = float(free_values.max())
    image = _add_image(ax, shown.box, values, _axes.DISTANCE_COLORS, Normalize(0.0, largest))
    x, y = np.moveaxis(points[..., list(shown.axes)], 2, 0)
    has_lines = min(values.shape) > 1  # Matplotlib draws contours only of two rows and two columns or more
    if has_lines and largest > 0:
        levels = MaxNLocator(_NUM_LEVELS).tick_values(0.0, largest)[1:]
        ax.contour(x, y, values, levels=levels, colors="white", linewidths=0.8)
    # 4. Cover what is not free.
    if space is not None and not is_free.all():
        gray = np.ma.masked_where(is_free, np.ones(is_free.shape))
        _add_image(ax, shown.box, gray, ListedColormap([OBSTACLE]), Normalize(0.0, 1.0)).set_zorder(3)
        if has_lines:
            ax.contour(x, y, ~is_free, levels=[0.5], colors=_axes.INK, linewidths=0.6, zorder=3.5)
    _add_obstacles(workspace, ax)
    for polygon in cut_off:
        ax.add_patch(PathPatch(_outline(polygon), facecolor=OBSTACLE, linewidth=0, zorder=3))
    _axes.add_colorbar(ax, image, f"{label} ({unit})")
    return ax


def plot_cells(
    plr: PiecewiseFunction,
    ax: Axes | None = None,
    *,
    workspace: Workspace | None = None,
    at: Mapping[int, float | int] | None = None,
    color: str = _CELL_COLOR,
) -> Axes:
    """Draw the boxes of a PLR's leaves as rectangles; arguments and errors are as for :func:`plot_contours`."""
    shown = Slice.of(plr.domain, at)
    _require_drawable(shown, workspace, None)
    ax = _axes.prepare_axes(ax, shown, room_for_colorbar=False)
    cells = _cells_of(plr, shown)
    closed = np.concatenate([cells, cells[:, :1]], axis=1)
    ax.add_collection(LineCollection(list(closed), colors=color, linewidths=0.4, alpha=0.7, zorder=2.5))
    _add_obstacles(workspace, ax)
    return ax


def plot_error(
    errors: Float[np.ndarray, "rows columns"],
    workspace: Workspace | FreeTest,
    ax: Axes | None = None,
    *,
    at: Mapping[int, float | int] | None = None,
    unit: str = _axes.WORKSPACE_UNITS,
    largest: float | None = None,
) -> Axes:
    """Draw errors ``|L - V|`` of an approximation ``L`` of distances ``V`` in free space, as in Fig. 2 of the paper.

    Args:
        errors: Result of ``metrics.error_grid``: errors at the cell centers of a grid, row 0 at the lowest ``y``. NaN
            is blank, infinite errors (points without an answer) are red. At least one is finite.
        workspace: The workspace or the configuration space in which the errors were measured. Obstacles of a
            workspace are drawn on top.
        ax: Axes to draw on; a new figure by default.
        at: The slice that ``metrics.error_grid`` was given, in a space of more than two dimensions.
        unit: The unit of the errors, such as "m".
        largest: Error at the upper end of the logarithmic color scale. The lower end is a thousandth of this error.
            Errors beyond the ends get the colors of the ends. By default, the 99.9 % quantile. Give the same number
            to pictures that are to be compared.
    """
    errors = as_numbers("errors", errors, "numbers of shape (rows, columns), NaN where there is none")
    if not (finite := errors[np.isfinite(errors)]).size:
        raise ValueError("There is nothing to draw: no error is finite.")
    shown = Slice.of(workspace.bounds if isinstance(workspace, Workspace) else workspace.domain, at)
    ax = _axes.prepare_axes(ax, shown)
    # 1. Draw finite errors; errors below the logarithmic scale, such as 0, have its lowest color.
    largest = float(np.quantile(finite, 0.999)) if largest is None else largest
    smallest = _ERROR_RANGE * (largest or 1.0)  # 1.0: any scale will do if nearly all errors are 0
    shown_errors = np.ma.masked_invalid(np.maximum(errors, smallest))
    image = _add_image(ax, shown.box, shown_errors, _ERROR_COLORS, LogNorm(smallest, largest or 1.0))
    # 2. Draw infinite errors in the lowest color of "autumn", which is red.
    if (unanswered := np.ma.masked_where(~np.isposinf(errors), np.ones_like(errors))).count():
        _add_image(ax, shown.box, unanswered, "autumn", Normalize(1.0, 2.0))
    # 3. Cover obstacles, and label.
    _add_obstacles(workspace, ax)
    _axes.add_colorbar(ax, image, f"error $|L - V|$ ({unit})", extend="both" if finite.max() > largest else "min")
    ax.set_title(f"max {finite.max():.3g}, mean {finite.mean():.3g}", fontsize=_axes.FONT_SIZE, color=_axes.INK)
    return ax


def _require_drawable(shown: Slice, workspace: Workspace | None, space: FreeTest | None) -> None:
    """Raise a ``ValueError`` if a workspace or space does not fit the slice to be drawn, or if both are given."""
    if workspace is not None and shown.axes != (0, 1):
        raise ValueError(f"A workspace needs axes 0 and 1 to be drawn, got axes {shown.axes}: leave it out.")
    if workspace is not None and space is not None:
        raise ValueError("Expected either a workspace or a space, got both: leave one out.")
    if space is not None and space.domain.dim != shown.domain.dim:
        raise ValueError(f"Expected a space of {shown.domain.dim} dimensions, got {space.domain.dim}.")


def _cells_of(plr: PiecewiseFunction, shown: Slice) -> Float[np.ndarray, "cells 4 2"]:
    """Return the rectangles in which boxes of a PLR's leaves meet a slice: four corners each, counterclockwise."""
    # 1. Along the axes that are fixed, a cell holds the coordinates lo <= at < hi; the last cell holds its hi too.
    lo, hi = (np.asarray(corner) for corner in plr.leaf_boxes)
    fixed = [axis for axis in range(shown.domain.dim) if axis not in shown.axes]
    at = shown.at[fixed]
    is_below_end = (at < hi[:, fixed]) | ((at == hi[:, fixed]) & (hi[:, fixed] == shown.domain.hi[fixed]))
    meets = np.all((lo[:, fixed] <= at) & is_below_end, axis=1)
    # 2. Along the other two: x, y (cell, end).     y[1]  3---2
    #                                               y[0]  0---1
    #                                                   x[0]  x[1]
    x, y = np.stack([lo[meets], hi[meets]])[..., shown.axes].transpose(2, 1, 0)
    return np.stack([x[:, [0, 1, 1, 0]], y[:, [0, 0, 1, 1]]], axis=2)


def _add_image(ax: Axes, box: Box, values: np.ma.MaskedArray, colors: str | Colormap, norm: Normalize) -> AxesImage:
    extent = (box.lo[0], box.hi[0], box.lo[1], box.hi[1])
    options = {"extent": extent, "cmap": colors, "norm": norm, "aspect": ax.get_aspect()}  # else imshow changes it
    return ax.imshow(values, origin="lower", interpolation="nearest", **options)


def _outline(polygon: shapely.Polygon) -> Path:
    rings = shapely.get_rings(polygon)
    return Path.make_compound_path(*(Path(shapely.get_coordinates(ring), closed=True) for ring in rings))
