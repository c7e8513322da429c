"""Samples of free space with the corners that they see, shared by the distances to many goals of one workspace."""

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import shapely
from jaxtyping import Float, Int

from plr_jax._arrays import parts, take_ragged
from plr_jax.geometry.cell_sight import turns_by_triangle
from plr_jax.geometry.convex_pieces import areas, centers, clip_to_boxes
from plr_jax.geometry.corners import CornerVisibility
from plr_jax.geometry.triangulation import Triangulation
from plr_jax.geometry.visibility import VisibilityTable

_PAIRS, _WALL_BOXES = 1 << 18, 1 << 11  # pairs of a sample and a corner, and boxes at walls, in memory at a time
_LEAST_SHARE = 1e-9  # free share of a box's area below which the box counts as an obstacle
Corners: TypeAlias = Float[np.ndarray, "boxes 2"]


@dataclass(frozen=True, eq=False)
class FamilySamples:
    """At most one sample for each of several boxes, and the corners where paths from the sample may turn first.

    The sample is the center of the box if no wall meets the box, else the center of its largest free convex piece.

    Attributes:
        x: The sample of each box; NaN if no part of the box is free.
        weight: Free share of each box's area; 0 without a sample.
        sampled: Boxes that have a sample.
        placed: Rounded samples of these boxes; samples that rounding puts into a wall are moved out of it.
        box: Boxes whose samples see corners; their corners are ``corner[first[i]]`` up to the next box's.
        length: Distance from the sample to each of these corners.
    """

    x: Corners
    weight: Float[np.ndarray, "boxes"]
    sampled: Int[np.ndarray, "sampled"]
    placed: Float[np.ndarray, "sampled 2"]
    box: Int[np.ndarray, "seeing"]
    first: Int[np.ndarray, "seeing"]
    corner: Int[np.ndarray, "pairs"]
    length: Float[np.ndarray, "pairs"]

    @staticmethod
    def of(visibility: CornerVisibility, triangulation: Triangulation, lo: Corners, hi: Corners) -> "FamilySamples":
        """Sample boxes of one size, and find the corners that the samples see and at which a path may turn."""
        # 1. Choose the samples.
        x, weight, area = (lo + hi) / 2, np.ones(len(lo)), np.prod(hi[0] - lo[0])
        boxes: Any = shapely.box(*lo.T, *hi.T)
        at_wall = np.unique(triangulation.boundary.tree.query(boxes, predicate="intersects")[0])
        elsewhere = np.setdiff1d(np.arange(len(lo)), at_wall)
        weight[elsewhere] = triangulation.locator.find(x[elsewhere])[1] >= -triangulation.tolerance
        weight[at_wall] = 0.0
        triangles = np.ascontiguousarray(triangulation.triangles.transpose(2, 0, 1))
        for begin in range(0, len(at_wall), _WALL_BOXES):
            some = at_wall[begin : begin + _WALL_BOXES]
            pieces, box, _ = clip_to_boxes(triangles, lo[some], hi[some])
            size = areas(pieces)
            order = np.lexsort((-size, box))
            largest = order[np.append(True, box[order[1:]] != box[order[:-1]])] if len(order) else order
            x[some[box[largest]]] = centers(pieces[:, largest])
            weight[some] = np.bincount(box, size, len(some)) / area
        weight[weight < _LEAST_SHARE] = 0.0
        sampled = np.flatnonzero(weight)
        x[weight == 0] = np.nan
        # 2. Test the corners that see a part of each sample's triangle.
        places, corners = triangulation.place(x[sampled]), visibility.corners
        first, turns = turns_by_triangle(visibility, triangulation)
        count = np.int64(len(corners.points))
        key = np.unique(np.repeat(np.arange(len(first) - 1), np.diff(first)) * count + (turns >> 1))
        triangle, of_triangle = np.divmod(key, count)
        first = np.searchsorted(triangle, np.arange(len(first)))
        pairs = [np.zeros((2, 0), np.int64)]
        for part in parts(np.diff(first)[places.triangle], _PAIRS):
            entry, sample = take_ragged(first, places.triangle[part])
            corner, sample = of_triangle[entry], sample + part.start
            turns_there = corners.is_tangent_to(corner, places.x[sample])
            corner, sample = corner[turns_there], sample[turns_there]
            seen = visibility.table.sees(corner, places.x[sample])
            pairs.append(np.stack([sample[seen], corner[seen]]))
        sample, corner = np.concatenate(pairs, axis=1)
        first = np.flatnonzero(np.append(True, sample[1:] != sample[:-1])[: len(sample)])
        length = np.linalg.norm(x[sampled[sample]] - corners.points[corner], axis=1)
        box = sampled[sample[first]]
        return FamilySamples(x, weight, sampled, places.x, box, first, corner.astype(np.int32), length)

    def first_turns(
        self, goal: Float[np.ndarray, "2"], view: VisibilityTable, corner_distances: Float[np.ndarray, "corners"]
    ) -> tuple[Float[np.ndarray, "boxes"], Int[np.ndarray, "boxes"]]:
        """Return each sample's distance to a goal, and the first vertex of its path: 0, the goal, or corner + 1.

        Without a path, return ``inf`` and -1. ``view`` is what the goal sees.
        """
        distance, vertex = np.full(len(self.x), np.inf), np.full(len(self.x), -1)
        if len(self.first):
            way = corner_distances[self.corner] + self.length
            distance[self.box] = np.minimum.reduceat(way, self.first)
            counts = np.diff(self.first, append=len(way))
            shortest = np.flatnonzero((way == np.repeat(distance[self.box], counts)) & np.isfinite(way))[::-1]
            vertex[np.repeat(self.box, counts)[shortest]] = self.corner[shortest] + 1
        # The goal sees nothing outside the bounding box of itself and the walls that it sees.
        ends = np.append(view.boundary.segments[view.edge[view.edge >= 0]].reshape(-1, 2), view.points, axis=0)
        lo, hi = ends.min(axis=0) - view.tolerance, ends.max(axis=0) + view.tolerance
        near = np.flatnonzero(((self.placed >= lo) & (self.placed <= hi)).all(axis=1))
        direct = self.sampled[near[view.sees(np.zeros(len(near), int), self.placed[near])]]
        distance[direct], vertex[direct] = np.linalg.norm(self.x[direct] - goal, axis=1), 0
        return distance, vertex
