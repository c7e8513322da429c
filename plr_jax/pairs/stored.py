"""The file of a PairPLR: what it holds of a workspace, and its layout.

It is a PLR file (see ``plr/container.py``) whose leaf model has the code 7, of two layers. The first one holds:

    the largest error of a distance from the rounding of the points to the outline's lattice, a 32-bit float
    the outline of free space: the lattice's step, whether paths may squeeze, the sizes of the rings, and the points
    which of its points are corners, a set
    which pairs of corners are joined, a set of the pairs in order of the later corner
    if there are any, the walls that lower bounds do not count on, a set

The second one makes queries quick:

    the tree over the leaves
    the corners that are listed: for the root those that it leaves out of all, a set; then for the halves of the split
      nodes of each level, those that they leave out of their parent's, a set a level

Files of plr_jax 0.1 may hold the joined pairs in a layer of their own between the two, behind the error again.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from plr_jax._arrays import take_ragged
from plr_jax.geometry.box import Box
from plr_jax.geometry.vectors import cross_product, left_normal, pseudo_angle
from plr_jax.plr.coding import BitReader, BitWriter, read_tree, write_tree
from plr_jax.plr.container import PAIRS_CODE, Container, Header, Layer
from plr_jax.plr.tree import Cells, Tree

_SHARP = -0.5  # cosine of the turn at a tip of an obstacle, at the most
_MITRE = 4.0  # times as far as a wall recedes does a tip at the most
_COUNT_BITS = 32
_WALLS_AT_ONCE = 2**5  # walls of which it is found what they cross


@dataclass(frozen=True, eq=False)
class Outline:
    """Rings of points with integer coordinates.

    Attributes:
        origin: Where both coordinates are 0.
        step: Width of the lattice.
        points: Points of all rings, ring by ring, in steps from the origin.
        first: First point of each ring, and the number of points.
        may_squeeze: Whether a path may pass between walls that touch in one point.
        thin: Walls that lower bounds do not count on, as they are not inside of an obstacle after they move back.
    """

    origin: Float[np.ndarray, "2"]
    step: float
    points: Int[np.ndarray, "points 2"]
    first: Int[np.ndarray, "rings_plus_one"]
    may_squeeze: bool
    thin: Int[np.ndarray, "thin"] = field(default_factory=lambda: np.zeros(0, np.int64))

    @cached_property
    def positions(self) -> Float[np.ndarray, "points 2"]:
        """Where the points are."""
        return self.origin + self.step * self.points

    @cached_property
    def _following(self) -> Int[np.ndarray, "points"]:
        """The next point of each point's ring."""
        following = np.arange(1, len(self.points) + 1)
        following[self.first[1:] - 1] = self.first[:-1]
        return following

    @property
    def is_thin(self) -> Bool[np.ndarray, "points"]:
        """Which walls are thin, those from each point to the next one."""
        return np.isin(np.arange(len(self.points)), self.thin)

    @cached_property
    def is_contact(self) -> Bool[np.ndarray, "points"]:
        """Contacts of free space that no path may squeeze through: places at which several walls begin."""
        _, index = np.unique(self.points, axis=0, return_inverse=True)
        return (np.bincount(index.ravel(), self._has_length)[index.ravel()] > 1) & (not self.may_squeeze)

    @cached_property
    def _has_length(self) -> Bool[np.ndarray, "walls"]:
        return (self.points[self._following] != self.points).any(axis=1)

    @cached_property
    def _following_past_contacts(self) -> Int[np.ndarray, "points"]:
        """As ``_following``, but at a contact each wall goes on around its own obstacle: obstacles are then apart."""
        following, at = self._following.copy(), np.flatnonzero(self.is_contact & self._has_length)
        before = np.argsort(following)[at]
        onward = (self.points[following] - self.points)[at].astype(float)
        _, place = np.unique(self.points[at], axis=0, return_inverse=True)
        order = np.lexsort((pseudo_angle(*onward.T), place.ravel()))
        first = np.searchsorted(place.ravel()[order], place.ravel()[order])
        is_last = np.append(np.diff(first) > 0, True)[: len(at)]
        following[before[order]] = at[order[np.where(is_last, first, np.arange(len(at)) + 1)]]
        return following

    def _beside(
        self, following: Int[np.ndarray, "points"]
    ) -> tuple[Int[np.ndarray, "points 2"], Int[np.ndarray, "points 2"]]:
        """The walls that arrive at each point and leave it, as vectors; walls that are points are passed over."""
        leaving, comes_from = self.points[following] - self.points, np.argsort(following)
        arriving = leaving[comes_from]
        for walls, beyond in ((leaving, following), (arriving, comes_from)):
            while len(flat := np.flatnonzero(~walls.any(axis=1) & walls[beyond].any(axis=1))):
                walls[flat] = walls[beyond[flat]]
        return arriving, leaving

    @cached_property
    def is_reflex(self) -> Bool[np.ndarray, "points"]:
        """Points that stand out into the free space on their side."""
        (ax, ay), (bx, by) = (walls.T for walls in self._beside(self._following))
        return ax * by < ay * bx

    def contains(self, x: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, "n"]:
        """Whether points are in free space."""
        import shapely  # which to load a file does not need

        shapely.prepare(self.region)
        return shapely.intersects_xy(self.region, *x.T)

    @cached_property
    def region(self) -> Any:
        """Free space: of the faces between the walls those from which a ray crosses an odd number of walls.

        Rings may touch one another and themselves, so they are no polygons. Raises ``ValueError`` if they cross more
        often than details narrower than the lattice make them.
        """
        import shapely

        ends = self.moved_walls(0.0).reshape(-1, 2, 2)
        lines: Any = shapely.linestrings(ends)
        tree: Any = shapely.STRtree(lines)
        points: Any = shapely.points(np.unique(ends.reshape(-1, 2), axis=0))
        for each, predicate, most in ((lines, "crosses", 2 * len(lines)), (points, "intersects", 3 * len(lines))):
            meetings = 0
            for begin in range(0, len(each), _WALLS_AT_ONCE):
                meetings += tree.query(each[begin : begin + _WALLS_AT_ONCE], predicate=predicate).shape[1]
                if meetings > most:
                    raise ValueError(f"the {len(lines):,} walls of its outline cross one another too often")
        walls: Any = shapely.union_all(lines)
        faces: Any = shapely.get_parts(shapely.polygonize(shapely.get_parts(walls)))
        px, py = shapely.get_coordinates(shapely.point_on_surface(faces)).T[:, :, None]
        (ax, ay), (bx, by) = ends.transpose(1, 2, 0)
        with np.errstate(divide="ignore", invalid="ignore"):
            is_left = (ay > py) != (by > py)
            is_left &= ax + (py - ay) / (by - ay) * (bx - ax) < px
        return shapely.union_all(faces[is_left.sum(axis=1) % 2 == 1])

    def moved_walls(self, distance: float, *, surely: bool = False) -> Float[np.ndarray, "walls 4"]:
        """Ends of the walls after all of them have moved so far back, out of free space, or into it if negative.

        Walls that move back leave contacts open, and cut off tips. So further walls, there and back, go from the
        contact, or from where a tip may be cut off, to where the walls meet.

        Args:
            distance: How far they move.
            surely: Whether all walls move back, however thin obstacles are, and without the further walls.
        """
        following = self._following if distance <= 0 else self._following_past_contacts
        moved = self.positions - distance * self._moves(distance, surely)
        walls = np.concatenate([moved, moved[following]], axis=1)
        if distance <= 0 or surely:
            return walls
        away = self.positions - moved
        far = np.linalg.norm(away, axis=1)
        most = np.where(self.is_contact, 0.0, _MITRE * distance)
        tips = np.flatnonzero(far > most)
        start = self.positions[tips] - (most[tips] / far[tips])[:, None] * away[tips]
        return np.concatenate([walls, np.hstack([start, moved[tips]]), np.hstack([moved[tips], start])])

    def around_thin_walls(self, distance: float) -> Float[np.ndarray, "walls 4"]:
        """Rectangles around thin walls, as walls of obstacles: walls between tips that are cut off hardly move."""
        start, end = self.positions[self.thin], self.positions[self._following[self.thin]]
        has_length = (start != end).any(axis=1)
        start, end = start[has_length], end[has_length]
        aside = distance * left_normal(end - start)
        along = np.stack([aside[:, 1], -aside[:, 0]], axis=1)
        corners = [start - along + aside, end + along + aside, end + along - aside, start - along - aside]
        return np.concatenate([np.concatenate([corners[k], corners[(k + 1) % 4]], axis=1) for k in range(4)])

    def moved_points(self, distance: float) -> Float[np.ndarray, "points 2"]:
        """The points after all walls have moved so far back, out of free space, or into it if negative."""
        return self.positions - distance * self._moves(distance)

    def ends_sight(self, distance: float) -> Bool[np.ndarray, "points"]:
        """Points at which a wall begins, of those that have moved so far back: contacts, and points that stay."""
        return self.is_contact | (self._moves(distance) == 0).all(axis=1)

    def _moves(self, distance: float, surely: bool = False) -> Float[np.ndarray, "points 2"]:
        """How far points move back, in distances. A wall that is a point moves with those beside it.

        Some points do not move back, unless surely: points between thin walls, and ends of walls so short that they
        would turn around, as of an obstacle that is thinner than twice the distance.
        """
        following = self._following if distance <= 0 else self._following_past_contacts
        onward = self.positions[following] - self.positions
        before, normal = map(_normal_of, self._beside(following))
        cosine, sine = (normal * before).sum(axis=1), cross_product(before, normal)
        mitre = (normal + before) / np.maximum(1 + cosine, 1e-12)[:, None]
        length = np.linalg.norm(mitre, axis=1, keepdims=True)
        if distance <= 0:
            return mitre * np.minimum(1, _MITRE / np.maximum(length, 1e-12))
        # As far as the sharpest tip needs, but no more than a part of the walls beside it.
        long = np.linalg.norm(onward, axis=1)
        short = np.minimum(long, long[np.argsort(following)])[:, None]
        mitre *= np.minimum(1, np.maximum(_MITRE, short / (4 * distance)) / np.maximum(length, 1e-12))
        if surely:
            return mitre
        is_tip = (cosine < _SHARP) & (sine < 0)  # which recedes along itself, within its obstacle
        mitre[self.is_thin & self.is_thin[np.argsort(following)] & ~is_tip] = 0.0
        moved_onward = onward - distance * (mitre[following] - mitre)
        turned = np.flatnonzero((onward * moved_onward).sum(axis=1) < 0)
        mitre[turned] = mitre[following[turned]] = 0.0
        return mitre

    def write(self, body: BitWriter) -> None:
        """Append the outline to a file's body."""
        body.write(np.frombuffer(np.float64(self.step).tobytes(), "<u4").astype(np.int64), 32)
        body.write(np.array([self.may_squeeze], np.int64), 1)
        sizes = np.diff(self.first)
        body.write(np.array([len(sizes)]), _COUNT_BITS).write_coded(sizes)
        for along in self.points.T:
            body.write_signed(np.diff(along, prepend=0))


