"""Distances in a building of seven floors: exact, in files with proven bounds, between any two places; their speed.

Westport House in Dundee: seven floors with 29 stairs and elevators, in meters, from the folder that ``PLR_JAX_DATA``
names. The smallest setting takes a random building of the tests instead.

``exact``: the oracle beside an independent search of the tests, by Shapely and NetworkX, to goals on five floors.
``costs``: CPU seconds, bytes and errors of certified PLRs of one goal.
``bounds``: random points at which proven bounds do not hold the exact distance.
``speed``: time of a query in batches and alone, beside NetworkX; pairs.
``random``: wrong answers in the random buildings of the tests, which have links of all kinds, touching walls, and
floors far from the origin.
"""

import ctypes
import json
import os
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable
from functools import cache, partial
from importlib import import_module
from pathlib import Path
from typing import Any

import jax
import networkx
import numpy as np
import shapely
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from experiments._c_headers import compiled_library, median_seconds
from experiments._measures import timed
from experiments._runner import Section, run
from plr_jax import Building, Link, construct_pairs, scenes
from plr_jax.buildings import BuildingPLR

BUDGETS, PAIR_BYTES = (12_288, 24_576, 32_768), 262_144
SEARCH_ERROR = 1e-9  # meters: a larger difference to the independent search counts as wrong
_GOALS, _POINTS, _BOUNDED, _BATCH, _SINGLE, _RANDOM = 5, 2_000, 1_000_000, 100_000, 100, 300
_FILES, _PAIRS = 3, 5  # of so many random buildings one has its file, or its pairs, checked
_TESTS = Path(__file__).parent.parent / "tests"
_PATH = "#D55E00"


def helpers(name: str) -> Any:
    """Import a module of the tests."""
    if str(_TESTS) not in sys.path:
        sys.path.append(str(_TESTS))
    return import_module(name)


@cache
def building_and_goal(smoke: bool) -> tuple[Building, tuple] | None:
    """Return the building and a goal; None, with a message, without the data."""
    if smoke:
        building = helpers("building_helpers").random_building(0)
        return building, (1, building.floors[1].sample_free(1, 0)[0].tolist())
    folder = Path(os.environ.get("PLR_JAX_DATA", "")) / "westport"
    if not folder.exists():
        print("skipped: PLR_JAX_DATA names no folder with westport")
        return None
    entries = json.loads((folder / "links.json").read_text())
    places = [tuple(zip(entry["floors"], entry["at"], strict=True)) for entry in entries]
    links = [Link(start, end, entry["cost"]) for (start, end), entry in zip(places, entries, strict=True)]
    building = Building([scenes.read_workspace(folder / f"floor_{k}.wkt") for k in range(7)], links)
    floor, (x, y) = links[0].start
    return building, (floor, (x + 0.3, y + 0.2))


def on_building(measure: Callable[..., dict[str, Any]], seed: int, smoke: bool) -> dict[str, Any]:
    found = building_and_goal(smoke)
    return {} if found is None else measure(*found, seed, smoke)


