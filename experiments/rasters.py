"""Cost distance over rasters beside truths that share no code with it (``_raster_truths.py``), and other tools.

``slopes``: land classes on a relief, by Tobler's function. The truth is a graph on a lattice of four nodes a cell,
with edges of up to 7 nodes (144 neighbors). ``path``: how far costs of paths, integrated, are from the distance.
``truth_off``, in all sections: how far the truth is from what coarser and finer graphs or marches give.
``degrees``: great circles on rasters of longitude and latitude; then land classes and barriers beside a march over
Mercator's map, extrapolated from 4 and 8 nodes a cell.
``rivals``: GRASS ``r.cost`` and ``r.walk`` (``apt-get install grass-core``), xarray-spatial and scikit-image; those
that are not installed are skipped. CPU seconds of GRASS are those of its module, without import and export.
``r.walk`` adds the friction of cells to Langmuir's costs of slopes, where ``cost_distance`` multiplies. So the
friction is 0, and costs are 1. Truths: ``over_sides`` with 6 and 12 parts a side, extrapolated, and that of slopes.
``classes``: land classes by slope and height with roads of one cell, whose cost is 0.1; and random costs. Errors
are relative to each distance, beyond 10 cells from the source.

Reliefs have 250 x 250 cells: matplotlib's sample ``jacksboro_fault_dem.npz``, and the nearly flat ``data/dem.tif`` of
github.com/mdbartos/pysheds, which is skipped unless the environment variable ``PLR_JAX_DEM`` names its folder. Both
have steps of 3 seconds of arc, so cells have the width and height, in meters, of the map's middle, or for ``classes``
sides of 1.
"""

import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import matplotlib.cbook
import numpy as np
from PIL import Image
from scipy import ndimage

from experiments import _raster_truths as truths
from experiments._measures import timed
from experiments._raster_truths import RADIUS, Cell, Pair, Raster
from experiments._runner import Section, run
from experiments.cost_distance import rasters, scikit_image, xarray_spatial
from plr_jax import cost_distance

SIDE, PARTS, NUM_PATHS = 250, 12, 200
SOURCE, SOURCES = (125, 60), [(60, 60), (190, 200)]

Rows = Iterator[dict[str, Any]]


def reliefs(smoke: bool) -> dict[str, tuple[Raster, Pair]]:
    """Return heights of reliefs, with the width and height of their cells, all in meters."""
    sample: Any = matplotlib.cbook.get_sample_data("jacksboro_fault_dem.npz")
    found = {"jacksboro": (sample["elevation"], 36.59)}
    if folder := os.environ.get("PLR_JAX_DEM"):
        found["pysheds"] = np.asarray(Image.open(Path(folder) / "dem.tif")), 32.67
    else:
        print("pysheds: skipped, PLR_JAX_DEM names no folder with dem.tif")
    side, step = (40 if smoke else SIDE), np.radians(3 / 3600) * RADIUS
    return {
        name: (heights[:side, :side].astype(float), (step * np.cos(np.radians(latitude)), step))
        for name, (heights, latitude) in found.items()
    }


def land(heights: Raster, side: Pair, num_roads: int = 0) -> Raster:
    """Return costs of a walker: classes of slope, wet lowlands, and roads of one cell in both directions."""
    slope = np.hypot(*np.gradient(heights, *side[::-1]))
    costs = np.array([1.0, 2.0, 5.0, 10.0])[np.digitize(slope, np.quantile(slope, [0.4, 0.7, 0.9]))]
    costs[heights <= np.quantile(heights, 0.08)] = 6.0
    for turned in (costs, costs.T):
        for road in range(num_roads):
            swing = 0.2 * np.sin(np.arange(turned.shape[1] + 1) / (20 + 5 * road) + road)
            winding = ((road + 0.5 + swing) / num_roads * turned.shape[0]).astype(int)
            for column, rows in enumerate(pairwise(winding)):
                turned[min(rows) : max(rows) + 1, column] = 0.1
    return costs


