"""Walks along the raw gradient alone: what a field gives without lookahead."""

import dataclasses
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import shapely
from jaxtyping import Array, Bool, Float
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from experiments._runner import run
from experiments.benchmarks._maps import load_maps
from plr_jax import (
    PLR,
    Descent,
    VisibilityGraph,
    Workspace,
    construct,
    descend,
    metrics,
    plot,
)

STEPS_ACROSS = 500  # the longer side of the domain is so many steps long
LONGEST = 4  # times the exact distance, after which a walk is given up
_GRAZE = 0.1  # of a step, by which a walk may cut a corner: steps that turn beside one do not end on it exactly
_STEPS_AT_ONCE = 64  # before those that have ended are left out
_WALKING, _REACHED, _LEFT = range(3)

Directions = Callable[[Any], Any]


def measure_walks(
    directions: Directions,
    workspace: Workspace,
    starts: Float[np.ndarray, "n 2"],
    goal: Float[np.ndarray, "2"],
    distance: Float[np.ndarray, "n"],
) -> dict[str, Any]:
    """Shares of the starts whose walk reaches the goal, leaves free space, or runs out of steps.

    Args:
        directions: The way to go from points ``(n, 2)``; only its direction matters, and where it is zero or not
            finite, a walk stays.
        workspace: The free space.
        starts: Where the walks begin, all at once.
        goal: Where they end, once it is within a step.
        distance: The exact distance of the starts.
    """
    step = float(workspace.bounds.width.max()) / STEPS_ACROSS
    walls, target = _walls(workspace, _GRAZE * step), jnp.asarray(goal, jnp.float32)
    most = np.where(np.isfinite(distance), LONGEST * distance / step, 0.0)
    x, status, taken = np.array(starts, np.float32), np.full(len(starts), _WALKING), np.zeros(len(starts))
    count = 0
    while len(pending := np.flatnonzero((status == _WALKING) & (count < most))):
        rows = np.resize(pending, 1 << (len(pending) - 1).bit_length())  # padded: few sizes are compiled
        now, state, steps = jnp.asarray(x[rows]), jnp.full(len(rows), _WALKING), jnp.zeros(len(rows))
        for _ in range(_STEPS_AT_ONCE):
            now, state, steps = _advance(now, directions(now), state, steps, walls, target, step)
        x[rows], status[rows] = now, state
        taken[rows] += np.asarray(steps)
        count += _STEPS_AT_ONCE
    reached = (status == _REACHED) & (taken <= most)
    left = (status == _LEFT) & (taken <= most)
    ratio = (taken * step)[reached] / distance[reached]
    return {
        "reached": float(reached.mean()),
        "left_free_space": float(left.mean()),
        "out_of_steps": float(1 - reached.mean() - left.mean()),
        "median_ratio": float(np.median(ratio)) if reached.any() else None,
    }


def downhill(field: Callable[[Any], Any]) -> Directions:
    """The negative gradient of a field, compiled."""
    return jax.jit(lambda x: -jax.grad(lambda x: field(x).sum())(x))


@partial(jax.jit, static_argnames="step")
def _advance(
    x: Float[Array, "n 2"],
    direction: Float[Array, "n 2"],
    state: Any,
    steps: Float[Array, "n"],
    walls: Float[Array, "edges 2 2"],
    goal: Float[Array, "2"],
    step: float,
) -> tuple[Any, Any, Any]:
    """One step of every walk, or the whole way to the goal within a step."""
    direction = jnp.asarray(direction, x.dtype)
    size = jnp.linalg.norm(direction, axis=1, keepdims=True)
    moves = jnp.isfinite(size) & (size > 0)
    unit = jnp.where(moves, direction, 0.0) / jnp.where(moves, size, 1.0)
    near = jnp.linalg.norm(goal - x, axis=1) <= step
    there = jnp.where(near[:, None], goal, x + step * unit)
    after = jnp.where(_crosses(x, there, walls), _LEFT, jnp.where(near, _REACHED, _WALKING))
    walking = state == _WALKING
    return (
        jnp.where(walking[:, None], there, x),
        jnp.where(walking, after, state),
        steps + walking,
    )


def _crosses(a: Float[Array, "n 2"], b: Float[Array, "n 2"], walls: Float[Array, "edges 2 2"]) -> Bool[Array, "n"]:
    """Whether each segment crosses an edge."""
    c, d = walls[:, 0], walls[:, 1]

    def side(p: Any, q: Any, r: Any) -> Any:
        (px, py), (qx, qy), (rx, ry) = (jnp.moveaxis(each, -1, 0) for each in (p, q, r))
        return (qx - px) * (ry - py) > (qy - py) * (rx - px)

    a, b = a[:, None], b[:, None]
    return ((side(a, b, c) != side(a, b, d)) & (side(c, d, a) != side(c, d, b))).any(axis=1)


