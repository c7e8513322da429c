"""Animate a path of robots, as a GIF file or as a web page that plays the path: :func:`animate`."""

import io
import json
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg

from plr_jax._arrays import as_finite, as_number
from plr_jax._files import StrPath, file_path, write_atomically
from plr_jax._problem import Problem
from plr_jax._types import ArrayLike
from plr_jax.plot import _axes, _paths, _plane
from plr_jax.plot._page import BORDER, PLAY, asset, html_document, in_iframe, obstacles_path, pixel_scale, pixels
from plr_jax.robots import placed

_CONTROLS = 28  # pixels: height of the controls below the picture, as in page.css
_PADDING = 6  # pixels around the page's content, as in page.css
HOLD = 1.2  # seconds of pause at the end before the animation repeats
_SMALLEST_NUMBERED = 10.0  # pixels across the smallest body whose number is drawn inside


def player(problem: Problem, motion: _paths.Timeline, seconds: float) -> str:
    """Return the HTML of a web page that plays a path; one playback takes ``seconds``."""
    content = json.dumps(_motion(problem, motion, seconds), separators=(",", ":"))
    body = _svg(problem, motion) + "\n" + asset("player.html").replace("{{play}}", PLAY).rstrip()
    script = asset("clock.js") + asset("player.js").replace("{{motion}}", content)
    return html_document(f"Path of {len(problem.robots)} robots", asset("player.css"), body, script)


def _motion(problem: Problem, motion: _paths.Timeline, seconds: float) -> dict[str, object]:
    """Return the robots' motion as data for ``player.js``; rounding moves positions by at most 1/20 of a pixel.

    ``seconds`` is the duration of one playback.
    """
    # The longer side w has SIZE = 520 pixels. Rounding to d = 4 - floor(log10 w) decimals changes a position by at
    # most 10**-d / 2 <= w * 1e-4 / 2, which is 0.026 pixels.
    bounds = problem.workspace.bounds
    decimals = max(0, 4 - math.floor(math.log10(bounds.width.max())))
    digits = [(decimals, decimals, 4)[: robot.dof] for robot in problem.robots]  # rounding stops after the dof
    steps = motion.configurations.tolist()
    return {
        "seconds": seconds,
        "hold": HOLD,
        "view": {"scale": pixel_scale(bounds), "left": float(bounds.lo[0]), "top": float(bounds.hi[1])},
        "duration": motion.duration,
        "times": np.round(motion.times / motion.duration, 6).tolist(),
        "steps": [[list(map(round, q, n)) for q, n in zip(step, digits, strict=True)] for step in steps],
    }


