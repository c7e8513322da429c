"""What the file of a PairPLR holds, and its layout.

It is a PLR file (see ``plr/container.py``) of three layers, whose leaf model has the code 7. The first one is
all that one goal needs:

    the largest error of a distance from the rounding of the points to the outline's lattice, a 32-bit float
    the outline of free space (see ``outline.py``)
    which of its points are corners, a set

Where a file was cut off behind it, corners are joined as they are in the outline's free space (see
:func:`derived_edges`); the error is that of distances which follow from this. The second one saves finding that out,
and knows of the true walls what the lattice rounds:

    the largest error of a distance, again, by the pairs that follow
    which pairs of corners are joined, a set of the pairs in order of the later corner

Where details narrower than the lattice make the outline tell other distances, these pairs stand in the first layer
instead, behind the corners, and there are two layers; the error is theirs. The last one is what makes queries quick.
Where it was cut off, there is one leaf, which lists all corners.

    the tree over the leaves
    the corners that are listed: for the root those that it leaves out of all, a set; then for the halves of the split
      nodes of each level, those that they leave out of their parent's, a set a level
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from plr_jax._arrays import run_members
from plr_jax.geometry.box import Box
from plr_jax.pairs.outline import Outline, read_outline
from plr_jax.plr.coding import BitReader, BitWriter, read_tree, write_tree
from plr_jax.plr.container import PAIRS_CODE, Container, Layer
from plr_jax.plr.partition.cells import Cells, Level, Tree, levels_of, tree_of_levels

if TYPE_CHECKING:
    from plr_jax.geometry.corners import CornerVisibility
    from plr_jax.geometry.workspace import Workspace


# Which corners are joined, and the distances between corners over them.
#
# Joined are corners between which a shortest path may go straight: they see one another, and the line is tangent to
# the obstacles at both. This follows from free space, so an outline tells it of itself, but for what its lattice
# rounds.


_AT_ONCE = 2**21  # distances


def taut_edges(visibility: "CornerVisibility") -> Int[np.ndarray, "edges 2"]:
    """Pairs of corners that see one another and whose line is tangent at both: what shortest paths are made of."""
    corners, (i, j) = visibility.corners, visibility.edges.T
    return visibility.edges[corners.is_tangent(i, j) & corners.is_tangent(j, i)]


def derived_edges(
    workspace: "Workspace", outline: Outline, corner: Int[np.ndarray, "corners"]
) -> Int[np.ndarray, "edges 2"]:
    """Pairs of corners that are joined in the workspace of an outline, the earlier one first.

    Args:
        workspace: What the outline bounds.
        outline: The outline.
        corner: Which of its points are corners.

    Returns:
        The pairs, in order of the later corner. Corners that the lattice has made to stick out no longer are in none.
    """
    from plr_jax.geometry.corners import corner_visibility  # which a query of a whole file does not need

    visibility = corner_visibility(workspace)
    number = {tuple(point): i for i, point in enumerate(outline.points[corner].tolist())}
    lattice = np.rint((visibility.corners.points - outline.origin) / outline.step).astype(np.int64)
    found = np.array([number.get(tuple(point), -1) for point in lattice.tolist()], np.int64)
    edges = found[taut_edges(visibility)]
    return in_order(edges[(edges >= 0).all(axis=1) & (edges[:, 0] != edges[:, 1])])


def in_order(edges: Int[np.ndarray, "edges 2"]) -> Int[np.ndarray, "distinct 2"]:
    """Pairs, each once, the earlier corner first, in order of the later one."""
    return np.unique(np.sort(edges, axis=1)[:, ::-1], axis=0)[:, ::-1]


def distances_by_rows(
    points: Float[np.ndarray, "n 2"], edges: Int[np.ndarray, "edges 2"]
) -> Iterator[tuple[int, Float[np.ndarray, "rows n"]]]:
    """Shortest distances between points some of which are joined, ``inf`` without a path: first rows, and some."""
    start, end = edges.T
    lengths = np.linalg.norm(points[start] - points[end], axis=1)
    graph = coo_array((lengths, (start, end)), shape=2 * (len(points),)).tocsr()
    step = max(1, _AT_ONCE // max(1, len(points)))
    for begin in range(0, len(points), step):
        rows = np.arange(begin, min(begin + step, len(points)))
        yield begin, dijkstra(graph, directed=False, indices=rows)


def distances_table(stored: "Stored", size: int) -> Float[np.ndarray, "size size"]:
    """Shortest distances between all corners in 32 bits, and to none, ``inf``, in rows and columns up to a size."""
    table = np.full((size, size), np.inf, np.float32)
    for first, rows in distances_by_rows(stored.points, stored.edges):
        table[first : first + len(rows), : len(stored.points)] = rows
    return table


def largest_difference(
    points: Float[np.ndarray, "n 2"],
    edges: Int[np.ndarray, "edges 2"],
    others: Float[np.ndarray, "n 2"],
    other_edges: Int[np.ndarray, "others 2"],
) -> float:
    """How far the distances between points are from those between others; ``inf`` if one path has no other."""
    largest = 0.0
    both = zip(distances_by_rows(points, edges), distances_by_rows(others, other_edges), strict=True)
    for (_, one), (_, other) in both:
        with np.errstate(invalid="ignore"):
            largest = max(largest, float(np.where(one == other, 0.0, np.abs(one - other)).max()))
    return largest


MOST_CORNERS = 2**13
WIDEST = 1e18
"""Width of the widest domain: squares of distances stay within 32-bit floats."""
_MOST_NUMBERS = 2**24  # of a table of leaves and corners that queries read
_MOST_ENTRIES_A_BYTE, _LEAST_ENTRIES = 2**6, 2**20


@dataclass(frozen=True, eq=False)
class Stored:
    """What a file holds.

    Attributes:
        domain: The box.
        outline: Free space.
        corner: Points of the outline that are corners, ascending.
        joined: Pairs of corners that a shortest path may join straight, the earlier one first, if the file says it.
        levels: The tree over the leaves.
        leaf: The leaf of each entry of a list, in the order of the tree's traversal.
        listed: Its corner; ascending in a leaf.
        rounding: The largest error of a distance from the rounding of the points to the outline's lattice.
        rounding_of_outline: The same where the joined pairs are those of the outline's free space; None if that
            tells other distances.
    """

    domain: Box
    outline: Outline
    corner: Int[np.ndarray, "corners"]
    joined: Int[np.ndarray, "edges 2"] | None
    levels: list[Level]
    leaf: Int[np.ndarray, "entries"]
    listed: Int[np.ndarray, "entries"]
    rounding: float
    rounding_of_outline: float | None
    label: str = ""

    @cached_property
    def tree(self) -> Tree:
        """The tree over the leaves."""
        return tree_of_levels(self.levels, 2)

    @property
    def cells(self) -> Cells:
        """The leaves' cells, in the order of the tree's traversal."""
        return self.tree.leaves

    @cached_property
    def points(self) -> Float[np.ndarray, "corners 2"]:
        """Where the corners are."""
        return self.outline.positions[self.corner]

    @cached_property
    def edges(self) -> Int[np.ndarray, "edges 2"]:
        """Pairs of corners that a shortest path may join straight, the earlier one first."""
        return derived_edges(self.workspace, self.outline, self.corner) if self.joined is None else self.joined

    @property
    def workspace(self) -> "Workspace":
        """The workspace whose free space the outline bounds, with corners on the outline's lattice.

        Raises ``ValueError`` if the outline is none of a workspace, which is not found out before it is asked for.
        """
        import shapely  # which to load a file does not need

        from plr_jax.geometry.workspace import Workspace

        try:
            return Workspace.from_polygons([self.outline.region], self.domain, squeeze=self.outline.may_squeeze)
        except (ValueError, shapely.errors.ShapelyError) as error:
            raise ValueError(f"its outline bounds no workspace: {error}") from error

    def to_bytes(self) -> bytes:
        """The bytes of the file."""
        first, pairs, lists = BitWriter(), BitWriter(), BitWriter()
        first.write_floats(
            np.array([self.rounding if self.rounding_of_outline is None else self.rounding_of_outline])
        )
        self.outline.write(first)
        is_corner = np.zeros(len(self.outline.points), bool)
        is_corner[self.corner] = True
        first.write_set(is_corner)
        if self.rounding_of_outline is None:
            _write_pairs(first, self.edges, len(self.corner))
        else:
            _write_pairs(pairs.write_floats(np.array([self.rounding])), self.edges, len(self.corner))
        write_tree(lists, self.levels, 2)
        _write_lists(lists, self.tree, self.leaf, self.listed, len(self.corner))
        bodies = [first, lists] if self.rounding_of_outline is None else [first, pairs, lists]
        layers = tuple(Layer(PAIRS_CODE, body.to_bytes()) for body in bodies)
        return Container(self.domain, layers, label=self.label).to_bytes()

    @staticmethod
    def from_bytes(data: bytes) -> "Stored":
        """What a file's bytes hold; raises ``ValueError`` saying what is wrong with them."""
        container = Container.from_bytes(data)
        _require_pairs(container)
        body, *others = (BitReader(layer.body) for layer in container.layers)
        rounding, joined, rounding_of_outline = _read_rounding(body), None, None
        outline = read_outline(body, container.domain.lo)
        corner = np.flatnonzero(body.read_set(len(outline.points)))
        if (count := len(corner)) > MOST_CORNERS:
            raise ValueError(f"it has {count} corners; at most {MOST_CORNERS} are read")
        if not body.at_end():
            joined = _read_pairs(body, count)
        else:
            rounding_of_outline = rounding
            if others:
                body = others.pop(0)
                rounding, joined = _read_rounding(body), _read_pairs(body, count)
        if not body.at_end():
            raise ValueError("it holds more data than its corners need")
        if len(others) > 1:
            raise ValueError(f"its pairs have {len(others)} layers of lists")
        leaves = levels_of(Cells.root(2))[0], np.zeros(count, np.int64), np.arange(count)
        if others:
            leaves = _read_leaves(others[0], count, max(_LEAST_ENTRIES, _MOST_ENTRIES_A_BYTE * len(data)))
        return Stored(container.domain, outline, corner, joined, *leaves, rounding, rounding_of_outline)


