"""Buildings for tests: an independent search by Shapely and NetworkX, and random buildings."""

from dataclasses import dataclass, field
from typing import Any

import networkx
import numpy as np
import shapely

from plr_jax import Building, Link, Workspace

ALLOWED = 1e-9  # of a building's size: errors of distances up to this are rounding
_SHARE = 1e-11  # of a floor's size: how far segments may leave free space
_NEAR = 8  # times this distance, a segment counts as touching a contact


@dataclass(frozen=True, eq=False)
class Contact:
    """A point where obstacles touch, and the sectors of free space around it, between which no path passes."""

    point: np.ndarray
    sectors: list[Any]
    radius: float  # sectors are wedges up to at least this distance from the point

    @classmethod
    def of(cls, point: np.ndarray, free: Any, edges: Any, tolerance: float) -> "Contact":
        distance = shapely.distance(edges, shapely.Point(point))
        radius = distance[distance > tolerance].min() / 4
        parts = shapely.get_parts(shapely.intersection(free, shapely.box(*(point - radius), *(point + radius))))
        sectors = parts[shapely.dwithin(parts, shapely.Point(point), tolerance)]
        return cls(point, [sector.buffer(radius / 1e4, join_style="mitre") for sector in sectors], radius)

    def looks(self, towards: np.ndarray) -> set[int]:
        """Return the sectors that hold the direction to another point."""
        along = (towards - self.point) / np.linalg.norm(towards - self.point)
        probe = shapely.Point(self.point + self.radius / 2 * along)
        return {i for i, sector in enumerate(self.sectors) if sector.intersects(probe)}


@dataclass(frozen=True, eq=False)
class Nodes:
    """Points of a floor, each of which has a copy for each sector if it is a contact."""

    points: np.ndarray
    sector: np.ndarray  # 0 unless the point is a contact
    owner: np.ndarray  # the point of which each node is a copy

    def __getitem__(self, rows: Any) -> "Nodes":
        return Nodes(self.points[rows], self.sector[rows], self.owner[rows])


class FloorSight:
    """Free space of a floor: which points are free, and which points see each other."""

    def __init__(self, free: Any, squeeze: bool):
        lo, hi = np.reshape(free.bounds, (2, 2))
        self.origin = lo
        self.free = free = shapely.transform(free, lambda x: x - lo)  # exact arithmetic near 0
        self.tolerance = _SHARE * float((hi - lo).max()) + 4 * float(np.spacing(np.abs([lo, hi]).max()))
        self.grown = free.buffer(self.tolerance, join_style="mitre")
        self.vertices = np.unique(shapely.get_coordinates(free), axis=0)
        shapely.prepare(self.grown)
        rings = map(shapely.get_coordinates, shapely.get_rings(shapely.get_parts(free)))
        edges: Any = np.concatenate([shapely.linestrings(np.stack([r[:-1], r[1:]], axis=1)) for r in rings])
        number = np.zeros(len(self.vertices), int)
        at, _ = shapely.STRtree(edges).query(shapely.points(self.vertices), "dwithin", distance=self.tolerance)
        np.add.at(number, at, 1)
        # More than the two edges of one corner meet at a contact.
        touched = [] if squeeze else self.vertices[number > 2]
        self.contacts = [Contact.of(point, free, edges, self.tolerance) for point in touched]

    def is_free(self, x: np.ndarray) -> np.ndarray:
        return shapely.intersects_xy(self.grown, *x.T)

    def holds(self, path: np.ndarray, near: float) -> bool:
        """Return whether a path, in coordinates of the floor, is nowhere farther than ``near`` from free space."""
        path = path - self.origin
        line: Any = shapely.linestrings(path if len(path) > 1 else np.repeat(path, 2, axis=0))
        return bool(shapely.covers(self.free.buffer(near), line))

    def nodes(self, x: np.ndarray) -> Nodes:
        copies = np.ones(len(x), int)
        for contact in self.contacts:
            copies[self._is_at(contact, x)] = len(contact.sectors)
        owner = np.repeat(np.arange(len(x)), copies)
        return Nodes(x[owner], np.arange(len(owner)) - np.searchsorted(owner, owner), owner)

    def sees(self, a: Nodes, b: Nodes) -> np.ndarray:
        """Return whether the segments between nodes lie in free space, and in one sector at each contact."""
        lines: Any = shapely.linestrings(np.stack([a.points, b.points], axis=1))
        is_clear = shapely.covers(self.grown, lines)
        for contact in self.contacts:
            near = np.flatnonzero(is_clear & shapely.dwithin(lines, shapely.Point(contact.point), self._near))
            starts, ends = self._is_at(contact, a.points[near]), self._is_at(contact, b.points[near])
            for i, is_start, is_end in zip(near, starts, ends, strict=True):
                first = {a.sector[i]} if is_start else contact.looks(a.points[i])
                last = {b.sector[i]} if is_end else contact.looks(b.points[i])
                is_clear[i] = bool(first & last)
        return is_clear

    @property
    def _near(self) -> float:
        return _NEAR * self.tolerance

    def _is_at(self, contact: Contact, x: np.ndarray) -> np.ndarray:
        return np.linalg.norm(x - contact.point, axis=1) <= self._near