def _svg(problem: Problem, motion: _paths.Timeline) -> str:
    """Return an SVG picture of obstacles, goals and paths, with bodies at the origin for ``player.js`` to move."""
    bounds = problem.workspace.bounds
    scale = pixel_scale(bounds)
    width, height = scale * bounds.width
    obstacles = f'<path d="{obstacles_path(problem.workspace, bounds)}" class="obstacle" fill-rule="evenodd"/>'
    border = f'<rect class="frame" width="{width:.1f}" height="{height:.1f}"/>'
    tracks, goals, trails, bodies = [], [], [], []
    for i, (robot, goal) in enumerate(zip(problem.robots, problem.goals, strict=True)):
        color = _paths.color_of(i)
        line = f'stroke="{color}" style="--color:{color}"'  # lines get lighter on dark pages
        # 1. Draw the whole track as a thin line, and the trail, which grows with time.
        points = f'points="{pixels(bounds, motion.configurations[:, i, :2])}"'
        tracks.append(f'<polyline class="track" {line} {points}/>')
        trails.append(f'<polyline class="trail" id="trail{i}" stroke-dasharray="0 1" {line} {points}/>')
        # 2. Draw the goal as a dashed outline with a solid front.
        points = pixels(bounds, _paths.outline(robot, goal, bounds))
        goals.append(f'<polygon class="halo" points="{points}"/><polygon class="goal" {line} points="{points}"/>')
        if robot.dof == 3:
            front = pixels(bounds, placed(robot, _paths.front_sides(robot, bounds), goal))
            goals[-1] += f'<polyline class="front" {line} points="{front}"/>'
        # 3. Draw the body around the origin, to be rotated, and its number, which stays upright.
        radius = scale * _paths.drawn_rounding(robot, bounds)
        if robot.core.any():
            points = " ".join(f"{x:.2f},{-y:.2f}" for x, y in scale * _paths.body_outline(robot, bounds))
            body = f'<polygon class="body" points="{points}" fill="{color}"/>'
        else:
            body = f'<circle class="body" r="{radius:.2f}" fill="{color}"/>'
        if robot.dof == 3:
            (x, y0), (_, y1) = scale * _paths.heading_bar(robot, bounds)
            body += f'<path class="nose" stroke="{_paths.ink_on(color)}" d="M{x:.2f} {-y0:.2f}V{-y1:.2f}"/>'
        number = f'<text y="4" fill="{_paths.ink_on(color)}">{i}</text>'
        if 2 * robot.inscribed_radius * scale < _SMALLEST_NUMBERED:
            beside = scale * robot.circumscribed_radius or radius  # upper right of the body; a point robot is a disc
            place = f'x="{beside + 6:.2f}" y="{-beside:.2f}"'
            number = f'<text class="beside" {place} style="--color:{color}" fill="{color}">{i}</text>'
        bodies.append(f'<g id="place{i}"><g id="turn{i}">{body}</g>{number}</g>')
    shapes = "\n".join([obstacles, border, *tracks, *goals, *trails, *bodies])
    label = f"{len(problem.robots)} robots move from their starts to their goals"
    view_box = f"{-BORDER:g} {-BORDER:g} {width + 2 * BORDER:.1f} {height + 2 * BORDER:.1f}"
    return f'<svg viewBox="{view_box}" role="img" aria-label="{label}">\n{shapes}\n</svg>'


_MARGIN = 0.08  # inches around the picture of a GIF
_DPI = 120  # pixels per inch
_LARGEST_RATE = 50.0  # frames per second; common GIF viewers slow down faster ones
_PACK = np.array([65536, 256, 1], dtype=np.uint32)  # packs the three bytes of a color into one number
_TRACK, _GOAL, _TRAIL = 3.3, 3.6, 4.0  # z-orders


@dataclass(frozen=True, eq=False)
class Animation:
    """An animation of a path, made by :func:`animate`. Notebooks play it, and :meth:`save` writes it to a file."""

    problem: Problem
    motion: _paths.Timeline
    seconds: float
    frames_per_second: float

    @property
    def num_frames(self) -> int:
        """Number of frames of a GIF, from the start to the end of the path."""
        return max(1, round(self.seconds * self.frames_per_second)) + 1

    def save(self, path: StrPath) -> None:
        """Write a looping ``.gif``, or an ``.html`` page with a time slider; another ending raises ``ValueError``."""
        path = file_path(path)
        if (ending := path.suffix.lower()) not in (".gif", ".html"):
            raise ValueError(f"An animation must be written to a .gif or .html file, got {str(path)!r}.")
        content = _gif(self) if ending == ".gif" else player(self.problem, self.motion, self.seconds).encode()
        write_atomically(path, content)

    def __repr__(self) -> str:
        return f"Animation({len(self.problem.robots)} robots, {len(self.motion.times)} steps, {self.seconds:g} s)"

    def _repr_html_(self) -> str:
        bounds = self.problem.workspace.bounds
        width, height = pixel_scale(bounds) * bounds.width + 2 * (BORDER + _PADDING)
        return in_iframe(player(self.problem, self.motion, self.seconds), width, height + _CONTROLS)


