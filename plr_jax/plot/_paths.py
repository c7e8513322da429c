"""Draw problems, planned paths and samples; and draw robots, also for animations."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import shapely
from jaxtyping import Float
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.patches import Polygon
from matplotlib.patheffects import withStroke

from plr_jax._arrays import as_numbers
from plr_jax._problem import Problem, as_path, row_times
from plr_jax._types import ArrayLike
from plr_jax.geometry.box import Box
from plr_jax.plot import _axes, _plane
from plr_jax.robots import Robot, placed, rows_around, shorter_turn


class Timeline(NamedTuple):
    """A path of all robots: configurations at nondecreasing times, from 0 to the path's duration.

    Headings are continuous: they grow beyond pi instead of jumping by a full turn.
    """

    times: Float[np.ndarray, " steps"]
    configurations: Float[np.ndarray, "steps robots dof"]

    @property
    def duration(self) -> float:
        return float(self.times[-1])

    def at(self, times: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n robots dof"]:
        """Return the configurations at given times, interpolated between the rows before and after each time."""
        row, after, fraction = rows_around(self.times, times)
        fraction = fraction[:, None, None]
        return (1 - fraction) * self.configurations[row] + fraction * self.configurations[after]

    def between(self, first: float, last: float) -> Float[np.ndarray, "steps robots dof"]:
        """Return the part of the path from one time to another, with both ends."""
        ends = self.at(np.array([first, last]))
        return np.concatenate([ends[:1], self.configurations[(self.times > first) & (self.times < last)], ends[1:]])


def timeline(problem: Problem, path: ArrayLike) -> Timeline:
    """Return a path with the time of each of its configurations; steps in which no robot moves are left out.

    ``ValueError`` if the path is not finite.
    """
    path = as_path(problem, path)
    if (bad := np.argwhere(~np.isfinite(path))).size:  # (step, robot, coordinate)
        raise ValueError(f"A path must be finite, got {path[tuple(bad[0][:2])]} in step {bad[0][0]}.")
    # 1. Sum the moves. Headings change by the shorter turn. A robot without a heading does not turn.
    moves = np.diff(path, axis=0)
    if problem.dof == 3:
        has_heading = np.array([robot.dof == 3 for robot in problem.robots])
        moves[..., 2] = np.where(has_heading, shorter_turn(path[:-1, :, 2], path[1:, :, 2]), 0.0)
    continued = path[:1] + np.concatenate([np.zeros_like(path[:1]), np.cumsum(moves, axis=0)])
    continued[..., :2] = path[..., :2]  # exact, without rounding errors of the sum
    # 2. Drop the end of each step in which nothing moves.
    rows = np.append(True, moves.any(axis=(1, 2)))
    return Timeline(row_times(problem, path)[rows], continued[rows])


# From named color-blind-safe palettes: any two stay distinct for normal, red-, green- and blue-blind readers, and the
# first four most clearly.
ROBOT_COLORS = ("#0072B2", "#E69F00", "#B22222", "#56B4E9", "#009988", "#882255", "#D55E00", "#1B4F9C")
DASHES = (3.0, 1.6)  # dash and gap of a goal's outline, in line widths
_DOT = 0.011  # radius of a point robot's dot, as a share of the longer side of the bounds
_CORNERS = 72  # corners of the polygon that draws a disc
_AHEAD = 0.7  # cosine of the largest angle between the heading and the normal of a front side
_LIGHT = 0.55  # bodies of colors with a larger luma (from 0 to 1) get dark numbers
# Unit vectors around a robot, at which its number may be: first the diagonal ones, then those along the axes.
_AROUND = np.array([(np.cos(angle), np.sin(angle)) for angle in np.pi / 4 * np.array([1, 3, 5, 7, 0, 2, 4, 6])])
BODY, LABEL = 5.0, 6.0  # z-orders, above obstacles


def color_of(i: int) -> str:
    return ROBOT_COLORS[i % len(ROBOT_COLORS)]


def ink_on(color: str) -> str:
    return _axes.INK if np.dot(to_rgb(color), (0.299, 0.587, 0.114)) > _LIGHT else "white"


def body_outline(robot: Robot, bounds: Box) -> Float[np.ndarray, "corners 2"]:
    """Return the corners of a robot's body in its own frame, counterclockwise; a point robot is a small disc."""
    if (radius := drawn_rounding(robot, bounds)) == 0:
        return robot.core
    # In each direction u, the farthest point of the body is the farthest core vertex, plus radius * u.
    angle = 2 * np.pi * np.arange(_CORNERS) / _CORNERS
    directions = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return robot.core[np.argmax(directions @ robot.core.T, axis=1)] + radius * directions


