"""CPU seconds of a new process from its start to its first answers, beside other libraries; and other small costs.

``fresh``: each task runs in a Python process of its own, which imports, compiles, builds and answers. ``certified``:
construction with a proof beside construction without. ``one_query``: one exact distance a call. ``pair_queries``:
batches of pairs on large maps. All seconds are user and system time of all cores.

The Python of an environment that ``PLR_JAX_EXACT_RIVALS`` names runs pyvisgraph and extremitypathfinder; see
``benchmarks/_exact_rivals.py``.
"""

import json
import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import shapely

from experiments._measures import relative_errors, timed
from experiments._runner import Section, run
from experiments.benchmarks._maps import load_maps
from experiments.benchmarks._oracle import RIVALS_PYTHON, polygon_field, polygons_of
from experiments.costs import BOUNDS, GOAL, WALL, converged, rasters
from plr_jax import PlaneSpace, VisibilityGraph, Workspace, construct, construct_many, construct_pairs, scenes

NUM_QUERIES, TURNS = 1_000, 3
ROOT = Path(__file__).parents[1]
FAMILY, NUM_SINGLE, NUM_PAIRS = 100, 300, 100_000


class Task(NamedTuple):
    """One way to answer a question: a program that reads ``given`` and leaves its answers in ``found``."""

    question: str
    by: str
    program: str
    is_exact_rival: bool = False


_BEFORE = """
import json, sys
import numpy as np
given = json.load(open(sys.argv[1]))
polygons = given.pop("polygons")
given = {name: np.array(values) for name, values in given.items()}
"""
_AFTER = "\nprint(json.dumps(np.asarray(found, float).tolist()))"
_MAZE = "import plr_jax; w = plr_jax.scenes.maze().workspace; goal = (0.06, 0.07); "
_PLR = _MAZE + "plr = plr_jax.construct(plr_jax.VisibilityGraph(w, goal), w.bounds, {}); found = plr(given['x'])"
_NODES = """
from scipy.ndimage import distance_transform_edt, map_coordinates
n = 256
p = (np.arange(n) + 0.5) / n
free = np.ones((n, n), bool)
for x0, y0, x1, y1 in given['walls']:
    free &= ~((p[:, None] > y0) & (p[:, None] < y1) & (p > x0) & (p < x1))
from_goal = np.hypot(p - 0.06, p[:, None] - 0.07)
"""
_FILL = """
def filled(values, blocked):  # walls get the value of the nearest free node
    nearest = distance_transform_edt(blocked, return_distances=False, return_indices=True)
    return values[tuple(nearest)]
"""
_READ = "found = map_coordinates(filled({}, ~free), given['x'].T[::-1] * n - 0.5, order=1, mode='nearest')"
_LINKS = """
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra
number, links = np.arange(free.size).reshape(free.shape), []
low, high, all_ = slice(None, -1), slice(1, None), slice(None)
for a, b, beside, length in (
    ((all_, low), (all_, high), (), 1), ((low, all_), (high, all_), (), 1),
    ((low, low), (high, high), ((low, high), (high, low)), 2**0.5),
    ((high, low), (low, high), ((low, low), (high, high)), 2**0.5),
):
    is_open = free[a] & free[b] & (np.logical_or.reduce([free[each] for each in beside]) if beside else True)
    links.append((number[a][is_open], number[b][is_open], np.full(is_open.sum(), length)))
i, j, length = map(np.concatenate, zip(*links))
graph = coo_array((length, (i, j)), (free.size, free.size)).tocsr()
"""
_EXTREMITYPATHFINDER = """
from extremitypathfinder import PolygonEnvironment
environment = PolygonEnvironment()
environment.store(polygons["outer"], polygons["holes"])
found = [environment.find_shortest_path(tuple(x), tuple(y), verify=False)[1] for x, y in zip(given['x'], {})]
"""
_PYVISGRAPH = """
from math import dist
from pyvisgraph import Point, VisGraph
graph = VisGraph()
graph.build([[Point(*vertex) for vertex in ring] for ring in polygons["obstacles"]], status=False)
paths = [graph.shortest_path(Point(*x), Point(*y)) for x, y in zip(given['x'], {})]
found = [sum(dist((a.x, a.y), (b.x, b.y)) for a, b in zip(path, path[1:])) for path in paths]
"""
_OMPL = """
from ompl import base, geometric, util
util.setLogLevel(util.LogLevel.LOG_ERROR)
space = base.RealVectorStateSpace(2)
bounds = base.RealVectorBounds(2)
bounds.setLow(0)
bounds.setHigh(1)
space.setBounds(bounds)
walls = given['walls'].tolist()
setup = geometric.SimpleSetup(space)
setup.setStateValidityChecker(
    lambda q: not any(x0 < q[0] < x1 and y0 < q[1] < y1 for x0, y0, x1, y1 in walls)
)
start, goal = space.allocState(), space.allocState()
start[0], start[1], goal[0], goal[1] = 0.93, 0.95, 0.06, 0.07
setup.setStartAndGoalStates(start, goal)
objective = base.PathLengthOptimizationObjective(setup.getSpaceInformation())
objective.setCostThreshold(base.Cost(float("inf")))  # the first path will do
setup.setOptimizationObjective(objective)
setup.setPlanner(geometric.BITstar(setup.getSpaceInformation()))
setup.solve(10.0)
setup.simplifySolution()
found = [setup.getSolutionPath().length()]
"""

