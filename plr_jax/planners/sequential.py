"""A first path for a few discs among few walls, without a lattice: the robots move one after the other.

Each robot follows a shortest route, straight from corner to corner, in an order in which no robot blocks another. If
there is no such order, as for two robots that swap places, a robot first steps aside to a corner. References:
Buckley, "Fast motion planning for multiple moving robots", 1989; van den Berg et al., RSS 2009.
"""

from functools import lru_cache
from itertools import groupby, pairwise, permutations
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.sparse.csgraph import shortest_path

from plr_jax._arrays import path_from_root
from plr_jax._problem import JointPath, Problem
from plr_jax.collision.walls import MotionTest
from plr_jax.geometry.vectors import distance_to_segment, turn_between, turned_left
from plr_jax.geometry.workspace import Workspace
from plr_jax.robots import DiscRobot, Points

# With more walls or robots, lattice searches are as fast, and no order of robots is likely to exist.
_MOST_WALLS = 48
_MOST_ROBOTS = 8
_CELLS = (1, 8)  # a coarse grid for the test of motions: building it takes longer than testing the few motions
_SHARP_TURN = 2.0  # turn of the normals (radians) at a convex corner above which a route has two positions there
_LEAST_COSINE = 1e-3  # bounds the distance of positions from sharp concave corners
_COMPLEX = np.array([1, 1j])  # converts points to complex numbers, which are faster in plain Python
_DEPARTURES = 32  # most departure times that are tried for a robot, besides the last one
Route = list[complex]  # positions of the disc's center


class CornerRoadmap:
    """A roadmap for a disc: positions of its center beside corners of walls, and free straight motions."""

    def __init__(self, workspace: Workspace, radius: float):
        # 1. Find the free positions beside corners. `turn` is the angle at the begin of each wall, from its normal to
        #    the normal of the wall before it: positive at convex corners of obstacles, negative at concave ones.
        boundary, begin = workspace.boundary, workspace.boundary.segments[:, 0]
        turn = turn_between(boundary.normal, turned_left(begin - boundary.vertices[boundary.sector_end]))
        turn = np.where(turn > np.pi, turn - 2 * np.pi, turn)
        q = _positions_at(begin, boundary.normal, turn, radius)
        self.q = q[workspace.clearance(q) >= radius - workspace.tolerance / 2]  # rounding must not exclude contacts
        self.places: list[complex] = (self.q @ _COMPLEX).tolist()
        # 2. Find the shortest routes between them.
        self.is_free = MotionTest(workspace, DiscRobot(radius), cells=_CELLS)
        first, last = np.triu_indices(len(self.q), 1)
        free = self.is_free(self.q[first], self.q[last])
        straight = np.zeros((len(self.q), len(self.q)))
        straight[first[free], last[free]] = np.hypot(*(self.q[last] - self.q[first])[free].T)
        self.cost, self._previous = shortest_path(straight, directed=False, return_predecessors=True)

    def routes_of(self, start: Float[np.ndarray, "2"], goal: Float[np.ndarray, "2"]) -> "Routes":
        """Return the costs of a robot's motions between its start, the roadmap's positions, and its goal."""
        # Motions from start to goal, then from the start to all corners, then from the goal to all corners.
        ends = np.stack([start, goal])
        begin = np.concatenate([ends[:1], ends.repeat(len(self.q), axis=0)])
        end = np.concatenate([ends[1:], self.q, self.q])
        cost = np.where(self.is_free(begin, end), np.hypot(*(end - begin).T), np.inf)
        out, home = cost[1:].reshape(2, len(self.q))
        first, last = (ends @ _COMPLEX).tolist()
        return Routes(self, first, last, float(cost[0]), out, home, (home + self.cost).min(axis=1, initial=np.inf))

    def between(self, u: int, v: int) -> Route:
        return [self.places[corner] for corner in path_from_root(self._previous[u], v)]


_cached_roadmap = lru_cache(maxsize=16)(CornerRoadmap)


