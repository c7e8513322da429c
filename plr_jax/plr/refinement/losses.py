"""What :func:`refine` makes small: a loss of the errors at points, and penalties on the planes themselves."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from plr_jax._arrays import as_finite, as_number
from plr_jax._types import ArrayLike
from plr_jax.plr.refinement.face_samples import Faces


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
