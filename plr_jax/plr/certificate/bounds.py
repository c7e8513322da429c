"""Bounds of how much the distance is above what a leaf holds, over all free points of a piece of it.

The distance is nowhere above the cone of a source that all of the piece sees, and nowhere below the least cone of the
sources that any of it may use. Where no source is seen by all, it is at most that of the piece's center, and the way
there, which is free.
"""

from collections.abc import Callable
from typing import Any, Protocol, TypeAlias, runtime_checkable

import numpy as np
from jaxtyping import Float, Int

from plr_jax._arrays import run_members
from plr_jax._types import CellSources
from plr_jax.geometry.convex_pieces import Pieces


@runtime_checkable
class ConesAbove(Protocol):
    """Smallest and largest value, over pieces, of cones minus what leaves hold.

    ``row`` says which of the leaves that were asked about each piece is of.
    """

    def __call__(
        self,
        pieces: Pieces,
        apex: Float[np.ndarray, "n 2"],
        offset: Float[np.ndarray, "n"],
        row: Int[np.ndarray, "n"],
        /,
    ) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]: ...


BelowCones: TypeAlias = Callable[..., tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]]
"""The method of that name of a leaf model."""


def bounds_of_pieces(
    visible: CellSources, piece: Int[np.ndarray, "n"], cones_above: ConesAbove
) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
    """Bounds of the distance minus what a leaf holds, over pieces, to within their ``slack``.

    A piece may be asked about several times, for other leaves each: rows are told apart by their place.
    """
    if not len(piece):
        return np.zeros(0), np.zeros(0)
    pairs, row = run_members(visible.first_pair, piece)
    source, sources = visible.source[pairs], visible.sources
    lowest, highest = cones_above(
        visible.pieces[:, piece[row]], sources.points[source], sources.distances[source], row
    )
    first = np.flatnonzero(np.append(True, row[1:] != row[:-1]))
    lower = np.minimum.reduceat(lowest, first)
    upper = np.minimum.reduceat(np.where(visible.by_all[pairs], highest, np.inf), first)
    hidden = np.flatnonzero(np.isinf(upper))
    if len(hidden):
        of = piece[hidden]
        _, upper[hidden] = cones_above(visible.pieces[:, of], visible.center[of], visible.distance[of], hidden)
    return lower, upper


def proven_errors(
    visible: CellSources, below_cones: BelowCones, functions: tuple[Float[np.ndarray, "cells _"], ...]
) -> Float[np.ndarray, "cells"]:
    """Bound of the largest error in each cell, 0 where nothing of it reaches the goal.

    What cells hold is given as :meth:`LeafModel.below_cones` takes it: their corners, and coefficients.
    """

    def of_rows(*cones: Any) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
        pieces, apex, offset, row = cones
        return below_cones(*(each[visible.cell[row]] for each in functions), pieces, apex, offset)

    lower, upper = bounds_of_pieces(visible, np.arange(len(visible.cell)), of_rows)
    errors = np.zeros(visible.num_cells)
    np.maximum.at(errors, visible.cell, np.maximum(-lower, upper))
    return errors
