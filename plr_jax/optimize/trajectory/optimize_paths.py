"""Shorten and smooth paths by the gradient of their cost, and return only what an independent check finds valid."""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from tqdm import tqdm

from plr_jax._arrays import as_finite, as_number, as_numbers, padded, padded_size, require_integer
from plr_jax._compiled import as_pytree
from plr_jax._problem import Problem, makespan, path_cost
from plr_jax._types import ArrayLike, DimensionedFn
from plr_jax._validate import validate
from plr_jax.optimize.trajectory.clearance import outlines_of, padded_boundary
from plr_jax.optimize.trajectory.scaled_problem import (
    Aims,
    Path,
    ScaledProblem,
    advance,
    begin,
    moves_of,
    retimed,
    subdivided,
    unwrapped,
)

# What :func:`optimize_paths` is given, checked.


def differentiable(problem: Problem, distance_fns: Sequence[Any] | None) -> tuple[Any, ...]:
    """The distance functions as pytrees, after a trial."""
    fns = () if distance_fns is None else tuple(distance_fns)
    if fns and len(fns) != len(problem.robots):
        raise ValueError(f"distance_fns must be one a robot, {len(problem.robots)}, got {len(fns)}.")
    for i, fn in enumerate(fns):
        dim = fn.dim if isinstance(fn, DimensionedFn) else problem.dof
        if not 1 <= dim <= problem.dof:
            raise ValueError(f"distance_fns[{i}] takes {dim} coordinates, configurations have {problem.dof}.")
        points = jax.ShapeDtypeStruct((2, dim), jnp.float32)
        try:
            shape = jax.eval_shape(fn, points).shape
        except (TypeError, AttributeError, ValueError, jax.errors.JAXTypeError) as error:
            raise ValueError(f"distance_fns[{i}] must be a function that JAX can trace, such as a PLR.") from error
        if shape != (2,):
            raise ValueError(
                f"distance_fns[{i}] must take points (n, dim) to distances (n,), got {shape} for 2 points."
            )
    return tuple(map(_as_argument, fns))


@dataclass(frozen=True)
class _OfLeadingCoordinates:
    """A function of the leading coordinates; equal for equal functions, so that JAX compiles once."""

    fn: Callable[[Array], Array]
    dim: int

    def __call__(self, q: Array) -> Array:
        return self.fn(q[:, : self.dim])


def _as_argument(fn: Any) -> Any:
    pytree = as_pytree(fn)
    if pytree is fn or not isinstance(fn, DimensionedFn):
        return pytree
    return as_pytree(_OfLeadingCoordinates(fn, fn.dim))  # a Partial does not pass on the attribute ``dim``


def as_paths(problem: Problem, paths: ArrayLike) -> Float[np.ndarray, "guesses steps robots dof"]:
    """The given paths as a batch, checked."""
    shape = f"(steps, robots, dof) or (guesses, steps, robots, dof) with (robots, dof) = {problem.starts.shape}"
    batch = as_numbers("Paths", paths, f"numbers of shape {shape}")
    batch = batch[None] if batch.ndim == 3 else batch
    if batch.ndim != 4 or batch.shape[2:] != problem.starts.shape or 0 in batch.shape:
        raise ValueError(f"Paths must have shape {shape}, at least one guess of one step, got {np.shape(paths)}.")
    if not np.isfinite(batch).all():
        raise ValueError(f"Paths must be finite; path {np.argwhere(~np.isfinite(batch))[0, 0]} is not.")
    for row, wanted, name in ((0, problem.starts, "starts"), (-1, problem.goals, "goals")):
        for i, robot in enumerate(problem.robots):
            dof = robot.dof
            off = np.flatnonzero((batch[:, row, i, :dof] != wanted[i, :dof]).any(axis=1))
            if off.size:
                raise ValueError(
                    f"Path {off[0]} must have the problem's {name} as its {'first' if row == 0 else 'last'} row, got "
                    f"{batch[off[0], row, i, :dof].tolist()} for robot {i}, not {wanted[i, :dof].tolist()}."
                )
    return batch


