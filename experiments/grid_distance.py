"""Distances inside jit: levels a second on grids that are traced, beside what environments in JAX do today.

Levels are square, with walls around and 40 % of the inner cells blocked, and a free cell of each is the goal. Their
rivals are measured unmodified, where they can be imported: JaxNav's ``dikstra_path`` (package ``jaxmarl``), minimax's
``shortest_path_len`` (``minimax-lib``) and jaxgmg's ``maze_distances``. All are mapped over levels by ``jax.vmap``.
The first two answer for one pair of cells a level, jaxgmg for all pairs, and so do we for its row. Environments of
CAMAR (``camar``) and JaxNav are measured with rewards that know the way beside their own, of straight lines: a row's
levels are then environments, each of which is reset where that is said, and then makes 100 steps. Seconds are given
twice: elapsed, and of all cores together, which other programs on the machine do not lengthen as much.
"""

import importlib
import time
from collections.abc import Callable
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool, Float
from scipy import sparse

from experiments._runner import Section, run
from plr_jax import VisibilityGraph, Workspace, grid_distance

Levels = Bool[np.ndarray, "levels h w"]
Goals = Float[np.ndarray, "levels 2"]

_TURNS = 5
_POINTS = 200
_STEPS = 100


def random_levels(number: int, size: int, seed: int) -> tuple[Levels, Goals]:
    """Random levels, and the center of a free cell of each."""
    rng = np.random.default_rng(seed)
    free = np.zeros((number, size, size), bool)
    free[:, 1:-1, 1:-1] = rng.random((number, size - 2, size - 2)) >= 0.4
    free[:, 1, 1] |= ~free.any(axis=(1, 2))
    return free, _random_goals(free, rng)


def rooms(number: int, size: int, seed: int) -> tuple[Levels, Goals]:
    """Levels of rooms of 7 x 7 cells, with a door, a cell wide, in three of four walls between two."""
    rng, pitch = np.random.default_rng(seed), 8
    free = np.ones((number, size, size), bool)
    free[:, ::pitch], free[:, :, ::pitch], free[:, -1], free[:, :, -1] = False, False, False, False
    for level in free:
        for row, column in np.ndindex(size // pitch, size // pitch):
            across, along = rng.integers(1, pitch - 1, 2)
            if column and rng.random() < 3 / 4:
                level[row * pitch + across, column * pitch] = True
            if row and rng.random() < 3 / 4:
                level[row * pitch, column * pitch + along] = True
    free[:, -1], free[:, :, -1] = False, False
    return free, _random_goals(free, rng)


def _random_goals(free: Levels, rng: np.random.Generator) -> Goals:
    return np.stack([rng.choice(np.argwhere(level))[::-1] + 0.5 for level in free]).astype(np.float32)


def random_points(number: int, size: int, seed: int) -> Float[np.ndarray, "levels points 2"]:
    return np.random.default_rng(seed).uniform(0, size, (number, _POINTS, 2)).astype(np.float32)


# Speed.


def timed(calls: dict[str, tuple[Callable, tuple]]) -> list[dict[str, Any]]:
    """Seconds of functions that are mapped over the leading axis of their arguments, which take turns."""
    rows, compiled = [], {}
    for name, (function, arguments) in calls.items():
        start = time.perf_counter()
        compiled[name] = jax.jit(jax.vmap(function)).lower(*arguments).compile()
        rows.append({"what": name, "compile_seconds": time.perf_counter() - start, "levels": len(arguments[-1])})
        jax.block_until_ready(compiled[name](*arguments))
    for row in rows:
        row["elapsed"], row["cpu"] = [], []
    for _ in range(_TURNS):
        for row in rows:
            elapsed, cpu = time.perf_counter(), time.process_time()
            jax.block_until_ready(compiled[row["what"]](*calls[row["what"]][1]))
            row["elapsed"].append(time.perf_counter() - elapsed)
            row["cpu"].append(time.process_time() - cpu)
    return [_with_rates(row) for row in rows]


def _with_rates(row: dict[str, Any]) -> dict[str, Any]:
    elapsed, cpu = (float(np.median(row.pop(key))) for key in ("elapsed", "cpu"))
    return row | {"levels_a_second": row["levels"] / elapsed, "levels_a_cpu_second": row["levels"] / cpu}


def cells(moves: Any, free: Any, goal: Any) -> Any:
    return grid_distance(free, goal, moves=moves).cells


def at_points(free: Any, goal: Any, x: Any) -> Any:
    return grid_distance(free, goal)(x)


def small(seed: int, smoke: bool) -> dict[str, Any]:
    number = 16 if smoke else 4096
    free, goals = random_levels(number, 11, seed)
    x = random_points(number, 11, seed)
    calls: dict[str, tuple[Callable, tuple]] = {
        f"moves={moves}, all cells": (partial(cells, moves), (free, goals)) for moves in (4, 8, "any-angle")
    }
    few = number // 16
    calls["any-angle, 200 points"] = at_points, (free, goals, x)
    calls["any-angle, all cells, 200 points"] = (
        lambda free, goal, x: (lambda field: (field.cells, field(x)))(grid_distance(free, goal)),
        (free, goals, x),
    )
    calls["moves=4, all pairs of cells"] = (
        lambda free: jax.tree.leaves(grid_distance(free, None, moves=4)),
        (free[:few],),
    )
    held = jax.eval_shape(lambda *given: jax.tree.leaves(jax.vmap(grid_distance)(*given)), free, goals)
    num_bytes = sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(held)) / number
    rows = timed(calls | rivals(free, goals, few))
    versions = versions_of("jaxmarl", "minimax-lib", "jaxgmg")
    return {"rows": rows, "any_angle_bytes_a_level": num_bytes, "rivals": versions}


