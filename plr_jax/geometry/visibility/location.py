"""Which triangle holds a point: those that meet the point's cell of a grid are tried one after another."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from jaxtyping import Float, Int

from plr_jax.geometry.vectors import left_normal


@dataclass(frozen=True, eq=False)
class Locator:
    """Triangles by the cells of a grid.

    Args:
        lo: Lower corner of the grid, ``(2,)``.
        width: Sides of a cell, ``(2,)``.
        shape: Number of cells along each axis.
        first: First entry of each cell, row by row, and the number of entries, ``(cells + 1,)``.
        triangle: Triangles that meet each cell, ``(entries,)``.
        lines: Inward unit normal of each side of a triangle, and its product with a point of the side,
            ``(triangles, 3, 3)``.
    """

    lo: Float[np.ndarray, "2"]
    width: Float[np.ndarray, "2"]
    shape: tuple[int, int]
    first: Int[np.ndarray, "cells_plus_one"]
    triangle: Int[np.ndarray, "entries"]
    lines: Float[np.ndarray, "triangles 3 3"]

    def find(self, x: Float[np.ndarray, "n 2"]) -> Int[np.ndarray, "n"]:
        """The triangle that holds each point, or that it is nearest to of those that meet its cell; else -1."""
        place = np.clip((x - self.lo) / self.width, 0, np.array(self.shape) - 1).astype(int)
        cell = place[:, 0] * self.shape[1] + place[:, 1]
        found, best = np.full(len(x), -1), np.full(len(x), -np.inf)
        pending, entry, end = np.arange(len(x)), self.first[cell], self.first[cell + 1]
        while len(pending):
            more = entry < end
            pending, entry, end = pending[more], entry[more], end[more]
            triangle = self.triangle[entry]
            height = self.heights(triangle, x[pending]).min(axis=1)
            better = height > best[pending]
            found[pending[better]], best[pending[better]] = triangle[better], height[better]
            outside = height < 0
            pending, entry, end = pending[outside], entry[outside] + 1, end[outside]
        return found

    def heights(self, triangle: Int[np.ndarray, "n"], x: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 3"]:
        """How far inside of each side of a triangle a point lies."""
        lines = self.lines[triangle]
        return lines[:, :, 0] * x[:, :1] + lines[:, :, 1] * x[:, 1:] - lines[:, :, 2]


def locator_of(triangles: Float[np.ndarray, "triangles 3 2"], tolerance: float) -> Locator:
    """A grid over triangles, which stand counterclockwise, of about as many cells.

    A triangle also counts for the cells that it meets but for the tolerance.
    """
    lo, hi = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    side = np.sqrt(np.prod(hi - lo) / len(triangles))
    count = np.maximum(1, np.minimum((hi - lo) / side, 4 * len(triangles)).astype(int))
    width = (hi - lo) / count
    corner = lo + width * np.stack(np.meshgrid(*map(np.arange, count), indexing="ij"), axis=-1).reshape(-1, 2)
    cells: Any = shapely.box(*(corner - tolerance).T, *(corner + width + tolerance).T)
    polygons: Any = shapely.polygons(triangles)
    cell, triangle = shapely.STRtree(polygons).query(cells, predicate="intersects")
    order = np.argsort(cell, kind="stable")
    first = np.searchsorted(cell[order], np.arange(len(cells) + 1))
    normal = left_normal(np.roll(triangles, -1, axis=1) - triangles)
    offset = (normal * triangles).sum(axis=2, keepdims=True)
    shape = int(count[0]), int(count[1])
    return Locator(
        lo, width, shape, first, triangle[order].astype(np.int32), np.concatenate([normal, offset], axis=2)
    )
