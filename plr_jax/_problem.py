"""Planning problems (robots in a workspace, each with a start and a goal) and the cost of paths."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import shapely
from jaxtyping import Bool, Float

from plr_jax._arrays import as_finite, as_numbers, is_single, require_type, set_fields, shortened
from plr_jax._types import ArrayLike
from plr_jax.geometry.workspace import Workspace, part_groups, require_workspace
from plr_jax.robots import Configurations, Robot, check_body, footprint, smaller_angle

JointPath: TypeAlias = Float[np.ndarray, "steps robots dof"]
ROUNDING = 1e-9  # costs count as equal if their relative difference is smaller; rounding changes them far less
_VERBS = {"starts": "starts", "goals": "has its goal"}


@dataclass(frozen=True, eq=False)
class Problem:
    """Robots in a workspace, each with a start and a goal.

    Robots may touch walls and one another, and may overlap by up to ``workspace.tolerance``. Point robots never
    collide with one another. If starts or goals are given as 32-bit floats, and overlap walls only by rounding, they
    are moved off the walls.

    Args:
        workspace: The obstacles and bounds.
        robots: The robots, one or more.
        starts: Start configurations, ``(robots, dof)``. Rows are ``(x, y)`` in workspace units if no robot has a
            heading, else ``(x, y, heading)`` with the heading in radians, ignored for points and discs.
        goals: Goal configurations, ``(robots, dof)``.
        rotation_weight: Cost of a turn by one radian, in workspace units, at least 0, for robots with a heading.
            None: each robot's circumscribed radius, such as half the diagonal of a rectangle.

    Raises:
        ValueError: If there is no robot, an argument has a wrong shape or value, or a start or goal is outside the
            bounds or in collision. Also if obstacles leave no path from a start to its goal even for the robot's
            inscribed disc. A problem that passes these tests may still have no solution.
    """

    workspace: Workspace
    robots: tuple[Robot, ...]
    starts: Float[np.ndarray, "robots dof"]
    goals: Float[np.ndarray, "robots dof"]
    rotation_weight: float | None

    def __init__(
        self,
        workspace: Workspace,
        robots: Sequence[Robot],
        starts: ArrayLike,
        goals: ArrayLike,
        rotation_weight: float | int | None = None,
    ):
        require_workspace(workspace)
        require_type("robots", robots, Iterable, "a list of robots")
        robots = tuple(robots)
        for i, robot in enumerate(robots):
            if not isinstance(robot, Robot):
                raise ValueError(f"Robot {i} must be a Robot, such as DiscRobot(radius), got {robot!r}.")
            check_body(f"Robot {i}", robot)
        if not robots:
            raise ValueError("A problem needs at least one robot, got none.")
        weight = None if rotation_weight is None else as_finite("rotation_weight", rotation_weight)
        set_fields(self, workspace=workspace, robots=robots, rotation_weight=weight)
        poses = {"starts": starts, "goals": goals}
        set_fields(self, **{name: _configurations(name, q, self) for name, q in poses.items()})
        for name in poses:
            _require_free(self, name)
            _require_no_overlap(self, name)
        _require_connected(self)

    @property
    def dof(self) -> int:
        """Length of each robot's configuration: 2 if no robot has a heading, else 3."""
        return max(robot.dof for robot in self.robots)

    @property
    def rotation_weights(self) -> Float[np.ndarray, " robots"]:
        """Cost of each robot's turn by one radian, in workspace units; 0 for robots without a heading."""
        return _rotation_weights(self.robots, self.rotation_weight)


def _rotation_weights(robots: Sequence[Robot], weight: float | None) -> Float[np.ndarray, " robots"]:
    weights = [robot.circumscribed_radius if weight is None else weight for robot in robots]
    return np.array(weights) * [robot.dof == 3 for robot in robots]


def robot_kinds(problem: Problem) -> dict[tuple[Robot, float], list[int]]:
    """Return, for each pair of a shape and a rotation weight, the indices of the robots that have both."""
    kinds = {}
    for i, kind in enumerate(zip(problem.robots, problem.rotation_weights.tolist(), strict=True)):
        kinds.setdefault(kind, []).append(i)
    return kinds


def motion_costs(problem: Problem, q0: Configurations, q1: Configurations) -> Float[np.ndarray, "*batch"]:
    """Return the costs ``(..., robots)`` of straight motions between joint configurations ``(..., robots, dof)``."""
    return straight_costs(q0, q1, problem.rotation_weights)


def straight_costs(q0: Configurations, q1: Configurations, rotation_weight: ArrayLike) -> Float[np.ndarray, "*batch"]:
    """Return the costs of straight motions: lengths plus ``rotation_weight`` times the angles turned, in radians.

    ``rotation_weight`` is one number, or one per robot. Robots turn the shorter way. Without headings (``dof`` 2),
    costs are lengths.
    """
    cost = np.hypot(q1[..., 0] - q0[..., 0], q1[..., 1] - q0[..., 1])
    if q0.shape[-1] == 3:
        cost = cost + rotation_weight * smaller_angle(q0[..., 2], q1[..., 2])
    return cost


