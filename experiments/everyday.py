"""What everyday tasks take: pairs in an environment and on large maps, a scan, depots, and the README's own code.

- ``steps``: environments in ``floor_plan`` that are stepped inside ``jit``, each towards a goal of its own, and ask
  for the distance before and after each step; of pairs, of goals that are prepared once, and of straight lines.
- ``maps``: the same queries on maps of many corners, and what the tables of pairs hold of memory.
- ``scan``: a scan of 800 x 600 cells of 5 cm with specks, for a robot of 0.3 m: ``leaf="best"`` of 4 KB, seconds from
  the workspace to the PLR, and the largest memory of a process that draws the scan and does that.
- ``depots``: 200 of them for 1,000 points, and the first PLR of one goal of pairs.
- ``snippets``: each block of Python in the README, in a process of its own, from its start to its end.
"""

import json
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from experiments._measures import peak_megabytes
from experiments._runner import Section, run
from experiments.benchmarks._maps import load_map
from experiments.benchmarks._timing import interleaved
from experiments.maps import drawn, salted
from plr_jax import PairPLR, VisibilityGraph, Workspace, construct, construct_pairs, place, scenes

README = Path(__file__).parent.parent / "README.md"
ENVIRONMENTS, STEPS, STRIDE = 4_096, 200, 0.02
PAIRS = 2**16
CELLS, SHARE_BLOCKED = 84, 0.25
SCAN, SCAN_ROOMS, CELL, SPECKS, RADIUS = (800, 600), (8, 6), 0.05, 0.0045, 0.3
DEPOTS, POINTS = 200, 1_000
WAYS = ("pairs", "prepared", "straight")


def steps(seed: int, smoke: bool) -> dict[str, Any]:
    workspace = scenes.floor_plan().workspace
    pairs = construct_pairs(workspace, max_bytes=4_096 if smoke else None)
    environments, num_steps = (16, 4) if smoke else (ENVIRONMENTS, STEPS)
    x, goals = (jnp.asarray(workspace.sample_free(environments, seed + i), jnp.float32) for i in range(2))
    prepared = jax.jit(lambda pairs, goals: pairs.prepared(goals))

    def way(name: str, pairs: PairPLR, goals: jax.Array) -> Callable[[jax.Array], jax.Array]:
        if name == "straight":
            return lambda x: jnp.linalg.norm(x - goals, axis=1)
        ends = pairs.prepared(goals) if name == "prepared" else goals
        return lambda x: pairs(x, ends)

    def rollout(name: str) -> Callable[[], jax.Array]:
        @jax.jit
        def episode(pairs: PairPLR, x: jax.Array, goals: jax.Array, key: jax.Array) -> jax.Array:
            distance = way(name, pairs, goals)

            def step(x: jax.Array, key: jax.Array) -> tuple[jax.Array, jax.Array]:
                after = jnp.clip(x + STRIDE * jax.random.normal(key, x.shape), *map(jnp.asarray, bounds))
                gain = distance(x) - distance(after)
                return after, jnp.where(jnp.isfinite(gain), gain, 0).mean()

            return jax.lax.scan(step, x, jax.random.split(key, num_steps))[1]

        return partial(episode, pairs, x, goals, jax.random.key(seed))

    bounds = (workspace.bounds.lo.astype(np.float32), workspace.bounds.hi.astype(np.float32))
    seconds = interleaved(
        {**{name: rollout(name) for name in WAYS}, "prepare": lambda: prepared(pairs, goals)},
        3 if smoke else 5,
    )
    done = environments * num_steps
    rows = [{"distance": name, "million steps a second": done / seconds[name].median / 1e6} for name in WAYS]
    return {
        "rows": rows,
        "microseconds to prepare a goal": seconds["prepare"].median / environments * 1e6,
        "bytes": pairs.num_bytes,
    }


def maps(seed: int, smoke: bool) -> dict[str, Any]:
    free = np.random.default_rng(seed).random((CELLS, CELLS)) >= SHARE_BLOCKED
    workspaces = {"floor_plan": scenes.floor_plan().workspace}
    if not smoke:
        workspaces["random cells"] = Workspace.from_mask(free)
        for name in ("den520d", "Berlin"):
            if (found := load_map(name)) is not None:
                workspaces[name] = found[0]
    return {"rows": [_asked(name, workspace, seed, smoke) for name, workspace in workspaces.items()]}