def rivals(free: Levels, goals: Goals, few: int) -> dict[str, tuple[Callable, tuple]]:
    """Those that are installed; of the others is said that they are not."""
    last = np.stack([np.argwhere(level)[-1][::-1] for level in free])
    found: dict[str, tuple[Callable, tuple]] = {}
    if (maps := _module("jaxmarl.environments.jaxnav.maps.grid_map")) is not None:
        path = partial(maps.GridMapCircleAgents.dikstra_path, None)
        found["JaxNav dikstra_path, one pair"] = path, ((~free).astype(np.int32), goals, last + 0.5)
    if (graph := _module("minimax.util.graph")) is not None:
        arguments = (~free)[:few], goals[:few].astype(np.uint32), last[:few].astype(np.uint32)
        found["minimax shortest_path_len, one pair"] = graph.shortest_path_len, arguments
    if (maze := _module("jaxgmg.procgen.maze_solving")) is not None:
        found["jaxgmg maze_distances, all pairs"] = maze.maze_distances, ((~free)[:few],)
    return found


def _module(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        print(f"{name}: left out, {error}")
        return None


def versions_of(*packages: str) -> dict[str, str]:
    found = {}
    for package in packages:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed"
    return found


def of_rooms(seed: int, smoke: bool) -> dict[str, Any]:
    """Also seconds of SciPy's Dijkstra, graph given, and of scikit-fmm, which measures another distance."""
    rows = []
    for size in (16,) if smoke else (64, 128):
        free, goals = rooms(2 if smoke else 32, size, seed)
        ours = timed({f"moves={moves}": (partial(cells, moves), (free, goals)) for moves in (4, 8)})
        graphs = [graph_of(level, 8) for level in free[:8]]
        sources = [int(y) * size + int(x) for x, y in goals[:8]]
        solve = partial(sparse.csgraph.dijkstra, directed=True)
        others = {
            "SciPy dijkstra, moves=8": [partial(solve, g, indices=s) for g, s in zip(graphs, sources, strict=True)]
        }
        if (skfmm := _module("skfmm")) is not None:
            others["scikit-fmm distance"] = [
                partial(_marched, skfmm, *each) for each in zip(free[:8], goals, strict=False)
            ]
        rows += [row | {"size": size} for row in [*ours, *(_on_the_host(*each) for each in others.items())]]
    return {"rows": rows}


def graph_of(free: Bool[np.ndarray, "h w"], moves: int) -> Any:
    """Legal steps between cells as a sparse matrix of their lengths."""
    h, w = free.shape
    number, padded = np.arange(h * w).reshape(h, w), np.pad(free, 1)
    at = lambda down, right: padded[1 + down : h + 1 + down, 1 + right : w + 1 + right]  # noqa: E731
    ends = []
    for down, right in ((0, 1), (1, 0), (0, -1), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1))[:moves]:
        start = number[free & at(down, right) & at(down, 0) & at(0, right)]
        ends.append((start, start + down * w + right, np.full(len(start), np.hypot(down, right))))
    start, end, length = (np.concatenate(parts) for parts in zip(*ends, strict=True))
    return sparse.csr_array((length, (start, end)), shape=(h * w, h * w))


def _marched(skfmm: Any, free: Any, goal: Any) -> Any:
    front = np.ma.MaskedArray(np.ones(free.shape), ~free)
    front[int(goal[1]), int(goal[0])] = -1
    return skfmm.distance(front)


def _on_the_host(name: str, calls: list[Callable]) -> dict[str, Any]:
    row = {"what": name, "compile_seconds": 0.0, "levels": len(calls), "elapsed": [], "cpu": []}
    for _ in range(_TURNS):
        elapsed, cpu = time.perf_counter(), time.process_time()
        for call in calls:
            call()
        row["elapsed"].append(time.perf_counter() - elapsed)
        row["cpu"].append(time.process_time() - cpu)
    return _with_rates(row)


# Environments.