def _at(cells: list[Cell], side: Pair = (1.0, 1.0)) -> list[Pair]:
    return [((column + 0.5) * side[0], (row + 0.5) * side[1]) for row, column in cells]


def _errors(found: Raster, truth: Raster) -> dict[str, float]:
    error = np.abs(found - truth) / np.nanmean(truth)
    return {"mean": float(np.nanmean(error)), "largest": float(np.nanmax(error))}


def tobler(slope: np.ndarray) -> np.ndarray:
    return 3.6 / (6 * np.exp(-3.5 * np.abs(slope + 0.05)))


def _over_lattice(*case: Any, smoke: bool) -> tuple[Raster, float]:
    # The truth, and how far it is off: the difference that fewer neighbors make, and that which more nodes make.
    graphs = ((3, 2), (2, 2), (2, 4)) if smoke else ((7, 4), (5, 4), (5, 6))
    truth, coarse, fine = (truths.over_lattice(*case, reach=reach, finer=finer) for reach, finer in graphs)
    return truth, _errors(coarse, truth)["mean"] + _errors(fine, coarse)["mean"]


def slopes(seed: int, smoke: bool) -> Rows:
    source = (20, 10) if smoke else SOURCE
    for name, (heights, side) in reliefs(smoke).items():
        for kind, costs in {"one": np.ones_like(heights), "classes": land(heights, side)}.items():
            seconds, ours = timed(partial(cost_distance, costs, _at([source], side), cell_size=side, heights=heights))
            truth, off = _over_lattice(costs, heights, side, source, tobler, smoke=smoke)
            cost_of = partial(truths.cost_of_path, costs=costs, heights=heights, side=side, factor=tobler)
            cells = map(tuple, np.random.default_rng(seed).integers(0, costs.shape, (NUM_PATHS, 2)).tolist())
            path = [cost_of(ours.path(*_at([at], side))) / ours.distance[at] - 1 for at in cells if at != source]
            row = {"relief": name, "costs": kind, "cpu_seconds": seconds, **_errors(ours.distance, truth)}
            yield {**row, "path": float(np.abs(path).max()), "truth_off": off}


def _data_array(costs: Raster, west: float, south: float, step: float) -> Any:
    import rioxarray  # noqa: F401  # pyright: ignore[reportMissingImports]
    import xarray  # pyright: ignore[reportMissingImports]

    at = {"y": south + (np.arange(len(costs)) + 0.5) * step, "x": west + (np.arange(costs.shape[1]) + 0.5) * step}
    return xarray.DataArray(costs, dims=("y", "x"), coords=at).rio.write_crs("EPSG:4326")


CITIES = [(2.35, 48.85), (-157.85, 21.3), (139.7, 35.7), (-58.4, -34.6), (178.4, -18.1)]
EUROPE = (0.0, 35.0)  # the first corner, longitude and latitude, of the raster with costs and barriers


