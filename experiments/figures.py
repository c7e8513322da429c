"""The picture of README.md, and figures 1 to 3 of the paper: a surface, error maps in the maze, paths of teams.

Error maps have a row for each oracle, as in the paper: (a) the visibility graph, (b) PRM*. A column for each
configuration: the paper's (axes in turn, depth 9) and the default at 2,048 bytes. All share one logarithmic scale of
colors. Paths are those of three discs in the cross, in two halves, and of two rectangles in the tangle.

The picture of README.md shows distances and a path in the maze, proven bounds along a line, and a moment of a team's
film.
"""

import base64
import math
from pathlib import Path
from typing import Any, cast

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from mpl_toolkits.mplot3d.axes3d import Axes3D

from experiments._planning import PLR_BYTES, SCENES, SMOKE_BYTES, solved_scene
from experiments._runner import Section, run
from experiments.table1 import NUM_ROADMAP_SAMPLES, papers_own
from plr_jax import PLR, Box, Euclidean, Roadmap, VisibilityGraph, Workspace, construct, metrics, plot, scenes, trace
from plr_jax.plr import from_bytes

DEPTH_OF_SURFACE = 6
MAX_BYTES = 2_048
RESOLUTION = 256  # points of error maps along each axis
PATHS = (
    ("cross 3", 0.0, 0.5, "three discs in the cross, first half"),
    ("cross 3", 0.5, 1.0, "second half"),
    ("tangle", 0.0, 1.0, "two rectangles change places in the hallway"),
)
CONE_BYTES, SECTION_BYTES = 1_024, 200  # of the picture of README.md; bounds of small files are wide enough to see
START, SECTION_X = (0.93, 0.93), 0.55
TEAM, MOMENT = "four rooms 4", 0.55  # share of the film


def surface(seed: int, smoke: bool) -> dict[str, Any]:
    """The Euclidean distance to the origin, by planes."""
    domain, oracle = Box((0.0, 0.0), (1.0, 1.0)), Euclidean((0.0, 0.0))
    options, *_ = papers_own(4 if smoke else DEPTH_OF_SURFACE).values()
    plr = construct(oracle, domain, seed=seed, **options)
    report = metrics.error_map(plr, oracle, domain.grid(64 if smoke else 1024).reshape(-1, 2))
    row = {"leaves": plr.num_leaves, "bytes": plr.num_bytes, "max": report.max, "mean": report.mean}
    return row | {"plr": as_text(plr)}


def draw_surface(results: dict[str, Any], output: Path) -> list[Path]:
    # 1. Raise the corners of each leaf to its values, by points just inside of the corners; color by the mean height.
    plr = of_text(results["plr"])
    lo, hi = (np.asarray(corner) for corner in plr.leaf_boxes)
    corners = lo[:, None] + np.array([(0, 0), (1, 0), (1, 1), (0, 1)]) * (hi - lo)[:, None]
    inside = corners + 1e-3 * ((lo + hi)[:, None] / 2 - corners)
    polygons = np.concatenate([corners, np.asarray(plr(inside))[..., None]], axis=2)  # (leaves, 4, 3)
    heights = polygons[..., 2].mean(axis=1)
    colors = ScalarMappable(Normalize(0.0, heights.max()), "viridis")
    # 2. Draw them.
    figure = Figure(figsize=(6.2, 4.6), dpi=200, facecolor="white")
    ax = cast(Axes3D, figure.add_axes((0.07, 0.08, 0.68, 0.86), projection="3d"))
    ax.add_collection3d(Poly3DCollection(polygons, facecolors=colors.to_rgba(heights), edgecolors="#0006", lw=0.3))
    ax.set(xlim=(0, 1), ylim=(0, 1), zlim=(0, polygons[..., 2].max()), xlabel="x", ylabel="y")
    ax.set_box_aspect((1, 1, 0.7))
    ax.view_init(elev=32, azim=-125)
    figure.colorbar(colors, cax=figure.add_axes((0.86, 0.2, 0.025, 0.6)), label="distance to the goal")
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