class BruteForce:
    """Distances in a building by Dijkstra's algorithm over all vertices of all floors and all ends of links.

    The search uses only the polygons of free space and the links; all else is Shapely and NetworkX.
    """

    def __init__(self, building: Building):
        self.links, squeeze = building.links, building.floors[0].squeeze
        self.allowed = ALLOWED * size_of(building)
        self.floors = [FloorSight(floor.free_space, squeeze) for floor in building.floors]
        self.nodes: list[Nodes] = []
        self.walks, ends = networkx.DiGraph(), [place for link in self.links for place in (link.start, link.end)]
        for k, floor in enumerate(self.floors):
            places = np.reshape([point for at, point in ends if at == k], (-1, 2)) - floor.origin
            nodes = floor.nodes(np.unique(np.concatenate([floor.vertices, places]), axis=0))
            self.nodes.append(nodes)
            self.walks.add_nodes_from((k, i) for i in range(len(nodes.points)))
            a, b = np.triu_indices(len(nodes.points), 1)
            a, b = np.stack([a, b])[:, floor.sees(nodes[a], nodes[b])]
            length = np.linalg.norm(nodes.points[a] - nodes.points[b], axis=1)
            for i, j, cost in zip(a.tolist(), b.tolist(), length.tolist(), strict=True):
                self.walks.add_edge((k, i), (k, j), weight=cost)
                self.walks.add_edge((k, j), (k, i), weight=cost)
        # Paths are searched from the goal, so links lead from their end to their start.
        self.backward = self.walks.copy()
        for number, link in enumerate(self.links):
            for start, end in self.ways(number):
                self._add(end, start, link.cost)

    def _add(self, tail: tuple, head: tuple, cost: float) -> None:
        for i in self._at(*tail):
            for j in self._at(*head):
                known = self.backward.get_edge_data(i, j, {"weight": np.inf})["weight"]
                self.backward.add_edge(i, j, weight=min(cost, known))

    def _at(self, floor: int, point: Any) -> list[tuple[int, int]]:
        here = (self.nodes[floor].points == np.asarray(point) - self.floors[floor].origin).all(axis=1)
        return [(floor, int(i)) for i in np.flatnonzero(here)]

    def field(self, goals: Any, offsets: Any = None, use_links: bool = True) -> "Field":
        """Return the distance to the nearest goal; offsets are the costs of using each goal."""
        graph, goal_nodes = self.backward if use_links else self.walks, {}
        offsets = np.zeros(len(goals)) if offsets is None else np.asarray(offsets, float)
        graph.add_node("goal")
        for k, floor in enumerate(self.floors):
            index = [i for i, (at, _) in enumerate(goals) if at == k]
            places = np.reshape([goals[i][1] for i in index], (-1, 2)) - floor.origin
            goal_nodes[k] = floor.nodes(places), offsets[index]
            for i, offset in enumerate(offsets[index]):
                ends = floor.nodes(places[i : i + 1])
                for j in range(len(ends.points)):
                    end = ends[np.full(len(self.nodes[k].points), j)]
                    seen = np.flatnonzero(floor.sees(end, self.nodes[k]))
                    length = np.linalg.norm(self.nodes[k].points[seen] - places[i], axis=1) + offset
                    for node, cost in zip(seen.tolist(), length.tolist(), strict=True):
                        known = graph.get_edge_data("goal", (k, node), {"weight": np.inf})["weight"]
                        graph.add_edge("goal", (k, node), weight=min(cost, known))
        reached = networkx.single_source_dijkstra_path_length(graph, "goal")
        graph.remove_node("goal")
        distances = [
            np.array([reached.get((k, i), np.inf) for i in range(len(nodes.points))])
            for k, nodes in enumerate(self.nodes)
        ]
        return Field(self, distances, goal_nodes)

    def ways(self, number: int) -> list[tuple]:
        """Return the start and the end of a link in each direction in which it can be taken."""
        link = self.links[number]
        return [(link.start, link.end), (link.end, link.start)][: 1 + link.both_ways]

    def is_contact(self, floor: int, point: Any) -> bool:
        """Return whether obstacles touch at a point, and no path passes there between them."""
        sight = self.floors[floor]
        return len(sight.nodes(np.reshape(point, (1, 2)) - sight.origin).owner) > 1

    def distances(self, floor: int, x: Any, goals: Any) -> np.ndarray:
        return self.field(goals)(floor, x)

    def distance(self, start: Any, goal: Any) -> float:
        """Return the distance between two pairs ``(floor, point)``."""
        return float(self.distances(start[0], [start[1]], [goal])[0])


