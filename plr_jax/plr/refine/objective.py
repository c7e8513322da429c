"""All planes at once by Adam: the optimization that :func:`refine` poses, in coordinates that make it easy.

Which leaf holds a point does not change, so it is looked up once; a step gathers the planes of all points and adds up
their gradients. Three things make a few hundred steps enough, whatever the loss:

- The start is the least-squares plane of each cell, and what is optimized is the correction to it, so that 32-bit
  floats resolve small errors of large distances.
- The variables ``z`` of a leaf are coordinates in which a unit step changes the values at its points by a unit in the
  root mean square: ``correction = transform @ z``, from the Cholesky factor of the leaf's normal matrix.
- That unit is about the error of the leaf's least-squares plane: leaves of small errors take small steps.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from tqdm import tqdm

from plr_jax._types import Distances, Points
from plr_jax.plr._plr import PLR, leaf_of
from plr_jax.plr.refine.losses import Loss, Penalty, Planes
from plr_jax.plr.sampling.cell_samples import solve_planes

POINTS_A_COEFFICIENT = 4  # that a leaf must have to be fitted to its points
STEPS_AT_ONCE = 50  # between two chances to interrupt
_FIRST_STEP = 0.3  # of a leaf's unit
# The least unit of a leaf, should its least-squares plane fit very well: a share of the error over all points, and of
# how much its own plane varies. Penalties may ask more of it than its points do.
_OF_ALL_ERROR, _OF_VARIATION = 0.1, 0.01
_TINY = 1e-30


class Samples(NamedTuple):
    """Points of finite distance, with their weights."""

    x: Points
    distance: Distances
    weight: Float[np.ndarray, "n"]

    def take(self, index: Int[np.ndarray, "m"]) -> "Samples":
        """Some of the points."""
        return Samples(self.x[index], self.distance[index], self.weight[index])


class Problem(NamedTuple):
    """What a step reads. Points come leaf by leaf; they, and the leaves, are padded with zeros to powers of two.

    Attributes:
        leaf: The leaf of each point.
        feature: Change of a point's value with each variable of its leaf.
        error: Error of the least-squares plane at each point.
        weight: Weight of each point; they sum to 1.
        share: Sum of the weights in each leaf.
        plane: Least-squares plane of each leaf, its center and half-differences.
        transform: Change of a leaf's plane with each of its variables; 0 for a plane that is to stay.
        per_half: Slope along each axis of a leaf whose half-difference along it is 1.
    """

    leaf: Int[Any, "n"]
    feature: Float[Any, "n terms"]
    error: Float[Any, "n"]
    weight: Float[Any, "n"]
    share: Float[Any, "leaves"]
    plane: Float[Any, "leaves terms"]
    transform: Float[Any, "leaves terms terms"]
    per_half: Float[Any, "leaves dim"]

    def corrected(self, z: Float[Any, "leaves terms"]) -> Float[np.ndarray, "leaves terms"]:
        """The planes at given variables, in double precision."""
        return self.plane + np.einsum("lij,lj->li", self.transform, np.asarray(z, np.float64))


def pose(plr: PLR, samples: Samples) -> tuple[Problem, Bool[np.ndarray, "leaves"]]:
    """The problem of refining a PLR with some points, and which leaves have enough of them.

    The points of other leaves get no weight, and nothing moves the planes of those from the given ones.
    """
    leaf = leaf_of(plr, samples.x)
    order = np.argsort(leaf, kind="stable")
    leaf, (x, distance, weight) = leaf[order], samples.take(order)
    (lo, hi), (center, half) = plr.leaf_boxes, plr.planes.decode()
    plane = np.concatenate([np.where(plr.planes.unreachable, 0.0, center)[:, None], half], axis=1)
    num_points = np.bincount(leaf[weight > 0], minlength=len(plane))
    enough = (num_points >= POINTS_A_COEFFICIENT * plane.shape[1]) & ~plr.planes.unreachable
    weight = weight * enough[leaf]
    if not weight.any():
        raise ValueError(
            f"No leaf of {plr} has {POINTS_A_COEFFICIENT * plane.shape[1]} points of positive weight and finite "
            "distance to be fitted to; give more points."
        )
    weight /= weight.max()  # so that the sum does not overflow
    weight /= weight.sum()
    design = np.concatenate([np.ones((len(x), 1)), (2 * x - lo[leaf] - hi[leaf]) / (hi - lo)[leaf]], axis=1)
    sum_up = _sums(leaf, len(plane))
    share, normal = sum_up(weight), _normal_matrices(sum_up, design, weight)
    error = np.sum(plane[leaf] * design, axis=1) - distance
    plane -= solve_planes(normal.copy(), np.stack([sum_up(weight * error * term) for term in design.T], axis=1))
    error = np.sum(plane[leaf] * design, axis=1) - distance
    unit = _units(share, sum_up(weight * error**2), plane)
    transform = (enough * unit)[:, None, None] * _whitening(share, normal, np.where(enough, num_points, 1))
    feature = np.einsum("nij,ni->nj", transform[leaf], design)
    points = map(_padded, (leaf, feature, error, weight))
    leaves = map(_padded, (share, plane, transform, 2 / (hi - lo)))
    return Problem(*points, *leaves), enough


def minimize(
    problem: Problem, loss: Loss, penalties: tuple[Penalty, ...], num_steps: int
) -> tuple[Float[np.ndarray, "leaves terms"], tuple[float, float], int]:
    """The best variables found, the objective at the start and there, and the number of steps taken.

    Ctrl-C ends it early: fewer steps than asked for.
    """
    import optax

    loss, penalties = _as_pytree(loss), tuple(map(_as_pytree, penalties))
    problem = jax.tree.map(
        lambda array: jnp.asarray(array, jnp.int32 if array.dtype.kind == "i" else jnp.float32), problem
    )
    z = jnp.zeros(problem.plane.shape, jnp.float32)
    try:
        start = _checked_start(problem, loss, penalties, z)
    except jax.errors.TracerArrayConversionError:
        raise ValueError("The loss or a penalty computes in NumPy; write it in jax.numpy.") from None
    total = -(-num_steps // STEPS_AT_ONCE) * STEPS_AT_ONCE
    rates = np.asarray(optax.cosine_decay_schedule(_FIRST_STEP, total)(np.arange(total)), np.float32)
    state, done = (z, _adam().init(z), z, jnp.float32(start)), 0
    with tqdm(total=total, desc="refine", unit=" steps", delay=2, leave=False, disable=None) as progress:
        try:
            for done in range(STEPS_AT_ONCE, total + 1, STEPS_AT_ONCE):
                state = _descend(problem, loss, penalties, start, rates[done - STEPS_AT_ONCE : done], state)
                jax.block_until_ready(state)
                progress.update(STEPS_AT_ONCE)
        except KeyboardInterrupt:
            done -= STEPS_AT_ONCE
    _, _, best, least = state
    return np.asarray(best, np.float64), (start, float(least)), done


def _objective(
    problem: Problem, loss: Loss, penalties: tuple[Penalty, ...], z: Float[Array, "leaves terms"]
) -> Float[Array, ""]:
    """Mean loss over the points, plus the penalties."""
    error = problem.error + jnp.sum(problem.feature * z[problem.leaf], axis=1)
    objective = jnp.sum(problem.weight * loss(error))
    if penalties:
        planes = _planes_at(problem, z)
        objective += sum(penalty(planes) for penalty in penalties)
    return objective


def _planes_at(problem: Problem, z: Float[Array, "leaves terms"]) -> Planes:
    plane = problem.plane + jnp.einsum("lij,lj->li", problem.transform, z)
    return Planes(plane[:, 0], plane[:, 1:], problem.per_half * plane[:, 1:], problem.share)


def _checked_start(
    problem: Problem, loss: Loss, penalties: tuple[Penalty, ...], z: Float[Array, "leaves terms"]
) -> float:
    """The objective at the start, after what the loss and the penalties return has been checked."""
    errors = jax.ShapeDtypeStruct(problem.error.shape, jnp.float32)
    if _shape_of(jax.eval_shape(loss, errors)) != errors.shape:
        raise ValueError(
            f"A loss must return one number an error, shape {errors.shape} here, got {jax.eval_shape(loss, errors)}."
        )
    planes = jax.eval_shape(_planes_at, problem, z)
    for penalty in penalties:
        if _shape_of(jax.eval_shape(penalty, planes)) != ():
            raise ValueError(f"A penalty must return one number, got {jax.eval_shape(penalty, planes)}.")
    start = float(jax.jit(_objective)(problem, loss, penalties, z))
    if not np.isfinite(start):
        raise ValueError(f"The mean loss plus the penalties must be finite, got {start} at the least-squares planes.")
    return start


def _shape_of(result: Any) -> tuple[int, ...] | None:
    """Shape of real numbers; None if it is anything else."""
    is_real = jnp.issubdtype(getattr(result, "dtype", object), jnp.floating)
    return result.shape if is_real else None


@jax.jit
def _descend(
    problem: Problem, loss: Loss, penalties: tuple[Penalty, ...], start: Any, rates: Float[Array, "steps"], state: Any
) -> Any:
    """One step of Adam for each rate, keeping the best variables seen."""

    def step(state: Any, rate: Array) -> tuple[Any, None]:
        z, adam, best, least = state
        objective, gradient = jax.value_and_grad(scaled)(z)
        objective *= jnp.maximum(start, _TINY)
        best = jnp.where(objective < least, z, best)
        update, adam = _adam().update(gradient, adam)
        return (z - rate * jnp.asarray(update), adam, best, jnp.fmin(objective, least)), None

    def scaled(z: Float[Array, "leaves terms"]) -> Float[Array, ""]:
        return _objective(problem, loss, penalties, z) / jnp.maximum(start, _TINY)

    return jax.lax.scan(step, state, rates)[0]


def _adam():
    import optax  # a tenth of a second of import that a query does not need

    # Divided by its start, an objective has gradients of about a leaf's share of the points; far above this eps.
    return optax.scale_by_adam(b1=0.9, b2=0.99, eps=1e-12)


def _sums(leaf: Int[np.ndarray, "n"], leaves: int) -> Callable[[Float[np.ndarray, "n"]], Float[np.ndarray, "leaves"]]:
    """Sums a number a point over the points of each leaf."""
    return lambda values: np.bincount(leaf, values, minlength=leaves)


def _normal_matrices(
    sum_up: Callable, design: Float[np.ndarray, "n terms"], weight: Float[np.ndarray, "n"]
) -> Float[np.ndarray, "leaves terms terms"]:
    rows = [[sum_up(weight * a * b) for b in design.T] for a in design.T]
    return np.moveaxis(np.array(rows), -1, 0)


def _whitening(
    share: Float[np.ndarray, "leaves"],
    normal: Float[np.ndarray, "leaves terms terms"],
    num_points: Int[np.ndarray, "leaves"],
) -> Float[np.ndarray, "leaves terms terms"]:
    """For each leaf the coordinates in which its points' values change by a unit in the root mean square.

    As many points as a plane has coefficients, spread evenly over the cell, are counted in: along directions in
    which the points hardly vary, a plane is not flung about.
    """
    terms = normal.shape[-1]
    even = np.diag([1.0, *[1 / 3] * (terms - 1)])
    counted_in = np.where(share > 0, share * terms / num_points, 1.0)
    moments = (normal + counted_in[:, None, None] * even) / (share + counted_in)[:, None, None]
    return np.linalg.inv(np.linalg.cholesky(moments)).swapaxes(1, 2)


def _units(
    share: Float[np.ndarray, "leaves"], squares: Float[np.ndarray, "leaves"], plane: Float[np.ndarray, "leaves terms"]
) -> Float[np.ndarray, "leaves"]:
    """Unit of each leaf's variables: how far off its least-squares plane is, but not next to nothing."""
    of_leaf = np.sqrt(squares / np.where(share > 0, share, 1.0))
    least = np.maximum(_OF_ALL_ERROR * np.sqrt(squares.sum()), _OF_VARIATION * np.linalg.norm(plane[:, 1:], axis=1))
    return np.maximum(of_leaf, least)


def _as_pytree(function: Callable) -> Any:
    """A function that may be an argument of a jitted one: itself if it is a pytree, else compiled for its own."""
    return jax.tree_util.Partial(function) if jax.tree_util.all_leaves([function]) else function


def _padded(rows: np.ndarray) -> np.ndarray:
    padded = np.zeros((1 << (len(rows) - 1).bit_length(), *rows.shape[1:]), rows.dtype)
    padded[: len(rows)] = rows
    return padded
