"""Find touching or overlapping leaves and their shared faces; solve linear constraints between values at corners.

Pairs of leaves are found from pairs of tree nodes by replacing nodes by their children: :func:`leaf_pairs`. Pairs
that do not touch are dropped. Finite elements need shared faces and constraints: leaves that share a face must agree
on the face, which constrains their values at corners.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax.plr.tree import Cells, Rows, Tree, corner_bits

if TYPE_CHECKING:
    from scipy.sparse import csr_array

Indices: TypeAlias = Int[np.ndarray, " n"]
Leaves: TypeAlias = Int[np.ndarray, " _"]  # indices of some leaves
Pairs: TypeAlias = Int[np.ndarray, "rows pairs"]
# Function ``keep(pairs, side, half, axis)`` that returns which new pairs to follow, a mask. In each pair, the node in
# row ``side`` has just been replaced by its lower (``half`` 0) or upper (1) half along the pair's ``axis``.
Keep: TypeAlias = Callable[[Pairs, int, int, Int[np.ndarray, " pairs"]], Bool[np.ndarray, " pairs"]]


def leaf_pairs(a: Tree, b: Tree, pairs: Pairs, keep: Keep) -> Int[np.ndarray, "rows leaf_pairs"]:
    """Find pairs of leaves, such as overlapping ones, by descending two trees at once from pairs of nodes.

    Each step replaces a pair by two pairs, one for each half of its larger node. If the larger node is a leaf, the
    other node is halved. ``keep`` tells which new pairs to follow. A column of ``pairs`` has a node of ``a``, a node
    of ``b`` and, in further rows, any data that new pairs copy. The columns of the result have indices of leaves
    instead of nodes.
    """
    trees = a, b
    finished = [pairs[:, :0]]
    depths = [tree.cells.depth.sum(axis=1) for tree in trees]
    while pairs.shape[1]:
        # 1. Put aside the pairs of two leaves. Choose the node to split: the less deep one, if it is no leaf.
        #    (`pairs` may have rows of data, without a tree.)
        is_inner = np.stack([tree.child[nodes] >= 0 for tree, nodes in zip(trees, pairs, strict=False)])
        finished.append(pairs[:, ~is_inner.any(axis=0)])
        splits_a = is_inner[0] & (~is_inner[1] | (depths[0][pairs[0]] <= depths[1][pairs[1]]))
        # 2. Replace the node by either half.
        children = []
        for side, is_split in enumerate((splits_a, is_inner.any(axis=0) & ~splits_a)):
            parents = pairs[:, is_split]
            axis = trees[side].axis[parents[side]]
            for half in range(2):
                child = parents.copy()
                child[side] = trees[side].child[parents[side]] + half
                children.append(child[:, keep(child, side, half, axis)])
        pairs = np.concatenate(children, axis=1)
    leaves = np.concatenate(finished, axis=1)
    for side, tree in enumerate(trees):
        leaves[side] = tree.leaf_of_node[leaves[side]]
    return leaves


def overlap(a: Cells, i: Indices, b: Cells, j: Indices, axis: Indices) -> Bool[np.ndarray, " n"]:
    """Return, for each ``k``, whether cell ``i[k]`` of ``a`` and cell ``j[k]`` of ``b`` overlap along ``axis[k]``."""
    # One interval then contains the other: both have the same position at the lower one of their depths.
    common = np.minimum(a.depth[i, axis], b.depth[j, axis])
    return a.position[i, axis] >> (a.depth[i, axis] - common) == b.position[j, axis] >> (b.depth[j, axis] - common)


def overlapping_leaves(a: Tree, b: Tree) -> Int[np.ndarray, "2 pairs"]:
    """Return all pairs of a leaf of ``a`` and a leaf of ``b`` whose cells overlap."""

    def keep(pairs: Pairs, side: int, half: int, axis: Indices) -> Bool[np.ndarray, " pairs"]:
        return overlap(a.cells, pairs[0], b.cells, pairs[1], axis)

    return leaf_pairs(a, b, np.zeros((2, 1), np.int64), keep)


ZERO = 1e-9  # smaller weights are rounding errors: exact weights are multiples of a far larger power of two


def resolve_constraints(step: "csr_array", dependent: Indices) -> "csr_array":
    """Return the square matrix that computes all values from the values that are not ``dependent``.

    For each index ``i`` in ``dependent``, value ``i`` is a weighted sum of other values. Row ``i`` of ``step`` has
    the weights; its other rows are empty. No value may depend on itself.
    """
    from scipy.sparse import csr_array, diags_array

    # Squaring the matrix substitutes every value by its sum at once, so that the number of substitutions doubles. It
    # ends, since there are no cycles: then all rows name free values only. Rows of free values are unit vectors.
    is_free = np.isin(np.arange(len(step.indptr) - 1), dependent, invert=True).astype(float)
    step = csr_array(step + diags_array(is_free))
    while step[:, dependent].nnz:
        step = csr_array(step @ step)
        step.eliminate_zeros()
    return step


def eliminate_constraints(rows: "csr_array", level: Int[np.ndarray, " variables"], most_weights: int) -> "csr_array":
    """Return a square matrix ``m`` with ``rows @ m == 0``; it maps any values to solutions of these equations.

    Each row is an equation, and is solved for its variable of the highest ``level``, a number given for each
    variable. Among several such variables, the one with the largest absolute weight is chosen; among equal weights,
    the first. ``ValueError`` if this takes more than ``most_weights`` additions. ``rows`` is modified: weights up to
    ``ZERO`` become 0.
    """
    from scipy.sparse import csr_array

    # Gauss-Jordan elimination. For each equation, sum(row[i] * x[i]) == 0:
    #   1. replace each solved variable in it by its solution;
    #   2. solve it for its pivot: x[pivot] = -sum over the others of row[i] / row[pivot] * x[i];
    #   3. replace the pivot in all earlier solutions that use it, so that solutions name unsolved variables only.
    # An equation that is empty after step 1 follows from the earlier ones.
    solved: dict[int, dict[int, float]] = {}  # eliminated variable -> combination of others
    uses: dict[int, set[int]] = {}  # variable -> eliminated variables that use it
    rows.data[np.abs(rows.data) <= ZERO] = 0
    rows.eliminate_zeros()
    work = 0
    for start, end in zip(rows.indptr[:-1], rows.indptr[1:], strict=True):
        row: dict[int, float] = {}
        for index, weight in zip(rows.indices[start:end].tolist(), rows.data[start:end].tolist(), strict=True):
            work += _add(row, weight, solved.get(index, {index: 1.0}))
        check_num_weights(work, most_weights)
        if not row:
            continue
        pivot = max(row, key=lambda index: (level[index], abs(row[index]), -index))
        scale = row.pop(pivot)
        solution = {index: -weight / scale for index, weight in row.items()}
        # `uses` may also name variables in whose solutions the weight of the pivot has canceled.
        earlier = [user for user in uses.pop(pivot, ()) if pivot in solved[user]]
        solved[pivot] = solution
        for user in earlier:
            work += _add(solved[user], solved[user].pop(pivot), solution)
        for index in solution:
            uses.setdefault(index, set()).update([pivot, *earlier])
    # The matrix: rows of solved variables have their solutions, all other rows are unit vectors.
    table = [(pivot, index, weight) for pivot, row in solved.items() for index, weight in row.items()]
    pivots, index, weight = np.array(table).reshape(-1, 3).T
    free = np.setdiff1d(np.arange(len(level)), np.array(list(solved), np.int64))
    coordinates = np.concatenate([pivots, free]).astype(int), np.concatenate([index, free]).astype(int)
    return csr_array((np.concatenate([weight, np.ones(len(free))]), coordinates), (len(level), len(level)))


def _add(row: dict[int, float], factor: float, other: dict[int, float]) -> int:
    """Add ``factor * other`` to the sparse ``row`` in place; return the number of weights in ``other``.

    A sparse row maps indices to weights.
    """
    for index, weight in other.items():
        total = row.get(index, 0.0) + factor * weight
        if abs(total) > ZERO:
            row[index] = total
        else:
            row.pop(index, None)
    return len(other)


def check_num_weights(number: int | float, most: int) -> None:
    if number > most:
        expected = f"the constraints of its tied leaves may have at most {most} weights"
        advice = "Build it with fewer leaves, in fewer dimensions, or with planes, which are not tied"
        raise ValueError(f"{expected}, got {number:.3g} or more. {advice}")


_TOUCH = 2.0**-20  # counted as length of a contact along an axis on which cells only touch; in finest cell widths


def neighbor_of_largest_contact(tree: Tree, borrowers: Leaves, donors: Leaves, periodic: tuple[bool, ...]) -> Leaves:
    """For each leaf in ``borrowers``, find the leaf in ``donors`` with which it shares the largest face.

    A shared edge or corner counts as a tiny face. Leaves are indices; the result is -1 if no donor touches the leaf.
    """
    cells = tree.leaves
    borrower, donor = pairs = touching_leaves(tree, borrowers, donors, periodic)
    # Of several assignments to one leaf, the last counts: the largest contact and, among equal ones, the first leaf.
    order = np.lexsort((-donor, _contacts(cells, cells.depth.max(axis=0), pairs, periodic)))
    donor_of = np.full(len(cells), -1)
    donor_of[borrower[order]] = donor[order]
    return donor_of[borrowers]


def touching_leaves(tree: Tree, some: Leaves, others: Leaves, periodic: tuple[bool, ...]) -> Pairs:
    """Return all pairs of a leaf in ``some`` and a leaf in ``others`` that share a face, an edge or a corner.

    Leaves are given and returned by their indices.
    """
    # A pair of nodes stays if they touch or overlap, the first contains a leaf in ``some``, and the second contains a
    # leaf in ``others``.
    finest = tree.cells.depth.max(axis=0)
    holds = np.zeros((2, len(tree.child)), bool)
    holds[0, tree.node_of_leaf[some]] = holds[1, tree.node_of_leaf[others]] = True
    for splits in reversed(tree.splits):
        holds[:, splits] = holds[:, tree.child[splits]] | holds[:, tree.child[splits] + 1]

    def keep(pairs: Pairs, side: int, half: int, axis: Int[np.ndarray, " pairs"]) -> Bool[np.ndarray, " pairs"]:
        stays = holds[0][pairs[0]] & holds[1][pairs[1]]
        stays[stays] = _contacts(tree.cells, finest, pairs[:, stays], periodic) > 0
        return stays

    # Begin with the root and itself, or with no pair if it contains no leaf of one kind.
    return leaf_pairs(tree, tree, np.zeros((2, int(holds[0][0] & holds[1][0])), np.int64), keep)


def _contacts(cells: Cells, finest: Indices, pairs: Pairs, periodic: tuple[bool, ...]) -> Float[np.ndarray, " pairs"]:
    """Return a measure of contact of the two cells of each pair; 0 for cells that are apart.

    The measure is the product, over the axes, of the length along which both cells overlap, in fractions of the
    domain. Along an axis on which cells only touch, the length counts as ``_TOUCH`` widths of a finest cell. So a
    shared face gets its size times one tiny factor; a shared edge or corner has several tiny factors. ``finest`` has
    the largest depth of cells along each axis.
    """
    # Along an axis, in widths of finest cells:
    #     lo[0] ------------- hi[0]
    #                lo[1] ------------- hi[1]
    #                low      high                cells touch if low == high, and are apart if low > high
    contact = np.ones(pairs.shape[1])
    for axis in range(cells.dim):
        width_bits = finest[axis] - cells.depth[pairs, axis]  # (2, pairs)
        lo = cells.position[pairs, axis] << width_bits
        hi = (cells.position[pairs, axis] + 1) << width_bits
        low, high = lo.max(axis=0), hi.min(axis=0)
        touches = high == low
        if periodic[axis]:  # cells at both ends of the axis touch across the seam
            touches |= (high < low) & (lo.min(axis=0) == 0) & (hi.max(axis=0) == 1 << finest[axis])
        contact *= np.where(touches, _TOUCH, np.maximum(high - low, 0)) / 2.0 ** finest[axis]
    return contact


# Trees have at most max(_MOST_FACES, _MOST_FACES_OF_LEAF * leaves) shared faces.
_MOST_FACES = 2**18
_MOST_FACES_OF_LEAF = 2**7


@dataclass(frozen=True, eq=False)
class SharedFaces(Rows):
    """Faces between two leaves, perpendicular to ``axis``: leaf ``lower`` ends and leaf ``upper`` begins there."""

    # Across the ends of a periodic axis, the lower leaf is at the upper end; a leaf that spans it is on both sides.
    lower: Int[np.ndarray, " faces"]
    upper: Int[np.ndarray, " faces"]
    axis: Int[np.ndarray, " faces"]


def shared_faces(tree: Tree, periodic: tuple[bool, ...] = ()) -> SharedFaces:
    """Return all faces that two leaves share, sorted by lower leaf, then upper leaf, then axis.

    Along periodic axes, leaves at both ends of the domain share faces, too. ``ValueError`` if there are too many
    faces.
    """
    most = max(_MOST_FACES, _MOST_FACES_OF_LEAF * len(tree.node_of_leaf))
    # Start at the halves of every split, and at the root with itself across each periodic seam. A column has the node
    # below the face, the node above it, and the face's axis.
    split = np.flatnonzero(tree.child >= 0)
    pairs = np.stack([tree.child[split], tree.child[split] + 1, tree.axis[split]])
    seams = np.flatnonzero(periodic)
    pairs = np.concatenate([pairs, np.stack([0 * seams, 0 * seams, seams])], axis=1)

    def keep(pairs: Pairs, side: int, half: int, axis: Int[np.ndarray, "pairs"]) -> Bool[np.ndarray, "pairs"]:
        if pairs.shape[1] > most:
            message = f"its {len(tree.node_of_leaf)} leaves share more than {most} faces. Build it with fewer leaves"
            raise ValueError(message)
        # If the split is along the face's axis, only the half next to the face touches the face: the upper half (1)
        # of the node below (side 0), the lower half of the node above. Else the half must overlap the other node.
        return np.where(axis == pairs[2], half != side, overlap(tree.cells, pairs[0], tree.cells, pairs[1], axis))

    faces = leaf_pairs(tree, tree, pairs, keep)  # rows: lower leaf, upper leaf, axis
    return SharedFaces(*faces[:, np.lexsort(faces[::-1])])


def face_points(cells: Cells, faces: SharedFaces, w: Float[np.ndarray, "k dim"]) -> Float[np.ndarray, "faces k dim"]:
    """Return ``k`` points of each face, as fractions of the domain.

    ``w`` has the positions of the points in a face, from 0 to 1 along each axis; the coordinate across the face has
    no effect.
    """
    # A face is the intersection of both leaves' sides. Along its axis, it is where the lower leaf ends.
    lo, hi = cells.fractions
    low = np.maximum(lo[faces.lower], lo[faces.upper])
    high = np.minimum(hi[faces.lower], hi[faces.upper])
    row = np.arange(len(faces))
    low[row, faces.axis] = high[row, faces.axis] = hi[faces.lower, faces.axis]
    return low[:, None] + (high - low)[:, None] * w


def nodes_in_faces(
    cells: Cells, faces: SharedFaces, axis: int, nodes: Float[np.ndarray, "nodes dim"]
) -> tuple[Pairs, Float[np.ndarray, "2 points dim"]]:
    """Return certain points of all faces perpendicular to ``axis``, as points of both leaves that share the face.

    ``nodes`` are positions in a cell, from 0 to 1 along each axis, such as its corners. Nodes with coordinate 0 along
    ``axis`` give the points, scaled to the part of the face that both leaves share. The results have the leaf of each
    point, and the point's position in the leaf, from 0 to 1 along each axis. Index 0 on their first axis is for the
    lower leaf, index 1 for the upper leaf.
    """
    faces = faces[faces.axis == axis]
    x = face_points(cells, faces, nodes[nodes[:, axis] == 0])
    leaf = np.repeat(np.stack([faces.lower, faces.upper]), x.shape[1], axis=1)
    t = np.ldexp(x.reshape(-1, cells.dim), cells.depth[leaf]) - cells.position[leaf]
    t[:, :, axis] = [[1.0], [0.0]]  # exact, also across a periodic seam
    return leaf, t


def leaves_at_corners(tree: Tree) -> Int[np.ndarray, "nodes corners"]:
    """Return, for each node of a tree and each corner of the node's cell, the index of the leaf in this corner."""
    # Upward from the leaves: the leaf in a corner of a split node is in the same corner of one of its halves.
    bits = corner_bits(tree.cells.dim)
    leaf_at = np.repeat(tree.leaf_of_node[:, None], len(bits), axis=1)
    for split in reversed(tree.splits):
        half = tree.child[split][:, None] + bits[:, tree.axis[split]].T
        leaf_at[split] = leaf_at[half, np.arange(len(bits))]
    return leaf_at