def overview(seed: int, smoke: bool) -> dict[str, Any]:
    """The PLR of the README's first example, a smaller one with bounds of each leaf, and a team's path."""
    workspace, exact = maze()
    limits = {"distance_fn": exact, "domain": workspace.bounds}
    cones = construct(**limits, leaf="cone", max_bytes=300 if smoke else CONE_BYTES, certified=True)
    planes = construct(**limits, max_bytes=SECTION_BYTES, certified="leaves")
    results: dict[str, Any] = {name: as_text(plr) for name, plr in (("cones", cones), ("planes", planes))}
    results |= {"path": trace(cones, np.array([START])).paths[0].tolist()}
    return results | {"team": solved_scene(TEAM, SMOKE_BYTES if smoke else PLR_BYTES)}


def draw_overview(results: dict[str, Any], output: Path) -> list[Path]:
    (workspace, exact), cones, planes = maze(), of_text(results["cones"]), of_text(results["planes"])
    # Three squares; the first has a color bar to its right. All sizes are in inches.
    width, height, side, bottom = 9.75, 3.4, 2.85, 0.25
    figure = Figure(figsize=(width, height), dpi=190, facecolor="white")
    lefts = (0.06, 3.88, 6.84)
    squares = [(left / width, bottom / height, side / width, side / height) for left in lefts]
    field, section, team = map(figure.add_axes, squares)
    # 1. The field, a path, and the line of the section.
    plot.plot_contours(cones, field, workspace=workspace, goal=exact.goal)
    field.plot(*np.transpose(results["path"]), color="black", linewidth=3.4, zorder=3.5)
    field.plot(*np.transpose(results["path"]), color="white", linewidth=1.8, zorder=3.6)
    field.plot(*START, "o", color="white", markeredgecolor="black", zorder=5)
    field.axvline(SECTION_X, color="black", linestyle=(0, (4, 3)), linewidth=1.1, zorder=2.8)
    field.set(xticks=[], yticks=[], xlabel="", ylabel="")
    field.child_axes[0].set_ylabel("")  # of the color bar
    field.set_title(f"Distance and path, {cones.num_bytes:,} bytes", fontsize=11)
    # 2. Bounds along the line, with gaps at walls.
    y = np.linspace(workspace.bounds.lo[1], workspace.bounds.hi[1], 2001)
    points = np.column_stack([np.full_like(y, SECTION_X), y])
    is_free = workspace.is_free(points)
    lower, upper = (np.where(is_free, bound, np.nan) for bound in planes.numpy().bounds(points))
    truth = np.where(is_free, exact(points), np.nan)
    section.fill_between(y, lower, upper, color="#f2a65a", label="between proven bounds", linewidth=0)
    section.plot(y, truth, color="black", linewidth=1.4, label="exact distance")
    section.fill_between(y, 0, 1, where=~is_free, transform=section.get_xaxis_transform(), color="#ececec")
    section.set(xlim=(0, 1), xticks=[0, 1], ylim=(0, None), yticks=[0, 1, 2])
    section.set_xlabel("up the dashed line", fontsize=9.5, labelpad=-8)
    section.set_ylabel("distance to the goal", fontsize=9.5)
    section.tick_params(labelsize=9)
    section.legend(loc="upper left", fontsize=9, framealpha=1, edgecolor="white")
    proven = math.ceil(1e5 * (cones.max_error or 0.0)) / 1e5  # rounded up
    words = f"Of the file at left:\ndistance ± {proven:g}"
    section.text(0.96, 0.06, words, transform=section.transAxes, ha="right", fontsize=9, backgroundcolor="white")
    section.set_title(f"Proven bounds, {planes.num_bytes} bytes", fontsize=11)
    # 3. The team in the middle of its film.
    plot.plot_path(SCENES[TEAM](), results["team"]["path"], team, end=MOMENT, num_poses=6)
    team.set(xticks=[], yticks=[], xlabel="", ylabel="")
    team.set_title("A moment of a team's film", fontsize=11)
    figure.savefig(path := output / "overview.png")
    return [path]


SECTIONS = {
    "surface": Section(surface, draw_surface),
    "error_maps": Section(error_maps, draw_error_maps),
    "paths": Section(paths, draw_paths),
    "overview": Section(overview, draw_overview),
}

if __name__ == "__main__":
    run("figures", __doc__, SECTIONS)
