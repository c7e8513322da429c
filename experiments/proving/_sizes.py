"""The largest error that can be found: dense samples where the largest is proven, then boxes that shrink."""

import time
from functools import partial
from typing import Any

import jax.numpy as jnp
import numpy as np
import shapely
from jaxtyping import Float, Int

from experiments.benchmarks._maps import Map, load_map, load_maps
from experiments.benchmarks._oracle import prepared
from experiments.benchmarks._timing import interleaved
from plr_jax import PLR, VisibilityGraph, certify, construct
from plr_jax.geometry.boundary import polygons_of, triangulate

_LEAVES, _POINTS, _SMOKE_POINTS = 30, 20_000, 500
_BEST, _POINTS_A_BOX, _ROUNDS = 12, 2_000, 5
_FIRST_BOX, _SHRINKING = 0.1, 0.2  # of the sides of a leaf; of the box before

Points = Float[np.ndarray, "n 2"]


def widest_bounds(plr: PLR) -> Float[np.ndarray, " leaves"]:
    """The larger of the two bounds of each leaf of a PLR that has them."""
    assert plr.band is not None
    return np.abs(np.asarray(plr.band)).max(axis=0)[: plr.num_leaves].astype(float)


def largest_found(
    plr: PLR, oracle: VisibilityGraph, x: Points, errors: Float[np.ndarray, " n"], smoke: bool
) -> float:
    """The largest error at any of the points given, and at those that are looked for.

    Those lie in the leaves of the largest proven error, all over their free parts and beside the edges of these,
    where proofs are tight; then in ever smaller boxes around the worst.
    """
    rng = np.random.default_rng(7)
    lo, hi = plr.leaf_boxes
    worst = np.argsort(-widest_bounds(certify(plr, oracle, leaf_bounds=True)))[:_LEAVES]
    dense, side = dense_points(oracle, lo, hi, worst, _SMOKE_POINTS if smoke else _POINTS, rng)
    points, found = np.concatenate([x, dense]), np.concatenate([errors, _errors(plr, oracle, dense)])
    sides = np.concatenate([np.full(x.shape, np.median(hi - lo, axis=0)), side])
    largest = float(found.max(initial=0.0))
    best = np.argsort(-found)[:_BEST]
    center, side = points[best], _FIRST_BOX * sides[best]
    for _ in range(_ROUNDS):
        near = center[:, None] + side[:, None] * rng.uniform(-1, 1, (len(center), _POINTS_A_BOX, 2))
        near[:, 0] = center
        error = _errors(plr, oracle, near.reshape(-1, 2)).reshape(len(center), -1)
        center = near[np.arange(len(center)), error.argmax(axis=1)]
        largest, side = max(largest, float(error.max())), _SHRINKING * side
    return largest


def dense_points(
    oracle: VisibilityGraph,
    lo: Float[np.ndarray, "leaves 2"],
    hi: Float[np.ndarray, "leaves 2"],
    leaves: Int[np.ndarray, " some"],
    count: int,
    rng: np.random.Generator,
) -> tuple[Points, Points]:
    """Points of the free parts of some leaves, half of them next to the edges; and the sides of their leaves."""
    points, sides = [np.zeros((0, 2))], [np.zeros((0, 2))]
    for leaf in leaves:
        free = polygons_of(shapely.intersection(oracle.workspace.free_space, shapely.box(*lo[leaf], *hi[leaf])))
        if free:
            triangles = triangulate(shapely.MultiPolygon(free))
            points.append(points_of_triangles(triangles, count, rng))
            sides.append(np.broadcast_to(hi[leaf] - lo[leaf], points[-1].shape))
    return np.concatenate(points), np.concatenate(sides)