def drawn_rounding(robot: Robot, bounds: Box) -> float:
    """Return the radius by which pictures round a robot's core polygon; for a point robot, the radius of a dot."""
    return robot.rounding if robot.circumscribed_radius > 0 else _DOT * float(bounds.width.max())


def heading_bar(robot: Robot, bounds: Box) -> Float[np.ndarray, "2 2"]:
    """Return the ends of a bar that shows the heading: across a robot's body near its front, in the robot's frame."""
    #   +---------|--+
    #   |         |  |-->   The bar takes 56 % of the body's width at x, which is 20 % of the body's shorter side
    #   +---------|--+      behind the front.
    #             x
    corners = body_outline(robot, bounds)
    x = corners[:, 0].max() - 0.2 * np.ptp(corners, axis=0).min()
    across = shapely.LineString([(x, corners[:, 1].min()), (x, corners[:, 1].max())])
    y0, y1 = shapely.get_coordinates(shapely.intersection(shapely.Polygon(corners), across))[[0, -1], 1]
    y = (y0 + y1) / 2 + 0.28 * abs(y1 - y0) * np.array([-1, 1])
    return np.stack([[x, x], y], axis=1)


def front_sides(robot: Robot, bounds: Box) -> Float[np.ndarray, "points 2"]:
    """Return the part of a robot's outline that faces forward: an open polyline, counterclockwise.

    Points are in the robot's own frame. The workspace's ``bounds`` determine the size of a point robot's dot.
    """
    # 1. The outline is counterclockwise, so a side (dx, dy) has the outer normal (dy, -dx). The heading points along
    #    x, so the cosine of the angle between the two is dy / |side|.
    corners = body_outline(robot, bounds)
    sides = np.roll(corners, -1, axis=0) - corners
    cosine = sides[:, 1] / np.hypot(*sides.T)
    # 2. Front sides follow one another, since the body is convex. Return their ends, from the first front side on.
    is_front = cosine >= min(_AHEAD, cosine.max() - 1e-9)
    first = int(np.flatnonzero(is_front & ~np.roll(is_front, 1))[0])
    return corners[(first + np.arange(is_front.sum() + 1)) % len(corners)]


def outline(robot: Robot, q: Float[np.ndarray, " dof"], bounds: Box) -> Float[np.ndarray, "corners 2"]:
    """Return the corners of a robot's body in configuration ``q``, counterclockwise."""
    return placed(robot, body_outline(robot, bounds), q)


def add_body(ax: Axes, problem: Problem, i: int, q: Float[np.ndarray, " dof"]) -> list[Artist]:
    robot, color = problem.robots[i], color_of(i)
    corners = outline(robot, q, problem.workspace.bounds)
    body = ax.add_patch(Polygon(corners, facecolor=color, edgecolor="white", linewidth=0.6, zorder=BODY))
    if robot.dof == 2:
        return [body]
    ends = placed(robot, heading_bar(robot, problem.workspace.bounds), q)
    return [body, *ax.plot(*ends.T, color=ink_on(color), linewidth=1.1, zorder=BODY + 0.1)]


