"""Where a team meets and where a fleet's depots go: placement by gradients through the distances of pairs.

On each map 20 agents meet at one place, and 1,000 demand points are served by 8 depots, at the least sum of distances
or the least largest one. All costs are by the exact oracle. The rivals: the best choice of demand points, by a table
of all their exact distances (for the meeting point the best of all; for depots exchanged one at a time, and each time
the best exchange, from several draws); for the meeting point a dense grid of free candidates with exact distances;
and a placement by straight-line distances, confined to free space alike.
"""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments._runner import run
from experiments.benchmarks._maps import load_map, load_maps
from plr_jax import PairPLR, Placement, VisibilityGraph, Workspace, construct_pairs, place, plot

PAIR_BYTES = {"maze": 4_096, "arena": 65_536, "den520d": 1_048_576}
"""Largest size of the file of pairs of each map."""
OBJECTIVES = {"sum": np.sum, "max": np.max}
_GRID = 200  # candidates along the longer side
_DRAWS = 8
_LEAST_GAIN = 1e-9
_COLORS = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#8f8f2a", "#6a51a3")
_OURS, _OTHERS = "#d55e00", "#0072b2"

Points = Float[np.ndarray, "n 2"]
Cost = Callable[..., Any]


class Task(NamedTuple):
    """To place ``k`` facilities for ``n`` points; how fine the grid of candidates is, if there is one."""

    name: str
    k: int
    n: int
    grid: int | None


class Timed(NamedTuple):
    """A placement, and seconds: of the first call, which compiles, and of a like one after it."""

    placement: Placement
    first: float
    seconds: float


def compute(seed: int, smoke: bool) -> dict[str, Any]:
    tasks = (
        [Task("meeting point", 1, 8, 20), Task("depots", 2, 40, None)]
        if smoke
        else [Task("meeting point", 1, 20, _GRID), Task("depots", 8, 1_000, None)]
    )
    rows, pictures = [], {}
    for name, (workspace, goal) in load_maps(["maze"] if smoke else PAIR_BYTES).items():
        began = time.perf_counter()
        pairs = construct_pairs(workspace, max_bytes=PAIR_BYTES[name])
        built, exact = time.perf_counter() - began, VisibilityGraph(workspace, goal)
        pictures[name] = {}
        for task in tasks:
            demand = workspace.sample_free(task.n, seed)
            table = between(exact, demand, demand)
            for objective in OBJECTIVES:
                row, drawn = measure(exact, pairs, task, demand, table, objective, seed)
                rows.append({"map": name, "pairs": {"bytes": pairs.num_bytes, "seconds": built}, **row})
                if task.k == 1 or objective == "sum":
                    pictures[name][f"{task.name}, {objective}"] = drawn
                print("  ".join(cells(rows[-1])), flush=True)
    return {"rows": rows, "pictures": pictures}


def measure(
    exact: VisibilityGraph,
    pairs: PairPLR,
    task: Task,
    demand: Points,
    table: Float[np.ndarray, "n n"],
    objective: str,
    seed: int,
) -> tuple[dict[str, Any], dict[str, Any]]:
    """What ours and the rivals cost, and what is drawn of them."""
    cost, workspace = OBJECTIVES[objective], exact.workspace
    ours = timed(pairs, workspace, demand, task.k, objective, seed)
    straight = timed(euclidean, workspace, demand, task.k, objective, seed)

    def true_cost(facilities: Points) -> float:
        return float(cost(between(exact, facilities, demand).min(axis=0)))

    row = {
        "task": task.name,
        "k": task.k,
        "n": task.n,
        "objective": objective,
        "cost": true_cost(ours.placement.facilities),
        "said": ours.placement.cost,
        "best_start": float(ours.placement.start_costs[0]),
        "free": bool(workspace.is_free(ours.placement.facilities).all()),
        "seconds": ours.seconds,
        "seconds_first": ours.first,
        "straight": true_cost(straight.placement.facilities),
        "of_points": float(cost(table[best_points(table, task.k, cost, seed)].min(axis=0))),
        "of_grid": None if task.grid is None else of_grid(exact, demand, task.grid, cost),
    }
    drawn = {
        "facilities": ours.placement.facilities.tolist(),
        "straight": straight.placement.facilities.tolist(),
        "demand": demand.round(4).tolist(),
        "assignment": ours.placement.assignment.tolist(),
    }
    if task.k == 1:
        home = exact.with_goal(ours.placement.facilities[0])
        drawn["paths"] = [home.shortest_path(point).tolist() for point in demand]
    return row, drawn


def timed(
    distance: Callable[..., Any], workspace: Workspace, demand: Points, k: int, objective: str, seed: int
) -> Timed:
    """A placement for the demand after one for another demand, which compiles."""
    other = workspace.sample_free(len(demand), seed + 1_000)
    began = time.perf_counter()
    place(distance, workspace, other, k, objective=objective, seed=seed)
    compiled = time.perf_counter()
    placement = place(distance, workspace, demand, k, objective=objective, seed=seed)
    return Timed(placement, compiled - began, time.perf_counter() - compiled)