def _walls(workspace: Workspace, graze: float) -> Float[Array, "edges 2 2"]:
    """The edges around free space, moved outward a little."""
    grown = shapely.buffer(workspace.free_space, graze, join_style="mitre")
    rings = [ring for part in np.atleast_1d(shapely.get_parts(grown)) for ring in (part.exterior, *part.interiors)]
    edges = [np.stack([points[:-1], points[1:]], axis=1) for points in map(shapely.get_coordinates, rings)]
    return jnp.asarray(np.concatenate(edges), jnp.float32)


# Paths extracted from PLRs, and where their gradients point.
#
# On each map, at each size: descent from random free starts (how many reach the goal, whether a leg crosses a wall by
# an independent check, how much longer paths are than the shortest, seconds), and the gradient report. A field that
# is zero everywhere shows what descent does without one.

START_SEED = 1_000
SIZES = {"maze": [2_048, 6_144], "thin_maze": [2_048, 6_144], "arena": [6_144, 16_384], "den312d": [6_144]}
"""Bytes of the PLRs of each map; the last is drawn."""
_LEAVES = ("plane", "continuous", "smooth")
DRAWN = ("maze", "arena")
NUM_DRAWN = 40
POINTS_A_LEAF = 4
NUM_ARROWS = 28
_PATH_COLOR = "#D55E00"
_ARROW_COLOR = "#0072B2"


