"""Exact distances on big maps: seconds to prepare an oracle, and microseconds a point of a batch.

Fields of small obstacles (octagons, one a cell) and voids (few, star-shaped, of many walls) are synthetic; den520d is
a published map, measured as it is and after its obstacles are grown by 0.4. Preparing begins with the workspace, so
triangles, visibility polygons, the graph and the distances of its vertices are in it; the first query adds what is
found once for a goal. Bytes are those of the oracle's pickle, with its workspace. Seconds are those of the processor,
medians of several runs, each on a workspace of its own.
"""

import pickle
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from experiments._measures import timed
from experiments._runner import run
from experiments.benchmarks._maps import load_map
from experiments.benchmarks._oracle import polygon_field
from plr_jax import VisibilityGraph, Workspace

FIELDS, VOIDS, NUM_VOIDS, INFLATION = (4_000, 17_000, 44_000), 4_100, 4, 0.4
NUM_RUNS, NUM_POINTS = 3, 100_000


def compute(seed: int, smoke: bool) -> dict[str, Any]:
    num_runs, num_points = (1, 100) if smoke else (NUM_RUNS, NUM_POINTS)
    rows = []
    for name, make in maps(seed, smoke):
        rows.append({"map": name, **measure(make, num_runs, num_points, seed)})
    return {"runs": num_runs, "points": num_points, "rows": rows}


def maps(seed: int, smoke: bool) -> Iterator[tuple[str, Callable[[], Workspace]]]:
    """Names of maps, and what makes each anew."""
    for num_vertices in (80,) if smoke else FIELDS:
        yield f"field {num_vertices:,}", lambda num_vertices=num_vertices: polygon_field(num_vertices, seed)[0]
    num_vertices = 80 if smoke else VOIDS
    yield f"voids {num_vertices:,}", lambda: voids(num_vertices, seed)
    published = None if smoke else load_map("den520d")
    if published is not None:
        workspace = published[0]
        yield "den520d", lambda: Workspace((workspace.bounds.lo, workspace.bounds.hi), workspace.obstacles)
        yield f"den520d + {INFLATION}", lambda: workspace.inflate(INFLATION)


def voids(num_vertices: int, seed: int) -> Workspace:
    """Disjoint star-shaped rooms with jagged walls, in which a corner sees many others.

    Args:
        num_vertices: Vertices of the rooms together, rounded down to a multiple of their number.
        seed: Of the random numbers.
    """
    rng = np.random.default_rng(seed)
    count = num_vertices // NUM_VOIDS
    angle = 2 * np.pi / count * (np.arange(count) + rng.uniform(-0.3, 0.3, (NUM_VOIDS, count)))
    radius = rng.uniform(0.44, 0.46, (NUM_VOIDS, count))
    rings = radius[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    rings[..., 0] += np.arange(NUM_VOIDS)[:, None]
    return Workspace.from_polygons([{"outer": ring} for ring in rings])


def measure(make: Callable[[], Workspace], num_runs: int, num_points: int, seed: int) -> dict[str, Any]:
    seconds = []
    for _ in range(num_runs):
        to_workspace, workspace = timed(make)
        x = workspace.sample_free(num_points + 1, seed)
        workspace.is_free(x[:1])
        to_oracle, oracle = timed(lambda workspace=workspace, x=x: VisibilityGraph(workspace, x[0]))
        to_first, _ = timed(lambda oracle=oracle, x=x: oracle(x[:1]))
        to_batch, _ = timed(lambda oracle=oracle, x=x: oracle(x[1:]))
        seconds.append((to_workspace, to_oracle, to_first, to_batch / num_points * 1e6))
    names = "seconds_workspace", "seconds_prepare", "seconds_first", "microseconds_a_point"
    graph = oracle.graph
    sizes = {"corners": len(graph.vertices) - 1, "edges": len(graph.edges), "bytes": len(pickle.dumps(oracle))}
    medians = dict(zip(names, np.median(seconds, axis=0).tolist(), strict=True))
    return {"vertices": len(workspace.boundary.vertices), **sizes, **medians}


if __name__ == "__main__":
    run("big_maps", "Seconds to prepare an exact oracle on big maps, and what a query costs.", compute)
