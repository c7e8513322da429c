"""Gradient descent on the way points of many paths at once, compiled once a family of shapes.

What is minimized over a path's inner rows: its length; a penalty on clearance below a margin, all along the motions;
another on a makespan above the longest allowed; and, if asked for, how unevenly the rows follow one another. Up to
that makespan time costs nothing: robots may wait.

Way points move by hat functions of all widths, from half the path to a single row: so whole stretches move as
quickly as details do. Lengths are shares of the workspace's extent, which suits 32-bit floats.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from plr_jax._arrays import runs
from plr_jax._problem import Problem, motion_costs
from plr_jax._types import DimensionedFn
from plr_jax.optimize.trajectory.clearance import Outlines, PaddedBoundary, convex_clearances, round_clearances
from plr_jax.robots.robot import between, shorter_turn

# Paths of as many rows as wanted, and the same motions at other times.


Path = Float[np.ndarray, "rows robots dof"]

_SHORTEST = 0.3  # share of the path's time in which a robot makes all its motions, at the shortest


def subdivided(problem: Problem, path: Float[np.ndarray, "steps robots dof"], rows: int) -> Path:
    """The same path of as many rows as wanted, at least 2 and its own: its costliest motions are divided evenly."""
    path = path if len(path) > 1 else np.repeat(path, 2, axis=0)
    cost = motion_costs(problem, path[:-1], path[1:]).sum(axis=1)
    count = np.ones(len(cost), dtype=np.intp)
    for _ in range(rows - len(path)):
        count[np.argmax(cost / count)] += 1
    motion, step = runs(count)
    share = (step / count[motion])[:, None, None]
    return np.concatenate([between(path[motion], path[motion + 1], share), path[-1:]])


def retimed(path: Path, rng: np.random.Generator) -> Path:
    """The same motions of each robot, begun and ended at random times, in as many rows; robots may collide."""
    whole, last = unwrapped(path), len(path) - 1
    result = np.empty_like(path)
    for i in range(path.shape[1]):
        duration = rng.uniform(_SHORTEST, 1.0)
        begin = rng.uniform(0.0, 1.0 - duration)
        when = np.clip((np.linspace(0.0, 1.0, last + 1) - begin) / duration, 0.0, 1.0) * last
        row = np.minimum(when.astype(np.intp), last - 1)
        share = (when - row)[:, None]
        result[:, i] = (1 - share) * whole[row, i] + share * whole[row + 1, i]
    result[0], result[-1] = path[0], path[-1]
    return result


def unwrapped(path: Path) -> Path:
    """The path with headings that do not jump by whole turns."""
    change = np.diff(path, axis=0, prepend=path[:1])
    change[1:, :, 2:] = shorter_turn(path[:-1, :, 2:], path[1:, :, 2:])
    return path[:1] + np.cumsum(change, axis=0)


# How the iterations are compiled: hundreds of small operations and their derivatives.


_OPTIONS = {"xla_cpu_use_fusion_emitters": False}


def jit_iterations(iterate: Callable) -> Callable:
    """``jax.jit`` without XLA's slow code generator for fused operations, where this version has a choice."""

    @functools.cache
    def compiled() -> Callable:
        return jax.jit(iterate, compiler_options=_known(_OPTIONS))

    @functools.wraps(iterate)
    def call(*args: Any) -> Any:
        return compiled()(*args)

    return call


def _known(options: dict[str, bool]) -> dict[str, bool]:
    """The options, if this version of XLA knows them."""
    try:
        jax.jit(lambda: 0, compiler_options=options)()
    except jax.errors.JaxRuntimeError:
        return {}
    return options


_STEEPNESS = 10.0  # of the penalty; the pull of a path on a row is at most 2, and in a hurry 6
_RATES = (3e-3, 3e-6)  # learning rate at first and at last
_WIDENING = 10.0  # by how much the margin is wider at first, so that bodies slide past one another
_PACE = 0.1  # weight of the unevenness of the pace
_GUIDE = 5.0  # weight, at first, of the cost-to-go's deviation from even progress
_FADE = 1e-3  # its share that is left at last
_HURRY = 2.0  # weight of the makespan beyond the longest allowed
_EARLY = 3e-4  # share of it by which paths aim to end before, so that they do not end after
_PIECES = 2  # of a motion in which something turns, each taken for a chord
_SMOOTHING = 1e-6  # length below which a motion costs less than its length, so that it has a gradient at rest

