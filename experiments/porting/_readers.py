"""Readers of the format, each leaf model: are answers equal to the bit, how large is the code, how fast is it?

Points are uniform in a box 2 % wider than the domain, in 32-bit floats; far from the origin in 64-bit ones.
"""

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from experiments._tables import aligned
from experiments.porting._headers import compiled_header, median_seconds, object_for_size, section_bytes
from plr_jax import PLR, Box, Euclidean, ReedsShepp, VisibilityGraph, construct, scenes

NUM_POINTS, CHUNK, NUM_CALLS = 10_000_000, 1_000_000, 20_000
_WIDER = 1.02
_TURNS = Box((-5, -5, -np.pi), (5, 5, np.pi), periodic=(False, False, True))
_ZONE = Box((5e5, 4e6), (5e5 + 2000, 4e6 + 1500))


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    num_points, num_calls = (20_000, 100) if smoke else (NUM_POINTS, NUM_CALLS)
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for number, (name, make) in enumerate(plrs(512 if smoke else 2048).items()):
            plr = make()
            row = _measured(plr, Path(folder) / f"{number}", num_points, num_calls, seed)
            rows.append({"plr": name, "leaf": plr.leaf.name, "leaves": plr.num_leaves, "bytes": plr.num_bytes, **row})
            print(rows[-1], flush=True)
    return {"points": num_points, "rows": rows}


def plrs(max_bytes: int) -> dict[str, Callable[[], PLR]]:
    """PLRs of each leaf model, in several dimensions, with and without folding, near the origin and far from it."""
    problem = scenes.maze()
    oracle = VisibilityGraph(problem.workspace, problem.goals[0])
    car, ball = ReedsShepp((0, 0, 0), 1), Euclidean((0.3, 0.2, 0.1, 0, -0.3))
    square = problem.workspace.bounds
    return {
        "maze, planes": lambda: construct(oracle, square, max_bytes=max_bytes),
        "maze, continuous": lambda: construct(oracle, square, leaf="continuous", max_bytes=max_bytes),
        "maze, smooth": lambda: construct(oracle, square, leaf="smooth", max_bytes=max_bytes),
        "maze, cones": lambda: construct(oracle, square, leaf="cone", max_bytes=max_bytes, certified=True),
        "car, planes": lambda: construct(car, _TURNS, max_bytes=max_bytes),
        "car, continuous": lambda: construct(car, _TURNS, leaf="continuous", max_bytes=max_bytes),
        "car turned": lambda: construct(ReedsShepp((1, 0.5, 0.6), 1), _TURNS, leaf="continuous", max_bytes=max_bytes),
        "5-D, planes": lambda: construct(ball, (-np.ones(5), np.ones(5)), max_bytes=max_bytes),
        "5-D, continuous": lambda: construct(ball, (-np.ones(5), np.ones(5)), leaf="continuous", max_bytes=max_bytes),
        "UTM, planes": lambda: construct(Euclidean((5e5 + 700, 4e6 + 300)), _ZONE, max_bytes=max_bytes),
    }


def _measured(plr: PLR, folder: Path, num_points: int, num_calls: int, seed: int) -> dict[str, Any]:
    in_c, f, rng = compiled_header(plr, folder), plr.numpy(), np.random.default_rng(seed)
    center, half = (plr.domain.lo + plr.domain.hi) / 2, _WIDER / 2 * plr.domain.width
    in_c_equal, jax_equal = 0, 0
    for start in range(0, num_points, CHUNK):
        shape = (min(CHUNK, num_points - start), plr.dim)
        x = (center + half * rng.uniform(-1, 1, shape)).astype(in_c.real)
        expected = f(x).view(np.uint32)
        in_c_equal += int(np.count_nonzero(in_c(x).view(np.uint32) == expected))
        jax_equal += int(np.count_nonzero(np.asarray(plr(x)).view(np.uint32) == expected))
    inside = plr.domain.lo + plr.domain.width * rng.random((num_calls, plr.dim))
    points = list(map(tuple, inside.tolist()))
    return {
        **section_bytes(object_for_size(plr, folder)),
        "c_equal": in_c_equal / num_points,
        "jax_equal": jax_equal / num_points,
        "c_nanoseconds": in_c.nanoseconds(x),
        "numpy_microseconds": median_seconds(lambda: [f(point) for point in points]) / num_calls * 1e6,
        "numpy_batch_nanoseconds": median_seconds(lambda: f(x), 3) / len(x) * 1e9,
    }


def table(results: dict[str, Any]) -> str:
    head = ["PLR", "leaves", "file B", "code B", "data B", "C = NumPy", "plr(x) = NumPy", "C ns", "NumPy us"]
    rows = [[*head, "batch ns"]]
    for row in results["rows"]:
        numbers = [f"{row[key]:,}" for key in ("leaves", "bytes", "code", "data")]
        equal = [f"{100 * row[key]:.7g} %" for key in ("c_equal", "jax_equal")]
        speeds = [f"{row['c_nanoseconds']:.0f}", f"{row['numpy_microseconds']:.1f}"]
        rows.append([row["plr"], *numbers, *equal, *speeds, f"{row['numpy_batch_nanoseconds']:.0f}"])
    return f"{results['points']:,} points each\n" + aligned(rows, len(rows[0]) - 1)
