"""From nothing to an answer: imports, a first query, a first plan, each in a process of its own.

Seconds are counted within the process, from the first statement on, and are medians; the processes take turns. What
a program pays beyond JAX is the difference to ``import jax``. With JAX's persistent compilation cache, a process
before those that are timed has filled the folder. The cache is asked to keep all that is compiled: by default it
keeps nothing that compiles in less than a second, which is everything here.
"""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from experiments._tables import aligned
from plr_jax import construct, save

NUM_RUNS = 5
IMPORT, CACHED = "import jax", ", cached"
SCENE = "single door"
_ROOT = Path(__file__).parents[2]

# A process prints the seconds of its statements.
_TIMED = """
import time
begin = time.perf_counter()
{statements}
print(time.perf_counter() - begin)
"""
_STATEMENTS = {
    IMPORT: "import jax",
    "import plr_jax": "import plr_jax",
    "to load and query": "from plr_jax import PLR, evaluate, load",
    "to construct": "from plr_jax import VisibilityGraph, Workspace, construct",
    "to plan": "from plr_jax import bl_plan, robot_distance_fns, scenes, sum_of_distances",
    "first query": "from plr_jax import load\nload({plr!r})([0.5, 0.5]).block_until_ready()",
    "second query": "from plr_jax import load\nplr = load({plr!r})\nplr([0.5, 0.5]).block_until_ready()\n"
    "begin = time.perf_counter()\nplr([0.25, 0.5]).block_until_ready()",
}
_IMPORTS = ("import plr_jax", "to load and query", "to construct", "to plan")
_CACHED_STATEMENTS = ("first query",)
PLAN = "first plan"
_PLAN = f"from experiments import _cold\n_cold.main({SCENE!r}, 'PLR')"


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as folder:
        plr = Path(folder) / "cone.plr"
        save(construct(lambda x: np.hypot(*x.T), ((0.0, 0.0), (1.0, 1.0)), max_leaves=512, seed=seed), plr)
        commands = {
            name: _TIMED.format(statements=code.format(plr=str(plr)))
            for name, code in _STATEMENTS.items()
            if not smoke or name in (IMPORT, _IMPORTS[0], *_CACHED_STATEMENTS)
        }
        commands |= {name + CACHED: commands[name] for name in _CACHED_STATEMENTS}
        if not smoke:
            commands |= {PLAN: _PLAN, PLAN + CACHED: _PLAN}
        runs = _take_turns(commands, Path(folder) / "cache", 1 if smoke else NUM_RUNS)
    rows = {name: _summary(times) for name, times in runs.items()}
    return {"runs": 1 if smoke else NUM_RUNS, "scene": SCENE, "leaves": 512, "rows": rows}


def _take_turns(commands: dict[str, str], cache: Path, num_runs: int) -> dict[str, list[dict[str, float]]]:
    """Seconds of each run of each command, by phase."""
    environments = {name: _environment(cache if name.endswith(CACHED) else None) for name in commands}
    for name in commands:
        if name.endswith(CACHED):
            _run(commands[name], environments[name])
    turns = [name for _ in range(num_runs) for name in commands]
    runs: dict[str, list[dict[str, float]]] = {name: [] for name in commands}
    for name in tqdm(turns, desc="processes", disable=None):
        runs[name].append(_run(commands[name], environments[name]))
    return runs


def _environment(cache: Path | None) -> dict[str, str]:
    """This process's environment, with JAX's persistent cache in a folder, or without one."""
    kept = {name: value for name, value in os.environ.items() if "COMPILATION_CACHE" not in name}
    if cache is None:
        return kept
    return kept | {
        "JAX_COMPILATION_CACHE_DIR": str(cache),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
    }


def _run(command: str, environment: dict[str, str]) -> dict[str, float]:
    """What a new process prints: seconds in all, or those of each phase."""
    ran = subprocess.run(
        [sys.executable, "-c", command], cwd=_ROOT, env=environment, capture_output=True, text=True, check=True
    )
    printed = json.loads(ran.stdout)
    if not isinstance(printed, dict):
        return {"total": printed}
    if not printed.pop("valid"):
        raise RuntimeError("The first plan is not valid.")
    return {"total": sum(printed.values()), **printed}


def _summary(times: list[dict[str, float]]) -> dict[str, Any]:
    """Medians by phase, and the least and most in all."""
    total = [each["total"] for each in times]
    medians = {phase: float(np.median([each[phase] for each in times])) for phase in times[0]}
    return {**medians, "least": min(total), "most": max(total)}


def table(results: dict[str, Any]) -> str:
    rows = [["in a new process", "seconds", "least", "most", f"beyond {IMPORT}"]]
    alone = results["rows"][IMPORT]["total"]
    notes = []
    for name, row in results["rows"].items():
        times = [f"{row[key]:.4f}" for key in ("total", "least", "most")]
        beyond = "" if name in (IMPORT, "second query") else f"{row['total'] - alone:+.3f}"
        rows.append([name, *times, beyond])
        if "plan" in row:
            phases = ", ".join(f"{phase} {row[phase]:.2f}" for phase in ("import", "oracle", "plr", "plan"))
            notes.append(f"{name} ({results['scene']}): {phases} s")
    for name in _IMPORTS:
        if name in results["rows"]:
            beyond = results["rows"][name]["total"] - alone
            notes.append(f"{name}: {beyond:+.2f} s beyond {IMPORT} (at most +0.8)")
    return "\n".join([aligned(rows, numbers=4), *notes]) + "\n"
