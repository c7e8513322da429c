"""Conversion of a PairPLR and a goal to an ordinary PLR with a cone in each leaf."""

from collections.abc import Callable
from itertools import product

import numpy as np
from jaxtyping import Float, Int

from plr_jax._types import ArrayLike, Sources
from plr_jax.pairs.stored import PairsFileData
from plr_jax.plr._file import DecodedFile
from plr_jax.plr._plr import PLR, plr_of_leaves
from plr_jax.plr.leaves import ConeFiles, leaf_model
from plr_jax.plr.tree import Cells, Tree, tree_of

_SAMPLES = 0.96 * np.array(list(product((-1, 0, 1), repeat=2)))  # a grid just inside a leaf, in local coordinates
_HALVINGS = 4  # times that a leaf may be halved if no cone fits it well
_DEPTH = 13  # or more times, if these and the depth of a balanced tree of the file's leaves are at most so many
_MAX_AXIS_DEPTH = 13  # halvings of the domain along an axis
_NEGLIGIBLE = 1e-5  # acceptable mean error of a cell, in domain widths
_ROUNDING = 1e-6  # more than a query's error, relative to the distance plus the domain width
PairFn = Callable[[ArrayLike, ArrayLike], ArrayLike]
ToCorners = Float[np.ndarray, "corners"]
Point = Float[np.ndarray, "2"]


def plr_to(stored: PairsFileData, pairs: PairFn, to_corners: ToCorners, goal: Point) -> PLR:
    """Return the distance to a goal as a PLR with a cone in each leaf.

    ``pairs`` computes the distance between any two points, and ``to_corners`` has the distance from the goal to each
    corner. A cone is the distance to its apex, a corner or the goal, plus the distance from the apex to the goal.
    Each leaf gets the cone that fits it best, and is halved a few times if no cone fits well.
    """
    domain = stored.domain
    sources = _sources(stored, to_corners, goal)
    # 1. Accept cells that a cone fits well, and halve the other cells, a few times.
    cells = stored.cells
    leaf = np.arange(len(cells))  # the leaf of the file that holds each cell
    most = max(_HALVINGS, _DEPTH - (len(cells) - 1).bit_length())
    accepted = []
    for halvings in range(most + 1):
        source, error = _best_sources(stored, pairs, sources, cells, leaf)
        is_poor = (error > _NEGLIGIBLE * domain.width.max()) & (cells.depth.max(axis=1) < _MAX_AXIS_DEPTH)
        is_poor &= halvings < most
        accepted.append((cells[~is_poor], source[~is_poor]))
        poor = cells[is_poor]
        cells, leaf = poor.split(poor.longest_axis(domain)), np.repeat(leaf[is_poor], 2)
    first, *others = (cells for cells, _ in accepted)
    cells, source = first.append(*others), np.concatenate([source for _, source in accepted])
    if (source < 0).all():
        raise ValueError(f"No leaf reaches the goal {goal.tolist()}: move it into free space.")
    # 2. Merge cells with the same cone. A tree has its leaves in an order of its own.
    tree = tree_of(cells)
    cells, source = _merge_halves(tree, source[tree.order])
    tree = tree_of(cells)
    cones = ConeFiles(sources, domain).stored(source[tree.order])
    return plr_of_leaves(DecodedFile(domain, leaf_model("cone"), tree, cones))


