"""The file of a PairPLR: its contents, and their layout, which ``FORMAT.md`` describes."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import comb
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from plr_jax.geometry.box import Box
from plr_jax.geometry.graph import NO_ARCS, Arcs, Graph
from plr_jax.geometry.vectors import left_normal, orientation, pseudo_angle
from plr_jax.plr.coding import BitReader, BitWriter, read_tree, write_tree
from plr_jax.plr.container import PAIRS_CODE, Container, Header, Layer
from plr_jax.plr.tree import Cells, Tree

MITRE = 4.0  # most that a point moves if walls move by 1; tips may move farther, and added walls then close the gap
_COUNT_BITS = 32  # of the number of rings in a file
_WALLS_AT_ONCE = 2**5  # walls whose crossings are searched together
Vectors = Int[np.ndarray, "points 2"]


@dataclass(frozen=True, eq=False)
class Outline:
    """The boundary of free space: closed rings of lattice points, joined by walls with free space on their left.

    Wall ``i`` leads from point ``i`` to the next point of its ring, ``following[i]``. Walls without length are
    allowed.
    """

    origin: Float[np.ndarray, "2"]  # position of the lattice point (0, 0)
    step: float
    points: Int[np.ndarray, "points 2"]  # in lattice steps
    first: Int[np.ndarray, " rings_plus_one"]  # index of the first point of each ring
    may_squeeze: bool  # whether a path may pass contacts, points where obstacles touch
    # Whether each wall may leave its obstacle when it moves back. Lower bounds ignore such walls.
    is_thin: Bool[np.ndarray, " points"]

    @cached_property
    def positions(self) -> Float[np.ndarray, "points 2"]:
        """The positions of all points, in workspace units."""
        return self.origin + self.step * self.points

    @cached_property
    def following(self) -> Int[np.ndarray, " points"]:
        """Index of the point that follows each point in its ring."""
        following = np.arange(1, len(self.points) + 1)
        following[self.first[1:] - 1] = self.first[:-1]
        return following

    @cached_property
    def is_contact(self) -> Bool[np.ndarray, " points"]:
        """Mask of the outline points where obstacles touch and no path may pass between them."""
        return self.is_shared & (not self.may_squeeze)

    @cached_property
    def is_shared(self) -> Bool[np.ndarray, " points"]:
        """Mask of the outline points where more than one wall begins, because obstacles touch."""
        _, index = np.unique(self.points, axis=0, return_inverse=True)
        return np.bincount(index.ravel(), self._has_length)[index.ravel()] > 1

    @cached_property
    def _has_length(self) -> Bool[np.ndarray, " walls"]:
        return (self.points[self.following] != self.points).any(axis=1)

    @cached_property
    def following_past_contacts(self) -> Int[np.ndarray, " points"]:
        """Index of the point that follows each point on the boundary of its obstacle.

        It differs from ``following``, the order around free space, only at contacts (points where obstacles touch and
        no path may pass).
        """
        # A ring follows free space. At a contact P it goes on with the next wall clockwise, across free space; an
        # obstacle's outline goes on with the next wall counterclockwise, across the obstacle:
        #
        #            free            Counterclockwise around P come a wall that leaves (a'), free space, the wall of
        #       a  \     / a'        its ring that arrives (a), an obstacle, the next wall that leaves (b'), free
        #    obstacle P obstacle     space, the wall that arrives (b), an obstacle.
        #       b' /     \ b         Rings go from a to a' and from b to b'; obstacles, from a to b' and from b to a'.
        #            free
        following = self.following.copy()
        contact = np.flatnonzero(self.is_contact & self._has_length)
        previous = np.argsort(following)[contact]
        leaving = (self.points[following] - self.points)[contact].astype(float)
        # Sort the walls that leave by place, then by angle. After each of them, take the next one of its place,
        # cyclically: `first` is the index in this order of the first wall of the same place.
        _, place = np.unique(self.points[contact], axis=0, return_inverse=True)
        order = np.lexsort((pseudo_angle(*leaving.T), place.ravel()))
        first = np.searchsorted(place.ravel()[order], place.ravel()[order])
        is_last = np.append(np.diff(first) > 0, True)[: len(contact)]
        following[previous[order]] = contact[order[np.where(is_last, first, np.arange(len(contact)) + 1)]]
        return following

    def _beside(self, following: Int[np.ndarray, " points"]) -> tuple[Vectors, Vectors]:
        """Return the wall that arrives at each point and the wall that leaves the point, as vectors.

        ``following`` is the index of the next point. In place of a wall without length, the result has the next wall
        beyond it.
        """
        leaving = self.points[following] - self.points
        previous = np.argsort(following)
        arriving = leaving[previous]
        # Let a wall without length take over the vector of the wall behind it, which may itself have just done so.
        for walls, beyond in ((leaving, following), (arriving, previous)):
            while len(flat := np.flatnonzero(~walls.any(axis=1) & walls[beyond].any(axis=1))):
                walls[flat] = walls[beyond[flat]]
        return arriving, leaving

    @cached_property
    def is_reflex(self) -> Bool[np.ndarray, " points"]:
        """Mask of the outline points at which an obstacle sticks out into free space."""
        arriving, leaving = (walls.T.astype(float) for walls in self._beside(self.following))
        return orientation(*arriving, *leaving) < 0

    def contains(self, x: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, " n"]:
        import shapely  # loading a file does not need it

        shapely.prepare(self.region)
        return shapely.intersects_xy(self.region, *x.T)

    @cached_property
    def region(self) -> Any:
        """Free space as a Shapely geometry, by the even-odd rule, so that rings may touch and cross.

        ``ValueError`` if walls cross one another too often, as in a corrupt file.
        """
        import shapely

        # 1. Count the crossings of walls, and the walls that meet at points. Give up if they are more than two or
        #    three times as many as the walls.
        ends = self.moved_walls(0.0).reshape(-1, 2, 2)
        lines: Any = shapely.linestrings(ends)
        tree: Any = shapely.STRtree(lines)
        points: Any = shapely.points(np.unique(ends.reshape(-1, 2), axis=0))
        for shapes, predicate, most in ((lines, "crosses", 2 * len(lines)), (points, "intersects", 3 * len(lines))):
            meetings = 0
            for begin in range(0, len(shapes), _WALLS_AT_ONCE):
                meetings += tree.query(shapes[begin : begin + _WALLS_AT_ONCE], predicate=predicate).shape[1]
                if meetings > most:
                    raise ValueError(f"the {len(lines):,} walls of its outline cross one another too often")
        # 2. Divide the plane by the walls into polygons.
        pieces: Any = shapely.get_parts(shapely.union_all(lines))
        polygons: Any = shapely.get_parts(shapely.polygonize(pieces))
        # 3. Keep polygons that are free: an odd number of walls a-b crosses the ray to the left from a point p
        #    inside. A wall does if a and b are on two sides of the ray's line, which the wall meets at x < px.
        px, py = shapely.get_coordinates(shapely.point_on_surface(polygons)).T[:, :, None]
        (ax, ay), (bx, by) = ends.transpose(1, 2, 0)
        with np.errstate(divide="ignore", invalid="ignore"):
            is_crossed = (ay > py) != (by > py)
            is_crossed &= ax + (py - ay) / (by - ay) * (bx - ax) < px
        return shapely.union_all(polygons[is_crossed.sum(axis=1) % 2 == 1])

    def moved_walls(self, distance: float, *, moves_all: bool = False) -> Float[np.ndarray, "walls 4"]:
        """Return the walls, rows ``(x0, y0, x1, y1)``, moved by ``distance`` into the obstacles behind them.

        A negative distance moves all walls into free space, by less beside sharp corners. A positive distance moves
        walls of thin obstacles only if ``moves_all``. If it is positive and ``moves_all`` is false, the result ends
        with added walls, which close the gaps that open at contacts and sharp tips.
        """
        # Into obstacles, a contact moves to one place in each obstacle, and a sharp tip moves far. So that no path
        # slips through, two walls of opposite directions join the new place to the old place of a contact, or to a
        # point near the old tip:
        #
        #     ----____
        #     --__    ----____           tip: the old place of a sharp tip
        #         m======s    > tip      m:   its new place, where the moved walls meet
        #     --''    ____----           s:   `MITRE * distance` behind the old tip; the added walls are m-s and s-m
        #     ----''''
        following = self.following if distance <= 0 else self.following_past_contacts
        moved = self.positions - distance * self._moves(distance, moves_all)
        walls = np.concatenate([moved, moved[following]], axis=1)
        if distance <= 0 or moves_all:
            return walls
        back = self.positions - moved
        far = np.linalg.norm(back, axis=1)
        gap = np.where(self.is_contact, 0.0, MITRE * distance)  # between the old place and s
        tips = np.flatnonzero(far > gap)
        start = self.positions[tips] - (gap[tips] / far[tips])[:, None] * back[tips]
        return np.concatenate([walls, np.hstack([start, moved[tips]]), np.hstack([moved[tips], start])])

    def around_thin_walls(self, distance: float) -> Float[np.ndarray, "walls 4"]:
        """Return the sides of rectangles around walls of thin obstacles, ``distance`` away from the wall.

        Sides are rows ``(x0, y0, x1, y1)``, clockwise around the wall, so that free space is on their left.
        """
        #     0-----------------1
        #     |  start---->end  |      corners, `aside` from the wall's line, `along` beyond its ends
        #     3-----------------2
        start, end = self.positions[self.is_thin], self.positions[self.following[self.is_thin]]
        has_length = (start != end).any(axis=1)
        start, end = start[has_length], end[has_length]
        aside = distance * left_normal(end - start)
        along = np.stack([aside[:, 1], -aside[:, 0]], axis=1)
        corners = [start - along + aside, end + along + aside, end + along - aside, start - along - aside]
        return np.concatenate([np.concatenate([corners[k], corners[(k + 1) % 4]], axis=1) for k in range(4)])

    def moved_points(self, distance: float) -> Float[np.ndarray, "points 2"]:
        """Return the positions of all points after the walls have moved by ``distance`` into obstacles.

        A negative distance moves walls into free space.
        """
        return self.positions - distance * self._moves(distance)

    def ends_sight(self, distance: float) -> Bool[np.ndarray, " points"]:
        """Mask of the points that block sight after walls have moved by ``distance`` into obstacles.

        Contacts (points where obstacles touch) block sight, and so do points that do not move.
        """
        return self.is_contact | (self._moves(distance) == 0).all(axis=1)

    def _moves(self, distance: float, moves_all: bool = False) -> Float[np.ndarray, "points 2"]:
        """Return a vector for each point: ``-distance`` times this vector moves the point along with its two walls.

        The walls then move by ``distance`` into obstacles, less at sharp corners. If ``distance`` is positive, two
        kinds of points have the vector 0 unless ``moves_all``: points between two walls of thin obstacles, and both
        ends of a wall that would change its direction, as at the end of a thin obstacle.
        """
        following = self.following if distance <= 0 else self.following_past_contacts
        onward = self.positions[following] - self.positions
        # 1. Move both walls of each point by 1: m = (n0 + n1) / (1 + n0 . n1) has m . n0 = m . n1 = 1, with the unit
        #    normals n0 of the wall that arrives and n1 of the wall that leaves. A wall without length has n = 0.
        before, normal = map(_normal_of, self._beside(following))
        mitre = (normal + before) / np.maximum(1 + (normal * before).sum(axis=1), 1e-12)[:, None]
        length = np.linalg.norm(mitre, axis=1, keepdims=True)
        # 2. Limit the length: into free space, to `MITRE`. Into obstacles, tips recede until their walls have moved
        #    by the distance, but at most along a quarter of the shorter wall, or by `MITRE` distances.
        if distance <= 0:
            return mitre * np.minimum(1, MITRE / np.maximum(length, 1e-12))
        previous = np.argsort(following)
        wall_length = np.linalg.norm(onward, axis=1)
        shorter = np.minimum(wall_length, wall_length[previous])[:, None]
        mitre *= np.minimum(1, np.maximum(MITRE, shorter / (4 * distance)) / np.maximum(length, 1e-12))
        if moves_all:
            return mitre
        # 3. Let points stay: first between thin walls, then at both ends of walls that would still be turned round.
        mitre[self.is_thin & self.is_thin[previous]] = 0.0
        moved_onward = onward - distance * (mitre[following] - mitre)
        turned = np.flatnonzero((onward * moved_onward).sum(axis=1) < 0)
        mitre[turned] = mitre[following[turned]] = 0.0
        return mitre

    def write(self, body: BitWriter) -> None:
        """Append the encoded outline to ``body``, except origin and thin walls, which the file has elsewhere."""
        body.write_doubles(np.array([self.step]))
        body.write(np.array([self.may_squeeze], np.int64), 1)
        sizes = np.diff(self.first)
        body.write(np.array([len(sizes)]), _COUNT_BITS).write_coded(sizes)
        for along in self.points.T:
            body.write_signed(np.diff(along, prepend=0))


def _normal_of(walls: Int[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
    """Return the unit normals on the left of walls, 0 for a wall without length."""
    is_wall = walls.any(axis=1, keepdims=True)
    return np.where(is_wall, left_normal(np.where(is_wall, walls, 1.0)), 0.0)


def read_outline(body: BitReader, origin: Float[np.ndarray, "2"]) -> Outline:
    """Decode an outline that :meth:`Outline.write` encoded; ``ValueError`` if the data are invalid.

    ``origin`` is the position of the lattice point (0, 0).
    """
    step = body.read_doubles(1)[0]
    if not (np.isfinite(step) and step > 0):
        raise ValueError(f"its lattice step must be positive and finite, got {step}")
    may_squeeze = bool(body.read_fixed_width(1, 1)[0])
    num_rings = int(body.read_fixed_width(1, _COUNT_BITS)[0])
    sizes = body.read_coded(num_rings)
    if not num_rings or sizes.min() < 3:
        raise ValueError("each of its rings must have three points or more, and it needs one ring")
    first = np.concatenate([[0], np.cumsum(sizes)])
    # Coordinates are stored as differences from the point before, across rings.
    points = np.stack([np.cumsum(body.read_signed(int(first[-1]))) for _ in range(2)], axis=1)
    return Outline(origin, float(step), points, first, may_squeeze, np.zeros(len(points), bool))


_DISTANCES_AT_ONCE = 2**21  # entries of a block of the distance matrix


def distances_by_rows(
    points: Float[np.ndarray, "n 2"], edges: Int[np.ndarray, "edges 2"], arcs: Arcs = NO_ARCS
) -> Iterator[tuple[int, Float[np.ndarray, "rows n"]]]:
    """Yield the matrix of shortest path lengths along straight edges and arcs between points, in blocks of rows.

    Rows are starts, columns are ends. Each item is ``(first, block)``: the index of the block's first row, and the
    block. Lengths are ``inf`` without a path.
    """
    adjacency = Graph(points, edges, arcs=arcs).adjacency
    step = max(1, _DISTANCES_AT_ONCE // max(1, len(points)))
    for begin in range(0, len(points), step):
        yield begin, dijkstra(adjacency, indices=np.arange(begin, min(begin + step, len(points))))


def distances_table(stored: "PairsFileData", size: int) -> Float[np.ndarray, "size size"]:
    """Return the matrix of path lengths between corners, padded with ``inf`` to ``size`` rows and columns."""
    table = np.full((size, size), np.inf, np.float32)
    for first, rows in distances_by_rows(stored.points, stored.edges, stored.arcs):
        table[first : first + len(rows), : len(stored.points)] = rows
    return table


# Limits of files: a reader refuses files whose tables would take too much memory.
MOST_CORNERS = 2**13
WIDEST = 1e18  # largest domain width: squares of distances stay finite in 32 bits
_MOST_NUMBERS = 2**24  # entries of the query table of leaves and corners
# List entries of the leaves so far, and of the nodes of the next level while it is decoded: at most
# `_MOST_ENTRIES_A_BYTE` for each byte of the file, or `_LEAST_ENTRIES` if this is more.
_MOST_ENTRIES_A_BYTE = 2**6
_LEAST_ENTRIES = 2**20


@dataclass(frozen=True, eq=False)
class PairsFileData:
    """The content of a PairPLR's file: the map, its corners, and the corners that each leaf lists."""

    domain: Box
    outline: Outline
    corner: Int[np.ndarray, " corners"]  # outline points that are corners, ascending
    edges: Int[np.ndarray, "edges 2"]  # pairs of corners that a shortest path may join straight, the smaller first
    tree: Tree
    # Entry (i, c) is true if leaf i lists corner c: shortest paths from the leaf may turn first there. Sorted.
    lists: csr_array
    rounding: float  # largest error of a distance due to rounding points to the lattice
    label: str = ""
    # Points of free space at which paths may turn in any direction, such as ends of stairs. They count as corners,
    # with indices after those of `corner`.
    places: Float[np.ndarray, "places 2"] = field(default_factory=lambda: np.zeros((0, 2)))
    arcs: Arcs = NO_ARCS  # between places, given as indices of corners

    @property
    def cells(self) -> Cells:
        return self.tree.leaves

    @cached_property
    def points(self) -> Float[np.ndarray, "corners 2"]:
        return np.concatenate([self.outline.positions[self.corner], self.places])

    @property
    def num_corners(self) -> int:
        """Number of corners at which paths may turn: corners of obstacles, and ends of links (:attr:`places`)."""
        return len(self.points)

    def to_bytes(self) -> bytes:
        """Encode the file: a layer of the map and its corners, then a layer of the leaves and their lists."""
        # 1. Write the map, the corners, and the pairs of corners: i < j has the number j (j - 1) / 2 + i.
        first, count = BitWriter(), self.num_corners
        first.write_floats(np.array([self.rounding]))
        self.outline.write(first)
        first.write_set(np.isin(np.arange(len(self.outline.points)), self.corner))
        is_joined = np.zeros(comb(count, 2), bool)
        i, j = self.edges.T
        is_joined[j * (j - 1) // 2 + i] = True
        num_pairs = comb(len(self.corner), 2)  # the first pairs, without places
        first.write_set(is_joined[:num_pairs])
        if self.outline.is_thin.any() or len(self.places):
            first.write_set(self.outline.is_thin)
        if len(self.places):
            first.write(np.array([len(self.places), len(self.arcs.start)]), _COUNT_BITS)
            first.write_doubles(np.append(self.places, self.arcs.length))
            first.write(np.concatenate(self.arcs[:2]) - len(self.corner), _COUNT_BITS)
            first.write_set(is_joined[num_pairs:])
        # 2. Write the tree and the lists. A node lists the union of its halves' lists. Level by level, the file
        #    stores which of its parent's corners each node drops; the root drops corners that no leaf lists.
        lists, tree = BitWriter(), self.tree
        write_tree(lists, tree)
        is_listed = np.zeros((len(tree.child), count), bool)  # by node and corner
        is_listed[tree.node_of_leaf] = self.lists.toarray()
        for split in reversed(tree.splits):
            is_listed[split] = is_listed[tree.child[split]] | is_listed[tree.child[split] + 1]
        lists.write_set(~is_listed[0])
        for split in filter(len, tree.splits):
            by_parent, by_half = is_listed[np.repeat(split, 2)], is_listed[tree.halves(split)]
            lists.write_set(~by_half[by_parent])
        layers = tuple(Layer(PAIRS_CODE, body.to_bytes()) for body in (first, lists))
        return Container(self.domain, layers, label=self.label).to_bytes()

    @staticmethod
    def from_bytes(data: bytes) -> "PairsFileData":
        """Decode the file of a PairPLR; ``ValueError`` if it is invalid."""
        container = Container.from_bytes(data)
        domain = container.domain
        if any(layer.leaf_code != PAIRS_CODE for layer in container.layers):
            raise ValueError("it holds the distance to one goal; use load")
        if any(layer.proof_code for layer in container.layers) or container.folding is not None:
            raise ValueError("its pairs have proofs or folded points")
        if domain.dim != 2 or domain.is_periodic:
            raise ValueError(f"its domain must be a box in the plane without periodic axes, got {domain}")
        if not domain.width.max() <= WIDEST:
            raise ValueError(f"its domain is {domain.width.max():g} wide, more than {WIDEST:g}")
        stated = 1 + len(Header.read(data).marks)
        if stated == 1 or len(container.layers) < stated:
            raise ValueError("it was cut off before its lists of corners: take the whole file")
        if stated > 3:
            raise ValueError(f"its pairs have {stated} layers, more than 3")
        body, *others, lists = (BitReader(layer.body) for layer in container.layers)
        # 1. Read the outline and its corners.
        rounding = _read_rounding(body)
        outline = read_outline(body, domain.lo)
        corner = np.flatnonzero(body.read_set(len(outline.points)))
        if (count := len(corner)) > MOST_CORNERS:
            raise ValueError(f"it may have at most {MOST_CORNERS} corners, got {count}")
        # 2. Decode pair numbers into pairs of corners: i < j has the number j (j - 1) / 2 + i. Files of release 0.1
        #    may have the pairs in a layer of their own, with a rounding error that counts instead.
        if others:
            body.require_end("its outline needs")
            (body,) = others
            rounding = _read_rounding(body)
        number = body.read_members(num_pairs := comb(count, 2))
        places, arcs = np.zeros((0, 2)), NO_ARCS
        if not body.at_end():
            outline = replace(outline, is_thin=body.read_set(len(outline.points)))
        if not body.at_end():
            places, arcs = _read_places(body, count)
            count += len(places)
            number = np.append(number, num_pairs + body.read_members(comb(count, 2) - num_pairs))
        first_number = np.arange(count) * np.arange(-1, count - 1) // 2  # of the pairs of each j
        j = np.searchsorted(first_number, number, side="right") - 1
        edges = np.stack([number - first_number[j], j], axis=1)
        body.require_end("its corners need")
        # 3. Read the tree and the leaves' lists.
        tree = read_tree(lists, 2)
        if (leaves := len(tree.node_of_leaf)) > most_leaves(count):
            raise ValueError(f"it has {leaves:,} leaves and {count:,} corners, more than tables are made of")
        listed = _read_lists(lists, tree, count, max(_LEAST_ENTRIES, _MOST_ENTRIES_A_BYTE * len(data)))
        lists.require_end("its leaves need")
        return PairsFileData(domain, outline, corner, edges, tree, listed, rounding, container.label, places, arcs)


def most_leaves(num_corners: int) -> int:
    return max(1, _MOST_NUMBERS // max(1, num_corners))


def _read_places(body: BitReader, num_corners: int) -> tuple[Float[np.ndarray, "places 2"], Arcs]:
    """Decode the :attr:`PairsFileData.places`, and the arcs (links of a building) that lead from place to place.

    ``num_corners`` is the number of corners of obstacles. Arcs refer to place ``i`` by ``num_corners + i``.
    """
    num_places, num_arcs = body.read_fixed_width(2, _COUNT_BITS).tolist()
    if num_corners + num_places > MOST_CORNERS:
        raise ValueError(f"it may have at most {MOST_CORNERS} corners and places, got {num_corners + num_places}")
    places, lengths = body.read_doubles(2 * num_places).reshape(-1, 2), body.read_doubles(num_arcs)
    ends = body.read_fixed_width(2 * num_arcs, _COUNT_BITS).reshape(2, -1)
    is_valid = np.isfinite(places).all() and np.isfinite(lengths).all() and (lengths >= 0).all()
    if not is_valid or ends.max(initial=0) >= num_places:
        raise ValueError("its places or arcs are invalid")
    start, end = num_corners + ends
    return places, Arcs(start, end, lengths)


def _read_rounding(body: BitReader) -> float:
    rounding = float(body.read_floats(1)[0])
    if not 0 <= rounding < np.inf:
        raise ValueError(f"its rounding error must be at least 0 and finite, got {rounding}")
    return rounding


def _read_lists(body: BitReader, tree: Tree, count: int, most: int) -> csr_array:
    """Decode the corners that each leaf lists: see :attr:`PairsFileData.lists`.

    ``count`` is the number of corners. ``ValueError`` if the lists have more than ``most`` entries.
    """
    # Level by level, each half of a split node takes over its parent's list, less the corners that the file says it
    # drops.
    is_listed = np.zeros((len(tree.child), count), bool)  # by node and corner
    is_listed[0] = ~body.read_set(count)
    num_entries = np.count_nonzero(is_listed[0])  # of the leaves so far and of the nodes of a level
    for split in filter(len, tree.splits):
        by_half = is_listed[np.repeat(split, 2)]
        inherited = np.flatnonzero(by_half)
        num_entries += len(inherited) // 2
        if num_entries > most:
            raise ValueError("its lists have more entries than a file of its size ought to")
        dropped = inherited[body.read_set(len(inherited))]
        by_half.ravel()[dropped] = False
        num_entries -= len(dropped)
        is_listed[tree.halves(split)] = by_half
    return csr_array(is_listed[tree.node_of_leaf])
