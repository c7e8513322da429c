"""Construction of a PairPLR of a planar workspace.

1. Round the boundary of free space to a lattice and find the corners that shortest paths may join.
2. Halve cells and list, for each leaf, the corners at which shortest paths from it may turn first.

A query tries the corners that its point's leaf lists, and drops those that the point does not see. Only corners that
see a part of the leaf, but not all of it, can be tried in vain. So the cells with the largest product of free area
and number of such corners are halved first.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from plr_jax._arrays import shortened, take_ragged
from plr_jax.geometry.boundary import Boundary
from plr_jax.geometry.box import Box
from plr_jax.geometry.cell_sight import CellSources, corner_sight, corners_of_cells, turns_by_triangle
from plr_jax.geometry.convex_pieces import areas
from plr_jax.geometry.corners import CornerVisibility, corner_visibility
from plr_jax.geometry.triangulation import Triangulation
from plr_jax.geometry.vectors import pseudo_angle
from plr_jax.geometry.workspace import Workspace
from plr_jax.pairs.portable import MARGIN, RECEDING
from plr_jax.pairs.stored import MOST_CORNERS, WIDEST, Outline, PairsFileData, distances_by_rows, most_leaves
from plr_jax.plr.certificate import Proof
from plr_jax.plr.container import frame_size
from plr_jax.plr.growth import Limits, grow
from plr_jax.plr.leaves import leaf_model
from plr_jax.plr.leaves.base import check_limits
from plr_jax.plr.tree import Cells, tree_of

DEFAULT_MAX_BYTES = 2**16
_SLACK = 8  # number of workspace tolerances by which visibility may err
_FINEST = 2.0**-24  # finest lattice step, in domain widths: the resolution of 32-bit floats


def outline_of(
    boundary: Boundary, origin: Float[np.ndarray, "2"], width: float, tolerance: float, may_squeeze: bool
) -> tuple[Outline, Int[np.ndarray, "points"]]:
    """Return the outline of a boundary, rounded to a lattice, and the boundary vertex at each outline point."""
    # 1. Find the next edge of each edge's ring: the edge whose sector it closes. If paths may squeeze through
    #    contacts, it is the next edge around the same obstacle instead.
    edges = boundary.edges
    leaving = {
        (int(at), int(end)): i for i, (at, end) in enumerate(zip(edges[:, 0], boundary.sector_end, strict=True))
    }
    onward = np.array([leaving[b, a] for a, b in edges.tolist()])
    if may_squeeze:
        direction = boundary.segments[:, 1] - boundary.segments[:, 0]
        angle = pseudo_angle(direction[:, 0], direction[:, 1])
        following = np.arange(len(edges))
        for vertex in boundary.contacts:
            around = np.flatnonzero(edges[:, 0] == vertex)
            around = around[np.argsort(angle[around])]
            following[around] = np.roll(around, -1)
        onward = following[onward]
    # 2. Follow the rings, and round their points to the lattice.
    vertex, first, is_done = [], [0], np.zeros(len(edges), bool)
    for start in range(len(edges)):
        edge = start
        while not is_done[edge]:
            is_done[edge] = True
            vertex.append(edges[edge, 0])
            edge = onward[edge]
        if len(vertex) > first[-1]:
            first.append(len(vertex))
    index = np.array(vertex)
    step = lattice_step(boundary.vertices - origin, width, tolerance)
    points = distinct_lattice_points((boundary.vertices - origin) / step, edges)[index]
    return Outline(origin, step, points, np.array(first), may_squeeze), index


def distinct_lattice_points(x: Float[np.ndarray, "n 2"], edges: Int[np.ndarray, "edges 2"]) -> Int[np.ndarray, "n 2"]:
    """Round points to integers; a point whose place is taken moves to a free neighbor, away from the other point.

    Only the ends of edges that round to nothing share a place (or, rarely, points with all eight neighbors taken). So
    walls that merely come close stay apart, and walls with a common place really touch.
    """
    points, num = np.rint(x).astype(np.int64), len(x)
    short = edges[(points[edges[:, 0]] == points[edges[:, 1]]).all(axis=1)]
    graph = coo_array((np.ones(len(short)), short.T), shape=(num, num))
    _, member, group = np.unique(connected_components(graph)[1], return_index=True, return_inverse=True)
    x, points = x[member], points[member]
    _, first, place = np.unique(points, axis=0, return_index=True, return_inverse=True)
    taken, around = (
        set(map(tuple, points[first].tolist())),
        np.delete(np.stack(np.divmod(np.arange(9), 3)).T - 1, 4, 0),
    )
    for i in np.setdiff1d(np.arange(len(points)), first):
        away = around @ (x[i] - x[first[place.ravel()[i]]]) / np.linalg.norm(around, axis=1)
        sites = map(tuple, (points[i] + around[np.argsort(-away)]).tolist())
        points[i] = site = next((site for site in sites if site not in taken), tuple(points[i]))
        taken.add(site)
    return points[group]


def lattice_step(points: Float[np.ndarray, "n 2"], width: float, tolerance: float) -> float:
    """Return the largest lattice step that keeps points distinct and moves no coordinate by more than the tolerance.

    Steps are powers of two or ten. If no step fits, return the finest: about ``2**-24`` of the width.
    """
    exponents = np.arange(-60, 60)
    steps = np.concatenate([2.0**exponents, 10.0 ** exponents[40:80]])
    for step in np.sort(steps[(steps <= width) & (steps >= _FINEST * width)])[::-1]:
        steps_away = np.rint(points / step)
        is_near = np.abs(points - step * steps_away).max(initial=0.0) <= tolerance
        if is_near and len(np.unique(steps_away, axis=0)) == len(points):
            return float(step)
    return float(2.0 ** np.floor(np.log2(_FINEST * width)))


_SHARE = 0.25  # share of the largest key above which cells are halved together
_IN_VAIN = 0.1  # mean number of listed corners that a point does not see; fewer make queries no faster


@dataclass(frozen=True, eq=False)
class Lists:
    """Cells, and for each the list of the corners at which shortest paths from it may turn first.

    ``cell`` (ascending) and ``corner`` belong to each list entry; ``by_all`` tells whether all of the cell is known
    to see the corner.
    """

    cells: Cells
    cell: Int[np.ndarray, "entries"]
    corner: Int[np.ndarray, "entries"]
    by_all: Bool[np.ndarray, "entries"]

    def of_cells(self, rows: Int[np.ndarray, "some"]) -> "Lists":
        first = np.searchsorted(self.cell, np.arange(len(self.cells) + 1))
        entries, cell = take_ragged(first, rows)
        return Lists(self.cells[rows], cell, self.corner[entries], self.by_all[entries])

    def append(self, other: "Lists") -> "Lists":
        return Lists(
            self.cells.append(other.cells),
            np.concatenate([self.cell, len(self.cells) + other.cell]),
            np.concatenate([self.corner, other.corner]),
            np.concatenate([self.by_all, other.by_all]),
        )


@dataclass(frozen=True, eq=False)
class _ListTree:
    """A partition during construction, with the corner lists of all nodes of its tree.

    Attributes:
        key: Priority of halving each node, at most that of its parent, whose index is in ``parent`` (-1 for the
            root).
        visible: The free convex pieces of each leaf, in the order of leaves, and the corners that each piece may see.
    """

    lists: Lists
    key: Float[np.ndarray, "nodes"]
    is_leaf: Bool[np.ndarray, "nodes"]
    parent: Int[np.ndarray, "nodes"]
    visible: CellSources

    def __len__(self) -> int:
        return int(self.is_leaf.sum())

    def leaves_above(self, key: float) -> Lists:
        """Return the lists of the leaves that remain if only nodes with larger keys than this are halved."""
        is_halved = ~self.is_leaf & (self.key > key)
        of_halved = np.append(True, is_halved[self.parent[1:]])
        return self.lists.of_cells(np.flatnonzero(of_halved & ~is_halved))


def grow_lists(
    root: CellSources, domain: Box, limits: Limits, most_leaves: int, num_bytes: Callable[[Lists], int]
) -> Lists:
    """Halve cells until that saves queries little or a limit is passed, then undo the least useful halvings.

    Halvings are undone until the file fits into ``limits.max_bytes`` and has at most ``most_leaves`` leaves; the root
    always stays. ``num_bytes`` returns the size of the file for given lists. Returns the lists of the leaves.
    """
    tree = _ListTree(*_keyed_lists(root, Cells.root(2), limits), np.ones(1, bool), np.full(1, -1), root)
    enough = _IN_VAIN * areas(root.pieces).sum()

    def halved(tree: _ListTree) -> _ListTree | None:
        leaves = np.flatnonzero(tree.is_leaf)
        key = tree.key[leaves]
        if key.sum() <= enough or len(tree) >= most_leaves or num_bytes(tree.leaves_above(0.0)) > limits.max_bytes:
            return None
        return _halved(tree, leaves[key > _SHARE * key.max()], domain, limits)

    tree = grow(tree, halved, limits)
    keys = np.unique(np.append(tree.key[~tree.is_leaf], 0.0))
    low, high = 0, len(keys) - 1  # the last key as threshold halves nothing
    while low < high:
        middle = (low + high) // 2
        leaves = tree.leaves_above(keys[middle])
        fits = len(leaves.cells) <= most_leaves and num_bytes(leaves) <= limits.max_bytes
        low, high = (low, middle) if fits else (middle + 1, high)
    return tree.leaves_above(keys[low])


def _halved(tree: _ListTree, nodes: Int[np.ndarray, "nodes"], domain: Box, limits: Limits) -> _ListTree:
    leaves = np.flatnonzero(tree.is_leaf)
    cells = tree.lists.cells[nodes]
    axis = cells.longest_axis(domain)
    both = cells.split(axis)
    place, is_upper = np.repeat(np.searchsorted(leaves, nodes), 2), np.tile([False, True], len(nodes))
    visible = tree.visible.parts(place, np.repeat(axis, 2), is_upper, *both.grown_boxes(domain))
    lists, key = _keyed_lists(visible, both, limits)
    key = np.minimum(key, np.repeat(tree.key[nodes], 2))
    is_leaf = tree.is_leaf.copy()
    is_leaf[nodes] = False
    stay = np.flatnonzero(is_leaf[leaves])
    return _ListTree(
        tree.lists.append(lists),
        np.append(tree.key, key),
        np.append(is_leaf, np.ones(len(both), bool)),
        np.append(tree.parent, np.repeat(nodes, 2)),
        tree.visible.of_cells(stay).append(visible),
    )


def _keyed_lists(visible: CellSources, cells: Cells, limits: Limits) -> tuple[Lists, Float[np.ndarray, "cells"]]:
    """Return corner lists of cells, and each cell's key: its free area times its number of partly visible corners.

    Keys are 0 for cells that may not be halved. A corner is partly visible if only a part of the cell is known to see
    it.
    """
    lists = Lists(cells, *corners_of_cells(visible))
    area = np.bincount(visible.cell, areas(visible.pieces), len(cells))
    doubtful = np.bincount(lists.cell, ~lists.by_all, len(cells))
    return lists, np.where((cells.depth < limits.max_axis_depth).all(axis=1), area * doubtful, 0.0)


def corners_seen(
    visibility: CornerVisibility,
    triangulation: Triangulation,
    lo: Float[np.ndarray, "cells 2"],
    hi: Float[np.ndarray, "cells 2"],
) -> CellSources:
    """Return the convex free pieces of boxes, and the corners where shortest paths from each piece may turn first."""
    lists = turns_by_triangle(visibility, triangulation)
    return CellSources.of_boxes(corner_sight(visibility, triangulation), lists, lo, hi)


def construct_stored(workspace: Workspace, max_bytes: int | None) -> tuple[PairsFileData, bytes]:
    """Build the file of a workspace's PairPLR; return its decoded contents and its bytes."""
    if not isinstance(workspace, Workspace):
        raise ValueError(f"construct_pairs needs a Workspace, got {shortened(workspace)}.")
    max_bytes = DEFAULT_MAX_BYTES if max_bytes is None else max_bytes
    frame = frame_size(workspace.bounds)
    limits = check_limits(leaf_model("cone"), 2, None, None, max_bytes, None, Proof.NONE, frame)
    domain, boundary = workspace.bounds, workspace.boundary
    if domain.width.max() > WIDEST:
        raise ValueError(f"The workspace may be at most {WIDEST:g} wide, got {domain.width.max():g}: scale it.")
    visibility = corner_visibility(workspace)
    if len(visibility.corners.points) > MOST_CORNERS:
        raise ValueError(
            f"The workspace may have at most {MOST_CORNERS:,} corners, got {len(visibility.corners.points):,}: "
            "simplify its polygons, or ask a VisibilityGraph."
        )
    outline, vertex = outline_of(
        boundary, domain.lo, float(domain.width.max()), workspace.tolerance, workspace.squeeze
    )
    corner, rank = corners_in_outline(outline, vertex, visibility.corners.points, boundary)
    # 1. Join corners that see one another and whose line is tangent at both: only such edges are on shortest paths.
    a, b = visibility.edges.T
    is_taut = visibility.corners.is_tangent(a, b) & visibility.corners.is_tangent(b, a)
    edges = np.unique(np.sort(rank[visibility.edges[is_taut]], axis=1)[:, ::-1], axis=0)[:, ::-1]
    # 2. Bound the rounding error. Rounding changes each of the two legs of a path by at most the shift of its corner.
    #    Distances between corners are compared one by one. Visibility has a tolerance.
    none, width = np.zeros(0, np.int64), float(domain.width.max())
    outline = replace(outline, thin=thin_walls(outline, workspace.free_space, width))
    unlisted = PairsFileData(domain, outline, corner, edges, tree_of(Cells.root(2)), none, none, 0.0)
    true = np.empty_like(unlisted.points)
    true[rank] = visibility.corners.points
    moved = float(np.linalg.norm(true - unlisted.points, axis=1).max(initial=0.0))
    largest = 0.0
    for (_, one), (_, other) in zip(
        distances_by_rows(true, edges), distances_by_rows(unlisted.points, edges), strict=True
    ):
        with np.errstate(invalid="ignore"):
            largest = max(largest, float(np.where(one == other, 0.0, np.abs(one - other)).max()))
    rounding = np.float32(2 * moved + largest + _SLACK * workspace.tolerance)

    unlisted = replace(unlisted, rounding=float(np.nextafter(rounding, np.float32(np.inf))))

    # 3. Grow the leaves and their lists.
    def stored(lists: Lists) -> PairsFileData:
        tree = tree_of(lists.cells)
        place = np.argsort(tree.order)[lists.cell]
        by_leaf = np.lexsort((rank[lists.corner], place))
        return replace(unlisted, tree=tree, leaf=place[by_leaf], listed=rank[lists.corner][by_leaf])

    most = min(limits.max_leaves, most_leaves(len(rank)))
    root = corners_seen(visibility, workspace.triangulation, domain.lo[None], domain.hi[None])
    held = stored(grow_lists(root, domain, limits, most, lambda lists: len(stored(lists).to_bytes())))
    data = held.to_bytes()
    if len(data) > limits.max_bytes:
        raise ValueError(
            f"max_bytes must leave room for free space and its corners, which alone take {len(data):,} bytes, got "
            f"max_bytes={limits.max_bytes:,.0f}: raise it, or simplify the polygons."
        )
    return held, data


def thin_walls(outline: Outline, free_space: Any, width: float) -> Int[np.ndarray, "thin"]:
    """Return the walls that may come close to free space when they move back, because their obstacle is thin."""
    walls: Any = shapely.linestrings(outline.moved_walls(RECEDING * width, surely=True).reshape(-1, 2, 2))
    return np.flatnonzero(shapely.dwithin(free_space, walls, MARGIN * width))


def corners_in_outline(
    outline: Outline, vertex: Int[np.ndarray, "points"], corners: Float[np.ndarray, "corners 2"], boundary: Boundary
) -> tuple[Int[np.ndarray, "corners"], Int[np.ndarray, "corners"]]:
    """Return the outline points that are corners, ascending, and each workspace corner's place among them."""
    number = {tuple(point): i for i, point in enumerate(corners.tolist())}
    corner_of_vertex = np.array([number.get(tuple(point), -1) for point in boundary.vertices.tolist()])
    order = np.argsort(~outline.is_reflex, kind="stable")
    found, place = np.unique(corner_of_vertex[vertex[order]], return_index=True)
    point = order[place[found >= 0]]
    rank = np.empty(len(point), np.int64)
    rank[np.argsort(point)] = np.arange(len(point))
    return np.sort(point), rank
