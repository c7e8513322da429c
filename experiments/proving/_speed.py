"""Seconds of cones beside planes: queries of as many leaves, and the way from a workspace to a PLR.

Queries are of the maze, of random points of its domain, which are on the device; the leaf models take turns. Builds
are warm, each from rings of free space by way of a workspace and a visibility graph of its own; they take turns too.
"""

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np

from experiments._tables import aligned
from experiments.benchmarks._maps import Map, load_maps
from experiments.benchmarks._oracle import prepared
from experiments.benchmarks._timing import interleaved
from plr_jax import PLR, VisibilityGraph, construct

QUERIED, QUERIED_LEAVES = "maze", (128, 256, 512, 1_024, 2_048)
POINTS, POINT_SEED = 1_000_000, 1_000
BUILDS: dict[str, dict[str, int]] = {
    "maze": {"max_leaves": 512},
    "arena": {"max_bytes": 16_384},
    "den520d": {"max_bytes": 16_384},
}
_LEAVES = ("cone", "plane")
_QUERY_TURNS, _BUILD_TURNS = 15, 5


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    return {"queries": _queries(seed, smoke), "builds": _builds(seed, smoke)}


def _queries(seed: int, smoke: bool) -> dict[str, Any]:
    points, leaves = (1_000, QUERIED_LEAVES[:1]) if smoke else (POINTS, QUERIED_LEAVES)
    ((workspace, goal),) = load_maps([QUERIED]).values()
    oracle = VisibilityGraph(workspace, goal)
    x = workspace.bounds.lo + workspace.bounds.width * np.random.default_rng(POINT_SEED + seed).random((points, 2))
    on_device = jnp.asarray(x, jnp.float32)
    plrs = {
        (leaf, number): construct(oracle, workspace.bounds, leaf=leaf, max_leaves=number, seed=seed)
        for number in leaves
        for leaf in _LEAVES
    }

    def query(plr: PLR) -> Callable[[], Any]:
        return lambda: plr(on_device)

    seconds = interleaved({str(key): query(plr) for key, plr in plrs.items()}, 2 if smoke else _QUERY_TURNS)
    rows = [
        {
            "leaf": key[0],
            "max_leaves": key[1],
            "leaves": plr.num_leaves,
            "nanoseconds": [1e9 / points * s for s in seconds[str(key)]],
        }
        for key, plr in plrs.items()
    ]
    return {"map": QUERIED, "points": points, "rows": rows}


def _builds(seed: int, smoke: bool) -> list[dict[str, Any]]:
    maps = load_maps(list(BUILDS)[: 1 if smoke else None])
    rows = []
    for name, found in maps.items():
        calls = {leaf: _build(found, leaf, BUILDS[name], seed) for leaf in _LEAVES}
        seconds = interleaved(calls, 1 if smoke else _BUILD_TURNS)
        for leaf, call in calls.items():
            plr = call()
            sizes = {"leaves": plr.num_leaves, "bytes": plr.num_bytes}
            rows.append({"map": name, "leaf": leaf, **BUILDS[name], **sizes, "seconds": list(seconds[leaf])})
            print(_build_line(rows[-1]), flush=True)
    return rows


def _build(found: Map, leaf: str, limits: dict[str, Any], seed: int) -> Callable[[], PLR]:
    def build() -> PLR:
        *_, oracle = prepared(*found)
        return construct(oracle, oracle.workspace.bounds, leaf=leaf, seed=seed, **limits)

    return build


def _build_line(row: dict[str, Any]) -> str:
    median = row["seconds"][0]
    return f"{row['map']:9}{row['leaf']:6}{row['leaves']:>7,} leaves {row['bytes']:>7,} bytes  {median:.3f} s"


def cone_over_plane(queries: dict[str, Any]) -> dict[int, float]:
    """By number of leaves, how many times as long a query of cones takes as one of planes."""
    medians = {(row["leaf"], row["max_leaves"]): row["nanoseconds"][0] for row in queries["rows"]}
    return {number: medians["cone", number] / medians["plane", number] for leaf, number in medians if leaf == "cone"}


def table(results: dict[str, Any]) -> str:
    queries, ratios = results["queries"], cone_over_plane(results["queries"])
    rows = [["leaf", "at most", "leaves", "ns a point", "cone / plane"]]
    for row in queries["rows"]:
        ratio = f"{ratios[row['max_leaves']]:.2f}" if row["leaf"] == "cone" else ""
        cells = [f"{row['max_leaves']:,}", f"{row['leaves']:,}", f"{row['nanoseconds'][0]:.2f}", ratio]
        rows.append([row["leaf"], *cells])
    builds = [_build_line(row) for row in results["builds"]]
    head = f"{queries['map']}, {queries['points']:,} points\n"
    return head + aligned(rows, numbers=4) + "\nfrom workspace to PLR\n" + "\n".join(builds) + "\n"
