"""Pictures in the plane: workspaces, contours, cells, errors."""

import numpy as np
import shapely
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.image import AxesImage
from matplotlib.patches import PathPatch
from matplotlib.path import Path
from matplotlib.ticker import MaxNLocator

from plr_jax._arrays import as_numbers
from plr_jax._types import ArrayLike, PiecewiseFunction
from plr_jax.geometry.box import Box
from plr_jax.geometry.workspace import Workspace
from plr_jax.plot._page import (
    DISTANCE_COLORS,
    DISTANCE_LABEL,
    FONT_SIZE,
    INK,
    add_colorbar,
    cell_corners,
    dressed_axes,
    require_2d,
)

_QUIET = "#6e6e6e"
OBSTACLE = "#ececec"
_ERROR_COLORS = "inferno"


def plot_workspace(workspace: Workspace, ax: Axes | None = None) -> Axes:
    """Draw the obstacles of a workspace and its outline.

    Args:
        workspace: What to draw.
        ax: Axes to draw on; a new figure where not given.

    Returns:
        The axes.
    """
    ax = dressed_axes(ax, workspace.bounds, room_for_colorbar=False)
    for polygon in blocked_polygons(workspace):
        ax.add_patch(PathPatch(_outline(polygon), facecolor=OBSTACLE, edgecolor=INK, linewidth=0.7, zorder=3))
    return ax


def blocked_polygons(workspace: Workspace) -> list[shapely.Polygon]:
    """What obstacles cover of the bounds, merged."""
    bounds = shapely.box(*workspace.bounds.lo, *workspace.bounds.hi)
    blocked = shapely.intersection(bounds, shapely.union_all(workspace.obstacles))
    return [polygon for polygon in shapely.get_parts(blocked) if polygon.geom_type == "Polygon"]


def plot_contours(
    plr: PiecewiseFunction,
    ax: Axes | None = None,
    *,
    workspace: Workspace | None = None,
    goal: ArrayLike | None = None,
    resolution: int = 800,
) -> Axes:
    """Draw a 2-D distance function as colors with contour lines.

    Args:
        plr: The PLR.
        ax: Axes to draw on; a new figure where not given.
        workspace: Its obstacles are drawn on top. Without it, the values inside obstacles show, which mean
            nothing.
        goal: A point to mark with a star, ``(2,)``.
        resolution: Number of samples along the longer side of the domain.

    Returns:
        The axes. Points without an answer stay blank; a grid of one row or column gets no lines.

    Raises:
        ValueError: If the PLR is not 2-D, or no point has an answer.
    """
    require_2d(plr)
    ax = dressed_axes(ax, plr.domain)
    points = plr.domain.grid(resolution)
    values = np.ma.masked_invalid(np.asarray(plr(points), dtype=np.float64))
    # Values inside obstacles are drawn (and covered), so that colors reach the walls, but set no scale.
    shown = values if workspace is None else values[workspace.is_free(points.reshape(-1, 2)).reshape(values.shape)]
    if not shown.count():
        raise ValueError("There is nothing to draw: no point has an answer in free space.")
    largest = float(shown.max())
    image = _add_image(ax, plr.domain, values, DISTANCE_COLORS, 0.0, largest)
    if min(values.shape) > 1:
        levels = MaxNLocator(16).tick_values(0.0, largest)[1:]
        ax.contour(points[..., 0], points[..., 1], values, levels=levels, colors="white", linewidths=0.9)
    if workspace is not None:
        plot_workspace(workspace, ax)
    if goal is not None:
        ax.plot(*np.asarray(goal), "*", ms=11, mfc="white", mec=INK, mew=0.8, zorder=5, clip_on=False)
    add_colorbar(ax, image, DISTANCE_LABEL)
    return ax


def plot_cells(
    plr: PiecewiseFunction, ax: Axes | None = None, *, workspace: Workspace | None = None, color: str = _QUIET
) -> Axes:
    """Draw the cells of a 2-D partition, one rectangle a leaf.

    Args:
        plr: The PLR.
        ax: Axes to draw on; a new figure where not given.
        workspace: Its obstacles are drawn on top.
        color: Color of the lines.

    Returns:
        The axes.

    Raises:
        ValueError: If the PLR is not 2-D.
    """
    require_2d(plr)
    ax = dressed_axes(ax, plr.domain, room_for_colorbar=False)
    cells = cell_corners(plr)
    closed = np.concatenate([cells, cells[:, :1]], axis=1)
    ax.add_collection(LineCollection(list(closed), colors=color, linewidths=0.4, alpha=0.7, zorder=2.5))
    if workspace is not None:
        plot_workspace(workspace, ax)
    return ax


def plot_error(
    errors: Float[np.ndarray, "rows columns"],
    workspace: Workspace,
    ax: Axes | None = None,
    *,
    largest: float | None = None,
) -> Axes:
    """Draw the error of an approximation over free space, as in Fig. 2 of the paper.

    Args:
        errors: Errors at the cell centers of a grid over the bounds, row 0 at the lowest ``y``, as
            ``metrics.error_grid`` gives them. NaN is blank; points without an answer (infinite) are red.
        workspace: Its obstacles are drawn on top.
        ax: Axes to draw on; a new figure where not given.
        largest: Error at the upper end of the colors, beyond which they stay the same; where not given, the
            error that 99.9 % of the points do not exceed. Give the same number to pictures that are to be
            compared.

    Returns:
        The axes.

    Raises:
        ValueError: If no error is finite, or one is masked.

    References:
        Putman et al., Section IV-A, Fig. 2: ``epsilon_g(x) = |L_g(x) - V_g(x)|``.
    """
    errors = as_numbers("errors", errors, "numbers of shape (rows, columns), NaN where there is none")
    finite = errors[np.isfinite(errors)]
    if finite.size == 0:
        raise ValueError("There is nothing to draw: no error is finite.")
    ax = dressed_axes(ax, workspace.bounds)
    largest = float(np.quantile(finite, 0.999)) if largest is None else largest
    image = _add_image(ax, workspace.bounds, np.ma.masked_invalid(errors), _ERROR_COLORS, 0.0, largest or None)
    unanswered = np.ma.masked_where(~np.isposinf(errors), np.ones_like(errors))
    if unanswered.count():
        _add_image(ax, workspace.bounds, unanswered, "autumn", 1.0, 2.0)
    plot_workspace(workspace, ax)
    clipped = "max" if finite.max() > largest else "neither"
    add_colorbar(ax, image, "error $|L - V|$ (workspace units)", extend=clipped)
    ax.set_title(f"max {finite.max():.2g}, mean {finite.mean():.2g}", fontsize=FONT_SIZE, color=INK)
    return ax


def _add_image(
    ax: Axes, box: Box, values: np.ma.MaskedArray, colors: str, lowest: float, largest: float | None
) -> AxesImage:
    """Show values at the cell centers of a grid over a box."""
    extent = (box.lo[0], box.hi[0], box.lo[1], box.hi[1])
    scale = {"cmap": colors, "vmin": lowest, "vmax": largest}
    return ax.imshow(values, origin="lower", extent=extent, interpolation="nearest", **scale)


def _outline(polygon: shapely.Polygon) -> Path:
    rings = [polygon.exterior, *polygon.interiors]
    return Path.make_compound_path(*(Path(shapely.get_coordinates(ring), closed=True) for ring in rings))
