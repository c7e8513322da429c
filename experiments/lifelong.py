"""Goals that keep coming: robots that arrive get their next goals while the others go on.

Discs at a door and in a crowd serve goals, drawn at random from free space, clear of the walls and of the goals of
the others. ``replanned``: ``lifelong``, which plans those that arrive among the others. ``from_nothing``: the same
loop, in which ``bl_plan`` plans the whole team for each new goal. All that robots do is checked, from the first row
to the last. Told are goals a minute of travel, at unit speed, and CPU seconds of what is done when robots arrive.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float

from experiments._runner import Section, run
from plr_jax import Problem, Solution, bl_plan, lifelong, scenes, validate
from plr_jax.planners import LifelongRun

GOALS, OF_NOTHING = 500, 100
_CLEAR = 0.05  # of a goal, from walls and from other goals

Goals = Float[np.ndarray, "robots 2"]


def replanned(seed: int, smoke: bool) -> dict[str, Any]:
    return _served(seed, smoke, GOALS)


def from_nothing(seed: int, smoke: bool) -> dict[str, Any]:
    return _served(seed, smoke, OF_NOTHING, bl_plan)


def _served(
    seed: int, smoke: bool, num_goals: int, plan: Callable[[Problem], Solution] | None = None
) -> dict[str, Any]:
    teams = {"door": scenes.door(4 if smoke else 20), "crowd": scenes.crowd(4 if smoke else 50, seed)}
    rows = []
    for name, problem in teams.items():
        found = lifelong(problem, stream(problem, seed), 8 if smoke else num_goals, plan=plan)
        rows.append({"scene": name, "robots": len(problem.robots), **_measured(found)})
    return {"rows": rows}


def stream(problem: Problem, seed: int) -> Callable[[int, Goals], Float[np.ndarray, "2"]]:
    """Random goals of discs, that are free."""
    rng, workspace = np.random.default_rng(seed), problem.workspace

    def next_goal(i: int, others: Goals) -> Float[np.ndarray, "2"]:
        radius = problem.robots[i].inscribed_radius
        while True:
            goal = rng.uniform(workspace.bounds.lo, workspace.bounds.hi)
            is_apart = np.hypot(*(others - goal).T).min() >= 2 * radius + _CLEAR
            if is_apart and workspace.clearance(goal[None])[0] >= radius + _CLEAR:
                return goal

    return next_goal


def _measured(found: LifelongRun) -> dict[str, Any]:
    report, milliseconds = validate(found.problem, found.path), 1e3 * found.seconds
    minutes = found.times[found.rows] / 60
    return {
        "goals": len(found.rows),
        "status": found.status.name,
        "valid": report.valid,
        "clearance": report.clearance,
        "motions": len(found.path) - 1,
        "least goals of a robot": int(np.bincount(found.robots, minlength=len(found.problem.robots)).min()),
        "minutes of travel": float(minutes[-1]),
        "goals a minute": len(minutes) / float(minutes[-1]),
        "of the first 100": min(len(minutes), OF_NOTHING) / float(minutes[:OF_NOTHING][-1]),
        "replans": len(milliseconds),
        "from nothing": found.num_from_nothing,
        "ms": float(np.median(milliseconds)),
        "ms, 95 %": float(np.percentile(milliseconds, 95)),
        "ms at most": float(milliseconds.max()),
    }


SECTIONS = {each.__name__: Section(each) for each in (replanned, from_nothing)}

if __name__ == "__main__":
    run("lifelong", __doc__, SECTIONS)
