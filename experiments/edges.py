"""What happens at the edges of what PLRs are made for."""

import time
from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import shapely
from jaxtyping import Float

from experiments._runner import Section, run
from experiments.benchmarks._maps import load_maps
from experiments.benchmarks._oracle import polygon_field
from plr_jax import PLR, VisibilityGraph, Workspace, construct, construct_pairs, ompl_objective, scenes, stack

# A map in UTM coordinates beside the same map at the origin: mean errors of NumPy's 64-bit points, and of 32 bits.
#
# The maze, 2,000 units wide, and goal are moved by (5e5, 4e6). The tables of PLRs are in 32 bits, which resolve such
# coordinates to a quarter of a unit.

OFFSET, WIDTH = np.array([5e5, 4e6]), 2000.0
LEAVES, UTM_BYTES, UTM_POINTS, NUM_PAIRS = ("plane", "continuous", "smooth", "cone"), 4096, 100_000, 10_000


def utm(seed: int, smoke: bool) -> dict[str, Any]:
    num_bytes, num_points, num_pairs = (512, 500, 100) if smoke else (UTM_BYTES, UTM_POINTS, NUM_PAIRS)
    maps = [_moved_maze(origin) for origin in (np.zeros(2), OFFSET)]
    x = maps[0][0].sample_free(num_points, seed)
    distances = maps[0][1](x)
    rows = []
    for leaf in LEAVES:
        near, far = (construct(oracle, space.bounds, leaf=leaf, max_bytes=num_bytes) for space, oracle in maps)
        moved = x + OFFSET
        rows.append(_row(leaf, near(x), far(moved), far(jnp.asarray(moved)), distances))
        nears, fars = stack([near, near]), stack([far, far])
        answers = nears(0, x), fars(0, moved), fars(0, jnp.asarray(moved))
        rows.append(_row(f"stack, {leaf}", *answers, distances))
    y, x = maps[0][0].sample_free(num_pairs, seed + 1), x[:num_pairs]
    near, far = (construct_pairs(space, max_bytes=num_bytes) for space, _ in maps)
    single = far(jnp.asarray(x + OFFSET), jnp.asarray(y + OFFSET))
    rows.append(_row("pairs", near(x, y), far(x + OFFSET, y + OFFSET), single, maps[0][1].between(x, y)))
    return {"bytes": num_bytes, "points": num_points, "pairs": num_pairs, "rows": rows}


def _moved_maze(origin: Float[np.ndarray, "2"]) -> tuple[Workspace, VisibilityGraph]:
    maze = scenes.maze()
    walls = [origin + WIDTH * shapely.get_coordinates(wall) for wall in maze.workspace.obstacles]
    workspace = Workspace((origin, origin + WIDTH), walls)
    return workspace, VisibilityGraph(workspace, origin + WIDTH * maze.goals[0])


def _row(what: str, near: Any, far: Any, single: Any, distances: Float[np.ndarray, "n"]) -> dict[str, Any]:
    errors = [float(np.abs(np.asarray(each, np.float64) - distances).mean()) for each in (near, far, single)]
    return {"what": what, "error": errors[0], "ratio": errors[1] / errors[0], "ratio_32_bits": errors[2] / errors[0]}


# What is free and how far walls are, asked by compiled functions: tables beside Shapely, time a point.

FIELDS, NUM_POINTS, NUM_RUNS = (4_000, 40_000), 1_000_000, 5


def free_space(seed: int, smoke: bool) -> dict[str, Any]:
    rows, (num_points, num_runs) = [], (1000, 1) if smoke else (NUM_POINTS, NUM_RUNS)
    for name, workspace in _maps(seed, smoke):
        rows.append({"map": name, **_measured(workspace, seed, num_points, num_runs)})
    return {"points": num_points, "rows": rows}


def _maps(seed: int, smoke: bool) -> Iterator[tuple[str, Workspace]]:
    for name, (workspace, _) in load_maps(("maze",) if smoke else ("maze", "arena", "den520d")).items():
        yield name, workspace
    for num_vertices in (80,) if smoke else FIELDS:
        yield f"field {num_vertices:,}", polygon_field(num_vertices, seed)[0]