def _sources(stored: PairsFileData, to_corners: ToCorners, goal: Point) -> Sources:
    """Return the goal (source 0) and all corners (source ``1 + i`` is corner ``i``) as sources of cones.

    Each source has its distance to the goal, and the next turn of the shortest path. A corner whose next turn is not
    found gets the distance ``inf``.
    """
    # 1. The next turn is the goal if the distance is the length of a straight line, up to rounding.
    points = np.concatenate([goal[None], stored.points])
    distances = np.append(0.0, to_corners)
    slack = _ROUNDING * (distances + stored.domain.width.max())
    parents = np.where(distances <= np.linalg.norm(points - goal, axis=1) + slack, 0, -1)  # -1: not yet known
    # 2. Find edges from start to end along which a shortest path may go: |start - end| + distance(end) is the
    #    distance of start, up to rounding. Follow them only towards the goal, so that no cycles arise. Long paths
    #    come first.
    start, end = 1 + np.concatenate([stored.edges, stored.edges[:, ::-1]]).T
    onward = np.linalg.norm(points[start] - points[end], axis=1) + distances[end]
    leads_on = (onward <= distances[start] + slack[start]) & (distances[end] < distances[start])
    edges = np.flatnonzero(leads_on & np.isfinite(onward))
    edges = edges[np.argsort(-onward[edges], kind="stable")]
    # 3. Extend the tree of paths by edges to corners whose next turn is known, until no edge extends it.
    while len(next_edges := edges[(parents[start[edges]] < 0) & (parents[end[edges]] >= 0)]):
        parents[start[next_edges]] = end[next_edges]  # the last assignment wins: the shortest path
    distances[parents < 0] = np.inf  # paths only start there, so no leaf may use the corner
    return Sources.of_graph(points, distances, parents)


def _best_sources(
    stored: PairsFileData, pairs: PairFn, sources: Sources, cells: Cells, leaf: Int[np.ndarray, " cells"]
) -> tuple[Int[np.ndarray, " cells"], Float[np.ndarray, " cells"]]:
    """Return the index in ``sources`` of the apex whose cone has the least mean error in each cell, and this error.

    Possible apexes of cell ``i`` are the goal, and the corners that leaf ``leaf[i]``, which holds the cell, lists.
    The result is -1 and 0 for a cell without a cone.
    """
    # 1. Compute distances of sample points, `inf` outside free space.
    x = cells.points(_SAMPLES, stored.domain)
    distance = np.full(x.shape[:2], np.inf)
    is_free = stored.outline.contains(x.reshape(-1, 2)).reshape(x.shape[:2])
    distance[is_free] = pairs(x[is_free], sources.points[0])
    # 2. Pair each cell with its sources, first with the goal, source 0.
    cell, corner = stored.lists[leaf].nonzero()
    cell = np.concatenate([np.arange(len(cells)), cell])
    source = np.concatenate([np.zeros(len(cells), np.int64), 1 + corner])
    # 3. Compare each pair's cone with the distances at the samples, and take the pair of least error of each cell.
    cone = sources.distances[source, None] + np.linalg.norm(x[cell] - sources.points[source, None], axis=2)
    with np.errstate(invalid="ignore"):
        error = np.where(np.isfinite(distance[cell]), np.abs(cone - distance[cell]), 0.0).mean(axis=1)
    order = np.lexsort((error, cell))
    best = order[np.searchsorted(cell[order], np.arange(len(cells)))]
    has_cone = np.isfinite(distance).any(axis=1) & np.isfinite(sources.distances[source[best]])
    return np.where(has_cone, source[best], -1), np.where(has_cone, error[best], 0.0)


def _merge_halves(tree: Tree, source: Int[np.ndarray, " leaves"]) -> tuple[Cells, Int[np.ndarray, " kept"]]:
    """Merge both halves of a cell, again and again, if their cones have the same apex.

    ``source`` is the apex of each leaf of ``tree``, as an index. Return the cells that are left, and their apexes.
    """
    # 1. From the leaves up: a node's apex, -2 if its leaves have several.
    apex = np.full(len(tree.child), -2)
    apex[tree.node_of_leaf] = source
    for split in reversed(tree.splits):
        lower, upper = apex[tree.child[split]], apex[tree.child[split] + 1]
        apex[split] = np.where(lower == upper, lower, -2)
    # 2. Keep the largest nodes with one apex: the root, or halves of nodes with several.
    largest = np.append(0, tree.halves(np.flatnonzero(apex == -2)))
    merged = np.sort(largest[apex[largest] > -2])
    return tree.cells[merged], apex[merged]
