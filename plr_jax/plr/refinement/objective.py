"""Mean loss plus penalties as a function of scaled variables, and its minimization by Adam, all leaves at once."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from tqdm import tqdm

from plr_jax._arrays import as_finite, as_number, require_integer
from plr_jax._pytree import as_pytree
from plr_jax._types import ArrayLike, DistanceFn
from plr_jax.plr._plr import PLR, local_coordinates, unfolded_points
from plr_jax.plr.leaves.base import as_linear
from plr_jax.plr.partition.cells import tree_of
from plr_jax.plr.partition.faces import face_points, shared_faces
from plr_jax.plr.sampling.cell_fit import call_oracle

# Points on the faces between leaves that one can step across: where a PLR may jump and the distance does not.


_SAME = 1e-6  # of a leaf's width


@dataclass(frozen=True, eq=False)
class Faces:
    """Points on faces between two reachable leaves, all of them reachable themselves.

    Attributes:
        x: The points.
        leaves: The two leaves that meet at each point, the one below the face first.
        u: The point in the local coordinates of each of the two; ``[-1, 1]`` spans a leaf.
        basis: What the coefficients of each of the two multiply there.
    """

    x: Float[np.ndarray, "m dim"]
    leaves: Int[np.ndarray, "m 2"]
    u: Float[np.ndarray, "m 2 dim"]
    basis: Float[np.ndarray, "m 2 terms"]

    def __len__(self) -> int:
        return len(self.x)

    def jumps(self, plr: PLR) -> Float[np.ndarray, "m"]:
        """Value above the face minus value below it, for any PLR of the partition that was sampled.

        Raises:
            ValueError: If the PLR has another partition, or leaves of another kind.
        """
        is_here = self.leaves.max(initial=0) < plr.num_leaves and self.x.shape[1] == plr.dim
        is_here = is_here and as_linear(plr.leaf).basis(np.zeros((1, plr.dim))).shape[1] == self.basis.shape[2]
        if not (is_here and (np.abs(local_coordinates(plr, self.leaves, self.x[:, None]) - self.u) < _SAME).all()):
            raise ValueError(f"These faces are not those of {plr}; sample_faces gives its own.")
        below, above = (plr.values_in_leaves(leaf, self.x) for leaf in self.leaves.T)
        return above - below


def sample_faces(plr: PLR, distance_fn: DistanceFn, *, num_samples: int = 8, seed: int = 0) -> Faces:
    """Sample the free faces of a PLR's partition.

    Each piece of a face that two leaves share is sampled alike, so where small leaves meet a large one each has its
    points. A face is free where the goal can be reached from it: inside a wall it has no points. The side of a wall
    is free, so a face along it has points, although nobody can step across. What a leaf around a whole periodic axis
    shares with itself is left out.

    Args:
        plr: The PLR whose partition is meant.
        distance_fn: Distance to the goal for a batch of points ``(n, dim)``; ``inf`` where it cannot be reached.
        num_samples: Points on each such piece, before those are left out that are not free; at least 1.
        seed: Seed of the points. The same seed gives the same points.

    Returns:
        The points and the two leaves that meet in each.

    Raises:
        ValueError: If ``num_samples`` is not positive, ``seed`` is negative, or ``distance_fn`` returns a wrong
            shape or NaN.
    """
    require_integer("num_samples", num_samples, 1)
    require_integer("seed", seed, 0)
    tree = tree_of(plr.cells)
    faces = shared_faces(tree, plr.folded_domain.periodic)
    pairs = tree.order[np.stack([faces.lower, faces.upper], axis=1)]
    kept = ~plr.unreachable[pairs].any(axis=1) & (faces.lower != faces.upper)
    w = np.random.default_rng(seed).uniform(size=(int(num_samples), plr.dim))
    points = plr.folded_domain.lo + plr.folded_domain.width * face_points(tree.leaves, faces[kept], w)
    x, leaves = unfolded_points(plr, points.reshape(-1, plr.dim)), np.repeat(pairs[kept], len(w), axis=0)
    free = np.isfinite(call_oracle(distance_fn, x)) if len(x) else np.zeros(0, bool)
    x, leaves = x[free], leaves[free]
    u = local_coordinates(plr, leaves, x[:, None])
    basis = as_linear(plr.leaf).basis(u.reshape(-1, plr.dim))
    return Faces(x, leaves, u, basis.reshape(len(x), 2, basis.shape[1]))


# What :func:`refine` makes small: a loss of the errors at points, and penalties on the planes themselves.


class Planes(NamedTuple):
    """All leaves of a PLR while they are refined; unreachable ones are zero.

    Where a leaf holds another function than a plane, center, half-differences and slope are those of its mean plane.

    Attributes:
        coefficients: What the leaf model keeps of each leaf: of a plane its center and half-differences.
        center: Value at each leaf's center.
        half: Half-difference along each axis of the leaf.
        slope: Slope, the gradient in the leaf.
        share: Share of the points' weight that lies in the leaf.
    """

    coefficients: Float[Array, "leaves terms"]
    center: Float[Array, "leaves"]
    half: Float[Array, "leaves dim"]
    slope: Float[Array, "leaves dim"]
    share: Float[Array, "leaves"]


Loss: TypeAlias = Callable[[Float[Array, "n"]], Float[Array, "n"]]
"""Loss of each error, PLR minus distance (positive: over-estimated), in JAX; differentiable almost everywhere.

