"""What of a file is fetched from a static server: requests, and bytes.

One is the first kilobyte of a progressive file of 64 KB; the others what one goal needs of a PairPLR.
"""

import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import plr_jax
from experiments.benchmarks._maps import load_map
from experiments.benchmarks._oracle import polygon_field
from plr_jax import VisibilityGraph, Workspace, construct, scenes

PREFIX, FILE, PAIRS, CORNERS = 1_024, 65_536, 2**20, 4_000
NUM_POINTS = 20_000


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    problem = scenes.maze()
    oracle, domain = VisibilityGraph(problem.workspace, problem.goals[0]), problem.workspace.bounds
    sizes = (PREFIX - 40, FILE // (16 if smoke else 1))
    plrs = [construct(oracle, domain, leaf="plane", max_bytes=size, certified=True) for size in sizes]
    with _serving(plr_jax.progressive(plrs).to_bytes()) as (url, sent):
        rows = [_row("first 1 KB of 64 KB", sent, plr_jax.open_url(url, max_bytes=PREFIX), oracle, seed)]
    for name, workspace in _maps(seed, smoke):
        pairs = plr_jax.construct_pairs(workspace, max_bytes=4_000 if smoke else PAIRS)
        exact = VisibilityGraph(workspace, workspace.sample_free(1, seed)[0])
        with _serving(pairs.to_bytes()) as (url, sent):
            rows.append(_row(name, sent, plr_jax.open_url(url, goal=exact.goal, timeout=60.0), exact, seed))
    return {"rows": rows}


def _maps(seed: int, smoke: bool) -> Iterator[tuple[str, Workspace]]:
    yield f"one goal, {CORNERS:,} corners", polygon_field(80 if smoke else CORNERS, seed)[0]
    if not smoke and (published := load_map("den520d")) is not None:
        yield "one goal, den520d", published[0]


def _row(
    part: str, sent: dict[str, int], plr: plr_jax.PLR | plr_jax.PairPLR, oracle: VisibilityGraph, seed: int
) -> dict[str, Any]:
    assert isinstance(plr, plr_jax.PLR)
    report = plr_jax.metrics.error_map(plr, oracle, oracle.workspace.sample_free(NUM_POINTS, seed + 1))
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


def table(results: dict[str, Any]) -> str:
    return "".join(
        f"{row['part']:26}{row['requests']} requests, {row['sent']:,} of {row['size']:,} bytes ({row['share']:.4f}); "
        f"mean error {row['mean_error']:.3g}, largest distance {row['largest_distance']:.4g}\n"
        for row in results["rows"]
    )
