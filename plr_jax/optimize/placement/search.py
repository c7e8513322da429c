"""The search for facilities without gradients: where descent starts, its steps in free space, and the last ones.

Draws are those of k-means++, by distances and not their squares: a point is drawn with a probability in proportion to
what it costs under the points drawn before, or, for the largest cost, is the costliest. Then one facility at a time
is exchanged for a point by which the cost falls (Teitz and Bart, 1968), until it falls no more. Of many demand points
only some are sites, at which facilities may start.
"""

from typing import Any

import numpy as np
import shapely
from jaxtyping import Float, Int

from plr_jax.geometry.workspace import Workspace
from plr_jax.optimize.placement.costs import LocationProblem, PlacementObjective, pair_distances, pair_slopes

# Steps in free space: what is blocked by a wall turns aside, is shortened, or is not taken.


_ANGLES = np.deg2rad([20, 40, 60, 80])
_SHORTER = (0.5, 0.25)


def _detours() -> Float[np.ndarray, "detours 2 2"]:
    """Linear maps of a step to those tried in its place: turned, as long as it is in that direction, or shortened."""
    turned = [
        np.cos(angle) * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        for angle in np.concatenate([_ANGLES, -_ANGLES])
    ]
    tried = [*turned, *(share * np.eye(2) for share in _SHORTER)]
    return np.array(sorted(tried, key=lambda each: -each[0, 0]))  # by how far they go where the step would


_DETOURS = _detours()


def moved(
    workspace: Workspace, x: Float[np.ndarray, "n 2"], step: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "n 2"]:
    """Free points after steps along free segments."""
    end = x + step
    blocked = np.flatnonzero(~workspace.is_visible(x, end))
    if not blocked.size:
        return end
    from_here = np.repeat(x[blocked, None], len(_DETOURS), axis=1)
    tried = from_here + np.einsum("dij,nj->ndi", _DETOURS, step[blocked])
    visible = np.reshape(workspace.is_visible(from_here.reshape(-1, 2), tried.reshape(-1, 2)), tried.shape[:2])
    first = tried[np.arange(len(blocked)), visible.argmax(axis=1)]
    end[blocked] = np.where(visible.any(axis=1, keepdims=True), first, x[blocked])
    return end


# The last steps of a placement, without gradients: costs have kinks, and the cheapest places are often there.
#
# A median may be a corner of a wall or a demand point; a center has several points equally far away. So each facility
# is moved to the best of some places around, or to a corner, a demand point or a wall nearby, as long as the demand
# that is its own costs less from there; else its search goes on around a smaller circle.


_DIRECTIONS = 8
_TURN = np.pi * (3 - np.sqrt(5))  # the golden angle, by which directions differ from round to round
_LEAST_GAIN = 1e-7
"""Of a facility's cost: less is the rounding of distances in 32 bits."""

Facilities = Float[np.ndarray, "k 2"]
Radii = Float[np.ndarray, "k"]


def searched(
    problem: LocationProblem, x: Facilities, radius: Radii, near: Int[np.ndarray, "n near"], turn: int
) -> tuple[Facilities, Radii]:
    """Every facility at the best place around, or else with a smaller circle to be searched next.

    Demand points are served by the nearest of the facilities that are near.
    """
    to_near = pair_distances(problem.distance, x[near], problem.points[:, None])
    nearest, facility = near[np.arange(len(near)), to_near.argmin(axis=1)], np.arange(len(x))
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

    distances, slopes = pair_slopes(problem.distance, x[nearest], problem.points)
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


_MOST_SITES = 256
_MOST_DRAWS = 4  # a start
_POWER, _LAST_POWER = 8, 64  # of costs of which the largest counts, before descent and where there is none
_LEAST_EXCHANGE_GAIN = 1e-6  # of the cost, by an exchange


def starts(
    problem: LocationProblem,
    candidates: Float[np.ndarray, "m 2"] | None,
    k: int,
    num_restarts: int,
    rng: np.random.Generator,
) -> Float[np.ndarray, "restarts k 2"]:
    """Placements at candidates, of which None are demand points, no two alike, the cheapest first.

    Fewer than asked for where there are no more.
    """
    if candidates is None:
        (sites, distances), power = _demand_sites(problem, k, rng), _POWER
    else:
        sites, distances, power = candidates, problem.distances(candidates), _LAST_POWER
    _check_reached(problem, distances, k)
    terms = _terms(problem, distances, power)
    found: dict[tuple[int, ...], float] = {}
    for _ in range(_MOST_DRAWS * num_restarts):
        drawn = _drawn(problem, distances, k, rng)
        # Where another draw has led to the same exchange, this one starts as it was drawn.
        for chosen in (_exchanged(terms, drawn), drawn):
            key = tuple(sorted(chosen.tolist()))
            if key not in found:
                found[key] = float(problem.cost(distances[list(key)].min(axis=0)))
                break
        if len(found) == num_restarts:
            break
    cheapest = sorted(found, key=lambda key: (found[key], key))
    return sites[np.array(cheapest)]


