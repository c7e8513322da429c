"""What continuity costs: planes against continuous leaves and ones with a continuous gradient, at equal bytes.

Errors are over random free points against the exact distance. Jumps are measured at random points of the leaves'
faces, moved ``2**-22`` of the domain to either side, where both sides are free: of the value as a share of the
largest distance, of the gradient as the length of the difference. Queries of a million points (less with ``--smoke``)
take turns; medians are reported.
"""

import time
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from experiments._runner import run
from experiments.benchmarks._maps import load_maps
from experiments.benchmarks._timing import interleaved
from plr_jax import PLR, Box, VisibilityGraph, Workspace, construct, metrics
from plr_jax.plr.partition.cells import tree_of
from plr_jax.plr.partition.faces import face_points, shared_faces

POINT_SEED, FACE_SEED = 1_000, 3_000
BESIDE = 2.0**-22
POINTS_A_FACE = 8
_MAPS = ("maze", "thin_maze", "arena")
_LEAVES = ("plane", "continuous", "smooth")

Points = Float[np.ndarray, "n 2"]


def compute(seed: int, smoke: bool) -> dict[str, Any]:
    num_points, num_runs = (1_000, 2) if smoke else (1_000_000, 15)
    budgets = [512] if smoke else [2_048, 6_144, 30_720]
    maps = load_maps(_MAPS[:1] if smoke else _MAPS)
    rows = []
    for name, (workspace, goal) in maps.items():
        exact = VisibilityGraph(workspace, goal)
        x = workspace.sample_free(min(num_points, 200_000), POINT_SEED + seed)
        distance = exact(x)
        for budget in budgets:
            contenders = build(exact, workspace, budget, seed)
            nanoseconds = time_queries({leaf: plr for leaf, (plr, _) in contenders.items()}, num_points, num_runs)
            for leaf, (plr, seconds) in contenders.items():
                row = measure(plr, workspace, exact, x, distance)
                timing = {"nanoseconds": nanoseconds[leaf], "to_planes": nanoseconds[leaf] / nanoseconds["plane"]}
                rows.append({"map": name, "budget": budget, "leaf": leaf, **row, **timing, "seconds": seconds})
    return {"points": num_points, "runs": num_runs, "rows": rows}


def build(exact: VisibilityGraph, workspace: Workspace, max_bytes: int, seed: int) -> dict[str, tuple[PLR, float]]:
    """The three contenders, and seconds that each took."""
    contenders = {}
    for leaf in _LEAVES:
        start = time.perf_counter()
        plr = construct(exact, workspace.bounds, leaf=leaf, max_bytes=max_bytes, seed=seed)
        contenders[leaf] = (plr, time.perf_counter() - start)
    return contenders


def time_queries(plrs: dict[str, PLR], num_points: int, num_runs: int) -> dict[str, float]:
    domain = next(iter(plrs.values())).domain
    x = domain.lo + domain.width * np.random.default_rng(POINT_SEED).random((num_points, domain.dim))
    on_device = jnp.asarray(x, jnp.float32)
    queries = {leaf: (lambda plr=plr: plr(on_device)) for leaf, plr in plrs.items()}
    return {name: 1e9 / num_points * seconds.median for name, seconds in interleaved(queries, num_runs).items()}


def measure(
    plr: PLR,
    workspace: Workspace,
    exact: VisibilityGraph,
    x: Points,
    distance: Float[np.ndarray, "n"],
) -> dict[str, Any]:
    report = metrics.error_map(plr, lambda _: distance, x)
    value_jump, gradient_jump = jumps(plr, workspace, exact)
    return {
        "leaves": plr.num_leaves,
        "bytes": plr.num_bytes,
        "resident_bytes": plr.resident_bytes,
        "mean": report.mean,
        "max": report.max,
        "unanswered": report.num_unanswered,
        "value_jump": value_jump / report.max_distance,
        "gradient_jump": gradient_jump,
    }


def jumps(plr: PLR, workspace: Workspace, exact: VisibilityGraph) -> tuple[float, float]:
    """Largest jumps of value and gradient over random points of free faces."""
    below, above = both_sides(plr, plr.domain)
    free = workspace.is_free(below) & workspace.is_free(above)
    free[free] = np.isfinite(exact(below[free]))  # the goal can be reached
    sides = [jnp.asarray(side[free], jnp.float32) for side in (below, above)]
    (low, slope_low), (high, slope_high) = (jax.vmap(jax.value_and_grad(plr))(side) for side in sides)
    gradient = np.linalg.norm(np.asarray(slope_low) - np.asarray(slope_high), axis=1)
    return float(np.abs(np.asarray(low) - np.asarray(high)).max()), float(gradient.max())


def both_sides(plr: PLR, domain: Box) -> tuple[Points, Points]:
    tree = tree_of(plr.cells)
    faces = shared_faces(tree)
    w = np.random.default_rng(FACE_SEED).random((POINTS_A_FACE, domain.dim))
    u = face_points(tree.leaves, faces, w)
    across = BESIDE * np.eye(domain.dim)[faces.axis][:, None]
    below, above = ((domain.lo + domain.width * (u + sign * across)).reshape(-1, domain.dim) for sign in (-1, 1))
    return below, above


if __name__ == "__main__":
    run("continuity", "What continuity costs in error, bytes and query time.", compute)