def animate(
    problem: Problem, path: ArrayLike, *, seconds: float | int = 8.0, frames_per_second: float | int = 20.0
) -> Animation:
    """Return an animation of a path ``(steps, robots, dof)`` of a problem, timed as in :meth:`Solution.path_at`.

    Steps in which nothing moves are skipped; one playback takes ``seconds``. A GIF has ``frames_per_second``, above 0
    and at most 50, rounded so that a frame lasts whole hundredths of a second. Web pages play at the screen's rate.
    ``ValueError`` is raised if a number is out of range, the path is invalid, or nothing moves.
    """
    as_finite("seconds", seconds, positive=True)
    expected = f"above 0 and at most {_LARGEST_RATE:g}"
    as_number("frames_per_second", frames_per_second, expected, lambda rate: 0 < rate <= _LARGEST_RATE)
    motion = _paths.timeline(problem, path)
    if motion.duration == 0:
        raise ValueError(f"path must move a robot to be animated, got {len(np.asarray(path))} step(s) at rest.")
    return Animation(problem, motion, float(seconds), float(frames_per_second))


def _gif(animation: Animation) -> bytes:
    from PIL import Image

    frames = list(_frames(animation))
    # 1. Count the colors in about eight frames, and sort them by frequency.
    sample = np.stack(frames[:: max(1, len(frames) // 8)]).reshape(-1, 3)
    packed, counts = np.unique(sample.astype(np.uint32) @ _PACK, return_counts=True)
    colors = packed[np.argsort(-counts, kind="stable"), None] // _PACK % 256
    # 2. Make a palette of the 256 most frequent colors, only one of colors that agree in the upper 5 bits of red,
    #    green and blue. The palettes of Pillow average colors: white turns gray and flat areas flicker.
    most_frequent = np.unique(colors >> 3, axis=0, return_index=True)[1]
    palette = Image.new("P", (1, 1))
    palette.putpalette(colors[np.sort(most_frequent)[:256]].astype(np.uint8).tobytes())
    images = [Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    # 3. Write the frames; the last one stays longer.
    delay = 10 * round(100 / animation.frames_per_second)  # milliseconds, a multiple of the 10 that GIF supports
    durations = [delay] * (len(images) - 1) + [int(1000 * HOLD)]
    data = io.BytesIO()
    images[0].save(data, "GIF", save_all=True, append_images=images[1:], duration=durations, loop=0, optimize=False)
    return data.getvalue()


def _frames(animation: Animation) -> Iterator[UInt8[np.ndarray, "height width 3"]]:
    problem, motion = animation.problem, animation.motion
    # 1. Draw the static background once: the workspace, whole tracks as thin lines, goals as outlines.
    ax = _axes.new_axes(problem.workspace.bounds, (_MARGIN, _MARGIN), (_MARGIN, _MARGIN), _DPI)
    _plane.plot_workspace(problem.workspace, ax)
    ax.set(xticks=[], yticks=[], xlabel="", ylabel="")
    for i in range(len(problem.robots)):
        ax.plot(*motion.configurations[:, i, :2].T, color=_paths.color_of(i), linewidth=1.0, alpha=0.3, zorder=_TRACK)
        _paths.add_goal(ax, problem, i, zorder=_GOAL)
    figure = ax.figure.canvas.figure
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    background = canvas.copy_from_bbox(figure.bbox)
    # 2. For each frame, draw trails, bodies and numbers on a copy of the background, and remove them again.
    for time in np.linspace(0.0, motion.duration, animation.num_frames):
        so_far = motion.between(0.0, float(time))
        canvas.restore_region(background)
        artists = [artist for i in range(len(problem.robots)) for artist in _add_robot(ax, problem, i, so_far[:, i])]
        for artist in sorted(artists, key=Artist.get_zorder):
            ax.draw_artist(artist)
            artist.remove()
        yield np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _add_robot(ax: Axes, problem: Problem, i: int, so_far: Float[np.ndarray, "steps dof"]) -> list[Artist]:
    """Draw robot ``i`` at the end of its path so far, a trail along the path, and its number if there is room."""
    q = so_far[-1]
    trail = ax.plot(*so_far[:, :2].T, color=_paths.color_of(i), linewidth=2.0, solid_joinstyle="round", zorder=_TRAIL)
    artists = [*trail, *_paths.add_body(ax, problem, i, q)]
    if 2 * problem.robots[i].inscribed_radius >= 0.75 * _paths.number_size(ax, i):
        artists.append(_paths.add_number(ax, i, q[:2], _paths.ink_on(_paths.color_of(i))))
    return artists