def path_cost(problem: Problem, path: ArrayLike) -> float:
    """Return the sum of the motion costs of a path ``(steps, robots, dof)``; another shape raises ``ValueError``."""
    path = as_path(problem, path)
    return float(motion_costs(problem, path[:-1], path[1:]).sum())


def makespan(problem: Problem, path: ArrayLike) -> float:
    """Return the duration of a path ``(steps, robots, dof)`` at unit speed.

    The duration of a motion is the largest cost of any robot in this motion. If ``rotation_weight`` is 0, turns cost
    nothing but still take time: as much as with the default weight.
    """
    return float(row_times(problem, path)[-1])


def row_times(problem: Problem, path: ArrayLike) -> Float[np.ndarray, " steps"]:
    """Return the time ``(steps,)`` at which the robots reach each row of a path ``(steps, robots, dof)``.

    Times rise from 0 to the :func:`makespan`.
    """
    path = as_path(problem, path)
    weights = _rotation_weights(problem.robots, problem.rotation_weight or None)
    return np.append(0.0, np.cumsum(straight_costs(path[:-1], path[1:], weights).max(axis=1)))


def require_problem(problem: object, path: object = None) -> None:
    require_type("problem", problem, Problem, "a Problem, such as Problem(workspace, robots, starts, goals)")
    if hasattr(path, "path"):
        raise ValueError(f"A path must be an array (steps, robots, dof), got {shortened(path)}. Pass its .path.")


def as_path(problem: Problem, path: ArrayLike) -> JointPath:
    """Check a path, and return it as a float64 array ``(steps, robots, dof)``.

    If the path has 32-bit floats, a robot's first configuration is replaced by its start if both are equal up to
    rounding, and its last configuration by its goal.
    """
    require_problem(problem, path)
    if path is None:
        raise ValueError("A path must be an array, got None: solution.path is None, see solution.status.")
    shape = f"(steps, robots, dof) = (steps, {len(problem.robots)}, {problem.dof})"
    array = as_numbers("A path", path, f"numbers of shape {shape}")
    if array.ndim != 3 or array.shape[1:] != problem.starts.shape or len(array) == 0:
        raise ValueError(f"A path must have shape {shape} with at least one step, got {array.shape}.")
    if is_single(path):
        for row, ends in ((0, problem.starts), (-1, problem.goals)):  # starts and goals may have more bits
            for i, (robot, end) in enumerate(zip(problem.robots, ends, strict=True)):
                pose = np.asarray(path)[row, i]
                is_end = np.array_equal(settled_pose(problem.workspace, robot, pose), end)
                array[row, i] = end if is_end or np.array_equal(pose, end.astype(np.float32)) else pose
    return array


def settled_pose(workspace: Workspace, robot: Robot, q: ArrayLike) -> ArrayLike:
    """Move a pose ``q`` of 32-bit floats, ``(dof,)``, off walls that the robot overlaps only by rounding.

    A pose of another type is returned unchanged.
    """
    if not is_single(q):
        return q
    position, heading = np.split(np.asarray(q), [2])
    if robot.circumscribed_radius <= workspace.tolerance:
        position = workspace.settled(position)
    else:

        def is_free(x: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, " n"]:
            clearances = [_clearances(workspace, robot, np.append(point, heading)) for point in x]
            return np.array([min(inside, clearance) >= -workspace.tolerance for inside, clearance, _ in clearances])

        reach = robot.circumscribed_radius * max(1.0, np.abs(heading).max(initial=0.0))
        position = workspace.bounds.settled(position, is_free, reach)
    return np.append(position, heading.astype(np.float64))


def _configurations(name: str, value: ArrayLike, problem: Problem) -> Float[np.ndarray, "robots dof"]:
    """Check starts or goals (``name`` says which), and return them as a read-only float64 array.

    Configurations of 32-bit floats that lie in an obstacle only by rounding are moved out of the obstacle.
    """
    robots, dof = problem.robots, problem.dof
    shape = f"(robots, dof) = ({len(robots)}, {dof})"
    configurations = as_numbers(name, value, f"numbers of shape {shape}").copy()
    if is_single(value) and configurations.shape == (len(robots), dof):
        poses = np.asarray(value)
        configurations[:] = [settled_pose(problem.workspace, *pair) for pair in zip(robots, poses, strict=True)]
    if configurations.shape != (len(robots), dof):
        reason = ""
        if configurations.shape == (len(robots), 2):
            turning = next(i for i, robot in enumerate(robots) if robot.dof == 3)
            rows = "each row is (x, y, heading in radians), 0 for robots that do not turn"
            reason = f": robot {turning} can turn, so {rows}"
        elif configurations.shape == (len(robots), 3):
            reason = ": no robot can turn, so each row is (x, y)"
        raise ValueError(f"{name} must have shape {shape}, got {configurations.shape}{reason}.")
    if len(broken := np.flatnonzero(~np.isfinite(configurations).all(axis=1))):
        raise ValueError(f"{name} must be finite, got {configurations[broken[0]]} for robot {broken[0]}.")
    configurations.flags.writeable = False
    return configurations


