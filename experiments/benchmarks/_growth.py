"""How each cost grows: with points, leaves, dimension, vertices and robots.

Queries and constructions are of the cone, the distance to a corner of the unit cube: with 512 leaves by points,
10^6 points by leaves, 10^6 points and 4,096 leaves by dimensions. Oracles are of fields of octagons, and answer 10^4
points. Heuristics are of 32,768 joint configurations, and plans of PLRs that are built already, both for discs in
four rooms. An exponent is the slope of the least-squares line through the logarithms, over the upper half of the
measured range: below it, costs that do not grow at all often hide those that do.
"""

from collections.abc import Callable, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter, NullLocator
from tqdm import tqdm

from experiments import _planning
from experiments.benchmarks._oracle import median_seconds, polygon_field, prepared
from experiments.benchmarks._timing import interleaved
from plr_jax import PLR, BLOptions, Problem, VisibilityGraph, construct, robot_distance_fns, scenes, sum_of_distances

NUM_TURNS, NUM_RUNS = 9, 3
_POINT_SEED = 1_000
_BATCH, _PLR_BYTES, _MANY_VERTICES = 32_768, 2_048, 1_000


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    curves: dict[str, dict[str, Any]] = {}
    for name, (unit, measured) in tqdm(_CURVES.items(), desc="curves", disable=None):
        sizes, seconds = measured(seed, smoke)
        curves[name] = {
            "unit": unit,
            "sizes": list(sizes),
            "seconds": list(seconds),
            "exponent": fit(sizes, seconds).exponent,
        }
    return {"curves": curves}


class Fit(NamedTuple):
    """``factor * size**exponent``, from a size on."""

    exponent: float
    factor: float
    first: float


def fit(sizes: Sequence[float], seconds: Sequence[float]) -> Fit:
    """The power that describes the upper half of the sizes, on a log axis: at least the last two."""
    x, y = np.log(sizes), np.log(seconds)
    upper = x >= (x[0] + x[-1]) / 2
    upper[-2:] = True
    slope, offset = np.polyfit(x[upper], y[upper], 1)
    return Fit(float(slope), float(np.exp(offset)), float(np.array(sizes)[upper][0]))


Curve = tuple[Sequence[int], Sequence[float]]
"""Sizes, and seconds at each."""


def _cone_plr(dim: int, leaves: int, seed: int) -> PLR:
    def cone(x: Float[np.ndarray, "n dim"]) -> Float[np.ndarray, " n"]:
        return np.sqrt(sum(column * column for column in x.T))

    return construct(cone, (np.zeros(dim), np.ones(dim)), max_leaves=leaves, seed=seed)


def _queries(plrs: Sequence[PLR], num_points: Sequence[int], seed: int, smoke: bool) -> list[float]:
    """Seconds of a query of each PLR, with so many points each, which are on the device."""
    rng = np.random.default_rng(_POINT_SEED + seed)
    points = [jnp.asarray(rng.random((n, plr.dim)), jnp.float32) for plr, n in zip(plrs, num_points, strict=True)]
    calls: dict[str, Callable[[], Any]] = {
        str(k): partial(plr, x) for k, (plr, x) in enumerate(zip(plrs, points, strict=True))
    }
    return [seconds.median for seconds in interleaved(calls, 3 if smoke else NUM_TURNS).values()]


def _query_by_points(seed: int, smoke: bool) -> Curve:
    sizes = [10**power for power in range(3 if smoke else 8)]
    return sizes, _queries([_cone_plr(2, 64 if smoke else 512, seed)] * len(sizes), sizes, seed, smoke)


def _query_by_leaves(seed: int, smoke: bool) -> Curve:
    sizes = [4**power for power in range(2, 4 if smoke else 9)]
    return sizes, _queries(
        [_cone_plr(2, n, seed) for n in sizes], [10_000 if smoke else 10**6] * len(sizes), seed, smoke
    )


def _query_by_dimension(seed: int, smoke: bool) -> Curve:
    sizes = [2, 3] if smoke else [2, 3, 4, 5, 6]
    plrs = [_cone_plr(dim, 64 if smoke else 4_096, seed) for dim in sizes]
    return sizes, _queries(plrs, [10_000 if smoke else 10**6] * len(sizes), seed, smoke)


def _construct_by_leaves(seed: int, smoke: bool) -> Curve:
    sizes = [4**power for power in range(2, 4 if smoke else 8)]
    return sizes, [median_seconds(lambda n=n: _cone_plr(2, n, seed), 1 if smoke else NUM_RUNS) for n in sizes]


def _prepare_by_vertices(seed: int, smoke: bool) -> Curve:
    sizes = _num_vertices(smoke)
    return sizes, [_prepared(n, seed)[0] for n in sizes]


def _oracle_by_vertices(seed: int, smoke: bool) -> Curve:
    sizes, seconds = _num_vertices(smoke), []
    for n in sizes:
        _, oracle = _prepared(n, seed)
        x = oracle.workspace.sample_free(200 if smoke else 10_000, _POINT_SEED + seed)
        seconds.append(median_seconds(partial(oracle, x), NUM_RUNS))
    return sizes, seconds


