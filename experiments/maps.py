"""Maps that are pictures: from a scan to a file, and how near polygons are to the pixels that they are made of.

Both are drawn by seed: rooms in a grid, doors, furniture at any angle; the scan has salt and pepper on it. Files are
built by the command line, in a process of its own, imports included. Outlines are compared with those of the pixels,
both ways, and the middle of each passage of two pixels with what is left of it.
"""

import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from PIL import Image, ImageDraw

from experiments._runner import run
from plr_jax import VisibilityGraph, Workspace, load, scenes

SCAN, SCAN_ROOMS, NOISE = (2000, 1500), (10, 7), 0.0005
PLAN, PLAN_ROOMS = (200, 150), (4, 3)
SMOKE_SCAN, SMOKE_ROOMS = (200, 150), (3, 2)
MAX_BYTES, NUM_RUNS = 4096, 3
_FINER = 2  # times finer than its pixels a picture is drawn


def compute(seed: int, smoke: bool) -> dict[str, Any]:
    num_runs = 1 if smoke else NUM_RUNS
    with tempfile.TemporaryDirectory() as folder:
        rows = []
        for name, size, rooms, noise in (
            ("scan", *((SMOKE_SCAN, SMOKE_ROOMS) if smoke else (SCAN, SCAN_ROOMS)), NOISE),
            ("plan", PLAN, PLAN_ROOMS, 0.0),
        ):
            path = Path(folder, f"{name}.png")
            Image.fromarray(salted(drawn(size, rooms, seed), noise, seed)).save(path)
            rows.append({"map": name, "pixels": list(size), **of_picture(path, num_runs, seed)})
    return {"runs": num_runs, "max_bytes": MAX_BYTES, "noise": NOISE, "rows": rows}


def drawn(size: tuple[int, int], rooms: tuple[int, int], seed: int) -> np.ndarray:
    """A furnished plan in gray, white where free: every room has a door to the next one in its row, and row."""
    rng, width, height = np.random.default_rng(seed), size[0] * _FINER, size[1] * _FINER
    picture = Image.new("L", (width, height), 255)
    pen = ImageDraw.Draw(picture)
    room = np.array([width / rooms[0], height / rooms[1]])
    wall, door = 0.03 * room.min(), 0.18 * room.min()
    for axis in range(2):
        for i in range(rooms[axis] + 1):
            _rectangle(pen, axis, i * room[axis], wall, 0, (width, height)[1 - axis], 0)
            for j in range(rooms[1 - axis] if 0 < i < rooms[axis] else 0):
                middle = (j + rng.uniform(0.25, 0.75)) * room[1 - axis]
                _rectangle(pen, axis, i * room[axis], 2 * wall, middle - door / 2, middle + door / 2, 255)
    for i, j in np.ndindex(*rooms):
        for _ in range(rng.integers(2, 6)):
            center, half = (
                (np.array([i, j]) + rng.uniform(0.3, 0.7, 2)) * room,
                rng.uniform(0.04, 0.14, 2) * room.min(),
            )
            turn = rng.choice([0.0, rng.uniform(0, np.pi)])
            corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * half
            corners = center + corners @ [[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]
            pen.polygon([tuple(corner) for corner in corners.tolist()], fill=0)
    return np.asarray(picture.resize(size, Image.Resampling.BOX))


def _rectangle(pen: Any, axis: int, at: float, width: float, begin: float, end: float, gray: int) -> None:
    """A wall across an axis, or a door in it."""
    corners = np.array([(at - width, begin), (at + width, end)])
    pen.rectangle([tuple(corner) for corner in (corners if axis == 0 else corners[:, ::-1]).tolist()], fill=gray)


def salted(gray: np.ndarray, share: float, seed: int) -> np.ndarray:
    """A picture with some of its pixels black or white."""
    rng = np.random.default_rng(seed)
    hit, white = rng.random(gray.shape) < share, rng.random(gray.shape) < 0.5
    return np.where(hit, np.where(white, 255, 0), gray).astype(np.uint8)


def of_picture(path: Path, num_runs: int, seed: int) -> dict[str, Any]:
    """What reading a picture takes and gives, and building a file of it from the command line."""
    seconds = []
    for _ in range(num_runs):
        began = time.perf_counter()
        workspace = scenes.read_image(path)
        seconds.append(time.perf_counter() - began)
    goal = workspace.sample_free(100, seed)
    goal = goal[np.argmax(workspace.clearance(goal))]
    plane, best = built(path, goal, ["--leaf", "plane"]), built(path, goal, [])
    oracle, plr = VisibilityGraph(workspace, goal), load(path.with_suffix(".plr"))
    x = workspace.sample_free(20_000, seed + 1)
    distance = oracle(x)
    reached = np.isfinite(distance)
    free = np.asarray(Image.open(path))[::-1] > 127
    return {
        "vertices": len(workspace.boundary.vertices),
        "seconds_read": float(np.median(seconds)),
        "best": best,
        "plane": plane,
        "bytes": plr.num_bytes,
        "mean_error": float(np.abs(np.asarray(plr(x)) - distance)[reached].mean()),
        "mean_distance": float(distance[reached].mean()),
        **beside_pixels(free, workspace),
    }


def built(path: Path, goal: np.ndarray, options: list[str]) -> dict[str, float]:
    """Seconds of a command, by the clock and of all processors, from its start to its end."""
    target = ["--goal", ",".join(map(str, goal.tolist())), "--max-bytes", str(MAX_BYTES), "-o"]
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    command = [sys.executable, "-m", "plr_jax", "build", str(path), *target, str(path.with_suffix(".plr")), *options]
    subprocess.run(command, check=True, capture_output=True, env=os.environ)
    seconds, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return {"seconds": seconds, "cpu_seconds": cpu}


def beside_pixels(free: np.ndarray, workspace: Workspace) -> dict[str, Any]:
    """How far the outline is from that of the pixels, both ways, and how many passages of two pixels closed."""
    exact = Workspace.from_mask(free, tolerance=0)
    lines = (
        shapely.segmentize(exact.free_space.boundary, 0.25),
        shapely.segmentize(workspace.free_space.boundary, 0.25),
    )
    points = [shapely.points(shapely.get_coordinates(each)) for each in lines]
    trees = [each.edge_tree for each in (exact, workspace)]
    away = [trees[1 - i].query_nearest(points[i], return_distance=True, all_matches=False)[1].max() for i in range(2)]
    wide = free[:-1, :-1] & free[1:, :-1] & free[:-1, 1:] & free[1:, 1:]  # two by two, by their lower left
    row, column = np.nonzero(wide)
    center = np.stack([column, row], axis=1) + 1.0
    closed = 0
    for step in ((0, 1), (1, 0)):
        onward = np.zeros_like(wide)
        onward[: wide.shape[0] - step[0], : wide.shape[1] - step[1]] = wide[step[0] :, step[1] :]
        begin = center[onward[row, column]]
        closed += int((~workspace.is_visible(begin, begin + np.array(step[::-1], float))).sum())
    return {"hausdorff": float(max(away)), "closed_passages": closed, "passages": len(center)}


if __name__ == "__main__":
    run("maps", "Seconds from a picture to a file, and how near its polygons are to its pixels.", compute)
