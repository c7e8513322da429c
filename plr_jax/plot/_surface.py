"""The picture of a distance function as a surface."""

from typing import TypeAlias

import numpy as np
import shapely
from jaxtyping import Float
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from plr_jax.geometry.polygons import triangulate
from plr_jax.geometry.workspace import Workspace
from plr_jax.plot._page import (
    DISTANCE,
    DISTANCE_COLORS,
    WORKSPACE_UNITS,
    FunctionsOfLeaves,
    cell_corners,
    new_axes_3d,
    require_2d,
    style_colorbar,
)

Corners: TypeAlias = Float[np.ndarray, "_ 2"]


def plot_surface(
    plr: FunctionsOfLeaves,
    ax: Axes3D | None = None,
    *,
    workspace: Workspace | None = None,
    label: str = DISTANCE,
    unit: str = WORKSPACE_UNITS,
) -> Axes3D:
    """Draw a 2-D distance function as a surface of pieces, one a leaf, as in Fig. 1 of the paper.

    Args:
        plr: The PLR.
        ax: 3-D axes to draw on; a new figure where not given.
        workspace: Cells are cut to its free space, beyond which their planes mean nothing.
        label: The quantity, such as "time to the goal".
        unit: Its unit, such as "s".

    Returns:
        The axes. Leaves without an answer are left out.

    Raises:
        ValueError: If the PLR is not 2-D, or no leaf has an answer.
    """
    require_2d(plr)
    pieces = _pieces(plr, workspace)
    if not pieces:
        raise ValueError("There is nothing to draw: no leaf has an answer in free space.")
    heights = np.array([piece[:, 2].mean() for piece in pieces])
    colors = ScalarMappable(Normalize(0.0, heights.max()), DISTANCE_COLORS)
    if ax is None:
        ax = new_axes_3d(plr.domain, f"{label} ({unit})")
        bar = ax.figure.colorbar(colors, cax=ax.figure.add_axes((0.86, 0.2, 0.025, 0.6)))
    else:
        bar = ax.figure.colorbar(colors, ax=ax, shrink=0.6, pad=0.1)
    style_colorbar(bar, f"{label} ({unit})")
    # Lines are paler the more there are, so that they do not blacken the surface.
    lines = (0, 0, 0, min(0.45, 200 / len(pieces)))
    ax.add_collection3d(
        Poly3DCollection(pieces, facecolors=colors.to_rgba(heights), edgecolors=lines, linewidths=0.3)
    )
    ax.set_xlim(plr.domain.lo[0], plr.domain.hi[0])
    ax.set_ylim(plr.domain.lo[1], plr.domain.hi[1])
    ax.set_zlim(0.0, max(piece[:, 2].max() for piece in pieces))
    return ax


def _pieces(plr: FunctionsOfLeaves, workspace: Workspace | None) -> list[Float[np.ndarray, "_ 3"]]:
    """Every leaf's function at the leaf's corners (or those of the free part of it), as polygons in space."""
    parts = [[cell] if workspace is None else _free_parts(cell, workspace) for cell in cell_corners(plr)]
    pieces = [corners for of_leaf in parts for corners in of_leaf]
    if not pieces:
        return []
    points = np.concatenate(pieces)
    leaf = np.repeat(plr.leaf_of_box, [sum(map(len, of_leaf)) for of_leaf in parts])
    heights = np.split(plr.values_in_leaves(leaf, points), np.cumsum([len(corners) for corners in pieces])[:-1])
    placed = [np.column_stack(piece) for piece in zip(pieces, heights, strict=True)]
    return [piece for piece in placed if np.isfinite(piece).all()]


def _free_parts(cell: Corners, workspace: Workspace) -> list[Corners]:
    parts = shapely.get_parts(shapely.intersection(shapely.Polygon(cell), workspace.free_space))
    solid: list[Corners] = []
    for part in parts:
        if part.geom_type == "Polygon" and not part.is_empty:
            # A polygon in space has no holes: cut the rare cell around an obstacle into triangles.
            whole = shapely.get_num_interior_rings(part) == 0
            solid += [shapely.get_coordinates(part)[:-1]] if whole else list(triangulate(part))
    return solid