def _asked(name: str, workspace: Workspace, seed: int, smoke: bool) -> dict[str, Any]:
    pairs = construct_pairs(workspace, max_bytes=4_096 if smoke else None)
    began = time.perf_counter()
    memory = pairs.resident_bytes  # which makes the tables
    made = time.perf_counter() - began
    count = 64 if smoke else PAIRS
    x, y = (jnp.asarray(workspace.sample_free(count, seed + i), jnp.float32) for i in range(2))
    ask = jax.jit(lambda pairs, x, y: pairs(x, y))
    goal = pairs.prepared(y[0])
    seconds = interleaved({"pairs": partial(ask, pairs, x, y), "prepared": partial(ask, pairs, x, goal)}, 5)
    exact = VisibilityGraph(workspace, y[0]).between(np.asarray(x[:2_000]), np.asarray(y[:2_000]))
    error = np.abs(np.asarray(ask(pairs, x, y))[:2_000] - exact)[np.isfinite(exact)]
    return {
        "map": name,
        "vertices": len(workspace.boundary.vertices),
        "corners": pairs.num_corners,
        "bytes": pairs.num_bytes,
        "MB of tables": memory / 1e6,
        "seconds to make them": made,
        "microseconds a pair": seconds["pairs"].median / count * 1e6,
        "of a prepared goal": seconds["prepared"].median / count * 1e6,
        "largest error": float(error.max()),
    }


def scan(seed: int, smoke: bool) -> dict[str, Any]:
    """In a process of its own, whose memory is told at its largest."""
    code = f"from experiments.everyday import scanned; import json; print(json.dumps(scanned({seed}, {smoke})))"
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    return {"rows": [json.loads(done.stdout.splitlines()[-1])]}


def scanned(seed: int, smoke: bool) -> dict[str, float]:
    size, rooms = ((80, 60), (2, 1)) if smoke else (SCAN, SCAN_ROOMS)
    free = salted(drawn(size, rooms, seed), SPECKS, seed) > 127
    workspace = Workspace.from_mask(free, CELL).inflate(RADIUS)
    goal = workspace.sample_free(1, seed)[0]
    began = time.perf_counter()
    oracle = VisibilityGraph(workspace, goal)
    plr = construct(oracle, workspace.bounds, leaf="best", max_bytes=4_096)
    seconds, memory = time.perf_counter() - began, peak_megabytes()
    x = workspace.sample_free(20_000, seed + 1)
    distance = oracle(x)
    error = np.abs(np.asarray(plr(x)) - distance)[np.isfinite(distance)]
    return {
        "vertices": len(workspace.boundary.vertices),
        "seconds": seconds,
        "GB at most": memory / 1e3,
        "bytes": plr.num_bytes,
        "mean error": float(error.mean()),
        "mean distance": float(distance[np.isfinite(distance)].mean()),
    }


def depots(seed: int, smoke: bool) -> dict[str, Any]:
    workspace = scenes.maze().workspace
    pairs = construct_pairs(workspace, max_bytes=1_024)
    count, points = (3, 20) if smoke else (DEPOTS, POINTS)
    demand = workspace.sample_free(points, seed)
    pairs(demand[:1], demand)
    seconds = {}
    for name, call in {
        "place": lambda: place(pairs, workspace, demand, k=count),
        "to": lambda: pairs.to(demand[0]),
    }.items():
        began = time.perf_counter()
        call()
        seconds[name] = time.perf_counter() - began
    return {
        "rows": [
            {"depots": count, "points": points, "seconds": seconds["place"], "seconds of pairs.to": seconds["to"]}
        ]
    }


def snippets(seed: int, smoke: bool) -> dict[str, Any]:
    blocks = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)
    rows = []
    for number, block in enumerate(blocks[:1] if smoke else blocks):
        began = time.perf_counter()
        with tempfile.TemporaryDirectory() as folder:
            subprocess.run([sys.executable, "-c", block], check=True, capture_output=True, cwd=folder)
        rows.append({"block": number, "seconds": time.perf_counter() - began})
    return {"rows": rows}


SECTIONS = {each.__name__: Section(each) for each in (steps, maps, scan, depots, snippets)}

if __name__ == "__main__":
    run("everyday", __doc__, SECTIONS)
