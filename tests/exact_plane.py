"""Shortest paths among polygons by brute force, in exact arithmetic, independent of the package."""

from collections.abc import Callable, Iterable, Sequence
from fractions import Fraction
from functools import cmp_to_key
from typing import Any, TypeAlias

import numpy as np
import shapely
from scipy.sparse.csgraph import csgraph_from_dense, dijkstra

Point: TypeAlias = tuple[int, int, int]
"""A point ``(x / w, y / w)`` as integers ``(x, y, w)`` with ``w > 0``: floats are dyadic rationals."""
Vector: TypeAlias = tuple[int, int]
Sector: TypeAlias = tuple[Vector, Vector] | None
"""Directions at which a closed sector opens and closes, counterclockwise; None: all directions."""

_SURE = 1e-13  # float orientations have the right sign above this share of the largest coordinate squared


def as_exact(point: Sequence[Any]) -> Point:
    x, y = (Fraction(each.item() if isinstance(each, np.generic) else each) for each in point)
    w = x.denominator * y.denominator
    return x.numerator * y.denominator, y.numerator * x.denominator, w


def as_floats(points: Iterable[Point]) -> np.ndarray:
    return np.array([[x / w, y / w] for x, y, w in points]).reshape(-1, 2)


def _cross(u: Vector, v: Vector) -> int:
    return u[0] * v[1] - u[1] * v[0]


def _direction(p: Point, q: Point) -> Vector:
    """Return a positive multiple of the vector from ``p`` to ``q``."""
    return q[0] * p[2] - p[0] * q[2], q[1] * p[2] - p[1] * q[2]


def _side(p: Point, q: Point, r: Point) -> int:
    """Return 1 if ``r`` is on the left of the line from ``p`` to ``q``, -1 on the right, 0 on the line."""
    cross = _cross(_direction(p, q), _direction(p, r))
    return (cross > 0) - (cross < 0)


def _is_between(p: Point, q: Point, r: Point) -> bool:
    """Return whether ``r``, on the line through ``p`` and ``q``, lies strictly between them."""
    u, v = _direction(r, p), _direction(r, q)
    return u[0] * v[0] + u[1] * v[1] < 0


def _is_in(sector: Sector, v: Vector) -> bool:
    if sector is None:
        return True
    opens, closes = sector
    turn = _cross(opens, closes)
    after, before = _cross(opens, v) >= 0, _cross(v, closes) >= 0
    return (after and before) if turn > 0 else (after or before) if turn < 0 else after


def _middle(u: Vector, v: Vector) -> Vector:
    """Return a direction between two directions, counterclockwise from the first."""
    turn = _cross(u, v)
    middle = (-u[1], u[0]) if turn == 0 else (u[0] + v[0], u[1] + v[1])
    return (-middle[0], -middle[1]) if turn < 0 else middle


def _compare(u: Vector, v: Vector) -> int:
    """Compare directions, counterclockwise from the positive x axis; negative if ``u`` comes first."""
    half = [w[1] < 0 or (w[1] == 0 and w[0] < 0) for w in (u, v)]
    return half[0] - half[1] or -_cross(u, v)


