"""Travel times where the speed differs from place to place, without obstacles, beside fast marching on a fine grid.

In the unit square, two regions are ten times as fast as the rest; and a smooth slowness, between a half and three
halves. The cost map gives exact bounds over boxes for the regions, and those of a Lipschitz constant for the smooth
one. Errors are shares of the mean travel time of a field of scikit-fmm (second order, from a ball around the goal);
its own error is told by the difference to a grid half as fine.
"""

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from experiments.solving._rivals import marched
from plr_jax import PlaneSpace, Workspace, solve_eikonal
from plr_jax.spaces import CostMap, LipschitzCost

GOAL = np.array([0.13, 0.21])
LIMITS: tuple[dict[str, Any], ...] = ({"max_leaves": 10_000}, {"max_bytes": 6_144})
SIDE, _SMOKE_SIDE = 4_096, 256
POINTS = 1_000_000
_POINT_SEED = 61_000
_AMPLITUDE = 0.5


@dataclass(frozen=True)
class FastBoxes:
    """A factor of the cost that is 1 but in some boxes, borders included."""

    lo: Float[np.ndarray, "boxes dim"]
    hi: Float[np.ndarray, "boxes dim"]
    factor: float

    def __call__(self, q: Any) -> Float[np.ndarray, " n"]:
        inside = ((q[:, None] >= self.lo) & (q[:, None] <= self.hi)).all(axis=2).any(axis=1)
        return np.where(inside, self.factor, 1.0)

    def bounds(self, lo: Any, hi: Any) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Exact, as these boxes do not touch: a box meets one of them, or it does not; it is within one or not."""
        meets = ((lo[:, None] <= self.hi) & (hi[:, None] >= self.lo)).all(axis=2).any(axis=1)
        within = ((lo[:, None] >= self.lo) & (hi[:, None] <= self.hi)).all(axis=2).any(axis=1)
        return np.where(meets, self.factor, 1.0), np.where(within, self.factor, 1.0)


def _waves(q: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, " n"]:
    return 1 + _AMPLITUDE * np.sin(2 * np.pi * q[:, 0]) * np.sin(2 * np.pi * q[:, 1])


MAPS: dict[str, CostMap] = {
    "two regions, 10 x as fast": FastBoxes(
        np.array([(0.22, 0.37), (0.57, 0.13)]), np.array([(0.41, 0.91), (0.93, 0.34)]), 0.1
    ),
    "smooth": LipschitzCost(_waves, lipschitz=2 * np.pi * _AMPLITUDE, least=1 - _AMPLITUDE),
}


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    limits: tuple[dict[str, Any], ...] = ({"max_leaves": 300},) if smoke else LIMITS
    side = _SMOKE_SIDE if smoke else SIDE
    space = PlaneSpace(Workspace(((0, 0), (1, 1))))
    x = space.workspace.sample_free(5_000 if smoke else POINTS, _POINT_SEED + seed)
    solve_eikonal(space, GOAL, max_leaves=100)  # imports and compiles
    rows = []
    for name, cost_map in MAPS.items():
        began = time.perf_counter()
        truth = marched(space, GOAL, (side, side), cost_map)(x)
        marching = {"marching_seconds": time.perf_counter() - began}
        coarser = marched(space, GOAL, (side // 2, side // 2), cost_map)(x)
        marching["marching_difference"] = float(np.abs(coarser - truth).mean() / truth.mean())
        for limit in limits:
            began = time.perf_counter()
            plr = solve_eikonal(space, GOAL, cost_map=cost_map, **limit, seed=seed)
            row = {
                "map": name,
                "seconds": time.perf_counter() - began,
                "cells": plr.num_leaves,
                "bytes": plr.num_bytes,
            }
            rows.append(row | _errors(plr, x, truth) | marching)
    return {"side": side, "points": len(x), "rows": rows}


def _errors(plr: Any, x: Float[np.ndarray, "n 2"], truth: Float[np.ndarray, " n"]) -> dict[str, Any]:
    """Shares of the mean time; where the times of the grid are beyond the bounds, and by how much."""
    error = np.abs(np.asarray(plr(x), float) - truth) / truth.mean()
    lower, upper = (np.asarray(bound, float) for bound in plr.bounds(x))
    bounded = np.isfinite(upper)
    beyond = np.maximum(lower - truth, truth - upper) / truth.mean()
    return {
        "mean": float(error.mean()),
        "largest": float(error.max()),
        "gap": float((upper - lower)[bounded].mean() / truth[bounded].mean()) if bounded.any() else None,
        "without_upper": float(1 - bounded.mean()),
        "beyond_share": float((beyond > 0).mean()),
        "beyond_largest": float(beyond.max(initial=0.0)),
    }
