"""The history of the package: about ten ratios for each release, measured again by the same script.

``python -m experiments.history`` records the release that is checked out; an entry of the same version is replaced.
``--release REVISION`` records an older one. Ratios to the previous release come from its code: ``--previous
REVISION``, by default the commit of the entry before. Each release answers in a process of its own.

All ratios divide CPU seconds, user and system time of all threads, or errors, of this run. Contenders take turns. A
number is the median over the turns, or over the problems of the planner, with its quartiles. Beside it stands what
speed could be bought with: errors, bytes or costs.
"""

import argparse
import itertools
import json
import os
import subprocess
import sys
import tempfile
import textwrap
from collections.abc import Callable
from contextlib import ExitStack
from datetime import date
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from experiments import cost_distance, costs
from experiments._first_tables import row_of
from experiments._measures import ratios_in_turns, relative_error, timed
from experiments._release_worker import ROOT, Worker, repeated
from experiments._runner import RESULTS, commit_of_code, environment, read, run
from experiments.baselines.ompl import cpu_history
from experiments.benchmarks._rivals import coded_grid, scipy_grid
from experiments.first_answers import run_fresh
from plr_jax import PlaneSpace, VisibilityGraph, Workspace, scenes, validate
from plr_jax.metrics import path_cost

MAX_BYTES, PAIRS_BYTES = 2_048, 65_536
LEAVES = ("plane", "continuous", "cone")
TURNS = 9
SCENES = {"single_door": (), "four_rooms": (3,), "cross": (3,)}
NUM_VARIANTS = 5  # of each scene
PLAN_RUNS = 5  # of our planner on each variant
OMPL_PLANNERS, OMPL_LIMIT = ("RRTConnect", "AORRTC"), 2.0  # the sooner one counts; seconds

OPTIONS = argparse.ArgumentParser(add_help=False)
OPTIONS.add_argument("--release", metavar="REVISION", help="record this revision (default: the code checked out)")
OPTIONS.add_argument("--previous", metavar="REVISION", help="compare with it (default: the entry before)")
_MANY = 5  # releases whose names are written upright
_ENOUGH = 1.01  # cost of OMPL's path over ours
_PROGRAM = "import plr_jax; found = plr_jax.load(given['path'].item())(given['x'])"

Seconds = Callable[[Worker], float]
Numbers = dict[str, tuple[list[float] | None, float]]
"""Of each number its ratios, None without a rival or a function of ours, and what stands beside it."""


class Bench(NamedTuple):
    """What is measured, and how often."""

    ours: Worker
    previous: Worker | None
    folder: Path
    seed: int
    smoke: bool

    def in_turns(self, ours: Seconds, rival: Callable[[], float]) -> list[float]:
        """Return ratios of our seconds to a rival's."""
        return ratios_in_turns(lambda: ours(self.ours), rival, 1 if self.smoke else TURNS)

    def to_previous(self, ours: Seconds) -> list[float] | None:
        """Return ratios of our seconds to those of the previous release, if there is one."""
        before = self.previous
        return self.in_turns(ours, lambda: ours(before)) if before else None


class Number(NamedTuple):
    """A ratio, below 1 if we are better, and what the number beside it is."""

    what: str
    beside: str
    is_to_previous: bool = False


