"""A* on grids under proven lower bounds: every path must be as short as Dijkstra's.

Random grids over the maps, 8-connected, whose edges are those that :meth:`Workspace.is_visible` lets pass; the goal
is a random node, and starts are nodes that reach it. Bounds of small PLRs are far enough from the truth to matter. A
lower bound need not be consistent, so nodes are opened again where a shorter way to them is found, and every time
counts. The PLRs themselves are no lower bounds: how often they mislead is counted too.
"""

import heapq
import math
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from experiments.benchmarks._maps import load_maps
from plr_jax import VisibilityGraph, Workspace, construct

BUDGETS = {"maze": 256, "arena": 1_024, "floor_plan": 1_024}
GOALS, STARTS = 8, 42
_NODES_ALONG = 40, 64  # of the longer side of a grid
_OPTIMAL = 1e-9
_LEAVES = ("cone", "plane")


class Grid(NamedTuple):
    """A grid graph: where nodes are, neighbors with lengths of each, and the same as a matrix."""

    points: Float[np.ndarray, "nodes 2"]
    neighbors: list[list[tuple[int, float]]]
    matrix: csr_array


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    rng = np.random.default_rng(seed)
    num_goals, num_starts = (2, 5) if smoke else (GOALS, STARTS)
    maps = load_maps(list(BUDGETS)[: 1 if smoke else None])
    rows = []
    for name, (workspace, goal) in maps.items():
        oracle = VisibilityGraph(workspace, goal)
        problems = []
        for _ in range(num_goals):
            grid = random_grid(workspace, rng)
            problems += _problems(name, oracle, grid, num_starts, rng, seed)
        rows += summed_up(name, problems)
    return {"problems": num_goals * num_starts * len(maps), "budgets": BUDGETS, "rows": rows}


def random_grid(workspace: Workspace, rng: np.random.Generator) -> Grid:
    """A grid of random step and place over a workspace, without nodes that have no neighbor."""
    bounds = workspace.bounds
    step = bounds.width.max() / rng.integers(*_NODES_ALONG)
    first = bounds.lo + step * rng.random(2)
    count = np.floor((bounds.hi - first) / step).astype(int) + 1
    place = np.stack(np.meshgrid(np.arange(count[0]), np.arange(count[1]), indexing="ij"), axis=-1)
    number = np.arange(place.shape[0] * place.shape[1]).reshape(place.shape[:2])
    points = (first + step * place).reshape(-1, 2)
    parts = []
    for i, j in ((1, 0), (0, 1), (1, 1), (1, -1)):
        a = number[: len(number) - i, max(0, -j) : number.shape[1] - max(0, j)].ravel()
        parts.append(np.stack([a, a + i * number.shape[1] + j]))
    edges = np.concatenate(parts, axis=1)
    edges = edges[:, workspace.is_visible(*points[edges])]
    used, edges = np.unique(edges, return_inverse=True)
    edges, points = edges.reshape(2, -1), points[used]
    lengths = np.linalg.norm(points[edges[0]] - points[edges[1]], axis=1)
    neighbors: list[list[tuple[int, float]]] = [[] for _ in points]
    for a, b, length in zip(*edges.tolist(), lengths.tolist(), strict=True):
        neighbors[a].append((b, length))
        neighbors[b].append((a, length))
    matrix = csr_array((lengths, (edges[0], edges[1])), shape=(len(points), len(points)))
    return Grid(points, neighbors, matrix)


def _problems(
    name: str, oracle: VisibilityGraph, grid: Grid, num_starts: int, rng: np.random.Generator, seed: int
) -> list[dict[str, Any]]:
    """Searches from random starts to a random goal, under each heuristic."""
    goal = int(rng.integers(len(grid.points)))
    shortest = dijkstra(grid.matrix, directed=False, indices=goal)
    starts = rng.choice(np.flatnonzero(np.isfinite(shortest) & (shortest > 0)), num_starts)
    exact, domain = oracle.with_goal(grid.points[goal]), oracle.workspace.bounds
    heuristics = {"straight line": np.linalg.norm(grid.points - grid.points[goal], axis=1)}
    for leaf in _LEAVES:
        options = {"leaf": leaf, "max_bytes": BUDGETS[name], "certified": "leaves"}
        plr = construct(exact, domain, seed=seed, **options)
        lower = np.asarray(plr.lower(grid.points), float)
        heuristics[f"{leaf}, lower"] = lower
        heuristics[f"{leaf}, lower, and straight line"] = np.maximum(lower, heuristics["straight line"])
        heuristics[f"{leaf} itself"] = np.asarray(plr(grid.points), float)
    heuristics["exact"] = exact(grid.points)
    rows, reached = [], np.isfinite(shortest)
    for heuristic, values in heuristics.items():
        # By how much the heuristic is above the grid's distances at most, as a share of the largest.
        over = float((values - shortest)[reached].max() / shortest[reached].max())
        estimate = values.tolist()
        for start in starts.tolist():
            cost, expanded, nodes = a_star(grid, start, goal, estimate)
            found = {"ratio": cost / float(shortest[start]), "expanded": expanded, "nodes": nodes}
            rows.append({"heuristic": heuristic, **found, "over": over})
    return rows


def a_star(grid: Grid, start: int, goal: int, estimate: list[float]) -> tuple[float, int, int]:
    """Cost of the path that A* finds, how many times it expands a node, and how many nodes those are."""
    cost: dict[int, float] = {start: 0.0}
    closed: set[int] = set()
    seen: set[int] = set()
    queue, expanded = [(estimate[start], 0.0, start)], 0
    while queue:
        _, negative, node = heapq.heappop(queue)
        if node == goal:
            return cost[node], expanded, len(seen)
        if -negative > cost[node] or node in closed:
            continue
        closed.add(node)
        seen.add(node)
        expanded += 1
        for neighbor, length in grid.neighbors[node]:
            onward = cost[node] + length
            if onward < cost.get(neighbor, math.inf):
                cost[neighbor] = onward
                closed.discard(neighbor)
                heapq.heappush(queue, (onward + estimate[neighbor], -onward, neighbor))
    return math.inf, expanded, len(seen)


def summed_up(name: str, problems: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """A row each heuristic: paths that are not optimal, and expansions, alone and beside the straight line's."""
    by_name: dict[str, list[dict[str, Any]]] = {}
    for row in problems:
        by_name.setdefault(row["heuristic"], []).append(row)
    straight = sum(row["expanded"] for row in by_name["straight line"])
    rows = []
    for heuristic, found in by_name.items():
        ratio, expanded, nodes = (np.array([row[key] for row in found]) for key in ("ratio", "expanded", "nodes"))
        rows.append(
            {
                "map": name,
                "heuristic": heuristic,
                "problems": len(found),
                "not_optimal": int((ratio > 1 + _OPTIMAL).sum()),
                "worst_ratio": float(ratio.max()),
                "expanded": float(np.median(expanded)),
                "to_straight": float(expanded.sum() / straight),
                "nodes_to_straight": float(nodes.sum() / straight),
                "largest_over": max(row["over"] for row in found),
            }
        )
    return rows
