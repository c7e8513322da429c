"""The leaf model ``"plane"``: every leaf has a plane (affine function) fitted to the samples in this leaf alone."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jaxtyping import Int

from plr_jax._arrays import sum_of_columns
from plr_jax._types import Distances, Points
from plr_jax.geometry.box import Box
from plr_jax.geometry.convex_pieces import Pieces, cone_above_plane
from plr_jax.plr.frame import Corner, table_corners
from plr_jax.plr.leaves.base import UNIT, Coefficients, Parameters, largest_coordinates
from plr_jax.plr.leaves.independent import IndependentLeafModel
from plr_jax.plr.tree import Cells


class Plane(IndependentLeafModel):
    """The leaf model ``"plane"``: one plane (affine function) in every leaf; the function may jump between leaves.

    Coefficients are the value at a leaf's center, then half of the rise across the leaf along each axis.

    Args:
        coefficient_bits: Bits of a stored center value: 32 for floats, 4 to 20 for scaled integers. Slopes usually
            take fewer bits. None: 32 without ``max_bytes``; with ``max_bytes``, the number from 8 to 16 with the
            smallest expected error of fit and rounding. Other values raise ``ValueError``.
    """

    name = "plane"
    num_samples = 192
    least_bytes = 2
    has_exact_cone_bounds = True
    has_compact_code = True

    def halvings(self, cells: Cells) -> Int[np.ndarray, "leaves others"]:
        return cells.depth

    def basis(self, u: Points) -> Coefficients:
        return np.concatenate([np.ones((len(u), 1)), u], axis=1)

    def coefficients_of_planes(self, center: Distances, half: Points) -> Coefficients:
        return np.column_stack([center, half])

    def leaf_parameters(self, domain: Box, cells: Cells, coefficients: Coefficients, corner: Corner) -> Parameters:
        # Value at the corner, and slopes: center value + slope . (x - center), as value + slope . (x - corner).
        lo, hi = cells.boxes(domain)
        slope = coefficients[:, 1:] * 2 / (hi - lo)
        to_center = (lo + hi) / 2 - corner
        return np.column_stack([coefficients[:, 0] - sum_of_columns(slope * to_center), slope])

    def cone_minus_leaf_bounds(
        self, lo: Points, hi: Points, coefficients: Coefficients, pieces: Pieces, apex: Points, offset: Distances
    ) -> tuple[Distances, Distances]:
        slope = coefficients[:, 1:] * 2 / (hi - lo)
        intercept = coefficients[:, 0] - (slope * (lo + hi)).sum(axis=1) / 2
        return cone_above_plane(pieces, apex, offset, slope, intercept)

    def rounding_bounds(self, domain: Box, cells: Cells, coefficients: Coefficients) -> Distances:
        # Relative errors, in UNIT: of each parameter, offset and product, 1; of the sums of up to 1 + dim terms, dim.
        # Coordinates have absolute errors. The factor 1.01 covers products of these errors.
        parameters = np.abs(self.leaf_parameters(domain, cells, coefficients, table_corners(domain)[0]))
        terms = parameters[:, 0] + parameters[:, 1:] @ domain.width
        return 1.01 * UNIT * ((3 + domain.dim) * terms + parameters[:, 1:] @ largest_coordinates(domain))

    def value(self, parameters: Sequence[Any], place: Sequence[Any], root: Callable[[Any], Any]) -> Any:
        value, *slopes = parameters
        for slope, along in zip(slopes, place, strict=True):
            value = value + slope * along
        return value
