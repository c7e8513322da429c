"""Error at equal bytes: PLRs and other methods that can hold a distance function, map by map.

Errors are over random free points, and over those near walls, with a clearance below 1 % of the map's smaller side.
What each method is given:

- PLRs of cones, of planes and of continuous leaves: a budget of bytes. They query the oracle as often as they like.
  These queries are counted, except for cones, which ask what whole cells see.
- Coded grid, linear trees, network: as many samples, at random free points, as the PLR of planes asked for, up to
  half a million (``samples`` in the results, with the nodes of all grids).
- Coded grid: distances at nodes, rounded to multiples of a step, predicted from their neighbors and compressed by
  LZMA. Of 41 numbers of nodes, that of least error at the samples is kept. Nodes in obstacles take the value of the
  nearest free node.
- Linear trees: one, two or four, whichever fit the samples best. The network is trained for 40,000 steps and stored
  in 16-bit floats. There is none at the largest budget, where this would take minutes.
- scikit-fmm: its own field, at nodes that fill the bytes; it asks no oracle. Its nodes in obstacles hold no number,
  so points beside them get no answer.

A loaded PLR takes more memory than its file. So beside each PLR, a grid of 32-bit numbers is measured that fills
the memory of the loaded PLR. Seconds of building exclude the oracle's, except for cones, whose builder calls the
exact distance itself.
"""

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from tqdm import tqdm

from experiments.benchmarks._maps import load_map
from experiments.benchmarks._rivals import (
    NUM_STEPS,
    Rival,
    best_linear_trees,
    coded_grid,
    filled_grid,
    make_all,
    scipy_grid,
    train_network,
    travel_time_grid,
)
from plr_jax import VisibilityGraph, Workspace, construct


def _label_ends(ax: Axes, ends: list[tuple[str, float, float, str]], spacing: float) -> None:
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
        arrow = {"arrowstyle": "-", "color": color, "lw": 0.5, "shrinkA": 1, "shrinkB": 3}
        style: dict[str, Any] = {"textcoords": "axes fraction", "va": "center", "fontsize": 9, "arrowprops": arrow}
        ax.annotate(label, (x, y), (1.06, height), color=color, **style)


# Mean error against bytes, one panel a map.

_STYLES = {
    "PLR, cones": ("#0072B2", "-", "*"),
    "PLR, planes": ("#0072B2", "-", "o"),
    "PLR, continuous": ("#0072B2", "--", "o"),
    "coded grid": ("#444444", "-", "D"),
    "LightGBM linear trees": ("#D55E00", "-", "s"),
    "network, 16-bit": ("#E69F00", "-", "P"),
    "scikit-fmm": ("#56B4E9", ":", "X"),
}
_LABEL_HEIGHT = 0.06


def draw(results: dict[str, Any], output: Path) -> list[Path]:
    """Draw a panel for each map; the lines are labeled at the right of the last panel."""
    maps = results["maps"]
    figure = Figure(figsize=(2.7 * len(maps) + 2.0, 4.2), layout="constrained", facecolor="white")
    panels = figure.subplots(1, len(maps), squeeze=False)[0]
    for ax, (name, rows) in zip(panels, maps.items(), strict=True):
        _draw_map(ax, rows)
        ax.set_title(name.replace("_", " "), fontsize=11)
        ax.set_xlabel("bytes")
    panels[0].set_ylabel("mean error (workspace units)")
    _label_ends(panels[-1], _ends(list(maps.values())[-1]), _LABEL_HEIGHT)
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
    """Return label, end and color of each line."""
    last = {row["contender"]: row for row in rows if row["contender"] in _STYLES and row["free"]["mean"]}
    return [(name, row["bytes"], row["free"]["mean"], _STYLES[name][0]) for name, row in last.items()]


POINT_SEED, TRAINING_SEED = 1_000, 2_000
_MAPS = ("maze", "thin_maze", "arena", "den312d")
_BUDGETS = (2_048, 6_144, 30_720)
_MOST_SAMPLES = 500_000
_NEAR = 0.01  # of the smaller side of a map
_MOST_NETWORK_BYTES = 6_144
_PLRS = {"PLR, cones": "cone", "PLR, planes": "plane", "PLR, continuous": "continuous"}
_GIVEN_SAMPLES = ("coded grid", "LightGBM linear trees", "network, 16-bit")


