"""Vectorized 2-D kernels that Shapely does not give: boundary edges, the free sectors at a vertex, fans."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int


def cross(u: Float[np.ndarray, "*#batch 2"], v: Float[np.ndarray, "*#batch 2"]) -> Float[np.ndarray, "..."]:
    """Cross product of 2-D vectors: positive where ``v`` points to the left of ``u``."""
    return np.asarray(u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0])


def turned_left(u: Float[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch 2"]:
    """Each vector after a quarter turn to the left."""
    return np.stack([-u[..., 1], u[..., 0]], axis=-1)


def left_normal(u: Float[np.ndarray, "*batch 2"]) -> Float[np.ndarray, "*batch 2"]:
    """The unit vector a quarter turn to the left of each vector."""
    return turned_left(u) / np.linalg.norm(u, axis=-1, keepdims=True)


def pseudo_angle(dx: Float[np.ndarray, "*batch"], dy: Float[np.ndarray, "*batch"]) -> Float[np.ndarray, "*batch"]:
    """A number in [0, 4] that grows with the direction's angle in [0, 2 pi], at the cost of a division.

    It turns at between half and the full rate of the angle. The zero vector gives 0.
    """
    length = np.abs(dx) + np.abs(dy)
    slant = np.divide(dx, length, out=np.ones_like(length), where=length > 0)
    return np.where(dy >= 0, 1.0 - slant, 3.0 + slant)


@dataclass(frozen=True, eq=False)
class Boundary:
    """The boundary of a polygonal region as a graph: vertices, and edges with the region on their left.

    At each vertex the region is a union of sectors. Every sector opens counterclockwise from the edge that
    leaves the vertex to the edge that arrives at it, so there is one for each edge: sector ``e`` lies at the
    first vertex of edge ``e``. Where the region touches itself in one point, that vertex has several.

    Args:
        vertices: Distinct vertices, ``(vertices, 2)``.
        edges: Indices of the first and last vertex of each edge, ``(edges, 2)``.
        sector_end: The vertex towards which sector ``e`` closes, ``(edges,)``.
    """

    vertices: Float[np.ndarray, "vertices 2"]
    edges: Int[np.ndarray, "edges 2"]
    sector_end: Int[np.ndarray, "edges"]

    @property
    def segments(self) -> Float[np.ndarray, "edges 2 2"]:
        """First and last point of each edge."""
        return self.vertices[self.edges]

    @property
    def contacts(self) -> Int[np.ndarray, "contacts"]:
        """Vertices in which the region touches itself: those of more than one sector."""
        return np.flatnonzero(np.bincount(self.edges[:, 0], minlength=len(self.vertices)) > 1)

    def is_reflex(self, tolerance: float) -> Bool[np.ndarray, "edges"]:
        """Whether each sector is wider than half a turn, by a corner that stands out by ``tolerance``."""
        corner = self.vertices[self.edges[:, 0]]
        to_start = self.vertices[self.edges[:, 1]] - corner
        to_end = self.vertices[self.sector_end] - corner
        span = np.linalg.norm(to_start - to_end, axis=1)
        return cross(to_start, to_end) < -tolerance * span

    def in_sector(
        self, edge: int | np.integer, offsets: Float[np.ndarray, "n 2"], tolerance: float
    ) -> Bool[np.ndarray, "n"]:
        """Whether offsets from the first vertex of an edge lie in the closed sector there."""
        vertex = self.vertices[self.edges[edge, 0]]
        start = self.vertices[self.edges[edge, 1]] - vertex
        end = self.vertices[self.sector_end[edge]] - vertex
        left_of_start = cross(start, offsets) >= -tolerance * np.linalg.norm(start)
        right_of_end = cross(end, offsets) <= tolerance * np.linalg.norm(end)
        return left_of_start & right_of_end if cross(start, end) > 0 else left_of_start | right_of_end


def boundary_of(region: Any, tolerance: float) -> Boundary:
    """The boundary graph of a Shapely (Multi)Polygon, its edges split where a vertex lies on one.

    Args:
        region: A valid polygon or multipolygon.
        tolerance: A vertex this near to an edge lies on it.

    Returns:
        The graph, with the region to the left of each edge.
    """
    rings = shapely.get_rings(shapely.get_parts(shapely.orient_polygons(region)))
    points, ring = shapely.get_coordinates(rings, return_index=True)
    vertices, index = np.unique(points, axis=0, return_inverse=True)
    inner = ring[1:] == ring[:-1]
    edges = _split(vertices, np.stack([index[:-1][inner], index[1:][inner]], axis=1), tolerance)
    return Boundary(vertices, edges, _sector_ends(vertices, edges))


def _split(
    vertices: Float[np.ndarray, "vertices 2"], edges: Int[np.ndarray, "edges 2"], tolerance: float
) -> Int[np.ndarray, "pieces 2"]:
    """Edges cut at the vertices that lie on them."""
    lines: Any = shapely.linestrings(vertices[edges])
    vertex, edge = shapely.STRtree(lines).query(shapely.points(vertices), predicate="dwithin", distance=tolerance)
    apart = (edges[edge] != vertex[:, None]).all(axis=1)
    vertex, edge = vertex[apart], edge[apart]
    along = np.linalg.norm(vertices[vertex] - vertices[edges[edge, 0]], axis=1)
    owner = np.concatenate([np.arange(len(edges)), edge])
    start = np.concatenate([edges[:, 0], vertex])
    order = np.lexsort((np.concatenate([np.zeros(len(edges)), along]), owner))
    owner, start = owner[order], start[order]
    last = np.append(owner[1:] != owner[:-1], True)
    return np.stack([start, np.where(last, edges[owner, 1], np.roll(start, -1))], axis=1)


def _sector_ends(
    vertices: Float[np.ndarray, "vertices 2"], edges: Int[np.ndarray, "edges 2"]
) -> Int[np.ndarray, "edges"]:
    """For each edge, the start of the arriving edge that comes first counterclockwise at its first vertex."""
    at = np.concatenate([edges[:, 0], edges[:, 1]])
    other = np.concatenate([edges[:, 1], edges[:, 0]])
    direction = vertices[other] - vertices[at]
    order = np.lexsort((pseudo_angle(direction[:, 0], direction[:, 1]), at))
    # Around a vertex leaving and arriving edges alternate, so a leaving one is closed by its successor.
    rank = np.arange(len(order))
    first = np.searchsorted(at[order], at[order], side="left")
    count = np.searchsorted(at[order], at[order], side="right") - first
    successor = order[first + (rank - first + 1) % count]
    ends = np.empty(len(order), dtype=np.intp)
    ends[order] = other[successor]
    return ends[: len(edges)]


def arc(
    center: Float[np.ndarray, "2"],
    start: Float[np.ndarray, "2"],
    end: Float[np.ndarray, "2"],
    num_segments: int,
) -> Float[np.ndarray, "points 2"]:
    """Points on the circle about ``center`` from offset ``start`` counterclockwise to offset ``end``.

    Args:
        center: Center of the circle.
        start: Offset of the first point.
        end: Offset of the last point, of the same length.
        num_segments: Chords a quarter turn.

    Returns:
        The chords' ends, the first and last exactly ``center + start`` and ``center + end``.
    """
    turn = np.arctan2(cross(start, end), start @ end) % (2 * np.pi)
    angle = np.linspace(0.0, turn, 1 + max(1, int(np.ceil(num_segments * turn / (np.pi / 2) - 1e-9))))
    points = np.cos(angle)[:, None] * start + np.sin(angle)[:, None] * np.array([-start[1], start[0]])
    points[-1] = end
    return center + points
