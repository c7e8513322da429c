"""Routes of JuPedSim's router beside routes that are read from PLRs of cones."""

from typing import NamedTuple

import numpy as np
import shapely
from jaxtyping import Float

from experiments.environments.jupedsim import RADIUS as RADIUS
from experiments.environments.jupedsim import Points, jupedsim
from plr_jax import PLR, VisibilityGraph, Workspace, construct_many, trace

_SHALLOW = 1e-5  # meters: files round corners


class Routes(NamedTuple):
    """Paths, how long they are over the exact distance, and how deep they are inside walls at most."""

    paths: list[Points]
    over_exact: Float[np.ndarray, " n"]
    depth: Float[np.ndarray, " n"]

    @classmethod
    def of(cls, paths: list[Points], exact: Float[np.ndarray, " n"], area: Workspace) -> "Routes":
        """Measure paths, given the exact distances between their ends."""
        index = np.repeat(np.arange(len(paths)), [*map(len, paths)])
        lines = np.asarray(shapely.linestrings(np.concatenate(paths), indices=index))
        return cls(paths, shapely.length(lines) / exact, _depths(area, lines))


def routes_of_cones(cones: PLR, x: Points, area: Workspace) -> list[Points]:
    """Return the paths from points that are read from cones; ``ValueError`` if one crosses a wall."""
    traces = trace(cones, x, area)
    if not traces.arrived.all():
        raise ValueError(f"Of {len(x)} starts, {(~traces.arrived).sum()} have no free path in the file: use descend.")
    return [path[:count] for path, count in zip(traces.paths, traces.counts, strict=True)]


def compare_routes(
    area: Workspace, goals: Points, starts: Float[np.ndarray, "goals n 2"], max_bytes: int = 8192
) -> dict[str, Routes]:
    """Return routes to each goal from its own starts: those of JuPedSim's router, and those read from cones."""
    engine, first = jupedsim.RoutingEngine(area.free_space), VisibilityGraph(area, goals[0])
    oracles = [first, *map(first.with_goal, goals[1:])]
    cones = construct_many(oracles, area.bounds, leaf="cone", max_bytes=max_bytes)
    exact = np.concatenate([oracle(x) for oracle, x in zip(oracles, starts, strict=True)])
    theirs, ours = [], []
    for goal, some, plr in zip(goals, starts, cones, strict=True):
        theirs += [np.array(engine.compute_waypoints(tuple(start), tuple(goal))) for start in some]
        ours += routes_of_cones(plr, some, area)
    return {"JuPedSim": Routes.of(theirs, exact, area), "cones": Routes.of(ours, exact, area)}


def _depths(area: Workspace, lines: np.ndarray) -> Float[np.ndarray, " n"]:
    """Return the largest distance of each line's points to the walkable area, sampled every millimeter.

    Lines less than ``_SHALLOW`` outside count as inside.
    """
    grown = area.free_space.buffer(_SHALLOW)
    shapely.prepare(grown)
    depth, crossing = np.zeros(len(lines)), np.flatnonzero(~shapely.covers(grown, lines))
    outside = shapely.segmentize(shapely.difference(lines[crossing], area.free_space), 0.001)
    points = [shapely.points(shapely.get_coordinates(each)) for each in outside]
    depth[crossing] = [shapely.distance(area.free_space, each).max(initial=0.0) for each in points]
    return depth