def degrees(seed: int, smoke: bool) -> Rows:
    # 1. Great circles that stay between the raster's first and last latitude.
    south, north = -60.0, 75.0
    low, high = np.sin(np.radians([south, north]))
    for step in (2.5,) if smoke else (0.5, 0.1):
        costs = _data_array(np.ones((round((north - south) / step), round(360 / step))), -180.0, south, step)
        seconds, ours = timed(partial(cost_distance, costs, CITIES))
        sine = np.sin(np.radians(costs.y.values[:, None]))
        lengths = np.stack([truths.great_circle(costs.x.values, costs.y.values[:, None], city) for city in CITIES])
        truth = lengths.min(axis=0)
        start, angle = np.sin(np.radians(CITIES))[lengths.argmin(axis=0), 1], truth / RADIUS
        within = angle > 0.5 * np.radians(step)  # cities may lie in the middle of a cell
        for t in np.linspace(0, 1, 17):  # the sine of the latitude along a great circle
            along = (np.sin((1 - t) * angle) * sine + np.sin(t * angle) * start) / np.sin(angle)
            within &= np.abs(along - (low + high) / 2) < (high - low) / 2
        error = np.abs(ours.distance.values - truth)[within] / truth[within]
        is_far = angle[within] > 20 * np.radians(step)
        row = {"raster": f"{step:g} degrees", "cpu_seconds": seconds, "mean": float(error.mean())}
        yield {**row, "largest_far": float(error[is_far].max()), "compared": float(within.mean())}
    # 2. Land classes, with barriers and without.
    shape, step, sources = ((30, 60), 1.0, [(10, 10)]) if smoke else ((300, 600), 0.1, [(80, 120), (220, 430)])
    rng = np.random.default_rng(seed)
    noise = [ndimage.gaussian_filter(rng.normal(size=shape), shape[0] / 30) for _ in range(2)]
    classes = np.array([1.0, 2.0, 4.0, 8.0])[np.digitize(noise[0] / noise[0].std(), [-0.5, 0.5, 1.2])]
    barred = np.where(noise[1] > 1.5 * noise[1].std(), np.nan, classes)
    for row, column in sources:
        barred[row - 2 : row + 3, column - 2 : column + 3] = 1.0
    points, finer = EUROPE + step * np.array(_at(sources)), (1, 1, 2) if smoke else (2, 4, 8)
    for name, costs in {"classes": classes, "classes and barriers": barred}.items():
        seconds, ours = timed(partial(cost_distance, _data_array(costs, *EUROPE, step), points))
        coarse, half, fine = (truths.marched_on_sphere(costs, EUROPE, step, sources, each) for each in finer)
        truth, off = 2 * fine - half, _errors(2 * half - coarse, 2 * fine - half)["mean"]
        yield {"raster": name, "cpu_seconds": seconds, **_errors(ours.distance.values, truth), "truth_off": off}