A loss may say by an attribute ``share`` which share of points it wants over-estimated; see :func:`quantile`.
"""

Penalty: TypeAlias = Callable[[Planes], Float[Array, ""]]
"""A number, in JAX, that is added to the mean loss."""


def squared(error: Float[Array, "n"]) -> Float[Array, "n"]:
    """The squared error: alone, its best planes are each cell's least-squares plane (Section III-A of the paper)."""
    return error**2


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Quantile:
    """The loss that :func:`quantile` gives, of a share that is a number."""

    share: ArrayLike

    def __call__(self, error: Float[Array, "n"]) -> Float[Array, "n"]:
        """Loss of each error."""
        return jnp.maximum((1 - self.share) * error, -self.share * error)


def quantile(share: int | float) -> Quantile:
    """One-sided error: planes that over-estimate the distance at a given share of points.

    An over-estimate costs ``1 - share`` a unit, an under-estimate ``share``; a mean of that is smallest where the
    given share of points is over-estimated. 0.5 is half the absolute error; a small share makes a heuristic that
    seldom over-estimates, at the price of a larger mean error. The smaller the share, the more points a leaf needs:
    with fewer than a few over ``share`` its plane is set by chance, and lowering all values alike does as well.

    Args:
        share: Share of points to be over-estimated, between 0 and 1.

    Returns:
        A loss for :func:`refine`.

    Raises:
        ValueError: If the share is not between 0 and 1.

    References:
        Koenker and Bassett, "Regression quantiles", Econometrica 46, 1978.
    """
    return Quantile(
        as_number("A quantile's share of over-estimates", share, "between 0 and 1", lambda share: 0 < share < 1)
    )


def eikonal(weight: int | float = 1.0) -> Penalty:
    """Residual of the eikonal equation ``|grad V| = 1``, which a shortest path's length obeys where it is smooth.

    The mean of ``(|slope| - 1)**2`` over the points, times ``weight``. It holds for lengths in the units of the
    domain alone: not for turns, nor for a cost of another kind.

    Args:
        weight: Mean loss that is worth a residual of 1, >= 0. With the squared loss, ``weight = w**2``
            treats a slope that is off by 1 like an error of ``w``.

    Returns:
        A penalty for :func:`refine`.

    Raises:
        ValueError: If the weight is negative or not finite.
    """
    return jax.tree_util.Partial(_eikonal, as_finite("The weight of eikonal", weight))


def jumps(faces: Faces, weight: int | float = 1.0) -> Penalty:
    """Squared jumps of the value across free faces, where the distance is continuous.

    The mean of the squared jump over the sampled points, times ``weight``.

    Args:
        faces: Points on free faces of the partition that is refined, from :func:`sample_faces`; at least one.
        weight: Mean loss that is worth a mean squared jump of 1, >= 0.

    Returns:
        A penalty for :func:`refine`.

    Raises:
        ValueError: If there are no points, or the weight is negative or not finite.
    """
    if len(faces) == 0:
        raise ValueError("There is no free face to keep from jumping: the faces have no points.")
    leaves, basis = jnp.asarray(faces.leaves.T, jnp.int32), jnp.asarray(faces.basis, jnp.float32)
    return jax.tree_util.Partial(_jumps, as_finite("The weight of jumps", weight), leaves, basis)


def _eikonal(weight: Array | float, planes: Planes) -> Float[Array, ""]:
    norm = jnp.sqrt(jnp.sum(planes.slope**2, axis=1) + np.float32(1e-12))  # differentiable at slope 0 too
    return weight * jnp.sum(planes.share * (norm - 1) ** 2)


def _jumps(
    weight: Array | float, leaves: Int[Array, "2 m"], basis: Float[Array, "m 2 terms"], planes: Planes
) -> Float[Array, ""]:
    below, above = planes.coefficients[leaves]
    jump = jnp.sum(above * basis[:, 1] - below * basis[:, 0], axis=1)
    return weight * jnp.mean(jump**2)


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