def check_options(
    num_retimings: int,
    num_iterations: int,
    margin: float | int | None,
    smoothness: float | int,
    makespan_factor: float | int,
    seed: int,
) -> None:
    """Raise ``ValueError`` for an option out of its range."""
    for name, value, least in (
        ("num_retimings", num_retimings, 0),
        ("num_iterations", num_iterations, 1),
        ("seed", seed, 0),
    ):
        require_integer(name, value, least)
    if margin is not None:
        as_finite("margin", margin, positive=True)
    as_finite("smoothness", smoothness)
    as_number("makespan_factor", makespan_factor, "a number of at least 1, or inf", lambda factor: factor >= 1)


_MARGIN = 1e-4  # of the extent
_MARGINS = (1.0, 4.0)  # tried in turn, where the first leaves a path that is not valid
_FEWEST_MOTIONS = 64
_HALVINGS = 6
_ITERATIONS_AT_ONCE = 50  # between them, Ctrl-C is heard
_GENTLE = 0.5  # progress at which the last descent begins, with small steps and hardly a wider margin

Paths = Float[np.ndarray, "guesses rows robots dof"]
Retimings = Float[np.ndarray, "guesses retimings rows robots dof"]


class OptimizationInterrupted(UserWarning):
    """Ctrl-C ended an optimization early; what it returns is the best found so far."""


@dataclass(frozen=True, eq=False)
class OptimizedPaths:
    """Paths after optimization.

    Attributes:
        path: The cheapest valid path, in workspace units and radians; None if no path is valid.
        cost: Its cost, ``inf`` if there is none.
        makespan: Its makespan (see :func:`plr_jax.makespan`), ``inf`` if there is none.
        paths: What became of each given path, all of as many rows.
        costs: Their costs, whether they are valid or not.
        makespans: Their makespans, likewise.
        valid: Which of them :func:`plr_jax.validate` finds valid.
        history: Loss of each of them in every iteration, in units of the workspace's extent; the margin narrows and
            the guide fades as it goes, so that it need not fall. That of the gentler descent at the end is not in it.
            NaN in iterations that an interrupt left out.
    """

    path: Path | None
    cost: float
    makespan: float
    paths: Paths
    costs: Float[np.ndarray, "guesses"]
    makespans: Float[np.ndarray, "guesses"]
    valid: Bool[np.ndarray, "guesses"]
    history: Float[np.ndarray, "guesses iterations"]

    def __repr__(self) -> str:
        return (
            f"OptimizedPaths({int(self.valid.sum()):,} of {len(self.valid):,} valid, cost {self.cost:.4g}, "
            f"makespan {self.makespan:.4g})"
        )


