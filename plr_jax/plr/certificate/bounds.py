"""How far the distance is above and below what every leaf holds: pieces are halved where that is not sure enough.

Bounds of a piece hold for all of it, and the error at its center is one that is met; where the center's distance is
known as a bound alone, that is taken for met, and bounds may be less tight. Pieces whose bounds are not much beyond
errors that are met are done with; the others are halved, which brings both together.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias, runtime_checkable

import numpy as np
from jaxtyping import Float, Int

from plr_jax._arrays import run_members
from plr_jax._types import CellSources
from plr_jax.geometry.convex_pieces import Pieces

# Bounds of how much the distance is above what a leaf holds, over all free points of a piece of it.
#
# The distance is nowhere above the cone of a source that all of the piece sees, and nowhere below the least cone of
# the sources that any of it may use. Where no source is seen by all, it is at most that of the piece's center, and
# the way there, which is free.


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
    ) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
        """Of cones with these apexes and offsets, one a piece."""
        ...


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


# Of halving, and of pieces to halve; then bounds are taken as they are, valid and not tight.
_MOST_ROUNDS, _MOST_PIECES = 48, 1 << 19
_OF_RANGE = 0.04  # of the range of errors that are met in a leaf, by which its bounds may be beyond them
LEAST_OF_LARGEST, _MOST_OF_LARGEST = 1e-3, 5e-3  # of the largest error, at least and at most so


@runtime_checkable
class LeafFunctions(Protocol):
    """What leaves hold."""

    def values(self, leaf: Int[np.ndarray, "n"], x: Float[np.ndarray, "n dim"]) -> Float[np.ndarray, "n"]:
        """Values at points, of given leaves."""
        ...

    def below_cones(
        self,
        leaf: Int[np.ndarray, "n"],
        pieces: Pieces,
        apex: Float[np.ndarray, "n 2"],
        offset: Float[np.ndarray, "n"],
    ) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
        """Smallest and largest value of cones ``offset + |x - apex|`` minus given leaves' functions, over pieces."""
        ...


@dataclass(frozen=True, eq=False)
class LeafBounds:
    """Bounds of the distance minus what each leaf holds, over all its points from which the goal can be reached."""

    lower: Float[np.ndarray, "leaves"]
    upper: Float[np.ndarray, "leaves"]

    @property
    def largest(self) -> float:
        """The largest error of all."""
        return float(max(self.upper.max(initial=0.0), -self.lower.min(initial=0.0)))


Errors: TypeAlias = Float[np.ndarray, "leaves"]
"""Of the distance minus what each leaf holds."""


def prove_bounds(
    functions: LeafFunctions,
    visible: CellSources,
    enough: Callable[[Errors, Errors], tuple[Errors, Errors]] | None = None,
) -> LeafBounds:
    """Bounds for leaves, whose sources are given as cells.

    In double precision; what it rounds is far below the ``slack`` of the sources, which is in the bounds.

    Args:
        functions: What the leaves hold.
        visible: Their sources.
        enough: What bounds of leaves need not be better than, given errors that are met; None: such as are close to
            these, or off by little of the largest error of all.
    """
    num_leaves = visible.num_cells
    lower, upper = np.zeros(num_leaves), np.zeros(num_leaves)
    least, most = np.zeros(num_leaves), np.zeros(num_leaves)  # of the errors that are met
    leaf = visible.cell
    for round_ in range(_MOST_ROUNDS):
        met = visible.distance - functions.values(leaf, visible.center)
        np.minimum.at(least, leaf, met)
        np.maximum.at(most, leaf, met)
        below, above = bounds_of_pieces(
            visible, np.arange(len(leaf)), lambda *cones, leaf=leaf: functions.below_cones(leaf[cones[3]], *cones[:3])
        )
        # Bounds that need not be better, given errors that are met.
        largest = max(most.max(initial=0.0), -least.min(initial=0.0))
        spare = (
            np.clip(_OF_RANGE * (most - least), LEAST_OF_LARGEST * largest, _MOST_OF_LARGEST * largest)
            + visible.slack
        )
        low_enough, high_enough = least - spare, most + spare
        if enough is not None:
            low, high = enough(least - visible.slack, most + visible.slack)
            low_enough = np.minimum(low_enough, low + visible.slack)
            high_enough = np.maximum(high_enough, high - visible.slack)
        open_ = (below < low_enough[leaf]) | (above > high_enough[leaf])
        open_ &= round_ < _MOST_ROUNDS - 1 and np.count_nonzero(open_) <= _MOST_PIECES
        np.minimum.at(lower, leaf[~open_], below[~open_])
        np.maximum.at(upper, leaf[~open_], above[~open_])
        if not open_.any():
            break
        visible = _halved(visible, np.flatnonzero(open_))
        leaf = leaf[open_][visible.cell // 2]
    return LeafBounds(lower - visible.slack, upper + visible.slack)


def _halved(visible: CellSources, piece: Int[np.ndarray, "open"]) -> CellSources:
    """Both halves of some pieces, each cut across where it is longest: two cells a piece."""
    alone = visible.pieces_as_cells(piece)
    lo, hi = visible.pieces[:, piece].min(axis=2).T, visible.pieces[:, piece].max(axis=2).T
    each = np.arange(len(piece))
    axis = np.argmax(hi - lo, axis=1)
    middle = (lo + hi)[each, axis] / 2
    lower_hi, upper_lo = hi.copy(), lo.copy()
    lower_hi[each, axis] = upper_lo[each, axis] = middle
    parent, is_upper = np.repeat(each, 2), np.tile([False, True], len(each))
    los, his = np.stack([lo, upper_lo], axis=1).reshape(-1, 2), np.stack([lower_hi, hi], axis=1).reshape(-1, 2)
    return alone.parts(parent, axis[parent], is_upper, los, his)
