"""Files on their way: prefixes that are PLRs with bounds, what that costs in bytes, and what of a file is fetched.

Every section is written as soon as it is measured; ``--only SECTION`` measures sections again and keeps the others.
"""

import re
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import shapely

import plr_jax
from experiments._runner import Section, run
from experiments.benchmarks._maps import load_map
from experiments.benchmarks._oracle import polygon_field
from experiments.summaries._given import Pairs, draw_pairs
from plr_jax import PLR, Box, PairPLR, VisibilityGraph, Workspace, construct, scenes
from plr_jax.plr.file.container import frame_size

# Every prefix of fifty progressive files: does it load, and do its bounds hold?
#
# Files are of all leaf models, in one to six dimensions, among obstacles and without, with periodic axes, folded, and
# far from the origin. Among obstacles coarser layers are built with their own proofs, and the truth is the exact
# distance; else layers are coarsened from the file's PLR, and what they are held against is what that answers.

STEP, LEAST = 8, 256
NUM_POINTS, SMOKE_POINTS = 1_000_000, 2_000
_AT_ONCE = 250_000
_KINDS = {"plane": 6, "continuous": 4, "smooth": 2, "cone": 5}
"""Leaf models, and up to how many dimensions they are tried in."""


def prefixes(seed: int, smoke: bool) -> dict[str, Any]:
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


# Every prefix of files of pairs: does it load, is it exact, and do its bounds hold?
#
# Behind the outline alone the joined corners are found out by the reader, from corners that a lattice has rounded; of
# one map the lattice hides a detail. Goals have 1,000 points each. Beyond bounds is a distance that is so by more
# than what the exact oracle rounds.

PAIR_BYTES = 16_384
NUM_GOALS, SMOKE_GOALS, POINTS = 100, 2, 1_000
_CORNERS = 400
_ORACLE = 1e-12  # of the domain's width: what the oracle rounds


def pair_prefixes(seed: int, smoke: bool) -> dict[str, Any]:
    rows = []
    for name, workspace in _pair_maps(seed, smoke):
        pairs = plr_jax.construct_pairs(workspace, max_bytes=PAIR_BYTES)
        exact = VisibilityGraph(workspace, workspace.sample_free(1, seed)[0])
        some = draw_pairs(exact, SMOKE_GOALS if smoke else NUM_GOALS, POINTS, seed)
        data = pairs.to_bytes()
        prefixes = [_judged(_read(data[:mark]), some) for mark in (*pairs.file_marks, len(data))]
        rows.append({"file": name, "corners": pairs.num_corners, "pairs": len(some.distance), "prefixes": prefixes})
    return {"rows": rows}


def _pair_maps(seed: int, smoke: bool) -> Iterator[tuple[str, Workspace]]:
    yield "maze", scenes.maze().workspace
    arc = np.linspace(0, np.pi, 9)
    top = np.stack([3 + 4 * arc / np.pi, 5 + 1e-7 * np.sin(arc)], axis=1)
    yield "arc of 1e-8 widths", Workspace(((0, 0), (10, 10)), [[*top.tolist(), (7, 2), (3, 2)]])
    if not smoke:
        floor, far = scenes.floor_plan().workspace, np.array([5e5, 4e6])
        yield "floor_plan", floor
        rings = [far + shapely.get_coordinates(obstacle) for obstacle in floor.obstacles]
        yield "floor_plan, UTM", Workspace((far + floor.bounds.lo, far + floor.bounds.hi), rings)
        yield f"{_CORNERS} corners", polygon_field(_CORNERS, seed)[0]


def _read(data: bytes) -> PairPLR:
    with TemporaryDirectory() as folder:
        path = Path(folder, "prefix")
        path.write_bytes(data)
        return plr_jax.load(path)


def _judged(pairs: PairPLR, some: Pairs) -> dict[str, Any]:
    lower, upper = (np.asarray(bound, np.float64) for bound in pairs.bounds(some.x, some.y))
    slack = _ORACLE * float(pairs.domain.width.max())
    is_told = np.isfinite(upper)
    return {
        "bytes": pairs.num_bytes,
        "beyond": int((lower > some.distance + slack).sum() + (upper < some.distance - slack).sum()),
        "largest_error": float(np.abs(np.asarray(pairs(some.x, some.y), np.float64) - some.distance).max()),
        "mean_distance": float(some.distance.mean()),
        "told": float(is_told.mean()),
        "gap": float((upper - lower)[is_told].mean()),
    }


# Bytes of a progressive file over those of a file of its last PLR alone, which errs alike; and bytes of headers.
#
# All have proofs. Layers are smaller than the file by a factor to some power, down to 256 bytes: 8, with which a file
# has a coarser PLR at every eighth of what was fetched; or 36, with which there is one coarser PLR or two.

