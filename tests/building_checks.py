"""Checks of buildings by the independent search, for tests and experiments: counts of wrong answers."""

from collections import Counter
from functools import cached_property
from typing import Any

import numpy as np
from building_helpers import BruteForce, Field, points_of, random_building, random_goals

from plr_jax import construct_pairs
from plr_jax.buildings import BuildingPLR, Route

_OF_FILE = 1e-5  # of the plane's width: errors of points in files and of pairs


class Case:
    """A random building, one or more goals, and points on each floor."""

    def __init__(self, seed: int, num_goals: int = 1, num_points: int = 60):
        self.seed, self.num_points = seed, num_points
        self.building = random_building(seed)
        self.goals = random_goals(self.building, seed, num_goals)

    @cached_property
    def search(self) -> BruteForce:
        return BruteForce(self.building)

    @cached_property
    def field(self) -> Field:
        return self.search.field(self.goals)

    @cached_property
    def oracle(self) -> Any:
        return self.building.oracle(self.goals)

    @cached_property
    def points(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Points of each floor and their true distances."""
        floors = range(len(self.building.floors))
        points = [points_of(self.building, floor, self.seed + floor, self.num_points) for floor in floors]
        return [(x, self.field(floor, x)) for floor, x in enumerate(points)]

    @property
    def coarse(self) -> float:
        """Allowed errors of points in files, and of pairs."""
        return _OF_FILE * float(self.building.plane.bounds.width.max())


def wrong_of_oracle(case: Case) -> Counter:
    """Count wrong distances, next links and routes of the oracle, and wrong distances of its functions of floors."""
    wrong, search, oracle = Counter(), case.search, case.oracle
    for floor, (x, truth) in enumerate(case.points):
        links = oracle.which(floor, x)
        wrong["points"] += len(x)
        wrong["distances"] += are_wrong(oracle(floor, x), truth, search.allowed).sum()
        wrong["links"] += wrong_links(case, floor, x, links).sum()
        for point, distance in zip(x[::3], truth[::3], strict=True):
            route = oracle.shortest_path(floor, point)
            wrong["routes"] += bool(route_fault(case, route, (floor, point), search.allowed, distance))
        if np.isfinite(truth).any():
            wrong["functions of floors"] += are_wrong(oracle[floor](x), truth, search.allowed).sum()
    return wrong


def wrong_of_plr(case: Case, plr: BuildingPLR) -> Counter:
    """Count broken bounds of a certified PLR, and wrong routes that are read from cones."""
    wrong, reader = Counter(), plr.numpy()
    for floor, (x, truth) in enumerate(case.points):
        is_reached = np.isfinite(truth)
        x, truth = x[is_reached], truth[is_reached]
        wrong["points"] += len(x)
        wrong["bounds"] += are_broken(reader.bounds(floor, x), truth).sum()
        if plr.plane.leaf.name != "cone" or not len(x):
            continue
        for point, route in zip(x[::3], plr.trace(floor, x[::3], case.building), strict=True):
            wrong["traced"] += bool(route.legs)
            wrong["routes"] += bool(route.legs and route_fault(case, route, (floor, point), case.coarse))
    return wrong


def wrong_of_pairs(case: Case, max_bytes: int = 30_000) -> Counter:
    """Count broken bounds of pairs that end at the first goal, and distances that are too far from the truth.

    Distances of points where obstacles touch count only with their bounds, as do links that end there.
    """
    wrong, pairs, (to, goal) = Counter(), construct_pairs(case.building, max_bytes=max_bytes), case.goals[0]
    places = [place for link in case.building.links for place in (link.start, link.end)]
    is_plain = not any(case.search.is_contact(*place) for place in [*places, case.goals[0]])
    field = case.search.field(case.goals[:1])
    for floor, (x, _) in enumerate(case.points):
        x = x[case.building.floors[floor].is_free(x)]
        truth, ends = field(floor, x), ((floor, x), (to, np.tile(goal, (len(x), 1))))
        wrong["points"] += len(x)
        wrong["bounds"] += are_broken(pairs.bounds(*ends), truth).sum()
        counts = np.array([is_plain and not case.search.is_contact(floor, point) for point in x], bool)
        wrong["distances"] += are_wrong(pairs(*ends), truth, case.coarse)[counts].sum()
    return wrong


def are_wrong(found: Any, expected: np.ndarray, allowed: float) -> np.ndarray:
    """Return which distances differ by more than an allowed error, or are infinite when they should not be."""
    found = np.asarray(found, float)
    both = np.isfinite(found) & np.isfinite(expected)
    difference = np.subtract(found, expected, where=both, out=np.zeros(len(expected)))
    return (np.isfinite(found) != np.isfinite(expected)) | (np.abs(difference) > allowed)


def are_broken(bounds: Any, truth: np.ndarray) -> np.ndarray:
    lower, upper = (np.asarray(bound, float) for bound in bounds)
    return ~((lower <= truth) & (truth <= upper))


def wrong_links(case: Case, floor: int, x: np.ndarray, which: np.ndarray) -> np.ndarray:
    """Return at which points no shortest path takes the next link that is claimed."""
    search, truth, is_wrong = case.search, case.field(floor, x), np.ones(len(x), bool)
    for number in np.unique(which).tolist():
        rows = np.flatnonzero(which == number)
        if number == -2:
            is_wrong[rows] = np.isfinite(truth[rows])
            continue
        ways = [(goal, 0.0) for goal in case.goals]
        if number >= 0:
            cost = search.links[number].cost
            ways = [(start, cost + case.field(end[0], [end[1]])[0]) for start, end in search.ways(number)]
        ways = [(place, cost) for place, cost in ways if np.isfinite(cost)]
        places, costs = ([way[i] for way in ways] for i in (0, 1))
        on_foot = search.field(places, costs, use_links=False)(floor, x[rows])
        is_wrong[rows] = are_wrong(on_foot, truth[rows], search.allowed)
    return is_wrong


def route_fault(case: Case, route: Route, start: Any, near: float, distance: float | None = None) -> str:
    """Return what is wrong with a route from a start, or an empty string.

    Points and the length may be wrong by ``near``. If the ``distance`` is given, the length must equal it; else the
    route may be longer than the shortest one.
    """
    search = case.search
    shortest = case.field(start[0], [start[1]])[0]
    if not route.legs:
        return "" if np.isinf([shortest, route.length]).all() else "no legs"
    length, here = 0.0, [start]
    for number, (floor, points) in enumerate(route.legs):
        if not any(_are_near(place, (floor, points[0]), near) for place in here):
            return f"leg {number} starts elsewhere"
        if not search.floors[floor].holds(points, near):
            return f"leg {number} leaves free space"
        length += np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
        if number < len(route.links):
            ways = search.ways(route.links[number])
            here = [end for begin, end in ways if _are_near(begin, (floor, points[-1]), near)]
            length += search.links[route.links[number]].cost
    if not any(_are_near(goal, (route.legs[-1][0], route.legs[-1][1][-1]), near) for goal in case.goals):
        return "the route does not end at a goal"
    if abs(length - route.length) > near or length < shortest - near:
        return f"the length is {length}, said to be {route.length}, of the shortest path {shortest}"
    return "" if distance is None or abs(length - distance) <= near else f"{length} is no shortest path"


def _are_near(place: Any, other: Any, near: float) -> bool:
    return place[0] == other[0] and bool(np.linalg.norm(np.subtract(place[1], other[1])) <= near)
