"""What the workers of ``scale`` do, where processes find it by its name."""

import os
import signal
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from plr_jax import BuildOptions, DistanceFn, VisibilityGraph, construct_many, scenes
from plr_jax._types import Distances, Points

GOAL_SEED = 13


@dataclass(frozen=True)
class FatalOnce:
    """The distance to a goal in the open; the first process but the parent that asks for it is killed.

    Args:
        goal: The goal.
        marker: A file that is made when that has happened.
        parent: A process that is spared.
    """

    goal: tuple[float, ...]
    marker: Path
    parent: int

    def __call__(self, x: Points) -> Distances:
        """Distances of points."""
        if os.getpid() != self.parent and not self.marker.exists():
            self.marker.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return np.linalg.norm(x - self.goal, axis=1)


def family(scene: str, num_goals: int, seed: int) -> list[VisibilityGraph]:
    """Oracles of goals of a scene."""
    workspace = getattr(scenes, scene)().workspace
    goals = workspace.sample_free(num_goals, GOAL_SEED + seed)
    first = VisibilityGraph(workspace, goals[0])
    return [first, *(first.with_goal(goal) for goal in goals[1:])]


def files_of(oracles: list[DistanceFn], scene: str, leaf: str, max_bytes: int, **work: Any) -> list[bytes]:
    """Return the files of the PLRs of oracles, built by an ``executor``, if one is given."""
    domain, options = getattr(scenes, scene)().workspace.bounds, BuildOptions(**work)
    plrs = construct_many(oracles, domain, leaf=leaf, max_bytes=max_bytes, options=options)
    return [plr.to_bytes() for plr in plrs]