class ExactPlane:
    """A box with polygonal obstacles; everything outside the interior of their union is free.

    A path may slide along walls. It may end where obstacles touch in a point, but not pass between them. So the free
    space around each point is a set of sectors, a path leaves a point in the sector in which it arrives, and a path
    is a chain of (point, sector) pairs.

    Args:
        bounds: Corners ``((x0, y0), (x1, y1))``, or all edges of free space ``(edges, 2, 2)`` without obstacles.
        obstacles: Rings ``(n, 2)``, or Shapely polygons, holes allowed.
    """

    def __init__(self, bounds: Any, obstacles: Iterable[Any] = ()):
        if np.ndim(bounds) == 2:
            (x0, y0), (x1, y1) = bounds
            corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
            bounds = list(zip(corners, corners[1:] + corners[:1], strict=True))
        self.solids = [[(as_exact(a), as_exact(b)) for a, b in bounds]]  # edges of the box, then of each obstacle
        for shape in obstacles:
            polygon = shape if isinstance(shape, shapely.Geometry) else shapely.Polygon(shape)
            edges: list[tuple[Point, Point]] = []
            for part in shapely.get_parts(polygon):
                for ring in [part.exterior, *part.interiors]:
                    ends = [as_exact(point) for point in ring.coords[:-1]]
                    edges += [(a, b) for a, b in zip(ends, ends[1:] + ends[:1], strict=True) if a != b]
            self.solids.append(edges)
        self.edges = [edge for solid in self.solids for edge in solid]
        self._ends = as_floats(end for edge in self.edges for end in edge).reshape(-1, 2, 2)
        self._sure = _SURE * np.abs(self._ends).max() ** 2
        self.vertices = list(dict.fromkeys(a for a, _ in self.edges))
        self.sectors = {vertex: self.sectors_at(vertex) for vertex in self.vertices}
        self._links = self._links_between(self.vertices, self.vertices)

    def _is_solid(self, x: Point) -> bool:
        """Return whether a point on no edge is in an obstacle or outside the box."""
        inside = []
        for edges in self.solids:
            crossings = 0
            for a, b in edges:
                above = [end[1] * x[2] > x[1] * end[2] for end in (a, b)]
                crossings += above[0] != above[1] and (_side(a, b, x) > 0) == above[1]
            inside.append(crossings % 2 == 1)
        return not inside[0] or any(inside[1:])

    def sectors_at(self, x: Point) -> list[Sector]:
        """Return the free sectors around a point; none in an obstacle or outside the box."""
        rays: list[Vector] = []
        side = self._sides(self._ends[:, 0], self._ends[:, 1], as_floats([x]), lambda e: (*self.edges[e], x))
        for a, b in (self.edges[e] for e in np.flatnonzero(side == 0)):
            if x in (a, b) or _is_between(a, b, x):
                rays += [_direction(x, end) for end in (a, b) if end != x]
        rays.sort(key=cmp_to_key(_compare))
        rays = [ray for i, ray in enumerate(rays) if i == 0 or _compare(rays[i - 1], ray) != 0]
        if not rays:
            return [] if self._is_solid(x) else [None]
        turns = zip(rays, rays[1:] + rays[:1], strict=True)
        return [(u, v) for u, v in turns if not self._is_solid(self._just_beside(x, _middle(u, v)))]

    def _just_beside(self, x: Point, d: Any) -> Point:
        """Return a point in a direction from ``x``, before the first edge there."""
        nearest = Fraction(1)
        for a, b in self.edges:
            u, v = _direction(x, a), _direction(x, b)
            if (over := _cross(d, u) * b[2]) == (under := _cross(d, v) * a[2]):
                continue  # parallel
            share = Fraction(over, over - under)  # of the way from a to b
            if 0 <= share <= 1:
                px, py = (Fraction(a[k], a[2]) * (1 - share) + Fraction(b[k], b[2]) * share for k in (0, 1))
                along = px - Fraction(x[0], x[2]) if d[0] else py - Fraction(x[1], x[2])
                if (reach := along / (d[0] or d[1])) > 0:
                    nearest = min(nearest, reach)
        return as_exact([Fraction(x[k], x[2]) + d[k] * nearest / 2 for k in (0, 1)])

    def _sides(self, p: np.ndarray, q: np.ndarray, r: np.ndarray, exact: Callable[..., Any]) -> np.ndarray:
        """Return on which sides of lines from ``p`` to ``q`` points ``r`` lie; exact where floats may be wrong."""
        u, v = q - p, r - p
        cross = u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]
        side = np.sign(cross).astype(int)
        for at in np.argwhere(np.abs(cross) <= self._sure).tolist():
            side[tuple(at)] = _side(*exact(*at))
        return side

    def _links_between(self, sources: list[Point], targets: list[Point]) -> list[tuple[Any, Any, float]]:
        """Return (point, sector) pairs that a segment in free space joins, and its length."""
        pairs = [(p, q) for p in sources for q in targets if p != q and self.sectors[p] and self.sectors[q]]
        ends, (a, b), links = as_floats(end for pair in pairs for end in pair), self._ends.transpose(1, 0, 2), []
        first, last = ends[::2, None], ends[1::2, None]
        side_a = self._sides(first, last, a, lambda i, e: (*pairs[i], self.edges[e][0]))
        side_b = self._sides(first, last, b, lambda i, e: (*pairs[i], self.edges[e][1]))
        for (p, q), x, y, of_a, of_b in zip(pairs, ends[::2], ends[1::2], side_a, side_b, strict=True):
            some = np.flatnonzero(of_a * of_b < 0)
            of_p = self._sides(a[some], b[some], x, lambda k, r=p, some=some: (*self.edges[some[k]], r))
            of_q = self._sides(a[some], b[some], y, lambda k, r=q, some=some: (*self.edges[some[k]], r))
            if (of_p * of_q < 0).any():
                continue  # an edge that is crossed is solid on one side
            on_line = {self.edges[e][0] for e in np.flatnonzero(of_a == 0)} - {p, q}
            u, v = _direction(p, q), _direction(q, p)
            touched = [self.sectors[x] for x in on_line if _is_between(p, q, x)]
            if all(any(_is_in(sector, u) and _is_in(sector, v) for sector in free) for free in touched):
                leaves = [(p, i) for i, sector in enumerate(self.sectors[p]) if _is_in(sector, u)]
                arrives = [(q, i) for i, sector in enumerate(self.sectors[q]) if _is_in(sector, v)]
                links += [(one, other, float(np.hypot(*(y - x)))) for one in leaves for other in arrives]
        return links

    def sees(self, a: Sequence[Any], b: Sequence[Any]) -> bool:
        """Return whether the segment between two points is free and does not pass between touching obstacles."""
        p, q = self._placed([a, b])
        return bool(self.sectors[p]) if p == q else bool(self._links_between([p], [q]))

    def joins(self, a: Any, b: Any, radius: float) -> bool:
        """Return whether a free path, with all vertices within a radius of their segment, joins two points."""
        p, q = self._placed([a, b])
        start, end = as_floats([p, q])
        segment: Any = shapely.linestrings(np.stack([start, end]))
        near = shapely.dwithin(segment, shapely.points(as_floats(self.vertices)), radius)
        points = [p, q, *(vertex for vertex, is_near in zip(self.vertices, near, strict=True) if is_near)]
        reached, pending = set(), [(p, i) for i in range(len(self.sectors[p]))]
        links = self._links_between(points, points)
        while pending:
            reached.add(node := pending.pop())
            pending += [other for one, other, _ in links if one == node and other not in reached]
        return any(point == q for point, _ in reached)

    def distances(self, source: Sequence[Any], points: Iterable[Sequence[Any]]) -> np.ndarray:
        """Return lengths of shortest paths from a point to others; ``inf`` if there is none."""
        start, *ends = self._placed([source, *points])
        others = [x for x in dict.fromkeys(ends) if x not in self.vertices]
        links = self._links + self._links_between([start], [*self.vertices, *others])
        links += self._links_between(others, self.vertices)
        # A path may begin in any sector of its start.
        links += [(None, (start, i), 0.0) for i in range(len(self.sectors[start]))]
        number = {node: i for i, node in enumerate(dict.fromkeys(node for link in links for node in link[:2]))}
        graph = np.full((len(number), len(number)), np.inf)
        for one, other, length in links:
            graph[number[one], number[other]] = length
        if None not in number:
            return np.full(len(ends), np.inf)
        length = dijkstra(csgraph_from_dense(graph, null_value=np.inf), directed=False, indices=number[None])
        reached = [[length[number[x, i]] for i in range(len(self.sectors[x])) if (x, i) in number] for x in ends]
        return np.array([min(each, default=np.inf) for each in reached])

    def near(self, x: Any, radius: float, *, in_sectors: bool = False) -> list[tuple[Fraction, ...]]:
        """Return the ends and nearest points of walls within a radius, which may lie across a wall or contact.

        ``in_sectors`` adds a point inside each sector of a contact, which may be far from the other sectors.
        """
        x, found = as_exact(x), []
        place = as_floats([x])[0]
        for (a, b), (start, end) in zip(self.edges, self._ends, strict=True):
            share = np.clip((place - start) @ (end - start) / ((end - start) @ (end - start)), 0, 1)
            if np.hypot(*(start + share * (end - start) - place)) <= radius:
                ends = [[Fraction(end[k], end[2]) for k in (0, 1)] for end in (a, b)]
                beside = np.hypot(*(np.stack([start, end]) - place).T) <= radius
                shares = {Fraction(float(share)), *(Fraction(i) for i in np.flatnonzero(beside).tolist())}
                found += [tuple(p + s * (q - p) for p, q in zip(*ends, strict=True)) for s in shares]
        for at in {as_exact(each) for each in found if in_sectors}:
            sectors = self.sectors_at(at)
            for sector in sectors if len(sectors) > 1 else ():
                middle = _middle(*sector)
                scale = Fraction(radius / 2 / float(np.hypot(float(middle[0]), float(middle[1]))))
                inside = self._just_beside(at, (middle[0] * scale, middle[1] * scale))
                found.append((Fraction(inside[0], inside[2]), Fraction(inside[1], inside[2])))
        return found

    def _placed(self, points: Iterable[Sequence[Any]]) -> list[Point]:
        """Return exact points, and store their sectors."""
        exact = [as_exact(point) for point in points]
        self.sectors |= {x: self.sectors_at(x) for x in exact if x not in self.sectors}
        return exact