def optimize_paths(
    problem: Problem,
    paths: ArrayLike,
    *,
    distance_fns: Sequence[Any] | None = None,
    num_retimings: int = 15,
    num_iterations: int = 1000,
    margin: float | int | None = None,
    smoothness: float | int = 0.0,
    makespan_factor: float | int = 1.0,
    seed: int = 0,
) -> OptimizedPaths:
    """Shorten paths by gradient descent on all their way points at once.

    A valid path stays valid, never becomes costlier, and takes no more time than before unless you allow it: what
    descent makes of it is put through :func:`plr_jax.validate`; failing that, the largest step found towards it that
    is; failing that, the path as it was; and at last, what a gentler descent from there makes of it.

    Paths that are not valid, such as straight lines through obstacles, are initial guesses, and ``valid`` says which
    became valid. That is for a robot that passes by a few obstacles. A guess stays in its homotopy class, and a
    motion that goes all the way through a wall is in none that is free: of random way points in
    :func:`plr_jax.scenes.maze` none become a valid path, and a minority do under a guide. Among many walls start from
    valid paths: that of ``bl_plan``, or for a point that of :func:`plr_jax.descend`, which also joins way points of
    your own, leg by leg.

    Waiting costs nothing, so a team's path is cheapest if the robots meet where there is room. Descent finds such
    times only near those of the path. Retimings start it from the same motions at other times, at random, and the
    cheapest valid outcome is kept. Left to itself, that spreads a team's motions in time: a path of four robots may
    take nearly twice as long. So a makespan above that of the given path is penalized, and never returned.

    Args:
        problem: The problem.
        paths: A path ``(steps, robots, dof)`` such as that of ``bl_plan``, or a batch of initial guesses ``(guesses,
            steps, robots, dof)``, from the starts to the goals, in workspace units and radians.
        distance_fns: One distance to its goal a robot, that JAX can differentiate: PLRs, or functions ``(n, dim) ->
            (n,)``. In the first iterations they draw way points to where the cost-to-go falls evenly along the path,
            which helps guesses that pass through obstacles. None: no guide.
        num_retimings: How many retimings of each path, at least 0; a single robot has none.
        num_iterations: Steps of each descent, at least 1.
        margin: Clearance below which there is a penalty, in workspace units, positive; None: 1e-4 of the extent.
            It is met where there is room, and costs about its multiple by the turns of a path.
        smoothness: Weight, at least 0, of the squared second differences of the way points. A path that costs more
            than a valid one that was given is not returned, however smooth.
        makespan_factor: By how much the makespan of a valid path may grow (see :func:`plr_jax.makespan`), as a factor
            of at least 1. ``inf``: time costs nothing at all, which is best for the cost. What becomes of paths that
            are not valid may take any time.
        seed: Seed of the retimings, at least 0.

    Returns:
        The optimized paths, of ``2**k + 1`` rows, at least 65 and at least as many as given; begin and end exact.
        The same whether optimized in a batch or one by one, up to rounding in 32 bits. If interrupted (Ctrl-C), the
        best found so far, with an ``OptimizationInterrupted`` warning: valid paths are valid, no costlier and no
        longer under way then, too.

    Raises:
        ValueError: If the paths have another shape, are not finite, or do not begin at the starts and end at the
            goals; there are not as many distance functions as robots, or JAX cannot trace one; or another argument
            is out of its range.

    References:
        Zucker et al., CHOMP: Covariant Hamiltonian optimization for motion planning, IJRR 32, 2013, for descent on
        whole paths in a smooth basis; the paper asks for optimal trajectories in its conclusion.
    """
    given = as_paths(problem, paths)
    check_options(num_retimings, num_iterations, margin, smoothness, makespan_factor, seed)
    scaled, fns = _scaled_problem(problem), differentiable(problem, distance_fns)
    width = float(scaled.scale) * _MARGIN if margin is None else float(margin)
    given = np.stack([subdivided(problem, path, _rows(given)) for path in given])
    guesses = _retimings(given, num_retimings if len(problem.robots) > 1 else 0, seed)
    best = [_given(problem, path, float(makespan_factor), num_iterations) for path in given]
    progress = np.linspace(0.0, 1.0, num_iterations, dtype=np.float32)
    try:
        for factor in _MARGINS:
            aims = Aims(jnp.float32(factor * width / scaled.scale), jnp.float32(smoothness), fns)
            if not _improve(problem, scaled, guesses, aims, best, progress):
                break
        _polish(problem, scaled, aims._replace(distance_fns=()), best, _GENTLE + (1 - _GENTLE) * progress)
    except KeyboardInterrupt:
        message = "Interrupted: the paths are the best found so far."
        warnings.warn(message, OptimizationInterrupted, stacklevel=2)
    return _result(problem, best)


class _Incumbent(NamedTuple):
    """A path, its cost, ``inf`` if it is not valid, and the losses of the descent that led to it.

    What replaces it must have a makespan of at most ``longest``.
    """

    path: Path
    cost: float
    losses: Float[np.ndarray, "iterations"]
    longest: float