NUMBERS = {
    "query": Number("1,000,000 points in JAX, to SciPy map_coordinates", "error, equal bytes"),
    "small_query": Number("100 points in NumPy, to SciPy map_coordinates", "error, equal bytes"),
    "error": Number("mean error of cones, to a coded grid", "bytes"),
    "solve_eikonal": Number("solve_eikonal, to scikit-fmm, 9 nodes a cell", "error"),
    "cost_distance": Number("cost_distance, to scikit-fmm, 9 nodes a cell", "error"),
    "first_path": Number("first path of a team, to OMPL", "cost of the first path"),
    "our_cost": Number("path at most 1 % longer than ours, to OMPL", "share of trials that OMPL ends within 2 s"),
    "construct": Number("construct of three kinds of leaves, to the previous release", "error", True),
    "certified": Number("construct of cones with a proof, to the previous release", "mean gap of bounds", True),
    "few_points": Number("1,000 points outside jit, to the previous release", "error", True),
    "first_answers": Number("import, load and 1,000 points, to the previous release", "error", True),
    "errors": Number("mean error of three kinds of leaves, to the previous release", "bytes", True),
    "pairs": Number("10,000 pairs of points, to the previous release", "error", True),
}


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    """Return what the numbers are and the entries of all releases, with that of the release measured now."""
    options, _ = OPTIONS.parse_known_args()
    is_kept = not smoke and (RESULTS / "history.json").exists()
    entries = read(RESULTS, "history")["results"]["entries"] if is_kept else {}
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        ours = _started(stack, folder / "ours" if options.release else ROOT, options.release)
        older = [version for version in entries if _order(version) < _order(ours.version)]
        revision = options.previous or (entries[older[-1]]["commit"].rstrip("+") if older else None)
        previous = _started(stack, folder / "previous", revision) if revision else ours if smoke else None
        bench = Bench(ours, previous, folder, seed, smoke)
        numbers = _distances(bench) | _costs(bench) | _plans(bench)
    entry = {
        "commit": commit_of_code(options.release or "HEAD"),
        "previous": {"version": previous.version, "commit": commit_of_code(revision or "HEAD")} if previous else None,
        "date": date.today().isoformat(),
        "cores": os.cpu_count(),
        "versions": environment()["versions"] | {"plr-jax": ours.version},
        "numbers": [{"number": name, **_summary(*numbers[name])} for name in NUMBERS],
    }
    entries[ours.version] = entry
    return {
        "numbers": {name: number._asdict() for name, number in NUMBERS.items()},
        "entries": {version: entries[version] for version in sorted(entries, key=_order)},
    }


def _started(stack: ExitStack, folder: Path, revision: str | None) -> Worker:
    """Start a process with the package of a folder, into which a revision is unpacked first."""
    if revision is not None:
        folder.mkdir()
        archive = subprocess.run(["git", "archive", revision, "plr_jax"], cwd=ROOT, check=True, capture_output=True)
        subprocess.run(["tar", "-x"], cwd=folder, input=archive.stdout, check=True)
    worker = Worker(folder)
    stack.callback(worker.close)
    return worker


def _order(release: str) -> tuple[int, ...]:
    return tuple(int(part) for part in release.split(".")[:3])


def _summary(ratios: list[float] | None, beside: float) -> dict[str, float | None]:
    """Return the median and quartiles of ratios, and what stands beside them; None without ratios."""
    low, ratio, high = [None] * 3 if ratios is None else np.quantile(ratios, [0.25, 0.5, 0.75])
    values = {"ratio": ratio, "low": low, "high": high, "beside": None if ratios is None else beside}
    return {name: None if each is None else float(f"{each:.4g}") for name, each in values.items()}


def _seconds(measured: Callable[..., Any], **arguments: Any) -> float:
    """Return the first part of an answer."""
    return measured(**arguments)[0]


