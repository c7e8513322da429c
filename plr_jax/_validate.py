"""An independent check of paths, which shares almost no code with the collision tests of the planners.

The check and the planners use the same boundary of free space, and the same rule for the direction of turns. In the
check, the shapes of robots are Shapely geometries.

In a motion without turns, a robot sweeps a convex hull, whose distance to obstacles is exact. Motions with turns are
bisected in time: in an interval, the clearance is at least its value in the middle, minus the largest distance that
the robots can move from there. For point robots, thin walls divide the free space near a path into parts; the path
must not lead from one part to another.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import is_single
from plr_jax._problem import JointPath, Problem, as_path, path_cost, require_problem, separation
from plr_jax._types import ArrayLike
from plr_jax.geometry.vectors import distance_to_segment
from plr_jax.geometry.workspace import Workspace, part_groups
from plr_jax.robots import Robot, between, footprint, placed, shorter_turn

_TOLERANCE = 1e-7  # accuracy, and deepest overlap that counts as touching, as a share of the workspace's extent
_SLACK = 1e-3  # share of the distance by which a point may be outside of free space: less than any wall is thick
_MOMENT = 2.0**-14  # accuracy of the time of a violation, in steps


@dataclass(frozen=True)
class ValidationReport:
    """Result of :func:`validate`: the first violation of a path, or its clearance.

    Args:
        valid: Whether the path solves the problem.
        cost: Recomputed cost, in workspace units. Cost and clearance are NaN if the path is not finite, or has a
            wrong shape.
        clearance: Smallest distance of a robot to an obstacle, the bounds or another robot. The clearance has an
            error of at most 1e-7 of the workspace's extent, or twice the workspace's ``tolerance`` if that is more.
            If the path has a collision, the clearance is about minus the depth of the first overlap.
        message: Description of the first violation, or of the closest pair if there is none.
        who: Indices of the robots in the message.
        when: Time of the violation in steps: 3.25 is a quarter of the way from row 3 of the path to row 4.
        where: Position ``(x, y)`` of robot ``who[0]`` at that time.
    """

    valid: bool
    cost: float
    clearance: float
    message: str
    who: tuple[int, ...] = ()
    when: float | None = None
    where: tuple[float, float] | None = None


def validate(problem: Problem, path: ArrayLike) -> ValidationReport:
    """Check whether a path, from any planner, solves a problem.

    The path, joint configurations ``(steps, robots, dof)``, must be finite. The path must begin at the starts and end
    at the goals exactly; headings of robots that do not turn are ignored. All robots must keep clear of obstacles,
    the bounds and one another during all motions; touching is allowed. Motions are straight, at constant rates, and
    turn the shorter way; a half turn is counterclockwise.

    A point robot may be outside of free space by twice the workspace's ``tolerance``. If the path has 32-bit floats,
    the rounding of its coordinates is added. A point robot may not cross a wall of ``Workspace.free_space``, however
    thin.

    An invalid path is reported, and raises no error. ``ValueError`` is raised if ``problem`` is not a Problem, or
    ``path`` is a Solution instead of its path.
    """
    require_problem(problem, path)
    # A point stays within this distance of free space. Points of 32 bits may be off by one step along both axes.
    margin = 2 * problem.workspace.tolerance
    margin += 2 * float(np.spacing(np.abs(path).max(initial=np.float32(0)))) if is_single(path) else 0.0
    try:
        path = as_path(problem, path)
    except ValueError as error:
        return ValidationReport(False, np.nan, np.nan, str(error))
    if len(broken := np.argwhere(~np.isfinite(path).all(axis=2))):
        step, i = map(int, broken[0])
        message = f"Robot {i} has a configuration that is not finite at step {step}."
        return ValidationReport(False, np.nan, np.nan, message, (i,), float(step))
    cost, encounters = path_cost(problem, path), _encounters(problem, path, margin)
    if colliding := [encounter for encounter in encounters if encounter.smallest.min() < -encounter.tolerance]:
        return _collision_report(problem, min(colliding, key=lambda encounter: encounter.first_moment), cost)
    closest = min(encounters, key=lambda encounter: encounter.smallest.min())
    clearance = max(float(closest.smallest.min()), 0.0)  # objects that touch may overlap by rounding
    if fault := _find_crossing(problem, path, margin) or _find_wrong_end(problem, path):
        i, when, message = fault
        return ValidationReport(False, cost, clearance, message, (i,), when, tuple(path[int(when), i, :2].tolist()))
    who, step = closest.who, closest.smallest.argmin()
    pair = f" {who[0]} to an obstacle or the bounds" if len(who) == 1 else f"s {who[0]} and {who[1]}"
    shown = clearance if clearance > closest.tolerance else 0.0
    message = f"Valid: clearance {shown:.4g}, of robot{pair} in the motion from step {step}."
    return ValidationReport(True, cost, clearance, message, who)


@dataclass(frozen=True, eq=False)
class _Encounter:
    """Two objects between which the clearance is measured: a robot, and another robot or the blocked region.

    Each robot moves along its path. The blocked region is the complement of the free space.
    """

    who: tuple[int, ...]
    robot: Robot
    path: Float[np.ndarray, "steps dof"]
    other: Any  # a robot if there is an other_path, else the blocked region
    other_path: Float[np.ndarray, "steps dof"] | None
    tolerance: float

    @property
    def reach(self) -> float:
        # The cores of both bodies must stay this far apart: the sum of the radii by which the bodies are rounded.
        return self.robot.rounding + (0.0 if self.other_path is None else self.other.rounding)

    def clearances(self, when: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Return the distance between the two objects at times ``when``, in steps; negative if they overlap."""
        bodies, others = footprint(self.robot, _at(self.path, when)), self._others(when)
        distance = np.asarray(shapely.distance(bodies, others))
        met = np.flatnonzero(distance == 0)
        distance[met] = [separation(*pair) for pair in zip(bodies[met], others[met], strict=True)]
        if len(self.robot.core) > 2:
            slight = met[distance[met] >= -self.tolerance]
            distance[slight[self._are_deep(bodies[slight], others[slight])]] = -2 * self.tolerance
        return distance - self.reach

    def _others(self, when: Float[np.ndarray, " n"]) -> Any:
        if self.other_path is None:
            return np.full(len(when), self.other)
        return footprint(self.other, _at(self.other_path, when))

    def _are_deep(self, bodies: Any, others: Any) -> Bool[np.ndarray, " n"]:
        # Return which overlaps are deeper than the tolerance: those that meet the body eroded by the tolerance. An
        # estimate from the area of the overlap would miss a thin wall across the body.
        return shapely.intersects(shapely.buffer(bodies, -self.tolerance, join_style="mitre"), others)

    def swept(self, motion: Int[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        # Return the smallest clearance in motions without turns. The robot sweeps the convex hull of its bodies at
        # both ends of the motion. If there is another robot, the motion is taken relative to that robot.
        start = placed(self.robot, self.robot.core, self.path[motion])
        corners = np.concatenate([start, start + self.velocity[motion, None]], axis=1)
        hulls: Any = shapely.convex_hull(shapely.multipoints(corners))
        others = self._others(motion.astype(float))
        distance = np.asarray(shapely.distance(hulls, others))
        if self.reach <= self.tolerance:  # at distance 0 a body is touched or entered
            met = np.flatnonzero(distance == 0)
            pair = hulls[met], others[met]
            distance[met[self._are_deep(*pair) | self._are_deep(*pair[::-1])]] = -2 * self.tolerance
        return distance - self.reach

    @cached_property
    def velocity(self) -> Float[np.ndarray, "motions 2"]:
        """Change of the robot's position in each motion, relative to the other robot if there is another robot."""
        velocity = np.diff(self.path[:, :2], axis=0)
        return velocity if self.other_path is None else velocity - np.diff(self.other_path[:, :2], axis=0)

    @cached_property
    def rim_speeds(self) -> Float[np.ndarray, " motions"]:
        speeds = _rim_speeds(self.robot, self.path)
        return speeds if self.other_path is None else speeds + _rim_speeds(self.other, self.other_path)

    @cached_property
    def max_rates(self) -> Float[np.ndarray, " motions"]:
        """Upper bound, for each motion, of how fast the clearance changes per unit of time (one step of the path)."""
        return self.rim_speeds + np.linalg.norm(self.velocity, axis=1)

    @cached_property
    def smallest(self) -> Float[np.ndarray, " motions"]:
        """Upper bound, for each motion, of the smallest clearance between the two objects."""
        # If no motion collides, the minimum over all motions is accurate to `tolerance`.
        # 1. Motions without turns: exact, as the robot's swept area. Others: at first, the clearance at both ends.
        at_rows = self.clearances(np.arange(len(self.path), dtype=float))
        smallest = np.minimum(at_rows[:-1], at_rows[1:])
        turns = self.rim_speeds > 0
        straight = np.flatnonzero(~turns)
        smallest[straight] = self.swept(straight)
        # 2. Halve intervals of the motions with turns. In an interval of length `size`, the clearance is at least
        #    that in the middle minus max_rate * size / 2. So the bounds tighten until all intervals are dropped.
        motion, begin = np.flatnonzero(turns), np.zeros(turns.sum())
        size = 1.0
        while len(motion):
            middle = self.clearances(motion + begin + size / 2)
            np.minimum.at(smallest, motion, middle)
            lower_bound = middle - self.max_rates[motion] * size / 2
            # Drop motions that collide, and intervals that are free and cannot have the smallest clearance.
            unsure = (lower_bound < -self.tolerance) | (lower_bound < smallest.min() - self.tolerance)
            unsure &= smallest[motion] >= -self.tolerance
            size /= 2
            motion, begin = np.repeat(motion[unsure], 2), np.repeat(begin[unsure], 2)
            begin[1::2] += size
        return smallest

    @cached_property
    def first_moment(self) -> float:
        """Time, in steps, at which the first collision of the two objects begins."""
        # Halve intervals as in `smallest`, but keep all intervals that may have a collision, up to the first interval
        # that has a collision in its middle.
        motion, begin = int((self.smallest < -self.tolerance).argmax()), np.zeros(1)
        size = 1.0
        while True:
            middle = self.clearances(motion + begin + size / 2)
            near = middle - self.max_rates[motion] * size / 2 < -self.tolerance
            begin, middle = begin[near], middle[near]
            collides = np.flatnonzero(middle < -self.tolerance)
            if size <= _MOMENT or not len(begin):
                # The collision may be too brief to be located.
                return float(motion + (begin[collides[0]] + size / 2 if len(collides) else 0.5))
            begin = begin[: collides[0] + 1] if len(collides) else begin
            size /= 2
            begin = np.repeat(begin, 2)
            begin[1::2] += size


def _encounters(problem: Problem, path: JointPath, margin: float) -> list[_Encounter]:
    """Return the pairs of objects whose clearance must be measured, sorted by the indices of their robots.

    Each robot is paired with the blocked region. Two robots are paired if they may collide, or may have the smallest
    clearance of the whole path. A point robot may overlap the blocked region by ``margin``.
    """
    workspace, robots = problem.workspace, problem.robots
    tolerance = _tolerance(workspace)
    path = np.repeat(path, 2, axis=0) if len(path) == 1 else path
    # 1. Pair each robot with the blocked space. The blocked region includes a margin beyond the bounds and the path.
    lo = np.minimum(workspace.bounds.lo, path[..., :2].min(axis=(0, 1))) - workspace.bounds.width
    hi = np.maximum(workspace.bounds.hi, path[..., :2].max(axis=(0, 1))) + workspace.bounds.width
    blocked = shapely.difference(shapely.box(*lo, *hi), workspace.free_space)
    shapely.prepare(blocked)
    encounters: dict[tuple[int, ...], _Encounter] = {}
    for j, robot in enumerate(robots):
        depth = margin if robot.circumscribed_radius <= tolerance else tolerance
        encounters[j,] = _Encounter((j,), robot, path[:, j], blocked, None, depth)
    # 2. Pair robots, in the order of lower bounds of their clearances, until these exceed the smallest clearance so
    #    far.
    smallest = min(encounter.smallest.min() for encounter in encounters.values())
    for least, i, j in _least_clearances(robots, path):
        if least > max(smallest, 0.0) + tolerance:
            break
        encounters[j, i] = _Encounter((i, j), robots[i], path[:, i], robots[j], path[:, j], tolerance)
        smallest = min(smallest, encounters[j, i].smallest.min())
    return [encounters[who] for who in sorted(encounters)]


def _tolerance(workspace: Workspace) -> float:
    return max(_TOLERANCE * float(workspace.bounds.width.max()), 2 * workspace.tolerance)


def _least_clearances(robots: Sequence[Robot], path: JointPath) -> list[tuple[float, int, int]]:
    """Return, for each pair of robots, a lower bound of their clearance on the path, and the indices of both robots.

    Pairs come by ascending bound. Pairs of two points, which never collide, are left out.
    """
    radius = np.array([robot.circumscribed_radius for robot in robots])
    clearances = []
    for j in range(1, len(robots)):
        # The offset of the reference points moves along a segment: find its point nearest to 0.
        x, y = np.moveaxis(path[:, :j, :2] - path[:, j, None, :2], 2, 0)
        distances = distance_to_segment(x[:-1], y[:-1], np.diff(x, axis=0), np.diff(y, axis=0))
        least = distances.min(axis=0) - radius[:j] - radius[j]
        clearances += [(float(least[i]), i, j) for i in np.flatnonzero(radius[:j] + radius[j] > 0).tolist()]
    return sorted(clearances)


def _at(path: Float[np.ndarray, "steps dof"], when: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n dof"]:
    motion = np.minimum(when.astype(int), len(path) - 2)
    return between(path[motion], path[motion + 1], (when - motion)[:, None])


def _rim_speeds(robot: Robot, path: Float[np.ndarray, "steps dof"]) -> Float[np.ndarray, " motions"]:
    """Return, for each motion, an upper bound of the length of the arcs that a robot's corners move by turning."""
    turn = shorter_turn(path[:-1, 2], path[1:, 2]) if robot.dof == 3 else np.zeros(len(path) - 1)
    return np.linalg.norm(robot.core, axis=1).max() * np.abs(turn)


def _find_crossing(problem: Problem, path: JointPath, margin: float) -> tuple[int, float, str] | None:
    """Find the first motion in which a point robot crosses a wall, or a contact (a point where obstacles touch).

    Return the robot's index, the index of the motion and a message, or None if there is no such motion. A point may
    be outside of free space by ``margin``.
    """
    most = _tolerance(problem.workspace)
    points = [i for i, robot in enumerate(problem.robots) if robot.circumscribed_radius <= most]
    first = {i: _first_crossing(problem.workspace, path[:, i, :2], margin) for i in points}
    if not (crossings := [(when, i) for i, when in first.items() if when is not None]):
        return None
    when, i = min(crossings)
    message = f"Robot {i} crosses a wall, or squeezes between obstacles that touch, in the motion from step {when}."
    return i, when, message


def _first_crossing(workspace: Workspace, track: Float[np.ndarray, "steps 2"], margin: float) -> int | None:
    """Return the index of the first motion in which a point robot crosses a wall or a contact; None if it never does.

    A contact is a point where obstacles touch. The robot's path is ``track``; the robot may be outside of free space
    by ``margin``. A motion is *doubtful* if it leaves the free space, or comes within ``margin`` of a contact. Walls,
    and contacts unless ``workspace.squeeze``, divide the free space near a doubtful motion into parts. The robot may
    begin the motion in these parts:

    - After another doubtful motion: in the parts that overlap a part in which that motion may have ended.
    - Otherwise: in the part nearest to the robot. At a contact, several parts are nearest.

    If the robot ends the motion in none of these parts, it crosses a wall or a contact.
    """
    # 1. Only motions that leave the free space, or pass a contact, can cross something.
    segments: Any = shapely.linestrings(np.stack([track[:-1], track[1:]], axis=1))
    points: Any = shapely.points(track)
    is_doubtful = ~shapely.covers(workspace.free_space, segments)
    is_doubtful |= workspace.boundary.touches_contact(segments, margin)
    # 2. In each row, find which parts the point may be in: in a *loose* row, all within the margin; else the nearest.
    #    A point near a contact at an end of its path is on all sides. Between two doubtful motions, it may be inside
    #    a thin wall.
    is_loose = np.pad(is_doubtful[:-1] & is_doubtful[1:], 1)
    is_loose[[0, -1]] |= workspace.boundary.touches_contact(points[[0, -1]], margin)
    # 3. Follow the point from part to part.
    part_before = None
    for k in np.flatnonzero(is_doubtful).tolist():
        parts = shapely.get_parts(shapely.intersection(workspace.free_space, shapely.buffer(segments[k], margin)))
        parts = parts[shapely.area(parts) > 0]
        group = part_groups(parts, workspace.squeeze)
        gaps = [shapely.distance(parts, points[row]) for row in (k, k + 1)]
        most = [margin if is_loose[k + end] else gaps[end].min(initial=np.inf) + _SLACK * margin for end in (0, 1)]
        if part_before is None or not is_doubtful[k - 1]:
            is_reached = gaps[0] <= most[0]
        else:
            is_reached = shapely.area(shapely.intersection(parts, part_before)) > 0
        is_reached = np.isin(group, group[is_reached]) & (gaps[1] <= margin)
        part_before = shapely.union_all(parts[is_reached])
        if not (is_reached & (gaps[1] <= most[1])).any():
            return k
    return None


def _find_wrong_end(problem: Problem, path: JointPath) -> tuple[int, float, str] | None:
    for row, expected, verb in ((0, problem.starts, "begins"), (len(path) - 1, problem.goals, "ends")):
        for i, robot in enumerate(problem.robots):
            got, should = path[row, i, : robot.dof].tolist(), expected[i, : robot.dof].tolist()
            if got != should:
                return i, float(row), f"Robot {i} {verb} at {got} and not exactly at {should}."
    return None


def _collision_report(problem: Problem, collision: _Encounter, cost: float) -> ValidationReport:
    workspace = problem.workspace
    when = collision.first_moment
    # Take the smallest clearance at some moments of the first motion that collides: about minus the overlap's depth.
    times = np.append(int(when) + np.linspace(0.0, 1.0, 65), when)
    depth = min(float(collision.clearances(times).min()), -collision.tolerance)
    q = _at(collision.path, np.array([when]))
    x, y = q[0, :2].tolist()
    event = f"Robots {collision.who[0]} and {collision.who[-1]} collide"
    if collision.other_path is None:
        body, obstacles = footprint(collision.robot, q)[0], np.array(workspace.obstacles, dtype=object)
        # The distance to an empty (removed) obstacle is NaN: it counts as infinite.
        distance = np.nan_to_num(np.append(shapely.distance(body, obstacles), np.inf), nan=np.inf, posinf=np.inf)
        bounds = shapely.box(*workspace.bounds.lo, *workspace.bounds.hi)
        outside = not shapely.covers(bounds, body) or shapely.distance(body, bounds.exterior) < distance.min()
        hits = "leaves the bounds" if outside else f"collides with obstacle {np.argmin(distance)}"
        event = f"Robot {collision.who[0]} {hits}"
    message = f"{event} at step {when:.6g}, the first at ({x:.6g}, {y:.6g}) (clearance {depth:.3g})."
    return ValidationReport(False, cost, depth, message, collision.who, when, (x, y))
