"""PLRs of a turning rectangle and of an arm of three joints, without an oracle, beside grids and roadmaps.

The rectangle is the first of the tangle, its goal in the hallway; the arm is fixed amid three obstacles. Judged is
what 50,000 and 100,000 cells give, at random free configurations from which the grid finds a way: the share that has
an upper bound, the mean gap there, and the mean difference of the PLR to the grid, as shares of the mean cost-to-go.

The grid is several times finer an axis than a uniform one of as many cells. Of the rectangle, whose cost is no
Euclidean length, it is searched by Dijkstra's algorithm: 48 directions in the plane, turns by a cell, both at once to
the eight nearest, all tested as motions. Its way is never shorter than the best one. In the open and without turns,
it is up to 0.76 % longer, where the best one is in between the directions; elsewhere it may be longer. Of the arm it
is marched over (scikit-fmm, second order, all axes periodic). How far a grid half as fine is from it is told.

PRM* gets more and more samples; judged are their own costs.
"""

import time
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from experiments._measures import relative_errors
from experiments.solving._rivals import Sizes, all_neighbors, counted, even_sizes, grid_search, marched, prm_star
from plr_jax import GridField, PlanarArm, RigidBodySpace, Workspace, scenes, solve_eikonal
from plr_jax.spaces import ConfigurationSpace

CELLS = (50_000, 100_000)
SAMPLES = (1_000, 3_000, 10_000, 30_000)
GRID_CELLS = 16_000_000
_SMOKE_CELLS, _SMOKE_SAMPLES, _SMOKE_GRID = 2_000, 300, 60_000
POINTS = 50_000
_POINT_SEED = 62_000
_LINKS, _BASE, _GOAL = (0.6, 0.5, 0.4), (0.0, 0.0), (-2.2, -0.3, 0.2)
_OBSTACLES = ((0.6, 0.5, 1.0, 0.9), (-1.2, 0.3, -0.7, 0.8), (-0.2, -1.3, 0.4, -0.9))  # x0, y0, x1, y1


class Body(NamedTuple):
    """What moves, where to, and how costs are found on a grid."""

    space: ConfigurationSpace
    goal: Float[np.ndarray, " dof"]
    on_grid: Callable[[ConfigurationSpace, Float[np.ndarray, " dof"], Sizes], GridField]


def rectangle() -> Body:
    problem = scenes.tangle()
    space = RigidBodySpace(problem.workspace, problem.robots[0], problem.rotation_weight)
    return Body(space, problem.goals[0], partial(grid_search, offsets=_RECTANGLE_STEPS))


def arm() -> Body:
    walls = [[(x0, y0), (x1, y0), (x1, y1), (x0, y1)] for x0, y0, x1, y1 in _OBSTACLES]
    space = PlanarArm(Workspace(((-2, -2), (2, 2)), walls), _LINKS, _BASE)
    return Body(space, np.array(_GOAL), marched)


_RECTANGLE_STEPS = [
    *((*step, 0) for step in all_neighbors(2, 4)),
    (0, 0, 1),
    *((x, y, 1) for x in (-1, 0, 1) for y in (-1, 0, 1) if (x, y) != (0, 0)),
]
BODIES = {"rectangle": rectangle, "arm": arm}


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    rows, grids, num_points = [], {}, 2_000 if smoke else POINTS
    for name, make in BODIES.items():
        body = make()
        x = _free(body.space, num_points, seed)
        truth, grids[name] = _grid(body, _SMOKE_GRID if smoke else GRID_CELLS, x)
        for max_leaves in (_SMOKE_CELLS,) if smoke else CELLS:
            rows.append({"body": name, **_solved(body, max_leaves, truth, x, seed)})
        for num_samples in (_SMOKE_SAMPLES,) if smoke else SAMPLES:
            rows.append({"body": name, **_sampled(body, num_samples, truth, seed)})
    return {"points": num_points, "grids": grids, "rows": rows}


def _free(space: ConfigurationSpace, num_points: int, seed: int) -> Float[np.ndarray, "n dof"]:
    """Random free configurations."""
    rng = np.random.default_rng(_POINT_SEED + seed)
    found: list[np.ndarray] = []
    while sum(map(len, found)) < num_points:
        x = space.domain.lo + space.domain.width * rng.random((num_points, space.domain.dim))
        found.append(x[space.is_free(x)])
    return np.concatenate(found)[:num_points]


def _grid(body: Body, num_cells: int, x: Float[np.ndarray, "n dof"]) -> tuple[GridField, dict[str, Any]]:
    """Costs on a grid, and how far those of one half as fine are from them."""
    space, scale = body.space, body.space.motion_cost.scale
    began = time.perf_counter()
    sizes = even_sizes(space.domain, scale, num_cells)
    truth = body.on_grid(space, body.goal, sizes)
    seconds = time.perf_counter() - began
    half = even_sizes(space.domain, scale, num_cells // 2**space.domain.dim)
    fine, coarse = truth(x), body.on_grid(space, body.goal, half)(x)
    known, both = np.isfinite(fine), np.isfinite(fine) & np.isfinite(coarse)
    own = float(np.abs(coarse[both] - fine[both]).mean() / fine[both].mean())
    return truth, {
        "sizes": sizes,
        "half": half,
        "seconds": seconds,
        "reached": float(known.mean()),
        "difference": own,
    }


def _solved(body: Body, max_leaves: int, truth: GridField, x: np.ndarray, seed: int) -> dict[str, Any]:
    space = counted(body.space)
    began = time.perf_counter()
    plr = solve_eikonal(space, body.goal, max_leaves=max_leaves, seed=seed)
    row: dict[str, Any] = {"method": "solve_eikonal", "seconds": time.perf_counter() - began, "cells": plr.num_leaves}
    cost = truth(x)
    x, cost = x[np.isfinite(cost)], cost[np.isfinite(cost)]
    lower, upper = (np.asarray(bound, float) for bound in plr.bounds(x))
    bounded = np.isfinite(upper)
    gap = float((upper - lower)[bounded].mean() / cost[bounded].mean()) if bounded.any() else None
    row |= {"bytes": plr.num_bytes, "tests": space.tests.for_json(), "gap": gap, "with_upper": float(bounded.mean())}
    beyond = np.maximum(lower - cost, np.where(bounded, cost - upper, -np.inf)) / cost.mean()
    row |= {"beyond_share": float((beyond > 0).mean()), "beyond_largest": float(beyond.max(initial=0.0))}
    below = float((cost - lower).mean() / cost.mean())
    return row | relative_errors(np.asarray(plr(x), float), cost) | {"below": below}


def _sampled(body: Body, num_samples: int, truth: GridField, seed: int) -> dict[str, Any]:
    sampled = prm_star(body.space, body.goal, num_samples, seed)
    cost = truth(sampled.vertices[1:])
    known = np.isfinite(cost)
    row = {"method": "PRM*", "cells": num_samples, "bytes": sampled.num_bytes, "seconds": sampled.seconds}
    return row | {"tests": sampled.tests} | relative_errors(sampled.costs[1:][known], cost[known])
