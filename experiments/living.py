"""Maps that change: oracles kept up to date, and oracles and certified cones built anew.

``maps``: 100 changes, one after the other, of each map. About half of them take an earlier box away, 35 % set a box
of 1 to 3 % of the width down at a random free place, 15 % close a doorway (a box across free space between two walls,
where that is narrowest of several places). Told are medians of the CPU seconds of all cores that the changed map and
its oracle take, and of an oracle and cones that are built anew every tenth time. The error is the mean error of the
last cones at random free points, a tenth of them around what has changed since the cones before, as a share of the
mean distance.

``rivals``: boxes of cells of den520d that are blocked and freed, one after the other, beside the grid searches that
repair what they found, for one start, and scikit-fmm, which marches again. Our time is that of the oracle; the change
of the workspace before it is not in it.

``doors``: three doorways of the floor plan close and open, one after the other: a film of cones of 2 KB and paths.
"""

import io
from base64 import b64decode, b64encode
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from jaxtyping import Float
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from experiments._measures import relative_error, timed
from experiments._runner import Section, run
from experiments.baselines.incremental import incremental_planners, replanned
from experiments.benchmarks._maps import load_map, load_maps
from plr_jax import PLR, VisibilityGraph, Workspace, construct, from_bytes, plot, trace

MAPS, BYTES = ("floor_plan", "arena", "den520d"), 8_192
CHANGES, EVERY, POINTS, BOXES = 100, 10, 1_000_000, 20
_TRIED = 40  # places of a doorway

Points = Float[np.ndarray, "n 2"]


def maps(seed: int, smoke: bool) -> dict[str, Any]:
    found = load_maps(MAPS[:1] if smoke else MAPS)
    return {"bytes": BYTES, "rows": [_changed(name, *each, seed, smoke) for name, each in found.items()]}


def _changed(name: str, workspace: Workspace, goal: Points, seed: int, smoke: bool) -> dict[str, Any]:
    rng, num_bytes = np.random.default_rng(seed), 1_024 if smoke else BYTES
    oracle = VisibilityGraph(workspace, goal)
    made: list[int] = []
    seconds: dict[str, list[float]] = {"workspace": [], "oracle": [], "anew": []}
    around, error = [], np.nan
    for step in range(1, (2 if smoke else CHANGES) + 1):
        change = _change(rng, oracle, made)
        around += change.get("add", [workspace.obstacles[i] for i in change.get("remove", ())])
        before, first = oracle, len(workspace.obstacles)
        took, workspace = timed(lambda change=change, workspace=workspace: workspace.with_obstacles(**change))
        seconds["workspace"].append(took)
        took, oracle = timed(lambda before=before, workspace=workspace: before.with_workspace(workspace))
        seconds["oracle"].append(took)
        made = [i for i in made if i not in change.get("remove", ())] + list(range(first, len(workspace.obstacles)))
        if step % (1 if smoke else EVERY) == 0:
            took, (truth, plr) = timed(lambda workspace=workspace: _anew(workspace, goal, num_bytes))
            seconds["anew"].append(took)
            x = _points(rng, workspace, around, 1_000 if smoke else POINTS)
            distance = truth(x)
            x, distance = x[np.isfinite(distance)], distance[np.isfinite(distance)]
            error, around = relative_error(np.asarray(plr(x), float), distance), []
    medians = {f"ms of the {key}": 1e3 * float(np.median(each)) for key, each in seconds.items() if key != "anew"}
    return {
        "map": name,
        "vertices": len(workspace.boundary.vertices),
        "changes": len(seconds["oracle"]),
        **medians,
        "ms anew": 1e3 * float(np.median(seconds["anew"])),
        "error, built anew": error,
    }


def _anew(workspace: Workspace, goal: Points, num_bytes: int) -> tuple[VisibilityGraph, PLR]:
    """An oracle, of the obstacles alone, and cones of it."""
    oracle = VisibilityGraph(Workspace(workspace.bounds, workspace.obstacles, squeeze=workspace.squeeze), goal)
    return oracle, construct(oracle, workspace.bounds, leaf="cone", max_bytes=num_bytes, certified=True)


def _change(rng: np.random.Generator, oracle: VisibilityGraph, made: list[int]) -> dict[str, Any]:
    """A box set down or taken away, or a doorway closed."""
    kind, goal = rng.random(), shapely.Point(oracle.goal)
    if made and kind < 0.5:
        return {"remove": [int(rng.choice(made))]}
    while True:
        box = _doorway(rng, oracle.workspace) if kind > 0.85 else _box(rng, oracle.workspace)
        if not box.intersects(goal):
            return {"add": [box]}


def _box(rng: np.random.Generator, workspace: Workspace) -> shapely.Polygon:
    center = workspace.sample_free(1, int(rng.integers(2**31)))[0]
    half = workspace.bounds.width.max() * rng.uniform(0.01, 0.03, 2) / 2
    return shapely.box(*(center - half), *(center + half))


