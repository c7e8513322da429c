"""Points beside contacts of obstacles, and in buildings whose walls nearly coincide: what is wrong, what is broken?

*Contacts.* Goals are random, points lie 1e-6 to 1e-2 beside points where obstacles touch. A bound of all pairs, or of
certified cones of 8 and 32 KB, is broken if it is beyond the exact distance by more than the oracle rounds.

*Buildings.* Pairs are random points, and points 0 to 1e-2 beside walls. A distance is wrong if it is not between
those of points that ``construct_pairs`` does not tell from these, as on both sides of walls that 32 bits do not
resolve.
"""

import os
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from jaxtyping import Float

from experiments._runner import run
from experiments.benchmarks._maps import load_maps
from experiments.compare_summaries import MAX_BYTES
from plr_jax import VisibilityGraph, Workspace, construct, construct_pairs

_ORACLE = 1e-12  # of the domain's width: what the oracle rounds
_NEAREST, _FARTHEST = 1e-6, 1e-2  # from a contact, in workspace units
_GOALS, _CONE_GOALS, _POINTS = 20, 2, 25_000
_CONES = (8_192, 32_768)
_PAIRS = 10_000
_THIN, _LACKING = 8e-6, 2e-5  # widths: what 32 bits resolve of walls, and what a point beside one may lack


def compute(seed: int, smoke: bool) -> dict[str, Any]:
    folder = Path(os.environ.get("PLR_JAX_DATA", ""))
    maps: dict[str, Workspace] = {}
    buildings: dict[str, Workspace] = {}
    for name in ("contacts/contact", "jupedsim/arena", "jupedsim/aknz_evac"):
        if (path := folder / f"{name}.wkt").exists():
            shapes = shapely.from_wkt(path.read_text())
            parts: Any = shapely.get_parts(shapes).tolist()
            if name.startswith("contacts"):
                maps[path.stem] = Workspace(np.reshape(shapes.bounds, (2, 2)), parts)
            else:
                buildings[path.stem] = Workspace.from_polygons(parts)
                if len(buildings[path.stem].boundary.contacts):
                    maps[path.stem] = buildings[path.stem]
        else:
            print(f"{name}: skipped, PLR_JAX_DATA names no folder with {path.name}")
    if not smoke:
        maps |= {name: workspace for name, (workspace, _) in load_maps(["den520d", "Berlin"]).items()}
    rng = np.random.default_rng(seed)
    return {
        "buildings": [row for name, each in buildings.items() for row in _in_building(name, each, rng, smoke)],
        "contacts": [row for name, each in maps.items() for row in _beside_contacts(name, each, rng, smoke)],
    }


def _beside_contacts(name: str, workspace: Workspace, rng: np.random.Generator, smoke: bool) -> list[dict[str, Any]]:
    contacts, count = workspace.boundary.vertices[workspace.boundary.contacts], 500 if smoke else _POINTS
    away = np.exp(rng.uniform(np.log(_NEAREST), np.log(_FARTHEST), (4 * count, 1)))
    angle = rng.uniform(0, 2 * np.pi, 4 * count)
    x = rng.choice(contacts, 4 * count) + away * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    x = x[shapely.intersects_xy(workspace.free_space, *x.T)][:count]
    goals = workspace.sample_free(4 if smoke else _GOALS, int(rng.integers(2**31)))
    oracle, slack = VisibilityGraph(workspace, goals[0]), _ORACLE * float(workspace.bounds.width.max())
    pairs, broken, asked = construct_pairs(workspace, max_bytes=MAX_BYTES.get(name, 2**18)), np.zeros(2, int), 0
    for goal, points in zip(goals, np.array_split(x, len(goals)), strict=True):
        counts = _broken(pairs.bounds(points, goal), oracle.with_goal(goal)(points), slack)
        broken, asked = broken + counts[:2], asked + int(counts[2])
    rows = [{"what": "pairs", "bytes": pairs.num_bytes, "goals": len(goals), "asked": asked, "broken": broken}]
    for most in _CONES:
        broken, asked, some = np.zeros(2, int), 0, goals[: 1 if smoke else _CONE_GOALS]
        for goal in some:
            own = oracle.with_goal(goal)
            cones = construct(own, workspace.bounds, leaf="cone", max_bytes=most, certified="leaves")
            counts = _broken(cones.bounds(x), own(x), slack)
            broken, asked = broken + counts[:2], asked + int(counts[2])
        rows.append({"what": "cones", "bytes": most, "goals": len(some), "asked": asked, "broken": broken})
    rows = [{"map": name, "contacts": len(contacts), **row, "broken": int(row["broken"].sum())} for row in rows]
    print(*rows, sep="\n", flush=True)
    return rows


