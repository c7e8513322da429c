"""What several figures of experiments have in common."""

import numpy as np
from matplotlib.axes import Axes


def label_ends(ax: Axes, ends: list[tuple[str, float, float, str]], spacing: float) -> None:
    """Name every line of logarithmic axes where it ends, with labels moved apart that would overlap.

    Args:
        ax: The axes.
        ends: Of each line its label, where it ends along x and y, and its color.
        spacing: Least distance of labels, in heights of the axes.
    """
    lo, hi = np.log(ax.get_ylim())
    height = -np.inf
    for label, x, y, color in sorted(ends, key=lambda end: end[2]):
        height = max((np.log(y) - lo) / (hi - lo), height + spacing)
        ax.annotate(
            label,
            (x, y),
            (1.06, height),
            textcoords="axes fraction",
            color=color,
            va="center",
            fontsize=9,
            arrowprops={"arrowstyle": "-", "color": color, "lw": 0.5, "shrinkA": 1, "shrinkB": 3},
        )
