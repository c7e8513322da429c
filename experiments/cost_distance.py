"""Cost distance over rasters beside other tools: errors, seconds, memory.

Rasters of 400 x 400 cells: smooth costs, classes of land, an expensive river of one cell with a ford, a cheap road of
one cell. Marches of scikit-fmm err in proportion to their step where costs jump. So the truth is extrapolated from
marches over eight and four times as many nodes along each axis. ``halved`` is its distance from what half as many
give: how far the truth is off. Rivals get the same cells: scikit-image ``MCP_Geometric``, scikit-fmm and, where it is
installed, xarray-spatial.

``mountain``: seconds of a hiker by Tobler's function, there and back, beside a raster three times finer. ``large``:
10,000 x 10,000 cells of a Dask array.
"""

from collections.abc import Callable
from functools import partial
from itertools import pairwise
from typing import Any

import dask.array  # pyright: ignore[reportMissingImports]
import numpy as np
import skfmm
import xarray  # pyright: ignore[reportMissingImports]
from jaxtyping import Float
from scipy import ndimage

from experiments._measures import peak_megabytes, timed
from experiments._runner import Section, run
from plr_jax import CostDistance, NearestGoal, VisibilityGraph, Workspace, cost_distance

SIDE, FINER, TURNS = 400, 8, 3
SOURCES = {1: [(200, 57)], 5: [(30, 30), (370, 40), (200, 200), (60, 350), (380, 390)]}
LARGE, LARGE_SOURCES = 10_000, 20
_METERS = 6_000.0

Raster = Float[np.ndarray, "rows columns"]


