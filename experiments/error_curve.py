"""Error against bytes: PLRs of cones and of planes, by rule and coefficients, a bilinear grid, LightGBM's trees.

All are measured over the same random free points against the exact distance. What each rival is given:

- The bilinear grid (SciPy's ``RegularGridInterpolator``) has as many float32 nodes as fit, spread in proportion to
  the sides of the map. A node in an obstacle takes the value of the nearest free node.
- LightGBM's linear trees get as many oracle samples, at random free points, as the default PLR of those bytes used.
  LightGBM gives the leaves of its first tree no slope, so that tree is a stump, and all other leaves hold planes.
  One, two and four trees after the stump are tried, each with as many leaves as fit, and the ones of the smallest
  mean error are kept. Bytes are counted as if packed into 17 a leaf (axis, float32 threshold, three float32
  coefficients), a fraction of the text that LightGBM saves; the results file has the bytes of that text too.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.interpolate import RegularGridInterpolator
from scipy.ndimage import distance_transform_edt
from tqdm import tqdm

from experiments._runner import run
from experiments.benchmarks._accuracy import label_ends
from experiments.benchmarks._maps import load_maps
from experiments.benchmarks._rivals import NUM_TREES, leaves_that_fit, train_linear_trees
from plr_jax import VisibilityGraph, Workspace, best_axis, construct, cyclic_axis, metrics
from plr_jax.plr import Plane

POINT_SEED, TRAINING_SEED = 1_000, 2_000
_MAPS = ("maze", "thin_maze", "arena")
_PLANES = {
    f"PLR, {rule}, {coefficients}": {"split": split, "leaf": Plane(coefficient_bits=bits)}
    for rule, split in (("best axis", best_axis), ("axes in turn", cyclic_axis))
    for coefficients, bits in (("chosen bits", None), ("16-bit", 16), ("float32", 32))
}
_PLRS: dict[str, dict[str, Any]] = {**_PLANES, "PLR, cones": {"leaf": "cone"}}
_STYLES = {
    "PLR, cones": ("#0072B2", "-", "*", "PLR, cones"),
    "PLR, best axis, chosen bits": ("#0072B2", "-", "o", "PLR (default)"),
    "PLR, best axis, float32": ("#0072B2", "--", "o", "PLR, float32"),
    "PLR, axes in turn, chosen bits": ("#009E73", "-", "^", "PLR, axes in turn"),
    "LightGBM linear trees": ("#D55E00", "-", "s", "LightGBM linear trees"),
    "bilinear grid": ("#444444", "-", "D", "bilinear grid"),
}
_LABEL_HEIGHT = 0.085

Approximation = Callable[[Float[np.ndarray, "n dim"]], Any]


def compute(seed: int, smoke: bool) -> dict[str, Any]:
    budgets = [256, 512] if smoke else [512 * 2**doubling for doubling in range(7)]
    num_points = 1_000 if smoke else 500_000
    maps = load_maps(_MAPS[:1] if smoke else _MAPS)
    curves = {
        name: _measure_map(workspace, goal, budgets, num_points, seed) for name, (workspace, goal) in maps.items()
    }
    return {"points": num_points, "budgets": budgets, "curves": curves}


def _measure_map(
    workspace: Workspace, goal: Float[np.ndarray, "2"], budgets: list[int], num_points: int, seed: int
) -> dict[str, list[dict[str, Any]]]:
    """For each contender its bytes and errors at every budget."""
    exact = VisibilityGraph(workspace, goal)
    x = workspace.sample_free(num_points, POINT_SEED + seed)
    distance = exact(x)
    curves: dict[str, list[dict[str, Any]]] = {}

    def record(name: str, num_bytes: int, approximation: Approximation) -> None:
        report = metrics.error_map(approximation, lambda _: distance, x)
        row = {
            "bytes": num_bytes,
            "max": report.max,
            "mean": report.mean,
            "quantile_99": report.quantiles[0.99],
            "unanswered": report.num_unanswered,
        }
        curves.setdefault(name, []).append(row)

    for budget in tqdm(budgets, desc="budgets", disable=None):
        num_samples = 0

        def counted(x: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n"]:
            nonlocal num_samples
            num_samples += len(x)
            return exact(x)

        for name, options in _PLRS.items():
            default = name == next(iter(_PLANES))
            plr = construct(counted if default else exact, workspace.bounds, max_bytes=budget, seed=seed, **options)
            record(name, plr.num_bytes, plr)
        grid = bilinear_grid(workspace, exact, budget)
        record("bilinear grid", 4 * grid.values.size, grid)
        x_train = workspace.sample_free(num_samples, TRAINING_SEED + seed)
        at_train = exact(x_train)
        trees = [
            train_linear_trees(x_train, at_train, leaves_that_fit(budget, number), number, seed)
            for number in NUM_TREES
        ]
        best = min(trees, key=lambda booster: np.abs(booster.predict(x) - distance).mean())
        record("LightGBM linear trees", budget, best.predict)
        curves["LightGBM linear trees"][-1]["bytes_as_saved"] = len(best.model_to_string())
    return curves


def bilinear_grid(workspace: Workspace, exact: VisibilityGraph, num_bytes: int) -> RegularGridInterpolator:
    """A float32 grid of so many bytes; nodes in obstacles take the value of the nearest free node."""
    bounds = workspace.bounds
    shape = np.floor(np.sqrt(num_bytes / 4 * bounds.width / bounds.width[::-1])).astype(int)
    axes = [np.linspace(lo, hi, n) for lo, hi, n in zip(bounds.lo, bounds.hi, shape, strict=True)]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    values = exact(nodes.reshape(-1, 2)).reshape(shape)
    spacing = bounds.width / (shape - 1)
    _, nearest = cast(tuple, distance_transform_edt(~np.isfinite(values), spacing, return_indices=True))
    return RegularGridInterpolator(axes, values[tuple(nearest)].astype(np.float32))


def draw(results: dict[str, Any], output: Path) -> list[Path]:
    """Mean and largest error against bytes, one column a map, each line labeled at the right."""
    curves = results["curves"]
    figure = Figure(figsize=(2.9 * len(curves) + 1.6, 5.2), layout="constrained", facecolor="white")
    axes = figure.subplots(2, len(curves), sharex=True, squeeze=False)
    for column, (name, contenders) in enumerate(curves.items()):
        for row, error in enumerate(("mean", "max")):
            _draw_curves(axes[row, column], contenders, error)
        axes[0, column].set_title(name.replace("_", " "), fontsize=11)
        axes[1, column].set_xlabel("bytes")
    axes[0, 0].set_ylabel("mean error (workspace units)", fontsize=9)
    axes[1, 0].set_ylabel("largest error (workspace units)", fontsize=9)
    last = {name: next(reversed(curves.values()))[name][-1] for name in _STYLES}
    for row, error in enumerate(("mean", "max")):
        ends = [
            (label, last[name]["bytes"], last[name][error], color) for name, (color, *_, label) in _STYLES.items()
        ]
        label_ends(axes[row, -1], ends, _LABEL_HEIGHT)
    path = output / "error_curve.png"
    figure.savefig(path, dpi=150)
    return [path]


def _draw_curves(ax: Axes, contenders: dict[str, list[dict[str, Any]]], error: str) -> None:
    for name, (color, line, marker, _) in _STYLES.items():
        rows = contenders[name]
        x, y = [row["bytes"] for row in rows], [row[error] for row in rows]
        ax.loglog(x, y, line, color=color, marker=marker, ms=4, lw=1.5)
    ax.grid(True, which="major", color="#dddddd", lw=0.6)
    ax.set_xticks([512, 2048, 8192, 32768], ["512", "2,048", "8,192", "32,768"])
    ax.minorticks_off()
    ax.spines[["top", "right"]].set_visible(False)


if __name__ == "__main__":
    run("error_curve", "Error against bytes, beside a bilinear grid and LightGBM's linear trees.", compute, draw)
