"""Which source each cone leaf names, and how large its proven error is: a picture of two files.

The results hold the files themselves; the picture is drawn from what they say.
"""

import base64
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import LogNorm, hsv_to_rgb
from matplotlib.figure import Figure

from experiments.benchmarks._maps import load_maps
from experiments.benchmarks._oracle import ring_of
from experiments.proving._sizes import widest_bounds
from plr_jax import PLR, VisibilityGraph, Workspace, certify, construct, from_bytes, plot

BUDGETS = {"maze": 512, "arena": 4_096}
_INK, _ERROR_COLORS = "#262626", "magma_r"


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    maps = {}
    for name, (workspace, goal) in load_maps(list(BUDGETS)[: 1 if smoke else None]).items():
        oracle = VisibilityGraph(workspace, goal)
        plr = construct(oracle, workspace.bounds, leaf="cone", max_bytes=BUDGETS[name], certified=True, seed=seed)
        maps[name] = {
            "bytes": plr.num_bytes,
            "max_error": plr.max_error,
            "file": base64.b64encode(certify(plr, oracle, leaf_bounds=True).to_bytes()).decode("ascii"),
            "goal": goal.tolist(),
            "free": [
                {"outer": ring_of(part.exterior), "holes": [ring_of(hole) for hole in part.interiors]}
                for part in shapely.get_parts(workspace.free_space)
            ],
        }
    return {"maps": maps}


def draw(results: dict[str, Any], output: Path) -> list[Path]:
    """Leaves in the colors of their sources, and in those of their proven errors."""
    maps = results["maps"]
    figure = Figure(figsize=(8.6, 4.0 * len(maps)), dpi=130, facecolor="white", layout="constrained")
    axes = figure.subplots(len(maps), 2, squeeze=False)
    for (left, right), (name, each) in zip(axes, maps.items(), strict=True):
        plr, workspace = from_bytes(base64.b64decode(each["file"])), Workspace.from_polygons(each["free"])
        _draw_sources(left, plr, np.array(each["goal"]))
        scale = _draw_errors(right, plr)
        for ax, title in ((left, "which corner each leaf belongs to"), (right, "proven error")):
            plot.plot_workspace(workspace, ax)
            ax.set_title(f"{name}, {each['bytes']:,} bytes: {title}", fontsize=9, color=_INK)
            ax.set(xlabel="", ylabel="")
        figure.colorbar(scale, ax=right, label="proven error (workspace units)", shrink=0.9)
    path = output / "proofs_leaves.png"
    figure.savefig(path)
    return [path]


def _boxes(plr: PLR) -> Float[np.ndarray, "leaves 4 2"]:
    (x0, y0), (x1, y1) = (corner.T for corner in plr.leaf_boxes)
    return np.stack([np.stack([x0, x1, x1, x0]), np.stack([y0, y0, y1, y1])], axis=-1).transpose(1, 0, 2)


def _draw_sources(ax: Axes, plr: PLR, goal: Float[np.ndarray, "2"]) -> None:
    source, points, parent = plr.stored.source, plr.stored.sources.points, plr.stored.sources.parent
    each = np.arange(len(points))
    hue = (each * 0.61803) % 1.0  # neighbors in the file far apart in hue
    colors = hsv_to_rgb(np.column_stack([hue, 0.35 + 0.2 * (each % 3), 0.75 + 0.1 * (each % 2)]))
    ax.add_collection(
        PolyCollection(list(_boxes(plr)), facecolors=colors[source], edgecolors="white", linewidths=0.2)
    )
    onward = each != parent
    ways = np.stack([points[onward], points[parent[onward]]], axis=1)
    ax.add_collection(LineCollection(list(ways), colors=_INK, linewidths=0.5, alpha=0.5, zorder=4))
    for start, end in ways:
        middle, step = (start + end) / 2, 1e-3 * (end - start)
        style = {"arrowstyle": "-|>", "color": _INK, "lw": 0.5, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 6}
        ax.annotate("", middle + step, middle, arrowprops=style, zorder=5)
    ax.scatter(*points.T, s=14, c=colors, edgecolors=_INK, linewidths=0.6, zorder=6, clip_on=False)
    ax.plot(*goal, "*", ms=10, mfc="white", mec=_INK, mew=0.8, zorder=7)


def _draw_errors(ax: Axes, plr: PLR) -> ScalarMappable:
    errors = widest_bounds(plr)
    norm = LogNorm(errors.min(), errors.max())
    cells = PolyCollection(
        list(_boxes(plr)), array=errors, cmap=_ERROR_COLORS, norm=norm, edgecolors="#888888", linewidths=0.15
    )
    ax.add_collection(cells)
    return cells
