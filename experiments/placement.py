"""Where a team meets and where a fleet's depots go: an example of placement through the distances of pairs.

On each map 20 agents meet at one place, and 8 depots serve 1,000 demand points, at the least sum of distances or the
least largest distance. ``place`` first exchanges candidates, then moves each facility by random steps that shrink.
All costs in the table are exact. Two rivals: the best demand points, and a placement by straight-line distances.
"""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from matplotlib.figure import Figure

from experiments._runner import run
from experiments.benchmarks._maps import load_map, load_maps
from plr_jax import VisibilityGraph, Workspace, construct_pairs, plot

PAIR_BYTES = {"maze": 4_096, "arena": 65_536, "den520d": 1_048_576}
TASKS = {"meeting point": (1, 20), "depots": (8, 1_000)}  # number of facilities and of demand points
OBJECTIVES = {"sum": np.sum, "max": np.max}
NUM_CANDIDATES, NUM_STEPS, NUM_ROUNDS = 512, 32, 24
_COLORS = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#8f8f2a", "#6a51a3")

Points = Float[np.ndarray, "n 2"]
Table = Float[np.ndarray, "facilities n"]
Distance = Callable[[Points, Points], Any]


def table_of(distance: Distance, sites: Points, demand: Points) -> Table:
    """Return the distance of each site from each demand point."""
    x, y = np.repeat(sites, len(demand), axis=0), np.tile(demand, (len(sites), 1))
    return np.asarray(distance(x, y), float).reshape(len(sites), len(demand))


def exchanged(table: Table, k: int, cost: Callable[..., Any]) -> Int[np.ndarray, " k"]:
    """Choose ``k`` rows greedily, then exchange one at a time, always the best, while the cost falls."""
    chosen: list[int] = []
    for _ in range(k):
        nearest = table[chosen].min(axis=0) if chosen else np.full(table.shape[1], np.inf)
        chosen.append(int(cost(np.minimum(table, nearest), axis=1).argmin()))
    while True:
        rest = [chosen[:i] + chosen[i + 1 :] for i in range(k)]
        nearest = [table[others].min(axis=0) if others else np.inf for others in rest]
        costs = np.stack([cost(np.minimum(table, each), axis=1) for each in nearest])
        place, row = np.unravel_index(costs.argmin(), costs.shape)
        if costs[place, row] >= (1 - 1e-9) * cost(table[chosen].min(axis=0)):
            return np.array(chosen)
        chosen = [*rest[place], int(row)]


def place(
    distance: Distance, workspace: Workspace, demand: Points, k: int, cost: Callable[..., Any], seed: int
) -> Points:
    """Return ``k`` free places at which the cost of the distances to the demand points is small."""
    # 1. The best of many candidates.
    candidates = workspace.sample_free(NUM_CANDIDATES, seed)
    table = table_of(distance, candidates, demand)
    chosen = exchanged(table, k, cost)
    facilities, table = candidates[chosen], table[chosen]
    # 2. Random steps of each facility, shorter in each round.
    rng = np.random.default_rng(seed)
    for step in 0.1 * float(workspace.bounds.width.max()) * 0.75 ** np.arange(NUM_ROUNDS):
        for i in range(k):
            moved = facilities[i] + step * rng.normal(size=(NUM_STEPS, 2))
            moved = np.concatenate([facilities[[i]], moved[workspace.is_free(moved)]])
            others = np.delete(table, i, axis=0).min(axis=0, initial=np.inf)
            rows = table_of(distance, moved, demand)
            best = int(cost(np.minimum(rows, others), axis=1).argmin())
            facilities[i], table[i] = moved[best], rows[best]
    return facilities


def straight(x: Points, y: Points) -> Float[np.ndarray, " n"]:
    return np.linalg.norm(x - y, axis=1)


def compute(seed: int, smoke: bool) -> dict[str, Any]:
    rows, pictures = [], {}
    tasks = {"meeting point": (1, 8), "depots": (2, 40)} if smoke else TASKS
    for name, (workspace, goal) in load_maps(["maze"] if smoke else PAIR_BYTES).items():
        pairs, exact = construct_pairs(workspace, max_bytes=PAIR_BYTES[name]), VisibilityGraph(workspace, goal)
        for task, (k, n) in tasks.items():
            demand = workspace.sample_free(n, seed)
            of_points = table_of(exact.between, demand, demand)
            for objective, cost in OBJECTIVES.items():
                place(pairs, workspace, workspace.sample_free(n, seed + 1_000), k, cost, seed)  # compiles
                began = time.perf_counter()
                facilities = place(pairs, workspace, demand, k, cost, seed)
                seconds = time.perf_counter() - began
                by_lines = place(straight, workspace, demand, k, cost, seed)
                ours, lines = (table_of(exact.between, each, demand) for each in (facilities, by_lines))
                row = {"map": name, "k": k, "n": n, "objective": objective, "seconds": seconds}
                row |= {"cost": float(cost(ours.min(axis=0))), "straight": float(cost(lines.min(axis=0)))}
                row |= {"of_points": float(cost(of_points[exchanged(of_points, k, cost)].min(axis=0)))}
                rows.append(row | {"free": bool(workspace.is_free(facilities).all())})
            pictures[f"{name}, {task}"] = {
                "map": name,
                "facilities": facilities.tolist(),
                "demand": demand.round(4).tolist(),
                "nearest": ours.argmin(axis=0).tolist(),
            }
    return {"rows": rows, "pictures": pictures}


def draw(results: dict[str, Any], output: Path) -> list[Path]:
    pictures = {title: each for title, each in results["pictures"].items() if load_map(each["map"]) is not None}
    figure = Figure(figsize=(8.4, 2.1 * len(pictures)), dpi=130, facecolor="white", layout="constrained")
    axes = figure.subplots(-(-len(pictures) // 2), 2, squeeze=False).ravel()
    for ax, (title, drawn) in zip(axes, pictures.items(), strict=False):
        workspace, _ = load_map(drawn["map"])  # type: ignore[reportGeneralTypeIssues]
        plot.plot_workspace(workspace, ax)
        demand, nearest = np.array(drawn["demand"]), np.array(drawn["nearest"])
        for number, facility in enumerate(drawn["facilities"]):
            color = _COLORS[number % len(_COLORS)]
            ax.plot(*demand[nearest == number].T, ".", ms=3.5, color=color, zorder=4)
            ax.plot(*facility, "*", ms=14, mfc=color, mec="black", zorder=6)
        ax.set(xticks=[], yticks=[], xlabel="", ylabel="", title=f"{title}, least largest distance")
    figure.savefig(output / "placement.png")
    return [output / "placement.png"]


if __name__ == "__main__":
    run("placement", __doc__, compute, draw)
