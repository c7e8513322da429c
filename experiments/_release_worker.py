"""Measure one release of the package in a process of its own: ``python -m experiments._release_worker``.

The working directory holds the ``plr_jax`` of that release. A request is a pickled name of a task with its arguments.
Each task returns CPU seconds and results. The answer is None if the release lacks a function that the task calls.
"""

import os
import pickle
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import plr_jax
from experiments._measures import timed

ROOT = Path(__file__).parents[1]
Answer = tuple[float, Any]


class Release:
    """Tasks by name. They call only functions that releases since 0.2.0 have, and check for later ones."""

    def __init__(self) -> None:
        self.plr: Any = None
        self.numpy_plr: Any = None
        self.pairs: Any = None

    def construct(self, leaf: str, max_bytes: int, certified: bool = False) -> Answer:
        """Build the floor plan's oracle and a PLR of it, and keep the PLR for queries."""
        workspace, goal = _floor_plan()
        options: dict[str, Any] = {"leaf": leaf, "max_bytes": max_bytes, "certified": certified}
        build = lambda: plr_jax.construct(plr_jax.VisibilityGraph(workspace, goal), workspace.bounds, **options)  # noqa: E731
        seconds, self.plr = timed(build)
        return seconds, self.plr.num_bytes

    def save(self, path: str) -> Answer:
        plr_jax.save(self.plr, path)
        self.numpy_plr = plr_jax.load_numpy(path)
        return 0.0, None

    def query(self, x: np.ndarray, calls: int, in_numpy: bool = False) -> Answer:
        plr = self.numpy_plr if in_numpy else self.plr
        return repeated(lambda: np.asarray(plr(x)), calls)

    def gap(self, x: np.ndarray) -> Answer:
        lower, upper = self.plr.bounds(x)
        return 0.0, np.asarray(upper - lower)

    def build_pairs(self, max_bytes: int) -> Answer:
        seconds, self.pairs = timed(lambda: plr_jax.construct_pairs(_floor_plan()[0], max_bytes=max_bytes))
        return seconds, self.pairs.num_bytes

    def query_pairs(self, x: np.ndarray, y: np.ndarray, calls: int) -> Answer:
        return repeated(lambda: np.asarray(self.pairs(x, y)), calls)

    def solve_eikonal(self, bounds: Any, wall: Any, goal: Any, costs: np.ndarray, x: np.ndarray) -> Answer:
        space = plr_jax.PlaneSpace(plr_jax.Workspace(bounds, [wall]))
        cost_map = plr_jax.RasterCost(costs, bounds)
        solve = lambda: plr_jax.solve_eikonal(space, goal, cost_map=cost_map, certified=False)  # noqa: E731
        seconds, plr = timed(solve)
        return seconds, np.asarray(plr(x))

    def cost_distance(self, costs: np.ndarray, sources: Any) -> Answer | None:
        if not hasattr(plr_jax, "cost_distance"):  # release 0.2.0
            return None
        return timed(lambda: plr_jax.cost_distance(costs, sources).distance)

    def plan(self, scene: str, size: Any, seed: int, is_first: bool) -> Answer:
        """Plan on a new map, from its obstacles to the path; ``is_first`` stops at the first path."""
        team = plr_jax.scenes.perturbed(getattr(plr_jax.scenes, scene)(*size), seed)
        bounds, obstacles, squeeze = team.workspace.bounds, team.workspace.obstacles, team.workspace.squeeze
        options = plr_jax.BLOptions(cost_factor=1e9) if is_first else plr_jax.BLOptions()

        def planned() -> Any:
            workspace = plr_jax.Workspace(bounds, obstacles, squeeze=squeeze)
            problem = plr_jax.Problem(workspace, team.robots, team.starts, team.goals, team.rotation_weight)
            return plr_jax.bl_plan(problem, None, options).path

        return timed(planned)


def _floor_plan() -> tuple[Any, Any]:
    problem = plr_jax.scenes.floor_plan()
    return problem.workspace, problem.goals[0]


def repeated(call: Callable[[], Any], calls: int) -> Answer:
    """Return the CPU seconds of one of several calls, and its answer."""
    seconds, answers = timed(lambda: [call() for _ in range(calls)])
    return seconds / calls, answers[-1]


class Worker:
    """A process that measures the release in ``folder``. Calling it runs a task and waits for the answer."""

    def __init__(self, folder: Path):
        self.folder = folder
        path = os.pathsep.join([str(folder), str(ROOT), *filter(None, [os.getenv("PYTHONPATH")])])
        self.process = subprocess.Popen(
            [sys.executable, "-m", "experiments._release_worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            cwd=folder,
            env=os.environ | {"PYTHONPATH": path},
        )
        self.version, source = self("about")
        if Path(source).parents[1] != folder:
            raise RuntimeError(f"{source} was imported instead of the release in {folder}.")

    def __call__(self, task: str, **arguments: Any) -> Any:
        process = self.process
        assert process.stdin is not None and process.stdout is not None
        try:
            pickle.dump((task, arguments), process.stdin)
            process.stdin.flush()
            return pickle.load(process.stdout)
        except (EOFError, BrokenPipeError):
            raise RuntimeError(f"{task} failed in {self.folder}; its error stands above.") from None

    def close(self) -> None:
        self.process.kill()
        self.process.communicate()


def main() -> None:
    """Answer requests until the other process closes the pipe."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # so that what libraries print does not come among the answers
    release = Release()
    while True:
        try:
            task, arguments = pickle.load(sys.stdin.buffer)
        except EOFError:
            return
        about = plr_jax.__version__, plr_jax.__file__
        pickle.dump(about if task == "about" else getattr(release, task)(**arguments), answers)
        answers.flush()


if __name__ == "__main__":
    main()
