"""Exact distances among polygons: preprocessing and microseconds a point, on maps of 28 to 4,004 vertices.

Preprocessing begins with the rings of free space, so that each run has a workspace of its own: a workspace keeps what
it has found once. It is reported in two parts, the workspace and the visibility graph of it, each the median of three
runs, fewer where they take long. A batch holds random free points, and goals are random free points too.

The rivals answer one point a call, and are run by another Python, which the environment variable
``PLR_JAX_EXACT_RIVALS`` names (:mod:`experiments.benchmarks._exact_rivals` says what it needs). Both let a path pass
between obstacles that touch in one point, which ours does not. So where there are any, the rivals' obstacles are
grown a little and overlap. pyvisgraph knows no outer boundary: what is not free is given to it as obstacles, with a
frame around the map that is slit open to be a polygon without holes; the slit leads nowhere.
"""

import json
import os
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from jaxtyping import Float
from tqdm import tqdm

from experiments.benchmarks._maps import Map, load_map
from plr_jax import VisibilityGraph, Workspace

RIVALS = ("extremitypathfinder", "pyvisgraph")
RIVALS_PYTHON = "PLR_JAX_EXACT_RIVALS"
BATCHES, LARGE_MAP = (1, 1_000, 100_000), 4_000
NUM_RUNS, NUM_QUERIES = 3, 30
SECONDS_A_BATCH, SECONDS_IN_ALL = 0.2, 20.0
RIVAL_LIMIT, QUERY_LIMIT = 25.0, 5.0
_CORNERS = 8  # of an obstacle of a synthetic map
_GROWN, _FRAME, _SLIT = 1e-7, 0.1, 1e-4  # as shares of the longer side of the bounds
_MAPS = ("maze", "arena", "den312d", "den520d", "synthetic")


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    batches = BATCHES[:2] if smoke else BATCHES
    maps = [(name, _map(name, seed, smoke)) for name in (["maze", "synthetic"] if smoke else _MAPS)]
    results: dict[str, Any] = {"rival_limit": RIVAL_LIMIT, "maps": {}}
    too_slow: dict[str, str] = {}
    for name, entry in tqdm(maps, desc="maps", disable=None):
        if entry is None:
            results["maps"][name] = {"skipped": "PLR_JAX_DATA names no folder with this map"}
            continue
        row, oracle = _ours(*entry, batches, seed)
        row["rivals"] = {rival: _rival(rival, oracle, seed, too_slow.get(rival)) for rival in RIVALS}
        for rival, outcome in row["rivals"].items():
            if outcome.get("over_limit"):
                too_slow[rival] = name
        results["maps"][name] = row
    return results


