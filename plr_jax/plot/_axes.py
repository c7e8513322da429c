"""Make figures, axes and color bars in the style that all plots share, and save pictures."""

import math
import os

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MultipleLocator

from plr_jax.geometry.box import Box, Slice

INK = "#262626"
DISTANCE_COLORS = "viridis"
DISTANCE, WORKSPACE_UNITS = "distance to the goal", "workspace units"
FONT_SIZE = 9  # points
_PANEL = 4.2  # inches of the longer side of the plotted box
DPI = 200  # pixels per inch
SQUARE = Box((0, 0), (1, 1))  # gives pictures whose axes have different units a square shape


def save(ax: Axes, path: str | os.PathLike[str]) -> None:
    """Write the figure of the axes to a file, in any format that Matplotlib supports, such as .png, .pdf or .svg."""
    ax.figure.canvas.figure.savefig(path)


def prepare_axes(ax: Axes | None, shown: Slice, *, room_for_colorbar: bool = True) -> Axes:
    """Return ``ax``, or new axes if it is None, with limits, ticks, labels and colors for the slice ``shown``."""
    box = shown.box
    same_unit = is_angle(shown.domain, shown.axes[0]) == is_angle(shown.domain, shown.axes[1])
    ax = ax or new_axes(box if same_unit else SQUARE, (0.6, 0.5), (1.0 if room_for_colorbar else 0.15, 0.3))
    ax.set(xlim=(box.lo[0], box.hi[0]), ylim=(box.lo[1], box.hi[1]), aspect="equal" if same_unit else "auto")
    _label_axes(ax, shown.domain, shown.axes)
    ax.spines[:].set(color=INK, linewidth=0.7, zorder=4)
    return ax


def _label_axes(ax: Axes, domain: Box, shown: tuple[int, int]) -> None:
    for axis, number in zip((ax.xaxis, ax.yaxis), shown, strict=True):
        axis.set_label_text(axis_label(domain, number))
        if is_angle(domain, number):
            axis.set_major_locator(MultipleLocator(math.pi / 2))
            axis.set_major_formatter(FuncFormatter(_in_multiples_of_pi))
    for axis in (ax.xaxis, ax.yaxis):
        axis.label.set(fontsize=FONT_SIZE, color=INK)
    ax.tick_params(labelsize=FONT_SIZE - 1, colors=INK, width=0.6, length=3)


def is_angle(domain: Box, axis: int) -> bool:
    """Return whether an axis of the domain is an angle in radians: periodic, and a full turn wide."""
    return domain.periodic[axis] and math.isclose(domain.width[axis], 2 * math.pi)


def axis_label(domain: Box, axis: int) -> str:
    """Return the name of an axis with its unit, guessed from the dimension and from which axes are angles."""
    are_angles = [is_angle(domain, other) for other in range(domain.dim)]
    if are_angles[axis]:
        return f"{'heading' if are_angles == [False, False, True] else f'angle {axis + 1}'} (rad)"
    has_positions = not any(are_angles[:2]) and domain.dim in (2, 3)
    return f"{'xyz'[axis]} ({WORKSPACE_UNITS})" if has_positions else f"coordinate {axis + 1}"


def _in_multiples_of_pi(angle: float, _: int | None = None) -> str:
    """Return the tick label of an angle in radians, a multiple of pi / 2, as a multiple of the letter pi."""
    halves = round(angle / (math.pi / 2))
    if halves % 2:
        return {1: r"$\pi/2$", -1: r"$-\pi/2$"}.get(halves, rf"${halves}\pi/2$")
    return {0: "0", 2: r"$\pi$", -2: r"$-\pi$"}.get(halves, rf"${halves // 2}\pi$")


def new_axes(box: Box, before: tuple[float, float], after: tuple[float, float], dpi: int = DPI) -> Axes:
    """Return axes with the proportions of a box in the plane, in a new figure.

    ``before`` has the margins (left, bottom), ``after`` has (right, top), in inches.
    """
    size = _PANEL * box.width / box.width.max()
    total = size + np.add(before, after)
    return Figure(figsize=tuple(total), dpi=dpi, facecolor="white").add_axes((*(before / total), *(size / total)))


def add_colorbar(ax: Axes, mappable: ScalarMappable, label: str, extend: str = "neither") -> None:
    bar = ax.figure.colorbar(mappable, cax=ax.inset_axes((1.035, 0.0, 0.045, 1.0)), extend=extend)
    if not isinstance(bar.norm, LogNorm):
        bar.ax.ticklabel_format(axis="y", scilimits=(-2, 4), useMathText=True)
    bar.ax.yaxis.get_offset_text().set(fontsize=FONT_SIZE - 1, color=INK)
    bar.set_label(label, fontsize=FONT_SIZE, color=INK)
    bar.ax.tick_params(labelsize=FONT_SIZE - 1, colors=INK, width=0.6, length=3)
    bar.outline.set(linewidth=0.7, edgecolor=INK)
