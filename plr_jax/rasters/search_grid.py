"""The grid in which paths over a raster are searched: parts of the raster's cells, of equal width and height.

Rasters in degrees of longitude and latitude become conformal grids: on Mercator's map of the sphere, a small motion
in any direction is longer by the factor 1 / cos(latitude) than on the sphere. So the cost per meter of the map is the
cost per meter of the sphere times cos(latitude)::

    raster, in degrees        Mercator's map

    +-----+-----+             +-----+-----+     Rows of the raster are higher on the map, the farther they are from
    |     |     |             |  o  |  o  |     the equator. Rows of the grid (o) are equally high. Each row has the
    +-----+-----+             |  o  |  o  |     costs of the raster's row in which its middle lies, and no row of the
    |     |     |             +-----+-----+     raster is left out.
    +-----+-----+             |  o  |  o  |
                              +-----+-----+

Reference: Snyder, "Map projections: a working manual", 1987, chapter 7.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax.geometry.box import Box
from plr_jax.rasters.search import Points, Raster, Sides, cells_of

EARTH_RADIUS = 6_371_008.8  # mean radius, in meters
MOST_LATITUDE = 85.0  # degrees: on Mercator's map, the poles are infinitely far away
Parts = Float[np.ndarray, "part_rows part_columns"]
_EXACT = 1e-6  # centers of cells within this share of a row are the centers of parts


@dataclass(frozen=True, eq=False)
class SearchGrid:
    """A grid of parts of a raster's cells, about square unless the grid is coarse. Raster rows ascend.

    The *plane* of the grid is the raster's plane, with the raster's lower corner at 0, or Mercator's map in meters.
    """

    box: Box  # of the raster; a periodic first axis wraps around
    shape: tuple[int, int]  # rows and columns of the raster
    in_degrees: bool
    row_of: Int[np.ndarray, " rows"]  # the raster's row of each row of parts
    column_parts: int  # columns of parts in each column of the raster
    side: Sides  # of a part, in the plane
    scale: Float[np.ndarray, " rows"]  # length on the ground of a unit of the plane, in each row of parts
    # The row of parts that has the middle of each raster row, and how far this middle is above the middle of that row
    # of parts, in rows of parts.
    middle_row: Int[np.ndarray, " raster_rows"]
    above: Float[np.ndarray, " raster_rows"]

    @classmethod
    def of(cls, box: Box, shape: tuple[int, int], in_degrees: bool, num_cells: int, divides: bool) -> "SearchGrid":
        """Return a grid of about ``num_cells`` parts, or of one part for each of more cells.

        Parts are about square, unless the grid ``divides`` no cell except to have rows of equal height.
        """
        # 1. Sides of rows in the plane, and the smallest number of equal rows that leaves out no row.
        rows, columns = shape
        borders = np.arange(rows + 1) / rows * box.width[1]
        middles = (np.arange(rows) + 0.5) / rows * box.width[1]
        width = box.width[0]
        if in_degrees:
            start = _mercator(box.lo[1])
            borders, middles = _mercator(box.lo[1] + borders) - start, _mercator(box.lo[1] + middles) - start
            width = EARTH_RADIUS * np.radians(width)
        num_rows = int(np.ceil(borders[-1] / np.diff(borders).min() * (1 - _EXACT)))
        # 2. Divide rows and columns into odd numbers of parts, so that the center of a cell is the center of a part.
        side = np.array([width / columns, borders[-1] / num_rows])
        row_parts = column_parts = 1
        if divides:
            finer = max(np.sqrt(num_cells / (num_rows * columns) * side.min() / side.max()), 1.0)
            wanted = side / side.min() * ((finer - 1) // 2 * 2 + 1)
            column_parts, row_parts = (np.ceil((wanted - 1.5) / 2) * 2 + 1).astype(int).tolist()
        elif in_degrees:
            row_parts = max(round(side[1] / side[0]), 1)  # heights are interpolated between rows
        num_rows *= row_parts
        side = np.array([width / (columns * column_parts), borders[-1] / num_rows])
        # 3. Rows of parts.
        center = (np.arange(num_rows) + 0.5) * side[1]
        row_of = np.clip(np.searchsorted(borders, center) - 1, 0, rows - 1)
        scale = 1 / np.cosh((center + start) / EARTH_RADIUS) if in_degrees else np.ones(num_rows)  # cos(latitude)
        place = middles / side[1] - 0.5
        middle_row = np.clip(np.rint(place).astype(int), 0, num_rows - 1)
        middle_row += np.sign(np.arange(rows) - row_of[middle_row])  # the other one of two rows beside the middle
        above = np.where(np.abs(place - middle_row) < _EXACT, 0.0, place - middle_row)
        return cls(box, shape, in_degrees, row_of, column_parts, side, scale, middle_row, above)

    @property
    def num_cells(self) -> int:
        """Number of parts."""
        return len(self.row_of) * self.shape[1] * self.column_parts

    @property
    def wraps(self) -> bool:
        """Whether the last column meets the first one."""
        return self.box.periodic[0]

    def divided(self, raster: Raster) -> Parts:
        """Return the raster's values in each part of its cells."""
        if self.num_cells > raster.size:
            raster = raster[self.row_of].repeat(self.column_parts, axis=1)
        return raster

    def interpolated(self, raster: Raster) -> Parts:
        """Return the raster's values at the center of each row of parts, linear between centers of cells."""
        if not self.in_degrees:
            return raster
        middle = np.stack([np.zeros(len(self.row_of)), (np.arange(len(self.row_of)) + 0.5) * self.side[1]], axis=1)
        latitude = self.on_raster(middle)[:, 1]
        place = np.clip((latitude - self.box.lo[1]) / self.box.width[1] * self.shape[0] - 0.5, 0, self.shape[0] - 1)
        below = np.minimum(place.astype(int), max(self.shape[0] - 2, 0))
        rest = (place - below)[:, None]
        return (1 - rest) * raster[below] + rest * raster[np.minimum(below + 1, self.shape[0] - 1)]

    def at_centers(self, table: np.ndarray) -> np.ndarray:
        """Return the values at the centers of the raster's cells, from values at the centers of parts.

        Numbers are interpolated between two rows; integers are those of the nearest row in the cell.
        """
        if table.shape == self.shape and not self.above.any():
            return table
        table = table[:, self.column_parts // 2 :: self.column_parts]
        here = table[self.middle_row]
        if table.dtype.kind == "i" or not self.above.any():
            return here
        # Linear between the rows `here` and `there`, which is `above` rows away. Where paths from these two rows lead
        # away from each other, the distance has a peak (^) between them, where two continued lines meet:
        #
        #              ^
        #            /   \
        #       here       there
        #     before           after
        #
        toward, share = np.sign(self.above).astype(int), np.abs(self.above)[:, None]
        before, there, after = (table[np.clip(self.middle_row + k * toward, 0, len(table) - 1)] for k in (-1, 1, 2))
        with np.errstate(invalid="ignore"):  # differences of infinite numbers, which comparisons ignore
            between = here + share * (there - here)
            continued = np.minimum(here + share * (here - before), there + (1 - share) * (there - after))
            middle = np.fmax(between, continued)
        return np.where(np.isfinite(middle), middle, here)

    def in_plane(self, points: Points, is_open: Bool[np.ndarray, "part_rows part_columns"]) -> Points:
        """Return the places, in the plane of the grid, of points in open cells of the raster.

        Rows of parts do not end where rows of the raster do. So points move up or down to the nearest part of their
        cell, unless they lie in another part that ``is_open``.
        """
        points = self.box.wrapped(points)
        if not self.in_degrees:
            return points - self.box.lo
        x = EARTH_RADIUS * np.radians(points[:, 0] - self.box.lo[0])
        y = _mercator(points[:, 1]) - _mercator(self.box.lo[1])
        row = cells_of(points - self.box.lo, self.box.width / self.shape[::-1], self.shape)[:, 0]
        first, last = (np.searchsorted(self.row_of, row, side) for side in ("left", "right"))
        places = np.stack([x, y], axis=1)
        is_in_barrier = ~is_open[tuple(cells_of(places, self.side, is_open.shape).T)]
        moved = np.clip(y, (first + _EXACT) * self.side[1], (last - _EXACT) * self.side[1])
        return np.stack([x, np.where(is_in_barrier, moved, y)], axis=1)

    def on_raster(self, points: Points) -> Points:
        """Return the points of the raster at places in the plane of the grid."""
        if not self.in_degrees:
            return self.box.lo + points
        y = points[:, 1] + _mercator(self.box.lo[1])
        latitude = np.degrees(np.arctan(np.sinh(y / EARTH_RADIUS)))
        return np.stack([self.box.lo[0] + np.degrees(points[:, 0] / EARTH_RADIUS), latitude], axis=1)

    def middle_of(self, cell: tuple[int, int]) -> tuple[int, int]:
        """Return the row and the column of the part in the middle of a cell."""
        row, column = cell
        return int(self.middle_row[row]), column * self.column_parts + self.column_parts // 2


def _mercator(latitude: Any) -> Any:
    return EARTH_RADIUS * np.arcsinh(np.tan(np.radians(latitude)))
