"""Fig. 2 of the paper: where on the maze a PLR errs, built from the exact distance and from a roadmap.

A row for each oracle, as in the paper: (a) the visibility graph, (b) PRM*. A column for each configuration: the
paper's (axes in turn, depth 9) and the default at 2,048 bytes. All four share one logarithmic scale of colors.
"""

import base64
import io
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib import colormaps
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from PIL import Image

from experiments._runner import run
from plr_jax import (
    BuildOptions,
    Roadmap,
    VisibilityGraph,
    Workspace,
    construct,
    cyclic_axis,
    maximum_depth,
    metrics,
    plot,
    scenes,
)

MAX_BYTES = 2_048
# Errors are stored as 8-bit logarithms, steps of 3.7 %: as fine as the colors of the picture.
SMALLEST, LARGEST = 1e-5, 1e-1
COLORS = "inferno"
_LEVELS = 255
_BLANK = 255


def compute(seed: int, smoke: bool) -> dict[str, Any]:
    problem = scenes.maze()
    workspace, goal = problem.workspace, problem.goals[0]
    exact = VisibilityGraph(workspace, goal)
    roadmap = Roadmap.from_workspace(workspace, goal, 200 if smoke else 10_000, seed=seed)
    resolution = 24 if smoke else 256
    panels = []
    for label, oracle in (("(a) visibility graph", exact), ("(b) PRM*", roadmap)):
        paper = construct(
            oracle,
            workspace.bounds,
            max_depth=5 if smoke else 9,
            seed=seed,
            options=BuildOptions(should_split=maximum_depth, split=cyclic_axis),
        )
        ours = construct(oracle, workspace.bounds, max_bytes=256 if smoke else MAX_BYTES, seed=seed)
        for configuration, plr in (("axes in turn, depth 9", paper), ("best axis", ours)):
            errors = metrics.error_grid(plr, exact, workspace, resolution=resolution)
            panels.append(
                {
                    "oracle": label,
                    "configuration": configuration,
                    "bytes": plr.num_bytes,
                    "max": float(np.nanmax(errors)),
                    "mean": float(np.nanmean(errors)),
                    "errors": encode_grid(errors),
                }
            )
    return {"scene": "maze", "resolution": resolution, "panels": panels}


def encode_grid(errors: Float[np.ndarray, "rows columns"]) -> str:
    """Errors as text; NaN stays blank, and what is off the scale of colors goes to its end."""
    share = np.log(np.clip(errors, SMALLEST, LARGEST) / SMALLEST) / np.log(LARGEST / SMALLEST)
    levels = np.where(np.isnan(errors), _BLANK, np.rint((_LEVELS - 1) * np.nan_to_num(share)))
    return base64.b64encode(zlib.compress(levels.astype(np.uint8).tobytes(), 9)).decode("ascii")


def decode_grid(text: str, resolution: int) -> Float[np.ndarray, "rows columns"]:
    """Inverse of :func:`encode_grid` for a square grid."""
    levels = np.frombuffer(zlib.decompress(base64.b64decode(text)), np.uint8).reshape(resolution, resolution)
    errors = SMALLEST * (LARGEST / SMALLEST) ** (levels / (_LEVELS - 1))
    return np.where(levels == _BLANK, np.nan, errors)


def draw(results: dict[str, Any], output: Path) -> list[Path]:
    workspace = getattr(scenes, results["scene"])().workspace
    figure = Figure(figsize=(6.6, 6.5), dpi=130, facecolor="white")
    axes = figure.subplots(
        2, 2, gridspec_kw=dict(left=0.075, right=0.86, bottom=0.07, top=0.95, wspace=0.1, hspace=0.2)
    )
    for ax, panel in zip(axes.flat, results["panels"], strict=True):
        image = _draw_panel(ax, panel, workspace, results["resolution"])
    for ax in axes[0]:
        ax.set_xlabel("")
        ax.tick_params(labelbottom=False)
    for ax in axes.flat:
        ax.set_xticks(np.linspace(0, 1, 6), ["0", "0.2", "0.4", "0.6", "0.8", "1"])
    for ax in axes[:, 1]:
        ax.set_ylabel("")
        ax.tick_params(labelleft=False)
    bar = figure.colorbar(image, cax=figure.add_axes((0.885, 0.07, 0.022, 0.88)), extend="both")
    bar.set_label("error $|L - V|$ against the exact distance", fontsize=9)
    bar.ax.tick_params(labelsize=8)
    path = output / "fig2.png"
    _save_with_palette(figure, path)
    return [path]


def _save_with_palette(figure: Figure, path: Path) -> None:
    """Write a PNG in the colors of the color map and grays alone: a third of the bytes of full color."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    ramps = [colormaps[name].resampled(size)(range(size)) for name, size in ((COLORS, 224), ("gray", 32))]
    palette = Image.new("P", (1, 1))
    palette.putpalette(np.rint(255 * np.concatenate(ramps)[:, :3]).astype(np.uint8).tobytes())
    picture = Image.open(buffer).convert("RGB").quantize(palette=palette, dither=Image.Dither.NONE)
    picture.save(path, optimize=True)


def _draw_panel(ax, panel: dict[str, Any], workspace: Workspace, resolution: int):
    lo, hi = workspace.bounds.lo, workspace.bounds.hi
    image = ax.imshow(
        np.ma.masked_invalid(decode_grid(panel["errors"], resolution)),
        origin="lower",
        extent=(lo[0], hi[0], lo[1], hi[1]),
        cmap=COLORS,
        norm=LogNorm(SMALLEST, LARGEST),
        interpolation="nearest",
    )
    plot.plot_workspace(workspace, ax)
    ax.set_title(
        f"{panel['oracle']}, {panel['configuration']}\n"
        f"{panel['bytes']:,} bytes, max {panel['max']:.2g}, mean {panel['mean']:.2g}",
        fontsize=8,
    )
    return image


if __name__ == "__main__":
    run("fig2", "Error maps of PLRs on the maze: two oracles, two configurations, one scale.", compute, draw)