def _require_free(problem: Problem, name: str) -> None:
    """Raise a ``ValueError`` if a robot leaves the bounds or overlaps an obstacle.

    ``name`` says where: at its start ("starts") or at its goal ("goals").
    """
    workspace = problem.workspace
    for i, (robot, q) in enumerate(zip(problem.robots, getattr(problem, name), strict=True)):
        inside, clearance, obstacle = _clearances(workspace, robot, q)
        if inside < -workspace.tolerance:
            is_in = workspace.bounds.contains(q[None, :2])[0]
            place = f" by {-inside:.3g} at {q.tolist()}" if is_in else f": {q.tolist()} is not in {workspace.bounds}"
            raise ValueError(f"Robot {i} {_VERBS[name]} outside the bounds{place}: move it inside.")
        if clearance < -workspace.tolerance:
            place = f"at {q.tolist()} (clearance {clearance:.3g})"
            raise ValueError(f"Robot {i} {_VERBS[name]} in collision with obstacle {obstacle} {place}: move it.")


def _clearances(workspace: Workspace, robot: Robot, q: Float[np.ndarray, " dof"]) -> tuple[float, float, int]:
    """Return a robot's distance to the edge of the bounds, and the clearance and index of the nearest obstacle.

    The distance is negative if the robot leaves the bounds. Only obstacles that the robot touches or overlaps are
    measured, so the clearance is at most 0. If there are none, the clearance is ``inf`` and the index -1.
    """
    core, radius, obstacles = footprint(robot, q), robot.rounding, np.array(workspace.obstacles, dtype=object)
    shapely.prepare(obstacles)
    left, bottom, right, top = shapely.bounds(core)
    (x0, y0), (x1, y1) = workspace.bounds.lo, workspace.bounds.hi
    inside = min(left - x0, bottom - y0, x1 - right, y1 - top) - radius
    near = np.flatnonzero(shapely.distance(core, obstacles) <= radius)
    clearances = [separation(core, obstacles[j]) - radius for j in near]
    return inside, min(clearances, default=np.inf), int(near[np.argmin(clearances)]) if clearances else -1


def _require_no_overlap(problem: Problem, name: str) -> None:
    """Raise a ``ValueError`` if two robots overlap at their starts (if ``name`` is "starts") or at their goals."""
    configurations = getattr(problem, name)
    cores = np.array([footprint(robot, q) for robot, q in zip(problem.robots, configurations, strict=True)])
    rounding = np.array([robot.rounding for robot in problem.robots])
    a, b = shapely.STRtree(cores).query(cores, predicate="dwithin", distance=rounding + rounding.max())
    a, b = a[a < b], b[a < b]
    for j, i in sorted(zip(b.tolist(), a.tolist(), strict=True)):
        if (clearance := separation(cores[i], cores[j]) - rounding[i] - rounding[j]) < -problem.workspace.tolerance:
            pair = f"{configurations[i].tolist()} and {configurations[j].tolist()}"
            raise ValueError(f"Robots {i} and {j} overlap at their {name}: {pair} (clearance {clearance:.3g}).")


def _require_connected(problem: Problem) -> None:
    """Raise a ``ValueError`` if obstacles leave no path from a start to its goal for the robot's inscribed disc."""
    workspace, parts_of = problem.workspace, {}
    for i, robot in enumerate(problem.robots):
        radius = max(0.0, robot.inscribed_radius - workspace.tolerance)  # a passage of equal width stays open
        if radius not in parts_of:
            polygons = shapely.get_parts(workspace.inflate(radius).free_space)
            parts_of[radius] = polygons, part_groups(polygons, workspace.squeeze)
        parts, label = parts_of[radius]
        # A start or goal where obstacles touch lies in several parts.
        apart = [shapely.distance(shapely.Point(q[i, :2]), parts) for q in (problem.starts, problem.goals)]
        first, last = (label[distance <= distance.min() + workspace.tolerance] for distance in apart)
        if not np.isin(first, last).any():
            body = "it" if radius == 0 else f"a disc of radius {robot.inscribed_radius:g}"
            reason = f"obstacles leave no path for {body} between them"
            start, goal = problem.starts[i].tolist(), problem.goals[i].tolist()
            raise ValueError(f"Robot {i} has its goal {goal} cut off from its start {start}: {reason}.")


def separation(a: Any, b: Any) -> float:
    """Return the distance between two Shapely geometries; if they overlap, minus the depth of the overlap.

    The depth of a point in a polygon is the point's distance to the polygon's boundary. The depth of two polygons is
    estimated from the area and the perimeter of their intersection. If one shape is a segment, or both are points,
    the depth is 0.
    """
    if (distance := shapely.distance(a, b)) > 0 or shapely.get_dimensions([a, b]).max() < 2:
        return distance
    if "Point" in (a.geom_type, b.geom_type):
        point, polygon = (a, b) if a.geom_type == "Point" else (b, a)
        return -shapely.distance(point, shapely.boundary(polygon))
    overlap = shapely.intersection(a, b)
    area = shapely.area(overlap)
    return -2 * area / shapely.length(overlap) if area > 0 else 0.0
