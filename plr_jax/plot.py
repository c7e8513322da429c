"""Pictures of piecewise linear regressions, their errors, and workspaces.

Every function draws on the axes it is given, or on a new figure of its own, and returns the axes; :func:`save`
writes the picture. Figures are made without pyplot, so no global state changes. They have
an opaque white page with dark ink, which stays legible when the picture is set into a dark page, and use
perceptually uniform color maps that color-blind readers can read.
"""

import os
from typing import Protocol, TypeAlias, runtime_checkable

import numpy as np
import shapely
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colorbar import Colorbar
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from plr_jax._box import Box
from plr_jax._types import ArrayLike
from plr_jax._workspace import Workspace

_INK = "#262626"
_QUIET = "#6e6e6e"
_OBSTACLE = "#ececec"
_DISTANCE_COLORS = "viridis"
_ERROR_COLORS = "inferno"
_DISTANCE_LABEL = "distance to the goal (workspace units)"
_FONT_SIZE = 9
_PANEL = 4.2  # inches along the longer side of the plotted box
_DPI = 200


@runtime_checkable
class _Partition(Protocol):
    """What a picture needs of a PLR."""

    @property
    def domain(self) -> Box: ...
    @property
    def leaf_boxes(self) -> tuple[ArrayLike, ArrayLike]: ...
    @property
    def slope(self) -> ArrayLike: ...
    @property
    def intercept(self) -> ArrayLike: ...
    def __call__(self, x: ArrayLike, /) -> ArrayLike: ...


Corners: TypeAlias = Float[np.ndarray, "_ 2"]


def plot_workspace(workspace: Workspace, ax: Axes | None = None) -> Axes:
    """Draw the obstacles of a workspace and its outline.

    Args:
        workspace: What to draw.
        ax: Axes to draw on; a new figure where not given.

    Returns:
        The axes.
    """
    ax = ax or _new_axes(workspace.bounds, room_for_colorbar=False)
    bounds = shapely.box(*workspace.bounds.lo, *workspace.bounds.hi)
    blocked = shapely.intersection(bounds, shapely.union_all(workspace.obstacles))
    for polygon in shapely.get_parts(blocked):
        if polygon.geom_type == "Polygon":
            ax.add_patch(PathPatch(_outline(polygon), facecolor=_OBSTACLE, edgecolor=_INK, linewidth=0.7, zorder=3))
    return ax


