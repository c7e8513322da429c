"""Construction of a PairPLR: distances between any two points of a planar workspace, stored in one file.

:func:`construct_stored` rounds the boundary of free space to a lattice (:func:`outline_of`), joins corners by edges,
and halves cells (:func:`grow_lists`). Each leaf lists the corners at which shortest paths from its points may turn
first. A query tries the corners of its point's leaf. Corners that the point does not see cost time in vain, so cells
with many such corners are halved first.
"""

from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int
from scipy.sparse import csr_array, vstack

from plr_jax._arrays import concatenated, shortened, take_ragged
from plr_jax.geometry.boundary import Boundary, Indices, vertices_near_edges
from plr_jax.geometry.box import Box
from plr_jax.geometry.cell_sight import CellSources, corner_sight, turns_by_triangle
from plr_jax.geometry.convex_pieces import areas
from plr_jax.geometry.corners import CornerVisibility
from plr_jax.geometry.graph import Arcs
from plr_jax.geometry.triangulation import Triangulation
from plr_jax.geometry.workspace import Workspace
from plr_jax.pairs.stored import MOST_CORNERS, WIDEST, Outline, PairsFileData, distances_by_rows, most_leaves
from plr_jax.pairs.thin_parts import FINEST, VertexOutline, with_thin_parts
from plr_jax.plr.certificate import Proof
from plr_jax.plr.container import frame_size
from plr_jax.plr.growth import Limits, grow
from plr_jax.plr.leaves import leaf_model
from plr_jax.plr.leaves.base import GivenLimits, check_limits
from plr_jax.plr.tree import Cells, tree_of

DEFAULT_MAX_BYTES = 2**16
PointIndices = Int[np.ndarray, "points"]  # a number for each point of an outline
# Finest lattice step at all, in domain widths. Rounded down to a power of two, it is more than 2**-38 widths, so
# coordinates are at most 2**38 steps: files hold coordinates of up to 39 bits.
_FINEST_EVER = 2.0**-37
_SLACK = 8  # number of workspace tolerances by which visibility may err


def outline_of(boundary: Boundary, origin: Float[np.ndarray, "2"], width: float, tolerance: float) -> VertexOutline:
    """Round the boundary of free space to a lattice; also return the index of each rounded point's vertex.

    Return an :class:`Outline`, and for each of its points the index of a vertex in ``boundary.vertices``. ``origin``
    is the position of the lattice point (0, 0), and ``width`` the width of the domain. Vertices move by at most the
    ``tolerance``, if a lattice step of at least 6e-8 widths allows it.
    """
    vertices, edges = boundary.vertices, boundary.edges
    # 1. Follow the rings. Where obstacles touch, several edges leave a vertex b. After an edge from a to b comes the
    #    edge that leaves b and whose sector of free space, which lies between both, ends at a. (`sector_end[e]` is
    #    the vertex from which the edge arrives that ends the sector of edge e.)
    sectors = zip(edges[:, 0].tolist(), boundary.sector_end.tolist(), strict=True)
    leaving = {sector: edge for edge, sector in enumerate(sectors)}
    order, first = _rings_of(np.array([leaving[b, a] for a, b in edges.tolist()]))
    # 2. Round the points to a lattice that separates points from walls. A quarter of 8 * FINEST widths is above both
    #    the finest step and the usual tolerance (1e-9 widths): walls that far away do not limit the step.
    all_indices = np.arange(len(vertices)), np.arange(len(edges))
    near, edge = vertices_near_edges(vertices, edges, 8 * FINEST * width, *all_indices)
    walls: Any = shapely.linestrings(boundary.segments[edge].reshape(-1, 2, 2))
    apart: Any = shapely.distance(shapely.points(vertices[near]), walls)
    step = lattice_step(vertices - origin, width, tolerance, float(apart.min(initial=np.inf)))
    points = np.rint((vertices - origin) / step).astype(np.int64)
    vertex, is_thin = edges[order, 0], np.zeros(len(order), bool)
    return Outline(origin, step, points[vertex], first, may_squeeze=False, is_thin=is_thin), vertex


def _rings_of(following: PointIndices) -> tuple[PointIndices, Int[np.ndarray, " rings_plus_one"]]:
    """Divide points into rings; point ``following[i]`` comes after point ``i``.

    Return ``(order, first)``: ring ``k`` has the points ``order[first[k] : first[k + 1]]``.
    """
    order, first, is_done = [], [0], np.zeros(len(following), bool)
    for point in range(len(following)):
        while not is_done[point]:
            is_done[point] = True
            order.append(point)
            point = following[point]
        if len(order) > first[-1]:
            first.append(len(order))
    return np.array(order), np.array(first)