def rasters(seed: int) -> dict[str, Raster]:
    rng = np.random.default_rng(seed)
    noise = ndimage.gaussian_filter(rng.normal(size=(SIDE, SIDE)), 20)
    smooth = 10 ** ((noise - noise.min()) / np.ptp(noise))
    share = ndimage.gaussian_filter(rng.normal(size=(SIDE, SIDE)), 8)
    classes = np.array([1.0, 2.0, 5.0, 10.0, 20.0])[np.digitize(share, [-0.04, -0.01, 0.01, 0.03])]
    winding = (SIDE // 2 + 60 * np.sin(np.arange(SIDE) / 40)).astype(int)
    is_line = np.zeros((SIDE, SIDE), bool)
    for column, rows in enumerate(pairwise(winding)):
        is_line[min(rows) : max(rows) + 1, column] = True
    is_line[winding[-1], -1] = True
    river = np.where(is_line, 20.0, 1.0)
    river[winding[100], 100] = 1.0  # a ford
    return {"smooth": smooth, "classes": classes, "river": river, "road": np.where(is_line, 1.0, 5.0)}


def marched(costs: Raster, sources: list[tuple[int, int]], finer: int) -> Raster:
    """Return the distance at the centers of cells, by one march a source over an even number of nodes a side."""
    y, x = (np.mgrid[: SIDE * finer, : SIDE * finer] + 0.5) / finer
    fine = np.kron(costs, np.ones((finer, finer)))
    least, beside = np.full(costs.shape, np.inf), slice(finer // 2 - 1, finer // 2 + 1)
    for row, column in sources:
        length, cost = np.hypot(x - column - 0.5, y - row - 0.5), costs[row, column]
        time = np.asarray(skfmm.travel_time(length - 0.5, 1 / fine, dx=1 / finer, order=2)) + cost / 2
        time = np.where(length < 0.5, length * cost, time)  # the source's own cell
        of_cells = time.reshape(SIDE, finer, SIDE, finer)[:, beside, :, beside].mean(axis=(1, 3))
        least = np.minimum(least, of_cells)
    return least


def scikit_fmm(costs: Raster, sources: list[tuple[int, int]]) -> Raster:
    phi = np.ones_like(costs)
    phi[tuple(np.transpose(sources))] = -1e-3
    return np.asarray(skfmm.travel_time(phi, 1 / costs, order=2))


def scikit_fmm_divided(costs: Raster, sources: list[tuple[int, int]]) -> Raster:
    """Return what the march gives over nine nodes a cell."""
    fine = np.kron(costs, np.ones((3, 3)))
    return scikit_fmm(fine, [(3 * row + 1, 3 * column + 1) for row, column in sources])[1::3, 1::3] / 3


def scikit_image(costs: Raster, sources: list[tuple[int, int]]) -> Raster:
    from skimage.graph import MCP_Geometric  # pyright: ignore[reportMissingImports]

    return MCP_Geometric(costs).find_costs(sources)[0]


def xarray_spatial(costs: Raster, sources: list[tuple[int, int]]) -> Raster:
    import xarray  # pyright: ignore[reportMissingImports]
    import xrspatial  # pyright: ignore[reportMissingImports]

    def raster(values: np.ndarray) -> Any:
        return xarray.DataArray(values, dims=("y", "x"), coords={axis: np.arange(SIDE) + 0.5 for axis in "yx"})

    seeds = np.zeros_like(costs)
    seeds[tuple(np.transpose(sources))] = 1 + np.arange(len(sources))
    return xrspatial.cost_distance(raster(seeds), raster(costs)).values


def _points(sources: list[tuple[int, int]]) -> list[tuple[float, float]]:
    return [(column + 0.5, row + 0.5) for row, column in sources]


TOOLS: dict[str, Callable[[Raster, list[tuple[int, int]]], Raster]] = {
    "plr_jax": lambda costs, sources: cost_distance(costs, _points(sources)).distance,
    "scikit-fmm": scikit_fmm,
    "scikit-fmm, 9 nodes a cell": scikit_fmm_divided,
    "scikit-image MCP_Geometric": scikit_image,
    "xarray-spatial": xarray_spatial,
}


def errors(seed: int, smoke: bool) -> dict[str, Any]:
    rows = []
    for name, costs in list(rasters(seed).items())[: 1 if smoke else None]:
        for count, sources in list(SOURCES.items())[: 1 if smoke else None]:
            coarse, half, fine = (
                marched(costs, sources, each) for each in ((2, 2, 2) if smoke else (FINER // 4, FINER // 2, FINER))
            )
            truth = 2 * fine - half
            halved = np.abs(2 * half - coarse - truth) / truth.mean()
            off = {"halved": float(halved.mean()), "halved_largest": float(halved.max())}
            for tool in TOOLS:
                try:
                    row = _measure(tool, costs, sources, truth)
                except ImportError as error:
                    print(f"{tool}: skipped, {error}")
                    continue
                rows.append({"raster": name, "sources": count, "tool": tool, **row, **off})
    return {"side": SIDE, "finer": FINER, "rows": rows}


def _measure(tool: str, costs: Raster, sources: list[tuple[int, int]], truth: Raster) -> dict[str, float]:
    call = TOOLS[tool]
    call(costs, sources)  # some compile
    runs = [timed(lambda: call(costs, sources)) for _ in range(TURNS)]
    error = np.abs(runs[0][1] - truth) / truth.mean()
    seconds = float(np.median([seconds for seconds, _ in runs]))
    return {"mean": float(error.mean()), "largest": float(error.max()), "cpu_seconds": seconds}


def bounds(seed: int, smoke: bool) -> dict[str, Any]:
    """Proven bounds: how far apart they are, and in how many cells they exclude the truth.

    The exact distances among ``walls`` test both bounds. On the other rasters the truth is too large by up to about
    its distance from a coarser march, so it tests the lower bounds only.
    """
    rows = []
    for name, costs in {"walls": _walls(seed), **rasters(seed)}.items():
        for count, sources in list(SOURCES.items())[: 1 if smoke else None]:
            seconds, result = timed(partial(cost_distance, costs, _points(sources), bounds=True))
            if name == "walls":
                truth, off = _exact(costs, sources), 1e-9
                broken = (result.lower > truth + off) | (result.upper < truth - off)
            else:
                truth = marched(costs, sources, 2 if smoke else FINER)
                off = np.abs(marched(costs, sources, 2 if smoke else FINER // 2) - truth)
                broken = result.lower > truth + 2 * off
            reached = np.isfinite(truth)
            gap, mean = result.upper[reached] - result.lower[reached], truth[reached].mean()
            row = {"raster": name, "sources": count, "cpu_seconds": seconds, "broken": int(broken[reached].sum())}
            rows.append({**row, "finite": float(np.isfinite(gap).mean()), "gap": float(gap.mean() / mean)})
        if smoke:
            break
    return {"rows": rows}


def _walls(seed: int) -> Raster:
    """Equal costs around rectangular barriers, which cover no source."""
    costs, rng = np.ones((SIDE, SIDE)), np.random.default_rng(seed)
    for row, column, height, width in rng.integers((0, 0, 5, 5), (SIDE, SIDE, 60, 60), (25, 4)):
        costs[row : row + height, column : column + width] = np.nan
    for row, column in (source for sources in SOURCES.values() for source in sources):
        costs[row - 2 : row + 3, column - 2 : column + 3] = 1.0
    return costs


def _exact(costs: Raster, sources: list[tuple[int, int]]) -> Raster:
    workspace = Workspace.from_mask(np.isfinite(costs))
    first, *others = _points(sources)
    oracle = VisibilityGraph(workspace, first)
    oracles: list[Any] = [oracle, *map(oracle.with_goal, others)]
    nearest = NearestGoal(oracles)
    centers = np.stack(np.meshgrid(np.arange(SIDE) + 0.5, np.arange(SIDE) + 0.5), axis=-1)
    return np.where(np.isfinite(costs), nearest(centers.reshape(-1, 2)).reshape(costs.shape), np.inf)


def _heights(count: int) -> Raster:
    along = (np.arange(count) + 0.5) / count * 4 - 2
    x, y = np.meshgrid(along, along)
    return 1_200 * np.exp(-(x**2) - y**2) + 300 * np.sin(3 * x) * np.cos(2 * y)


def mountain(seed: int, smoke: bool) -> dict[str, Any]:
    rows, count = [], 60 if smoke else 300
    sources = [(1_500.0, 1_500.0), (5_200.0, 4_100.0)]

    def hiked(finer: int, from_sources: bool) -> CostDistance:
        cells = count * finer
        options: Any = {"cell_size": _METERS / cells, "heights": _heights(cells), "from_sources": from_sources}
        return cost_distance(np.ones((cells, cells)), sources, **options)

    for from_sources in (False, True):
        seconds, result = timed(lambda from_sources=from_sources: hiked(1, from_sources))
        truth = hiked(3, from_sources).distance[1::3, 1::3]
        error = np.abs(result.distance - truth) / truth.mean()
        row = {"way": "from the sources" if from_sources else "to the sources", "cpu_seconds": seconds}
        rows.append(
            {**row, "mean": float(error.mean()), "largest": float(error.max()), "hours": float(truth.mean()) / 3600}
        )
    return {"side": count, "rows": rows}


def large(seed: int, smoke: bool) -> dict[str, Any]:
    side = 500 if smoke else LARGE
    rng = np.random.default_rng(seed)
    costs: Any = ndimage.zoom(1 + 9 * rng.random((side // 100, side // 100)), 100, order=1)
    sources = rng.uniform(0, side, (LARGE_SOURCES, 2))
    at = np.arange(side) + 0.5
    chunks = dask.array.from_array(costs.astype(np.float32))
    costs = xarray.DataArray(chunks, {"y": at, "x": at}, ("y", "x"))
    seconds, result = timed(lambda: cost_distance(costs, sources))
    reached = float(np.isfinite(result.distance).mean())
    return {
        "rows": [
            {
                "side": side,
                "sources": len(sources),
                "cpu_seconds": seconds,
                "megabytes": peak_megabytes(),
                "reached": reached,
            }
        ]
    }


SECTIONS = {each.__name__: Section(each) for each in (errors, bounds, mountain, large)}

if __name__ == "__main__":
    run("cost_distance", __doc__, SECTIONS)