def _better(
    problem: Problem,
    before: _Incumbent,
    moved: Float[np.ndarray, "retimings rows robots dof"],
    losses: Float[np.ndarray, "retimings iterations"],
) -> tuple[_Incumbent, bool]:
    """What is to be kept of several descents from one path, and whether none of the cheaper ones was valid.

    Of those that do not take too long, the cheapest valid one; the largest step towards the first descent's; or the
    path as it was.
    """
    costs = np.array([path_cost(problem, path) for path in moved])
    in_time = np.array([makespan(problem, path) for path in moved]) <= before.longest
    order = np.argsort(costs, kind="stable")
    order = order[(costs[order] < before.cost) & in_time[order]]
    for k in order:
        if validate(problem, moved[k]).valid:
            return before._replace(path=moved[k], cost=float(costs[k]), losses=losses[k]), False
    if not np.isfinite(before.cost):
        return before._replace(path=moved[0], losses=losses[0]), False
    change = moved[0] - before.path
    for share in 0.5 ** np.arange(1, 1 + _HALVINGS):
        path = before.path + share * change
        cost = path_cost(problem, path)
        if cost < before.cost and makespan(problem, path) <= before.longest and validate(problem, path).valid:
            return before._replace(path=path, cost=cost, losses=losses[0]), True
    return before._replace(losses=losses[0]), len(order) > 0


def _result(problem: Problem, outcomes: Sequence[_Incumbent]) -> OptimizedPaths:
    paths, history = (np.stack([getattr(outcome, name) for outcome in outcomes]) for name in ("path", "losses"))
    cost = np.array([outcome.cost for outcome in outcomes])
    makespans = np.array([makespan(problem, path) for path in paths])
    best = int(np.argmin(cost))
    found = bool(np.isfinite(cost[best]))
    return OptimizedPaths(
        path=paths[best] if found else None,
        cost=float(cost[best]),
        makespan=float(makespans[best]) if found else np.inf,
        paths=paths,
        costs=np.array([path_cost(problem, path) for path in paths]),
        makespans=makespans,
        valid=np.isfinite(cost),
        history=history,
    )


def _improve(
    problem: Problem,
    scaled: ScaledProblem,
    guesses: Retimings,
    aims: Aims,
    best: list[_Incumbent],
    progress: Float[np.ndarray, "iterations"],
) -> bool:
    """Put what descent makes of the guesses into ``best`` where it is better; whether collisions spoiled any.

    An interrupted descent counts as far as it came, before the interrupt goes on.
    """
    moved, losses, interrupt = _descended(scaled, guesses, np.array([each.longest for each in best]), aims, progress)
    spoiled = []
    for k in range(len(best)):
        best[k], bad = _better(problem, best[k], moved[k], losses[k])
        spoiled.append(bad)
    if interrupt is not None:
        raise interrupt
    return any(spoiled)


def _polish(
    problem: Problem,
    scaled: ScaledProblem,
    aims: Aims,
    best: list[_Incumbent],
    progress: Float[np.ndarray, "iterations"],
) -> None:
    """Descend once more from every valid path, gently: bold steps leave narrow places for others that cost more."""
    valid = [k for k, outcome in enumerate(best) if np.isfinite(outcome.cost)]
    if not valid:
        return
    polished = [best[k] for k in valid]
    try:
        _improve(problem, scaled, np.stack([each.path for each in polished])[:, None], aims, polished, progress)
    finally:
        for k, outcome in zip(valid, polished, strict=True):
            best[k] = outcome._replace(losses=best[k].losses)