def with_open_contacts(outline: Outline, vertex: PointIndices) -> VertexOutline:
    """Open the contacts of an outline (points where obstacles touch), so that paths may pass between the obstacles.

    The rings of the new outline follow walls around obstacles instead of around free space. ``vertex`` is the index
    of the boundary vertex at each point of the outline. Return the new outline, and the vertex at each of its points.

    If a wall of a thin obstacle begins or ends in a contact, the result is the old outline: all contacts stay closed.
    The reason is rounding: for tests of visibility, walls of thin obstacles stay in place, while other walls move
    back (:meth:`Outline.moved_walls`). So rounding would decide whether a wall of a thin obstacle hides the corner in
    an open contact. Paths pass a closed contact from one corner to another: :func:`corners_in_outline` makes one
    corner for each sector of free space beside the contact.
    """
    # Whether the wall that leaves each point, or the one that arrives at it, belongs to a thin obstacle. A wall
    # arrives from the previous point: `argsort` inverts the permutation `following`.
    is_beside_thin = outline.is_thin | outline.is_thin[np.argsort(outline.following)]
    if (outline.is_contact & is_beside_thin).any():
        return outline, vertex
    order, first = _rings_of(outline.following_past_contacts)
    points, is_thin = outline.points[order], outline.is_thin[order]
    return replace(outline, points=points, first=first, is_thin=is_thin, may_squeeze=True), vertex[order]


def lattice_step(points: Float[np.ndarray, "n 2"], width: float, tolerance: float, clearance: float) -> float:
    """Return the largest lattice step, a power of two or ten, such that points can be rounded to multiples of it.

    Rounded points must stay distinct. Coordinates may change by at most the ``tolerance``, and by at most a quarter
    of the ``clearance``, the least distance of a point from a wall that does not end at the point. If no step of at
    least ``FINEST`` times ``width``, the width of the domain, is fine enough, return a finer power of two, with
    which rounded points may coincide or move farther.
    """
    steps = np.concatenate([2.0 ** np.arange(-60, 60), 10.0 ** np.arange(-20, 20)])
    for step in np.sort(steps[(steps <= width) & (steps >= FINEST * width)])[::-1]:
        rounded = np.rint(points / step)
        moved = np.abs(points - step * rounded).max(initial=0.0)
        if moved <= min(tolerance, clearance / 4) and len(np.unique(rounded, axis=0)) == len(points):
            return float(step)
    step = min(FINEST * width, max(clearance / 4, _FINEST_EVER * width))
    return float(2.0 ** np.floor(np.log2(step)))


_LEAST_RELATIVE_KEY = 0.25  # share of the largest key above which cells are halved together
_IN_VAIN = 0.1  # mean number of listed corners that a point does not see; fewer make queries no faster


# Cells of the domain, and the corners at which shortest paths from their points may turn first: entry (i, c) of the
# matrix is true if cell i lists corner c.
Lists = tuple[Cells, csr_array]
_Keys = Float[np.ndarray, " nodes"]


@dataclass(frozen=True, eq=False)
class _ListTree:
    """A growing tree of cells; each node lists the corners at which paths from points of its cell may turn first."""

    cells: Cells
    lists: csr_array
    key: _Keys  # priority of halving each node, at most the parent's priority
    parent_key: _Keys  # priority of the parent, `inf` for the root
    is_leaf: Bool[np.ndarray, " nodes"]
    visible: CellSources  # free convex pieces of each leaf, and the corners that each piece may see

    @staticmethod
    def of_leaves(cells: Cells, visible: CellSources, parent_key: _Keys, limits: Limits) -> "_ListTree":
        """Return a tree that has each of the given cells as a leaf.

        ``visible`` has the convex pieces of free space in the cells, and the corners that each piece may see.
        """
        # A cell's key is the area of its free space, times the number of listed corners that not all of it may see.
        # It is 0 if the cell may not be halved.
        cell, corner, by_all = corners_of_cells(visible)
        shape = len(cells), len(visible.sight.turns.points) // 2  # each corner has two turns, one for each side
        lists = csr_array((np.ones(len(cell), bool), (cell, corner)), shape)
        area = np.bincount(visible.cell, areas(visible.pieces), len(cells))
        doubtful = np.bincount(cell, ~by_all, len(cells))
        key = np.where((cells.depth < limits.max_axis_depth).all(axis=1), area * doubtful, 0.0)
        return _ListTree(cells, lists, np.minimum(key, parent_key), parent_key, np.ones(len(cells), bool), visible)

    def __len__(self) -> int:
        return int(self.is_leaf.sum())

    def leaves_above(self, key: float) -> Lists:
        """Return the leaves, and their lists of corners, of a smaller tree.

        In the smaller tree, only nodes of priority above ``key`` are halved.
        """
        # Keys are at most the parent's, so all ancestors of a halved node are halved, too.
        leaves = np.flatnonzero((self.parent_key > key) & (self.is_leaf | (self.key <= key)))
        return self.cells[leaves], self.lists[leaves]


