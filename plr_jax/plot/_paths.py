"""Pictures of what a planner is asked and what it answers: problems, paths, samples."""

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.patches import Polygon

from plr_jax._arrays import as_numbers
from plr_jax._problem import Problem
from plr_jax._types import ArrayLike
from plr_jax.plot._plane import plot_workspace
from plr_jax.plot._robots import add_body, add_numbers, add_outline, color_of, outline
from plr_jax.plot._timeline import timeline

# z-orders: above obstacles, so that a wrong path is seen to be wrong, and below solid bodies.
_SAMPLES, _FADED, _LINE = 3.2, 3.4, 4.0


def plot_problem(problem: Problem, ax: Axes | None = None) -> Axes:
    """Draw a problem: solid bodies at the starts, dashed outlines at the goals, numbered by robot.

    Args:
        problem: What to draw. A bar near the front of a robot that has a heading shows where it heads; a point is a
            dot.
        ax: Axes to draw on; a new figure where not given.

    Returns:
        The axes.
    """
    ax = plot_workspace(problem.workspace, ax)
    for i in range(len(problem.robots)):
        add_body(ax, problem, i, problem.starts[i])
        add_outline(ax, problem, i, problem.goals[i])
    add_numbers(ax, problem, problem.starts, problem.goals)
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
    """Draw a path, or a part of it, as in Fig. 3 of the paper.

    Each robot leaves a line in its color and faded bodies, evenly spaced in time, and stands, solid and
    numbered, where it is at the end of the part.

    Args:
        problem: What the path solves.
        path: Joint configurations ``(steps, robots, dof)``.
        ax: Axes to draw on; a new figure where not given.
        begin: Where the part begins, as a share of the makespan: 0 is the start.
        end: Where it ends: 1 is the goal. ``end=0.5`` here and ``begin=0.5`` in a second picture show the path
            in two halves.
        num_poses: Number of faded bodies of a robot, the first at the beginning; 0 for none. A body that waits
            is drawn once.

    Returns:
        The axes.

    Raises:
        ValueError: If the path has a wrong shape or is not finite, not ``0 <= begin < end <= 1``, or the number
            of poses is negative.

    References:
        Putman et al., Section V, Fig. 3.
    """
    if not 0 <= begin < end <= 1:
        raise ValueError(f"begin and end must be shares with 0 <= begin < end <= 1, got {begin!r} and {end!r}.")
    if num_poses < 0:
        raise ValueError(f"num_poses must be at least 0, got {num_poses!r}.")
    motion = timeline(problem, path)
    first, last = begin * motion.duration, end * motion.duration
    shown = motion.between(first, last)
    poses = motion.at(np.linspace(first, last, num_poses, endpoint=False))
    ax = plot_workspace(problem.workspace, ax)
    for i in range(len(problem.robots)):
        _add_faded(ax, problem, i, poses[:, i])
        ax.plot(*shown[:, i, :2].T, color=color_of(i), linewidth=1.6, solid_joinstyle="round", zorder=_LINE)
        add_body(ax, problem, i, shown[-1, i])
    add_numbers(ax, problem, shown[-1], shown[:0, 0])
    return ax


def plot_samples(problem: Problem, samples: ArrayLike, ax: Axes | None = None) -> Axes:
    """Draw where a planner placed its samples, as in Fig. 4 of the paper: one color a robot.

    Args:
        problem: What was planned; its starts and goals are drawn on top.
        samples: Joint configurations ``(n, robots, dof)``, such as a solution's; a point is drawn at each
            robot's position.
        ax: Axes to draw on; a new figure where not given.

    Returns:
        The axes.

    Raises:
        ValueError: If the samples have another shape or are not numbers.

    References:
        Putman et al., Section V, Fig. 4.
    """
    shape = f"(n, robots, dof) = (n, {len(problem.robots)}, {problem.dof})"
    samples = as_numbers("Samples", samples, f"numbers of shape {shape}")
    if samples.ndim != 3 or samples.shape[1:] != problem.starts.shape:
        raise ValueError(f"Samples must have shape {shape}, got {samples.shape}.")
    ax = plot_problem(problem, ax)
    colors = np.array([color_of(i) for i in range(len(problem.robots))])
    # In one collection, so that no robot's points cover those of all robots before it.
    ax.scatter(
        *samples[..., :2].reshape(-1, 2).T,
        c=np.tile(colors, len(samples)),
        s=2.2,
        linewidths=0,
        zorder=_SAMPLES,
        rasterized=True,
    )
    return ax


def _add_faded(ax: Axes, problem: Problem, i: int, poses: Float[np.ndarray, "n dof"]) -> None:
    for k, q in enumerate(poses):
        if k == 0 or (q != poses[k - 1]).any():
            corners = outline(problem.robots[i], q, problem.workspace.bounds)
            ax.add_patch(Polygon(corners, facecolor=(color_of(i), 0.13), edgecolor=(color_of(i), 0.55),
                                 linewidth=0.6, zorder=_FADED))  # fmt: skip
