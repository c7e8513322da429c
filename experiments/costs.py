"""Costs that vary from place to place: estimates and proven bounds beside second-order fast marching of scikit-fmm.

Four smooth costs and four rasters, which differ by factors of 2 to 50, around a wall. Errors of fast marching are
proportional to the step. So the truth is extrapolated from marches of 3,201 x 1,601 nodes and of half as many along
each axis; how far it may be off is told by the truth from half and a quarter as many. In ``estimates``, scikit-fmm
gets a regular grid of about as many nodes as the PLR has cells (up to a third more, as nodes lie on the walls), and
is interpolated between them. In ``equal_seconds``, the PLR has 8 KB, and scikit-fmm the largest grid that it marches
in as many seconds, or two grids for extrapolation. Seconds are of all cores, compiled before; of scikit-fmm those of
the march alone, of a PLR those of ``solve_eikonal``, which asks costs and space too.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import skfmm
from jaxtyping import Float
from scipy import ndimage
from scipy.interpolate import RegularGridInterpolator

from experiments._c_headers import median_seconds
from experiments._measures import relative_error, timed
from experiments._runner import Section, run
from plr_jax import PlaneSpace, RasterCost, Workspace, solve_eikonal
from plr_jax.spaces import CostMap, LipschitzCost

BOUNDS = ((0.0, 0.0), (2.0, 1.0))
GOAL = np.array([0.2, 0.2])
WALL = [(0.9, 0.0), (1.0, 0.0), (1.0, 0.6), (0.9, 0.6)]
POINTS = 20_000
CELLS = (2_500, 10_000, 40_000)
MOST_BYTES = 8_192
_TURNS = 3
_FINE = 1_600  # rows of the truth

Points = Float[np.ndarray, "n 2"]
Distance = Callable[[Points], Float[np.ndarray, " n"]]


def _ramp(q: Points) -> Float[np.ndarray, " n"]:
    return 1 + 3 / (1 + np.exp(-(12 * (q[:, 0] - 1.4) - 6 * (q[:, 1] - 0.5))))


def _waves(q: Points) -> Float[np.ndarray, " n"]:
    return 1.5 + 0.5 * np.sin(6 * q[:, 0]) * np.cos(7 * q[:, 1])


def _hill(q: Points) -> Float[np.ndarray, " n"]:
    return 1 + 9 * np.exp(-12 * ((q[:, 0] - 1.3) ** 2 + (q[:, 1] - 0.7) ** 2))


def _cliff(q: Points) -> Float[np.ndarray, " n"]:
    return np.exp(np.log(50) / (1 + np.exp(-10 * (q[:, 1] - 0.55))))


def smooth() -> dict[str, LipschitzCost]:
    # The largest slopes, rounded up.
    constants = {"ramp": (_ramp, 10.07), "waves": (_waves, 3.6), "hill": (_hill, 26.8), "cliff": (_cliff, 143.2)}
    return {name: LipschitzCost(cost_fn, float(most), 0.99) for name, (cost_fn, most) in constants.items()}


def rasters(seed: int) -> dict[str, RasterCost]:
    """Noise, smoothed over fewer and fewer of 200 x 100 pixels, and what is inflated around blocks."""
    rng, maps = np.random.default_rng(seed), {}
    for name, width, most in (("noise 2", 12, 2.0), ("noise 10", 8, 10.0), ("noise 50", 5, 50.0)):
        noise = ndimage.gaussian_filter(rng.normal(size=(100, 200)), width)
        share = (noise - noise.min()) / np.ptp(noise)
        maps[name] = RasterCost(most**share, BOUNDS)
    blocked = np.zeros((100, 200), bool)
    for row, column in rng.integers((10, 30), (90, 190), (12, 2)):
        blocked[row : row + 4, column : column + 4] = True
    from_blocks: Any = ndimage.distance_transform_edt(~blocked)
    inflated = 1 + 9 * np.exp(-from_blocks / 6)
    maps["inflated"] = RasterCost(inflated, BOUNDS)
    return maps


def marched(space: PlaneSpace, cost_map: CostMap, rows: int) -> tuple[Distance, Callable[[], Any]]:
    """The cost-to-go by scikit-fmm on a grid of rows + 1 times twice as many + 1 nodes, and the march by itself.

    Nodes may lie on walls, and the front begins near the goal: so it errs less than over centers of cells, as
    ``solving/_rivals.py`` has it for spaces of any dimension.
    """
    x, y = np.linspace(0, 2, 2 * rows + 1), np.linspace(0, 1, rows + 1)
    q = np.stack(np.meshgrid(x, y), axis=-1)
    flat, radius, at_goal = q.reshape(-1, 2), 1.5 / rows, float(cost_map(GOAL[None])[0])
    factor = np.asarray(cost_map(flat)).reshape(q.shape[:2])
    blocked = ~space.is_free(flat).reshape(q.shape[:2])
    from_goal = np.linalg.norm(q - GOAL, axis=-1)

    def march():
        return skfmm.travel_time(np.ma.MaskedArray(from_goal - radius, blocked), 1 / factor, dx=1 / rows, order=2)

    time_beyond = np.ma.filled(march(), np.nan) + radius * at_goal
    cost = np.where(from_goal < radius, from_goal * (factor + at_goal) / 2, time_beyond)
    return RegularGridInterpolator((x, y), cost.T), march


def converged(space: PlaneSpace, cost_map: CostMap, x: Points, rows: int) -> tuple[Float[np.ndarray, " n"], ...]:
    """The cost-to-go extrapolated to steps of length 0, and how far it may be off."""
    fine, half, quarter = (marched(space, cost_map, rows // parts)[0](x) for parts in (1, 2, 4))
    return 2 * fine - half, np.abs(2 * fine - 3 * half + quarter)


def _space() -> PlaneSpace:
    return PlaneSpace(Workspace(BOUNDS, [WALL]))


def estimates(seed: int, smoke: bool) -> dict[str, Any]:
    space, rows, fine = _space(), [], 200 if smoke else _FINE
    maps = smooth() | rasters(seed)
    x = space.workspace.sample_free(POINTS, seed)
    for name, cost_map in list(maps.items())[:: 7 if smoke else 1]:
        truth, off = converged(space, cost_map, x, fine)
        for cells in CELLS[:1] if smoke else CELLS:

            def build(cells=cells, cost_map=cost_map):
                return solve_eikonal(space, GOAL, cost_map=cost_map, max_leaves=cells, certified=False)

            plr, nodes = build(), 10 * round(np.sqrt(cells / 2) / 10)  # on the walls
            rival, march = marched(space, cost_map, nodes)
            rows.append(
                {
                    "map": name,
                    "cells": plr.num_leaves,
                    "error": relative_error(np.asarray(plr(x), float), truth),
                    "seconds": median_seconds(build, _TURNS),
                    "nodes of scikit-fmm": (nodes + 1) * (2 * nodes + 1),
                    "its error": relative_error(rival(x), truth),
                    "its seconds": median_seconds(march, _TURNS),
                    "of the truth": relative_error(truth + off, truth),
                }
            )
    return {"rows": rows}


def equal_seconds(seed: int, smoke: bool) -> dict[str, Any]:
    space, rows, fine = _space(), [], 200 if smoke else _FINE
    x = space.workspace.sample_free(POINTS, seed)
    for name, cost_map in list((smooth() | rasters(seed)).items())[:: 7 if smoke else 1]:

        def build(cost_map=cost_map):
            return solve_eikonal(space, GOAL, cost_map=cost_map, max_bytes=MOST_BYTES, certified=False)

        truth, off = converged(space, cost_map, x, fine)
        plr, seconds = build(), median_seconds(build, _TURNS)
        rival, its_rows, its_seconds = _largest_march(space, cost_map, 0.01 if smoke else seconds)
        # For extrapolation, two grids, one of half as many rows, that scikit-fmm marches in as many seconds.
        fewer = max(20, int(0.85 * its_rows / 20) * 20)
        finer, coarser = (marched(space, cost_map, each)[0](x) for each in (fewer, fewer // 2))
        rows.append(
            {
                "map": name,
                "bytes": plr.num_bytes,
                "error": relative_error(np.asarray(plr(x), float), truth),
                "seconds": seconds,
                "nodes of scikit-fmm": (its_rows + 1) * (2 * its_rows + 1),
                "its error": relative_error(rival(x), truth),
                "its error, extrapolated": relative_error(2 * finer - coarser, truth),
                "its seconds": its_seconds,
                "of the truth": relative_error(truth + off, truth),
            }
        )
    return {"rows": rows}


def _largest_march(space: PlaneSpace, cost_map: CostMap, seconds: float) -> tuple[Distance, int, float]:
    """The largest grid with nodes on the walls that scikit-fmm marches in so many seconds, its rows and seconds."""
    tens, too_many = 4, _FINE
    while True:
        rows = 10 * tens
        found, march = marched(space, cost_map, rows)
        taken, _ = timed(march)
        other = int(tens * np.sqrt(seconds / taken))
        if taken > seconds:
            too_many, tens = tens, min(other, tens - 1)
        elif (other := min(other, too_many - 1)) <= tens:
            return found, rows, taken
        else:
            tens = other


def bounds(seed: int, smoke: bool) -> dict[str, Any]:
    space, rows = _space(), []
    x = space.workspace.sample_free(1_000 if smoke else 50 * POINTS, seed)
    maps = smooth() | rasters(seed)
    for name in ("ramp",) if smoke else maps:
        truth, off = converged(space, maps[name], x, 200 if smoke else _FINE)
        spare = np.nanmax(off)
        for cells in (300,) if smoke else (10_000, 40_000) if name == "ramp" else (10_000,):
            seconds, plr = timed(
                lambda name=name, cells=cells: solve_eikonal(space, GOAL, cost_map=maps[name], max_leaves=cells)
            )
            lower, upper = (np.asarray(each, float) for each in plr.bounds(x))
            both = np.isfinite(upper) & np.isfinite(truth)
            rows.append(
                {
                    "map": name,
                    "cells": plr.num_leaves,
                    "seconds": seconds,
                    "error": relative_error(np.asarray(plr(x), float), truth),
                    "gap": float((upper - lower)[both].mean() / truth[both].mean()),
                    "broken": int(np.count_nonzero((lower > truth + spare) | (upper < truth - spare))),
                    "points": len(x),
                    "allowed": float(spare),
                }
            )
    return {"rows": rows}


SECTIONS = {each.__name__: Section(each) for each in (estimates, equal_seconds, bounds)}

if __name__ == "__main__":
    run("costs", __doc__, SECTIONS)
