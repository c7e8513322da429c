"""Volumes of voxels: estimates and proven bounds from what is free, beside scikit-fmm.

``volumes``: rooms, boxes and a spiral ramp. The truth are paths of ``VoxelGraph(moves=26)``, pulled taut at any
angle (``_taut_paths.py``). Broken is a lower bound above one of these, and an upper bound below the lower one or the
straight line.

Lengths are in voxels; errors and gaps are means, as shares of the mean truth. Seconds are of all cores: of certified
PLRs with what is compiled for them, of estimates alone those of a second call, and of scikit-fmm with what prepares
the march.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from experiments._made_volumes import Volume, boxes, first_free, rooms, spiral
from experiments._measures import relative_error, timed
from experiments._runner import Section, run
from experiments._taut_paths import taut_paths
from experiments.solving._rivals import marched
from plr_jax import PLR, VoxelGraph, VoxelSpace, solve_eikonal

POINTS, QUERIES = 2_000, 1_000_000
LEAVES, BYTES = 21_000, 32_768  # of volumes, in about 64 KiB; the bytes are those of estimates alone
CERTIFIED = (True, False)
_ROUNDING = 1e-6
_TURNS = 5

Points = Float[np.ndarray, "n dim"]


def volumes(seed: int, smoke: bool) -> dict[str, Any]:
    rng = np.random.default_rng(seed)
    made = {
        "rooms": rooms(rng, (16, 16, 8) if smoke else (64, 64, 32), 8 if smoke else 16, 1.0 if smoke else 0.6),
        "boxes": boxes(rng, (128, 128, 128), 60, 10, 45),
        "spiral": spiral(64, 16),
    }
    parts = [_volume(name, free, seed, smoke) for name, free in list(made.items())[: 1 if smoke else None]]
    return {"rows": [row for rows, _ in parts for row in rows], "rivals": [rival for _, rival in parts]}


def _volume(name: str, free: Volume, seed: int, smoke: bool) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    space, goal, rng = VoxelSpace(free), first_free(free) + 0.5, np.random.default_rng(seed)
    graph = VoxelGraph(free, goal)
    x = _reached(graph, 50 if smoke else POINTS, rng)
    x = np.floor(x) + rng.random(x.shape)
    truth = taut_paths(space, graph, x).lengths

    def solve(certified: bool) -> PLR:
        limits = {
            "max_leaves": 300 if smoke else LEAVES,
            "max_bytes": None if certified else 1_024 if smoke else BYTES,
        }
        return solve_eikonal(space, goal, **limits, certified=certified)

    rows, queries = [], jnp.asarray(rng.random((100 if smoke else QUERIES, 3)) * free.shape, jnp.float32)
    ask = jax.jit(lambda plr, x: plr(x))
    for certified in CERTIFIED:
        if not certified:
            solve(certified)
        seconds, plr = timed(lambda certified=certified: solve(certified))
        row = {"volume": name, "certified": certified, "points": len(x), "mean length": float(truth.mean())}
        row |= {"leaves": plr.num_leaves, "bytes": plr.num_bytes, "seconds": seconds}
        asked = [timed(lambda plr=plr: ask(plr, queries).block_until_ready())[0] for _ in range(1 + _TURNS)]
        row |= {"ns a query": 1e9 * float(np.median(asked[1:])) / len(queries)}  # the first one compiles
        row |= {"error": relative_error(np.asarray(plr(x), float), truth)}
        rows.append(row | (_bounds(plr, x, truth, goal) if certified else {}))
    seconds, march = timed(lambda: marched(space, goal, free.shape))
    found = march(x)
    rival = {"volume": name, "scikit-fmm": relative_error(found, truth), "its seconds": seconds}
    rival |= {"its nodes": free.size, "unanswered": int(np.count_nonzero(~np.isfinite(found)))}
    return rows, rival | {"26 moves": relative_error(graph(x), truth)}


def _bounds(plr: PLR, x: Points, truth: Float[np.ndarray, " n"], goal: Float[np.ndarray, " dim"]) -> dict[str, Any]:
    """How far bounds are apart, and how many are broken; and upper bounds by paths shorter than the truth's."""
    lower, upper = (np.asarray(each, float) for each in plr.bounds(x))
    known, above = np.isfinite(upper), (1 + _ROUNDING) * upper
    too_low = above < np.maximum(lower, np.linalg.norm(x - goal, axis=1))
    return {
        "lower / truth": float(lower.mean() / truth.mean()),
        "gap": float((upper - lower)[known].mean() / truth[known].mean()) if known.any() else None,
        "upper known": float(known.mean()),
        "broken": int(np.count_nonzero((lower > (1 + _ROUNDING) * truth) | too_low)),
        "upper below truth": int(np.count_nonzero(above < truth)),
    }


def _reached(graph: VoxelGraph, num: int, rng: np.random.Generator) -> Points:
    """Centers of random voxels, of those that the goal is reached from."""
    center = np.argwhere(graph.free) + 0.5
    return rng.choice(center[np.isfinite(graph(center))], num)


SECTIONS = {each.__name__: Section(each) for each in (volumes,)}

if __name__ == "__main__":
    run("volumes", __doc__, SECTIONS)