@dataclass(frozen=True, eq=False)
class Field:
    """Distances from all points of a building to the nearest of several goals."""

    search: BruteForce = field(repr=False)
    of_nodes: list[np.ndarray]
    goals: dict[int, tuple[Nodes, np.ndarray]]

    def __call__(self, floor: int, x: Any) -> np.ndarray:
        """Return the distances ``(n,)`` of points ``(n, 2)`` of a floor."""
        sight, nodes, (goals, offsets) = self.search.floors[floor], self.search.nodes[floor], self.goals[floor]
        x = np.reshape(np.asarray(x, float), (-1, 2)) - sight.origin
        free = np.flatnonzero(np.isfinite(x).all(axis=1) & sight.is_free(x))
        starts = sight.nodes(x[free])
        ways = Nodes(*(np.concatenate(each) for each in zip(*map(_columns, (goals, nodes)), strict=True)))
        onward = np.concatenate([offsets[goals.owner], self.of_nodes[floor]])
        lengths = np.linalg.norm(starts.points[:, None] - ways.points, axis=2) + onward
        order, shortest = np.argsort(lengths, axis=1), np.full(len(x), np.inf)
        # Try the ways of each point from the shortest to the longest, until the point sees the next node.
        pending = np.arange(len(starts.points))
        for column in range(len(onward)):
            way = order[pending, column]
            is_open = np.isfinite(lengths[pending, way])
            pending, way = pending[is_open], way[is_open]
            if not len(pending):
                break
            sees = sight.sees(starts[pending], ways[way])
            done = pending[sees]
            np.minimum.at(shortest, free[starts.owner[done]], lengths[done, way[sees]])
            pending = pending[~sees]
        return shortest


def _columns(nodes: Nodes) -> tuple[np.ndarray, ...]:
    return nodes.points, nodes.sector, nodes.owner


# Random buildings.

_UNIT = 0.01
_ORIGINS = 0, 0, 1, 100, 1e4, 1e6