def _positions_at(
    corner: Points, normal: Points, turn: Float[np.ndarray, " n"], radius: float
) -> Float[np.ndarray, "corners 2"]:
    """Return the positions at which a disc's center turns around each corner: one, or two if the corner is sharp.

    ``normal`` is the unit normal of the wall that begins at the corner. ``turn`` is the angle, in radians, from this
    normal to the normal of the wall that ends at the corner. It is positive at convex corners of obstacles.
    """
    # Let r be the radius. The center passes along lines at the distance r from both walls. These lines meet in the
    # direction halfway between the walls' normals, at r / cos(turn / 2) from the corner. At a sharp corner, this is
    # far away. Two positions then cut off the tip: in the directions at turn / 4 from each normal, r / cos(turn / 4)
    # from the corner. Both positions also lie on the two lines, and the segment between them, too, has the distance r
    # from the corner.
    count = np.where(turn > _SHARP_TURN, 2, 1)
    points = []
    for fraction, selected in ((0.5, count == 1), (0.25, count == 2), (0.75, count == 2)):
        angle = (fraction * turn[selected])[:, None]
        half = (turn / 2 / count)[selected, None]
        away = np.cos(angle) * normal[selected] + np.sin(angle) * turned_left(normal[selected])
        points.append(corner[selected] + radius / np.maximum(np.cos(half), _LEAST_COSINE) * away)
    return np.concatenate(points)


class Routes(NamedTuple):
    """Costs of a disc's motions between its start, the positions of a roadmap (``corners``), and its goal.

    A cost is ``inf`` if a wall is in the way.
    """

    roadmap: CornerRoadmap
    start: complex
    goal: complex
    straight: float  # cost of the straight motion from start to goal
    out: Float[np.ndarray, " corners"]  # cost of the straight motion from the start to each corner
    home: Float[np.ndarray, " corners"]  # cost of the straight motion from each corner to the goal
    to_go: Float[np.ndarray, " corners"]  # cost of the shortest route from each corner to the goal

    def shortest(self) -> Route | None:
        if self.straight < np.inf:
            return [self.start, self.goal]
        total = self.out + self.to_go
        return [self.start, *self.route_home(int(total.argmin()))] if total.min(initial=np.inf) < np.inf else None

    def route_home(self, corner: int) -> Route:
        return [*self.roadmap.between(corner, int((self.home + self.roadmap.cost[corner]).argmin())), self.goal]


def sequential_path(problem: Problem) -> JointPath | None:
    """Return a path on which the robots move one after the other; None if no such path was found.

    The result is also None if a robot is no disc of radius above ``workspace.tolerance``, or for more than 8 robots
    or 48 walls.
    """
    robots, workspace = problem.robots, problem.workspace
    are_discs = all(robot.inscribed_radius == robot.circumscribed_radius > workspace.tolerance for robot in robots)
    if problem.dof > 2 or not are_discs or len(robots) > _MOST_ROBOTS or len(workspace.boundary.edges) > _MOST_WALLS:
        return None
    # 1. Find the routes of all robots; robots of equal radius share a roadmap.
    poses = zip(robots, problem.starts, problem.goals, strict=True)
    all_routes = [_cached_roadmap(workspace, robot.rounding).routes_of(*ends) for robot, *ends in poses]
    reach = _touch_distances(problem)
    chosen = [route for routes in all_routes if (route := routes.shortest())]
    if len(chosen) < len(robots):
        return None
    at = [routes.start for routes in all_routes]  # present positions
    rows = [at.copy()]
    waiting, aside = list(range(len(robots))), set()  # robots not at their goals, and robots that have stepped aside

    def clears(i: int, route: Route, ignored: tuple[int, ...]) -> bool:
        # Whether robot i hits no robot on a route.
        return not any(_comes_within(route, at[j], reach[i][j]) for j in range(len(robots)) if j not in ignored)

    def is_ready(i: int, *ignored: int) -> bool:
        # Whether robot i hits no robot on its route, and is in no waiting robot's way at its goal.
        others = [j for j in waiting if j not in ignored]
        goal = all_routes[i].goal
        return clears(i, chosen[i], ignored) and not any(_comes_within(chosen[j], goal, reach[i][j]) for j in others)

    def go(i: int, route: Route) -> None:
        for place in route[1:]:
            if place != at[i]:
                at[i] = place
                rows.append(at.copy())

    def make_way(i: int, j: int) -> bool:
        """Let robot ``i`` step aside to a corner, and robot ``j`` move to its goal; return whether both can."""
        if i in aside or not is_ready(j, i, j):
            return False
        routes = all_routes[i]
        # Costs of the shortest routes from start to goal through each corner.
        detours = (routes.out + routes.roadmap.cost).min(axis=1, initial=np.inf) + routes.to_go
        for corner in np.argsort(detours, kind="stable")[: np.count_nonzero(detours < np.inf)].tolist():
            if _comes_within(chosen[j], routes.roadmap.places[corner], reach[i][j]):
                continue
            first = int((routes.out + routes.roadmap.cost[corner]).argmin())
            out, home = [routes.start, *routes.roadmap.between(first, corner)], routes.route_home(corner)
            if clears(i, out, (i,)) and not _comes_within(home, all_routes[j].goal, reach[i][j]):
                go(i, out)
                aside.add(i)
                chosen[i] = home
                go(j, chosen[j])
                waiting.remove(j)
                return True
        return False

    # 2. Move robots that are ready to their goals. If none is ready, let one make way for another.
    while waiting:
        if (ready := next((i for i in waiting if is_ready(i, i)), None)) is not None:
            go(ready, chosen[ready])
            waiting.remove(ready)
        elif not any(make_way(i, j) for i, j in permutations(waiting, 2)):
            return None
    return np.array(rows)[..., None].view(np.float64)


