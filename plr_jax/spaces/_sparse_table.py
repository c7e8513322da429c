"""The least and the largest entry of blocks of an array, by a sparse table of windows."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Float32, Int

from plr_jax._arrays import parts, runs

_MOST_ENTRIES = 2**26  # of all windows, 256 MiB: where more would be, large blocks are covered by more windows
_AT_ONCE = 2**18  # windows that are looked up at a time

Window = Float[np.ndarray, "..."] | Float32[np.ndarray, "..."]


@dataclass(frozen=True, eq=False)
class SparseTable:
    """Extremes of blocks of an array of any rank, each the union of a few windows whose sides are powers of two.

    Of every place the table has the least and the largest entry in the window of each side that begins there, in 32
    bits, rounded outward. A block about as wide along every axis is covered by two windows an axis, a long one by
    more. Along an axis that is shorter than a window's side, the window is as long as the axis.

    Args:
        values: The entries, finite, of a size that 32 bits can tell.

    References:
        Bender and Farach-Colton, "The LCA problem revisited", 2000.
    """

    values: Float[np.ndarray, "..."]

    def extremes(
        self, first: Int[np.ndarray, "n rank"], last: Int[np.ndarray, "n rank"]
    ) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
        """The least and the largest entry of blocks.

        Args:
            first: Their first entries along each axis, ``(n, rank)``.
            last: Their last ones, which count as well.

        Returns:
            The extremes, ``(n,)`` each: exact of entries that 32 bits hold, else up to a rounding outward.
        """
        least, most = np.empty(len(first)), np.empty(len(first))
        sides = np.array([side for side, _, _ in self._levels])
        level = np.count_nonzero((last - first + 1 >= sides[1:, None]).all(axis=2), axis=0)
        for each in np.unique(level):
            blocks = np.flatnonzero(level == each)
            counts = -(-(last - first + 1)[blocks] // sides[each])
            for part in parts(counts.prod(axis=1), _AT_ONCE):
                which = blocks[part]
                least[which], most[which] = self._covered(int(each), first[which], last[which], counts[part])
        return least, most

    def _covered(
        self,
        level: int,
        first: Int[np.ndarray, "n rank"],
        last: Int[np.ndarray, "n rank"],
        counts: Int[np.ndarray, "n rank"],
    ) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
        """Extremes of blocks that are covered by so many windows of one level along each axis."""
        side, least, most = self._levels[level]
        totals = counts.prod(axis=1)
        block, rest = runs(totals)
        begin = np.empty((len(block), counts.shape[1]), np.intp)
        for axis in range(counts.shape[1]):
            rest, step = np.divmod(rest, counts[block, axis])
            begin[:, axis] = np.minimum(first[block, axis] + step * side[axis], last[block, axis] - side[axis] + 1)
        window = np.ravel_multi_index(tuple(begin.T), least.shape)
        starts = np.cumsum(totals) - totals
        return np.minimum.reduceat(least.take(window), starts), np.maximum.reduceat(most.take(window), starts)

    @cached_property
    def _levels(self) -> list[tuple[Int[np.ndarray, "rank"], Window, Window]]:
        """Sides of windows, and the least and the largest entry of those that begin at each place."""
        shape = np.array(self.values.shape)
        side, least, most = np.ones_like(shape), _rounded(self.values, -np.inf), _rounded(self.values, np.inf)
        levels, entries = [(side, self.values, self.values)], 0
        while (side < shape).any() and entries < _MOST_ENTRIES:
            step = np.minimum(side, shape - side)
            least, most = _joined(np.minimum, least, step), _joined(np.maximum, most, step)
            side, entries = side + step, entries + 2 * least.size
            levels.append((side, least, most))
        return levels


def _joined(extreme: np.ufunc, windows: Window, step: Int[np.ndarray, "rank"]) -> Window:
    """Extremes of windows that are longer by a step along each axis, of two that overlap or touch."""
    for axis in np.flatnonzero(step):
        along = np.moveaxis(windows, axis, 0)
        windows = np.moveaxis(extreme(along[: -step[axis]], along[step[axis] :]), 0, axis)
    return np.ascontiguousarray(windows)


def _rounded(values: Float[np.ndarray, "..."], toward: float) -> Float32[np.ndarray, "..."]:
    """Numbers in 32 bits, none moved but toward one side."""
    single = values.astype(np.float32)
    wrong = single < values if toward > 0 else single > values
    return np.where(wrong, np.nextafter(single, np.float32(toward)), single)