def _descended(
    scaled: ScaledProblem,
    guesses: Retimings,
    longest: Float[np.ndarray, "guesses"],
    aims: Aims,
    progress: Float[np.ndarray, "iterations"],
) -> tuple[Retimings, Float[np.ndarray, "guesses retimings iterations"], KeyboardInterrupt | None]:
    """Where descent takes paths, its losses, and what interrupted it."""
    flat = guesses.reshape(-1, *guesses.shape[2:])
    start = _scaled(scaled, flat)
    longest = padded(np.repeat(longest, guesses.shape[1]), len(start), np.inf) / float(scaled.scale)
    allowed = jnp.asarray(longest, jnp.float32)
    losses, done = np.full((len(start), len(progress)), np.nan), 0
    descent, interrupt = begin(start), None
    with tqdm(total=len(progress), desc="optimize", unit=" steps", delay=2, leave=False, disable=None) as bar:
        try:
            for part in _parts(progress):
                descent, loss = advance(scaled, start, allowed, aims, descent, jnp.asarray(part))
                count = int((part <= 1).sum())
                losses[:, done : done + count] = loss[:, :count]
                done += count
                bar.update(count)
        except KeyboardInterrupt as error:
            interrupt = error
    moves = np.array(moves_of(scaled, start, descent)[: len(flat)], np.float64)
    moves[..., :2] *= float(scaled.scale)
    moves[~np.isfinite(moves).all(axis=(1, 2, 3))] = 0.0  # of guesses so far out that 32-bit floats overflow
    return guesses + moves.reshape(guesses.shape), losses[: len(flat)].reshape(*guesses.shape[:2], -1), interrupt


def _scaled(scaled: ScaledProblem, paths: Paths) -> Float[Array, "padded rows robots dof"]:
    """Paths as they are optimized, padded to a power of two of them."""
    start = np.stack([unwrapped(path) for path in padded(paths, padded_size(len(paths)), paths[0])])
    start[..., :2] = (start[..., :2] - np.asarray(scaled.origin, np.float64)) / float(scaled.scale)
    return jnp.asarray(start, jnp.float32)


def _parts(progress: Float[np.ndarray, "iterations"]) -> Float[np.ndarray, "parts part"]:
    """Progress of the iterations in parts of one length, padded by more than 1."""
    count = -(-len(progress) // _ITERATIONS_AT_ONCE)
    return padded(progress, count * -(-len(progress) // count), 2.0).reshape(count, -1)


def _retimings(given: Paths, num_retimings: int, seed: int) -> Retimings:
    """Each path and its retimings, at the same times for every path."""
    keys = [(seed, k) for k in range(num_retimings)]
    return np.stack([[path, *(retimed(path, np.random.default_rng(key)) for key in keys)] for path in given])


def _rows(paths: Float[np.ndarray, "guesses steps robots dof"]) -> int:
    """One more than a power of two, so that hat functions of all widths fit."""
    return 1 + max(_FEWEST_MOTIONS, 1 << max(0, paths.shape[1] - 2).bit_length())


def _scaled_problem(problem: Problem) -> ScaledProblem:
    bounds = problem.workspace.bounds
    # Rounded first: far from the origin, 32-bit floats would move the paths and leave the walls.
    origin = ((bounds.lo + bounds.hi) / 2).astype(np.float32).astype(np.float64)
    scale = float(bounds.width.max())
    lever = [robot.circumscribed_radius or scale for robot in problem.robots]
    return ScaledProblem(
        padded_boundary(problem.workspace, origin, scale),
        outlines_of(problem.robots, scale),
        jnp.asarray(problem.rotation_weights / scale, jnp.float32),
        jnp.asarray(np.array(lever) / scale, jnp.float32),
        jnp.asarray(origin, jnp.float32),
        jnp.float32(scale),
    )


def _given(problem: Problem, path: Path, makespan_factor: float, num_iterations: int) -> _Incumbent:
    report, losses = validate(problem, path), np.full(num_iterations, np.nan)
    if not report.valid:
        return _Incumbent(path, np.inf, losses, np.inf)
    return _Incumbent(path, report.cost, losses, makespan_factor * makespan(problem, path))