def _comes_within(route: Route, place: complex, reach: float) -> bool:
    """Return whether a robot's route comes nearer than ``reach`` to a point ``place``, a complex number."""
    for begin, end in pairwise(route):
        rate, offset = end - begin, place - begin
        squared = abs(rate) ** 2
        t = (offset * rate.conjugate()).real / squared if squared > 0 else 0.0
        if abs(offset - min(max(t, 0.0), 1.0) * rate) < reach:
            return True
    return False


def _touch_distances(problem: Problem) -> list[list[float]]:
    radii, slack = [robot.rounding for robot in problem.robots], problem.workspace.tolerance / 2
    return [[a + b - slack for b in radii] for a in radii]


def with_early_departures(problem: Problem, path: JointPath) -> Float[np.ndarray, "rows robots dof"]:
    """Return a path on which robots depart before others have arrived, where they do not collide.

    ``path`` moves one robot at a time. Each robot's route and cost stay equal.
    """
    num = len(problem.robots)
    first_of, second_of = np.triu_indices(num, 1)
    reach = np.array(_touch_distances(problem))[first_of, second_of]
    # The waypoints of each robot so far, and the time at which it is at each of them.
    routes, times = [path[:1, i] for i in range(num)], [np.zeros(1)] * num
    result, row = path[:1], 0
    for i, motions in groupby((path[1:] != path[:-1]).any(axis=2).argmax(axis=1).tolist()):  # by the moving robot
        # 1. Add the route of one robot, until another one moves.
        route = path[row : row + len(list(motions)) + 1, i]
        row += len(route) - 1
        routes[i] = np.concatenate([routes[i], route])
        since = np.append(0.0, np.cumsum(np.hypot(*np.diff(route, axis=0).T)))
        # 2. Try to depart as soon as the robot has arrived, or later. Departure when all others have arrived is
        #    always free: they then stand as in the given path.
        earlier = times[i]
        first, last = earlier[-1], max(arrival[-1] for arrival in times)
        num_early = int(min(_DEPARTURES, np.ceil((last - first) / reach.min(initial=np.inf))))
        for depart in [*np.linspace(first, last, num_early, endpoint=False).tolist(), last]:
            times[i] = np.append(earlier, depart + since)
            # 3. Rows for all robots, at each time when one of them turns, departs or arrives. Between these, robots
            #    move straight at constant speed.
            when = np.unique(np.concatenate(times))
            pairs = zip(times, routes, strict=True)
            columns = [np.interp(when, at, waypoints[:, k]) for at, waypoints in pairs for k in (0, 1)]
            result = np.stack(columns, axis=1).reshape(len(when), num, 2)
            x, y = np.moveaxis(result[:, first_of] - result[:, second_of], 2, 0)
            if (distance_to_segment(x[:-1], y[:-1], np.diff(x, axis=0), np.diff(y, axis=0)) >= reach).all():
                break
    return result
