"""Pedestrians: routes and evacuations of JuPedSim beside those of cones, on two of its own walkable areas.

*Cones* of 8 KB, of some goals a map: CPU seconds of the oracle and the PLR, errors, nanoseconds of a point in C.

*Routes* between random points that an agent can reach: lengths over exact, and over the shortest path that keeps an
agent's radius from walls, as JuPedSim's router intends to; paths deeper than a millimeter in walls; time. *Many* more
routes of cones lead to the first of the goals.

*Evacuations*: the same agents walk to the same exits by JuPedSim's journeys, and steered by cones.

Bounds at points beside walls of these maps are in ``hard_points``.
"""

import importlib
import os
import tempfile
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from experiments._c_headers import compiled_header, median_seconds
from experiments._measures import timed
from experiments._runner import Section, run
from plr_jax import PLR, VisibilityGraph, Workspace, construct, plot, scenes, trace

MAX_BYTES, DEPTH = 8_192, 1e-3
_GOALS, _STARTS, _POINTS, _QUERIES, _AGENTS, _CROWDS = 30, 10, 100_000, 20_000, 100, 3
_SHOWN = 2  # routes in the picture: so many that JuPedSim makes longest, and the one deepest in walls
COLORS = {"JuPedSim": "#D55E00", "cones": "#0072B2"}
# Exits of ``aknz_evac`` are those of JuPedSim's example. Those of ``arena`` are ours: stairs, a way across, an aisle.
EXITS = {
    "arena": [
        [(51.2, 54.6), (52.8, 54.6), (52.8, 55.4), (51.2, 55.4)],
        [(42.0, 49.6), (42.6, 49.6), (42.6, 50.5), (42.0, 50.5)],
        [(48.4, 64.9), (49.4, 64.9), (49.4, 65.3), (48.4, 65.3)],
    ],
    "aknz_evac": [
        [(726.42, 1948.03), (721.32, 1964.0), (739.34, 1961.39), (746.12, 1959.66), (742.27, 1944.6)],
        [(895.93, 1925.66), (896.41, 1944.51), (901.41, 1944.38), (900.91, 1924.94)],
    ],
    "floor_plan": [[(1.0, 1.0), (2.0, 1.0), (2.0, 2.0), (1.0, 2.0)]],
}


def walkable_areas(smoke: bool) -> dict[str, Workspace]:
    """The two maps where ``PLR_JAX_DATA`` has them; ``floor_plan`` in the smallest setting."""
    if smoke:
        return {"floor_plan": scenes.floor_plan().workspace}
    paths = [Path(os.environ.get("PLR_JAX_DATA", "")) / f"jupedsim/{name}.wkt" for name in ("arena", "aknz_evac")]
    for path in paths:
        if not path.exists():
            print(f"{path.stem}: skipped, PLR_JAX_DATA names no folder with jupedsim/{path.name}")
    return {path.stem: scenes.read_workspace(path) for path in paths if path.exists()}


def _bridge(name: str) -> Any:
    """A module that uses JuPedSim; None, with a message, if JuPedSim is not installed."""
    if find_spec("jupedsim") is None:
        print("skipped: pip install jupedsim")
        return None
    return importlib.import_module(f"experiments.environments.{name}")


def cones(seed: int, smoke: bool) -> dict[str, Any]:
    rows = []
    for name, area in walkable_areas(smoke).items():
        goals = area.sample_free(2 if smoke else 5, seed)
        x = area.sample_free(1_000 if smoke else _POINTS, seed + 1)
        seconds, errors, nanoseconds = [], [], []
        for goal in goals:
            took, (oracle, plr) = timed(partial(_built, area, goal))
            error = np.abs(np.asarray(plr(x), float) - oracle(x))
            with tempfile.TemporaryDirectory() as folder:
                nanoseconds.append(compiled_header(plr, Path(folder)).nanoseconds(x))
            seconds.append(took)
            errors.append({"mean": float(error.mean()), "largest": float(error.max())})
        row = {"map": name, "vertices": len(area.boundary.vertices), "goals": len(goals), "points": len(x)}
        row |= {"seconds": seconds, "mean": float(np.mean([each["mean"] for each in errors]))}
        row |= {"largest": max(each["largest"] for each in errors), "nanoseconds": nanoseconds}
        rows.append(row)
    return {"max_bytes": MAX_BYTES, "rows": rows}


def _built(area: Workspace, goal: np.ndarray) -> tuple[VisibilityGraph, Any]:
    oracle = VisibilityGraph(area, goal)
    return oracle, construct(oracle, area.bounds, leaf="cone", max_bytes=MAX_BYTES)