TracedPath = Float[Array, "rows robots dof"]


class ScaledProblem(NamedTuple):
    """What paths are optimized in, in units of the workspace's extent, which is the ``scale`` in workspace units.

    The ``origin`` of the coordinates is in workspace units; a robot's ``lever`` is how far from its reference point
    what turns the farthest is.
    """

    walls: PaddedBoundary
    outlines: Outlines
    rotation_weight: Float[Array, "robots"]
    lever: Float[Array, "robots"]
    origin: Float[Array, "2"]
    scale: Float[Array, ""]


class Aims(NamedTuple):
    """What is asked of paths: a margin of clearance, in units of the extent, and a weight of squared bends.

    ``distance_fns``, the distance of each robot to its goal, are pytrees that are callable; or there are none.
    """

    margin: Any
    smoothness: Any
    distance_fns: tuple[Any, ...]


class DescentState(NamedTuple):
    """How far each path has come: by how much each hat function moves it, in shares of the extent; Adam's moments."""

    weights: Float[Array, "batch hats robots dof"]
    moments: Any


def begin(paths: Float[Array, "batch rows robots dof"]) -> DescentState:
    """Descents that have not moved their paths yet; these have ``2**k + 1`` rows."""
    weights = jnp.zeros((len(paths), _hats(paths.shape[1]).shape[1], *paths.shape[2:]))
    return DescentState(weights, jax.vmap(_adam().init)(weights))


@jit_iterations
def advance(
    problem: ScaledProblem,
    paths: Float[Array, "batch rows robots dof"],
    longest: Float[Array, "batch"],
    aims: Aims,
    descent: DescentState,
    progress: Float[Array, "iterations"],
) -> tuple[DescentState, Float[Array, "batch iterations"]]:
    """Some more iterations of every descent: Adam on the weights, its steps and the margin smaller and smaller.

    The paths are those of the beginning, headings unwrapped; their first and last rows stay. ``longest`` is the
    longest makespan that each may have, in units of the extent, or ``inf``. Progress is 0 in the first iteration of
    all and 1 in the last; beyond 1, nothing is done. Returns the loss in every step as well.
    """
    return jax.vmap(lambda path, longest, descent: _advanced(problem, path, longest, aims, descent, progress))(
        paths, longest, descent
    )


@jax.jit
def moves_of(
    problem: ScaledProblem, paths: Float[Array, "batch rows robots dof"], descent: DescentState
) -> Float[Array, "..."]:
    """By how much each way point has moved, of the shape of the paths."""
    return jax.vmap(lambda path, weights: _moves(problem, path, weights))(paths, descent.weights)


def _advanced(
    problem: ScaledProblem,
    path: TracedPath,
    longest: Float[Array, ""],
    aims: Aims,
    descent: DescentState,
    progress: Float[Array, "iterations"],
) -> tuple[DescentState, Float[Array, "iterations"]]:
    adam, (first, last) = _adam(), _RATES

    def step(descent: DescentState, progress: Float[Array, ""]) -> tuple[DescentState, Float[Array, ""]]:
        weights, moments = descent
        loss, gradient = jax.value_and_grad(
            lambda weights: _loss(problem, path + _moves(problem, path, weights), longest, aims, progress)
        )(weights)
        update, moments = adam.update(gradient, moments)
        rate = first * (last / first) ** progress
        after = DescentState(weights - rate * update, moments)
        return jax.tree.map(lambda new, old: jnp.where(progress <= 1, new, old), after, descent), loss

    return jax.lax.scan(step, descent, progress)


def _moves(problem: ScaledProblem, path: TracedPath, weights: Float[Array, "hats robots dof"]) -> TracedPath:
    unit = jnp.ones(path.shape[1:]).at[:, 2:].set(1 / problem.lever[:, None])
    return jnp.tensordot(jnp.asarray(_hats(len(path))), weights, 1) * unit


def _adam() -> Any:
    import optax

    return optax.scale_by_adam()


