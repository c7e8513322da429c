"""Write small files of all kinds, with the answers that the release which writes them gives.

Run this script before a release, and commit the folder that it writes, ``tests/files_of_releases/VERSION``:

    PYTHONPATH=.:tests python tests/release_files.py

``test_release_files.py`` tests that all later releases read the files and give the same answers. The script also runs
with release 0.2, which wrote the folder ``0.2.0``. A table ``answers.json`` has, for each file, the arguments of the
queries, the answers and the proven bounds if there are any, as hexadecimal floats.
"""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import plr_jax
from plr_jax import scenes

FOLDER = Path(__file__).parent / "files_of_releases"
QUERIES = 20
MAZE = scenes.maze()
ROOMS = np.ones((6, 9), bool)
ROOMS[1:5, 4] = ROOMS[3, 5:8] = False


def maze_oracle() -> Any:
    return plr_jax.VisibilityGraph(MAZE.workspace, MAZE.goals[0])


def maze(**options: Any) -> Any:
    return plr_jax.construct(maze_oracle(), MAZE.workspace.bounds, **options)


def car() -> Any:
    domain = plr_jax.Box((-2, -2, -np.pi), (2, 2, np.pi), periodic=(False, False, True))
    return plr_jax.construct(plr_jax.ReedsShepp((0, 0, 0), 0.5), domain, leaf="continuous", max_bytes=300)


def costs(**options: Any) -> Any:
    slow = plr_jax.RasterCost(np.linspace(1, 3, 24).reshape(4, 6), bounds=((0, 0), (6, 4)))
    return plr_jax.solve_eikonal(slow.space(radius=0.3), (5, 1), cost_map=slow, **options)


def metric() -> Any:
    def length(x: Any, y: Any) -> Any:
        return np.linalg.norm(np.asarray(x) - y, axis=-1)

    return plr_jax.construct_metric_pairs(length, plr_jax.Box((0,), (1,)), max_bytes=300).plr


def grid(connectivity: int) -> Any:
    return plr_jax.construct_grid_pairs(plr_jax.GridGraph(ROOMS, (0.5, 0.5), connectivity=connectivity))


def exits() -> Any:
    first = maze_oracle()
    oracle = plr_jax.NearestGoal([first, first.with_goal((0.05, 0.95))])
    return plr_jax.construct(oracle, MAZE.workspace.bounds, leaf="cone", max_bytes=400, certified=True)


def building() -> Any:
    floor = plr_jax.Workspace(((0, 0), (6, 4)), [[(2, 0), (3, 0), (3, 3), (2, 3)]])
    return plr_jax.Building([floor, floor], [plr_jax.Link((0, (1, 1)), (1, (1, 1)), cost=5)])


def cut_off() -> Any:
    walls = [[(3, 0), (3.2, 0), (3.2, 4), (3, 4)]]
    workspace = plr_jax.Workspace(((0, 0), (6, 4)), walls)
    return plr_jax.construct(
        plr_jax.VisibilityGraph(workspace, (1, 1)), workspace.bounds, leaf="plane", max_bytes=300
    )


FILES: dict[str, Callable[[], Any]] = {
    "planes": lambda: maze(max_bytes=300),
    "continuous": lambda: maze(leaf="continuous", max_bytes=300),
    "smooth": lambda: maze(leaf="smooth", max_bytes=300, certified=True),
    "cones": lambda: maze(leaf="cone", max_bytes=500, certified="leaves"),
    "car": car,
    "costs": lambda: costs(max_bytes=1000),
    "estimate": lambda: costs(certified=False, max_bytes=500),
    "metric": metric,
    "pairs": lambda: plr_jax.construct_pairs(MAZE.workspace, max_bytes=600),
    "grid_4": lambda: grid(4),
    "grid_8": lambda: grid(8),
}
SINCE_0_3: dict[str, Callable[[], Any]] = {
    "exits": exits,
    "cut_off": cut_off,
    "building": lambda: building().oracle(0, (5, 1)).construct(max_bytes=400, certified=True),
    "building_pairs": lambda: plr_jax.construct_pairs(building(), max_bytes=400),
}


def queries(kind: str, plr: Any) -> list[np.ndarray]:
    """Return the arguments of a call: points, or pairs of points, or floors and points."""
    rng = np.random.default_rng(0)
    lo, hi = (np.zeros(2), np.array([6.0, 4.0])) if "building" in kind else (plr.domain.lo, plr.domain.hi)
    points = [lo + rng.random((QUERIES, len(lo))) * (hi - lo) for _ in range(2)]
    floors = [rng.integers(0, 2, QUERIES) for _ in range(2)]
    return {"building": [floors[0], points[0]], "building_pairs": [*floors, *points]}.get(
        kind, points if kind in ("pairs", "grid_4", "grid_8") else points[:1]
    )


def answers(kind: str, plr: Any, arguments: list[np.ndarray]) -> dict[str, np.ndarray]:
    """Return the answers of a call at 32-bit points, and proven bounds."""
    given = [each.astype(np.float32) if each.dtype == float else each for each in arguments]
    if kind == "building_pairs":
        given = [(given[0], given[2]), (given[1], given[3])]  # places are pairs of a floor and a point
    found = {"answer": plr(*given)}
    if getattr(plr, "max_error", None) is not None or kind == "pairs":
        found["lower"], found["upper"] = plr.bounds(*given)
    return {name: np.asarray(values) for name, values in found.items()}


def to_hex(values: np.ndarray) -> Any:
    return [to_hex(row) for row in values] if np.ndim(values) else float(values).hex()


def from_hex(values: Any) -> Any:
    return [from_hex(row) for row in values] if isinstance(values, list) else float.fromhex(values)


def main() -> None:
    folder = FOLDER / plr_jax.__version__
    folder.mkdir(parents=True, exist_ok=True)
    table = {}
    for kind, make in (FILES | (SINCE_0_3 if hasattr(plr_jax, "Building") else {})).items():
        plr_jax.save(make(), folder / f"{kind}.plr")
        plr = plr_jax.load(folder / f"{kind}.plr")
        arguments = queries(kind, plr)
        found = answers(kind, plr, arguments)
        table[kind] = {"arguments": [to_hex(each) for each in arguments]}
        table[kind] |= {name: to_hex(values) for name, values in found.items()}
    lines = [f"{json.dumps(kind)}: {json.dumps(row)}" for kind, row in table.items()]
    (folder / "answers.json").write_text("{\n" + ",\n".join(lines) + "\n}\n")
    problem = scenes.single_door()
    scenes.save(problem, folder / "scene.json")
    plr_jax.bl_plan(problem).save(folder / "solution.json")


if __name__ == "__main__":
    main()