def _distances(bench: Bench) -> Numbers:
    """Distances to one goal of a floor plan, and between pairs of its points."""
    problem, smoke, ours = scenes.floor_plan(), bench.smoke, bench.ours
    workspace, exact = problem.workspace, VisibilityGraph(problem.workspace, problem.goals[0])
    x, y = workspace.sample_free(4_000 if smoke else 200_000, bench.seed).reshape(2, -1, 2)
    truth, releases = exact(x), [ours, bench.previous or ours]
    sizes: dict[tuple[Worker, str], int] = {}
    errors: dict[tuple[Worker, str], float] = {}

    def build(worker: Worker, leaf: str = "cone", certified: bool = False) -> float:
        seconds, sizes[worker, leaf] = worker("construct", leaf=leaf, max_bytes=MAX_BYTES, certified=certified)
        return seconds

    # 1. Cones with a proof, by both releases.
    proofs = bench.to_previous(partial(build, certified=True))
    gaps: list[float] = []
    for worker in releases:
        build(worker, certified=True)
        gaps.append(float(worker("gap", x=x)[1].mean()))
    numbers: Numbers = {"certified": (proofs, gaps[0] / gaps[1])}
    # 2. Kinds of leaves, by both releases; cones last, for what follows.
    leaves = LEAVES[-1:] if smoke else LEAVES
    building = bench.to_previous(lambda worker: sum(build(worker, leaf) for leaf in leaves))
    for worker, leaf in itertools.product(releases, leaves):
        build(worker, leaf)
        errors[worker, leaf] = relative_error(worker("query", x=x, calls=1)[1], truth)
    before = releases[1]
    of_errors, of_sizes = ([part[ours, leaf] / part[before, leaf] for leaf in leaves] for part in (errors, sizes))
    numbers["construct"] = building, float(np.exp(np.log(of_errors).mean()))
    numbers["errors"] = of_errors if bench.previous else None, float(np.mean(of_sizes))
    # 3. New processes that load a file of cones.
    files = {}
    for number, worker in enumerate(releases):
        files[worker] = bench.folder / f"{number}.json"
        given = {"polygons": [], "path": str(files[worker].with_suffix(".plr")), "x": x[:1_000].tolist()}
        files[worker].write_text(json.dumps(given), encoding="utf-8")
        worker("save", path=given["path"])
    answering = bench.to_previous(lambda worker: run_fresh(sys.executable, _PROGRAM, files[worker], worker.folder)[0])
    numbers["first_answers"] = answering, of_errors[-1]
    # 4. Cones beside a grid of as many bytes.
    grid = coded_grid(workspace, exact, sizes[ours, "cone"], x[:10_000], truth[:10_000])
    rival = scipy_grid(grid)
    error = errors[ours, "cone"] / relative_error(rival.on_host(x), truth)
    numbers["error"] = [error], sizes[ours, "cone"] / grid.num_bytes
    batch = np.tile(x, (1 if smoke else 10, 1)).astype(np.float32)
    for name, points, calls, in_numpy in (("query", batch, 10, False), ("small_query", batch[:100], 300, True)):
        query = partial(_seconds, task="query", x=points, calls=calls, in_numpy=in_numpy)
        of_grid = partial(_seconds, partial(repeated, partial(rival.answer, points), calls))
        numbers[name] = bench.in_turns(query, of_grid), error
    few = partial(_seconds, task="query", x=batch[:1_000], calls=100, in_numpy=False)
    numbers["few_points"] = bench.to_previous(few), of_errors[-1]
    # 5. Pairs of points.
    pairs = {"x": x[:10_000], "y": y[:10_000]}
    of_pairs = exact.between(*pairs.values())
    for worker in releases:
        worker("build_pairs", max_bytes=PAIRS_BYTES)
        errors[worker, "pairs"] = relative_error(worker("query_pairs", **pairs, calls=1)[1], of_pairs)
    asking = bench.to_previous(partial(_seconds, task="query_pairs", **pairs, calls=20))
    numbers["pairs"] = asking, errors[ours, "pairs"] / errors[before, "pairs"]
    return numbers


def _costs(bench: Bench) -> Numbers:
    """Costs that vary, in the plane around a wall and over a raster."""
    smoke, ours = bench.smoke, bench.ours
    # 1. A raster of 200 x 100 cells, interpolated. The rival's seconds are those of the march alone.
    space, cost_map = PlaneSpace(Workspace(costs.BOUNDS, [costs.WALL])), costs.rasters(bench.seed)["noise 10"]
    x = space.workspace.sample_free(costs.POINTS, bench.seed)
    truth, _ = costs.converged(space, cost_map, x, 200 if smoke else 1_600)
    rival, march = costs.marched(space, cost_map, 300)
    task = {"bounds": costs.BOUNDS, "wall": costs.WALL, "goal": costs.GOAL, "costs": cost_map.values, "x": x}
    solving = bench.in_turns(
        partial(_seconds, task="solve_eikonal", **task), partial(_seconds, partial(timed, march))
    )
    error = relative_error(ours("solve_eikonal", **task)[1], truth) / relative_error(rival(x), truth)
    numbers: Numbers = {"solve_eikonal": (solving, error), "cost_distance": (None, np.nan)}
    # 2. A raster of 400 x 400 cells.
    raster, cells = cost_distance.rasters(bench.seed)["smooth"], cost_distance.SOURCES[1]
    arguments = {"costs": raster, "sources": [(column + 0.5, row + 0.5) for row, column in cells]}
    if (answer := ours("cost_distance", **arguments)) is not None:
        coarse, fine = (cost_distance.marched(raster, cells, each) for each in ((2, 2) if smoke else (4, 8)))
        march = partial(timed, partial(cost_distance.scikit_fmm_divided, raster, cells))
        search = partial(_seconds, task="cost_distance", **arguments)
        searching = bench.in_turns(search, partial(_seconds, march))
        of_us, of_rival = (relative_error(each, 2 * fine - coarse) for each in (answer[1], march()[1]))
        numbers["cost_distance"] = searching, of_us / of_rival
    return numbers