def samples(building: Building, number: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return free points of all floors, in random order: their floors ``(n,)`` and coordinates ``(n, 2)``."""
    floor = np.repeat(np.arange(len(building.floors)), number)
    x = np.concatenate([each.sample_free(number, seed + k) for k, each in enumerate(building.floors)])
    order = np.random.default_rng(seed).permutation(len(floor))
    return floor[order], x[order]


# Right answers.


def exact(building: Building, goal: tuple, seed: int, smoke: bool) -> dict[str, Any]:
    floor, x = samples(building, 50 if smoke else _POINTS, seed)
    seconds, search = timed(lambda: helpers("building_helpers").BruteForce(building))
    rows = []
    others = [(k, each.sample_free(1, seed)[0].tolist()) for k, each in enumerate(building.floors) if k != goal[0]]
    for to in [goal, *others][:_GOALS]:
        oracle, field, truth = building.oracle(*to), search.field([to]), np.empty(len(x))
        for k in range(len(building.floors)):
            truth[floor == k] = field(k, x[floor == k])
        distance, is_reached = oracle(floor, x), np.isfinite(truth)
        wrong = helpers("building_checks").are_wrong(distance, truth, SEARCH_ERROR).sum()
        largest = np.abs(distance[is_reached] - truth[is_reached]).max(initial=0)
        reached = float(is_reached.mean())
        rows.append({"floor": to[0], "reached": reached, "wrong": int(wrong), "largest": float(largest)})
    # The picture shows the path from the farthest point to the first goal.
    oracle = building.oracle(*goal)
    distance = oracle(floor, x)
    farthest = int(np.where(np.isfinite(distance), distance, -1).argmax())
    legs = [(k, points.tolist()) for k, points in oracle.shortest_path(int(floor[farthest]), x[farthest]).legs]
    counts = {"points": len(x), "error": SEARCH_ERROR, "search_seconds": seconds}
    return {**counts, "rows": rows, "goal": goal, "longest": float(distance[farthest]), "legs": legs}


def bounds(building: Building, goal: tuple, seed: int, smoke: bool) -> dict[str, Any]:
    oracle = building.oracle(*goal)
    floor, x = samples(building, 100 if smoke else _BOUNDED // len(building.floors) + 1, seed)
    distance = np.concatenate([oracle(*part) for part in _batches(floor, x)])
    is_reached, rows = np.isfinite(distance), []
    for max_bytes in BUDGETS[:1] if smoke else BUDGETS:
        reader = built(oracle, max_bytes).numpy()
        lower, upper = np.concatenate([reader.bounds(*part) for part in _batches(floor, x)], axis=1)
        is_broken = is_reached & ~((lower <= distance) & (distance <= upper))
        rows.append({"budget": max_bytes, "points": int(is_reached.sum()), "broken": int(is_broken.sum())})
    return {"rows": rows}


def _batches(floor: np.ndarray, x: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    parts = max(1, len(x) // _BATCH)
    return list(zip(np.array_split(floor, parts), np.array_split(x, parts), strict=True))


def random(seed: int, smoke: bool) -> dict[str, Any]:
    checks, total = helpers("building_checks"), {"oracle": Counter(), "file": Counter(), "pairs": Counter()}
    number = 2 if smoke else _RANDOM
    warnings.filterwarnings("ignore", "The goal cannot be reached")
    for each in range(seed, seed + number):
        for num_goals in (1, 3):
            case = checks.Case(each, num_goals)
            total["oracle"].update(checks.wrong_of_oracle(case))
            if each % _FILES == 0:
                plr = case.oracle.construct(max_bytes=1_200 + 60 * len(case.building.links), certified=True)
                total["file"].update(checks.wrong_of_plr(case, plr))
        if each % _PAIRS == 0:
            total["pairs"].update(checks.wrong_of_pairs(case))
    counts = {part: {name: int(count) for name, count in wrong.items()} for part, wrong in total.items()}
    return {"buildings": number, "one_file_of": _FILES, "one_pairs_of": _PAIRS, **counts}


# Costs and speed.


def built(oracle: Any, max_bytes: int) -> BuildingPLR:
    return oracle.construct(max_bytes=max_bytes, certified=True)


def costs(building: Building, goal: tuple, seed: int, smoke: bool) -> dict[str, Any]:
    building = Building(building.floors, building.links)  # nothing is prepared
    preparing, oracle = timed(lambda: building.oracle(*goal))
    another = median_seconds(lambda: building.oracle(*goal))
    built(oracle, 1_500)  # compile
    (floor, x), rows = samples(building, 50 if smoke else _POINTS, seed), []
    distance = oracle(floor, x)
    is_reached = np.isfinite(distance)
    for max_bytes in BUDGETS[:1] if smoke else BUDGETS:
        seconds, plr = timed(partial(built, oracle, max_bytes))
        error = np.abs(np.asarray(plr(floor, x))[is_reached] - distance[is_reached])
        row = {"budget": max_bytes, "bytes": plr.num_bytes, "leaves": plr.plane.num_leaves, "cpu_seconds": seconds}
        row |= {"mean": float(error.mean()), "largest": float(error.max()), "proven": plr.max_error}
        rows.append(row)
        print(rows[-1], flush=True)
    sizes = {"floors": len(building.floors), "links": len(building.links)}
    sizes |= {"corners": len(building.corners.corners.points), "points": len(x)}
    return {**sizes, "preparing": preparing, "another_goal": another, "rows": rows}


def speed(building: Building, goal: tuple, seed: int, smoke: bool) -> dict[str, Any]:
    oracle = building.oracle(*goal)
    plr = built(oracle, BUDGETS[0 if smoke else 1])
    # 1. Batches of points on all floors.
    floor, x = samples(building, 50 if smoke else _BATCH // len(building.floors), seed)
    x = x.astype(np.float32)
    on_device, answers = jax.device_put((floor, x)), jax.jit(lambda plr, floor, x: plr(floor, x))
    with tempfile.TemporaryDirectory() as folder:
        batches = {
            "C": c_query(plr, floor, x, Path(folder)),
            "JAX": lambda: answers(plr, *on_device).block_until_ready(),
            "NumPy": partial(plr.numpy(), floor, x),
            "exact": partial(oracle, floor, x),
        }
        rows = [{"what": name, **_nanoseconds(call, len(x))} for name, call in batches.items()]
    # 2. One point after another, exactly.
    some = [(int(k), point) for k, point in zip(floor[:_SINGLE], x[:_SINGLE].astype(float), strict=True)]
    queries = {"networkx": search_by_networkx(building, goal), "exact": lambda k, point: oracle(k, point[None])[0]}
    alone = {name: np.array([query(*each) for each in some]) for name, query in queries.items()}
    assert not helpers("building_checks").are_wrong(alone["networkx"], alone["exact"], 1e-6).any()
    single = {}
    for name, query in queries.items():
        seconds = median_seconds(lambda query=query: [query(*each) for each in some])
        single[f"{name}_us"] = 1e6 * seconds / len(some)
    return {"bytes": plr.num_bytes, "batch": len(x), "rows": rows, **single, "pairs": _pairs(building, seed, smoke)}


def _nanoseconds(call: Callable[[], Any], number: int) -> dict[str, float]:
    call()  # compile
    cpu, walls = median_seconds(call), []
    for _ in range(5):
        began = time.perf_counter()
        call()
        walls.append(time.perf_counter() - began)
    return {"cpu_ns": 1e9 * cpu / number, "wall_ns": 1e9 * float(np.median(walls)) / number}


def c_query(plr: BuildingPLR, floor: np.ndarray, x: np.ndarray, folder: Path) -> Callable[[], np.ndarray]:
    """Return a function that answers for all points by the compiled header."""
    head = "void all(const int *floor, const float *x, float *y, uint32_t n)"
    body = "{ for (uint32_t i = 0; i < n; ++i) { y[i] = here_distance(floor[i], x + 2 * i); } }"
    library = compiled_library(f"{plr.c_header('here')}\n{head};\n{head} {body}\n", folder)
    arrays = floor.astype(np.int32), np.ascontiguousarray(x), np.empty(len(x), np.float32)

    def call() -> np.ndarray:
        library.all(*(ctypes.c_void_p(array.ctypes.data) for array in arrays), ctypes.c_uint32(len(x)))
        return arrays[2]

    return call


def search_by_networkx(building: Building, goal: tuple) -> Callable[[int, np.ndarray], float]:
    """Return a function that joins a point to the corners that it sees, and runs Dijkstra's algorithm of NetworkX.

    Its graph is the oracle's visibility graph, built before. Shapely tests what a point sees on its floor.
    """
    corners, floors = building.corners, building.plane_floors
    points = np.concatenate([corners.corners.points, building.in_plane(*goal)[None]])
    last, tolerance = len(points) - 1, building.plane.tolerance
    on_floor, free = [], [floor.free_space.buffer(floor.tolerance, join_style="mitre") for floor in building.floors]
    shapely.prepare(free)
    for k, floor in enumerate(building.floors):
        local = points - floors.shift[k]
        inside = ((local >= floor.bounds.lo - tolerance) & (local <= floor.bounds.hi + tolerance)).all(axis=1)
        on_floor.append((np.flatnonzero(inside), local[inside]))

    def seen(k: int, start: np.ndarray) -> tuple[list[int], list[float]]:
        index, ends = on_floor[k]
        lines: Any = shapely.linestrings(np.stack([np.broadcast_to(start, ends.shape), ends], axis=1))
        is_seen = shapely.covers(free[k], lines)
        return index[is_seen].tolist(), np.linalg.norm(ends - start, axis=1)[is_seen].tolist()

    graph, (a, b) = networkx.DiGraph(), corners.edges.T
    lengths = np.linalg.norm(points[a] - points[b], axis=1).tolist()
    for start, end in ((a, b), (b, a)):
        graph.add_weighted_edges_from(zip(start.tolist(), end.tolist(), lengths, strict=True))
    arcs = sorted(zip(*(column.tolist() for column in corners.arcs), strict=True), key=lambda arc: -arc[2])
    graph.add_weighted_edges_from(arcs)  # of several links between two places, the cheapest comes last
    graph.add_weighted_edges_from((i, last, length) for i, length in zip(*seen(*goal), strict=True) if i != last)

    def query(k: int, point: np.ndarray) -> float:
        graph.add_node("start")
        graph.add_weighted_edges_from(("start", i, length) for i, length in zip(*seen(k, point), strict=True))
        try:
            return networkx.dijkstra_path_length(graph, "start", last)
        except networkx.NetworkXNoPath:
            return np.inf
        finally:
            graph.remove_node("start")

    return query


def _pairs(building: Building, seed: int, smoke: bool) -> dict[str, Any]:
    """Build pairs; measure them between random places of all floors, and their errors by exact distances."""
    seconds, pairs = timed(lambda: construct_pairs(building, max_bytes=20_000 if smoke else PAIR_BYTES))
    (floor, x), (to, y) = (samples(building, 20 if smoke else _POINTS, seed + i) for i in (1, 2))
    compiled, ends = jax.jit(lambda pairs, x, y: pairs(x, y)), jax.device_put(((floor, x), (to, y)))
    nanoseconds, errors = _nanoseconds(lambda: compiled(pairs, *ends).block_until_ready(), len(x)), []
    for i in range(3 if smoke else _SINGLE):
        truth = building.oracle(int(to[i]), y[i])(floor, x)
        found = np.asarray(pairs((floor, x), (np.full(len(x), to[i]), np.tile(y[i], (len(x), 1)))))
        is_reached = np.isfinite(truth)
        errors.append(np.abs(found[is_reached] - truth[is_reached]))
    error = np.concatenate(errors)
    row = {"bytes": pairs.num_bytes, "cpu_seconds": seconds, "pairs": len(error), **nanoseconds}
    return {**row, "mean": float(error.mean()), "largest": float(error.max())}


# The picture.


def draw(results: dict[str, Any], output: Path) -> list[Path]:
    found = building_and_goal(smoke=False)
    if found is None or results.get("goal") != [found[1][0], list(found[1][1])]:
        return []  # no data, or results of the smallest setting
    building, goal = found
    oracle, count = building.oracle(*goal), len(building.floors)
    lo, hi = (np.stack([getattr(floor.bounds, name) for floor in building.floors]) for name in ("lo", "hi"))
    (x0, y0), (x1, y1) = lo.min(axis=0) - 1, hi.max(axis=0) + 1
    x, y = np.meshgrid(np.linspace(x0, x1, 480), np.linspace(y0, y1, 520))
    figure = Figure(figsize=(2.3 * count, 3.0), layout="constrained", facecolor="white")
    all_axes = figure.subplots(1, count, sharex=True, sharey=True)
    colors = Normalize(0, results["longest"])
    for k, ax in enumerate(all_axes):
        distance = np.ma.masked_invalid(oracle(k, np.stack([x.ravel(), y.ravel()], axis=1)).reshape(x.shape))
        image = ax.imshow(distance, norm=colors, extent=(x0, x1, y0, y1), origin="lower", interpolation="nearest")
        for ring in shapely.get_rings(shapely.get_parts(building.floors[k].free_space)):
            ax.plot(*shapely.get_coordinates(ring).T, color="#555555", lw=0.4)
        ax.set(title=f"floor {k}", aspect="equal", xticks=[], yticks=[])
    mark = {"color": "white", "mec": _PATH}
    for k, points in results["legs"]:
        all_axes[k].plot(*np.transpose(points), color=_PATH, lw=1.6)
        all_axes[k].plot(*np.transpose([points[0], points[-1]]), "o", ms=5, **mark)
    for k, points in (results["legs"][0], (goal[0], [goal[1]])):
        all_axes[k].plot(*points[0], "*", ms=11, **mark)
    figure.colorbar(image, ax=all_axes, label="distance (m)", shrink=0.8)
    figure.savefig(output / "buildings.png", dpi=110)
    return [output / "buildings.png"]


SECTIONS = {
    "exact": Section(partial(on_building, exact), draw),
    "costs": Section(partial(on_building, costs)),
    "bounds": Section(partial(on_building, bounds)),
    "speed": Section(partial(on_building, speed)),
    "random": Section(random),
}

if __name__ == "__main__":
    run("buildings", __doc__, SECTIONS)