def compute(seed: int, smoke: bool) -> dict[str, Any]:
    num_starts, num_points, num_runs = (10, 200, 1) if smoke else (10_000, 100_000, 15)
    sizes = {"maze": [512]} if smoke else SIZES
    results = []
    for name, (workspace, goal) in load_maps(sizes).items():
        exact = VisibilityGraph(workspace, goal)
        starts = workspace.sample_free(num_starts, START_SEED + seed)
        x = workspace.sample_free(num_points, 2 * START_SEED + seed)
        distance = exact(starts)
        blind = _measure_descent(lambda x: np.zeros(len(x)), workspace, starts, goal, distance, num_runs)
        few = slice(num_starts // 10)  # the oracle is slow
        walked = measure_walks(exact.directions, workspace, starts[few], goal, distance[few])
        rows, plr = [], None
        for max_bytes in sizes[name]:
            for leaf in _LEAVES[::2] if smoke else _LEAVES:
                field = construct(exact, workspace.bounds, leaf=leaf, max_bytes=max_bytes, seed=seed)
                row = _measure_descent(field, workspace, starts, goal, distance, num_runs)
                row["walks"] = measure_walks(downhill(field), workspace, starts, goal, distance)
                row["gradient"] = _gradient(field, exact, x)
                row["finite_differences"] = _worst_finite_difference(field)
                if leaf == "plane":
                    plr = field
                rows.append({"budget": max_bytes, "leaf": leaf, "bytes": field.num_bytes, **row})
        assert plr is not None
        entry = {"map": name, "corners": len(exact.graph.vertices) - 1, "without_field": blind}
        entry |= {"exact_directions": {"starts": len(starts[few]), "walks": walked}, "rows": rows}
        results.append({**entry, "picture": _picture(plr, workspace, goal, starts) if name in DRAWN else None})
    return {"starts": num_starts, "points": num_points, "maps": results}


def _measure_descent(
    field: Callable,
    workspace: Workspace,
    starts: Float[np.ndarray, "n 2"],
    goal: Float[np.ndarray, "2"],
    distance: Float[np.ndarray, "n"],
    num_runs: int,
) -> dict[str, Any]:
    descent = descend(field, workspace, starts, goal)  # compiles the field's query
    seconds = []
    for _ in range(num_runs):
        begin = time.perf_counter()
        descend(field, workspace, starts, goal)
        seconds.append(time.perf_counter() - begin)
    ratio = descent.lengths[descent.reached] / distance[descent.reached]
    return {
        "reached": float(descent.reached.mean()),
        "crossings": _count_crossings(descent, workspace),
        "ratio": {
            "median": float(np.median(ratio)),
            "99 %": float(np.quantile(ratio, 0.99)),
            "max": float(ratio.max()),
        },
        "seconds": {"median": float(np.median(seconds)), "min": min(seconds)},
    }


def _count_crossings(descent: Descent, workspace: Workspace) -> int:
    """Paths that go through an obstacle or leave the bounds, rounding aside: by Shapely, from the obstacles."""
    obstacles = shapely.union_all(workspace.obstacles)
    region = shapely.box(*workspace.bounds.lo, *workspace.bounds.hi)
    blocked = shapely.union_all([obstacles, shapely.buffer(region, 1.0, join_style="mitre").difference(region)])
    core = shapely.buffer(blocked, -2 * workspace.tolerance, join_style="mitre")
    shapely.prepare(core)
    rows = np.flatnonzero(descent.counts > 1)
    paths: Any = shapely.linestrings(descent.vertices[rows])
    return int(shapely.intersects(core, paths).sum())


def _gradient(plr: PLR, exact: VisibilityGraph, x: Float[np.ndarray, "n 2"]) -> dict[str, Any]:
    report = metrics.gradient_report(
        plr,
        exact.directions,
        exact.workspace,
        exact.goal,
        x,
        reaches=lambda x: descend(plr, exact.workspace, x, exact.goal).reached,
    )
    return dataclasses.asdict(report)


def _worst_finite_difference(plr: PLR) -> float:
    """Largest relative difference of the gradient to central differences in 64 bits, at random points in all leaves.

    Where both are zero, as beside leaves that have no way to the goal, there is nothing to compare.
    """
    lo, hi = plr.leaf_boxes
    share = np.random.default_rng(START_SEED).uniform(0.1, 0.9, (POINTS_A_LEAF, *lo.shape))
    step = np.broadcast_to(1e-5 * (hi - lo), share.shape)
    with jax.enable_x64(True):
        x = jnp.asarray(lo + share * (hi - lo))
        gradient = np.asarray(jax.grad(lambda x: plr(x).sum())(x))
        difference = np.empty_like(gradient)
        for axis in range(2):
            offset = jnp.asarray(step * np.eye(2)[axis])
            difference[..., axis] = np.asarray(plr(x + offset) - plr(x - offset)) / (2 * step[..., axis])
    size = np.maximum(np.linalg.norm(gradient, axis=-1), np.linalg.norm(difference, axis=-1))
    comparable = np.isfinite(difference).all(axis=-1) & (size > 0)
    return float((np.linalg.norm(difference - gradient, axis=-1)[comparable] / size[comparable]).max())


def _picture(
    plr: PLR, workspace: Workspace, goal: Float[np.ndarray, "2"], starts: Float[np.ndarray, "n 2"]
) -> dict[str, Any]:
    """Some paths, and the directions of the negative gradient on a grid."""
    gradient = np.asarray(jax.grad(lambda x: plr(x).sum())(jnp.asarray(_arrows(workspace))))
    paths = descend(plr, workspace, starts[:NUM_DRAWN], goal).paths
    return {
        "bytes": plr.num_bytes,
        "goal": goal.tolist(),
        "free_space": shapely.to_wkt(workspace.free_space, rounding_precision=9),
        "degrees": np.rint(np.degrees(np.arctan2(*-gradient.T[::-1]))).astype(int).tolist(),
        "paths": [np.round(path, 4).tolist() for path in paths],
    }


def _arrows(workspace: Workspace) -> Float[np.ndarray, "n 2"]:
    """Where arrows are drawn."""
    points = workspace.bounds.grid(NUM_ARROWS).reshape(-1, 2)
    return points[workspace.is_free(points)]


def _longest(row: dict[str, Any]) -> str:
    return f"{row['ratio']['max']:.4f} (median {row['ratio']['median']:.4f})"


def draw(results: dict[str, Any], output: Path) -> list[Path]:
    drawn = [entry for entry in results["maps"] if entry["picture"] is not None]
    figure = Figure(figsize=(5.2 * len(drawn), 5.4), dpi=100, facecolor="white", layout="constrained")
    for ax, entry in zip(np.atleast_1d(figure.subplots(1, len(drawn))), drawn, strict=True):
        _draw_map(ax, entry)
    path = output / "descent.png"
    figure.savefig(path)
    return [path]


def _draw_map(ax: Axes, entry: dict[str, Any]) -> None:
    picture = entry["picture"]
    row = [row for row in entry["rows"] if row["leaf"] == "plane"][-1]
    workspace = _workspace_of(picture["free_space"])
    plot.plot_workspace(workspace, ax)
    angle = np.radians(picture["degrees"])
    ax.quiver(
        *_arrows(workspace).T,
        np.cos(angle),
        np.sin(angle),
        color=_ARROW_COLOR,
        pivot="mid",
        angles="xy",
        width=0.0022,
        scale=NUM_ARROWS * 1.3,
    )
    ax.add_collection(LineCollection(picture["paths"], colors=_PATH_COLOR, linewidths=1.0, alpha=0.75, zorder=4))
    begins = np.array([path[0] for path in picture["paths"]])
    ax.plot(*begins.T, "o", ms=3, color=_PATH_COLOR, zorder=5)
    ax.plot(*picture["goal"], "*", ms=12, mfc="white", mec="black", zorder=6)
    ax.set_title(
        f"{entry['map']}, {picture['bytes']:,} bytes: {row['reached']:.1%} reach the goal, "
        f"{row['ratio']['median']:.3f} times as long\n"
        f"gradient {row['gradient']['angles']['0.5']:.2g} degrees off (median)",
        fontsize=8,
    )


def _workspace_of(free_space: str) -> Workspace:
    parts: Any = shapely.get_parts(shapely.from_wkt(free_space))
    rings = [(part.exterior, part.interiors) for part in parts]
    return Workspace.from_polygons(
        [{"outer": outer.coords, "holes": [hole.coords for hole in holes]} for outer, holes in rings]
    )


if __name__ == "__main__":
    run("descent", "Paths extracted from PLRs by descent, and where their gradients point.", compute, draw)
