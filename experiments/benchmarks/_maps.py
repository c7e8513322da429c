"""The maps of experiments, by name: scenes of the package, and published maps where ``PLR_JAX_DATA`` has them."""

import os
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from jaxtyping import Float

from plr_jax import Workspace, scenes

Map = tuple[Workspace, Float[np.ndarray, "2"]]
"""A workspace and a goal in it."""

_PUBLISHED = {
    "arena": ("polyanya_arena/arena_polygons.json", (1.0, 11.0)),
    "den312d": ("movingai/dao/den312d_polygons.json", None),
    "den520d": ("movingai/dao/den520d_polygons.json", None),
    "Berlin": ("movingai/street/Berlin_0_256.map", None),
}


def load_map(name: str) -> Map | None:
    """A map by name; None, with a message, if it is a published one whose data are absent."""
    if name not in _PUBLISHED:
        problem = {"maze": scenes.maze, "thin_maze": scenes.thin_maze, "floor_plan": scenes.floor_plan}[name]()
        return problem.workspace, problem.goals[0]
    file, goal = _PUBLISHED[name]
    path = Path(os.environ.get("PLR_JAX_DATA", "")) / file
    if "PLR_JAX_DATA" not in os.environ or not path.exists():
        print(f"{name}: skipped, PLR_JAX_DATA names no folder with {file}")
        return None
    workspace = scenes.read_map(path) if path.suffix == ".map" else scenes.read_polygons(path)
    return workspace, workspace.sample_free(1, seed=0)[0] if goal is None else np.array(goal)


def load_maps(names: Iterable[str]) -> dict[str, Map]:
    """Maps by name, without published ones whose data are absent, which is said."""
    maps = {name: load_map(name) for name in names}
    return {name: found for name, found in maps.items() if found is not None}