def _broken(bounds: Any, exact: Float[np.ndarray, " n"], slack: float) -> Any:
    """How many lower and upper bounds are broken of points that reach the goal, and how many points do."""
    (lower, upper), reached = (np.asarray(bound, float) for bound in bounds), np.isfinite(exact)
    beyond = [(lower > exact + slack)[reached], (upper < exact - slack)[reached], reached]
    return np.array([int(each.sum()) for each in beyond])


def _in_building(name: str, workspace: Workspace, rng: np.random.Generator, smoke: bool) -> list[dict[str, Any]]:
    count, boundary = 200 if smoke else _PAIRS, workspace.boundary
    wall = rng.integers(len(boundary.edges), size=4 * count)
    away = rng.choice([0.0, *10.0 ** np.arange(-9, -1)], 4 * count)[:, None]
    start, end = boundary.segments[wall].transpose(1, 0, 2)
    beside = start + rng.random((4 * count, 1)) * (end - start) + away * boundary.normal[wall]
    beside = beside[workspace.is_free(beside)][: 2 * count]
    random = workspace.sample_free(2 * count, int(rng.integers(2**31)))
    pairs, oracle = construct_pairs(workspace), VisibilityGraph(workspace, random[0])
    cones = construct(oracle, workspace.bounds, leaf="cone", max_bytes=_CONES[0], certified=True)
    slack = _ORACLE * float(workspace.bounds.width.max())
    rows = []
    for where, points in (("random", random), ("beside walls", beside)):
        x, y = np.split(points[: len(points) // 2 * 2], 2)
        exact, answer = oracle.between(x, y), np.asarray(pairs(x, y), float)
        width = float(workspace.bounds.width.max())
        differs = ~((answer == exact) | (np.abs(answer - exact) <= _LACKING * width))
        wrong, thin = 0, np.flatnonzero(differs)
        for i in thin:
            ends = [_around(workspace, point, _THIN * width) for point in (x[i], y[i])]
            p, q = (part.reshape(-1, 2) for part in np.broadcast_arrays(ends[0][:, None], ends[1][None]))
            near, lacking = oracle.between(p, q), _LACKING * width
            wrong += int(not near.min() - lacking <= answer[i] <= near.max() + lacking)
        of_pairs, of_cones = _broken(pairs.bounds(x, y), exact, slack), _broken(cones.bounds(x), oracle(x), slack)
        row = {"map": name, "where": where, "pairs": len(x), "as beside a thin wall": len(thin) - wrong}
        row |= {"wrong": wrong, "broken": int(of_pairs[:2].sum()), "broken of cones": int(of_cones[:2].sum())}
        print(row, flush=True)
        rows.append(row)
    return rows


def _around(workspace: Workspace, x: Float[np.ndarray, "2"], radius: float) -> Float[np.ndarray, "n 2"]:
    """A point and free ones around it."""
    angle = np.arange(16) * np.pi / 8
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    points = np.concatenate([x[None], x + radius * ring, x + radius / 2 * ring])
    return points[workspace.is_free(points)]


if __name__ == "__main__":
    run("hard_points", __doc__, compute)