def add_goal(ax: Axes, problem: Problem, i: int, zorder: float = BODY) -> None:
    robot, q, bounds = problem.robots[i], problem.goals[i], problem.workspace.bounds
    corners = outline(robot, q, bounds)
    style = {"edgecolor": color_of(i), "linewidth": 1.2}
    ax.add_patch(Polygon(corners, fill=False, edgecolor="white", linewidth=2.4, zorder=zorder + 0.1))
    ax.add_patch(Polygon(corners, fill=False, **style, linestyle=(0.0, DASHES), zorder=zorder + 0.2))
    if robot.dof == 3:  # the front is solid
        front = placed(robot, front_sides(robot, bounds), q)
        ax.add_patch(Polygon(front, closed=False, fill=False, **style, zorder=zorder + 0.2))


def add_number(ax: Axes, i: int, at: Float[np.ndarray, "2"], color: str) -> Artist:
    style = {"fontsize": _axes.FONT_SIZE - 1, "weight": "bold", "ha": "center", "va": "center_baseline"}
    return ax.text(at[0], at[1], str(i), color=color, zorder=LABEL, **style)


def add_numbers(ax: Axes, problem: Problem, ends: Float[np.ndarray, "ends dof"]) -> None:
    """Write each robot's number inside its outline if there is room, else beside it.

    The first rows of ``ends`` are the configurations at which the robots' bodies are drawn. The goals of all robots
    may follow; their outlines are numbered too.
    """
    # 1. Outlines of bodies are filled (solid), those of goals are lines (dashed).
    bounds = problem.workspace.bounds
    num_robots = len(problem.robots)
    robots = (problem.robots * 2)[: len(ends)]
    shapes = [shapely.Polygon(outline(robot, q, bounds)) for robot, q in zip(robots, ends, strict=True)]
    solid, dashed = shapes[:num_robots], [shape.exterior for shape in shapes[num_robots:]]
    occupied = [*shapes, shapely.box(*bounds.lo, *bounds.hi).exterior]
    for k, (robot, q, shape) in enumerate(zip(robots, ends, shapes, strict=True)):
        is_goal, i = divmod(k, num_robots)
        center = q[:2]
        size = number_size(ax, i)
        fits = 2 * robot.inscribed_radius >= 0.75 * size
        if fits and not (is_goal and shapely.intersects(_square(center, size), solid).any()):
            # 2. Inside: at the center. In a body, it is off the center if a goal's outline runs through the center.
            around = [center, *(center + 0.45 * robot.inscribed_radius * _AROUND)]
            place = center if is_goal else _least_covered(around, dashed, size)
            add_number(ax, i, place, color_of(i) if is_goal else ink_on(color_of(i)))
        else:
            # 3. Beside: at the one of eight places around the outline where the least is drawn.
            corners = shapely.get_coordinates(shape) - center
            around = [center + ((corners @ u).max() + 0.62 * size) * u for u in _AROUND]
            place = _least_covered(around, occupied, size)
            occupied.append(_square(place, size))
            add_number(ax, i, place, color_of(i)).set_path_effects([withStroke(linewidth=1.8, foreground="white")])


def number_size(ax: Axes, i: int) -> float:
    """Return the side of a square, in workspace units, that holds the number of robot ``i`` as drawn on ``ax``."""
    ax.apply_aspect()
    points = _axes.FONT_SIZE * (1 if i < 10 else 1.5)  # 72 points are one inch
    units = ax.transData.inverted().transform([(0.0, 0.0), (points * ax.figure.dpi / 72, 0.0)])
    return float(units[1, 0] - units[0, 0])


def _least_covered(
    places: Sequence[Float[np.ndarray, "2"]], drawn: Sequence[shapely.Geometry], size: float
) -> Float[np.ndarray, "2"]:
    """Return the place where a square of side ``size`` covers the least total length of the ``drawn`` outlines."""
    covered = [shapely.length(shapely.intersection(_square(place, size), drawn)).sum() for place in places]
    return places[int(np.argmin(covered))]


