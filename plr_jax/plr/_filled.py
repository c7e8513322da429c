"""All leaves of a file: what is stored, and for leaves without a function that of a neighbor; and their tables."""

import numpy as np
from jaxtyping import Float

from plr_jax.plr._file import Contents
from plr_jax.plr.leaves.base import LinearLeafModel, linear_mean_planes
from plr_jax.plr.partition.contacts import neighbor_of_largest_contact
from plr_jax.plr.query.frame import LARGEST, table_corners
from plr_jax.plr.query.tables import Tables, build_tables


def tables_of_file(contents: Contents, num_bytes: int, origin: Float[np.ndarray, "dim"] | None = None) -> Tables:
    """The tables of a file of so many bytes, for points counted from an origin, if one is given.

    Then they hold nothing that is coarser the farther the domain is from that of coordinates.
    """
    domain, cells, leaf, folding = contents.domain, contents.cells, contents.leaf, contents.folding
    corner = table_corners(domain)[0]
    if origin is not None and folding is None:
        domain, corner = domain.moved(-origin), origin + table_corners(domain.moved(-origin))[0]
    numbers = leaf.numbers(contents.domain, cells, filled_coefficients(contents), corner)
    if not (np.abs(numbers) < LARGEST)[~np.isinf(numbers)].all():  # NaN is not
        raise ValueError("its distances or their slopes are too large for 32-bit floats; scale them down")
    tables = build_tables(domain, cells, numbers, leaf, num_bytes)
    return tables.of_folding(folding, np.zeros(domain.dim) if origin is None else origin)


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
        coefficients[borrower] = leaf.of_planes(center + np.sum(half * along, axis=1), half * widths)
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
