"""Voxels of a box of 1 to 4 dimensions: their faces, location of points, and counts of blocked voxels in ranges.

Coordinates are compared with faces without rounding, so statements about touching are exact. Voxels are numbered from
1 along each axis, with face ``k`` below voxel ``k``. Number 0 is everything below the bounds and the last number
everything above, both blocked. Arrays of voxel numbers and of coordinates have shape ``(dim, n)``.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import combinations, product
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import as_cells, shortened
from plr_jax._types import FAR_AWAY, ArrayLike, Fractions, Reach
from plr_jax.geometry.boundary import LARGEST_COORDINATE, rounding_of
from plr_jax.geometry.box import Box

_AXES = range(1, 5)
_LEAST_SIDE = 8e3  # rounding errors of coordinates per side of a voxel, as for pixels
Coordinates = Float[np.ndarray, "dim n"]
Numbers = Int[np.ndarray, "dim n"]
NumbersAlong = Int[np.ndarray, " n"]
Cells = Bool[np.ndarray, "..."]


@dataclass(frozen=True, eq=False)
class VoxelGrid:
    """Free and blocked voxels that fill a box; methods use voxel numbers, which start at 1 (see the module)."""

    free: Cells  # read-only
    bounds: Box

    @classmethod
    def of(cls, free: ArrayLike, bounds: Box | ArrayLike | None, axes: range = _AXES) -> "VoxelGrid":
        """Check arguments and return the grid.

        ``free`` are booleans ``free[x, y, ...]``, and ``axes`` the allowed numbers of axes. The voxels fill the box
        ``bounds``; None: voxels of side 1, the first with its lower corner at the origin.
        """
        number = f"{axes[0]} to {axes[-1]}" if len(axes) > 1 else str(axes[0])
        must = f"free must be booleans of {number} axes, free[x, y, ...], True in free voxels, such as volume == 0"
        voxels = as_cells(must, free, lambda shape: len(shape) in axes)
        if not voxels.any():
            raise ValueError(f"free must have at least one free voxel, got none in shape {voxels.shape}.")
        voxels.flags.writeable = False
        box = Box(np.zeros(voxels.ndim), voxels.shape) if bounds is None else Box.of(bounds, "The bounds")
        if box.dim != voxels.ndim:
            expected = f"{voxels.ndim} axes, as free[x, y, ...] has"
            raise ValueError(f"The bounds must have {expected}, got {shortened(bounds)}.")
        if box.is_periodic:
            raise ValueError(f"The bounds of voxels must not have periodic axes, got {box}.")
        least = max(np.abs([box.lo, box.hi]).max() * 2.0**-52, rounding_of(box)) * _LEAST_SIDE
        if np.abs([box.lo, box.hi]).max() > LARGEST_COORDINATE or (box.width / voxels.shape).min() < least:
            expected = f"sides of at least {least:.2g} here, and coordinates up to {LARGEST_COORDINATE:g}"
            advice = "choose fewer voxels, or bounds less slender or nearer to zero"
            raise ValueError(f"Voxels must have {expected}, got {voxels.shape} of them in {box}: {advice}.")
        return cls(voxels, box)

    @property
    def dim(self) -> int:
        return self.free.ndim

    @property
    def sides(self) -> Float[np.ndarray, "dim"]:
        return self.bounds.width / self.free.shape

    @cached_property
    def faces(self) -> list[Float[np.ndarray, "faces"]]:
        """Coordinates of the faces along each axis, ascending, with ``-inf`` in front and ``inf`` at the end."""
        inner = (self.bounds.at(np.arange(n + 1)[:, None] / n).T[axis] for axis, n in enumerate(self.free.shape))
        return [np.pad(of_axis, 1, constant_values=(-np.inf, np.inf)) for of_axis in inner]

    @cached_property
    def padded(self) -> Cells:
        """The array ``free`` with a layer of blocked voxels around it; its indices are voxel numbers."""
        return np.pad(self.free, 1)

    def numbers(self, x: Coordinates) -> tuple[Numbers, Numbers]:
        """Return, along each axis, the least and largest index (in ``padded``) of voxels that contain each point."""
        below, above = zip(*[self.numbers_along(axis, row) for axis, row in enumerate(x)], strict=True)
        return np.stack(below), np.stack(above)

    def numbers_along(self, axis: int, x: Float[np.ndarray, " n"]) -> tuple[NumbersAlong, NumbersAlong]:
        """Return, for each coordinate along one axis, the least and largest number of voxels that contain it."""
        # The quotient is right up to rounding: compare exactly with the faces below and above that voxel.
        faces = self.faces[axis]
        guess = np.clip((x - faces[1]) / self.sides[axis] + 1, 0, len(faces) - 2).astype(np.int64)
        guess -= x < faces[guess]
        above = guess + (x >= faces[guess + 1])
        return above - (x == faces[above]), above

    @cached_property
    def blocked(self) -> "Sums":
        """A table that counts the blocked voxels in ranges of voxel numbers."""
        return Sums(~self.padded)

    def free_range(self, first: Numbers, last: Numbers) -> tuple[Numbers, Numbers]:
        """Shrink each range of voxel numbers to the smallest range with the same free voxels.

        Ranges include ``first`` and ``last``. For a range without free voxels, ``last < first`` in the result.
        """
        first, last = first.copy(), last.copy()
        for axis in range(self.dim):
            for moved, inward in ((first, 1), (last, -1)):
                # Bisection of the number of layers at this end that have no free voxel: it is from `least` to `most`.
                least, most = np.zeros_like(first[axis]), np.maximum(last[axis] - first[axis] + 1, 0)
                while len(rows := np.flatnonzero(least < most)):
                    num_layers = (least[rows] + most[rows] + 1) // 2
                    begin, end = first[:, rows], last[:, rows]
                    inner_end = end if inward > 0 else begin
                    inner_end[axis] = moved[axis, rows] + inward * (num_layers - 1)
                    is_blocked = self.blocked.within(begin, end) == np.prod(np.maximum(end - begin + 1, 0), axis=0)
                    least[rows] = np.where(is_blocked, num_layers, least[rows])
                    most[rows] = np.where(is_blocked, most[rows], num_layers - 1)
                moved[axis] += inward * least
        return first, last

    def touches_contact(self, lo: Coordinates, hi: Coordinates) -> Bool[np.ndarray, " n"]:
        """Return whether each closed box from ``lo`` to ``hi`` meets a contact.

        A contact is an edge or corner around which free voxels are not all connected through common faces.
        """
        (below_lo, above_lo), (below_hi, above_hi) = self.numbers(lo), self.numbers(hi)
        touches = np.zeros(lo.shape[1], bool)
        for across, contacts in self._contacts:
            # Along the contact's normal axes, count the faces from ``lo`` to ``hi``; along all other axes, open
            # voxels. The face above voxel k has index k: the first face is above the lowest voxel that contains
            # ``lo``.
            is_across = np.isin(np.arange(self.dim), across)[:, None]
            first, last = np.where(is_across, below_lo, above_lo), np.where(is_across, above_hi - 1, below_hi)
            touches |= contacts.within(first, last) > 0
        return touches

    @cached_property
    def _contacts(self) -> list[tuple[tuple[int, ...], "Sums"]]:
        """Contacts: edges and corners of voxels around which free voxels are not all connected through common faces.

        Each item is a pair ``(across, table)`` for contacts between voxels that differ along the axes ``across``. In
        3 dimensions, these are edges along z for ``(0, 1)``, and corners for ``(0, 1, 2)``. The table counts contacts
        in ranges of indices. For edges along z, index ``(i, j, k)`` is the edge at the upper end of voxel ``(i, j,
        k)`` along x and y: it lies between voxels ``i`` and ``i + 1`` along x, and between voxels ``j`` and ``j + 1``
        along y.
        """
        several = (across for num in range(2, self.dim + 1) for across in combinations(range(self.dim), num))
        contacts = ((across, are_disconnected(self.padded, across)) for across in several)
        return [(across, Sums(touches)) for across, touches in contacts if touches.any()]


class Sums:
    """A summed-area table of a boolean array (Crow, SIGGRAPH 1984), which counts the true entries of any range."""

    def __init__(self, array: Cells):
        table = np.pad(array, [(1, 0)] * array.ndim).astype(np.int32 if array.size < 2**31 else np.int64)
        for axis in range(array.ndim):
            np.cumsum(table, axis=axis, out=table)
        self.table, self.strides = table.ravel(), np.array(table.strides) // table.itemsize

    def within(self, first: Numbers, last: Numbers) -> Int[np.ndarray, " n"]:
        """Count the true entries in each range of indices from ``first`` to ``last``, both included, along all axes.

        The count is 0 if ``last < first`` along an axis. Indices have shape ``(dim, n)``.
        """
        # Inclusion and exclusion: entry (i, j, ...) of the table counts indices below i, j, ... So add the entries at
        # all corners of the range, with a minus for each lower end.
        begin = first * self.strides[:, None]
        end = np.maximum(last + 1, first) * self.strides[:, None]
        total = np.zeros(first.shape[1], self.table.dtype)
        for corner in product((0, 1), repeat=len(first)):
            at = sum(end[axis] if bit else begin[axis] for axis, bit in enumerate(corner))
            total += (-1) ** corner.count(0) * self.table[at]
        return total


def spread(live: Bool[np.ndarray, "n corners"], free: Bool[np.ndarray, "n corners"]) -> Bool[np.ndarray, "n corners"]:
    """Flood-fill across faces, from ``live`` voxels through ``free`` voxels; return which voxels are reached.

    Each row has the ``2**dim`` voxels around one point, and is filled on its own.
    """
    # The last axis is in the order of ``itertools.product((0, 1), repeat=dim)``.
    flat = live.shape
    shape = (-1, *[2] * (flat[1].bit_length() - 1))
    live, free = live.reshape(shape).copy(), free.reshape(shape)
    before = -1
    while (count := np.count_nonzero(live)) != before:
        before = count
        for axis in range(1, live.ndim):
            live |= np.flip(live, axis) & free
    return live.reshape(flat)


def are_disconnected(cells: Cells, across: Sequence[int]) -> Cells:
    """Return, for each face, edge or corner between true ``cells``, whether common faces fail to connect the cells.

    The ``2**len(across)`` cells around a face, edge or corner differ in their indices along the axes ``across``.
    Along these axes, the result is one entry shorter than ``cells``.
    """
    # Bit i of `around` says whether cell i of the ``2**len(across)`` cells around is true.
    around = np.zeros([n - (axis in across) for axis, n in enumerate(cells.shape)], np.uint16)
    for bit, sides in enumerate(product((0, 1), repeat=len(across))):
        side = dict(zip(across, sides, strict=True))  # of each axis across: 0 below, 1 above
        part = tuple(slice(side.get(axis, 0), n - 1 + side.get(axis, 1)) for axis, n in enumerate(cells.shape))
        around |= cells[part].astype(np.uint16) << np.uint16(bit)
    # Look the result up in a table of all sets of cells: bit i of a set's index says whether cell i is in the set.
    num = 2 ** len(across)
    return are_parted((np.arange(2**num)[:, None] >> np.arange(num)) % 2 == 1)[around]


def are_parted(free: Bool[np.ndarray, "n corners"]) -> Bool[np.ndarray, " n"]:
    """Return, for each row of ``2**dim`` voxels around a point, whether common faces fail to connect free voxels."""
    first = free & (np.cumsum(free, axis=1) == 1)
    return np.asarray((free & ~spread(first, free)).any(axis=1))


def reach_of_cells(reached: Cells, cut_off: Cells, bounds: Box, domain: Box) -> Reach:
    """Return tests whether boxes in ``domain`` hold cells that reach a goal, or free cells that do not.

    The grid of cells fills ``bounds``. ``reached`` is true for cells that reach the goal, ``cut_off`` for free cells
    that do not. Array axes are coordinate axes.
    """
    from scipy import ndimage

    # 1. Repeat cells along periodic axes, a period more on either side.
    shape = np.array(reached.shape)
    padding = np.where(bounds.periodic, shape, 0)
    reached, cut_off = (np.pad(cells, padding[:, None], mode="wrap") for cells in (reached, cut_off))
    # 2. Find the cells that may hold far points: points of two cells are at most a cell's diagonal farther apart than
    #    the cells' centers.
    far = np.zeros_like(cut_off)
    if cut_off.any() and reached.any():
        side = bounds.width / shape / domain.width
        away: Any = ndimage.distance_transform_edt(~reached, sampling=side)  # between centers of cells
        far = cut_off & (away > FAR_AWAY - np.linalg.norm(side))

    # 3. Make tests of boxes: whether a box meets any of some cells, by a summed-area table.
    def meets(sums: Sums, lo: Fractions, hi: Fractions) -> Bool[np.ndarray, " boxes"]:
        begin, end = ((domain.lo + x * domain.width - bounds.lo) / bounds.width * shape for x in (lo, hi))
        ends = np.floor(begin) + padding, np.ceil(end) + padding
        begin, end = (np.clip(x, 0, reached.shape).astype(int).T for x in ends)
        return sums.within(begin, end - 1) > 0

    return Reach(*(partial(meets, Sums(np.ascontiguousarray(cells))) for cells in (reached, cut_off, far)))