def _square(center: Float[np.ndarray, "2"], size: float) -> shapely.Polygon:
    x, y = center
    return shapely.box(x - size / 2, y - size / 2, x + size / 2, y + size / 2)


# z-orders of samples, faded bodies and paths: above obstacles, so that a path through an obstacle shows, and below
# solid bodies.
_SAMPLES, _FADED, _LINE = 3.2, 3.4, 4.0


def plot_problem(problem: Problem, ax: Axes | None = None) -> Axes:
    """Draw a problem: numbered bodies at the starts, with a bar for the heading, and dashed outlines at the goals."""
    ax = _plane.plot_workspace(problem.workspace, ax)
    for i in range(len(problem.robots)):
        add_body(ax, problem, i, problem.starts[i])
        add_goal(ax, problem, i)
    add_numbers(ax, problem, np.concatenate([problem.starts, problem.goals]))
    return ax


def plot_path(
    problem: Problem,
    path: ArrayLike,
    ax: Axes | None = None,
    *,
    begin: float | int = 0.0,
    end: float | int = 1.0,
    num_poses: int = 8,
) -> Axes:
    """Draw a path ``(steps, robots, dof)`` or a part of it, as in Fig. 3 of the paper (Putman et al.).

    The part lasts from ``begin`` to ``end``, fractions of the path's duration. Each robot's path is a line. Faded
    bodies show the robot at ``num_poses`` evenly spaced times; a robot that waits has fewer. The body at the end of
    the part is solid and numbered. An invalid path or number raises ``ValueError``.
    """
    if not 0 <= begin < end <= 1:
        raise ValueError(f"begin and end must be shares with 0 <= begin < end <= 1, got {begin!r} and {end!r}.")
    if num_poses < 0:
        raise ValueError(f"num_poses must be at least 0, got {num_poses!r}.")
    motion = timeline(problem, path)
    first, last = begin * motion.duration, end * motion.duration
    shown = motion.between(first, last)
    poses = motion.at(np.linspace(first, last, num_poses, endpoint=False))
    ax = _plane.plot_workspace(problem.workspace, ax)
    for i in range(len(problem.robots)):
        for k, q in enumerate(poses[:, i]):
            if k == 0 or (q != poses[k - 1, i]).any():  # draw a robot that waits once
                style = {"facecolor": (color_of(i), 0.13), "edgecolor": (color_of(i), 0.55), "linewidth": 0.6}
                ax.add_patch(Polygon(outline(problem.robots[i], q, problem.workspace.bounds), **style, zorder=_FADED))
        ax.plot(*shown[:, i, :2].T, color=color_of(i), linewidth=1.6, solid_joinstyle="round", zorder=_LINE)
        add_body(ax, problem, i, shown[-1, i])
    add_numbers(ax, problem, shown[-1])
    return ax


def plot_samples(problem: Problem, samples: ArrayLike, ax: Axes | None = None) -> Axes:
    """Draw positions, such as ``solution.samples``, as dots in a picture of the problem.

    The samples have the shape ``(n, robots, dof)``; another shape raises ``ValueError``. Fig. 4 of the paper (Putman
    et al.) is such a picture.
    """
    shape = f"(n, robots, dof) = (n, {len(problem.robots)}, {problem.dof})"
    samples = as_numbers("Samples", samples, f"numbers of shape {shape}")
    if samples.ndim != 3 or samples.shape[1:] != problem.starts.shape:
        raise ValueError(f"Samples must have shape {shape}, got {samples.shape}.")
    ax = plot_problem(problem, ax)
    colors = np.array([color_of(i) for i in range(len(problem.robots))])
    # In one collection, so that no robot's dots cover all dots of earlier robots.
    dots = {"c": np.tile(colors, len(samples)), "s": 2.2, "linewidths": 0, "zorder": _SAMPLES, "rasterized": True}
    ax.scatter(*samples[..., :2].reshape(-1, 2).T, **dots)
    return ax