def grass(module: str, tables: dict[str, Raster], source: Cell, side: Pair = (1.0, 1.0)) -> tuple[float, Raster]:
    """Return the CPU seconds of a module of GRASS, with options, and the distances that it finds."""
    if shutil.which("grass") is None:
        raise ImportError("GRASS is not installed")
    (rows, columns), ((x, y),) = next(iter(tables.values())).shape, _at([source], side)
    region = f"n={rows * side[1]} s=0 e={columns * side[0]} w=0 rows={rows} cols={columns}"
    with tempfile.TemporaryDirectory() as folder:
        lines = ["set -e", "TIMEFORMAT='cpu %U %S'", f"g.region {region}"]
        for name, values in tables.items():  # the first row of a file is the north
            values[::-1].astype(np.float64).tofile(f"{folder}/{name}")
            lines += [f"r.in.bin -d input={folder}/{name} output={name} bytes=8 {region}"]
            module += f" {name}={name}"
        lines += [f"time {module} output=found start_coordinates={x},{y} --quiet"]
        lines += [f"r.out.bin -f input=found output={folder}/found bytes=8"]
        Path(folder, "script").write_text("\n".join(lines), encoding="ascii")
        command = ["grass", "--tmp-location", "XY", "--exec", "bash", f"{folder}/script"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise RuntimeError(done.stderr)
        words = next(line for line in done.stderr.splitlines() if line.startswith("cpu ")).split()
        return float(words[1]) + float(words[2]), np.fromfile(f"{folder}/found").reshape(rows, columns)[::-1]


def langmuir(slope: np.ndarray) -> np.ndarray:
    """Return the seconds per horizontal meter that ``r.walk`` takes by default."""
    return 0.72 + slope * np.where(slope >= 0, 6.0, np.where(slope < -0.2125, -1.9998, 1.9998))


TOOLS: dict[str, Callable[[Raster, Cell], tuple[float, Raster]]] = {
    "plr_jax": lambda costs, source: timed(lambda: cost_distance(costs, _at([source])).distance),
    "GRASS r.cost": lambda costs, source: grass("r.cost", {"input": costs}, source),
    "GRASS r.cost -k": lambda costs, source: grass("r.cost -k", {"input": costs}, source),
    "xarray-spatial": lambda costs, source: timed(lambda: xarray_spatial(costs, [source])),
    "scikit-image MCP_Geometric": lambda costs, source: timed(lambda: scikit_image(costs, [source])),
}


def _compared(raster: str, tools: dict[str, Callable[..., Any]], truth: Raster, off: float) -> Rows:
    for tool, call in tools.items():
        try:
            call()  # some compile
            seconds, found = call()
        except ImportError as error:
            print(f"{tool}: skipped, {error}")
            continue
        yield {"raster": raster, "tool": tool, "cpu_seconds": seconds, **_errors(found, truth), "truth_off": off}


def rivals(seed: int, smoke: bool) -> Rows:
    for name in ("smooth",) if smoke else ("smooth", "classes", "road"):
        costs, source = rasters(seed)[name], (200, 57)
        tools = {tool: partial(call, costs, source) for tool, call in TOOLS.items()}
        yield from _compared(name, tools, *_over_sides(costs, [source], smoke)[:2])
    for name, (heights, side) in reliefs(smoke).items():
        costs, source = np.ones_like(heights), (20, 10) if smoke else SOURCE
        tables, options = {"elevation": heights, "friction": 0 * costs}, {"cell_size": side, "heights": heights}
        ours = partial(cost_distance, costs, _at([source], side), slope_cost=langmuir, from_sources=True, **options)
        tools = {
            "plr_jax": lambda ours=ours: timed(lambda: ours().distance),
            "GRASS r.walk": partial(grass, "r.walk", tables, source, side),
            "GRASS r.walk -k": partial(grass, "r.walk -k", tables, source, side),
        }
        case = costs, heights, side, source, lambda slope: langmuir(-slope)
        yield from _compared(f"slopes of {name}", tools, *_over_lattice(*case, smoke=smoke))


def _over_sides(costs: Raster, sources: list[Cell], smoke: bool) -> tuple[Raster, float, Raster]:
    # The truth, extrapolated; its mean distance from what half as many parts of sides give; and costs of paths.
    parts = 2 if smoke else PARTS
    coarse, half, fine = (truths.over_sides(costs, sources, count) for count in (parts // 4 or 1, parts // 2, parts))
    truth = fine + (fine - half) / 3
    return truth, _errors((4 * half - coarse) / 3, truth)["mean"], fine


def classes(seed: int, smoke: bool) -> Rows:
    tables = {name: land(heights, side, num_roads=4) for name, (heights, side) in reliefs(smoke).items()}
    side, sources = (40, [(10, 10)]) if smoke else (SIDE, SOURCES)
    tables["random"] = np.random.default_rng(seed).choice([1.0, 2.0, 5.0, 15.0], (side, side))
    for name, costs in tables.items():
        seconds, ours = timed(partial(cost_distance, costs, _at(sources)))
        bounded = cost_distance(costs, _at(sources), bounds=True)
        truth, off, of_paths = _over_sides(costs, sources, smoke)
        is_far = np.all([np.hypot(*(np.indices(costs.shape).T - at).T) > 10 for at in sources], axis=0)
        excess = ours.distance[is_far] / truth[is_far] - 1
        row = {"costs": name, "cpu_seconds": seconds, "mean": float(excess.mean()), "largest": float(excess.max())}
        gap = float((bounded.upper - bounded.lower).mean() / ours.distance.mean())
        broken = int((bounded.lower > of_paths * (1 + 1e-9)).sum())
        yield {**row, "gap": gap, "broken": broken, "truth_off": off}


def _printed(measure: Callable[[int, bool], Rows], seed: int, smoke: bool) -> dict[str, Any]:
    rows = []
    for row in measure(seed, smoke):
        print(row, flush=True)
        rows.append(row)
    return {"rows": rows}


SECTIONS = {each.__name__: Section(partial(_printed, each)) for each in (slopes, degrees, rivals, classes)}

if __name__ == "__main__":
    run("rasters", __doc__, SECTIONS)
