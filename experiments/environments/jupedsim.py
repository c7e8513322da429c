"""JuPedSim (package ``jupedsim``) with agents that walk where a PLR of cones says.

``evacuate(area, exits, starts, is_steered=True)`` sets the targets of all agents every 0.1 s. Paths keep the agents'
radius from walls, and have sharp corners.
"""

from collections.abc import Sequence
from importlib import import_module
from itertools import chain
from typing import Any, NamedTuple

import numpy as np
import shapely
from jaxtyping import Float, Int

from plr_jax import NearestGoal, VisibilityGraph, Workspace, construct, trace

jupedsim: Any = import_module("jupedsim")  # type checkers take the name for this very file
RADIUS = 0.2
"""Radius of an agent in meters, JuPedSim's default."""
_STEPS = 10  # steps of the simulation, of 0.01 s, from one steering to the next
Points = Float[np.ndarray, "n 2"]


class Exits:
    """Exits of a walkable area, convex polygons, and one PLR of cones of the distance to the nearest centroid."""

    def __init__(self, area: Workspace, polygons: Sequence[Any], max_bytes: int = 8192):
        self.polygons = list(map(shapely.Polygon, polygons))
        centers = [np.array(polygon.centroid.coords[0]) for polygon in self.polygons]
        inset = Workspace.from_polygons(area.free_space.buffer(-RADIUS, join_style="mitre"))
        first: Any = VisibilityGraph(inset, centers[0])
        nearest = NearestGoal([first, *map(first.with_goal, centers[1:])])
        self.cones = construct(nearest, area.bounds, leaf="cone", max_bytes=max_bytes)

    def targets(self, x: Points) -> tuple[Int[np.ndarray, " n"], Points]:
        """Return the index of the nearest exit of each point, and the first corner on the path there, or the exit.

        Walls push agents back, so an agent may never arrive at a corner. Corners within ``RADIUS`` do not count.
        """
        paths = trace(self.cones, x).paths
        is_ahead = np.linalg.norm(paths - x[:, None], axis=2) > RADIUS
        index = np.where(is_ahead.any(axis=1), is_ahead.argmax(axis=1), -1)
        return np.asarray(self.cones.which(x)), paths[np.arange(len(x)), index]


class Evacuation(NamedTuple):
    """Times in seconds at which agents left, in ascending order, and positions of agents that never did."""

    seconds: Float[np.ndarray, " left"]
    stuck: Points


def evacuate(area: Workspace, exits: Exits, starts: Points, *, is_steered: bool, limit: float = 900.0) -> Evacuation:
    """Simulate agents until all have left, or for ``limit`` seconds; all walk to their nearest exit.

    If they are not steered by cones, each follows a journey of JuPedSim, whose only stage is this exit.
    """
    simulation = jupedsim.Simulation(model=jupedsim.CollisionFreeSpeedModel(), geometry=area.free_space)
    stages = [simulation.add_exit_stage(polygon) for polygon in exits.polygons]
    if is_steered:
        stages = [simulation.add_direct_steering_stage()] * len(exits.polygons)
    journeys = {stage: simulation.add_journey(jupedsim.JourneyDescription([stage])) for stage in stages}
    row = {}
    for position, stage in zip(starts.tolist(), np.array(stages)[exits.targets(starts)[0]].tolist(), strict=True):
        where = {"position": tuple(position), "journey_id": journeys[stage], "stage_id": stage}
        row[simulation.add_agent(jupedsim.CollisionFreeSpeedModelAgentParameters(radius=RADIUS, **where))] = len(row)
    seconds, x = [], starts.copy()  # rows of agents that have left stay: JAX compiles for each new number of rows
    while (count := simulation.agent_count()) and simulation.elapsed_time() < limit:
        if is_steered:
            for number in chain.from_iterable(map(simulation.agents_in_polygon, exits.polygons)):
                simulation.mark_agent_for_removal(number)
            for agent in simulation.agents():
                x[row[agent.id]] = agent.position
            _, targets = exits.targets(x)
            for agent in simulation.agents():
                agent.target = tuple(targets[row[agent.id]].tolist())
        simulation.iterate(_STEPS)
        seconds += [simulation.elapsed_time()] * (count - simulation.agent_count())
    return Evacuation(np.array(seconds), np.reshape([agent.position for agent in simulation.agents()], (-1, 2)))
