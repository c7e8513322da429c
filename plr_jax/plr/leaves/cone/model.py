"""The leaf model ``"cone"``: functions ``offset + |x - source|``, where many leaves share a source."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import reduce
from operator import add
from typing import Any

import numpy as np
from jaxtyping import Int

from plr_jax._arrays import shortened
from plr_jax._types import CellSources, Distances, Points
from plr_jax.geometry.box import Box
from plr_jax.geometry.convex_pieces import Pieces, difference_of_cones
from plr_jax.plr.certificate import Bounds, LeafFunctions
from plr_jax.plr.coding import BitReader, BitWriter
from plr_jax.plr.frame import Corner, table_corners
from plr_jax.plr.growth import Limits, best_axis, largest_error
from plr_jax.plr.leaves.base import UNIT, Coefficients, LeafModel, Parameters, Rules, largest_coordinates
from plr_jax.plr.leaves.cone.codec import StoredCones, read_cones, write_cones
from plr_jax.plr.leaves.cone.search import best_cones
from plr_jax.plr.sampling import NEEDED, Sampler
from plr_jax.plr.tree import Cells, Tree

_UNDERFLOW = 1.1e-19  # root of the smallest normal 32-bit float; squares of smaller differences may become 0


@dataclass(frozen=True)
class Cone(LeafModel):
    """The leaf model ``"cone"``, functions ``offset + |x - source|``, for lengths of shortest paths among polygons.

    The source is the first corner of shortest paths from a leaf, or the goal. The offset is the source's distance to
    the goal.
    """

    name = "cone"
    least_bytes = 0.5
    has_deep_trees = True
    has_exact_cone_bounds = True
    splits_by_proven_error = True
    decoder_cost = 1_400, 500

    def bytes_without_budget(self, dim: int, num_leaves: int) -> int:
        return num_leaves // 2 + 256  # the constant is for some tens of sources

    def check_domain(self, domain: Box) -> None:
        if domain.is_periodic:
            expected = "Euclidean distances, without periodic axes"
            raise ValueError(f"Leaves of kind 'cone' need {expected}, got {domain}. Use continuous leaves or planes.")

    def construct(self, sampler: Sampler, rules: Rules, limits: Limits) -> tuple[Tree, StoredCones, CellSources]:
        if sampler.cache is None:
            got = f"{shortened(sampler.distance_fn)} in {sampler.domain.dim} dimensions"
            raise ValueError(f"Leaves of kind 'cone' need {NEEDED}, got {got}. Use leaf='continuous' for any other.")
        if sampler.weight_fn is not None or rules != Rules(largest_error, best_axis):
            options = "weight_fn, should_split or split: they are chosen by proven errors of whole cells"
            advice = "Leave these options out, or use leaf='continuous'."
            raise ValueError(f"Leaves of kind 'cone' must not have {options}. {advice}")
        visible = sampler.cache.sources(Cells.root(2))
        if not len(visible.cell):
            sampler.root()  # raises the error that nothing is reachable
        return best_cones(visible, sampler, limits)

    def write(self, body: BitWriter, domain: Box, cells: Cells, stored: StoredCones) -> None:
        write_cones(body, domain, stored)

    def read(self, body: BitReader, domain: Box, cells: Cells) -> StoredCones:
        return read_cones(body, domain, len(cells))

    def coefficients(self, cells: Cells, stored: StoredCones) -> Coefficients:
        # A leaf that cannot reach the goal has the source of another leaf.
        return np.column_stack([stored.sources.offsets, stored.sources.points])[stored.source]

    def values(self, lo: Points, hi: Points, coefficients: Coefficients, x: Points) -> Distances:
        return coefficients[:, 0] + np.linalg.norm(x - coefficients[:, 1:], axis=1)

    def leaf_parameters(self, domain: Box, cells: Cells, coefficients: Coefficients, corner: Corner) -> Parameters:
        return np.column_stack([coefficients[:, 0], coefficients[:, 1:] - corner])

    def cone_minus_leaf_bounds(self, leaf: LeafFunctions, pieces: Pieces, apex: Points, offset: Distances) -> Bounds:
        return difference_of_cones(pieces, apex, offset, leaf.coefficients[:, 1:], leaf.coefficients[:, 0])

    def rounding_bounds(self, domain: Box, cells: Cells, coefficients: Coefficients) -> Distances:
        # Errors, in UNIT, of the value offset + |d|, where d = (x - corner) - source is at most |source| + width:
        # - of d: 2 |source| + 2 width, as the source and both differences are rounded, and the error of x;
        # - of |d|: the length of these, and at most (2 + dim) |d|, from squares, sums and the root;
        # - of the value: offset + |d|, and the rounded offset.
        # The factor 1.01 covers products of these errors.
        parameters = np.abs(self.leaf_parameters(domain, cells, coefficients, table_corners(domain)[0]))
        error_of_d = 2 * parameters[:, 1:] + 2 * domain.width + largest_coordinates(domain)
        length = np.linalg.norm(parameters[:, 1:] + domain.width, axis=1)
        error_of_length = np.linalg.norm(error_of_d, axis=1) + (2 + domain.dim) * length
        return 1.01 * UNIT * (error_of_length + 2 * parameters[:, 0] + length) + _UNDERFLOW * np.sqrt(domain.dim)

    def value(self, parameters: Sequence[Any], place: Sequence[Any], root: Callable[[Any], Any]) -> Any:
        # The distance to the apex plus its offset, with operations of any number type.
        offset, *source = parameters
        differences = [along - of_source for along, of_source in zip(place, source, strict=True)]
        return offset + root(reduce(add, [difference * difference for difference in differences]))

    def source_of(self, parameters: Sequence[Any]) -> Sequence[Any]:
        return parameters[1:]


def as_sourced(leaf: LeafModel) -> Cone:
    if not isinstance(leaf, Cone):
        message = f"Waypoints need leaves with sources; leaves of kind {leaf.name!r} have no sources"
        raise ValueError(f"{message}. Build the PLR with leaf='cone', or follow it with descend.")
    return leaf


def goal_of_leaves(leaf: LeafModel, stored: Any) -> Int[np.ndarray, " leaves"] | None:
    goals = stored.sources.goal_of_source if isinstance(leaf, Cone) else None
    return None if goals is None else goals[stored.source]


def require_goals(goals: Any) -> Any:
    """Return ``goals``, the index of each leaf's nearest goal; ``ValueError`` if it is None (not stored)."""
    if goals is None:
        cause = "The PLR does not store which goal is nearest: only cones of a NearestGoal of VisibilityGraphs do"
        advice = "Give it a function that knows this, plr.with_nearest_goal(oracle.which)"
        raise ValueError(f"{cause}. {advice}; or, if its leaves are cones, take the ends of trace(plr, x).paths.")
    return goals