def most_leaves(count: int) -> int:
    """How many leaves there may be with so many corners."""
    return max(1, _MOST_NUMBERS // max(1, count))


def _require_pairs(container: Container) -> None:
    """Raise ``ValueError`` where a file is not one of pairs in the plane."""
    if any(layer.leaf_code != PAIRS_CODE for layer in container.layers):
        raise ValueError("it holds the distance to one goal; use load")
    if any(layer.proof_code for layer in container.layers) or container.folding is not None:
        raise ValueError("its pairs have proofs or folded points")
    domain = container.domain
    if domain.dim != 2 or domain.is_periodic:
        raise ValueError(f"its pairs are of points of {domain}; they ought to be of a region in the plane")
    if not domain.width.max() <= WIDEST:
        raise ValueError(f"its domain is {domain.width.max():g} wide, more than {WIDEST:g}")


def _read_rounding(body: BitReader) -> float:
    rounding = float(body.read_floats(1)[0])
    if not 0 <= rounding < np.inf:
        raise ValueError(f"its distances err by {rounding}")
    return rounding


def _write_pairs(body: BitWriter, edges: Int[np.ndarray, "edges 2"], count: int) -> None:
    """Append pairs of so many corners."""
    is_joined = np.zeros(count * (count - 1) // 2, bool)
    is_joined[_number_of_pair(edges)] = True
    body.write_set(is_joined)


def _read_pairs(body: BitReader, count: int) -> Int[np.ndarray, "edges 2"]:
    """The pairs of so many corners that come next, in order of the later one."""
    return _pair_of_number(body.read_members(count * (count - 1) // 2))


def _number_of_pair(pairs: Int[np.ndarray, "pairs 2"]) -> Int[np.ndarray, "pairs"]:
    """Places of pairs ``i < j`` among all of them, in order of ``j``, then ``i``."""
    i, j = pairs.T
    return j * (j - 1) // 2 + i


def _pair_of_number(number: Int[np.ndarray, "pairs"]) -> Int[np.ndarray, "pairs 2"]:
    """The pairs at some places."""
    j = ((1 + np.sqrt(1 + 8 * number.astype(np.float64))) // 2).astype(np.int64)
    j -= j * (j - 1) // 2 > number
    j += j * (j + 1) // 2 <= number
    return np.stack([number - j * (j - 1) // 2, j], axis=1)


def _read_leaves(
    body: BitReader, count: int, most: int
) -> tuple[list[Level], Int[np.ndarray, "entries"], Int[np.ndarray, "entries"]]:
    """The tree that comes next and its leaves' lists of some of so many corners."""
    levels = read_tree(body, 2)
    if (leaves := 1 + sum(len(level.axis) for level in levels)) > most_leaves(count):
        raise ValueError(f"it has {leaves:,} leaves and {count:,} corners, more than tables are made of")
    leaf, listed = _read_lists(body, tree_of_levels(levels, 2), count, most)
    if not body.at_end():
        raise ValueError("it holds more data than its leaves need")
    return levels, leaf, listed


def listed_by_nodes(tree: Tree, is_listed: Bool[np.ndarray, "leaves corners"]) -> Bool[np.ndarray, "nodes corners"]:
    """The corners that all leaves of each node list together."""
    of_node = np.zeros((len(tree.child), is_listed.shape[1]), bool)
    of_node[tree.node_of_leaf] = is_listed
    for split in reversed(tree.splits):
        of_node[split] = of_node[tree.child[split]] | of_node[tree.child[split] + 1]
    return of_node


def _write_lists(
    body: BitWriter, tree: Tree, leaf: Int[np.ndarray, "entries"], listed: Int[np.ndarray, "entries"], count: int
) -> None:
    """Append the leaves' lists, each node's as what its halves do not list."""
    is_listed = np.zeros((len(tree.node_of_leaf), count), bool)
    is_listed[leaf, listed] = True
    of_node = listed_by_nodes(tree, is_listed)
    body.write_set(~of_node[0])
    for split in filter(len, tree.splits):
        inherited, own = of_node[np.repeat(split, 2)], of_node[tree.halves(split)]
        body.write_set(~own[inherited])


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
        rows, node = run_members(first, parent)
        corner = corner[rows]
        if len(halves):
            stays = ~body.read_set(len(corner))
            node, corner = node[stays], corner[stays]
        nodes = halves
    leaf, listed = (np.concatenate(column) for column in zip(*parts, strict=True))
    order = np.argsort(leaf, kind="stable")
    return leaf[order], listed[order]
