"""What the file of a PairPLR holds, and its layout.

It is a PLR file (see ``plr/file/container.py``) of two layers, whose leaf model has the code 7. The first one, from
which all distances follow, is:

    the largest error of a distance from the rounding of the points to the outline's lattice, a 32-bit float
    the outline of free space (see ``outline.py``)
    which of its points are corners, a set
    which pairs of corners are joined, a set of the pairs in order of the later corner

The second one is what makes queries quick. Where it was cut off, there is one leaf, which lists all corners.

    the tree over the leaves
    the corners that are listed: for the root those that it leaves out of all, a set; then for the halves of the split
      nodes of each level, those that they leave out of their parent's, a set a level
"""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from plr_jax._arrays import run_members
from plr_jax.geometry.box import Box
from plr_jax.plr.file.bits import BitReader, BitWriter
from plr_jax.plr.file.container import PAIRS_CODE, Container, Layer
from plr_jax.plr.file.tree import read_tree, write_tree
from plr_jax.plr.pairs.outline import Outline, read_outline
from plr_jax.plr.partition.cells import Cells
from plr_jax.plr.partition.tree import Level, Tree, levels_of, tree_of_levels

if TYPE_CHECKING:
    from plr_jax.geometry.workspace import Workspace

MOST_CORNERS = 2**13
WIDEST = 1e18
"""Width of the widest domain: squares of distances stay within 32-bit floats."""
_MOST_ENTRIES_A_BYTE, _LEAST_ENTRIES = 2**8, 2**20