def _measured(workspace: Workspace, seed: int, num_points: int, num_runs: int) -> dict[str, Any]:
    edges, (seconds, tables) = len(workspace.boundary.edges), _timed(lambda: workspace.tables)
    rng = np.random.default_rng(seed)
    x = jnp.asarray(rng.uniform(workspace.bounds.lo, workspace.bounds.hi, (num_points, 2)), jnp.float32)
    tables.clearance(x).block_until_ready()
    runs = [_timed(lambda: tables.clearance(x).block_until_ready()) for _ in range(num_runs)]
    by_shapely, expected = _timed(lambda: workspace.clearance(np.asarray(x, np.float64)))
    error = np.abs(np.asarray(runs[0][1], np.float64) - expected).max()
    return {
        "edges": edges,
        "bytes": sum(array.nbytes for array in jax.tree.leaves(tables)),
        "seconds_to_build": seconds,
        "nanoseconds": float(np.median([each for each, _ in runs])) / num_points * 1e9,
        "nanoseconds_shapely": by_shapely / num_points * 1e9,
        "largest_error": float(error / workspace.bounds.width.max()),
    }


def _timed(call: Callable[[], Any]) -> tuple[float, Any]:
    start = time.perf_counter()
    result = call()
    return time.perf_counter() - start, result


# BIT* of OMPL in the maze, by its own bound of path lengths and by what is proven of a PLR.
#
# Until a path is 1 % longer than the shortest: seconds, and states tested, which the maze's test makes cheap.

NUM_TRIALS, TIME_LIMIT, LONGER, OMPL_BYTES = 5, 15.0, 1.01, 1024


def bit_star(seed: int, smoke: bool) -> dict[str, Any]:
    from ompl import util

    util.RNG.setSeed(seed + 1)  # 0 is no seed to OMPL, and one is taken only once
    problem = scenes.maze()
    oracle = VisibilityGraph(problem.workspace, problem.goals[0])
    domain = problem.workspace.bounds
    plr = construct(oracle, domain, leaf="cone", max_bytes=OMPL_BYTES, certified=True, leaf_bounds=True)
    plr.bounds(domain.lo)  # compiled before the clock starts
    shortest = float(oracle(problem.starts[:1])[0])
    num_trials, limit = (1, 0.5) if smoke else (NUM_TRIALS, TIME_LIMIT)
    rows = []
    for name, heuristic in (("length", None), ("PLR", plr)):
        trials = [_trial(problem, heuristic, shortest, limit) for _ in range(num_trials)]
        rows.append({"heuristic": name, "trials": trials})
    return {"bytes": OMPL_BYTES, "longer": LONGER, "limit": limit, "rows": rows}


def _trial(problem: Any, plr: PLR | None, shortest: float, limit: float) -> dict[str, float]:
    from ompl import base, geometric

    space, num_tested = base.RealVectorStateSpace(2), 0
    space.setBounds(0.0, 1.0)
    setup = geometric.SimpleSetup(space)

    def is_valid(state: Any) -> bool:
        nonlocal num_tested
        num_tested += 1
        return bool(problem.workspace.is_free([[state[0], state[1]]])[0])

    setup.setStateValidityChecker(is_valid)
    information = setup.getSpaceInformation()
    information.setStateValidityCheckingResolution(0.002)
    ends = []
    for (place,) in (problem.starts, problem.goals):
        ends.append(space.allocState())
        ends[-1][0], ends[-1][1] = place.tolist()
    setup.setStartAndGoalStates(*ends)
    objective = base.PathLengthOptimizationObjective if plr is None else lambda of: ompl_objective(of, plr)
    setup.setOptimizationObjective(objective := objective(information))
    objective.setCostThreshold(base.Cost(LONGER * shortest))
    setup.setPlanner(geometric.BITstar(information))
    start = time.perf_counter()
    setup.solve(limit)
    seconds = time.perf_counter() - start
    cost = setup.getSolutionPath().length() if setup.haveSolutionPath() else np.inf
    return {"seconds": seconds, "tested": num_tested, "arrived": bool(cost <= LONGER * shortest)}


SECTIONS = {
    "utm": Section(utm),
    "free_space": Section(free_space),
    "ompl": Section(bit_star),
}

if __name__ == "__main__":
    run("edges", __doc__, SECTIONS)
