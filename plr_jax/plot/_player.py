"""A page that plays a path: one file, nothing loaded from elsewhere."""

import html
import json
import math
from pathlib import Path

import numpy as np
import shapely
from jaxtyping import Float

from plr_jax._problem import Problem
from plr_jax.plot._page import INK
from plr_jax.plot._plane import OBSTACLE, blocked_polygons
from plr_jax.plot._robots import body_outline, color_of, drawn_rounding, front, ink_on, nose, outline
from plr_jax.plot._timeline import Timeline
from plr_jax.robots.motion import placed

_SIZE = 520.0  # pixels along the longer side of the bounds, before the browser scales them
_BORDER, _CONTROLS, _PADDING = 2.0, 28, 6
HOLD = 1.2  # seconds between the end and the next round
_SMALLEST_NUMBERED = 10.0  # pixels across a body that carries a number


def page(problem: Problem, motion: Timeline, seconds: float) -> str:
    """The page as HTML."""
    template = Path(__file__).with_name("player.html").read_text(encoding="utf-8")
    filled = {
        "robots": str(len(problem.robots)),
        "ink": INK,
        "obstacle": OBSTACLE,
        "svg": _svg(problem, motion),
        "motion": json.dumps(_motion(problem, motion, seconds), separators=(",", ":")),
    }
    for name, value in filled.items():
        template = template.replace("{{" + name + "}}", value)
    return template


def embedded(problem: Problem, motion: Timeline, seconds: float) -> str:
    """The page in a frame of its own, so that many fit on one page and none sees the others."""
    width, height = _SIZE * problem.workspace.bounds.width / problem.workspace.bounds.width.max() + 2 * _BORDER
    size = f'width="{width + 2 * _PADDING:.0f}" height="{height + 2 * _PADDING + _CONTROLS:.0f}"'
    source = html.escape(page(problem, motion, seconds))
    return f'<iframe srcdoc="{source}" {size} sandbox="allow-scripts" style="border:0;max-width:100%"></iframe>'


def _motion(problem: Problem, motion: Timeline, seconds: float) -> dict[str, object]:
    """What the page needs to know of the path; coordinates to a twentieth of a pixel or finer."""
    bounds = problem.workspace.bounds
    digits = max(0, 4 - math.floor(math.log10(bounds.width.max())))
    headings = [robot.dof == 3 for robot in problem.robots]
    return {
        "seconds": seconds,
        "hold": HOLD,
        "view": {"scale": _scale(problem), "left": float(bounds.lo[0]), "top": float(bounds.hi[1])},
        "duration": motion.duration,
        "times": [_number(share, 6) for share in motion.times / motion.duration],
        "steps": [
            [
                [_number(x, digits), _number(y, digits)] + ([_number(rest[0], 4)] if turns else [])
                for (x, y, *rest), turns in zip(step, headings, strict=True)
            ]
            for step in motion.configurations
        ],
    }


def _number(value: float, digits: int) -> float | int:
    """A number in as few characters as its digits need."""
    rounded = round(float(value), digits)
    return int(rounded) if rounded == int(rounded) else rounded


def _scale(problem: Problem) -> float:
    return _SIZE / float(problem.workspace.bounds.width.max())


def _svg(problem: Problem, motion: Timeline) -> str:
    """Everything at its place at time 0; the script moves what moves."""
    width, height = _scale(problem) * problem.workspace.bounds.width
    robots = range(len(problem.robots))
    frame = f'<rect class="frame" width="{width:.1f}" height="{height:.1f}"/>'
    parts = [_obstacles(problem), frame]
    parts += [_track(problem, motion, i, "track") for i in robots]
    parts += [_goal(problem, i) for i in robots]
    parts += [_track(problem, motion, i, "trail") for i in robots]
    parts += [_robot(problem, i) for i in robots]
    box = f"{-_BORDER:g} {-_BORDER:g} {width + 2 * _BORDER:.1f} {height + 2 * _BORDER:.1f}"
    label = f"{len(problem.robots)} robots move from their starts to their goals"
    return f'<svg viewBox="{box}" role="img" aria-label="{label}">\n' + "\n".join(parts) + "\n</svg>"


def _pixels(problem: Problem, points: Float[np.ndarray, "n 2"]) -> str:
    """Points in pixels, y downward."""
    bounds = problem.workspace.bounds
    x, y = _scale(problem) * (points[:, 0] - bounds.lo[0]), _scale(problem) * (bounds.hi[1] - points[:, 1])
    return " ".join(f"{a:.2f},{b:.2f}" for a, b in zip(x, y, strict=True))


def _obstacles(problem: Problem) -> str:
    rings = []
    for polygon in blocked_polygons(problem.workspace):
        for ring in (polygon.exterior, *polygon.interiors):
            rings.append(f"M{_pixels(problem, shapely.get_coordinates(ring)[:-1])}Z")
    return f'<path d="{"".join(rings)}" class="obstacle" fill-rule="evenodd"/>'


def _line(i: int) -> str:
    """The color of a robot's lines, which a dark page lightens."""
    return f'stroke="{color_of(i)}" style="--color:{color_of(i)}"'


def _track(problem: Problem, motion: Timeline, i: int, kind: str) -> str:
    name = f' id="trail{i}" stroke-dasharray="0 1"' if kind == "trail" else ""
    points = _pixels(problem, motion.configurations[:, i, :2])
    return f'<polyline class="{kind}"{name} {_line(i)} points="{points}"/>'


def _goal(problem: Problem, i: int) -> str:
    robot, q, bounds = problem.robots[i], problem.goals[i], problem.workspace.bounds
    points = _pixels(problem, outline(robot, q, bounds))
    shape = f'<polygon class="halo" points="{points}"/><polygon class="goal" {_line(i)} points="{points}"/>'
    if robot.dof == 2:
        return shape
    ahead = _pixels(problem, placed(robot, front(robot, bounds), q))
    return f'{shape}<polyline class="front" {_line(i)} points="{ahead}"/>'


def _robot(problem: Problem, i: int) -> str:
    """A robot about the origin: what turns with it, and its number, which stays upright."""
    robot, scale, color, bounds = problem.robots[i], _scale(problem), color_of(i), problem.workspace.bounds
    radius = scale * drawn_rounding(robot, bounds)
    if robot.core.any():
        points = " ".join(f"{x:.2f},{-y:.2f}" for x, y in scale * body_outline(robot, bounds))
        body = f'<polygon class="body" points="{points}" fill="{color}"/>'
    else:
        body = f'<circle class="body" r="{radius:.2f}" fill="{color}"/>'
    if robot.dof == 3:
        (x, y0), (_, y1) = scale * nose(robot, bounds)
        body += f'<path class="nose" stroke="{ink_on(color)}" d="M{x:.2f} {-y0:.2f}V{-y1:.2f}"/>'
    number = f'<text y="4" fill="{ink_on(color)}">{i}</text>'
    if 2 * robot.inscribed_radius * scale < _SMALLEST_NUMBERED:
        beside = scale * robot.circumscribed_radius or radius
        place = f'x="{beside + 6:.2f}" y="{-beside:.2f}"'
        number = f'<text class="beside" {place} style="--color:{color}" fill="{color}">{i}</text>'
    return f'<g id="place{i}"><g id="turn{i}">{body}</g>{number}</g>'
