"""The grid in which paths over a raster are searched: parts of the raster's cells, of equal width and height."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import ndimage

from plr_jax.geometry.box import Box
from plr_jax.rasters.search import Points, Raster, Scale, Sides

EARTH_RADIUS = 6_371_008.8  # mean radius, in meters
Parts = Float[np.ndarray, "part_rows part_columns"]


class SearchGrid(NamedTuple):
    """A grid that divides each cell of a raster into equal parts; rows have ascending y.

    The *plane* of the grid has the raster's lower corner at 0, and the raster's unit of length or, for a raster in
    degrees, meters along meridians. A unit of the plane along a parallel has the length ``scale`` on the ground.
    """

    box: Box  # of the raster; a periodic first axis wraps around
    shape: tuple[int, int]  # rows and columns of the raster
    parts: tuple[int, int]  # rows and columns of parts in each cell: odd, so that a part has the cell's center
    unit: float  # of the raster's coordinates, in the plane
    scale: Scale | None  # cosine of the latitude in the middle of each row of parts, for degrees

    @classmethod
    def of(cls, box: Box, shape: tuple[int, int], in_degrees: bool, num_cells: int) -> "SearchGrid":
        """Divide the cells of a raster into parts that are about square and, if there are few, into smaller parts.

        The grid then has up to about ``num_cells`` parts. Cells in degrees are not made square, since the search fits
        its edges to the shape of cells.
        """
        rows, columns = shape
        unit = EARTH_RADIUS * np.radians(1) if in_degrees else 1.0
        side = box.width / (columns, rows)
        ratio = np.ones(2) if in_degrees else side / side.min()
        finer = max(np.sqrt(num_cells / (rows * columns) / ratio.max()), 1.0)
        wanted = ratio[::-1] * ((finer - 1) // 2 * 2 + 1)
        # Odd numbers of parts: 1 up to 1.5, 3 up to 3.5, and so on.
        row_parts, column_parts = (np.ceil((wanted - 1.5) / 2) * 2 + 1).astype(int).tolist()
        latitude = box.lo[1] + (np.arange(rows * row_parts) + 0.5) / (rows * row_parts) * box.width[1]
        scale = np.cos(np.radians(latitude)) if in_degrees else None
        return cls(box, shape, (row_parts, column_parts), float(unit), scale)

    @property
    def side(self) -> Sides:
        """Width and height of a part of a raster's cell, in the plane of the grid (see the class)."""
        return self.unit * self.box.width / np.multiply(self.shape, self.parts)[::-1]

    def divided(self, raster: Raster) -> Parts:
        """Return, for each part into which the grid divides a cell of the raster, the cell's value."""
        if self.parts == (1, 1):
            return raster
        return raster.repeat(self.parts[0], axis=0).repeat(self.parts[1], axis=1)

    def interpolated(self, raster: Raster) -> Parts:
        """Return a raster's values at the centers of the parts into which the grid divides the raster's cells.

        Values are interpolated bilinearly between centers of cells, and constant beyond the outermost centers.
        """
        beside = np.pad(raster, ((1, 1), (0, 0)), mode="edge")
        beside = np.pad(beside, ((0, 0), (1, 1)), mode="wrap" if self.box.periodic[0] else "edge")
        along = ((np.arange(n * k) + 0.5) / k + 0.5 for n, k in zip(self.shape, self.parts, strict=True))
        return ndimage.map_coordinates(beside, np.meshgrid(*along, indexing="ij"), order=1)

    def at_centers(self, table: np.ndarray) -> np.ndarray:
        """Return the values at the centers of the raster's cells, from a table for the centers of the grid's parts.

        A part is one of the equal parts into which the grid divides a cell.
        """
        (rows, columns), parts = self.middle_of((0, 0)), self.parts
        return table[rows :: parts[0], columns :: parts[1]]

    def in_plane(self, points: Points) -> Points:
        """Convert points from the raster's coordinates to coordinates in the plane of the grid (see the class)."""
        return self.unit * (self.box.wrapped(points) - self.box.lo)

    def on_raster(self, places: Points) -> Points:
        """Convert points from coordinates in the plane of the grid (see the class) to the raster's coordinates."""
        return self.box.lo + places / self.unit

    def middle_of(self, cell: tuple[int, int]) -> tuple[int, int]:
        """Return the row and column, in this grid, of the part in the middle of a cell of the raster.

        ``cell`` has the row and column in the raster.
        """
        row, column = (k * count + count // 2 for k, count in zip(cell, self.parts, strict=True))
        return row, column
