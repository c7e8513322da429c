"""Functions of all leaves of a file: what is stored, and for leaves without one that of a neighbor."""

import numpy as np
from jaxtyping import Float

from plr_jax._arrays import sum_of_columns
from plr_jax.geometry.box import Box
from plr_jax.plr._file import Contents
from plr_jax.plr.leaves.base import LinearLeafModel, linear_mean_planes
from plr_jax.plr.partition.contacts import neighbor_of_largest_contact
from plr_jax.plr.query.frame import LARGEST, Corner, table_corners


def counted_from(contents: Contents, origin: Corner) -> tuple[Box, Float[np.ndarray, "leaves count"]]:
    """The domain that leaves partition, for points counted from an origin, and what a query of those reads of leaves.

    From the domain's own corner, neither is coarser the farther that is from the origin of coordinates. Folded points
    are seen from their center, wherever others are counted from.

    Raises:
        ValueError: If 32-bit floats cannot hold the domain or the numbers.
    """
    origin = origin if contents.folding is None else np.zeros(contents.domain.dim)
    domain = contents.domain.moved(-origin)
    corner = origin + table_corners(domain)[0]
    numbers = contents.leaf.numbers(contents.domain, contents.cells, filled_coefficients(contents), corner)
    if not (np.abs(numbers) < LARGEST)[~np.isinf(numbers)].all():  # NaN is not
        raise ValueError("its distances or their slopes are too large for 32-bit floats; scale them down")
    return domain, numbers


def filled_coefficients(contents: Contents) -> Float[np.ndarray, "leaves terms"]:
    """Coefficients of all leaves.

    An unreachable leaf continues the (mean) plane of the reachable one with which it shares the largest face, edge or
    corner, so that a free point beside or in a wall has an answer. Of one that touches none the first is ``inf``, the
    others are 0.
    """
    leaf, cells, unreachable = contents.leaf, contents.cells, contents.leaf.unreachable(contents.stored)
    coefficients = leaf.coefficients(cells, contents.stored)
    if not (np.abs(coefficients) < LARGEST).all():
        raise ValueError("its distances are too large for 32-bit floats; scale them down")
    if isinstance(leaf, LinearLeafModel) and unreachable.any():
        periodic = contents.domain.periodic
        donor = neighbor_of_largest_contact(
            cells, np.flatnonzero(unreachable), np.flatnonzero(~unreachable), periodic
        )
        borrower, donor = np.flatnonzero(unreachable)[donor >= 0], donor[donor >= 0]
        center, half = linear_mean_planes(leaf, coefficients[donor], cells.dim)
        widths = np.ldexp(1.0, cells.depth[donor] - cells.depth[borrower])  # of a borrower, in those of its donor
        place = (cells.position + 0.5) * np.ldexp(1.0, -cells.depth)
        apart = place[borrower] - place[donor]
        apart -= np.where(periodic, np.rint(apart), 0.0)  # the short way around periodic axes
        along = 2 * apart * np.ldexp(1.0, cells.depth[donor])
        coefficients[unreachable] = np.where(np.arange(coefficients.shape[1]) == 0, np.inf, 0.0)
        coefficients[borrower] = leaf.of_planes(center + sum_of_columns(half * along), half * widths)
    return coefficients


def planes_of_leaves(
    contents: Contents, coefficients: Float[np.ndarray, "leaves terms"]
) -> tuple[Float[np.ndarray, "leaves"], Float[np.ndarray, "leaves dim"]]:
    """Intercepts, ``inf`` where the first coefficient is, and slopes of the leaves' (mean) planes."""
    is_inf = np.isinf(coefficients[:, 0])
    lo, hi = contents.cells.boxes(contents.domain)
    center, half = contents.leaf.mean_planes(lo, hi, np.where(is_inf[:, None], 0.0, coefficients))
    slope = half * 2 / (hi - lo)
    return np.where(is_inf, np.inf, center - np.sum(slope * (lo + hi) / 2, axis=1)), slope