def _split(rng: np.random.Generator, lo: np.ndarray, hi: np.ndarray, wall: int, depth: int) -> list[np.ndarray]:
    """Return walls, as boxes of whole numbers, that divide a box into rooms; most walls have doors."""
    axis = int((hi - lo).argmax())
    if depth == 0 or (hi - lo)[axis] < 8 * wall + 8:
        return []
    at = int(rng.integers(lo[axis] + 2 * wall + 2, hi[axis] - 3 * wall - 2))
    a, b = lo.copy(), hi.copy()
    a[axis], b[axis] = at, at + wall
    boxes, other = [np.stack([a, b])], 1 - axis
    if rng.random() < 0.85 and (hi - lo)[other] > 4:
        door = int(rng.integers(1, max(2, (hi - lo)[other] // 3)))
        start = int(rng.integers(lo[other], hi[other] - door + 1))  # sometimes beside a wall
        first, second = np.stack([a, b]), np.stack([a, b])
        first[1, other], second[0, other] = start, start + door
        boxes = [box for box in (first, second) if (box[0] < box[1]).all()]
    below, above = hi.copy(), lo.copy()
    below[axis], above[axis] = at, at + wall
    return boxes + _split(rng, lo, below, wall, depth - 1) + _split(rng, above, hi, wall, depth - 1)


def random_floor(rng: np.random.Generator, squeeze: bool, origins: Any = _ORIGINS) -> Workspace:
    """Return rooms with doors and pillars, some of which touch a wall or one another; some rooms are closed."""
    sides = np.round(10 ** rng.uniform(2, 4) * rng.uniform(0.5, 1, 2)).astype(int)  # in units: 1 m to 100 m
    wall = max(1, int(sides.max() * rng.choice([0.002, 0.02, 0.05])))
    boxes = _split(rng, np.zeros(2, int), sides, wall, int(rng.integers(0, 4)))
    for _ in range(rng.integers(0, 6)):
        size = np.maximum(1, (sides * rng.uniform(0.01, 0.2, 2)).astype(int))
        corner = rng.integers(0, np.maximum(1, sides - size))
        if boxes and rng.random() < 0.4:  # touch another box along a part of a side, or in a corner
            other = boxes[rng.integers(len(boxes))]
            axis, is_corner = rng.integers(2), rng.random() < 0.5
            corner[axis] = other[1, axis]
            corner[1 - axis] = other[1 if is_corner else 0, 1 - axis]
        boxes.append(np.stack([corner, corner + size]))
    origin = np.round(rng.choice(origins) * rng.uniform(-1, 1, 2) / _UNIT) * _UNIT
    shapes: list[Any] = [shapely.box(*(box * _UNIT + origin).ravel()) for box in boxes]
    for _ in range(rng.integers(0, 3)):  # pillars with inclined sides
        turn = np.sort(rng.uniform(0, 2 * np.pi, rng.integers(3, 7)))
        ring = np.stack([np.cos(turn), np.sin(turn)], axis=1) * sides * rng.uniform(0.02, 0.2)
        ring = np.round(ring + rng.uniform(0, 1, 2) * sides)
        if shapely.Polygon(ring).is_valid and shapely.Polygon(ring).area > 1:
            shapes.append(shapely.Polygon(ring * _UNIT + origin))
    return Workspace((origin, origin + sides * _UNIT), shapes, squeeze=squeeze)


def random_place(rng: np.random.Generator, floors: list[Workspace], known: list[tuple]) -> tuple:
    """Return a floor and a free point: anywhere, at a corner, on a wall, or at a place that is known."""
    kind, k = rng.random(), int(rng.integers(len(floors)))
    if known and kind < 0.25:
        return known[rng.integers(len(known))]
    boundary = floors[k].boundary
    contacts = boundary.vertices[boundary.contacts]
    edge = boundary.vertices[boundary.edges[rng.integers(len(boundary.edges))]]
    if kind < 0.35 and len(contacts):
        point = contacts[rng.integers(len(contacts))]
    elif kind < 0.45:
        point = edge[0]
    elif kind < 0.6:
        point = edge[0] + rng.random() * (edge[1] - edge[0])
    else:
        point = floors[k].sample_free(1, int(rng.integers(2**31)))[0]
    return k, tuple(point.tolist())


def random_building(seed: int) -> Building:
    """Return up to 6 floors and up to 20 links: stairs, chains, one-way, free, double, and short cuts on a floor."""
    rng = np.random.default_rng(seed)
    squeeze = bool(rng.random() < 0.3)
    floors = [random_floor(rng, squeeze) for _ in range(rng.integers(1, 7))]
    largest = max(float(floor.bounds.width.max()) for floor in floors)
    linked = floors[: max(1, len(floors) - int(rng.integers(0, 2)))]  # sometimes, no link leads to the last floor
    links: list[Link] = []
    known: list[tuple] = []
    for _ in range(rng.integers(0, 21)):
        start, end = random_place(rng, linked, known), random_place(rng, linked, known)
        if links and rng.random() < 0.1:  # another link between the same places
            start, end = links[-1].start, links[-1].end
        cost = float(rng.choice([0.0, 0.0, *(largest * rng.uniform(0, 0.5, 5))]))
        links.append(Link(start, end, cost, both_ways=bool(rng.random() < 0.6)))
        known += [start, end]
    return Building(floors, links)


def random_goals(building: Building, seed: int, count: int = 1) -> list[tuple]:
    rng = np.random.default_rng(seed)
    known = [place for link in building.links for place in (link.start, link.end)]
    return [random_place(rng, list(building.floors), known) for _ in range(count)]


def points_of(building: Building, floor: int, seed: int, count: int) -> np.ndarray:
    """Return points of a floor: anywhere, also in obstacles and outside, at vertices, on walls, at ends of links."""
    rng, workspace = np.random.default_rng(seed), building.floors[floor]
    bounds, boundary = workspace.bounds, workspace.boundary
    ends = [point for link in building.links for at, point in (link.start, link.end) if at == floor]
    edges = boundary.vertices[boundary.edges]
    on_walls = edges[:, 0] + rng.random((len(edges), 1)) * (edges[:, 1] - edges[:, 0])
    special = rng.permutation(np.concatenate([boundary.vertices, on_walls, np.reshape(ends, (-1, 2))]))
    anywhere = rng.uniform(bounds.lo - bounds.width / 20, bounds.hi + bounds.width / 20, (count // 4, 2))
    free = workspace.sample_free(count - count // 4 - min(count // 4, len(special)), seed)
    return np.concatenate([free, special[: count // 4], anywhere])


def size_of(building: Building) -> float:
    """Return the width of the plane that holds all floors, or a share of the largest coordinate if that is more."""
    corners = np.concatenate([[floor.bounds.lo, floor.bounds.hi] for floor in building.floors])
    return max(float(building.plane.bounds.width.max()), 1e-3 * float(np.abs(corners).max()))
