"""The last steps of a placement, without gradients: costs have kinks, and the cheapest places are often there.

A median may be a corner of a wall or a demand point; a center has several points equally far away. So each facility
is moved to the best of some places around, or to a corner, a demand point or a wall nearby, as long as the demand
that is its own costs less from there; else its search goes on around a smaller circle.
"""

from typing import Any

import numpy as np
import shapely
from jaxtyping import Float, Int

from plr_jax.optimize.placement.costs import LocationProblem, PlacementObjective, pair_distances, slopes_at
from plr_jax.optimize.placement.moves import moved

_DIRECTIONS = 8
_TURN = np.pi * (3 - np.sqrt(5))  # the golden angle, by which directions differ from round to round
_LEAST_GAIN = 1e-7
"""Of a facility's cost: less is the rounding of distances in 32 bits."""

Facilities = Float[np.ndarray, "k 2"]
Radii = Float[np.ndarray, "k"]


def searched(problem: LocationProblem, x: Facilities, radius: Radii, turn: int) -> tuple[Facilities, Radii]:
    """Every facility at the best place around, or else with a smaller circle to be searched next."""
    nearest, facility = problem.distances(x).argmin(axis=0), np.arange(len(x))
    places = _places(problem, x, radius, nearest, turn)
    distances = pair_distances(problem.distance, places[nearest], problem.points[:, None])
    costs = problem.objective.over_groups(problem.weights[:, None] * distances, nearest, len(x))
    best = costs.argmin(axis=1)
    gains = costs[facility, best] < (1 - _LEAST_GAIN) * costs[:, 0]  # of the first place, where it is
    return np.where(gains[:, None], places[facility, best], x), np.where(gains, radius, radius / 2)


def _places(
    problem: LocationProblem, x: Facilities, radius: Radii, nearest: Int[np.ndarray, "n"], turn: int
) -> Float[np.ndarray, "k places 2"]:
    """Where each facility is, and places that it can go to straight; instead of those it cannot, where it is."""
    angle = _TURN * turn + 2 * np.pi / _DIRECTIONS * np.arange(_DIRECTIONS)
    circle = radius[:, None, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    here = x[:, None]
    tried = [here, here + circle, _kinks(problem, x, nearest)]
    if problem.objective is PlacementObjective.MAX:
        tried.append(moved(problem.workspace, x, _minimax_steps(problem, x, radius, nearest))[:, None])
    places = np.concatenate(tried, axis=1)
    from_here = np.broadcast_to(here, places.shape)
    visible = problem.workspace.is_visible(from_here.reshape(-1, 2), places.reshape(-1, 2))
    return np.where(visible.reshape(*places.shape[:2], 1), places, from_here)


def _kinks(problem: LocationProblem, x: Facilities, nearest: Int[np.ndarray, "n"]) -> Float[np.ndarray, "k 3 2"]:
    """The nearest corner, demand point of its own, and point of a wall, of each facility."""
    vertices, walls = problem.workspace.boundary.vertices, problem.workspace.walls
    corner = vertices[_squares(x, vertices).argmin(axis=1)]
    own = nearest == np.arange(len(x))[:, None]
    point = problem.points[np.where(own, _squares(x, problem.points), np.inf).argmin(axis=1)]
    points: Any = shapely.points(x)
    wall = shapely.get_coordinates(shapely.shortest_line(points, walls)).reshape(-1, 2, 2)[:, 1]
    return np.stack([corner, point, wall], axis=1)


def _minimax_steps(
    problem: LocationProblem, x: Facilities, radius: Radii, nearest: Int[np.ndarray, "n"]
) -> Float[np.ndarray, "k 2"]:
    """The step of each facility by which the largest cost of its demand falls most, as costs change at first.

    A linear program each, within a square.
    """
    from scipy.optimize import linprog

    distances, slopes = slopes_at(problem.distance, x[nearest], problem.points)
    costs, slopes = problem.weights * distances, problem.weights[:, None] * slopes
    steps = np.zeros_like(x)
    for facility in np.unique(nearest):
        own = nearest == facility
        upper = np.column_stack([slopes[own], -np.ones(own.sum())])
        bounds = [(-radius[facility], radius[facility])] * 2 + [(None, None)]
        found = linprog([0, 0, 1], upper, -costs[own], bounds=bounds)
        if found.success:
            steps[facility] = found.x[:2]
    return steps


def _squares(x: Facilities, y: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "k n"]:
    return ((x[:, None] - y) ** 2).sum(axis=-1)
