"""BIT* of OMPL in the maze, by its own bound of path lengths and by what is proven of a PLR.

Until a path is 1 % longer than the shortest: seconds, and states tested, which the maze's test makes cheap.
"""

import time
from typing import Any

import numpy as np

from plr_jax import PLR, VisibilityGraph, construct, ompl_objective, scenes

NUM_TRIALS, TIME_LIMIT, LONGER, NUM_BYTES = 5, 15.0, 1.01, 1024


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    from ompl import util

    util.RNG.setSeed(seed + 1)  # 0 is no seed to OMPL, and one is taken only once
    problem = scenes.maze()
    oracle = VisibilityGraph(problem.workspace, problem.goals[0])
    domain = problem.workspace.bounds
    plr = construct(oracle, domain, leaf="cone", max_bytes=NUM_BYTES, certified=True, leaf_bounds=True)
    plr.bounds(domain.lo)  # compiled before the clock starts
    shortest = float(oracle(problem.starts[:1])[0])
    num_trials, limit = (1, 0.5) if smoke else (NUM_TRIALS, TIME_LIMIT)
    rows = []
    for name, heuristic in (("length", None), ("PLR", plr)):
        trials = [_trial(problem, heuristic, shortest, limit) for _ in range(num_trials)]
        rows.append({"heuristic": name, "trials": trials})
        print(_line(rows[-1]), end="", flush=True)
    return {"bytes": NUM_BYTES, "longer": LONGER, "limit": limit, "rows": rows}


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


def table(results: dict[str, Any]) -> str:
    return "".join(map(_line, results["rows"]))


def _line(row: dict[str, Any]) -> str:
    seconds, tested = (np.median([trial[what] for trial in row["trials"]]) for what in ("seconds", "tested"))
    arrived = sum(trial["arrived"] for trial in row["trials"])
    return (
        f"BIT* by {row['heuristic']:8} states tested {tested:9,.0f}  s {seconds:6.2f}  "
        f"arrived {arrived}/{len(row['trials'])}\n"
    )
