"""Mean error against bytes, one panel a map."""

from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments._figures import label_ends

# interpax's linear answers are those of the bilinear grid.
_STYLES = {
    "PLR, cones": ("#0072B2", "-", "*"),
    "PLR": ("#0072B2", "-", "o"),
    "PLR, continuous": ("#0072B2", "--", "o"),
    "bilinear grid, 16-bit": ("#444444", "-", "D"),
    "bilinear grid": ("#444444", "--", "D"),
    "interpax, cubic, 16-bit": ("#009E73", "-", "^"),
    "interpax, cubic": ("#009E73", "--", "^"),
    "LinearNDInterpolator": ("#CC79A7", "-", "v"),
    "LightGBM linear trees": ("#D55E00", "-", "s"),
    "network, 16-bit": ("#E69F00", "-", "P"),
    "scikit-fmm": ("#56B4E9", ":", "X"),
}
_LABEL_HEIGHT = 0.06


def draw(results: dict[str, Any], output: Path) -> list[Path]:
    """A panel a map, the lines labeled at the right of the last."""
    maps = results["maps"]
    figure = Figure(figsize=(2.7 * len(maps) + 2.0, 4.2), layout="constrained", facecolor="white")
    panels = figure.subplots(1, len(maps), squeeze=False)[0]
    for ax, (name, rows) in zip(panels, maps.items(), strict=True):
        _draw_map(ax, rows)
        ax.set_title(name.replace("_", " "), fontsize=11)
        ax.set_xlabel("bytes")
    panels[0].set_ylabel("mean error (workspace units)")
    label_ends(panels[-1], _ends(list(maps.values())[-1]), _LABEL_HEIGHT)
    path = output / "benchmark_accuracy.png"
    figure.savefig(path, dpi=150)
    return [path]


def _draw_map(ax: Axes, rows: list[dict[str, Any]]) -> None:
    for name, (color, line, marker) in _STYLES.items():
        points = [(row["bytes"], row["free"]["mean"]) for row in rows if row["contender"] == name]
        if points:
            ax.loglog(*zip(*points, strict=True), line, color=color, marker=marker, ms=4, lw=1.5)
    budgets = sorted({row["budget"] for row in rows})
    ax.set_xticks(budgets, [f"{budget:,}" for budget in budgets])
    ax.minorticks_off()
    ax.grid(True, which="major", color="#dddddd", lw=0.6)
    ax.spines[["top", "right"]].set_visible(False)


def _ends(rows: list[dict[str, Any]]) -> list[tuple[str, float, float, str]]:
    """Label, end and color of each line."""
    most = max(row["budget"] for row in rows)
    last = [row for row in rows if row["budget"] == most and row["contender"] in _STYLES and row["free"]["mean"]]
    return [(row["contender"], row["bytes"], row["free"]["mean"], _STYLES[row["contender"]][0]) for row in last]