_POINT, _PAIR = "maze, one goal, 1,000 points", "maze, 1,000 pairs of points"
_PATH, _COST, _GRID = (
    "maze, length of one path",
    "costs of 200 x 100 cells and a wall, 1,000 points",
    "free cells of 11 x 11, all cells",
)

TASKS = (
    Task(_POINT, "planes, 2,048 bytes", _PLR.format("max_bytes=2048")),
    Task(_POINT, "continuous, 2,048 bytes", _PLR.format("leaf='continuous', max_bytes=2048")),
    Task(
        _POINT,
        "certified cones, 1,024 bytes, and bounds",
        _PLR.format("leaf='cone', max_bytes=1024, certified=True") + "; plr.bounds(given['x'])",
    ),
    Task(_POINT, "VisibilityGraph", _MAZE + "found = plr_jax.VisibilityGraph(w, goal)(given['x'])"),
    Task(
        _POINT,
        "scikit-fmm, 256 x 256 cells",
        _NODES
        + _FILL
        + "import skfmm\n"
        + "time = skfmm.travel_time(np.ma.MaskedArray(from_goal - 1.5 / n, ~free), np.ones((n, n)), dx=1 / n)\n"
        + _READ.format("time.data + 1.5 / n"),
    ),
    Task(
        _POINT,
        "SciPy, Dijkstra over 256 x 256 cells",
        _NODES
        + _FILL
        + _LINKS
        + "cost = dijkstra(graph, directed=False, indices=number[int(0.07 * n), int(0.06 * n)]).reshape(n, n) / n\n"
        + _READ.format("cost"),
    ),
    Task(_POINT, "extremitypathfinder", _EXTREMITYPATHFINDER.format("[(0.06, 0.07)] * len(given['x'])"), True),
    Task(_POINT, "pyvisgraph", _PYVISGRAPH.format("[(0.06, 0.07)] * len(given['x'])"), True),
    Task(
        _PAIR,
        "pairs, 1,024 bytes",
        _MAZE + "found = plr_jax.construct_pairs(w, max_bytes=1024)(given['x'], given['y'])",
    ),
    Task(_PAIR, "extremitypathfinder", _EXTREMITYPATHFINDER.format("given['y']"), True),
    Task(_PAIR, "pyvisgraph", _PYVISGRAPH.format("given['y']"), True),
    Task(_PATH, "VisibilityGraph", _MAZE + "found = plr_jax.VisibilityGraph(w, goal)([(0.93, 0.95)])"),
    Task(_PATH, "OMPL, first path of BIT*, simplified", _OMPL),
    Task(
        _COST,
        "solve_eikonal, estimate",
        f"import plr_jax; space = plr_jax.PlaneSpace(plr_jax.Workspace({BOUNDS}, [{WALL}])); "
        f"costs = plr_jax.RasterCost(given['costs'], {BOUNDS}); "
        f"plr = plr_jax.solve_eikonal(space, {GOAL.tolist()}, cost_map=costs, certified=False); "
        "found = plr(given['of_costs'])",
    ),
    *(
        Task(
            _COST,
            f"scikit-fmm, {parts} x {parts} nodes a cell",
            "import skfmm\n"
            "from scipy.ndimage import distance_transform_edt, map_coordinates\n"
            f"parts, step = {parts}, 0.01 / {parts}\n"
            + _FILL
            + "y, x = (np.mgrid[: 100 * parts, : 200 * parts] + 0.5) * step\n"
            "costs = map_coordinates(given['costs'], [100 * y - 0.5, 100 * x - 0.5], order=1, mode='nearest')\n"
            "blocked = (x > 0.9) & (x < 1.0) & (y < 0.6)\n"
            "front = np.ma.MaskedArray(np.hypot(x - 0.2, y - 0.2) - 1.5 * step, blocked)\n"
            "time = skfmm.travel_time(front, 1 / costs, dx=step).data + 1.5 * step * costs[20 * parts, 20 * parts]\n"
            "at = given['of_costs'].T[::-1] / step - 0.5\n"
            "found = map_coordinates(filled(time, blocked), at, order=1, mode='nearest')",
        )
        for parts in (1, 3, 5)
    ),
    Task(
        _GRID,
        "grid_distance",
        "import plr_jax; found = plr_jax.grid_distance(given['free'], (1.5, 1.5)).cells",
    ),
    Task(
        _GRID,
        "SciPy, Dijkstra with 8 moves",
        "free = given['free']"
        + _LINKS
        + "found = dijkstra(graph, directed=False, indices=number[1, 1]).reshape(free.shape)",
    ),
)


