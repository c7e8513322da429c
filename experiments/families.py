"""A thousand goals and more at once: seconds from oracles to PLRs, errors beside those built alone, stacks of PLRs.

On each map: goals drawn from free space, oracles of one workspace, all PLRs by ``construct_many`` in processes, one a
core, whose start counts; some goals again by ``construct``, for its time and errors. And pairs of an index and a
point of a stack, beside points of one PLR. CPU seconds of ``construct_many`` in this process are measured on a random
maze and on a field of thousands of vertices, oracles included.
"""

import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any

import jax.numpy as jnp
import numpy as np
import shapely

from experiments._runner import run
from experiments.benchmarks._oracle import polygon_field
from experiments.benchmarks._timing import interleaved
from plr_jax import PLR, BuildOptions, VisibilityGraph, Workspace, construct, construct_many, scenes, stack
from plr_jax._compiled import num_cores

GOAL_SEED, POINT_SEED = 11, 12
MAPS = {"maze": (1_000, 1_024), "floor_plan": (2_000, 2_048)}
"""Goals and bytes of each PLR."""
NUM_ALONE, NUM_POINTS, RUNS = 20, 1_000_000, 15
CPU_GOALS, ROOMS, FIELD_VERTICES = 200, 15, 4_832
WALL = 0.15
"""Half the thickness of a random maze's walls; a room is 1 wide."""


def compute(seed: int, smoke: bool) -> dict[str, Any]:
    maps = {"maze": (6, 300)} if smoke else MAPS
    num_alone, num_points = (2, 2_000) if smoke else (NUM_ALONE, NUM_POINTS)
    rows, plrs = [], []
    for name, (num_goals, max_bytes) in maps.items():
        row, built = _measure(name, num_goals, max_bytes, num_alone, seed)
        rows.append(row)
        plrs = plrs or built
    rng, domain = np.random.default_rng(POINT_SEED + seed), plrs[0].domain
    x = jnp.asarray(rng.uniform(domain.lo, domain.hi, (num_points, 2)).astype(np.float32))
    index = jnp.asarray(rng.integers(0, len(plrs), num_points).astype(np.int32))
    one, f = plrs[0], stack(plrs)
    seconds = interleaved({"one": lambda: one(x), "stack": lambda: f(index, x)}, RUNS)
    medians = {kind: each.median for kind, each in seconds.items()}
    ratio = medians["stack"] / medians["one"]
    rooms, vertices, goals = (3, 80, 2) if smoke else (ROOMS, FIELD_VERTICES, CPU_GOALS)
    maps = ("random maze", random_maze(rooms, seed), 1_024), ("field", polygon_field(vertices, seed)[0], 4_096)
    cpu = [_cpu(*each, goals, seed) for each in maps]
    return {"rows": rows, "cpu": cpu, "stack": {"plrs": len(plrs), "points": num_points, **medians, "ratio": ratio}}


def random_maze(rooms: int, seed: int) -> Workspace:
    """A maze of square rooms with thick walls: a random spanning tree says which neighbors are joined."""
    rng = np.random.default_rng(seed)
    order = [np.zeros(2, int)]
    seen, free = {(0, 0)}, [shapely.box(WALL, WALL, 1 - WALL, 1 - WALL)]
    while order:
        steps = rng.permutation([(1, 0), (-1, 0), (0, 1), (0, -1)])
        onward = [n for n in order[-1] + steps if n.min() >= 0 and n.max() < rooms and tuple(n) not in seen]
        if not onward:
            order.pop()
            continue
        lo, hi = np.minimum(order[-1], onward[0]) + WALL, np.maximum(order[-1], onward[0]) + 1 - WALL
        free.append(shapely.box(*lo, *hi))
        seen.add(tuple(onward[0]))
        order.append(onward[0])
    rings = [ring.coords[:-1] for ring in shapely.get_rings(shapely.union_all(free)).tolist()]
    return Workspace.from_polygons([{"outer": list(rings[0]), "holes": [list(ring) for ring in rings[1:]]}])


def _cpu(name: str, workspace: Workspace, max_bytes: int, num_goals: int, seed: int) -> dict[str, Any]:
    goals = workspace.sample_free(num_goals, GOAL_SEED + seed)
    first = VisibilityGraph(workspace, goals[0])
    seconds = time.process_time()
    oracles = [first, *(first.with_goal(goal) for goal in goals[1:])]
    plrs = construct_many(oracles, workspace.bounds, leaf="cone", max_bytes=max_bytes)
    seconds = time.process_time() - seconds
    x = workspace.sample_free(5_000, POINT_SEED + seed)
    return {
        "map": name,
        "corners": len(first.sources.points) - 1,
        "goals": num_goals,
        "bytes": max_bytes,
        "cpu_a_goal": seconds / num_goals,
        **_errors(plrs[:NUM_ALONE], oracles, x),
    }


def _measure(
    name: str, num_goals: int, max_bytes: int, num_alone: int, seed: int
) -> tuple[dict[str, Any], list[PLR]]:
    workspace = getattr(scenes, name)().workspace
    goals = workspace.sample_free(num_goals, GOAL_SEED + seed)
    first = VisibilityGraph(workspace, goals[0])
    begin = time.perf_counter()
    oracles = [first, *(first.with_goal(goal) for goal in goals[1:])]
    with ProcessPoolExecutor(num_cores(), get_context("spawn")) as processes:
        plrs = construct_many(
            oracles, workspace.bounds, leaf="cone", max_bytes=max_bytes, options=BuildOptions(executor=processes)
        )
    seconds = time.perf_counter() - begin
    alone_cpu = time.process_time()
    alone = [construct(oracle, workspace.bounds, leaf="cone", max_bytes=max_bytes) for oracle in oracles[:num_alone]]
    alone_cpu = time.process_time() - alone_cpu
    x = workspace.sample_free(5_000, POINT_SEED + seed)
    errors = {kind: _errors(some, oracles, x) for kind, some in (("family", plrs[:num_alone]), ("alone", alone))}
    row = {
        "map": name,
        "goals": num_goals,
        "bytes": max_bytes,
        "seconds": seconds,
        "cpu_alone": alone_cpu / num_alone,
        **errors,
    }
    return row, plrs


def _errors(plrs: list[PLR], oracles: list[VisibilityGraph], x: np.ndarray) -> dict[str, float]:
    errors = [np.abs(np.asarray(plr(x)) - oracle(x)) for plr, oracle in zip(plrs, oracles, strict=False)]
    return {"mean": float(np.mean(errors)), "max": float(np.max(errors))}


if __name__ == "__main__":
    run("families", "A thousand goals at once: seconds, errors, stacks.", compute)