def polygon_field(num_vertices: int, seed: int) -> Map:
    """A map of disjoint convex obstacles, and a goal: octagons of random size, place and angles, one in each cell.

    Args:
        num_vertices: Vertices of the obstacles together, rounded down to whole octagons.
        seed: Of the random numbers.
    """
    rng = np.random.default_rng(seed)
    count = num_vertices // _CORNERS
    side = int(np.ceil(np.sqrt(count)))
    center = np.stack(np.divmod(np.arange(count), side), axis=1) + 0.5 + rng.uniform(-0.1, 0.1, (count, 2))
    radius = rng.uniform(0.2, 0.38, count)
    # At least a fifth of a step between two corners, so that none lies on the line through its neighbors.
    angle = 2 * np.pi / _CORNERS * (np.arange(_CORNERS) + rng.uniform(-0.4, 0.4, (count, _CORNERS)))
    rings = center[:, None] + radius[:, None, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    workspace = Workspace(((0.0, 0.0), (float(side), float(side))), list(rings))
    return workspace, workspace.sample_free(1, seed)[0]


def _seconds(call: Callable[[], Any]) -> tuple[float, Any]:
    start = time.perf_counter()
    result = call()
    return time.perf_counter() - start, result


def _map(name: str, seed: int, smoke: bool) -> Map | None:
    if name == "synthetic":
        return polygon_field(80 if smoke else LARGE_MAP, seed)
    found = load_map(name)
    # A goal of the collection may lie on a wall, which not every rival can take.
    return None if found is None else (found[0], found[0].sample_free(1, seed)[0])


def prepared(workspace: Workspace, goal: Float[np.ndarray, "2"]) -> tuple[float, float, VisibilityGraph]:
    """Seconds to a workspace, seconds from there to its oracle, and the oracle."""
    components = [
        {"outer": ring_of(part.exterior), "holes": [ring_of(hole) for hole in part.interiors]}
        for part in shapely.get_parts(workspace.free_space)
    ]
    to_workspace, new = _seconds(lambda: Workspace.from_polygons(components, squeeze=workspace.squeeze))
    to_oracle, oracle = _seconds(lambda: VisibilityGraph(new, goal))
    return to_workspace, to_oracle, oracle


def _ours(
    workspace: Workspace, goal: Float[np.ndarray, "2"], batches: tuple[int, ...], seed: int
) -> tuple[dict[str, Any], VisibilityGraph]:
    runs, begun = [], time.perf_counter()
    while len(runs) < NUM_RUNS and (not runs or time.perf_counter() - begun < SECONDS_IN_ALL):
        runs.append(prepared(workspace, goal))
    oracle = runs[0][2]
    x = workspace.sample_free(max(batches), seed + 1)
    row = {
        "vertices": len(workspace.boundary.vertices),
        "runs": len(runs),
        "seconds_workspace": float(np.median([run[0] for run in runs])),
        "seconds_prepare": float(np.median([run[1] for run in runs])),
        "microseconds_a_point": {str(n): _a_point(oracle, x, n) for n in batches},
    }
    return row, oracle


def _a_point(oracle: VisibilityGraph, x: Float[np.ndarray, "points 2"], n: int) -> float:
    """Median microseconds a point of batches of ``n``, which begin at other points each time, as points differ."""
    oracle(x[: min(n, 1_000)])
    seconds, begun = [], time.perf_counter()
    while len(seconds) < NUM_RUNS or time.perf_counter() - begun < SECONDS_A_BATCH:
        begin = len(seconds) * n % (len(x) - n + 1)
        batch = x[begin : begin + n]
        seconds.append(_seconds(lambda batch=batch: oracle(batch))[0] / n)
        if time.perf_counter() - begun > SECONDS_IN_ALL / 2:
            break
    return float(np.median(seconds)) * 1e6


def _rival(rival: str, oracle: VisibilityGraph, seed: int, too_slow: str | None) -> dict[str, Any]:
    """What a rival takes on our oracle's map, and how far its answers are from ours; or why there are none."""
    python = os.environ.get(RIVALS_PYTHON)
    if python is None:
        return {"skipped": f"{RIVALS_PYTHON} names no Python that has it"}
    if too_slow is not None:
        return {"skipped": f"over the limit of {RIVAL_LIMIT:g} s on {too_slow}, which has fewer vertices"}
    x = oracle.workspace.sample_free(NUM_QUERIES, seed + 2)
    task = {**polygons_of(oracle.workspace, oracle.goal), "rival": rival, "goal": oracle.goal.tolist()}
    task |= {"queries": x.tolist(), "query_limit": QUERY_LIMIT}
    script = Path(__file__).parent / "_exact_rivals.py"
    try:
        ran = subprocess.run(
            [python, script], input=json.dumps(task), capture_output=True, text=True, timeout=RIVAL_LIMIT, check=False
        )
    except subprocess.TimeoutExpired:
        return {"skipped": f"over the limit of {RIVAL_LIMIT:g} s", "over_limit": True}
    except OSError as error:
        return {"skipped": f"{RIVALS_PYTHON} cannot be run: {error.strerror}"}
    if ran.returncode != 0:
        return {"skipped": f"failed: {ran.stderr.strip().splitlines()[-1]}"}
    report = json.loads(ran.stdout)
    theirs = np.array([np.inf if d is None else d for d in report.pop("distances")])
    difference = np.abs(theirs - oracle(x[: len(theirs)]))
    unanswered = ~np.isfinite(difference)
    report |= {"queries": len(theirs), "unanswered": int(unanswered.sum())}
    return {**report, "largest_difference": float(difference[~unanswered].max(initial=0.0))}


def polygons_of(workspace: Workspace, goal: Float[np.ndarray, "2"]) -> dict[str, Any]:
    """The connected part of free space that holds the goal, in the terms of both rivals."""
    width = float(workspace.bounds.width.max())
    touching = len(workspace.boundary.contacts) > 0 and not workspace.squeeze
    free: Any = shapely.buffer(workspace.free_space, -_GROWN * width if touching else 0.0, join_style="mitre")
    parts = shapely.orient_polygons(shapely.get_parts(free))
    part = min(parts, key=lambda part: part.distance(shapely.Point(goal)))
    return {
        "outer": ring_of(part.exterior),
        "holes": [ring_of(hole) for hole in part.interiors],
        "obstacles": [ring_of(obstacle.exterior) for obstacle in _obstacles(part, width)],
    }


def _obstacles(free: Any, width: float) -> list[Any]:
    """What is not free, within a frame around it that has a slit, as polygons without holes."""
    x0, y0, x1, y1 = free.bounds
    margin = _FRAME * width
    frame = shapely.box(x0 - margin, y0 - margin, x1 + margin, y1 + margin)
    rim = np.array(free.exterior.coords)
    lowest = rim[:, 1].argmin()
    x, y = (rim[lowest] + rim[lowest + 1 if lowest + 1 < len(rim) else 1]) / 2
    slit = shapely.box(x - _SLIT * width, y0 - 2 * margin, x + _SLIT * width, y + _SLIT * width)
    return list(shapely.get_parts(shapely.difference(shapely.difference(frame, free), slit)))


def ring_of(ring: Any) -> list[list[float]]:
    return shapely.get_coordinates(ring)[:-1].tolist()
