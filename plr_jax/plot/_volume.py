"""Pictures of volumes: the surface of what is blocked, and paths among it."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

from plr_jax._arrays import as_finite_point, as_points, shortened
from plr_jax._types import ArrayLike
from plr_jax.geometry.box import Box
from plr_jax.geometry.voxels import VoxelGrid
from plr_jax.plot._page import INK, axis_label, new_axes_3d
from plr_jax.plot._paths import color_of

_MOST_FACES = 50_000
_STONE, _OPACITY = "#c9c9c9", 0.35


def plot_volume(
    free: ArrayLike,
    ax: Axes3D | None = None,
    *,
    bounds: Box | ArrayLike | None = None,
    paths: Sequence[ArrayLike] = (),
    goal: ArrayLike | None = None,
) -> Axes3D:
    """Draw the surface of a volume's blocked voxels, translucent, and paths among them.

    Args:
        free: Which voxels are free, bools ``(x, y, z)``, as :func:`scenes.read_volume` gives them. For large volumes
            show every second voxel, ``free[::2, ::2, ::2]``, or a part.
        ax: 3-D axes to draw on; a new figure where not given.
        bounds: The Box, or its corners, that the voxels fill; None: each is one unit wide, the first at the origin.
        paths: Paths to draw as lines, ``(steps, 3)`` each; a dot is where one begins.
        goal: A point that is marked with a star, ``(3,)``.

    Returns:
        The axes. Faces of blocked voxels in the faces of the bounds are left out: one sees into a closed room.

    Raises:
        ValueError: If ``free`` are no bools of three axes or none is free, the bounds are no box of three axes, more
            than 50,000 faces of voxels would be drawn, or a path or the goal has another shape or is not finite.
    """
    grid = VoxelGrid.of(free, bounds, range(3, 4))
    box, faces = grid.bounds, _surface(grid.free)
    if len(faces) > _MOST_FACES:
        raise ValueError(
            f"The blocked voxels have {len(faces):,} faces, more than {_MOST_FACES:,}: give fewer voxels, such as "
            "free[::2, ::2, ::2]."
        )
    ax = _new_axes(box) if ax is None else ax
    ax.set(xlim=(box.lo[0], box.hi[0]), ylim=(box.lo[1], box.hi[1]), zlim=(box.lo[2], box.hi[2]))
    corners = box.lo + grid.sides * faces
    if len(corners):
        ax.add_collection3d(
            Poly3DCollection(
                list(corners),
                facecolors=_STONE,
                linewidths=0,
                antialiaseds=False,
                alpha=_OPACITY,
                shade=True,
                zorder=1,
            )
        )
    for i, path in enumerate(paths):
        x = as_points(f"path {i}", path, 3)
        if not np.isfinite(x).all() or not len(x):
            raise ValueError(f"path {i} must have finite coordinates and a step, got {shortened(path)}.")
        ax.plot(*x.T, color=color_of(i), linewidth=1.8, zorder=4)
        ax.plot(*x[:1].T, "o", color=color_of(i), markersize=4, zorder=5)
    if goal is not None:
        star: Any = as_finite_point("goal", goal, 3)[:, None]
        ax.plot(*star, "*", markersize=11, markerfacecolor="white", markeredgecolor=INK, zorder=6)
    return ax


def _new_axes(box: Box) -> Axes3D:
    ax = new_axes_3d(Box(box.lo[:2], box.hi[:2]), axis_label(box, 2))
    ax.set_position((0.04, 0.02, 0.92, 0.96))
    framed: Any = ax
    framed.set_box_aspect(tuple(box.width), zoom=0.93)
    ax.computed_zorder = False  # lines above what is translucent
    for axis in (framed.xaxis, framed.yaxis, framed.zaxis):
        axis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
        axis.set_pane_color((1, 1, 1, 0))
    ax.grid(False)
    corners = box.lo + box.width * np.stack(np.unravel_index(np.arange(8), (2, 2, 2)), axis=1)
    edges = [corners[[i, i | bit]] for bit in (1, 2, 4) for i in range(8) if not i & bit]
    ax.add_collection3d(Line3DCollection(edges, colors=_STONE, linewidths=0.7, zorder=0))
    return ax


def _surface(free: Bool[np.ndarray, "x y z"]) -> Float[np.ndarray, "faces 4 3"]:
    """Corners of the faces between blocked voxels and free ones, counterclockwise as seen from these."""
    faces, square = [], np.array([[1, 0, 0], [1, 1, 0], [1, 1, 1], [1, 0, 1]])
    for axis in range(3):
        along = free.transpose(np.roll(range(3), -axis))  # in cyclic order, which keeps the sense of rotation
        before, after = along[:-1], along[1:]
        for is_face, corners in ((~before & after, square), (before & ~after, square[::-1])):
            faces.append(np.roll(np.argwhere(is_face)[:, None] + corners, axis, axis=2))
    return np.concatenate(faces).astype(np.float64)