def fresh(seed: int, smoke: bool) -> dict[str, Any]:
    given, truth = _questions(seed, smoke)
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "given.json")
        path.write_text(json.dumps(given), encoding="utf-8")
        for task in TASKS[::6] if smoke else TASKS:
            python = os.environ.get(RIVALS_PYTHON) if task.is_exact_rival else sys.executable
            if python is None:
                print(f"{task.by}: skipped, {RIVALS_PYTHON} names no Python that has it")
                continue
            runs = [run_fresh(python, task.program, path) for _ in range(1 if smoke else TURNS)]
            true = truth[task.question].ravel()
            known = np.isfinite(true) & (true > 0)
            errors = relative_errors(np.ravel(runs[0][1])[known], true[known])
            rows.append(
                {
                    "question": task.question,
                    "by": task.by,
                    "cpu_seconds": float(np.median([cpu for cpu, _ in runs])),
                    **errors,
                }
            )
    return {"queries": NUM_QUERIES, "turns": TURNS, "rows": rows}


def _questions(seed: int, smoke: bool) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Return what all programs are given, and the true answers to each question."""
    problem = scenes.maze()
    oracle = VisibilityGraph(problem.workspace, problem.goals[0])
    x, y = problem.workspace.sample_free(2 * NUM_QUERIES, seed + 5).reshape(2, -1, 2)
    space, costs = PlaneSpace(Workspace(BOUNDS, [WALL])), rasters(seed)["noise 10"]
    of_costs = space.workspace.sample_free(NUM_QUERIES, seed + 6)
    free = np.random.default_rng(seed).random((11, 11)) < 0.75
    free[1, 1] = True
    cells = np.stack(np.meshgrid(np.arange(11) + 0.5, np.arange(11) + 0.5), axis=-1).reshape(-1, 2)
    blocked = [[(j, i), (j + 1, i), (j + 1, i + 1), (j, i + 1)] for i, j in np.argwhere(~free)]
    of_cells = VisibilityGraph(Workspace(((0, 0), (11, 11)), blocked), (1.5, 1.5))
    given = {
        "x": x,
        "y": y,
        "walls": [shapely.bounds(wall) for wall in problem.workspace.obstacles],
        "of_costs": of_costs,
        "costs": costs.values,
        "free": free,
    }
    truth = {
        _POINT: oracle(x),
        _PAIR: oracle.between(x, y),
        _PATH: oracle(problem.starts),
        _COST: converged(space, costs, of_costs, 200 if smoke else 1_600)[0],
        _GRID: np.where(free.ravel(), of_cells(cells), np.inf),
    }
    lists = {name: np.asarray(each).tolist() for name, each in given.items()}
    return {**lists, "polygons": polygons_of(problem.workspace, oracle.goal)}, truth


def run_fresh(python: str, program: str, given: Path, folder: Path = ROOT) -> tuple[float, np.ndarray]:
    """Run a program in a new process, which imports the package of a folder; return its CPU seconds and results."""
    begun = _cpu_of_children()
    # Bytecode is kept, as for users; compiled programs are not.
    absent = "JAX_COMPILATION_CACHE_DIR", "PYTHONDONTWRITEBYTECODE"
    environment = {name: each for name, each in os.environ.items() if name not in absent}
    ran = subprocess.run(
        [python, "-c", _BEFORE + program + _AFTER, given],
        capture_output=True,
        text=True,
        env=environment,
        cwd=folder,
        check=False,
    )
    if ran.returncode != 0:
        raise RuntimeError(f"A task failed:\n{program}\n{ran.stderr}")
    return _cpu_of_children() - begun, np.array(json.loads(ran.stdout.splitlines()[-1]), float)


def _cpu_of_children() -> float:
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def certified(seed: int, smoke: bool) -> dict[str, Any]:
    sizes = {"maze": (1_024,), "den520d": (8_192, 32_768)}
    rows = []
    for name, (workspace, goal) in load_maps(["maze"] if smoke else sizes).items():
        for max_bytes in sizes[name]:

            def build(is_certified: bool, workspace=workspace, goal=goal, max_bytes=max_bytes):
                oracle = VisibilityGraph(workspace, goal)
                construct(oracle, workspace.bounds, leaf="cone", max_bytes=max_bytes, certified=is_certified)

            rows.append({"map": name, "bytes": max_bytes, **_with_and_without(build, smoke)})
    maze = scenes.maze()
    workspace, goal = maze.workspace, maze.goals[0]
    oracle, goals = VisibilityGraph(workspace, goal), workspace.sample_free(2 if smoke else FAMILY, seed + 3)

    def build_all(is_certified: bool):
        oracles = [oracle.with_goal(goal) for goal in goals]
        construct_many(oracles, workspace.bounds, leaf="cone", max_bytes=1_024, certified=is_certified)

    rows.append({"map": f"maze, {len(goals)} goals", "bytes": 1_024, **_with_and_without(build_all, smoke)})
    return {"rows": rows}


def _with_and_without(build: Callable[[bool], None], smoke: bool) -> dict[str, float]:
    """Return CPU seconds of builds without and with a proof, in turns, and their ratio."""
    build(False)  # warm up
    seconds = [
        [timed(lambda proof=proof: build(proof))[0] for proof in (False, True)] for _ in range(1 + 2 * (not smoke))
    ]
    without, with_proof = np.median(seconds, axis=0).tolist()
    return {"cpu_without": without, "cpu_with": with_proof, "ratio": with_proof / without}


def one_query(seed: int, smoke: bool) -> dict[str, Any]:
    maps = load_maps(["maze"] if smoke else ["maze", "den520d"])
    return {"rows": [{"map": name, **_milliseconds_alone(*each, seed)} for name, each in maps.items()]}


def _milliseconds_alone(workspace: Workspace, goal: np.ndarray, seed: int) -> dict[str, float]:
    """Return CPU milliseconds of one exact distance to a goal, and between two points, one a call."""
    oracle, x = VisibilityGraph(workspace, goal), workspace.sample_free(2 * NUM_SINGLE, seed + 5)
    pairs = list(zip(x[:NUM_SINGLE, None], x[NUM_SINGLE:, None], strict=True))
    for points in (x[:1], x):  # what an oracle prepares once for all queries does not count
        oracle(points)
        oracle.between(points, points[::-1])
    to_goal, _ = timed(lambda: [oracle(point) for point, _ in pairs])
    between, _ = timed(lambda: [oracle.between(*pair) for pair in pairs])
    return {"goal_ms": to_goal / len(pairs) * 1e3, "between_ms": between / len(pairs) * 1e3}


def pair_queries(seed: int, smoke: bool) -> dict[str, Any]:
    """Microseconds a pair of points, in batches, of all cores."""
    maps = {name: each[0] for name, each in load_maps(["maze"] if smoke else ["maze", "den520d"]).items()}
    if not smoke:
        maps["field of 3,000 vertices"] = polygon_field(3_000, seed)[0]
    rows, num_pairs = [], 1_000 if smoke else NUM_PAIRS
    for name, workspace in maps.items():
        build, pairs = timed(lambda workspace=workspace: construct_pairs(workspace, max_bytes=2**20))
        x, y = workspace.sample_free(2 * num_pairs, seed + 1).reshape(2, -1, 2)
        query = lambda pairs=pairs, x=x, y=y: pairs(x, y).block_until_ready()  # noqa: E731
        first, _ = timed(query)
        seconds = np.median([timed(query)[0] for _ in range(TURNS)])
        rows.append(
            {
                "map": name,
                "bytes": pairs.num_bytes,
                "cpu_build": build,
                "cpu_first_batch": first,
                "us": float(seconds) / num_pairs * 1e6,
            }
        )
    return {"pairs": num_pairs, "rows": rows}


SECTIONS = {each.__name__: Section(each) for each in (fresh, certified, one_query, pair_queries)}

if __name__ == "__main__":
    run("first_answers", __doc__, SECTIONS)