def environments(seed: int, smoke: bool) -> dict[str, Any]:
    """Steps with rewards of the shortest path beside steps with those of the straight line; actions are random."""
    number = 2 if smoke else 16
    keys = jax.random.split(jax.random.key(seed), number)
    calls: dict[str, tuple[Callable, tuple]] = {}
    if (camar := _module("experiments.environments.camar")) is not None:
        theirs, ours = camar.camar_v0(), camar.ShapedCamar()
        act = theirs.action_spaces.sample
        calls |= _rollouts("CAMAR", theirs.reset, theirs.step, ours.reset, ours.step, act, keys)
    if (jaxnav := _module("experiments.environments.jaxnav")) is not None:
        theirs, ours = jaxnav.JaxNav(num_agents=4), jaxnav.ShapedJaxNav(num_agents=4)
        act = lambda key: {agent: jax.random.uniform(key, (2,), minval=-1) for agent in theirs.agents}  # noqa: E731
        calls |= _rollouts("JaxNav", theirs.reset, theirs.step_env, ours.reset, ours.step, act, keys)
    rows = [row | {"steps_a_cpu_second": _STEPS * row["levels_a_cpu_second"]} for row in timed(calls)]
    rate = {row["what"]: row["steps_a_cpu_second"] for row in rows}
    ratios = {what: rate[what] / rate[what.replace("path", "line")] for what in rate if "path" in what}
    return {"rows": rows, "path over line": ratios, "rivals": versions_of("camar", "jaxmarl")}


def _rollouts(
    name: str, reset: Callable, step: Callable, our_reset: Callable, our_step: Callable, act: Callable, keys: Any
) -> dict[str, tuple[Callable, tuple]]:
    calls: dict[str, tuple[Callable, tuple]] = {}
    for reward, begin, advance in (("line", reset, step), ("path", our_reset, our_step)):

        def steps(state: Any, key: Any, advance: Callable = advance) -> Any:
            def one(state: Any, key: Any) -> Any:
                return advance(key, state, act(key))[1:3]

            return jax.lax.scan(one, state, jax.random.split(key, _STEPS))[1]

        def episode(key: Any, begin: Callable = begin, steps: Callable = steps) -> Any:
            return steps(begin(key)[1], key)

        states = jax.jit(jax.vmap(begin))(keys)[1]
        calls[f"{name}, {reward}, {_STEPS} steps"] = steps, (states, keys)
        calls[f"{name}, {reward}, reset and {_STEPS} steps"] = episode, (keys,)
    return calls


# Truth.


def differences(seed: int, smoke: bool) -> dict[str, Any]:
    """From breadth-first search, SciPy's Dijkstra and ``VisibilityGraph``."""
    many, some = (8, 4) if smoke else (10_000, 1_000)
    free, goals = random_levels(many, 11, seed + 1)
    four = np.asarray(jax.jit(jax.vmap(partial(cells, 4)))(free, goals))
    eight = np.asarray(jax.jit(jax.vmap(partial(cells, 8)))(free[:some], goals[:some])).reshape(some, -1)
    octile = [
        sparse.csgraph.dijkstra(graph_of(level, 8), indices=int(y) * 11 + int(x))
        for level, (x, y) in zip(free[:some], goals, strict=False)
    ]
    x = random_points(some, 11, seed + 1)
    anywhere = jax.jit(jax.vmap(at_points))(free[:some], goals[:some], x)
    centers = jax.jit(jax.vmap(partial(cells, "any-angle")))(free[:some], goals[:some])
    ours = np.concatenate([np.asarray(centers).reshape(some, -1), anywhere], axis=1)
    middle = np.stack(np.meshgrid(np.arange(11), np.arange(11)), axis=-1).reshape(-1, 2) + 0.5
    truth = [
        VisibilityGraph(Workspace.from_mask(level, tolerance=0), goal)(np.vstack([middle, points]))
        for level, goal, points in zip(free[:some], goals, x, strict=False)
    ]
    return {
        "levels": {"moves=4": many, "others": some},
        "moves=4, cells that differ": int(np.sum(four != breadth_first(free, goals))),
        "moves=8, largest relative difference": _largest(eight, np.stack(octile), relative=True),
        "any-angle, largest difference": _largest(ours, np.stack(truth)),
    }


def breadth_first(free: Levels, goals: Goals) -> Float[np.ndarray, "levels h w"]:
    """Steps to goals, by the book, of all levels at once."""
    steps = np.full(free.shape, np.inf)
    levels, (columns, rows) = np.arange(len(free)), goals.astype(int).T
    front = np.zeros(free.shape, bool)
    front[levels, rows, columns], step = True, 0
    while front.any():
        steps[front] = step
        wide = np.pad(front, ((0, 0), (1, 1), (1, 1)))
        beside = wide[:, 2:, 1:-1] | wide[:, :-2, 1:-1] | wide[:, 1:-1, 2:] | wide[:, 1:-1, :-2]
        front, step = beside & free & np.isinf(steps), step + 1
    return steps


def _largest(ours: np.ndarray, truth: np.ndarray, relative: bool = False) -> float:
    """Infinite where only one of both is."""
    with np.errstate(invalid="ignore"):
        gap = np.abs(ours - truth) / (np.maximum(truth, 1) if relative else 1)
    return float(np.max(np.where(np.isinf(ours) & np.isinf(truth), 0, np.nan_to_num(gap, nan=np.inf))))


SECTIONS = {
    "11 x 11": Section(small),
    "rooms": Section(of_rooms),
    "environments": Section(environments),
    "differences": Section(differences),
}

if __name__ == "__main__":
    run("grid_distance", __doc__, SECTIONS)