def _demand_sites(
    problem: LocationProblem, k: int, rng: np.random.Generator
) -> tuple[Float[np.ndarray, "sites 2"], Float[np.ndarray, "sites n"]]:
    """Demand points at which facilities may start, from which all are reached; and all distances to them."""
    points = problem.points
    sites = rng.permutation(len(points))[: max(_MOST_SITES, 2 * k)]
    distances = problem.distances(points[sites])
    while not (reached := np.isfinite(distances).any(axis=0)).all():
        new = int(np.argmin(reached))
        row = problem.distances(points[[new]])
        if not np.isfinite(row[0, new]):
            raise ValueError(
                f"distance gives inf from the demand point {points[new].tolist()} to itself: is it in its domain?"
            )
        sites, distances = np.append(sites, new), np.concatenate([distances, row])
    return points[sites], distances


def _check_reached(problem: LocationProblem, distances: Float[np.ndarray, "sites n"], k: int) -> None:
    """Raise ``ValueError`` if k facilities at sites cannot reach all points."""
    unreached = np.flatnonzero(np.isinf(distances).all(axis=0))
    if unreached.size:
        raise ValueError(
            f"No candidate reaches {unreached.size:,} of {distances.shape[1]:,} demand points, such as "
            f"{problem.points[unreached[0]].tolist()}, number {unreached[0]}: add some, or leave points out."
        )
    # How many sites it takes to reach all points, where those that reach a point in common reach the same.
    reaches = np.isfinite(distances)
    num_parts, left = 0, np.ones(reaches.shape[1], bool)
    while left.any():
        site = np.argmax(reaches[:, np.argmax(left)])
        num_parts, left = num_parts + 1, left & ~reaches[site]
    if num_parts > k:
        raise ValueError(
            f"The demand points lie in {num_parts} parts of free space that no path joins, so that k={k} facilities "
            f"cannot reach all of them: use k={num_parts} or more, or leave points out."
        )


def _drawn(
    problem: LocationProblem, distances: Float[np.ndarray, "sites n"], k: int, rng: np.random.Generator
) -> Int[np.ndarray, "k"]:
    """Sites drawn one after the other."""
    chosen: list[int] = []
    costs = problem.weights
    for _ in range(k):
        farthest = chosen and problem.objective is PlacementObjective.MAX
        point = int(np.argmax(costs)) if farthest else _drawn_by(costs, rng)
        to_sites = np.minimum(distances[:, point], np.finfo(float).max)  # 0 where the point is one itself
        to_sites[chosen] = np.inf
        chosen.append(int(np.argmin(to_sites)))
        costs = problem.weights * distances[chosen].min(axis=0)
    return np.array(chosen)


def _drawn_by(cost: Float[np.ndarray, "n"], rng: np.random.Generator) -> int:
    """A point drawn in proportion to its cost: one of infinite cost, if there is any."""
    if np.isinf(cost).any():
        cost = np.isinf(cost).astype(float)
    total = cost.sum()
    return int(rng.choice(len(cost), p=cost / total if total > 0 else None))


def _terms(
    problem: LocationProblem, distances: Float[np.ndarray, "sites n"], power: int
) -> Float[np.ndarray, "sites n"]:
    """What each point costs at each site, so that the sum is to be small.

    Exchanges rarely lower a largest cost, which is that of one point. So what is summed are high powers of costs.
    """
    costs = problem.weights * distances
    if problem.objective is PlacementObjective.SUM:
        return costs
    return (costs / costs[np.isfinite(costs)].max(initial=1e-300)) ** power


def _exchanged(terms: Float[np.ndarray, "sites n"], chosen: Int[np.ndarray, "k"]) -> Int[np.ndarray, "k"]:
    """Sites after exchanges by which the sum falls: each site takes the place of that which is missed least.

    As in FasterPAM (Schubert and Rousseeuw, "Fast and eager k-medoids clustering", Information Systems 101, 2021):
    an exchange is made as soon as it gains, until no site gains any more.
    """
    # What is not reached costs more than anything that reaches all.
    terms = np.where(np.isfinite(terms), terms, 10 * terms.shape[1] * terms[np.isfinite(terms)].max(initial=1e-300))
    chosen, k, idle, site = chosen.copy(), len(chosen), 0, 0
    first, nearest, second = _two_nearest(terms[chosen])
    while idle < len(terms):
        kept, lost = np.minimum(nearest, terms[site]), np.minimum(second, terms[site])
        totals = kept.sum() + np.bincount(first, lost - kept, k)
        place = int(totals.argmin())
        if totals[place] < (1 - _LEAST_EXCHANGE_GAIN) * nearest.sum():
            chosen[place], idle = site, 0
            first, nearest, second = _two_nearest(terms[chosen])
        site, idle = (site + 1) % len(terms), idle + 1
    return chosen


def _two_nearest(
    terms: Float[np.ndarray, "k n"],
) -> tuple[Int[np.ndarray, "n"], Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
    """The chosen site that costs each point least, what it costs, and what the next one does; ``inf`` if none is."""
    if len(terms) == 1:
        return np.zeros(terms.shape[1], int), terms[0], np.full(terms.shape[1], np.inf)
    point = np.arange(terms.shape[1])
    first, second = np.argpartition(terms, 1, axis=0)[:2]
    return first, terms[first, point], terms[second, point]
