"""Paths from PLRs by descent: how many reach the goal, how long they are, and whether one crosses a wall.

On each map and for each size, paths start at random free points. Lengths are compared with the exact distances. An
independent check by Shapely looks for paths that cross a wall. A field that is zero everywhere shows what descent
reaches without guidance.
"""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from experiments._runner import run
from experiments.benchmarks._maps import load_maps
from plr_jax import PLR, Descent, VisibilityGraph, Workspace, construct, descend, plot

START_SEED = 1_000
# Bytes of the PLRs of each map. The largest is drawn.
SIZES = {"maze": [2_048, 6_144], "thin_maze": [2_048, 6_144], "arena": [6_144, 16_384], "den312d": [6_144]}
_LEAVES = ("plane", "continuous", "smooth")
DRAWN = ("maze", "arena")
NUM_DRAWN = 40
_PATH_COLOR = "#D55E00"


def compute(seed: int, smoke: bool) -> dict[str, Any]:
    num_starts, num_runs = (10, 1) if smoke else (10_000, 15)
    sizes = {"maze": [512]} if smoke else SIZES
    results = []
    for name, (workspace, goal) in load_maps(sizes).items():
        exact = VisibilityGraph(workspace, goal)
        starts = workspace.sample_free(num_starts, START_SEED + seed)
        distance = exact(starts)
        blind = _measure_descent(lambda x: np.zeros(len(x)), workspace, starts, goal, distance, num_runs)
        rows, plr = [], None
        for max_bytes in sizes[name]:
            for leaf in _LEAVES[::2] if smoke else _LEAVES:
                field = construct(exact, workspace.bounds, leaf=leaf, max_bytes=max_bytes, seed=seed)
                row = _measure_descent(field, workspace, starts, goal, distance, num_runs)
                if leaf == "plane":
                    plr = field
                rows.append({"budget": max_bytes, "leaf": leaf, "bytes": field.num_bytes, **row})
        assert plr is not None
        entry = {"map": name, "without_field": blind, "rows": rows}
        results.append({**entry, "picture": _picture(plr, workspace, goal, starts) if name in DRAWN else None})
    return {"starts": num_starts, "maps": results}


def _measure_descent(
    field: Callable,
    workspace: Workspace,
    starts: Float[np.ndarray, "n 2"],
    goal: Float[np.ndarray, "2"],
    distance: Float[np.ndarray, " n"],
    num_runs: int,
) -> dict[str, Any]:
    descent = descend(field, workspace, starts, goal)  # compiles the field's query
    seconds = []
    for _ in range(num_runs):
        begin = time.perf_counter()
        descend(field, workspace, starts, goal)
        seconds.append(time.perf_counter() - begin)
    ratio = descent.lengths[descent.reached] / distance[descent.reached]
    return {
        "reached": float(descent.reached.mean()),
        "crossings": _count_crossings(descent, workspace),
        "ratio": {
            "median": float(np.median(ratio)),
            "99 %": float(np.quantile(ratio, 0.99)),
            "max": float(ratio.max()),
        },
        "seconds": {"median": float(np.median(seconds)), "min": min(seconds)},
    }


def _count_crossings(descent: Descent, workspace: Workspace) -> int:
    """Paths that go through an obstacle or leave the bounds, rounding aside: by Shapely, from the obstacles."""
    obstacles = shapely.union_all(workspace.obstacles)
    region = shapely.box(*workspace.bounds.lo, *workspace.bounds.hi)
    blocked = shapely.union_all([obstacles, shapely.buffer(region, 1.0, join_style="mitre").difference(region)])
    core = shapely.buffer(blocked, -2 * workspace.tolerance, join_style="mitre")
    shapely.prepare(core)
    rows = np.flatnonzero(descent.counts > 1)
    paths: Any = shapely.linestrings(descent.vertices[rows])
    return int(shapely.intersects(core, paths).sum())


def _picture(
    plr: PLR, workspace: Workspace, goal: Float[np.ndarray, "2"], starts: Float[np.ndarray, "n 2"]
) -> dict[str, Any]:
    """Return what is drawn of a map: free space, the goal and some paths."""
    paths = descend(plr, workspace, starts[:NUM_DRAWN], goal).paths
    return {
        "bytes": plr.num_bytes,
        "goal": goal.tolist(),
        "free_space": shapely.to_wkt(workspace.free_space, rounding_precision=9),
        "paths": [np.round(path, 4).tolist() for path in paths],
    }


def draw(results: dict[str, Any], output: Path) -> list[Path]:
    drawn = [entry for entry in results["maps"] if entry["picture"] is not None]
    figure = Figure(figsize=(5.2 * len(drawn), 5.4), dpi=100, facecolor="white", layout="constrained")
    for ax, entry in zip(np.atleast_1d(figure.subplots(1, len(drawn))), drawn, strict=True):
        _draw_map(ax, entry)
    path = output / "descent.png"
    figure.savefig(path)
    return [path]


def _draw_map(ax: Axes, entry: dict[str, Any]) -> None:
    picture = entry["picture"]
    row = [row for row in entry["rows"] if row["leaf"] == "plane"][-1]
    parts: Any = shapely.get_parts(shapely.from_wkt(picture["free_space"]))
    rings = [{"outer": part.exterior.coords, "holes": [hole.coords for hole in part.interiors]} for part in parts]
    plot.plot_workspace(Workspace.from_polygons(rings), ax)
    ax.add_collection(LineCollection(picture["paths"], colors=_PATH_COLOR, linewidths=1.0, alpha=0.75, zorder=4))
    begins = np.array([path[0] for path in picture["paths"]])
    ax.plot(*begins.T, "o", ms=3, color=_PATH_COLOR, zorder=5)
    ax.plot(*picture["goal"], "*", ms=12, mfc="white", mec="black", zorder=6)
    ax.set_title(
        f"{entry['map']}, {picture['bytes']:,} bytes: {row['reached']:.1%} reach the goal, "
        f"{row['ratio']['median']:.3f} times as long",
        fontsize=8,
    )


if __name__ == "__main__":
    run("descent", __doc__, compute, draw)