def corner_parents(tree: Tree) -> tuple[Int[np.ndarray, "leaves corners 2"], Bool[np.ndarray, "leaves corners"]]:
    """Return, for each corner of each leaf, the two ends of the edge that a split halved to create the corner.

    Ends are corners of leaves, numbered ``leaf * 2**dim + corner``. The second result is False for corners of the
    domain, which no split created.
    """
    #     end 0 ------- corner ------- end 1        an edge of the node ``made_by``, which was halved along this edge:
    #       lower half    |    upper half           the ends are corners of this node
    bits = corner_bits(tree.cells.dim)  # (corners, dim) of 0 and 1
    corners = np.arange(len(bits))
    # 1. From the root down: the node whose split made each corner of each node. A half keeps the corners on its outer
    #    side.
    origin = np.full((len(tree.child), len(bits)), -1)
    for split in tree.splits:
        for half in range(2):
            stays = (bits == half)[:, tree.axis[split]].T
            origin[tree.child[split] + half] = np.where(stays, origin[split], split[:, None])
    # 2. The ends of the halved edge: clear and set the corner's bit of the split axis. For corners of the domain,
    #    this has no meaning.
    made_by = origin[tree.node_of_leaf]
    across = (1 << np.arange(tree.cells.dim)[::-1])[tree.axis[made_by]]
    ends = np.stack([corners & ~across, corners | across], axis=-1)
    return leaves_at_corners(tree)[made_by[..., None], ends] * len(bits) + ends, made_by >= 0
