"""A thousand random problems: one to eight robots of all shapes among random obstacles.

Each is planned twice: to a first path, shortened, within 3 s; and anew with a cost factor of 1 for 0.5 s, so that a
path is improved until then, under the robots' exact distances, which claim to bound all costs. Wrong is a path that
``validate`` refuses, a cost that is not that of the path or less than that of the robots' shortest paths as points, a
lower bound above the cost of either path, and a factor below 1.
"""

import traceback
from collections import Counter
from typing import Any

import numpy as np
import shapely
from tqdm import tqdm

from experiments._planning import lower_bound, plan
from experiments._tables import aligned
from plr_jax import (
    BLOptions,
    DiscRobot,
    PointRobot,
    PolygonRobot,
    Problem,
    RectangleRobot,
    Robot,
    Solution,
    Workspace,
    path_cost,
    robot_distance_fns,
    sum_of_distances,
    validate,
)

NUM_PROBLEMS = 1_000
MOST_ROBOTS, MOST_OBSTACLES = 8, 8
SECONDS, IMPROVING_SECONDS = 3.0, 0.5
_TRIALS = 200
_ROUNDING = 1e-9


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    count, counts, wrong = 5 if smoke else NUM_PROBLEMS, Counter[str](), []
    for k in tqdm(range(count), desc="random problems", delay=3, disable=None):
        problem = random_problem(np.random.default_rng((seed, k)))
        try:
            outcome, failure = judged(problem)
        except Exception:
            outcome, failure = "crashed", traceback.format_exc()
        counts[outcome] += 1
        if failure:
            wrong.append({"problem": k, "failure": failure})
    return {"problems": count, "outcomes": dict(counts), "wrong": wrong}


def judged(problem: Problem) -> tuple[str, str]:
    """How planning ended, and what is wrong with it."""
    solution, _ = plan(problem, None, BLOptions(time_limit=SECONDS))
    exact = sum_of_distances(robot_distance_fns(problem))
    improved, _ = plan(problem, exact, BLOptions(cost_factor=1.0, time_limit=IMPROVING_SECONDS))
    shortest, best = lower_bound(problem, inflated=False), min(solution.cost, improved.cost)
    for each in (solution, improved):
        outcome, failure = wrong_with(problem, each, shortest, best)
        if failure:
            return outcome, failure
    return f"{solution.status.name.lower()}{'' if solution.solved else ', no path'}", ""


def wrong_with(problem: Problem, solution: Solution, shortest: float, best: float) -> tuple[str, str]:
    """What is wrong with a solution, and the numbers that show it, if anything.

    Args:
        problem: The problem.
        solution: A solution of it.
        shortest: The cost of the robots' shortest paths as points: no path of the team costs less.
        best: The cost of the best path that is known.
    """
    if solution.lower_bound > best * (1 + _ROUNDING):
        return "wrong bound", f"lower bound {solution.lower_bound}, a path of {best}"
    if solution.path is None:
        return "", ""
    report, cost = validate(problem, solution.path), path_cost(problem, solution.path)
    if not report.valid:
        return "invalid path", report.message
    if abs(cost - solution.cost) > _ROUNDING * (1 + cost):
        return "wrong cost", f"{solution.cost} for a path of {cost}"
    if cost < shortest * (1 - _ROUNDING):
        return "cost below the shortest paths", f"cost {cost}, shortest paths {shortest}"
    if min(solution.factor, solution.motions_factor) < 1 - _ROUNDING:
        return "wrong factor", f"factor {solution.factor}, motions factor {solution.motions_factor}"
    return "", ""


def random_problem(rng: np.random.Generator) -> Problem:
    """Up to eight robots of random shapes among up to eight random obstacles."""
    while True:
        num_obstacles = rng.integers(MOST_OBSTACLES + 1)
        obstacles = [convex(rng, rng.uniform(0, 10, 2), rng.uniform(0.5, 2.5)) for _ in range(num_obstacles)]
        try:
            workspace = Workspace(((0, 0), (10, 10)), obstacles)
            robots = [random_robot(rng) for _ in range(rng.integers(1, MOST_ROBOTS + 1))]
            if rng.random() < 0.5:  # robots of few kinds, as in most teams
                robots = [robots[i % 2 % len(robots)] for i in range(len(robots))]
            ends = [random_places(workspace, robots, rng) for _ in range(2)]
            return Problem(workspace, robots, ends[0], ends[1])
        except ValueError:
            continue


def convex(rng: np.random.Generator, center: np.ndarray, size: float) -> np.ndarray:
    """A random convex polygon about a center."""
    points = shapely.MultiPoint(center + size * rng.uniform(-1, 1, (rng.integers(4, 8), 2)))
    return shapely.get_coordinates(points.convex_hull)[:-1]


def random_robot(rng: np.random.Generator) -> Robot:
    shape = rng.integers(4)
    if shape == 0:
        return PointRobot()
    if shape == 1:
        return DiscRobot(float(rng.uniform(0.1, 0.6)))
    if shape == 2:
        return RectangleRobot(float(rng.uniform(0.3, 1.5)), float(rng.uniform(0.2, 0.8)))
    corners = convex(rng, np.zeros(2), float(rng.uniform(0.3, 0.8)))
    return PolygonRobot(corners - corners.mean(axis=0))


def random_places(workspace: Workspace, robots: list[Robot], rng: np.random.Generator) -> np.ndarray:
    """Places for all robots, one after the other; ``ValueError`` if there is no room."""
    dof = max(robot.dof for robot in robots)
    places: list[np.ndarray] = []
    for i, _ in enumerate(robots):
        for _ in range(_TRIALS):
            place = np.concatenate([rng.uniform(0, 10, 2), rng.uniform(-np.pi, np.pi, 1)])[:dof]
            try:
                Problem(workspace, robots[: i + 1], [*places, place], [*places, place])
            except ValueError:
                continue
            places.append(place)
            break
        else:
            raise ValueError("There is no room.")
    return np.array(places)


def table(results: dict[str, Any]) -> str:
    rows = [["outcome", "problems"]]
    rows += [[name, f"{count:,}"] for name, count in sorted(results["outcomes"].items())]
    failures = "".join(f"problem {each['problem']}: {each['failure']}\n" for each in results["wrong"])
    return aligned(rows, 1) + failures