def _normal_of(walls: Int[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
    """Unit normals of walls, to the left; zero of walls that are points."""
    is_wall = walls.any(axis=1, keepdims=True)
    return np.where(is_wall, left_normal(np.where(is_wall, walls, 1.0)), 0.0)


def read_outline(body: BitReader, origin: Float[np.ndarray, "2"]) -> Outline:
    """The outline that comes next; raises ``ValueError`` if it is none."""
    step = np.frombuffer(body.read_alike(2, 32).astype("<u4").tobytes(), "<f8")[0]
    if not (np.isfinite(step) and step > 0):
        raise ValueError(f"its points are {step} apart")
    may_squeeze = bool(body.read_alike(1, 1)[0])
    num_rings = int(body.read_alike(1, _COUNT_BITS)[0])
    sizes = body.read_coded(num_rings)
    if not num_rings or sizes.min() < 3:
        raise ValueError("it has no ring of points, or one of fewer than three")
    first = np.concatenate([[0], np.cumsum(sizes)])
    points = np.stack([np.cumsum(body.read_signed(int(first[-1]))) for _ in range(2)], axis=1)
    return Outline(origin, float(step), points, first, may_squeeze)


_DISTANCES_AT_ONCE = 2**21  # distances


def distances_by_rows(
    points: Float[np.ndarray, "n 2"], edges: Int[np.ndarray, "edges 2"]
) -> Iterator[tuple[int, Float[np.ndarray, "rows n"]]]:
    """Shortest distances between points some of which are joined, ``inf`` without a path: first rows, and some."""
    start, end = edges.T
    lengths = np.linalg.norm(points[start] - points[end], axis=1)
    graph = coo_array((lengths, (start, end)), shape=2 * (len(points),)).tocsr()
    step = max(1, _DISTANCES_AT_ONCE // max(1, len(points)))
    for begin in range(0, len(points), step):
        rows = np.arange(begin, min(begin + step, len(points)))
        yield begin, dijkstra(graph, directed=False, indices=rows)


def distances_table(stored: "Stored", size: int) -> Float[np.ndarray, "size size"]:
    """Shortest distances between all corners in 32 bits, and to none, ``inf``, in rows and columns up to a size."""
    table = np.full((size, size), np.inf, np.float32)
    for first, rows in distances_by_rows(stored.points, stored.edges):
        table[first : first + len(rows), : len(stored.points)] = rows
    return table


MOST_CORNERS = 2**13
WIDEST = 1e18
"""Width of the widest domain: squares of distances stay within 32-bit floats."""
_MOST_NUMBERS = 2**24  # of a table of leaves and corners that queries read
_MOST_ENTRIES_A_BYTE, _LEAST_ENTRIES = 2**6, 2**20


@dataclass(frozen=True, eq=False)
class PairsFileData:
    """What a file holds.

    Attributes:
        domain: The box.
        outline: Free space.
        corner: Points of the outline that are corners, ascending.
        edges: Pairs of corners that a shortest path may join straight, the earlier one first.
        tree: The tree over the leaves.
        leaf: The leaf of each entry of a list, in the order of the tree's traversal.
        listed: Its corner; ascending in a leaf.
        rounding: The largest error of a distance from the rounding of the points to the outline's lattice.
        label: Text that the file says of itself.
    """

    domain: Box
    outline: Outline
    corner: Int[np.ndarray, "corners"]
    edges: Int[np.ndarray, "edges 2"]
    tree: Tree
    leaf: Int[np.ndarray, "entries"]
    listed: Int[np.ndarray, "entries"]
    rounding: float
    label: str = ""

    @property
    def cells(self) -> Cells:
        """The leaves' cells, in the order of the tree's traversal."""
        return self.tree.leaves

    @cached_property
    def points(self) -> Float[np.ndarray, "corners 2"]:
        """Where the corners are."""
        return self.outline.positions[self.corner]

    def to_bytes(self) -> bytes:
        """The bytes of the file."""
        first, lists, count = BitWriter(), BitWriter(), len(self.corner)
        first.write_floats(np.array([self.rounding]))
        self.outline.write(first)
        is_corner, is_joined = np.zeros(len(self.outline.points), bool), np.zeros(count * (count - 1) // 2, bool)
        is_corner[self.corner] = True
        i, j = self.edges.T
        is_joined[j * (j - 1) // 2 + i] = True
        first.write_set(is_corner)
        first.write_set(is_joined)
        if len(self.outline.thin):
            first.write_set(self.outline.is_thin)
        write_tree(lists, self.tree)
        # Each node lists what its halves list together, and is written as what it does not list of its parent's.
        tree = self.tree
        of_node = np.zeros((len(tree.child), count), bool)
        of_node[tree.node_of_leaf[self.leaf], self.listed] = True
        for split in reversed(tree.splits):
            of_node[split] = of_node[tree.child[split]] | of_node[tree.child[split] + 1]
        lists.write_set(~of_node[0])
        for split in filter(len, tree.splits):
            inherited, own = of_node[np.repeat(split, 2)], of_node[tree.halves(split)]
            lists.write_set(~own[inherited])
        layers = tuple(Layer(PAIRS_CODE, body.to_bytes()) for body in (first, lists))
        return Container(self.domain, layers, label=self.label).to_bytes()

    @staticmethod
    def from_bytes(data: bytes) -> "Stored":
        """What a file's bytes hold; raises ``ValueError`` saying what is wrong with them."""
        container = Container.from_bytes(data)
        domain = container.domain
        if any(layer.leaf_code != PAIRS_CODE for layer in container.layers):
            raise ValueError("it holds the distance to one goal; use load")
        if any(layer.proof_code for layer in container.layers) or container.folding is not None:
            raise ValueError("its pairs have proofs or folded points")
        if domain.dim != 2 or domain.is_periodic:
            raise ValueError(f"its pairs are of points of {domain}; they ought to be of a region in the plane")
        if not domain.width.max() <= WIDEST:
            raise ValueError(f"its domain is {domain.width.max():g} wide, more than {WIDEST:g}")
        stated = 1 + len(Header.read(data).marks)
        if stated == 1 or len(container.layers) < stated:
            raise ValueError("it was cut off before its lists of corners: take the whole file")
        if stated > 3:
            raise ValueError(f"its pairs have {stated} layers, more than 3")
        body, *others, lists = (BitReader(layer.body) for layer in container.layers)
        # 1. The outline, and which of its points are corners.
        rounding = _read_rounding(body)
        outline = read_outline(body, domain.lo)
        corner = np.flatnonzero(body.read_set(len(outline.points)))
        if (count := len(corner)) > MOST_CORNERS:
            raise ValueError(f"it has {count} corners; at most {MOST_CORNERS} are read")
        # 2. Pairs of corners, of which the file tells the numbers.
        if others:
            if not body.at_end():
                raise ValueError("it holds more data than its outline needs")
            (body,) = others
            rounding = _read_rounding(body)
        number = body.read_members(count * (count - 1) // 2)
        j = ((1 + np.sqrt(1 + 8 * number.astype(np.float64))) // 2).astype(np.int64)
        j -= j * (j - 1) // 2 > number
        j += j * (j + 1) // 2 <= number
        edges = np.stack([number - j * (j - 1) // 2, j], axis=1)
        if not body.at_end():
            outline = replace(outline, thin=np.flatnonzero(body.read_set(len(outline.points))))
        if not body.at_end():
            raise ValueError("it holds more data than its corners need")
        # 3. The tree and the leaves' lists.
        tree = read_tree(lists, 2)
        if (leaves := len(tree.node_of_leaf)) > most_leaves(count):
            raise ValueError(f"it has {leaves:,} leaves and {count:,} corners, more than tables are made of")
        most = max(_LEAST_ENTRIES, _MOST_ENTRIES_A_BYTE * len(data))
        leaf, listed = _read_lists(lists, tree, count, most)
        if not lists.at_end():
            raise ValueError("it holds more data than its leaves need")
        return PairsFileData(domain, outline, corner, edges, tree, leaf, listed, rounding, container.label)


def most_leaves(count: int) -> int:
    """How many leaves there may be with so many corners."""
    return max(1, _MOST_NUMBERS // max(1, count))


def _read_rounding(body: BitReader) -> float:
    rounding = float(body.read_floats(1)[0])
    if not 0 <= rounding < np.inf:
        raise ValueError(f"its distances err by {rounding}")
    return rounding


def _read_lists(
    body: BitReader, tree: Tree, count: int, most: int
) -> tuple[Int[np.ndarray, "entries"], Int[np.ndarray, "entries"]]:
    """The leaves' lists that come next; raises ``ValueError`` where they have more entries than all may have."""
    corner, listed_so_far = np.flatnonzero(~body.read_set(count)), 0
    nodes, node, parts = np.zeros(1, np.int64), np.zeros(len(corner), np.int64), []
    for split in tree.splits:
        place = tree.leaf_of_node[nodes[node]]
        parts.append((place[place >= 0], corner[place >= 0]))
        listed_so_far += len(parts[-1][0])
        halves = tree.halves(split)
        first = np.searchsorted(node, np.arange(len(nodes) + 1))
        parent = np.repeat(np.searchsorted(nodes, split), 2)
        if listed_so_far + int((first[parent + 1] - first[parent]).sum()) > most:
            raise ValueError("its lists have more entries than a file of its size ought to")
        rows, node = take_ragged(first, parent)
        corner = corner[rows]
        if len(halves):
            stays = ~body.read_set(len(corner))
            node, corner = node[stays], corner[stays]
        nodes = halves
    leaf, listed = (np.concatenate(column) for column in zip(*parts, strict=True))
    order = np.argsort(leaf, kind="stable")
    return leaf[order], listed[order]
