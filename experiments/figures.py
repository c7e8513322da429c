"""Figures 1 to 3 of the paper: a PLR as a surface, error maps of PLRs in the maze, paths of teams.

Error maps have a row for each oracle, as in the paper: (a) the visibility graph, (b) PRM*. A column for each
configuration: the paper's (axes in turn, depth 9) and the default at 2,048 bytes. All share one logarithmic scale of
colors. Paths are those of three discs in the cross, in two halves, and of two rectangles in the tangle.
"""

import base64
from pathlib import Path
from typing import Any, cast

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from experiments._planning import PLR_BYTES, SCENES, SMOKE_BYTES, solved_scene
from experiments._runner import Section, run
from experiments.table1 import NUM_ROADMAP_SAMPLES, papers_own
from plr_jax import PLR, Box, Euclidean, Roadmap, VisibilityGraph, Workspace, construct, metrics, plot, scenes
from plr_jax.plr import from_bytes

DEPTH_OF_SURFACE = 6
MAX_BYTES = 2_048
RESOLUTION = 256  # points of error maps along each axis
PATHS = (
    ("cross 3", 0.0, 0.5, "three discs in the cross, first half"),
    ("cross 3", 0.5, 1.0, "second half"),
    ("tangle", 0.0, 1.0, "two rectangles change places in the hallway"),
)


def surface(seed: int, smoke: bool) -> dict[str, Any]:
    """The Euclidean distance to the origin, by planes."""
    domain, oracle = Box((0.0, 0.0), (1.0, 1.0)), Euclidean((0.0, 0.0))
    options, *_ = papers_own(4 if smoke else DEPTH_OF_SURFACE).values()
    plr = construct(oracle, domain, seed=seed, **options)
    report = metrics.error_map(plr, oracle, domain.grid(64 if smoke else 1024).reshape(-1, 2))
    row = {"leaves": plr.num_leaves, "bytes": plr.num_bytes, "max": report.max, "mean": report.mean}
    return row | {"plr": as_text(plr)}


def draw_surface(results: dict[str, Any], output: Path) -> list[Path]:
    ax = plot.plot_surface(of_text(results["plr"]))
    ax.set_title(
        f"{results['leaves']} planes, {results['bytes']:,} bytes: max error {results['max']:.2g}, "
        f"mean {results['mean']:.2g}",
        fontsize=9,
    )
    path = output / "fig1.png"
    plot.save(ax, path)
    return [path]


def error_maps(seed: int, smoke: bool) -> dict[str, Any]:
    """PLRs of two oracles in two configurations, each with its errors on a grid."""
    workspace, exact = maze()
    roadmap = Roadmap.from_workspace(workspace, exact.goal, 200 if smoke else NUM_ROADMAP_SAMPLES, seed=seed)
    own, *_ = papers_own(5 if smoke else 9).values()
    configurations = {"axes in turn, depth 9": own, "best axis": {"max_bytes": 256 if smoke else MAX_BYTES}}
    panels = []
    for label, oracle in (("(a) visibility graph", exact), ("(b) PRM*", roadmap)):
        for configuration, limits in configurations.items():
            plr = construct(oracle, workspace.bounds, seed=seed, **limits)
            errors = metrics.error_grid(plr, exact, workspace, resolution=RESOLUTION)
            panel = {"oracle": label, "configuration": configuration, "bytes": plr.num_bytes, "plr": as_text(plr)}
            panels.append(panel | {"max": float(np.nanmax(errors)), "mean": float(np.nanmean(errors))})
    return {"panels": panels}


def draw_error_maps(results: dict[str, Any], output: Path) -> list[Path]:
    workspace, exact = maze()
    lo, hi = workspace.bounds.lo, workspace.bounds.hi
    figure = Figure(figsize=(7.8, 6.6), dpi=90, facecolor="white", layout="constrained")
    axes = figure.subplots(2, 2, sharex=True, sharey=True)
    for ax, panel in zip(axes.flat, results["panels"], strict=True):
        errors = metrics.error_grid(of_text(panel["plr"]), exact, workspace, resolution=RESOLUTION)
        image = ax.imshow(
            np.ma.masked_invalid(errors),
            origin="lower",
            extent=(lo[0], hi[0], lo[1], hi[1]),
            cmap="inferno",
            norm=LogNorm(1e-5, 1e-1),
            interpolation="nearest",
        )
        plot.plot_workspace(workspace, ax)
        numbers = f"{panel['bytes']:,} bytes, max {panel['max']:.2g}, mean {panel['mean']:.2g}"
        ax.set_title(f"{panel['oracle']}, {panel['configuration']}\n{numbers}", fontsize=8)
    figure.colorbar(image, ax=axes, extend="both", label="error $|L - V|$ against the exact distance")
    path = output / "fig2.png"
    figure.savefig(path)
    return [path]


def maze() -> tuple[Workspace, VisibilityGraph]:
    problem = scenes.maze()
    return problem.workspace, VisibilityGraph(problem.workspace, problem.goals[0])


def as_text(plr: PLR) -> str:
    return base64.b64encode(plr.to_bytes()).decode("ascii")


def of_text(text: str) -> PLR:
    return cast(PLR, from_bytes(base64.b64decode(text)))


def paths(seed: int, smoke: bool) -> dict[str, Any]:
    """Both scenes as published; nothing here is random."""
    names = dict.fromkeys(name for name, *_ in PATHS)
    plr_bytes = SMOKE_BYTES if smoke else PLR_BYTES
    return {"plr_bytes": plr_bytes, "paths": {name: solved_scene(name, plr_bytes) for name in names}}


def draw_paths(results: dict[str, Any], output: Path) -> list[Path]:
    figure = Figure(figsize=(12.4, 3.9), layout="constrained", facecolor="white")
    axes = figure.subplots(1, len(PATHS), width_ratios=[1.0, 1.0, 1.25])
    for ax, (name, begin, end, title) in zip(axes, PATHS, strict=True):
        plot.plot_path(SCENES[name](), results["paths"][name]["path"], ax, begin=begin, end=end, num_poses=10)
        ax.set_title(title, fontsize=10)
    path = output / "fig3.png"
    plot.save(axes[0], path)
    return [path]


SECTIONS = {
    "surface": Section(surface, draw_surface),
    "error_maps": Section(error_maps, draw_error_maps),
    "paths": Section(paths, draw_paths),
}

if __name__ == "__main__":
    run("figures", __doc__, SECTIONS)
