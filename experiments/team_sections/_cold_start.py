"""From the start of a process: import, the first plan, a second one with other starts and goals; the command line.

Medians of several processes, in which nothing is planned before: neither map nor starts and goals are known. The
second plan is in a workspace of its own, so that it knows no map either.
"""

import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from experiments._cold import cold_seconds
from experiments._planning import LATTICE
from experiments._tables import aligned

NUM_PROCESSES = 5
SCENE = "four rooms 4"


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    count = 1 if smoke else NUM_PROCESSES
    plans = [cold_seconds(SCENE, LATTICE) for _ in range(count)]
    keys = ("import", "plan", "second_plan", "process")
    medians = {key: round(float(np.median([plan[key] for plan in plans])), 4) for key in keys}
    with tempfile.TemporaryDirectory() as folder:
        commands = [seconds_of_command(Path(folder) / "path.json") for _ in range(count)]
    return {"scene": SCENE, **medians, "command": round(float(np.median(commands)), 3)}


def seconds_of_command(output: Path) -> float:
    command = [sys.executable, "-m", "plr_jax", "plan", "four_rooms", "--robots", "4", "--output", str(output)]
    began = time.perf_counter()
    subprocess.run(command, capture_output=True, check=True)
    return time.perf_counter() - began


def table(results: dict[str, Any]) -> str:
    head = ["scene", "import s", "first plan s", "second plan s", "process s", "plr-jax plan s"]
    keys = ("import", "plan", "second_plan", "process", "command")
    return aligned([head, [results["scene"], *(f"{results[key]:.3f}" for key in keys)]], 5)
