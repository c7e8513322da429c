"""Bytes of a progressive file over those of a file of its last PLR alone, which errs alike; and bytes of headers.

All have proofs. Layers are smaller than the file by a factor to some power, down to 256 bytes: 8, with which a file
has a coarser PLR at every eighth of what was fetched; or 36, with which there is one coarser PLR or two.
"""

from functools import cache, partial
from typing import Any

import numpy as np

import plr_jax
from plr_jax import Box, VisibilityGraph, construct, scenes
from plr_jax.plr.file.container import frame_size

BYTES, SMOKE_BYTES, LEAST, FACTORS = 65_536, 4_096, 256, (8, 36)
NUM_BOXES = 20_000


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    problem = scenes.maze()
    oracle, rows = VisibilityGraph(problem.workspace, problem.goals[0]), []
    bounds, factors = problem.workspace.bounds, FACTORS[: 1 if smoke else None]
    for leaf in ("plane",) if smoke else ("plane", "continuous", "smooth", "cone"):
        build = cache(partial(construct, oracle, bounds, leaf=leaf, certified=True))
        alone = build(max_bytes=SMOKE_BYTES if smoke else BYTES)
        for factor in factors:
            sizes = [alone.num_bytes // factor]
            while sizes[0] // factor >= LEAST:
                sizes.insert(0, sizes[0] // factor)
            whole = plr_jax.progressive([*(build(max_bytes=size) for size in sizes), alone])
            marks = [*whole.file_marks, whole.num_bytes]
            rows.append({"leaf": leaf, "factor": factor, "marks": marks, "ratio": whole.num_bytes / alone.num_bytes})
            print(_line(rows[-1]), flush=True)
    return {"rows": rows, "headers": _headers(seed, 100 if smoke else NUM_BOXES)}


def _headers(seed: int, count: int) -> dict[str, int]:
    """Bytes of header, domain and checksum in the plane: the most among random domains, and some by name."""
    rng, sizes = np.random.default_rng(seed), []
    for number in range(count):
        lo = rng.normal(size=2) * 10.0 ** rng.uniform(-6, 8)
        width = rng.random(2) * 10.0 ** rng.uniform(-3, 4) + 1e-3
        decimals = number % 20  # beyond 17 there are as many as a float has
        corners = np.array([lo, lo + width]) if decimals > 9 else np.round([lo, lo + 1 + width], decimals)
        periodic = (False, number % 7 == 0)
        sizes.append(frame_size(Box(corners[0], corners[1], periodic)))
    named = {
        "unit square": Box((0, 0), (1, 1)),
        "centimeters": Box((-12.35, 0.15), (40.25, 31.05)),
        "UTM": Box((391_542.25, 5_819_020.5), (393_542.25, 5_821_020.5)),
    }
    return {"random, most": max(sizes), **{name: frame_size(box) for name, box in named.items()}}


def table(results: dict[str, Any]) -> str:
    headers = ", ".join(f"{name} {size} B" for name, size in results["headers"].items())
    return "".join(_line(row) + "\n" for row in results["rows"]) + f"header, domain and checksum: {headers}\n"


def _line(row: dict[str, Any]) -> str:
    marks = ", ".join(f"{mark:,}" for mark in row["marks"])
    return f"{row['leaf']:12}steps of {row['factor']:>2}  ends at {marks:32} ratio {row['ratio']:.4f}"