def euclidean(x: Float[Array, "n 2"], y: Float[Array, "n 2"]) -> Float[Array, "n"]:
    return jnp.sqrt(((x - y) ** 2).sum(axis=-1))


def between(exact: VisibilityGraph, x: Points, y: Points) -> Float[np.ndarray, "x y"]:
    """Exact distances."""
    return np.stack([exact.with_goal(point)(y) for point in x])


def of_grid(exact: VisibilityGraph, demand: Points, resolution: int, cost: Cost) -> float:
    """The least cost of one place, of all free nodes of a grid."""
    grid = exact.workspace.bounds.grid(resolution).reshape(-1, 2)
    return float(cost(between(exact, demand, grid[exact.workspace.is_free(grid)]), axis=0).min())


def best_points(table: Float[np.ndarray, "n n"], k: int, cost: Cost, seed: int) -> Int[np.ndarray, "k"]:
    """The best demand point; of several, the best that exchanges lead to from random choices."""
    if k == 1:
        return np.array([cost(table, axis=1).argmin()])
    rng = np.random.default_rng(seed)
    found = [exchanged(table, rng.choice(len(table), k, replace=False), cost) for _ in range(_DRAWS)]
    return min(found, key=lambda chosen: cost(table[chosen].min(axis=0)))


def exchanged(table: Float[np.ndarray, "n n"], chosen: Int[np.ndarray, "k"], cost: Cost) -> Int[np.ndarray, "k"]:
    """A choice after exchanges, each time the best one, as long as it becomes cheaper."""
    while True:
        rest = [np.delete(chosen, place) for place in range(len(chosen))]
        costs = np.stack([cost(np.minimum(table, table[others].min(axis=0)), axis=1) for others in rest])
        place, point = np.unravel_index(costs.argmin(), costs.shape)
        if costs[place, point] >= (1 - _LEAST_GAIN) * cost(table[chosen].min(axis=0)):
            return chosen
        chosen = np.append(rest[place], point)


def draw(results: dict[str, Any], output: Path) -> list[Path]:
    maps = results["pictures"]
    figure = Figure(figsize=(4.2 * len(maps), 8.6), dpi=130, facecolor="white", layout="constrained")
    axes = figure.subplots(2, len(maps), squeeze=False)
    for (name, drawn), (above, below) in zip(maps.items(), axes.T, strict=True):
        workspace, _ = load_map(name) or (None, None)
        if workspace is None:
            continue
        draw_meeting(workspace, drawn["meeting point, sum"], drawn["meeting point, max"], above)
        above.set_title(f"{name}: a meeting point", fontsize=11)
        draw_depots(workspace, drawn["depots, sum"], below)
        count = len(drawn["depots, sum"]["facilities"])
        below.set_title(f"{name}: {count} depots of least sum", fontsize=11)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False, fontsize=10)
    picture = output / "placement.png"
    figure.savefig(picture)
    return [picture]


def draw_meeting(workspace: Workspace, of_sum: dict[str, Any], of_max: dict[str, Any], ax: Axes) -> None:
    """Agents, their ways to the place of least sum, and other places."""
    _frame(workspace, ax)
    for path in of_sum["paths"]:
        ax.plot(*np.array(path).T, color=_OURS, lw=0.9, alpha=0.55, zorder=4)
    ax.plot(*np.array(of_sum["demand"]).T, "o", ms=4.5, mfc="white", mec="black", mew=1, zorder=5, label="agents")
    for facilities, marker, color, label in (
        (of_sum["facilities"], "*", _OURS, "least sum"),
        (of_max["facilities"], "D", _OTHERS, "least longest way"),
        (of_sum["straight"], "X", "#777777", "least sum of straight lines"),
    ):
        size = 17 if marker == "*" else 9
        ax.plot(
            *np.array(facilities).T,
            marker,
            ms=size,
            mfc=color,
            mec="black",
            mew=0.9,
            ls="none",
            zorder=6,
            label=label,
        )


def draw_depots(workspace: Workspace, drawn: dict[str, Any], ax: Axes) -> None:
    """Demand points in the colors of their depots."""
    _frame(workspace, ax)
    demand, assignment = np.array(drawn["demand"]), np.array(drawn["assignment"])
    for number, depot in enumerate(drawn["facilities"]):
        color = _COLORS[number % len(_COLORS)]
        ax.plot(*demand[assignment == number].T, ".", ms=3.5, color=color, zorder=4)
        ax.plot(*depot, "*", ms=15, mfc=color, mec="black", mew=1, zorder=6)


def _frame(workspace: Workspace, ax: Axes) -> None:
    plot.plot_workspace(workspace, ax)
    ax.set(xticks=[], yticks=[], xlabel="", ylabel="")


if __name__ == "__main__":
    run("placement", "Meeting points of a team and depots of a fleet.", compute, draw)