@dataclass(frozen=True, eq=False)
class Stored:
    """What a file holds.

    Attributes:
        domain: The box.
        outline: Free space.
        corner: Points of the outline that are corners, ascending.
        edges: Pairs of corners that a shortest path may join straight, the earlier one first.
        levels: The tree over the leaves.
        leaf: The leaf of each entry of a list, in the order of the tree's traversal.
        listed: Its corner; ascending in a leaf.
        rounding: The largest error of a distance from the rounding of the points to the outline's lattice.
    """

    domain: Box
    outline: Outline
    corner: Int[np.ndarray, "corners"]
    edges: Int[np.ndarray, "edges 2"]
    levels: list[Level]
    leaf: Int[np.ndarray, "entries"]
    listed: Int[np.ndarray, "entries"]
    rounding: float

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
    def distances(self) -> Float[np.ndarray, "corners corners"]:
        """Shortest distances between corners; ``inf`` where there is no path."""
        return shortest_distances(self.points, self.edges)

    @property
    def workspace(self) -> "Workspace":
        """The workspace whose free space the outline bounds, with corners on the outline's lattice."""
        import shapely  # which a query does not need

        from plr_jax.geometry.workspace import Workspace

        domain = self.domain
        walls = shapely.box(*domain.lo, *domain.hi).difference(self.outline.region)
        squeeze = self.outline.may_squeeze
        return Workspace(domain, [part for part in shapely.get_parts(walls) if part.area], squeeze=squeeze)

    def to_bytes(self) -> bytes:
        """The bytes of the file."""
        body, count = BitWriter(), len(self.corner)
        body.write_floats(np.array([self.rounding]))
        self.outline.write(body)
        is_corner = np.zeros(len(self.outline.points), bool)
        is_corner[self.corner] = True
        body.write_set(is_corner)
        is_joined = np.zeros(count * (count - 1) // 2, bool)
        is_joined[_number_of_pair(self.edges)] = True
        body.write_set(is_joined)
        lists = BitWriter()
        write_tree(lists, self.levels, 2)
        _write_lists(lists, self.tree, self.leaf, self.listed, count)
        layers = Layer(PAIRS_CODE, body.to_bytes()), Layer(PAIRS_CODE, lists.to_bytes())
        return Container(self.domain, layers).to_bytes()

    @staticmethod
    def from_bytes(data: bytes) -> "Stored":
        """What a file's bytes hold; raises ``ValueError`` saying what is wrong with them."""
        container = Container.from_bytes(data)
        if any(layer.leaf_code != PAIRS_CODE for layer in container.layers):
            raise ValueError("it holds the distance to one goal; use load")
        first, *others = container.layers
        if len(others) > 1 or any(layer.proof_code for layer in container.layers) or container.folding is not None:
            raise ValueError(f"its pairs have {len(others)} layers of lists, proofs or folded points")
        domain = container.domain
        if domain.dim != 2 or domain.is_periodic:
            raise ValueError(f"its pairs are of points of {domain}; they ought to be of a region in the plane")
        if not domain.width.max() <= WIDEST:
            raise ValueError(f"its domain is {domain.width.max():g} wide, more than {WIDEST:g}")
        body = BitReader(first.body)
        rounding = float(body.read_floats(1)[0])
        if not 0 <= rounding < np.inf:
            raise ValueError(f"its distances err by {rounding}")
        outline = read_outline(body, domain.lo)
        corner = np.flatnonzero(body.read_set(len(outline.points)))
        count = len(corner)
        if count > MOST_CORNERS:
            raise ValueError(f"it has {count} corners; at most {MOST_CORNERS} are read")
        edges = _pair_of_number(np.flatnonzero(body.read_set(count * (count - 1) // 2)))
        if not body.at_end():
            raise ValueError("it holds more data than its corners need")
        levels, leaf, listed = levels_of(Cells.root(2))[0], np.zeros(count, np.int64), np.arange(count)
        if others:
            body = BitReader(others[0].body)
            levels = read_tree(body, 2)
            most = max(_LEAST_ENTRIES, _MOST_ENTRIES_A_BYTE * len(data))
            leaf, listed = _read_lists(body, tree_of_levels(levels, 2), count, most)
            if not body.at_end():
                raise ValueError("it holds more data than its leaves need")
        return Stored(domain, outline, corner, edges, levels, leaf, listed, rounding)


def shortest_distances(
    points: Float[np.ndarray, "n 2"], edges: Int[np.ndarray, "edges 2"]
) -> Float[np.ndarray, "n n"]:
    """Shortest distances between points some of which are joined; ``inf`` where there is no path."""
    if not len(points):
        return np.zeros((0, 0))
    start, end = edges.T
    lengths = np.linalg.norm(points[start] - points[end], axis=1)
    return dijkstra(coo_array((lengths, (start, end)), shape=2 * (len(points),)).tocsr(), directed=False)


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


def _write_lists(
    body: BitWriter, tree: Tree, leaf: Int[np.ndarray, "entries"], listed: Int[np.ndarray, "entries"], count: int
) -> None:
    """Append the leaves' lists: a node's list is that of both its halves together."""
    is_listed = np.zeros((len(tree.child), count), bool)
    is_listed[tree.node_of_leaf[leaf], listed] = True
    for split in reversed(tree.splits):
        is_listed[split] = is_listed[tree.child[split]] | is_listed[tree.child[split] + 1]
    body.write_set(~is_listed[0])
    for split in filter(len, tree.splits):
        inherited, own = is_listed[np.repeat(split, 2)], is_listed[_halves(tree, split)]
        body.write_set(~own[inherited])


def _read_lists(
    body: BitReader, tree: Tree, count: int, most: int
) -> tuple[Int[np.ndarray, "entries"], Int[np.ndarray, "entries"]]:
    """The leaves' lists that come next; raises ``ValueError`` where they have more entries than a level may have."""
    corner = np.flatnonzero(~body.read_set(count))
    nodes, node, parts = np.zeros(1, np.int64), np.zeros(len(corner), np.int64), []
    for split in tree.splits:
        place = tree.leaf_of_node[nodes[node]]
        parts.append((place[place >= 0], corner[place >= 0]))
        halves = _halves(tree, split)
        first = np.searchsorted(node, np.arange(len(nodes) + 1))
        parent = np.repeat(np.searchsorted(nodes, split), 2)
        if int((first[parent + 1] - first[parent]).sum()) > most:
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


def _halves(tree: Tree, split: Int[np.ndarray, "splits"]) -> Int[np.ndarray, "halves"]:
    """Both halves of some nodes, side by side."""
    return (tree.child[split][:, None] + np.arange(2)).ravel()
