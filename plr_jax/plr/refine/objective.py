"""All leaves at once by Adam: the optimization that :func:`refine` poses, in coordinates that make it easy.

Which leaf holds a point does not change, so it is looked up once; a step gathers the coefficients of all points and
adds up their gradients. Three things make a few hundred steps enough, whatever the loss:

- The start is the least-squares fit, and what is optimized is the correction to it, so that 32-bit floats resolve
  small errors of large distances.
- The variables ``z`` are coordinates in which a unit step changes the values at the points it moves by a unit in the
  root mean square. Where each leaf has parameters of its own, they come from the Cholesky factor of the leaf's normal
  matrix; where leaves share them, each parameter is scaled for itself.
- That unit is about the error of the least-squares fit there: leaves of small errors take small steps.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from tqdm import tqdm

from plr_jax._types import Distances, Points
from plr_jax.plr._plr import PLR, leaf_of
from plr_jax.plr.leaves.base import Parameters, values_at_centers
from plr_jax.plr.refine.coordinates import count_in, leaf_normal_matrices, scaled_one_by_one, sums, units, whitened
from plr_jax.plr.refine.losses import Loss, Penalty, Planes

POINTS_A_COEFFICIENT = 4  # that a leaf must have to be fitted to its points
STEPS_AT_ONCE = 50  # between two chances to interrupt
_FIRST_STEP = 0.3  # of a unit
_RIDGE = 1e-9  # of a normal matrix: what the points do not determine stays as it is
_TINY = 1e-30


class WeightedPoints(NamedTuple):
    """Points of finite distance, with their weights."""

    x: Points
    distance: Distances
    weight: Float[np.ndarray, "n"]

    def take(self, index: Int[np.ndarray, "m"]) -> "WeightedPoints":
        """Some of the points."""
        return WeightedPoints(self.x[index], self.distance[index], self.weight[index])


class Objective(NamedTuple):
    """What a step reads. Points come leaf by leaf; all that varies in number is padded with zeros to powers of two.

    Attributes:
        leaf: The leaf of each point.
        basis: What the coefficients of its leaf multiply there.
        error: Error of the least-squares fit at each point.
        weight: Weight of each point; they sum to 1.
        share: Sum of the weights in each leaf.
        coefficients: Those of the least-squares fit.
        row: Of every entry of the map from variables to corrections the coefficient, numbered leaf by leaf.
        column: Its variable.
        entry: What the variable is multiplied with.
        center: What a leaf's coefficients are multiplied with to give the value at its center.
        half: And its half-differences.
        per_half: Slope along each axis of a leaf whose half-difference along it is 1.
        start: The variables at the start, 0.
    """

    leaf: Int[Any, "n"]
    basis: Float[Any, "n terms"]
    error: Float[Any, "n"]
    weight: Float[Any, "n"]
    share: Float[Any, "leaves"]
    coefficients: Float[Any, "leaves terms"]
    row: Int[Any, "entries"]
    column: Int[Any, "entries"]
    entry: Float[Any, "entries"]
    center: Float[Any, "terms"]
    half: Float[Any, "dim terms"]
    per_half: Float[Any, "leaves dim"]
    start: Float[Any, "variables"]


@dataclass(frozen=True, eq=False)
class Refinable:
    """A PLR's parameters, and the objective in which they are variables.

    Attributes:
        objective: What is minimized.
        values: The parameters of least squared error.
        to_parameters: From variables to corrections of them, in double precision.
        has_enough: Which leaves have enough points to be fitted to.
    """

    objective: Objective
    values: Float[np.ndarray, "parameters"]
    to_parameters: Callable[[Float[np.ndarray, "variables"]], Float[np.ndarray, "parameters"]]
    has_enough: Bool[np.ndarray, "leaves"]

    def corrected(self, z: Float[np.ndarray, "padded"]) -> Float[np.ndarray, "parameters"]:
        """The parameters at given variables."""
        return self.values + self.to_parameters(np.asarray(z, np.float64)[: len(self.values)])


def pose(plr: PLR, points: WeightedPoints) -> Refinable:
    """The problem of refining a PLR with some points.

    Points of leaves that have too few of them get no weight, and nothing moves what those leaves alone depend on.
    Where leaves share parameters, some points on which the given functions are right are counted in.
    """
    leaf = leaf_of(plr, points.x)
    order = np.argsort(leaf, kind="stable")
    leaf, (x, distance, weight) = leaf[order], points.take(order)
    lo, hi = plr.leaf_boxes
    basis = plr.leaf.basis((2 * x - lo[leaf] - hi[leaf]) / (hi - lo)[leaf])
    parameters = plr.leaf.parameters(plr.cells, plr.stored)
    shape = (plr.num_leaves, basis.shape[1])
    num_points, enough = np.bincount(leaf[weight > 0], minlength=len(lo)), POINTS_A_COEFFICIENT * (plr.dim + 1)
    has_enough = (num_points >= enough) & ~plr.unreachable
    weight = _normalized(weight * has_enough[leaf], plr, enough)
    sum_up = sums(leaf, len(lo))
    normal, share = leaf_normal_matrices(sum_up, basis, weight), sum_up(weight)
    counted_in, mean_squares = count_in(plr.leaf, plr.dim, normal, share, num_points)
    error = np.sum(_coefficients(parameters, shape)[leaf] * basis, axis=1) - distance
    moments = np.stack([sum_up(weight * error * term) for term in basis.T], axis=1)
    parameters = parameters.moved(
        -_least_squares(parameters, normal if parameters.is_leafwise else counted_in, moments)
    )
    coefficients = _coefficients(parameters, shape)
    error = np.sum(coefficients[leaf] * basis, axis=1) - distance
    center, half = values_at_centers(plr.leaf, np.eye(shape[1]), plr.dim)
    unit = has_enough * units(share, sum_up(weight * error**2), coefficients @ half)
    scaled, to_parameters = (whitened if parameters.is_leafwise else scaled_one_by_one)(
        parameters, mean_squares, unit
    )
    objective = Objective(
        *map(_padded, (leaf, basis, error, weight, share, coefficients, scaled.row, scaled.column, scaled.weight)),
        center,
        half.T,
        _padded(2 / (hi - lo)),
        _padded(np.zeros(len(parameters.values))),
    )
    return Refinable(objective, parameters.values, to_parameters, has_enough)


def _normalized(weight: Float[np.ndarray, "n"], plr: PLR, num_points: int) -> Float[np.ndarray, "n"]:
    """Weights that sum to 1."""
    if not weight.any():
        raise ValueError(
            f"No leaf of {plr} has {num_points} points of positive weight and finite distance to be fitted to; give "
            "more points."
        )
    weight = weight / weight.max()  # so that the sum does not overflow
    return weight / weight.sum()


def _coefficients(parameters: Parameters, shape: tuple[int, int]) -> Float[np.ndarray, "leaves terms"]:
    moved = parameters.weight * parameters.values[parameters.column]
    return np.bincount(parameters.row, moved, minlength=shape[0] * shape[1]).reshape(shape)


def _least_squares(
    parameters: Parameters,
    normal: Float[np.ndarray, "leaves terms terms"],
    moments: Float[np.ndarray, "leaves terms"],
) -> Float[np.ndarray, "parameters"]:
    """The change of parameters that explains the moments of the errors."""
    from scipy.sparse import bsr_array, csc_array, diags_array
    from scipy.sparse.linalg import splu

    leaves, shape = len(moments), (moments.size, len(parameters.values))
    of_leaves = csc_array((parameters.weight, (parameters.row, parameters.column)), shape)
    blocks = bsr_array((normal, np.arange(leaves), np.arange(leaves + 1)), (moments.size, moments.size))
    matrix = of_leaves.T @ (blocks @ of_leaves)
    diagonal = matrix.diagonal()
    matrix = csc_array(matrix + diags_array(_RIDGE * (diagonal + diagonal.max())))
    factors = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    return factors.solve(of_leaves.T @ moments.ravel())


def minimize(
    objective: Objective, loss: Loss, penalties: tuple[Penalty, ...], num_steps: int
) -> tuple[Float[np.ndarray, "variables"], tuple[float, float], int]:
    """The best variables found, the objective at the start and there, and the number of steps taken.

    Ctrl-C ends it early: fewer steps than asked for.
    """
    import optax

    loss, penalties = _as_pytree(loss), tuple(map(_as_pytree, penalties))
    objective = jax.tree.map(
        lambda array: jnp.asarray(array, jnp.int32 if array.dtype.kind == "i" else jnp.float32), objective
    )
    z = objective.start
    try:
        start = _checked_start(objective, loss, penalties, z)
    except jax.errors.TracerArrayConversionError:
        raise ValueError("The loss or a penalty computes in NumPy; write it in jax.numpy.") from None
    total = -(-num_steps // STEPS_AT_ONCE) * STEPS_AT_ONCE
    rates = np.asarray(optax.cosine_decay_schedule(_FIRST_STEP, total)(np.arange(total)), np.float32)
    state, done = (z, _adam().init(z), z, jnp.float32(start)), 0
    with tqdm(total=total, desc="refine", unit=" steps", delay=2, leave=False, disable=None) as progress:
        try:
            for done in range(STEPS_AT_ONCE, total + 1, STEPS_AT_ONCE):
                state = _descend(objective, loss, penalties, start, rates[done - STEPS_AT_ONCE : done], state)
                jax.block_until_ready(state)
                progress.update(STEPS_AT_ONCE)
        except KeyboardInterrupt:
            done -= STEPS_AT_ONCE
    _, _, best, least = state
    return np.asarray(best, np.float64), (start, float(least)), done


def _value(
    objective: Objective, loss: Loss, penalties: tuple[Penalty, ...], z: Float[Array, "variables"]
) -> Float[Array, ""]:
    """Mean loss over the points, plus the penalties."""
    correction = _corrections(objective, z)
    error = objective.error + jnp.sum(objective.basis * correction[objective.leaf], axis=1)
    value = jnp.sum(objective.weight * loss(error))
    if penalties:
        planes = _planes_at(objective, z)
        value += sum(penalty(planes) for penalty in penalties)
    return value


def _corrections(objective: Objective, z: Float[Array, "variables"]) -> Float[Array, "leaves terms"]:
    """What given variables add to the coefficients."""
    flat = jnp.zeros(objective.coefficients.size, z.dtype)
    flat = flat.at[objective.row].add(objective.entry * z[objective.column])
    return flat.reshape(objective.coefficients.shape)


def _planes_at(objective: Objective, z: Float[Array, "variables"]) -> Planes:
    coefficients = objective.coefficients + _corrections(objective, z)
    half = coefficients @ objective.half.T
    return Planes(coefficients, coefficients @ objective.center, half, objective.per_half * half, objective.share)


def _checked_start(
    objective: Objective, loss: Loss, penalties: tuple[Penalty, ...], z: Float[Array, "variables"]
) -> float:
    """The objective at the start, after what the loss and the penalties return has been checked."""
    errors = jax.ShapeDtypeStruct(objective.error.shape, jnp.float32)
    if _shape_of(jax.eval_shape(loss, errors)) != errors.shape:
        raise ValueError(
            f"A loss must return one number an error, shape {errors.shape} here, got {jax.eval_shape(loss, errors)}."
        )
    planes = jax.eval_shape(_planes_at, objective, z)
    for penalty in penalties:
        if _shape_of(jax.eval_shape(penalty, planes)) != ():
            raise ValueError(f"A penalty must return one number, got {jax.eval_shape(penalty, planes)}.")
    start = float(jax.jit(_value)(objective, loss, penalties, z))
    if not np.isfinite(start):
        raise ValueError(f"The mean loss plus the penalties must be finite, got {start} at the least-squares planes.")
    return start


def _shape_of(result: Any) -> tuple[int, ...] | None:
    """Shape of real numbers; None if it is anything else."""
    is_real = jnp.issubdtype(getattr(result, "dtype", object), jnp.floating)
    return result.shape if is_real else None


@jax.jit
def _descend(
    objective: Objective,
    loss: Loss,
    penalties: tuple[Penalty, ...],
    start: Any,
    rates: Float[Array, "steps"],
    state: Any,
) -> Any:
    """One step of Adam for each rate, keeping the best variables seen."""

    def step(state: Any, rate: Array) -> tuple[Any, None]:
        z, adam, best, least = state
        value, gradient = jax.value_and_grad(scaled)(z)
        value *= jnp.maximum(start, _TINY)
        best = jnp.where(value < least, z, best)
        update, adam = _adam().update(gradient, adam)
        return (z - rate * jnp.asarray(update), adam, best, jnp.fmin(value, least)), None

    def scaled(z: Float[Array, "variables"]) -> Float[Array, ""]:
        return _value(objective, loss, penalties, z) / jnp.maximum(start, _TINY)

    return jax.lax.scan(step, state, rates)[0]


def _adam():
    import optax  # a tenth of a second of import that a query does not need

    # Divided by its start, an objective has gradients of about a leaf's share of the points; far above this eps.
    return optax.scale_by_adam(b1=0.9, b2=0.99, eps=1e-12)


def _as_pytree(function: Callable) -> Any:
    """A function that may be an argument of a jitted one: itself if it is a pytree, else compiled for its own."""
    return jax.tree_util.Partial(function) if jax.tree_util.all_leaves([function]) else function


def _padded(rows: np.ndarray) -> np.ndarray:
    padded = np.zeros((1 << (len(rows) - 1).bit_length(), *rows.shape[1:]), rows.dtype)
    padded[: len(rows)] = rows
    return padded