def _loss(
    problem: ScaledProblem, path: TracedPath, longest: Float[Array, ""], aims: Aims, progress: Float[Array, ""]
) -> Float[Array, ""]:
    margin = aims.margin * (1 + _WIDENING * 1e-3**progress)
    penalty = sum(_hinge(margin - clearance, margin / 2).sum() for clearance in _clearances(problem, path))
    bends = path[2:] - 2 * path[1:-1] + path[:-2]
    costs = _costs(problem, path)
    loss = _length(costs) + _HURRY * _overtime(costs, longest)
    loss = loss + aims.smoothness * len(path) * (bends * bends).sum()
    if not aims.distance_fns:
        return loss + _STEEPNESS * penalty
    # Walls fade in as the guide fades out: what begins on their wrong side could not cross them later.
    guide = _FADE**progress
    return loss + _STEEPNESS * (1 - guide) * penalty + _GUIDE * guide * _lag(problem, path, aims.distance_fns)


def _costs(problem: ScaledProblem, path: TracedPath) -> Float[Array, "motions robots"]:
    """Cost of each robot's motions."""
    change = jnp.diff(path, axis=0)
    cost = jnp.sqrt((change[..., :2] ** 2).sum(axis=-1) + _SMOOTHING**2)
    if path.shape[-1] > 2:
        cost = cost + problem.rotation_weight * jnp.sqrt(change[..., 2] ** 2 + _SMOOTHING**2)
    return cost


def _length(costs: Float[Array, "motions robots"]) -> Float[Array, ""]:
    """Cost of a path, and a little for an uneven pace: that keeps motions short, and can be had for nothing."""
    pace = costs.sum(axis=1)
    total = pace.sum()
    return total + _PACE * (len(pace) * (pace * pace).sum() / total - total)


def _overtime(costs: Float[Array, "motions robots"], longest: Float[Array, ""]) -> Float[Array, ""]:
    """By how much the makespan is beyond a little less than the longest allowed, which may be ``inf``."""
    early = _SMOOTHING + _EARLY * jnp.where(jnp.isfinite(longest), longest, 0.0)
    return _hinge(costs.max(axis=1).sum() - (longest - early), early)


def _clearances(problem: ScaledProblem, path: TracedPath) -> tuple[Float[Array, "..."], ...]:
    if problem.outlines.all_round:
        return round_clearances(problem.walls, problem.outlines, path[:-1, :, :2], path[1:, :, :2])
    share = jnp.arange(_PIECES + 1)[:, None, None, None] / _PIECES
    times = path[:-1] + share * jnp.diff(path, axis=0)
    return convex_clearances(problem.walls, problem.outlines, times[:-1], times[1:])


def _lag(problem: ScaledProblem, path: TracedPath, distance_fns: tuple[Any, ...]) -> Float[Array, ""]:
    """How far each robot's cost-to-go is from falling evenly from start to goal, summed over the rows."""
    share, lag = jnp.linspace(1.0, 0.0, len(path)), jnp.zeros(())
    for i, fn in enumerate(distance_fns):
        q = _pulled_where_it_can_be(path[:, i].at[:, :2].set(path[:, i, :2] * problem.scale + problem.origin))
        cost = fn(q[:, : fn.dim] if isinstance(fn, DimensionedFn) else q) / problem.scale
        known = jnp.isfinite(cost) & jnp.isfinite(cost[0])
        off = jnp.where(known, cost - share * cost[0], 0.0)
        lag = lag + jnp.sqrt(off * off + _SMOOTHING).sum()
    return lag


@jax.custom_vjp
def _pulled_where_it_can_be(q: Float[Array, "rows dof"]) -> Float[Array, "rows dof"]:
    """The configurations, but nothing pulls those where a distance has no gradient, as a norm at the goal itself."""
    return q


_pulled_where_it_can_be.defvjp(lambda q: (q, None), lambda _, pull: (jnp.where(jnp.isfinite(pull), pull, 0.0),))


def _hinge(x: Float[Array, "*shape"], width: Float[Array, ""]) -> Float[Array, "*shape"]:
    """0 below 0, a parabola up to ``width``, a line of slope 1 from there."""
    x = jnp.maximum(x, 0.0)
    return jnp.where(x < width, x * x / (2 * width), x - width / 2)


def _hats(rows: int) -> Float[np.ndarray, "rows hats"]:
    """Hat functions of all widths, one a column; 0 at both ends."""
    at, columns, width = np.arange(rows), [], (rows - 1) // 2
    while width >= 1:
        columns += [np.maximum(0.0, 1 - np.abs(at - center) / width) for center in range(width, rows - 1, width)]
        width //= 2
    return np.stack(columns, axis=1).astype(np.float32)
