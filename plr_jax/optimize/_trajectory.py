"""Shorten and smooth paths by the gradient of their cost, and return only what an independent check finds valid."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from plr_jax._problem import Problem, path_cost
from plr_jax._robot import RectangleRobot
from plr_jax._types import ArrayLike
from plr_jax._validate import validate
from plr_jax.optimize._clearance import bodies_of, walls_of
from plr_jax.optimize._retime import retimed, subdivided, unwrapped
from plr_jax.optimize._waypoints import Aims, Scene, move_waypoints

_MARGIN = 1e-4  # of the extent
_MARGINS = (1.0, 4.0)  # tried in turn, where the first leaves a path that is not valid
_FEWEST_MOTIONS = 64
_HALVINGS = 6

Path = Float[np.ndarray, "rows robots dof"]
Paths = Float[np.ndarray, "guesses rows robots dof"]


@dataclass(frozen=True, eq=False)
class OptimizedPaths:
    """Paths after optimization.

    Args:
        path: The cheapest valid path, in workspace units and radians; None if no path is valid.
        cost: Its cost, ``inf`` if there is none.
        paths: What became of each given path, all of as many rows.
        costs: Their costs, whether they are valid or not.
        valid: Which of them :func:`plr_jax.validate` finds valid.
        history: Loss of each of them in every iteration, in units of the workspace's extent; the margin narrows and
            the guide fades as it goes, so that it need not fall.
    """

    path: Path | None
    cost: float
    paths: Paths
    costs: Float[np.ndarray, "guesses"]
    valid: Bool[np.ndarray, "guesses"]
    history: Float[np.ndarray, "guesses iterations"]


def optimize_paths(
    problem: Problem,
    paths: ArrayLike,
    *,
    distance_fns: Sequence[Any] | None = None,
    num_retimings: int = 15,
    num_iterations: int = 1000,
    margin: float | int | None = None,
    smoothness: float | int = 0.0,
    seed: int = 0,
) -> OptimizedPaths:
    """Shorten paths by gradient descent on all their way points at once.

    A valid path stays valid and never becomes costlier: what descent makes of it is put through
    :func:`plr_jax.validate`; failing that, the largest step found towards it that is; failing that, the path is
    returned as it was. Paths that are not valid, such as straight lines through obstacles, are initial guesses: they
    often become valid, and ``valid`` says which did.

    Waiting costs nothing, so a team's path is cheapest if the robots meet where there is room. Descent finds such
    times only near those of the path. Retimings start it from the same motions at other times, at random, and the
    cheapest valid outcome is kept.

    Args:
        problem: The problem.
        paths: A path ``(steps, robots, dof)`` such as that of ``bl_plan``, or a batch of initial guesses ``(guesses,
            steps, robots, dof)``, from the starts to the goals, in workspace units and radians.
        distance_fns: One distance to its goal a robot, that JAX can differentiate: PLRs, or functions ``(n, dim) ->
            (n,)``. In the first iterations they draw way points to where the cost-to-go falls evenly along the path,
            which helps guesses that pass through obstacles. None: no guide.
        num_retimings: How many retimings of each path, at least 0; a single robot has none.
        num_iterations: Steps of descent, at least 1.
        margin: Clearance below which there is a penalty, in workspace units, positive; None: 1e-4 of the extent.
            It is met where there is room, and costs about its multiple by the turns of a path.
        smoothness: Weight, at least 0, of the squared second differences of the way points. A path that costs more
            than a valid one that was given is not returned, however smooth.
        seed: Seed of the retimings.

    Returns:
        The optimized paths, of ``2**k + 1`` rows, at least 65 and at least as many as given; begin and end exact.
        The same whether optimized in a batch or one by one, up to rounding in 32 bits.

    Raises:
        ValueError: If the paths have another shape, are not finite, or do not begin at the starts and end at the
            goals; there are not as many distance functions as robots, or JAX cannot trace one; or another argument
            is out of its range.

    References:
        Zucker et al., CHOMP: Covariant Hamiltonian optimization for motion planning, IJRR 32, 2013, for descent on
        whole paths in a smooth basis; the paper asks for optimal trajectories in its conclusion.
    """
    given = _as_paths(problem, paths)
    _check_options(num_retimings, num_iterations, margin, smoothness)
    scene, fns = _scene(problem), _differentiable(problem, distance_fns)
    width = float(scene.scale) * _MARGIN if margin is None else float(margin)
    given = np.stack([subdivided(problem, path, _rows(given)) for path in given])
    guesses = _retimings(given, num_retimings if len(problem.robots) > 1 else 0, seed)
    best = [_Outcome(path, _cost_if_valid(problem, path), np.zeros(num_iterations)) for path in given]
    for factor in _MARGINS:
        aims = Aims(jnp.float32(factor * width / scene.scale), jnp.float32(smoothness), fns)
        moved, losses = _moved(scene, guesses, aims, num_iterations)
        outcomes = [_better(problem, *each) for each in zip(best, moved, losses, strict=True)]
        best, spoiled = [outcome for outcome, _ in outcomes], any(spoiled for _, spoiled in outcomes)
        if not spoiled:
            break
    return _result(problem, best)


class _Outcome(NamedTuple):
    """A path, its cost, ``inf`` if it is not valid, and the losses of the descent that led to it."""

    path: Path
    cost: float
    losses: Float[np.ndarray, "iterations"]


def _better(
    problem: Problem, before: _Outcome, moved: Paths, losses: Float[np.ndarray, "guesses iterations"]
) -> tuple[_Outcome, bool]:
    """What is to be kept of several descents from one path, and whether none of the cheaper ones was valid.

    The cheapest valid one; the largest step towards the first of them; or the path as it was.
    """
    costs = np.array([path_cost(problem, path) for path in moved])
    order = np.argsort(costs, kind="stable")
    order = order[costs[order] < before.cost]
    for k in order:
        if validate(problem, moved[k]).valid:
            return _Outcome(moved[k], float(costs[k]), losses[k]), False
    if not np.isfinite(before.cost):
        return _Outcome(moved[0], np.inf, losses[0]), False
    change = moved[0] - before.path
    for share in 0.5 ** np.arange(1, 1 + _HALVINGS):
        path = before.path + share * change
        cost = path_cost(problem, path)
        if cost < before.cost and validate(problem, path).valid:
            return _Outcome(path, cost, losses[0]), True
    return before._replace(losses=losses[0]), len(order) > 0


def _result(problem: Problem, outcomes: Sequence[_Outcome]) -> OptimizedPaths:
    paths, history = (np.stack([getattr(outcome, name) for outcome in outcomes]) for name in ("path", "losses"))
    cost = np.array([outcome.cost for outcome in outcomes])
    best = int(np.argmin(cost))
    return OptimizedPaths(
        path=paths[best] if np.isfinite(cost[best]) else None,
        cost=float(cost[best]),
        paths=paths,
        costs=np.array([path_cost(problem, path) for path in paths]),
        valid=np.isfinite(cost),
        history=history,
    )


def _moved(
    scene: Scene, guesses: Float[np.ndarray, "guesses starts rows robots dof"], aims: Aims, num_iterations: int
) -> tuple[Float[np.ndarray, "guesses starts rows robots dof"], Float[np.ndarray, "guesses starts iterations"]]:
    """Where descent takes paths, and its losses; the batch is padded to a power of two."""
    flat = guesses.reshape(-1, *guesses.shape[2:])
    padded = np.concatenate([flat, np.repeat(flat[:1], (1 << (len(flat) - 1).bit_length()) - len(flat), axis=0)])
    start = np.stack([unwrapped(path) for path in padded])
    start[..., :2] = (start[..., :2] - np.asarray(scene.origin, np.float64)) / float(scene.scale)
    moves, losses = move_waypoints(scene, jnp.asarray(start, jnp.float32), aims, num_iterations)
    moves = np.array(moves[: len(flat)], np.float64)
    moves[..., :2] *= float(scene.scale)
    shape = guesses.shape[:2]
    return guesses + moves.reshape(guesses.shape), np.array(losses[: len(flat)], np.float64).reshape(*shape, -1)


def _retimings(given: Paths, num_retimings: int, seed: int) -> Float[np.ndarray, "guesses starts rows robots dof"]:
    """Each path and its retimings, at the same times for every path."""
    keys = [(seed, k) for k in range(num_retimings)]
    return np.stack([[path, *(retimed(path, np.random.default_rng(key)) for key in keys)] for path in given])


def _rows(paths: Float[np.ndarray, "guesses steps robots dof"]) -> int:
    """One more than a power of two, so that hat functions of all widths fit."""
    return 1 + max(_FEWEST_MOTIONS, 1 << max(0, paths.shape[1] - 2).bit_length())


def _scene(problem: Problem) -> Scene:
    bounds = problem.workspace.bounds
    origin, scale = (bounds.lo + bounds.hi) / 2, float(bounds.width.max())
    lever = [robot.circumscribed_radius or scale for robot in problem.robots]
    return Scene(
        walls_of(problem.workspace, origin, scale),
        bodies_of(problem.robots, scale),
        jnp.asarray(problem.rotation_weights / scale, jnp.float32),
        jnp.asarray(np.array(lever) / scale, jnp.float32),
        jnp.asarray(origin, jnp.float32),
        jnp.float32(scale),
    )


def _cost_if_valid(problem: Problem, path: Path) -> float:
    report = validate(problem, path)
    return report.cost if report.valid else np.inf


def _differentiable(problem: Problem, distance_fns: Sequence[Any] | None) -> tuple[Any, ...]:
    """The distance functions as pytrees, after a trial."""
    fns = () if distance_fns is None else tuple(distance_fns)
    if fns and len(fns) != len(problem.robots):
        raise ValueError(f"distance_fns must be one a robot, {len(problem.robots)}, got {len(fns)}.")
    for i, fn in enumerate(fns):
        points = jax.ShapeDtypeStruct((2, getattr(fn, "dim", problem.dof)), jnp.float32)
        try:
            shape = jax.eval_shape(fn, points).shape
        except (TypeError, AttributeError, ValueError, jax.errors.JAXTypeError) as error:
            raise ValueError(f"distance_fns[{i}] must be a function that JAX can trace, such as a PLR.") from error
        if shape != (2,):
            raise ValueError(
                f"distance_fns[{i}] must take points (n, dim) to distances (n,), got {shape} for 2 points."
            )
    return tuple(jax.tree_util.Partial(fn) if jax.tree.leaves(fn) == [fn] else fn for fn in fns)


def _as_paths(problem: Problem, paths: ArrayLike) -> Float[np.ndarray, "guesses steps robots dof"]:
    """The given paths as a batch, checked."""
    shape = f"(steps, robots, dof) or (guesses, steps, robots, dof) with (robots, dof) = {problem.starts.shape}"
    try:
        batch = np.array(paths, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"Paths must be numbers of shape {shape}.") from None
    batch = batch[None] if batch.ndim == 3 else batch
    if batch.ndim != 4 or batch.shape[2:] != problem.starts.shape or 0 in batch.shape:
        raise ValueError(f"Paths must have shape {shape}, at least one guess of one step, got {np.shape(paths)}.")
    if not np.isfinite(batch).all():
        raise ValueError(f"Paths must be finite; path {np.argwhere(~np.isfinite(batch))[0, 0]} is not.")
    for row, wanted, name in ((0, problem.starts, "starts"), (-1, problem.goals, "goals")):
        for i, robot in enumerate(problem.robots):
            dof = 3 if isinstance(robot, RectangleRobot) else 2
            off = np.flatnonzero((batch[:, row, i, :dof] != wanted[i, :dof]).any(axis=1))
            if off.size:
                raise ValueError(
                    f"Path {off[0]} must have the problem's {name} as its {'first' if row == 0 else 'last'} row, got "
                    f"{batch[off[0], row, i, :dof].tolist()} for robot {i}, not {wanted[i, :dof].tolist()}."
                )
    return batch


def _check_options(
    num_retimings: int, num_iterations: int, margin: float | int | None, smoothness: float | int
) -> None:
    for name, value, least in (("num_retimings", num_retimings, 0), ("num_iterations", num_iterations, 1)):
        if value < least:
            raise ValueError(f"{name} must be at least {least}, got {value!r}.")
    if margin is not None and not (np.isfinite(margin) and margin > 0):
        raise ValueError(f"margin must be positive and finite, got {margin!r}.")
    if not (np.isfinite(smoothness) and smoothness >= 0):
        raise ValueError(f"smoothness must be finite and at least 0, got {smoothness!r}.")
