"""``plr-jax query``: seconds and memory of tables of ten times as many rows, each of two numbers of six decimals."""

import re
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from experiments._tables import aligned
from plr_jax import VisibilityGraph, construct, save, scenes

ROWS, MOST_AT_ONCE = (100_000, 1_000_000, 10_000_000), 100_000
_CODE = r"""
import pathlib, re, sys
from plr_jax.cli import load_app
try: load_app()(["query", *sys.argv[1:]])
except SystemExit: pass
kilobytes = re.findall(r"VmHWM:\s+(\d+)", pathlib.Path("/proc/self/status").read_text())
print(*kilobytes, "jax" in sys.modules, file=sys.stderr)
"""


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    problem = scenes.maze()
    oracle, rows = VisibilityGraph(problem.workspace, problem.goals[0]), []
    with tempfile.TemporaryDirectory() as folder:
        plr = Path(folder) / "maze.plr"
        save(construct(oracle, problem.workspace.bounds, leaf="cone", max_bytes=1024), plr)
        for number in (1_000, 10_000) if smoke else ROWS:
            points = Path(folder) / "points.csv"
            _write(points, number, seed)
            began, before = time.perf_counter(), _of_children()
            with open(Path(folder) / "answers.txt", "wb") as answers:
                command = [sys.executable, "-c", _CODE, str(plr), str(points)]
                done = subprocess.run(command, check=True, stdout=answers, stderr=subprocess.PIPE, text=True)
            seconds, of_processor = time.perf_counter() - began, _of_children() - before
            *kilobytes, has_jax = done.stderr.split()
            megabytes = int(kilobytes[0]) / 1024 if kilobytes else None
            rows.append(
                {
                    "rows": number,
                    "seconds": seconds,
                    "processor": of_processor,
                    "megabytes": megabytes,
                    "jax": has_jax == "True",
                }
            )
            print(rows[-1], flush=True)
    return {"rows": rows}


def _of_children() -> float:
    """Seconds of a processor that all processes took that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _write(path: Path, number: int, seed: int) -> None:
    x = np.random.default_rng(seed).random((min(number, MOST_AT_ONCE), 2))
    text = re.sub(" ", ",", "\n".join(f"{a:.6f} {b:.6f}" for a, b in x.tolist())) + "\n"
    with open(path, "w") as file:
        for _ in range(number // len(x)):
            file.write(text)


def table(results: dict[str, Any]) -> str:
    rows = [["rows", "s", "s of a processor", "MB", "JAX imported"]]
    for row in results["rows"]:
        memory = "-" if row["megabytes"] is None else f"{row['megabytes']:.0f}"
        seconds = [f"{row[key]:.1f}" for key in ("seconds", "processor")]
        rows.append([f"{row['rows']:,}", *seconds, memory, "yes" if row["jax"] else "no"])
    return aligned(rows, 5)