def _doorway(rng: np.random.Generator, workspace: Workspace, tried: int = _TRIED) -> shapely.Polygon:
    """A box that reaches from wall to wall, at the narrowest of some places."""
    center = workspace.sample_free(tried, int(rng.integers(2**31)))
    reach, thin, lines = workspace.bounds.width.max(), 0.002 * workspace.bounds.width.max(), []
    for axis in range(2):
        step = reach * np.eye(2)[axis]
        across: Any = shapely.linestrings(np.stack([center - step, center + step], axis=1))
        parts = shapely.intersection(across, workspace.free_space)
        lines += [
            next(part for part in shapely.get_parts(each) if part.dwithin(shapely.Point(at), 1e-6 * reach))
            for each, at in zip(parts, center, strict=True)
        ]
    narrowest = min(lines, key=lambda line: line.length)
    (x0, y0), (x1, y1) = np.array(narrowest.bounds).reshape(2, 2) + thin * np.array([[-1], [1]])
    return shapely.box(x0, y0, x1, y1)


def _points(rng: np.random.Generator, workspace: Workspace, around: list[Any], num: int) -> Points:
    """Random free points, a tenth of them around polygons."""
    x = [workspace.sample_free(num - num // 10, int(rng.integers(2**31)))]
    for polygon in around:
        lo, hi = np.array(polygon.bounds).reshape(2, 2)
        near = lo - 0.5 * (hi - lo) + 2 * (hi - lo) * rng.random((num // (10 * len(around)), 2))
        x.append(near[workspace.is_free(near)])
    return np.concatenate(x)


RIVALS_MAP, LONGEST = "den520d", 0.03


def rivals(seed: int, smoke: bool) -> dict[str, Any]:
    import skfmm

    found = load_map(RIVALS_MAP)
    if found is None:
        return {"rows": []}
    (workspace, at), rng, num_bytes = found, np.random.default_rng(seed), 1_024 if smoke else BYTES
    shape, lo = workspace.bounds.width.astype(int)[::-1], workspace.bounds.lo
    center = lo + np.argwhere(np.ones(shape))[:, ::-1] + 0.5
    free = workspace.is_free(center).reshape(shape)
    goal = np.floor(at - lo).astype(int)
    oracle = VisibilityGraph(workspace, lo + goal + 0.5)
    reach = np.argwhere(free & np.isfinite(oracle(center)).reshape(shape))
    start = rng.choice(reach)[::-1]
    planners = incremental_planners(free, tuple(start), tuple(goal))
    for planner in planners.values():
        planner.plan()
    names = ("with_workspace", "built anew", *planners, "scikit-fmm")
    seconds, errors = ({name: [] for name in names} for _ in range(2))
    made: list[Any] = []
    for step in range(2 if smoke else BOXES):
        blocked = step % 2 == 0
        if blocked:
            made.append(_free_cells(rng, free, np.stack([start, goal])))
        cells = made[-1]
        free[cells[:, 1], cells[:, 0]] = not blocked
        box = shapely.box(*(lo + cells.min(axis=0)), *(lo + cells.max(axis=0) + 1))
        change = {"add": [box]} if blocked else {"remove": [len(workspace.obstacles) - 1]}
        workspace, before = workspace.with_obstacles(**change), oracle
        took, oracle = timed(lambda before=before, workspace=workspace: before.with_workspace(workspace))
        seconds["with_workspace"].append(took)
        took, (_, plr) = timed(lambda workspace=workspace: _anew(workspace, lo + goal + 0.5, num_bytes))
        seconds["built anew"].append(took)
        x = center[free.ravel()]
        truth = oracle(x)
        x, truth = x[np.isfinite(truth)], truth[np.isfinite(truth)]
        length = float(oracle(lo + start[None] + 0.5)[0])
        for name, planner in planners.items():
            took, cost = timed(partial(replanned, planner, cells, blocked=blocked))
            seconds[name].append(took)
            errors[name].append(abs(cost - length) / length)
        away = np.linalg.norm(center - lo - goal - 0.5, axis=1).reshape(shape)
        took, field = timed(lambda away=away: skfmm.distance(np.ma.MaskedArray(away - 2, ~free)))
        seconds["scikit-fmm"].append(took)
        marched = np.ma.filled(field + 2, np.nan)[*np.floor(x - lo).astype(int).T[::-1]]
        for name, values in (("built anew", plr(x)), ("scikit-fmm", marched)):
            errors[name].append(float(np.nanmean(np.abs(np.asarray(values, float) - truth)) / truth.mean()))
    told = {
        "with_workspace": "any point, exact",
        "LPA*": "one path",
        "D* Lite": "one path",
        "scikit-fmm": "all cells",
    }
    rows = []
    for name in names:
        error = float(np.mean(errors[name])) if errors[name] else 0.0
        ms = 1e3 * float(np.median(seconds[name]))
        rows.append({"by": name, "answers": told.get(name, "any point, proven"), "ms": ms, "mean error": error})
    return {"map": RIVALS_MAP, "rows": rows}


def _free_cells(rng: np.random.Generator, free: Any, others: Any) -> Any:
    """All cells of a box of 1 to 3 % of the width, all free, none of which is another."""
    while True:
        size = rng.integers(int(0.01 * free.shape[1]) + 1, int(LONGEST * free.shape[1]) + 1, 2)
        corner = rng.integers(0, np.array(free.shape)[::-1] - size)
        cells = corner + np.argwhere(np.ones(size))
        if free[cells[:, 1], cells[:, 0]].all() and not (cells[:, None] == others).all(axis=2).any():
            return cells


DOORS, DOORWAYS, FILM_BYTES, STARTS = 3, 60, 2_048, 5
_SECONDS_A_PICTURE, _DPI = 1.6, 72


def doors(seed: int, smoke: bool) -> dict[str, Any]:
    workspace, goal = load_maps(("floor_plan",))["floor_plan"]
    oracle, num_bytes = VisibilityGraph(workspace, goal), 512 if smoke else FILM_BYTES
    starts, num_doors = workspace.sample_free(STARTS, seed), 1 if smoke else DOORS
    boxes = _telling_doors(np.random.default_rng(seed), oracle, num_doors)
    first, pictures = len(workspace.obstacles), []
    closed = range(num_doors)
    changes = [{"add": [box]} for box in boxes] + [{"remove": [first + i]} for i in closed]
    words = ["all doors open", *(f"door {i + 1} closes" for i in closed), *(f"door {i + 1} opens" for i in closed)]
    for word, change in zip(words, [None, *changes], strict=True):
        if change is not None:
            workspace = workspace.with_obstacles(**change)
            oracle = oracle.with_workspace(workspace)
        plr = construct(oracle, workspace.bounds, leaf="cone", max_bytes=num_bytes, certified=True)
        reached = starts[np.isfinite(oracle(starts))]
        pictures.append(
            {
                "word": word,
                "closed": [
                    i
                    for i in closed
                    if i + first < len(workspace.obstacles) and not workspace.obstacles[i + first].is_empty
                ],
                "plr": b64encode(plr.to_bytes()).decode("ascii"),
                "paths": [np.round(path, 3).tolist() for path in trace(plr, reached).paths],
            }
        )
    return {"boxes": [list(box.bounds) for box in boxes], "goal": list(map(float, goal)), "pictures": pictures}


def _telling_doors(rng: np.random.Generator, oracle: VisibilityGraph, num: int) -> list[shapely.Polygon]:
    """Of some doorways, those far from one another that make the most difference when they close."""
    workspace, far = oracle.workspace, 0.1 * oracle.workspace.bounds.width.max()
    x = workspace.sample_free(500, 0)
    before, boxes = oracle(x), [_doorway(rng, workspace, tried=4) for _ in range(DOORWAYS)]
    longer = [np.minimum(oracle.with_workspace(workspace.with_obstacles([box]))(x), far + before) for box in boxes]
    chosen: list[shapely.Polygon] = []
    for i in np.argsort([-each.mean() for each in longer]):
        if not any(boxes[i].dwithin(other, far) for other in (*chosen, shapely.Point(oracle.goal))):
            chosen.append(boxes[i])
    return chosen[:num]


def draw_doors(results: dict[str, Any], output: Path) -> list[Path]:
    workspace, _ = load_maps(("floor_plan",))["floor_plan"]
    boxes, frames = [shapely.box(*bounds) for bounds in results["boxes"]], []
    for picture in results["pictures"]:
        figure = Figure(figsize=(7.2, 4.2), dpi=_DPI, layout="constrained", facecolor="white")
        ax, there = figure.subplots(), workspace.with_obstacles([boxes[i] for i in picture["closed"]])
        plr = from_bytes(b64decode(picture["plr"]))
        plot.plot_contours(plr, ax, workspace=there, goal=results["goal"], resolution=500)
        for i in picture["closed"]:
            ax.fill(*boxes[i].exterior.xy, color="#d1495b", linewidth=2, zorder=4)
        for path in picture["paths"]:
            ax.plot(*np.array(path).T, color="white", linewidth=3, zorder=4)
            ax.plot(*np.array(path).T, color="#d1495b", linewidth=1.6, zorder=4)
        ax.set_title(picture["word"], fontsize=11)
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
        frames.append(Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3]).quantize(64))
    data, path = io.BytesIO(), output / "living_doors.gif"
    delay = int(1000 * _SECONDS_A_PICTURE)
    frames[0].save(data, "GIF", save_all=True, append_images=frames[1:], duration=delay, loop=0)
    path.write_bytes(data.getvalue())
    return [path]


SECTIONS = {
    "maps": Section(maps),
    "rivals": Section(rivals),
    "doors": Section(doors, draw_doors),
}

if __name__ == "__main__":
    run("living", __doc__, SECTIONS)
