"""Building a PairPLR of a planar workspace."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int

from plr_jax._arrays import shortened
from plr_jax.geometry.boundary import Boundary
from plr_jax.geometry.corners import CornerVisibility, corner_visibility
from plr_jax.geometry.workspace import Workspace
from plr_jax.plr.certificate.certificate import Proof
from plr_jax.plr.file.container import frame_size
from plr_jax.plr.growth.limits import check_limits
from plr_jax.plr.pairs.growth import Lists, grow_lists
from plr_jax.plr.pairs.joined import in_order, largest_difference, taut_edges
from plr_jax.plr.pairs.lattice import outline_of
from plr_jax.plr.pairs.outline import Outline
from plr_jax.plr.pairs.pair_plr import PairPLR, pairs_of_stored
from plr_jax.plr.pairs.stored import MOST_CORNERS, WIDEST, Stored, most_leaves
from plr_jax.plr.pairs.tables import RECEDING
from plr_jax.plr.pairs.visible_corners import visible_corners
from plr_jax.plr.partition.cells import Cells
from plr_jax.plr.partition.tree import levels_of

DEFAULT_MAX_BYTES = 2**16
_SLACK = 8  # tolerances of the workspace


def construct_pairs(workspace: Workspace, *, max_bytes: int | None = None) -> PairPLR:
    """Build a PairPLR: the distance between any two points of a planar workspace.

    The domain is halved again and again, and each leaf lists the corners at which a shortest path from it may turn
    first. The file holds free space, which pairs of corners are joined, the partition and the lists, in layers of
    which the first is enough to answer (see ``file_marks``). Distances are exact but for the rounding of 32-bit
    floats, whatever the budget, and but for points nearer to a wall than 4e-6 of the domain's width: these may see
    past its ends, and be told up to 2e-5 of the width too little. More bytes make queries faster, up to a point, as
    fewer corners need to be looked at.

    Args:
        workspace: The free space, with at most 8,192 corners that stand out into it.
        max_bytes: Largest size of the file that :func:`save` writes; None: 65,536.

    Returns:
        The PairPLR. If interrupted (Ctrl-C), of the partition so far, with a ``ConstructionInterrupted`` warning.

    Raises:
        ValueError: If the workspace is none, has too many corners, is wider than 1e18, or has an obstacle thinner
            than 8e-6 of its width; or if free space and corners alone take more bytes.

    References:
        "all-pairs" in Section II of the paper.
    """
    if not isinstance(workspace, Workspace):
        raise ValueError(f"A PairPLR is of a Workspace, got {shortened(workspace)}.")
    max_bytes = DEFAULT_MAX_BYTES if max_bytes is None else max_bytes
    frame = frame_size(workspace.bounds)
    limits = check_limits(2, 0.5, True, lambda dim, leaves: leaves, None, None, max_bytes, None, Proof.NONE, frame)
    domain, boundary = workspace.bounds, workspace.boundary
    if domain.width.max() > WIDEST:
        raise ValueError(f"The workspace is {domain.width.max():g} wide; pairs are for {WIDEST:g} at most: scale it.")
    visibility = corner_visibility(workspace)
    if len(visibility.corners.points) > MOST_CORNERS:
        raise ValueError(
            f"The workspace has {len(visibility.corners.points):,} corners; pairs are for {MOST_CORNERS:,} at most: "
            "simplify its polygons, or ask a VisibilityGraph."
        )
    outline, vertex = outline_of(
        boundary, domain.lo, float(domain.width.max()), workspace.tolerance, workspace.squeeze
    )
    if outline.is_turned_around(RECEDING * float(domain.width.max())):
        raise ValueError(
            f"An obstacle is thinner than {2 * RECEDING:.1e} of the domain's width, or has a sharp end that short, "
            "which 32-bit floats do not resolve: make it thicker, or ask a VisibilityGraph."
        )
    corner, rank = _corners_in_outline(outline, vertex, visibility, boundary)
    edges = in_order(rank[taut_edges(visibility)])
    undivided = levels_of(Cells.root(2))[0], np.zeros(0, np.int64), np.zeros(0, np.int64)
    unlisted = Stored(domain, outline, corner, edges, *undivided, 0.0, None)
    true = np.empty_like(unlisted.points)
    true[rank] = visibility.corners.points
    unlisted = _with_roundings(unlisted, true, _SLACK * workspace.tolerance)

    def stored(lists: Lists) -> Stored:
        levels, order = levels_of(lists.cells)
        place = np.argsort(order)[lists.cell]
        by_leaf = np.lexsort((rank[lists.corner], place))
        return replace(unlisted, levels=levels, leaf=place[by_leaf], listed=rank[lists.corner][by_leaf])

    most = min(limits.max_leaves, most_leaves(len(corner)))
    root = visible_corners(visibility, workspace, domain)
    lists = grow_lists(root, domain, limits, most, lambda lists: len(stored(lists).to_bytes()))
    if (size := len(stored(lists).to_bytes())) > limits.max_bytes:
        raise ValueError(f"Free space and its corners alone take {size:,} bytes, more than max_bytes={max_bytes:,}.")
    return pairs_of_stored(stored(lists))


def _corners_in_outline(
    outline: Outline, vertex: Int[np.ndarray, "points"], visibility: CornerVisibility, boundary: Boundary
) -> tuple[Int[np.ndarray, "corners"], Int[np.ndarray, "corners"]]:
    """Which points of the outline are corners, ascending; and of each corner of the workspace, which one it is.

    Of points in one place, it is the one that stands out.
    """
    number = {tuple(point): i for i, point in enumerate(visibility.corners.points.tolist())}
    corner_of_vertex = np.array([number.get(tuple(point), -1) for point in boundary.vertices.tolist()])
    order = np.argsort(~outline.is_reflex, kind="stable")
    found, place = np.unique(corner_of_vertex[vertex[order]], return_index=True)
    point = order[place[found >= 0]]
    rank = np.empty(len(point), np.int64)
    rank[np.argsort(point)] = np.arange(len(point))
    return np.sort(point), rank


def _with_roundings(stored: Stored, true: Float[np.ndarray, "corners 2"], slack: float) -> Stored:
    """With the largest difference in length between a way by the corners as a file rounds them and by the true ones.

    A way has two legs, each of which changes by no more than its corner moves, and the distance between these
    corners, of which all are compared: by the joined pairs, and by those that follow from the outline if they are
    as good as queries are beside walls. The slack is how well visibility itself is known.
    """
    moved = float(np.linalg.norm(true - stored.points, axis=1).max(initial=0.0))

    def rounding(edges: Int[np.ndarray, "edges 2"]) -> float:
        difference = largest_difference(true, stored.edges, stored.points, edges)
        return float(np.nextafter(np.float32(2 * moved + difference + slack), np.float32(np.inf)))

    stored = replace(stored, rounding=rounding(stored.edges))
    try:
        edges = replace(stored, joined=None).edges
    except ValueError:  # details narrower than the lattice leave an outline of nothing
        return stored
    of_outline = stored.rounding if np.array_equal(edges, stored.edges) else rounding(edges)
    is_as_good = of_outline <= RECEDING * float(stored.domain.width.max())
    return replace(stored, rounding_of_outline=of_outline if is_as_good else None)