def _plans(bench: Bench) -> Numbers:
    """Teams. Our seconds begin with the obstacles, those of OMPL when it has compiled. It calls Python for tests."""
    first, same, costs_of_first, is_reached = [], [], [], []
    variants = range(bench.seed, bench.seed + (1 if bench.smoke else NUM_VARIANTS))
    for (scene, size), seed in itertools.product(list(SCENES.items())[: 1 if bench.smoke else None], variants):
        problem = scenes.perturbed(getattr(scenes, scene)(*size), seed)
        seconds, found = [], []
        for is_first in (True, False):
            arguments: dict[str, Any] = {"scene": scene, "size": size, "seed": seed, "is_first": is_first}
            runs = [bench.ours("plan", **arguments) for _ in range(1 + PLAN_RUNS)][1:]
            if not validate(problem, runs[0][1]).valid:
                raise RuntimeError(f"A path on {scene} is not valid.")
            seconds.append(np.median([run[0] for run in runs]))
            found.append(path_cost(problem, runs[0][1]))
        limit, target = 0.5 if bench.smoke else OMPL_LIMIT, _ENOUGH * found[1]
        histories = [cpu_history(problem, planner, seed, limit, target) for planner in OMPL_PLANNERS]
        their_first, their_cost = min(history[0] for history in histories)
        known = [at for history in histories for at, cost in history if cost <= target]
        first.append(seconds[0] / their_first)
        costs_of_first.append(found[0] / their_cost)
        is_reached.append(len(known) > 0)
        same.append(seconds[1] / min(known, default=max(history[-1][0] for history in histories)))
    return {"first_path": (first, float(np.median(costs_of_first))), "our_cost": (same, float(np.mean(is_reached)))}


def draw(results: dict[str, Any], output: Path) -> list[Path]:
    """Draw a panel for each number: ratios over releases, with their quartiles."""
    versions, entries = list(results["entries"]), list(results["entries"].values())
    figure = Figure(figsize=(11, 10), layout="constrained", facecolor="white")
    panels = list(figure.subplots(-(-len(results["numbers"]) // 4), 4).flat)
    for ax in panels[len(results["numbers"]) :]:
        ax.remove()
    for ax, (name, number) in zip(panels, results["numbers"].items(), strict=False):
        low, ratio, high = levels(entries, name, number["is_to_previous"])
        ax.axhline(1, color="#999999", lw=0.8, ls="--")
        ax.errorbar(range(len(entries)), ratio, [ratio - low, high - ratio], fmt="-o", color="#0072B2", ms=4)
        for release, value in enumerate(ratio):
            if np.isfinite(value) and release in (0, len(entries) - 1):
                ax.annotate(f"{value:.2g}", (release, value), (5, 4), textcoords="offset points", fontsize=8)
        ax.set_title(textwrap.fill(number["what"].replace("previous release", "first entry"), 34), fontsize=9)
        ax.set_xticks(range(len(entries)), versions, fontsize=7, rotation=0 if len(entries) < _MANY else 60)
        ax.set(yscale="log", xlim=(-0.5, len(entries) - 0.5))
        ax.yaxis.set_major_formatter("{x:g}")
        ax.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        ax.yaxis.set_minor_formatter("")
        ax.set_ylim(np.nanmin([*low, 0.75]) / 1.5, np.nanmax([*high, 1.33]) * 1.5)
        ax.tick_params(labelsize=7)
        ax.spines[["top", "right"]].set_visible(False)
    figure.supylabel("ratio; below 1, ours takes less", fontsize=9)
    figure.savefig(output / "history.png", dpi=110)
    return [output / "history.png"]


def levels(entries: list[dict[str, Any]], name: str, is_to_previous: bool) -> np.ndarray:
    """Return lower quartiles, medians and upper quartiles of a number, one column a release.

    Ratios to the previous release are multiplied up, so that the release before the first ratio has level 1.
    """
    found = [row_of(entry, name) for entry in entries]  # what is missing becomes NaN
    values = np.array([[row.get(key) for row in found] for key in ("low", "ratio", "high")], float)
    if is_to_previous:
        known = np.nan_to_num(values[1], nan=1.0)
        values *= np.cumprod(np.concatenate([[1.0], known[:-1]]))
        first = np.isfinite(values[1]).argmax()
        values[:, first - 1 : first] = 1.0
    return values


if __name__ == "__main__":
    run("history", __doc__, measure, draw, OPTIONS)
