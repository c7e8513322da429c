"""Two plans in a new process, from its start: ``python -m experiments._cold SCENE HEURISTIC`` prints JSON."""

import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

_ROOT = Path(__file__).parent.parent


def cold_seconds(scene: str, heuristic: str) -> dict[str, Any]:
    """Seconds by phase of the first plans in a new process, and in all from its start to its end."""
    command = [sys.executable, "-m", "experiments._cold", scene, heuristic]
    began = time.perf_counter()
    output = subprocess.run(command, cwd=_ROOT, capture_output=True, text=True, check=True).stdout
    total = time.perf_counter() - began
    return {**json.loads(output), "process": round(total, 4)}


def main(scene: str, heuristic: str) -> None:
    began = time.perf_counter()
    from experiments._planning import SCENES, BLOptions, build, is_valid, plan, scenes

    problem = SCENES[scene]()
    loaded = time.perf_counter()
    built = build(problem, heuristic)
    solution, seconds = plan(problem, built.heuristic, BLOptions())
    other = scenes.perturbed(SCENES[scene](), seed=1)
    again = build(other, heuristic)
    second = plan(other, again.heuristic, BLOptions())[1] + again.oracle_seconds + again.plr_seconds
    report = {
        "import": loaded - began,
        "oracle": built.oracle_seconds,
        "plr": built.plr_seconds,
        "plan": seconds,
        "second_plan": second,
    }
    rounded = {name: round(value, 4) for name, value in report.items()}
    print(json.dumps({**rounded, "valid": is_valid(problem, solution)}))


if __name__ == "__main__":
    main(*sys.argv[1:])