BYTES, SMOKE_BYTES, LEAST_LAYER, FACTORS = 65_536, 4_096, 256, (8, 36)
NUM_BOXES = 20_000


def sizes(seed: int, smoke: bool) -> dict[str, Any]:
    problem = scenes.maze()
    oracle, rows = VisibilityGraph(problem.workspace, problem.goals[0]), []
    bounds, factors = problem.workspace.bounds, FACTORS[: 1 if smoke else None]
    for leaf in ("plane",) if smoke else ("plane", "continuous", "smooth", "cone"):
        build = cache(partial(construct, oracle, bounds, leaf=leaf, certified=True))
        alone = build(max_bytes=SMOKE_BYTES if smoke else BYTES)
        for factor in factors:
            sizes = [alone.num_bytes // factor]
            while sizes[0] // factor >= LEAST_LAYER:
                sizes.insert(0, sizes[0] // factor)
            whole = plr_jax.progressive([*(build(max_bytes=size) for size in sizes), alone])
            marks = [*whole.file_marks, whole.num_bytes]
            rows.append({"leaf": leaf, "factor": factor, "marks": marks, "ratio": whole.num_bytes / alone.num_bytes})
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


# What of a file is fetched from a static server: requests, and bytes.
#
# One is the first kilobyte of a progressive file of 64 KB; the others what one goal needs of a PairPLR.

PREFIX, FILE, PAIRS, CORNERS = 1_024, 65_536, 2**20, 4_000
RANGE_POINTS = 20_000


def ranges(seed: int, smoke: bool) -> dict[str, Any]:
    problem = scenes.maze()
    oracle, domain = VisibilityGraph(problem.workspace, problem.goals[0]), problem.workspace.bounds
    sizes = (PREFIX - 40, FILE // (16 if smoke else 1))
    plrs = [construct(oracle, domain, leaf="plane", max_bytes=size, certified=True) for size in sizes]
    with _serving(plr_jax.progressive(plrs).to_bytes()) as (url, sent):
        rows = [_row("first 1 KB of 64 KB", sent, plr_jax.open_url(url, max_bytes=PREFIX), oracle, seed)]
    for name, workspace in _range_maps(seed, smoke):
        pairs = plr_jax.construct_pairs(workspace, max_bytes=4_000 if smoke else PAIRS)
        exact = VisibilityGraph(workspace, workspace.sample_free(1, seed)[0])
        with _serving(pairs.to_bytes()) as (url, sent):
            rows.append(_row(name, sent, plr_jax.open_url(url, goal=exact.goal, timeout=60.0), exact, seed))
    return {"rows": rows}


def _range_maps(seed: int, smoke: bool) -> Iterator[tuple[str, Workspace]]:
    yield f"one goal, {CORNERS:,} corners", polygon_field(80 if smoke else CORNERS, seed)[0]
    if not smoke and (published := load_map("den520d")) is not None:
        yield "one goal, den520d", published[0]


def _row(
    part: str, sent: dict[str, int], plr: plr_jax.PLR | plr_jax.PairPLR, oracle: VisibilityGraph, seed: int
) -> dict[str, Any]:
    assert isinstance(plr, plr_jax.PLR)
    report = plr_jax.metrics.error_map(plr, oracle, oracle.workspace.sample_free(RANGE_POINTS, seed + 1))
    errors = {"mean_error": report.mean, "largest_distance": report.max_distance}
    return {"part": part, **sent, "share": sent["sent"] / sent["size"], **errors}


@contextmanager
def _serving(data: bytes) -> Iterator[tuple[str, dict[str, int]]]:
    """A server of one file that knows ranges, as any static server does; its address, and what it counts."""
    counts = {"requests": 0, "sent": 0, "size": len(data)}

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            match = re.fullmatch(r"bytes=(\d+)-(\d+)", self.headers.get("Range", ""))
            assert match is not None
            start, end = int(match[1]), min(int(match[2]) + 1, len(data))
            counts["requests"] += 1
            counts["sent"] += end - start
            self.send_response(206)
            self.send_header("Content-Range", f"bytes {start}-{end - 1}/{len(data)}")
            self.send_header("Content-Length", str(end - start))
            self.end_headers()
            self.wfile.write(data[start:end])

        def log_message(self, format: str, *args: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}/file", counts
    finally:
        server.shutdown()
        server.server_close()


SECTIONS = {
    "prefixes": Section(prefixes),
    "pair_prefixes": Section(pair_prefixes),
    "sizes": Section(sizes),
    "ranges": Section(ranges),
}

if __name__ == "__main__":
    run("wire", __doc__, SECTIONS)
