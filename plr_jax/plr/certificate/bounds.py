"""Bounds of how much the distance is above what a leaf holds, over all free points of a piece of it.

The distance is nowhere above the cone of a source that all of the piece sees, and nowhere below the least cone of the
sources that any of it may use. Where no source is seen by all, it is at most that of the piece's center, and the way
there, which is free.
"""

from typing import Protocol

import numpy as np
from jaxtyping import Float, Int

from plr_jax._arrays import run_members
from plr_jax._types import CellSources
from plr_jax.geometry.box import Box
from plr_jax.geometry.convex_pieces import Pieces
from plr_jax.plr.partition.cells import Cells

_ROUNDING = 2.0**-22
"""Widths of the domain by which a query may place a point beside its cell: twice the last bit of a lookup."""


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


def grown_boxes(cells: Cells, domain: Box) -> tuple[Float[np.ndarray, "cells dim"], Float[np.ndarray, "cells dim"]]:
    """Corners of boxes that hold all points for which queries may ask a cell."""
    lo, hi = cells.boxes(domain)
    margin = _ROUNDING * domain.width
    return lo - margin, hi + margin


def grown_domain(domain: Box) -> Box:
    """The domain as such a box."""
    lo, hi = grown_boxes(Cells.root(domain.dim), domain)
    return Box(lo[0], hi[0])


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
