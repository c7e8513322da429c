"""By how much a process grows under limits of memory: at its peak, over what it held at the call.

Each call has a process of its own, in which two discs were planned before in another workspace, so that neither its
map nor its starts and goals are known, and goes on until it is out of memory or time. By turns it has no heuristic,
and one that is 0 everywhere, under which searches hardly ever succeed. A limit of memory bounds what lattices and
searches hold; the process may grow by a fifth more.
"""

import json
import subprocess
import sys
from itertools import product
from pathlib import Path
from typing import Any

from tqdm import tqdm

from experiments._planning import SCENES as OF_TABLE_TWO
from experiments._tables import aligned

MEGABYTES = (100, 200, 500, 1000)
SECONDS = 20.0
SCENES = (*OF_TABLE_TWO, "door 50", "crowd 100")
MOST_GROWTH = 1.2
HEURISTICS = ("lattice", "none")
_ROOT = Path(__file__).parents[2]
_STATUS = Path("/proc/self/status")


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    if not _STATUS.exists():
        return {"rows": [], "skipped": "skipped: this system does not tell the largest size of a process\n"}
    scenes, limits, seconds = (SCENES[:1], MEGABYTES[:1], 0.3) if smoke else (SCENES, MEGABYTES, SECONDS)
    calls = list(product(scenes, limits))
    rows = []
    for k, (scene, limit) in enumerate(tqdm(calls, desc="memory limits", delay=3, disable=None)):
        kind = HEURISTICS[(k + k // len(limits)) % 2]
        command = [sys.executable, "-m", __name__, scene, str(limit), kind, str(seconds)]
        output = subprocess.run(command, cwd=_ROOT, capture_output=True, text=True, check=True).stdout
        rows.append({"scene": scene, "megabytes": limit, "heuristic": kind, **json.loads(output)})
    return {"rows": rows}


def grown(scene: str, megabytes: str, kind: str, seconds: str) -> dict[str, Any]:
    """What one call makes of this process."""
    from experiments._planning import plan
    from experiments.team_sections._time_limits import SCENES as PROBLEMS
    from plr_jax import BLOptions, zero

    problem, heuristic = PROBLEMS[scene](), zero() if kind == "none" else None
    plan(PROBLEMS["four rooms 2"](), None, BLOptions())
    before = kilobytes("VmRSS")
    Path("/proc/self/clear_refs").write_text("5")  # the largest size begins anew
    options = BLOptions(cost_factor=1e-9, max_memory=1e6 * float(megabytes), time_limit=float(seconds))
    solution, taken = plan(problem, heuristic, options)
    return {
        "growth": round((kilobytes("VmHWM") - before) * 1024 / 1e6, 1),
        "status": solution.status.name,
        "seconds": round(taken, 3),
        "solved": solution.solved,
    }


def kilobytes(name: str) -> int:
    """A figure of this process, as Linux tells it."""
    lines = dict(line.split(":", 1) for line in _STATUS.read_text().splitlines())
    return int(lines[name].split()[0])


def table(results: dict[str, Any]) -> str:
    rows = [["scene", "heuristic", "status", "path", "s", "limit MB", "grown MB", "share"]]
    shares = {True: [0.0], False: [0.0]}
    for row in results["rows"]:
        share = row["growth"] / row["megabytes"]
        shares[row["status"] == "MEMORY_LIMIT"].append(share)
        numbers = f"{row['seconds']:.1f}", f"{row['megabytes']:,}", f"{row['growth']:,.0f}", f"{share:.2f}"
        rows.append([row["scene"], row["heuristic"], row["status"], "yes" if row["solved"] else "no", *numbers])
    count, too_large = len(rows) - 1, sum(share > MOST_GROWTH for part in shares.values() for share in part)
    return aligned(rows, 4) + (
        f"{len(shares[True]) - 1} of {count} calls reached the limit of memory; the largest share among them was "
        f"{max(shares[True]):.2f}, among those that ended before {max(shares[False]):.2f}; above {MOST_GROWTH:g}: "
        f"{too_large}.\n{results.get('skipped', '')}"
    )


if __name__ == "__main__":
    print(json.dumps(grown(*sys.argv[1:])))