def routes(seed: int, smoke: bool) -> dict[str, Any]:
    num_goals, num_starts = (2, 3) if smoke else (_GOALS, _STARTS)
    rows, bridge = [], _bridge("jupedsim_routes")
    for name, area in walkable_areas(smoke).items() if bridge else ():
        inflated = area.inflate(bridge.RADIUS)
        goals, starts = inflated.sample_free(num_goals, seed), inflated.sample_free(num_goals * num_starts, seed + 1)
        found = bridge.compare_routes(area, goals, starts.reshape(num_goals, num_starts, 2), MAX_BYTES)
        ends = starts, np.repeat(goals, num_starts, axis=0)
        exact, clear = (VisibilityGraph(each, goals[0]).between(*ends) for each in (area, inflated))
        theirs = found["JuPedSim"]
        shown = [*np.argsort(-theirs.over_exact)[:_SHOWN], theirs.depth.argmax()]
        row: dict[str, Any] = {"map": name, "pairs": len(starts)}
        for router, each in found.items():
            row[router] = {
                **_mean_and_largest(each.over_exact),
                "over_clear": _mean_and_largest(each.over_exact * exact / clear),
                "crosses": int((each.depth > DEPTH).sum()),
                "deepest": float(each.depth.max()),
                "paths": [each.paths[i].tolist() for i in shown],
            }
        oracle, plr = _built(area, goals[0])
        x = inflated.sample_free(_QUERIES, seed + 2)
        many = bridge.Routes.of(bridge.routes_of_cones(plr, x, area), oracle(x), area)
        row["many"] = {**_mean_and_largest(many.over_exact), "crosses": int((many.depth > DEPTH).sum())}
        row["microseconds"] = _microseconds(bridge, area, goals[0], plr, x)
        rows.append(row)
        print({key: each for key, each in row["JuPedSim"].items() if key != "paths"}, row["microseconds"], flush=True)
    return {"max_bytes": MAX_BYTES, "depth": DEPTH, "queries": _QUERIES, "agents": _AGENTS, "rows": rows}


def _mean_and_largest(values: np.ndarray) -> dict[str, float]:
    return {"mean": float(values.mean()), "largest": float(values.max())}


def _microseconds(bridge: Any, area: Workspace, goal: np.ndarray, plr: PLR, x: np.ndarray) -> dict[str, float]:
    """CPU microseconds of a query: whole paths, waypoints and distances, in batches and one by one."""
    engine, end = bridge.jupedsim.RoutingEngine(area.free_space), tuple(goal)
    numpy, few = plr.numpy(), x[:_AGENTS]
    calls = {
        "JuPedSim": (_AGENTS, lambda: [engine.compute_waypoints(tuple(start), end) for start in few]),
        "paths": (len(x), lambda: trace(plr, x, area)),
        "path": (_AGENTS, lambda: [trace(plr, start[None], area) for start in few]),
        "waypoints": (len(x), lambda: numpy.waypoint(x)),
        "agents": (_AGENTS, lambda: numpy.waypoint(few)),
        "waypoint": (_AGENTS, lambda: [numpy.waypoint(start) for start in few]),
        "distance": (_AGENTS, lambda: [numpy(start) for start in few]),
    }
    return {name: 1e6 * median_seconds(call) / number for name, (number, call) in calls.items()}


def evacuations(seed: int, smoke: bool) -> dict[str, Any]:
    num_agents, num_crowds = (5, 1) if smoke else (_AGENTS, _CROWDS)
    rows, bridge = [], _bridge("jupedsim")
    for name, area in walkable_areas(smoke).items() if bridge else ():
        seconds, exits = timed(partial(bridge.Exits, area, EXITS[name], MAX_BYTES))
        row: dict[str, Any] = {"map": name, "exits": len(exits.polygons), "agents": num_agents, "build": seconds}
        for crowd in range(num_crowds):
            starts = bridge.jupedsim.distribute_by_number(
                polygon=area.inflate(1.1 * bridge.RADIUS).free_space,
                number_of_agents=num_agents,
                distance_to_agents=2.2 * bridge.RADIUS,
                distance_to_polygon=0.0,
                seed=seed + crowd,
            )
            for router, is_steered in (("JuPedSim", False), ("cones", True)):
                simulate = partial(bridge.evacuate, area, exits, np.array(starts), is_steered=is_steered)
                took, (left, stuck) = timed(simulate)
                run_ = {"last": float(left.max()), "mean": float(left.mean()), "stuck": len(stuck), "cpu": took}
                row.setdefault(router, []).append(run_)
                print(name, router, run_, flush=True)
        rows.append(row)
    return {"rows": rows}


def draw(results: dict[str, Any], output: Path) -> list[Path]:
    areas = walkable_areas(smoke=False) | walkable_areas(smoke=True)
    rows = [row for row in results["rows"] if row["map"] in areas]
    if not rows:
        return []
    figure = Figure(figsize=(6.4 * len(rows), 5.6), layout="constrained", facecolor="white")
    for ax, row in zip(figure.subplots(1, len(rows), squeeze=False)[0], rows, strict=True):
        plot.plot_workspace(areas[row["map"]], ax)
        for router, color in COLORS.items():
            for path in row[router]["paths"]:
                ax.plot(*np.transpose(path), color=color, lw=1.6, label=router)
        handles, labels = ax.get_legend_handles_labels()
        ax.legend(dict(zip(labels, handles, strict=True)).values(), dict.fromkeys(labels))
        ax.set(xlabel="x (m)", ylabel="y (m)", title=row["map"])
    figure.savefig(output / "pedestrians.png", dpi=90)
    return [output / "pedestrians.png"]


SECTIONS = {"cones": Section(cones), "routes": Section(routes, draw), "evacuations": Section(evacuations)}

if __name__ == "__main__":
    run("pedestrians", __doc__, SECTIONS)