def corners_of_cells(cells: CellSources) -> tuple[Indices, Indices, Bool[np.ndarray, " entries"]]:
    """Return the pairs of a cell and a corner where shortest paths from the cell may turn first.

    The result is three arrays ``(cell, corner, is_seen_by_all)``: two indices, and whether every point of the cell is
    known to see the corner.
    """
    # 1. Unite both sources of a corner, 2 c and 2 c + 1, in pairs (piece, corner). If a piece has both, their
    #    `by_all` are equal, since they are seen from the same viewpoint.
    count = np.int64(len(cells.sight.turns.points) // 2)
    of_piece, first = np.unique(cells.piece * count + (cells.source >> 1), return_index=True)
    piece, corner = np.divmod(of_piece, count)
    # 2. Unite the pieces of a cell. All of the cell sees a corner if as many pieces as the cell has see it wholly.
    key, index = np.unique(cells.cell[piece] * count + corner, return_inverse=True)
    cell, corner = np.divmod(key, count)
    num_whole = np.bincount(index, cells.by_all[first], len(key))
    return cell, corner, num_whole == np.diff(cells.first_piece)[cell]


def grow_lists(root: CellSources, domain: Box, limits: Limits, most: int, num_bytes: Callable[[Lists], int]) -> Lists:
    """Partition the domain into cells that list the corners of obstacles where shortest paths may turn first.

    ``root`` has the convex pieces of all free space, and the corners that each piece may see. The result has at most
    ``most`` cells. Halvings that help least are undone until the size of the file, which ``num_bytes``
    computes from the cells and lists, is at most ``limits.max_bytes``.
    """
    # 1. Halve the cells of the largest keys in each round, until halving more makes queries no faster or a limit is
    #    reached. The sum of keys is the area times the mean number of corners tried in vain.
    tree = _ListTree.of_leaves(Cells.root(2), root, np.full(1, np.inf), limits)
    stop_at = _IN_VAIN * areas(root.pieces).sum()

    def next_round(tree: _ListTree) -> _ListTree | None:
        # All nodes that have been halved have keys above 0, so `leaves_above(0.0)` are the leaves of the whole tree.
        leaves = np.flatnonzero(tree.is_leaf)
        key = tree.key[leaves]
        if key.sum() <= stop_at or len(tree) >= most or num_bytes(tree.leaves_above(0.0)) > limits.max_bytes:
            return None
        return _with_halves(tree, leaves[key > _LEAST_RELATIVE_KEY * key.max()], domain, limits)

    tree = grow(tree, next_round, limits)

    # 2. Find the least threshold of keys whose leaves fit, by bisection. A higher threshold gives fewer leaves, so
    #    the values of `fits` are False, ..., False, True, ..., True. If no other threshold fits, take the largest
    #    key, above which no node is halved.
    def fits(key: float) -> bool:
        leaves = tree.leaves_above(key)
        return len(leaves[0]) <= most and num_bytes(leaves) <= limits.max_bytes

    keys = np.unique(np.append(tree.key[~tree.is_leaf], 0.0))
    return tree.leaves_above(keys[bisect_left(keys[:-1], True, key=fits)])


def _with_halves(tree: _ListTree, nodes: Int[np.ndarray, " nodes"], domain: Box, limits: Limits) -> _ListTree:
    """Return the tree in which the leaves ``nodes`` (indices) are halved along their longest axis, with new lists."""
    # The halves of all nodes are appended to the tree: lower, upper, lower, upper, ...
    axis = tree.cells[nodes].longest_axis(domain)
    halves = tree.cells[nodes].split(axis)
    leaves = np.flatnonzero(tree.is_leaf)  # `tree.visible` has its cells in this order
    parent = np.repeat(np.searchsorted(leaves, nodes), 2)
    is_upper = np.tile([False, True], len(nodes))
    visible = tree.visible.parts(parent, np.repeat(axis, 2), is_upper, *halves.grown_boxes(domain))
    new = _ListTree.of_leaves(halves, visible, np.repeat(tree.key[nodes], 2), limits)
    old = replace(tree, is_leaf=tree.is_leaf & ~np.isin(np.arange(len(tree.is_leaf)), nodes))
    visible = tree.visible.of_cells(np.flatnonzero(old.is_leaf[leaves])).append(visible)
    key, parent_key, is_leaf = concatenated([old, new], "key", "parent_key", "is_leaf")
    lists: Any = vstack([tree.lists, new.lists])
    return _ListTree(tree.cells.append(halves), lists, key, parent_key, is_leaf, visible)


def corners_seen(visibility: CornerVisibility, triangulation: Triangulation, domain: Box) -> CellSources:
    """Return the convex pieces of all free space in the domain, and the corners that each piece may see."""
    lists = turns_by_triangle(visibility, triangulation)
    return CellSources.of_boxes(corner_sight(visibility, triangulation), lists, domain.lo[None], domain.hi[None])


def construct_stored(
    workspace: Workspace, max_bytes: int | None, visibility: CornerVisibility | None = None, num_other_bytes: int = 0
) -> tuple[PairsFileData, bytes]:
    """Build the content of a file of distances between pairs of points; also return the bytes of the file.

    The size of the file plus ``num_other_bytes`` is at most ``max_bytes`` (None: 65,536). ``visibility`` has the
    corners of the workspace, and the places and arcs of a building's links (see :class:`CornerVisibility`). None: the
    corners are computed, without places and arcs.
    """
    if not isinstance(workspace, Workspace):
        raise ValueError(f"construct_pairs needs a Workspace or a Building, got {shortened(workspace)}.")
    max_bytes = DEFAULT_MAX_BYTES if max_bytes is None else max_bytes
    domain = workspace.bounds
    limits = check_limits(leaf_model("cone"), 2, Proof.NONE, frame_size(domain), GivenLimits(max_bytes=max_bytes))
    if domain.width.max() > WIDEST:
        raise ValueError(f"The workspace may be at most {WIDEST:g} wide, got {domain.width.max():g}: scale it.")
    # Indices:
    #   vertex   of `workspace.boundary`; vertex[p] is the vertex at point p
    #   point p  of the outline
    #   corner c of `visibility`
    #   corner f of the file: at the point point_of[f], and equal to the corner corner_of[f] of `visibility`
    # A corner c has several corners f, such as two at a sharp tip, or none: order[first[c] : first[c + 1]].
    #
    # 1. Round the boundary of free space to a lattice, and find its corners.
    visibility = visibility or CornerVisibility.of(workspace)
    width = float(domain.width.max())
    outline, vertex = outline_of(workspace.boundary, domain.lo, width, workspace.tolerance)
    outline, vertex = with_thin_parts(outline, vertex, workspace.free_space, width)
    if workspace.squeeze:
        outline, vertex = with_open_contacts(outline, vertex)
    places = visibility.places
    point_of, corner_of = corners_in_outline(outline, vertex, visibility.of_vertex, workspace.squeeze)
    corner_of, num_corners = np.append(corner_of, places), len(point_of) + len(places)
    if num_corners > MOST_CORNERS:
        advice = "simplify its polygons, or ask a VisibilityGraph"
        raise ValueError(f"The workspace may have at most {MOST_CORNERS:,} corners, got {num_corners:,}: {advice}.")
    shift = num_corners - len(visibility.corners.points)
    arcs = Arcs(shift + visibility.arcs.start, shift + visibility.arcs.end, visibility.arcs.length)
    order = np.argsort(corner_of, kind="stable")
    first = np.searchsorted(corner_of[order], np.arange(len(visibility.corners.points) + 1))
    # 2. Join corners that see one another and whose line is tangent at both: only such edges are on shortest paths.
    a, b = visibility.edges.T
    is_taut = visibility.corners.is_tangent(a, b) & visibility.corners.is_tangent(b, a)
    edges = _edges_in_file(order, first, a[is_taut], b[is_taut])
    # 3. Bound the rounding error. Rounding changes each of the two legs of a path by at most the shift of its corner.
    #    Distances between corners are compared one by one. Visibility has a tolerance.
    true = visibility.corners.points[corner_of]
    rounded = np.concatenate([outline.positions[point_of], true[len(point_of) :]])
    moved = float(np.linalg.norm(true - rounded, axis=1).max(initial=0.0))
    change = 0.0  # largest change of a distance between corners
    by_rows = (distances_by_rows(points, edges, arcs) for points in (true, rounded))
    for (_, exact), (_, rough) in zip(*by_rows, strict=True):
        with np.errstate(invalid="ignore"):  # `exact` and `rough` may both be infinite
            change = max(change, float(np.where(exact == rough, 0.0, np.abs(exact - rough)).max()))
    # The file has 32 bits, so round up.
    rounding = float(np.nextafter(np.float32(2 * moved + change + _SLACK * workspace.tolerance), np.float32(np.inf)))

    # 4. Grow the leaves and their lists. Entry (c, f) of the matrix is true if corner f of the file is at corner c.
    corners_at = csr_array((np.ones(num_corners, bool), order, first), (len(first) - 1, num_corners))

    def file_data(leaves: Lists) -> PairsFileData:
        tree = tree_of(leaves[0])
        lists = (leaves[1][tree.order] @ corners_at).sorted_indices()
        return PairsFileData(domain, outline, point_of, edges, tree, lists, rounding, "", true[len(point_of) :], arcs)

    most = min(limits.max_leaves, most_leaves(num_corners))
    root = corners_seen(visibility, workspace.triangulation, domain)

    def num_bytes(leaves: Lists) -> int:
        return num_other_bytes + len(file_data(leaves).to_bytes())

    pairs_data = file_data(grow_lists(root, domain, limits, most, num_bytes))
    data = pairs_data.to_bytes()
    if (least := num_other_bytes + len(data)) > limits.max_bytes:
        expected = f"leave room for free space and its corners, which alone take {least:,} bytes"
        advice = "raise it, or simplify the polygons"
        raise ValueError(f"max_bytes must {expected}, got max_bytes={limits.max_bytes:,.0f}: {advice}.")
    return pairs_data, data


def _edges_in_file(order: Indices, first: Indices, a: Indices, b: Indices) -> Int[np.ndarray, "edges 2"]:
    """Return the edges between corners of the file, given the edges from ``a`` to ``b`` between workspace corners.

    The file has the corners ``order[first[c] : first[c + 1]]`` at corner ``c`` of the workspace. Columns of the
    result are the earlier and the later corner. Rows are distinct, sorted by the later, then the earlier corner.
    """
    # 1. Join all of the file's corners at a with all at b. If the file has corners 4 and 6 at a, and 5 and 9 at b:
    #      the edge               (a, b)
    #      has the starts         (4, b)          (6, b)
    #      and becomes the edges  (4, 5), (4, 9), (6, 5), (6, 9).
    start, edge = take_ragged(first, a)  # places in `order`
    end, row = take_ragged(first, b[edge])
    between = np.stack([start[row], end], axis=1)
    # 2. Join the file's corners at the same place in a chain, so that paths may pass from one to another: (4, 6).
    later = np.setdiff1d(np.arange(1, len(order)), first)  # all but the first at each place
    edges = order[np.concatenate([between, np.stack([later - 1, later], axis=1)])]
    return np.unique(np.sort(edges, axis=1)[:, ::-1], axis=0)[:, ::-1]


def corners_in_outline(
    outline: Outline, vertex: PointIndices, corner_of_vertex: Int[np.ndarray, " vertices"], squeezes: bool
) -> tuple[Int[np.ndarray, " corners"], Int[np.ndarray, " corners"]]:
    """Return the indices of outline points that are corners, ascending, and for each the index of a workspace corner.

    ``vertex`` is the index of the boundary vertex at each point of the outline, -1 for none. ``corner_of_vertex`` is
    the index of the workspace corner at each vertex, -1 for none. If paths may squeeze between
    obstacles that touch (``squeezes``), all outline points at a contact that :func:`with_open_contacts` left closed
    become corners.
    """
    # 1. Find the points of corners, and choose one point for each corner: the first reflex one, else the first one.
    of_point = np.append(corner_of_vertex, -1)[vertex]  # the last entry is for vertex -1
    candidates = np.flatnonzero(of_point >= 0)
    candidates = candidates[np.argsort(~outline.is_reflex[candidates], kind="stable")]
    chosen = candidates[np.unique(of_point[candidates], return_index=True)[1]]
    is_corner = np.zeros(len(vertex) + 1, bool)  # one more, for the point after the last one
    is_corner[chosen] = True
    # 2. Sharp tips have two points with the same vertex, one after the other.
    is_corner[chosen + 1] |= np.append(vertex, -1)[chosen + 1] == vertex[chosen]
    # 3. If paths squeeze through closed contacts, they lead from any sector of free space beside it into any other.
    is_corner[candidates] |= squeezes & outline.is_contact[candidates]
    corner = np.flatnonzero(is_corner)
    return corner, of_point[corner]