class Oracle:
    """A distance function that counts its points and its seconds."""

    def __init__(self, exact: VisibilityGraph):
        self.exact = exact
        self.points, self.seconds = 0, 0.0

    def __call__(self, x: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
        begun = time.perf_counter()
        distance = self.exact(x)
        self.seconds += time.perf_counter() - begun
        self.points += len(x)
        return distance


class Setting(NamedTuple):
    budgets: tuple[int, ...]  # bytes
    num_points: int  # drawn to measure errors
    most_samples: int  # for rivals that learn from samples
    num_steps: int  # of training the network
    seed: int


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    full = Setting(_BUDGETS, 200_000, _MOST_SAMPLES, NUM_STEPS, seed)
    setting = Setting((1_024,), 2_000, 2_000, 20, seed) if smoke else full
    results: dict[str, Any] = {"points": setting.num_points, "maps": {}, "skipped": {}}
    for name in _MAPS[:1] if smoke else _MAPS:
        loaded = load_map(name)
        if loaded is None:
            results["skipped"][name] = "PLR_JAX_DATA names no folder with this map"
            continue
        rows, skipped = _measure_map(*loaded, name, setting)
        results["maps"][name] = rows
        results["skipped"].update(skipped)
    return results


def _measure_map(
    workspace: Workspace, goal: Float[np.ndarray, "2"], name: str, setting: Setting
) -> tuple[list[dict[str, Any]], dict[str, str]]:
    """Return rows of all contenders at every budget, and why others were skipped."""
    exact, seed = VisibilityGraph(workspace, goal), setting.seed
    x, distance = reachable_points(workspace, exact, setting.num_points, POINT_SEED + seed)
    near = workspace.clearance(x) < _NEAR * workspace.bounds.width.min()
    samples = reachable_points(workspace, exact, setting.most_samples, TRAINING_SEED + seed)
    rows, skipped = [], {}
    for budget in tqdm(setting.budgets, desc=name, disable=None):
        oracle = Oracle(exact)
        ours = {
            contender: _with_counts(partial(make_plr, leaf, oracle, workspace, budget, seed), oracle, 0)()
            for contender, leaf in _PLRS.items()
        }
        _, num_asked, _ = ours["PLR, planes"]
        x_train, at_train = (part[:num_asked] for part in samples)
        makers = _makers(workspace, goal, oracle, budget, x_train, at_train, setting.num_steps, seed)
        num_given = {rival: len(x_train) if rival in _GIVEN_SAMPLES else 0 for rival in makers}
        counted = {rival: _with_counts(make, oracle, num_given[rival]) for rival, make in makers.items()}
        rivals, reasons = make_all(counted)
        skipped.update(reasons)
        for contender, (rival, num_samples, seconds) in {**ours, **rivals}.items():
            error = np.abs(rival.on_host(x) - distance)
            row: dict[str, Any] = {"contender": contender, "budget": budget, "bytes": rival.num_bytes}
            row |= {"samples": num_samples, "build_seconds": seconds}
            row |= {"free": summary(error), "near_walls": summary(error[near])}
            if contender in _PLRS:
                row["resident_bytes"] = rival.answer.resident_bytes
                grid = scipy_grid(filled_grid(workspace, exact, rival.answer.resident_bytes))
                row["grid_in_memory"] = summary(np.abs(grid.on_host(x) - distance))
            rows.append(row)
    return rows, skipped


def make_plr(leaf: str, oracle: Oracle, workspace: Workspace, budget: int, seed: int) -> Rival:
    distance_fn = oracle.exact if leaf == "cone" else oracle
    plr = construct(distance_fn, workspace.bounds, leaf=leaf, max_bytes=budget, seed=seed)
    return Rival(plr.num_bytes, plr, True)


def reachable_points(
    workspace: Workspace, exact: VisibilityGraph, n: int, seed: int
) -> tuple[Float[np.ndarray, "points 2"], Float[np.ndarray, " points"]]:
    """Return random free points from which the goal can be reached, and their distances."""
    x = workspace.sample_free(n, seed)
    distance = exact(x)
    reachable = np.isfinite(distance)
    return x[reachable], distance[reachable]


def _makers(
    workspace: Workspace,
    goal: Float[np.ndarray, "2"],
    oracle: Oracle,
    budget: int,
    x: Float[np.ndarray, "n 2"],
    distance: Float[np.ndarray, " n"],
    num_steps: int,
    seed: int,
) -> dict[str, Callable[[], Rival]]:
    makers = {
        "coded grid": lambda: scipy_grid(coded_grid(workspace, oracle, budget, x, distance)),
        "LightGBM linear trees": lambda: best_linear_trees(x, distance, budget, seed),
        "network, 16-bit": lambda: train_network(x, distance, budget, num_steps, seed, jnp.float16),
        "scikit-fmm": lambda: scipy_grid(travel_time_grid(workspace, goal, budget)),
    }
    if budget > _MOST_NETWORK_BYTES:
        del makers["network, 16-bit"]
    return makers


def _with_counts(make: Callable[[], Rival], oracle: Oracle, num_given: int) -> Callable[[], tuple[Rival, int, float]]:
    """Wrap a maker so that it also returns its number of oracle values and its seconds without the oracle.

    The number includes ``num_given`` values that the maker was given.
    """

    def counted() -> tuple[Rival, int, float]:
        oracle.points, oracle.seconds, begun = 0, 0.0, time.perf_counter()
        rival = make()
        return rival, num_given + oracle.points, time.perf_counter() - begun - oracle.seconds

    return counted


def summary(error: Float[np.ndarray, " n"]) -> dict[str, float | int | None]:
    """Return errors over the points that are answered, and how many are not (an answer that is NaN or infinite)."""
    answered = error[np.isfinite(error)]
    counts = {"points": len(error), "unanswered": len(error) - len(answered)}
    if len(answered) == 0:
        return {"mean": None, "median": None, "quantile_99": None, "max": None, **counts}
    return {
        "mean": float(answered.mean()),
        "median": float(np.median(answered)),
        "quantile_99": float(np.quantile(answered, 0.99)),
        "max": float(answered.max()),
        **counts,
    }
