"""Sixteen discs of the db-CBS collection, their motions holonomic, medians of five calls after one on eight."""

from typing import Any

from experiments._tables import aligned
from experiments.planning._collections import SKIPPED, collections
from experiments.planning._plans import HEAD, alone, cells, middle, planned
from plr_jax import bl_plan, scenes

NUM_RUNS = 5


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    folder = collections("dbcbs")
    if folder is None:
        return {"rows": [], "skipped": SKIPPED}
    warm, timed = (
        scenes.read_dbcbs(folder / "dbcbs" / f"gen_p10_n{size}_0_unicycle_sphere.yaml")
        for size in ((2, 4) if smoke else (8, 16))
    )
    bl_plan(warm)
    bound = alone(timed)
    runs = [planned(timed, bound) for _ in range(1 if smoke else NUM_RUNS)]
    return {"rows": [{"scene": "gen_p10_n16_0", **middle(runs)}]}


def table(results: dict[str, Any]) -> str:
    return aligned([HEAD, *map(cells, results["rows"])], 5) + results.get("skipped", "")
