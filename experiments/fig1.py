"""Fig. 1 of the paper: a PLR of the Euclidean distance to the origin, as a surface."""

import base64
from pathlib import Path
from typing import Any

from experiments._runner import run
from plr_jax import (
    PLR,
    Box,
    BuildOptions,
    Euclidean,
    construct,
    cyclic_axis,
    from_bytes,
    maximum_depth,
    metrics,
    plot,
)

DEPTH = 6


def compute(seed: int, smoke: bool) -> dict[str, Any]:
    domain = Box((0.0, 0.0), (1.0, 1.0))
    oracle = Euclidean((0.0, 0.0))
    options = BuildOptions(should_split=maximum_depth, split=cyclic_axis)
    plr = construct(oracle, domain, max_depth=4 if smoke else DEPTH, seed=seed, options=options)
    points = domain.grid(64 if smoke else 1024).reshape(-1, 2)
    report = metrics.error_map(plr, oracle, points)
    return {
        "leaves": plr.num_leaves,
        "bytes": plr.num_bytes,
        "points": report.num_points,
        "max": report.max,
        "mean": report.mean,
        "plr_base64": base64.b64encode(plr.to_bytes()).decode("ascii"),
    }


def draw(results: dict[str, Any], output: Path) -> list[Path]:
    plr = from_bytes(base64.b64decode(results["plr_base64"]))
    assert isinstance(plr, PLR)
    ax = plot.plot_surface(plr)
    ax.set_title(
        f"{results['leaves']} planes, {results['bytes']:,} bytes: max error {results['max']:.2g}, "
        f"mean {results['mean']:.2g}",
        fontsize=9,
    )
    path = output / "fig1.png"
    plot.save(ax, path)
    return [path]


if __name__ == "__main__":
    run("fig1", "Surface of a PLR of the Euclidean distance to the origin.", compute, draw)
