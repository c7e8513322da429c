"""A notch one thousandth of the map, of which samples hardly know: the largest error there and next to the goal."""

from typing import Any

import numpy as np

from experiments._tables import aligned
from experiments.proving._worst_points import largest_found
from plr_jax import VisibilityGraph, Workspace, construct

GOAL = np.array([3.0, 3.0])
STRIP = [(0, 5), (23, 5), (23, 6), (24, 6), (24, 5), (40, 5), (40, 46), (0, 46)]
BYTES = (4_096, 65_536)
_REGIONS = {"notch": ((23.0, 5.0), (24.0, 6.0)), "near the goal": ((2.0, 2.0), (4.0, 4.0))}


def notched_strip() -> Workspace:
    """A strip along the lower side of a map, with a notch in its upper wall."""
    return Workspace(((0, 0), (40, 46)), [np.array(STRIP, float)])


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    oracle, points = VisibilityGraph(notched_strip(), GOAL), 5_000 if smoke else 500_000
    domain, rng = oracle.workspace.bounds, np.random.default_rng(seed)
    regions = {name: rng.uniform(lo, hi, (points, 2)) for name, (lo, hi) in _REGIONS.items()}
    regions["anywhere"] = oracle.workspace.sample_free(points, seed)
    rows = []
    for budget in BYTES[:1] if smoke else BYTES:
        for leaf, certified in (("plane", False), ("plane", True), ("cone", True)):
            plr = construct(oracle, domain, leaf=leaf, max_bytes=budget, certified=certified, seed=seed)
            errors = {name: np.abs(np.asarray(plr(x), float) - oracle(x)) for name, x in regions.items()}
            largest = {name: float(error.max()) for name, error in errors.items()}
            found = largest_found(plr, oracle, regions["anywhere"], errors["anywhere"], smoke)
            row = {"leaf": leaf, "certified": certified, "budget": budget, "bytes": plr.num_bytes}
            rows.append({**row, "largest": {**largest, "found": found}, "proven": plr.max_error})
    return {"points": points, "rows": rows}


def table(results: dict[str, Any]) -> str:
    names = list(results["rows"][0]["largest"])
    rows = [["leaf", "certified", "bytes", *(f"largest, {name}" for name in names), "proven"]]
    for row in results["rows"]:
        proven = "-" if row["proven"] is None else f"{row['proven']:.3g}"
        largest = [f"{row['largest'][name]:.3g}" for name in names]
        rows.append([row["leaf"], "yes" if row["certified"] else "no", f"{row['bytes']:,}", *largest, proven])
    return aligned(rows, numbers=len(names) + 2)
