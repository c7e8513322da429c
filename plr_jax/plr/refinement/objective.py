"""Mean loss plus penalties as a function of scaled variables, and its minimization by Adam, all leaves at once."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from tqdm import tqdm

from plr_jax._pytree import as_pytree
from plr_jax.plr.refinement.losses import Loss, Penalty, Planes

STEPS_AT_ONCE = 50  # between two chances to interrupt
_FIRST_STEP = 0.3  # of a variable's unit
_TINY = 1e-30


class Objective(NamedTuple):
    """What a step reads. Points come leaf by leaf; all that varies in number is padded with zeros to powers of two.

    Error and coefficients are those of the least-squares fit, corrected by a map of the variables: an entry adds to a
    coefficient (``row``, numbered leaf by leaf) a variable (``column``) times ``entry``. Weights sum to 1, in a leaf
    to its ``share``. With ``center`` and ``half`` coefficients give the mean plane, with ``per_half`` its slope.
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


def minimize(
    objective: Objective, loss: Loss, penalties: tuple[Penalty, ...], num_steps: int
) -> tuple[Float[np.ndarray, "variables"], tuple[float, float], int]:
    """The best variables found, the objective at the start and there, and the number of steps taken.

    Ctrl-C ends it early: fewer steps than asked for.
    """
    import optax

    loss, penalties = as_pytree(loss), tuple(map(as_pytree, penalties))
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
    losses = jax.eval_shape(loss, errors)
    if _shape_of(losses) != errors.shape:
        raise ValueError(f"A loss must return one number an error, shape {errors.shape} here, got {losses}.")
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
