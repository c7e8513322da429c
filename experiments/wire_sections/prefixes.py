"""Every prefix of fifty progressive files: does it load, and do its bounds hold?

Files are of all leaf models, in one to six dimensions, among obstacles and without, with periodic axes, folded, and
far from the origin. Among obstacles coarser layers are built with their own proofs, and the truth is the exact
distance; else layers are coarsened from the file's PLR, and what they are held against is what that answers.
"""

from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import Any

import numpy as np

import plr_jax
from plr_jax import PLR, Box, VisibilityGraph, construct, scenes

STEP, LEAST = 8, 256
NUM_POINTS, SMOKE_POINTS = 1_000_000, 2_000
_AT_ONCE = 250_000
_KINDS = {"plane": 6, "continuous": 4, "smooth": 2, "cone": 5}
"""Leaf models, and up to how many dimensions they are tried in."""


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    num_points, rows = (SMOKE_POINTS if smoke else NUM_POINTS), []
    for name, plr, parts in files(num_points, seed, smoke):
        data = plr.to_bytes()
        beyond = {}
        for mark in (*plr.file_marks, len(data)):
            found = plr_jax.from_bytes(data[:mark])
            if found.to_bytes() != data[:mark]:
                raise AssertionError(f"{name}: {mark} bytes are read as others")
            if mark < len(data) or found.max_error is not None:
                beyond[mark] = sum(_count_beyond(found, x, exact) for x, exact in parts)
        rows.append({"file": name, "bytes": len(data), "beyond": beyond})
        print(_line(rows[-1]), flush=True)
    return {"points": num_points, "rows": rows}


def _count_beyond(plr: PLR, x: np.ndarray, exact: np.ndarray) -> int:
    """At how many points the truth is beyond the bounds."""
    lower, upper = (np.asarray(bound, np.float64) for bound in plr.bounds(x))
    is_beyond = (lower > np.maximum(exact, 0)) | (exact > upper)
    return int(np.count_nonzero(is_beyond & np.isfinite(exact)))


def _parts(
    truth: Callable[[np.ndarray], Any], sample: Callable[[int, int], np.ndarray], num_points: int, seed: int
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Points and the truth there, in parts."""
    sizes = np.diff([*range(0, num_points, _AT_ONCE), num_points]).tolist()
    parts = [sample(size, seed * 100 + part) for part, size in enumerate(sizes)]
    return [(x, np.asarray(truth(x), np.float64)) for x in parts]


def files(num_points: int, seed: int, smoke: bool) -> Iterator[tuple[str, PLR, list[tuple[np.ndarray, np.ndarray]]]]:
    """Names of files, their PLRs, and points with the truth there."""
    for name in ("maze",) if smoke else ("maze", "thin_maze", "floor_plan"):
        problem = getattr(scenes, name)()
        oracle = VisibilityGraph(problem.workspace, problem.goals[0])
        parts = _parts(oracle, problem.workspace.sample_free, num_points, seed)
        for leaf in _KINDS:
            for leaf_bounds in (False,) if smoke else (False, True):
                plr = plr_jax.progressive(list(_certified(oracle, leaf, leaf_bounds)))
                yield f"{name}, {leaf}{', bounds of leaves' * leaf_bounds}", plr, parts
    for name, distance, domain, leaf in _others(smoke):
        plr = construct(distance, domain, leaf=leaf, max_bytes=1_500 if smoke else 6_000)
        sizes = [size for size in (LEAST, plr.num_bytes // STEP) if LEAST <= size <= plr.num_bytes // 2]
        layers = [plr_jax.coarsen(plr, size, leaf_bounds=bool(number)) for number, size in enumerate(sizes)]
        layers = [layer for layer, after in pairwise([*layers, plr]) if _is_less(layer, after)]
        parts = _parts(plr, _of_box(Box.of(domain)), num_points, seed)
        yield f"{name}, {leaf}", plr_jax.progressive([*layers, plr]), parts


def _certified(oracle: VisibilityGraph, leaf: str, leaf_bounds: bool) -> Iterator[PLR]:
    domain = oracle.workspace.bounds
    for max_bytes in (LEAST, LEAST * STEP, LEAST * STEP**2):
        yield construct(oracle, domain, leaf=leaf, max_bytes=max_bytes, certified=True, leaf_bounds=leaf_bounds)


def _others(smoke: bool) -> Iterator[tuple[str, Any, Any, str]]:
    for leaf, most in _KINDS.items():
        for dim in (3,) if smoke and most > 2 else range(1, 1 if smoke else most + 1):
            yield f"{dim}-D", _bent, ([0.0] * dim, [1.0] * dim), leaf
    if smoke:
        return
    ring = Box((0, 0), (2 * np.pi, 1), periodic=(True, False))
    window = Box((-3, -3, -np.pi), (3, 3, np.pi), periodic=(False, False, True))
    for leaf in ("plane", "continuous"):
        yield "Reeds-Shepp, folded", plr_jax.ReedsShepp(goal=(0, 0, 0), radius=1), window, leaf
        yield "Dubins", plr_jax.Dubins(goal=(0, 0, 0), radius=1), window, leaf
        yield "a ring", lambda x: np.abs(np.sin(x[:, 0] / 2)) + x[:, 1], ring, leaf
    for leaf in _KINDS:
        corner = np.array([5e5, 4e6])
        yield "UTM", lambda x: np.linalg.norm(x - [5e5 + 300, 4e6 + 900], axis=1), (corner, corner + 2000), leaf


def _bent(x: np.ndarray) -> np.ndarray:
    return np.linalg.norm(x - 0.3, axis=1) + np.sin(5 * x[:, 0]) / 4


def _is_less(layer: PLR, after: PLR) -> bool:
    return len(layer.container.last.body) < len(after.container.last.body)


def _of_box(box: Box) -> Callable[[int, int], np.ndarray]:
    return lambda n, seed: box.lo + box.width * np.random.default_rng(seed).random((n, box.dim))


def table(results: dict[str, Any]) -> str:
    rows = results["rows"]
    counts = [count for row in rows for count in row["beyond"].values()]
    last = (
        f"{len(rows)} files, {len(counts)} prefixes; beyond bounds {sum(counts)} of {results['points']:,} points each"
    )
    return "".join(_line(row) + "\n" for row in rows) + last + "\n"


def _line(row: dict[str, Any]) -> str:
    prefixes = "  ".join(f"{int(mark):,} B: {count}" for mark, count in row["beyond"].items())
    return f"{row['file']:40}{row['bytes']:>7,} B   beyond bounds  {prefixes}"
