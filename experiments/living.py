"""Maps that change: oracles kept up to date, and oracles and certified cones built anew.

``rivals``: boxes of cells of den520d that are blocked and freed, one after the other, beside the grid searches that
repair what they found, for one start, and scikit-fmm, which marches again. Seconds are CPU seconds. Ours are those of
the changed oracle, without the change of the workspace before it, and of an oracle and certified cones built anew.

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

from experiments._measures import timed
from experiments._runner import Section, run
from experiments.baselines.incremental import incremental_planners, replanned
from experiments.benchmarks._maps import load_map, load_maps
from plr_jax import PLR, VisibilityGraph, Workspace, construct, from_bytes, plot, trace

BYTES, BOXES = 8_192, 20

Points = Float[np.ndarray, "n 2"]


def _anew(workspace: Workspace, goal: Points, num_bytes: int) -> tuple[VisibilityGraph, PLR]:
    """An oracle, of the obstacles alone, and cones of it."""
    oracle = VisibilityGraph(Workspace(workspace.bounds, workspace.obstacles, squeeze=workspace.squeeze), goal)
    return oracle, construct(oracle, workspace.bounds, leaf="cone", max_bytes=num_bytes, certified=True)


def _doorway(rng: np.random.Generator, workspace: Workspace, tried: int) -> shapely.Polygon:
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
    "rivals": Section(rivals),
    "doors": Section(doors, draw_doors),
}

if __name__ == "__main__":
    run("living", __doc__, SECTIONS)