def points_of_triangles(triangles: Float[np.ndarray, "n 3 2"], count: int, rng: np.random.Generator) -> Points:
    """Random points of triangles, half of them uniform, half near edges and vertices, in all triangles alike."""
    (a, b), c = triangles[:, 1:].transpose(1, 0, 2) - triangles[:, :1].transpose(1, 0, 2), triangles[:, 0]
    area = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    uniform = rng.choice(len(area), count // 2, p=area / area.sum())
    pick = np.concatenate([uniform, rng.integers(len(area), size=count - count // 2)])
    weight = rng.exponential(size=(count, 3))
    weight[count // 2 :] **= rng.choice([1.0, 4.0, 16.0], (count - count // 2, 1))
    weight /= weight.sum(axis=1, keepdims=True)
    return c[pick] + weight[:, 1:2] * a[pick] + weight[:, 2:] * b[pick]


def _errors(plr: PLR, oracle: VisibilityGraph, x: Points) -> Float[np.ndarray, " n"]:
    """Errors where the goal can be reached, 0 elsewhere and outside the domain."""
    distance = oracle(x)
    error = np.abs(np.asarray(plr(x), float) - np.where(np.isfinite(distance), distance, 0.0))
    return np.where(np.isfinite(distance) & np.isfinite(error), error, 0.0)


# Cones, planes and continuous leaves at equal bytes: their errors, the largest found and the largest proven.
#
# Mean errors are over random free points. The largest error is looked for as above
# says, and so is closer to the truth than the largest over random points. Seconds are medians of three runs, fewer
# where they take long, each with a workspace of its own and after a first that is not timed: of the oracle alone, and
# of the whole chain from rings of free space to the certified PLR.

LEAVES = ("cone", "plane", "continuous")
SIZES = {
    "maze": (256, 512, 1_024),
    "thin_maze": (256, 512, 1_024),
    "floor_plan": (1_024, 4_096),
    "arena": (2_048, 8_192),
    "den312d": (2_048, 6_144),
    "den520d": (16_384,),
}
POINTS, POINT_SEED = 500_000, 40_000
_EXACT = 1e-6  # of the largest distance
_RUNS, _SECONDS_IN_ALL = 3, 20.0


def sizes(seed: int, smoke: bool) -> dict[str, Any]:
    sizes = {"maze": (256,)} if smoke else SIZES
    points = 5_000 if smoke else POINTS
    rows = []
    for name, budgets in sizes.items():
        if (found := load_map(name)) is None:
            continue
        workspace, goal = found
        oracle = VisibilityGraph(workspace, goal)
        x = workspace.sample_free(points, POINT_SEED + seed)
        distance = oracle(x)
        reached = np.isfinite(distance)
        for budget in budgets:
            for leaf in LEAVES:
                plr, timing = timed_builds(found, leaf, budget, seed, smoke)
                errors = error_row(plr, oracle, x[reached], distance[reached], smoke)
                rows.append({"map": name, "budget": budget, "leaf": leaf, **errors, **timing})
    return {"points": points, "exact": _EXACT, "rows": rows}


def timed_builds(found: Map, leaf: str, budget: int, seed: int, smoke: bool) -> tuple[PLR, dict[str, Any]]:
    """A certified PLR, and median seconds of its parts."""
    workspace, goal = found

    def build() -> tuple[PLR, float, float]:
        to_workspace, to_oracle, oracle = prepared(workspace, goal)
        start = time.perf_counter()
        plr = construct(oracle, workspace.bounds, leaf=leaf, max_bytes=budget, certified=True, seed=seed)
        return plr, to_workspace + to_oracle, time.perf_counter() - start

    plr, *_ = build()  # compiles
    runs, begun = [], time.perf_counter()
    while not runs or (not smoke and len(runs) < _RUNS and time.perf_counter() - begun < _SECONDS_IN_ALL):
        runs.append(build()[1:])
    of_oracle, of_plr = np.array(runs).T
    timing = {"runs": len(runs), "seconds_oracle": of_oracle, "seconds": of_oracle + of_plr}
    return plr, {name: float(np.median(value)) if name != "runs" else value for name, value in timing.items()}


def error_row(plr: PLR, oracle: VisibilityGraph, x: np.ndarray, distance: np.ndarray, smoke: bool) -> dict[str, Any]:
    """Errors of a certified PLR at points that reach the goal, and the largest that can be found and proven."""
    errors = np.abs(np.asarray(plr(x), float) - distance)
    assert plr.max_error is not None
    found = largest_found(plr, oracle, x, errors, smoke)
    return {
        "bytes": plr.num_bytes,
        "leaves": plr.num_leaves,
        "mean": float(errors.mean()),
        "largest_of_points": float(errors.max()),
        "largest_found": found,
        "proven": plr.max_error,
        "proven_to_found": plr.max_error / found,
        "largest_distance": float(distance.max()),
        "share_exact": float((errors <= _EXACT * distance.max()).mean()),
    }


# Seconds of cones beside planes: queries of as many leaves, and the way from a workspace to a PLR.
#
# Queries are of the maze, of random points of its domain, which are on the device; the leaf models take turns. Builds
# are warm, each from rings of free space by way of a workspace and a visibility graph of its own; they take turns
# too.

QUERIED, QUERIED_LEAVES = "maze", (128, 256, 512, 1_024, 2_048)
SPEED_POINTS, SPEED_SEED = 1_000_000, 1_000
BUILDS: dict[str, dict[str, int]] = {
    "maze": {"max_leaves": 512},
    "arena": {"max_bytes": 16_384},
    "den520d": {"max_bytes": 16_384},
}
_SPEED_LEAVES = ("cone", "plane")
_QUERY_TURNS, _BUILD_TURNS = 15, 5


def speed(seed: int, smoke: bool) -> dict[str, Any]:
    return {"queries": _queries(seed, smoke), "builds": _builds(seed, smoke)}


def _queries(seed: int, smoke: bool) -> dict[str, Any]:
    points, leaves = (1_000, QUERIED_LEAVES[:1]) if smoke else (SPEED_POINTS, QUERIED_LEAVES)
    ((workspace, goal),) = load_maps([QUERIED]).values()
    oracle = VisibilityGraph(workspace, goal)
    x = workspace.bounds.lo + workspace.bounds.width * np.random.default_rng(SPEED_SEED + seed).random((points, 2))
    on_device = jnp.asarray(x, jnp.float32)
    plrs = {
        (leaf, number): construct(oracle, workspace.bounds, leaf=leaf, max_leaves=number, seed=seed)
        for number in leaves
        for leaf in _SPEED_LEAVES
    }
    seconds = interleaved(
        {str(key): partial(plr, on_device) for key, plr in plrs.items()}, 2 if smoke else _QUERY_TURNS
    )
    rows = [
        {
            "leaf": key[0],
            "max_leaves": key[1],
            "leaves": plr.num_leaves,
            "nanoseconds": [1e9 / points * s for s in seconds[str(key)]],
        }
        for key, plr in plrs.items()
    ]
    return {"map": QUERIED, "points": points, "rows": rows}


def _builds(seed: int, smoke: bool) -> list[dict[str, Any]]:
    maps = load_maps(list(BUILDS)[: 1 if smoke else None])
    rows = []
    for name, found in maps.items():
        calls = {leaf: partial(_build, found, leaf, BUILDS[name], seed) for leaf in _SPEED_LEAVES}
        seconds = interleaved(calls, 1 if smoke else _BUILD_TURNS)
        for leaf, call in calls.items():
            plr = call()
            sizes = {"leaves": plr.num_leaves, "bytes": plr.num_bytes}
            rows.append({"map": name, "leaf": leaf, **BUILDS[name], **sizes, "seconds": list(seconds[leaf])})
    return rows


def _build(found: Map, leaf: str, limits: dict[str, Any], seed: int) -> PLR:
    *_, oracle = prepared(*found)
    return construct(oracle, oracle.workspace.bounds, leaf=leaf, seed=seed, **limits)