def plot_contours(
    plr: _Partition,
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
        The axes. Points without an answer stay blank.

    Raises:
        ValueError: If the PLR is not 2-D, or no point has an answer.
    """
    _require_2d(plr)
    ax = ax or _new_axes(plr.domain)
    x, y = _grid(plr.domain, resolution)
    points = np.stack(np.meshgrid(x, y), axis=-1)
    values = np.ma.masked_invalid(np.asarray(plr(points), dtype=np.float64))
    # Values inside obstacles are drawn (and covered), so that colors reach the walls, but set no scale.
    shown = values if workspace is None else values[workspace.is_free(points.reshape(-1, 2)).reshape(values.shape)]
    if not shown.count():
        raise ValueError("There is nothing to draw: no point has an answer in free space.")
    largest = float(shown.max())
    lo, hi = plr.domain.lo, plr.domain.hi
    image = ax.imshow(
        values,
        origin="lower",
        extent=(lo[0], hi[0], lo[1], hi[1]),
        cmap=_DISTANCE_COLORS,
        vmin=0.0,
        vmax=largest,
        interpolation="nearest",
    )
    levels = MaxNLocator(16).tick_values(0.0, largest)[1:]
    ax.contour(x, y, values, levels=levels, colors="white", linewidths=0.9)
    if workspace is not None:
        plot_workspace(workspace, ax)
    if goal is not None:
        ax.plot(*np.asarray(goal), "*", ms=11, mfc="white", mec=_INK, mew=0.8, zorder=5, clip_on=False)
    _add_colorbar(ax, image, _DISTANCE_LABEL)
    return ax


def plot_cells(
    plr: _Partition, ax: Axes | None = None, *, workspace: Workspace | None = None, color: str = _QUIET
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
    _require_2d(plr)
    ax = ax or _new_axes(plr.domain, room_for_colorbar=False)
    cells = _cell_corners(plr)
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
        ValueError: If no error is finite.

    References:
        Putman et al., Section IV-A, Fig. 2: ``epsilon_g(x) = |L_g(x) - V_g(x)|``.
    """
    finite = errors[np.isfinite(errors)]
    if finite.size == 0:
        raise ValueError("There is nothing to draw: no error is finite.")
    ax = ax or _new_axes(workspace.bounds)
    lo, hi = workspace.bounds.lo, workspace.bounds.hi
    extent = (lo[0], hi[0], lo[1], hi[1])
    largest = float(np.quantile(finite, 0.999)) if largest is None else largest
    image = ax.imshow(
        np.ma.masked_invalid(errors),
        origin="lower",
        extent=extent,
        cmap=_ERROR_COLORS,
        vmin=0.0,
        vmax=largest or None,
        interpolation="nearest",
    )
    unanswered = np.ma.masked_where(~np.isposinf(errors), np.ones_like(errors))
    if unanswered.count():
        ax.imshow(unanswered, origin="lower", extent=extent, cmap="autumn", vmin=1.0, vmax=2.0)
    plot_workspace(workspace, ax)
    clipped = "max" if finite.max() > largest else "neither"
    _add_colorbar(ax, image, "error $|L - V|$ (workspace units)", extend=clipped)
    ax.set_title(f"max {finite.max():.2g}, mean {finite.mean():.2g}", fontsize=_FONT_SIZE, color=_INK)
    return ax


def plot_surface(plr: _Partition, ax: Axes3D | None = None, *, workspace: Workspace | None = None) -> Axes3D:
    """Draw a 2-D distance function as a surface of plane pieces, as in Fig. 1 of the paper.

    Args:
        plr: The PLR.
        ax: 3-D axes to draw on; a new figure where not given.
        workspace: Cells are cut to its free space, beyond which their planes mean nothing.

    Returns:
        The axes. Leaves without an answer are left out.

    Raises:
        ValueError: If the PLR is not 2-D, or no leaf has an answer.
    """
    _require_2d(plr)
    pieces = _plane_pieces(plr, workspace)
    if not pieces:
        raise ValueError("There is nothing to draw: no leaf has an answer in free space.")
    heights = np.array([piece[:, 2].mean() for piece in pieces])
    colors = ScalarMappable(Normalize(min(0.0, heights.min()), heights.max()), _DISTANCE_COLORS)
    ax = ax or _new_axes_3d(plr.domain)
    ax.add_collection3d(
        Poly3DCollection(
            pieces,
            facecolors=colors.to_rgba(heights),
            # Paler with their number, so that lines do not blacken the surface.
            edgecolors=(0, 0, 0, min(0.45, 200 / len(pieces))),
            linewidths=0.3,
        )
    )
    top = max(piece[:, 2].max() for piece in pieces)
    ax.set_xlim(plr.domain.lo[0], plr.domain.hi[0])
    ax.set_ylim(plr.domain.lo[1], plr.domain.hi[1])
    ax.set_zlim(0.0, top)
    bar = ax.figure.colorbar(colors, cax=ax.figure.add_axes((0.86, 0.2, 0.025, 0.6)))
    _style_colorbar(bar, _DISTANCE_LABEL)
    return ax


def save(ax: Axes, path: str | os.PathLike[str]) -> None:
    """Write the picture that axes belong to.

    Args:
        ax: Any axes of the picture.
        path: The file; its ending says how: ``.png``, ``.pdf``, ``.svg`` and what else Matplotlib knows.

    Raises:
        ValueError: If the ending is none that Matplotlib knows.
        OSError: If the file cannot be written.
    """
    ax.figure.canvas.figure.savefig(path)


def _plane_pieces(plr: _Partition, workspace: Workspace | None) -> list[Float[np.ndarray, "_ 3"]]:
    """Every leaf's plane over the leaf (or over the free part of it), as polygons in space."""
    slope, intercept = np.asarray(plr.slope, dtype=np.float64), np.asarray(plr.intercept, dtype=np.float64)
    pieces = []
    for cell, a, b in zip(_cell_corners(plr), slope, intercept, strict=True):
        if np.isfinite(b):
            for corners in [cell] if workspace is None else _free_parts(cell, workspace):
                pieces.append(np.column_stack([corners, corners @ a + b]))
    return pieces


def _free_parts(cell: Corners, workspace: Workspace) -> list[Corners]:
    parts = shapely.get_parts(shapely.intersection(shapely.Polygon(cell), workspace.free_space))
    solid = []
    for part in parts:
        if part.geom_type == "Polygon" and not part.is_empty:
            # A polygon in space has no holes: cut the rare cell around an obstacle into triangles.
            whole = shapely.get_num_interior_rings(part) == 0
            solid += [part] if whole else list(shapely.constrained_delaunay_triangles(part).geoms)
    return [shapely.get_coordinates(part)[:-1] for part in solid]


def _cell_corners(plr: _Partition) -> Float[np.ndarray, "leaves 4 2"]:
    lo, hi = plr.leaf_boxes
    x = np.stack([lo[:, 0], hi[:, 0], hi[:, 0], lo[:, 0]], axis=1)
    y = np.stack([lo[:, 1], lo[:, 1], hi[:, 1], hi[:, 1]], axis=1)
    return np.stack([x, y], axis=-1)


def _grid(domain: Box, resolution: int) -> tuple[np.ndarray, np.ndarray]:
    """Cell centers along each axis of a grid of square cells."""
    columns, rows = np.maximum(2, np.rint(resolution * domain.width / domain.width.max())).astype(int)
    return (
        domain.lo[0] + domain.width[0] * (np.arange(columns) + 0.5) / columns,
        domain.lo[1] + domain.width[1] * (np.arange(rows) + 0.5) / rows,
    )


def _outline(polygon: shapely.Polygon) -> Path:
    rings = [polygon.exterior, *polygon.interiors]
    return Path.make_compound_path(*(Path(shapely.get_coordinates(ring), closed=True) for ring in rings))


def _new_axes(box: Box, *, room_for_colorbar: bool = True) -> Axes:
    width, height = _PANEL * box.width / box.width.max()
    total = np.array([width + (1.6 if room_for_colorbar else 0.75), height + 0.8])
    figure = Figure(figsize=tuple(total), dpi=_DPI, facecolor="white")
    ax = figure.add_axes((0.6 / total[0], 0.5 / total[1], width / total[0], height / total[1]))
    ax.set_xlim(box.lo[0], box.hi[0])
    ax.set_ylim(box.lo[1], box.hi[1])
    ax.set_aspect("equal")
    _style(ax)
    ax.set_xlabel("x (workspace units)")
    ax.set_ylabel("y (workspace units)")
    ax.spines[:].set(color=_INK, linewidth=0.7, zorder=4)
    return ax


def _new_axes_3d(box: Box) -> Axes3D:
    figure = Figure(figsize=(6.2, 4.6), dpi=_DPI, facecolor="white")
    ax = figure.add_axes((0.07, 0.08, 0.68, 0.86), projection="3d")
    assert isinstance(ax, Axes3D)
    ax.set_box_aspect((*(box.width / box.width.max()), 0.7))
    ax.view_init(elev=32, azim=-125)
    _style(ax)
    ax.set_xlabel("x (workspace units)")
    ax.set_ylabel("y (workspace units)")
    ax.set_zlabel("distance", labelpad=6)
    return ax


def _style(ax: Axes) -> None:
    axes = [ax.xaxis, ax.yaxis] + ([ax.zaxis] if isinstance(ax, Axes3D) else [])
    for axis in axes:
        axis.label.set(fontsize=_FONT_SIZE, color=_INK)
    ax.tick_params(labelsize=_FONT_SIZE - 1, colors=_INK, width=0.6, length=3)


def _add_colorbar(ax: Axes, mappable: ScalarMappable, label: str, extend: str = "neither") -> None:
    # An inset is exactly as high as the axes, whatever their aspect.
    place = ax.inset_axes((1.035, 0.0, 0.045, 1.0))
    _style_colorbar(ax.figure.colorbar(mappable, cax=place, extend=extend), label)


def _style_colorbar(bar: Colorbar, label: str) -> None:
    bar.ax.ticklabel_format(axis="y", scilimits=(-2, 4), useMathText=True)
    bar.ax.yaxis.get_offset_text().set(fontsize=_FONT_SIZE - 1, color=_INK)
    bar.set_label(label, fontsize=_FONT_SIZE, color=_INK)
    bar.ax.tick_params(labelsize=_FONT_SIZE - 1, colors=_INK, width=0.6, length=3)
    bar.outline.set(linewidth=0.7, edgecolor=_INK)


def _require_2d(plr: _Partition) -> None:
    if plr.domain.dim != 2:
        raise ValueError(f"Only a 2-D PLR can be drawn, got one of {plr.domain.dim} dimensions.")