@cache
def _prepared(num_vertices: int, seed: int) -> tuple[float, VisibilityGraph]:
    """Median seconds from a workspace to its oracle, of one run where that takes long; and the oracle."""
    workspace, goal = polygon_field(num_vertices, seed)
    runs = [prepared(workspace, goal) for _ in range(1 if num_vertices > _MANY_VERTICES else NUM_RUNS)]
    return float(np.median([to_oracle for _, to_oracle, _ in runs])), runs[0][2]


def _num_vertices(smoke: bool) -> list[int]:
    return [48, 96] if smoke else [48, 128, 256, 512, 1_024, 2_048, 4_000]


def _heuristic_by_robots(seed: int, smoke: bool) -> Curve:
    sizes = [1, 2] if smoke else [1, 2, 4, 8, 16]
    problem = scenes.four_rooms(4)
    domain, size = problem.workspace.bounds, 512 if smoke else _PLR_BYTES
    plrs = [construct(fn, domain, max_bytes=size, seed=seed) for fn in robot_distance_fns(problem)]
    calls, n = {}, 1_024 if smoke else _BATCH
    for robots in sizes:
        q = problem.workspace.sample_free(n * robots, _POINT_SEED + seed).reshape(n, robots, 2)
        # Each robot's PLR has arrays of its own, also where robots are as many as twice the team's.
        team = [jax.tree.map(jnp.copy, plrs[i % len(plrs)]) for i in range(robots)]
        calls[str(robots)] = partial(sum_of_distances(team), q)
    return sizes, [seconds.median for seconds in interleaved(calls, 3 if smoke else NUM_TURNS).values()]


def _plan_by_robots(seed: int, smoke: bool) -> Curve:
    sizes, num_runs, num_bytes = ([2, 3], 1, 512) if smoke else ([2, 3, 4, 8], NUM_RUNS, _planning.PLR_BYTES)
    return sizes, [_plan_seconds(scenes.four_rooms(robots), num_runs, num_bytes) for robots in sizes]


def _plan_seconds(problem: Problem, num_runs: int, plr_bytes: int) -> float:
    """Seconds of BL with PLRs, which are there already."""
    heuristic = _planning.build(problem, _planning.PLR, plr_bytes)
    _planning.plan(problem, heuristic, BLOptions(searchers=("bl",)))
    runs = [_planning.plan(problem, heuristic, BLOptions(searchers=("bl",))) for _ in range(num_runs)]
    if not runs[0][0].solved:
        raise RuntimeError(f"A scene was not solved: {runs[0][0].status}.")
    return float(np.median([seconds for _, seconds in runs]))


_CURVES: dict[str, tuple[str, Callable[[int, bool], Curve]]] = {
    "query by points": ("points", _query_by_points),
    "query by leaves": ("leaves", _query_by_leaves),
    "query by dimension": ("dimensions", _query_by_dimension),
    "construction": ("leaves", _construct_by_leaves),
    "oracle, preprocessing": ("vertices", _prepare_by_vertices),
    "oracle, query": ("vertices", _oracle_by_vertices),
    "heuristic": ("robots", _heuristic_by_robots),
    "plan": ("robots", _plan_by_robots),
}


def draw(results: dict[str, Any], output: Path) -> list[Path]:
    """A panel a cost: what was measured, and the fitted line where it was fitted."""
    curves = results["curves"]
    figure = Figure(figsize=(11.5, 5.2), layout="constrained", facecolor="white")
    axes = figure.subplots(2, -(-len(curves) // 2)).ravel()
    for ax, (name, curve) in zip(axes, curves.items(), strict=True):
        _draw_panel(ax, curve["sizes"], curve["seconds"])
        ax.set_title(name, fontsize=9)
        ax.set_xlabel(curve["unit"], fontsize=9)
    for ax in axes[:: len(axes) // 2]:
        ax.set_ylabel("seconds", fontsize=9)
    path = output / "benchmark_growth.png"
    figure.savefig(path, dpi=150)
    return [path]


def _draw_panel(ax: Axes, sizes: list[int], seconds: list[float]) -> None:
    power = fit(sizes, seconds)
    ends = np.array([power.first, sizes[-1]])
    ax.loglog(sizes, seconds, "o", color="#0072B2", ms=4)
    ax.loglog(ends, power.factor * ends**power.exponent, "-", color="#D55E00", lw=1.5)
    ax.annotate(f"exponent {power.exponent:.2f}", (0.06, 0.88), xycoords="axes fraction", color="#D55E00", fontsize=9)
    if sizes[-1] < sizes[0] * 1_000:
        ticks = sizes if len(sizes) < 6 else sizes[::2]
        ax.set_xticks(ticks, [f"{size:,}" for size in ticks])
        ax.xaxis.set_minor_locator(NullLocator())
    ax.yaxis.set_minor_formatter(NullFormatter())
    lo, hi = min(seconds), max(seconds)
    ax.set_ylim(lo / 4, max(hi * 6, lo * 20))  # a decade at least, and room for the exponent
    ax.grid(True, which="major", color="#e4e4e4", lw=0.6)
    ax.tick_params(labelsize=8)
    ax.spines[["top", "right"]].set_visible(False)
