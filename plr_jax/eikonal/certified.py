"""PLRs of an estimated cost-to-go, with proven bounds of the true cost-to-go in each leaf.

A PLR has one leaf for each cell of the mesh if the file then fits, else fewer leaves, which are fitted to the
estimate. Each leaf stores the worst bounds of the cells that it overlaps. If there are few goals, the file also holds
the goals: the least cost of a straight motion to a goal is another lower bound.
"""

from dataclasses import replace
from itertools import product

import numpy as np
from jaxtyping import Float

from plr_jax._arrays import parts, ragged_indices
from plr_jax.eikonal.bounds import AtCorners, CostToGoField, MeshEstimate
from plr_jax.eikonal.elements import basis
from plr_jax.eikonal.goals import Goals, Points
from plr_jax.eikonal.program import ROUNDING, Numbers
from plr_jax.geometry.box import Box
from plr_jax.oracles import VoxelGraph
from plr_jax.plr._file import DecodedFile, cut_off_leaves, filled_coefficients
from plr_jax.plr._plr import PLR, plr_of_leaves
from plr_jax.plr.certificate import MOST_GOALS, Certificate, Proof, StraightBound
from plr_jax.plr.container import frame_size
from plr_jax.plr.growth import best_axis, largest_error
from plr_jax.plr.leaf_faces import overlapping_leaves
from plr_jax.plr.leaves import StoredValues, TiedPartition, leaf_model
from plr_jax.plr.leaves.base import UNIT, GivenLimits, Rules, check_limits, largest_coordinates
from plr_jax.plr.sampling import Sampler, sample_pattern
from plr_jax.plr.tree import PLACING, Cells, corner_bits, enumerate_boxes
from plr_jax.spaces import CellState, MotionCost, VoxelSpace

_MOST_VOXELS = 1 << 24  # most voxels of spaces in which paths from voxel to voxel give upper bounds
_VOXEL_GOALS = 8  # most goals to which these paths lead: paths to any of the goals give upper bounds
_PAIRS_AT_ONCE = 1 << 20  # pairs of a leaf and a voxel handled together, which bounds the memory
_STEP_PER_GAP = 0.02  # step of stored values, as a share of the mean gap between the bounds
_LEAST_STEP = 2.0**-22  # least step, as a share of the largest value
_STEP_UNPROVEN = 2.0**-15  # step without bounds, as a share of the largest value
_LENGTH_MARGIN = 2.0**-20  # relative margin of a straight motion's cost, for rounding in 32 bits
_LEAST_LENGTH = 1e-15  # 32 bits hold the squares of lengths and costs above this
_MOST_LENGTH = 1e15  # and below this
_STRAIGHT_BYTES = 0.4  # most bytes of the goals, as a share of the file


def plr_on_mesh(estimate: MeshEstimate, field: CostToGoField | None, max_bytes: float) -> PLR | None:
    """Return a PLR whose leaves are the cells of the mesh, or None if the file takes more than ``max_bytes``.

    If ``field`` is given, the PLR has the field's proven bounds, and the file size includes them.
    """
    mesh = estimate.mesh
    values = estimate.corner_values
    # 1. Quantize the values at corners, by a step that is small beside the gap between the bounds.
    step = _STEP_UNPROVEN * float(values.max()) if field is None else _STEP_PER_GAP * field.mean_gap
    step = max(step, _LEAST_STEP * float(np.abs(values).max()), float(np.finfo(np.float32).tiny))
    partition = TiedPartition(mesh.tree, mesh.state == CellState.BLOCKED, mesh.all_faces, mesh.is_open_face)
    stored = StoredValues.quantize_corners(partition, values, step)
    cut_off = cut_off_leaves(estimate.reach, mesh.tree)
    contents = DecodedFile(mesh.domain, leaf_model("continuous"), mesh.tree, stored, cut_off=cut_off)
    plr = plr_of_leaves(contents)
    # 2. Add the bounds, which take long: not if the leaves alone are too large.
    if field is not None and plr.num_bytes <= max_bytes:
        plr = plr_of_leaves(_with_proof(contents, field, _straight_bound_of(field, max_bytes)))
    return plr if plr.num_bytes <= max_bytes else None


def plr_of_bytes(estimate: MeshEstimate, max_bytes: int, seed: int, field: CostToGoField | None) -> PLR:
    """Return a PLR of at most ``max_bytes`` bytes, fitted to samples of an estimate of the cost-to-go.

    If ``field`` is given, the PLR has the field's proven bounds. ``seed`` is the seed of the samples.
    """
    # 1. Limits of the leaves: the proof and the goals take a part of the file.
    straight = None if field is None else _straight_bound_of(field, max_bytes)
    num_other_bytes = frame_size(estimate.mesh.domain) + (0 if straight is None else straight.num_bytes)
    model, domain = leaf_model("continuous"), estimate.mesh.domain
    proof = Proof.NONE if field is None else Proof.OPEN_LEAVES
    limits = check_limits(model, domain.dim, proof, num_other_bytes, GivenLimits(max_bytes=max_bytes))

    # 2. Fit leaves to the estimate on the grid. Where there is none, use the estimate on the mesh.
    def distances(x: Points) -> Numbers:
        on_mesh = estimate(x)
        on_grid = on_mesh if field is None or field.guide is None else field.guide(x)
        return np.where(np.isfinite(on_grid), on_grid, on_mesh)

    pattern = sample_pattern(domain.dim, model.num_samples, 0.0, seed)
    sampler = Sampler(distances, domain, None, pattern, pattern, limits.max_axis_depth, reach=estimate.reach)
    tree, stored, _ = model.construct(sampler, Rules(largest_error, best_axis), limits)
    contents = DecodedFile(domain, model, tree, stored, cut_off=cut_off_leaves(estimate.reach, tree))
    return plr_of_leaves(contents if field is None else _with_proof(contents, field, straight))


def _with_proof(contents: DecodedFile, field: CostToGoField, straight: StraightBound | None) -> DecodedFile:
    """Return ``contents``, a decoded file, with proven bounds of (cost-to-go - leaf function) added for each leaf.

    A leaf gets the worst of the field's bounds over all mesh cells that overlap the leaf. ``straight`` is the lower
    bound by straight motions, which is stored too.
    """
    mesh = field.mesh
    cells = contents.tree.leaves
    corners = corner_bits(mesh.dim)
    # 1. Rows (leaf, held_in, bounded_by): a point of the leaf in the cell `held_in` has the bounds of the open cell
    #    `bounded_by`. This is the same cell or, for a flush blocked cell, each open cell beside it. A blocked cell is
    #    *flush* (see :class:`Mesh`) if it borders on space that is not blocked: rounding may then place free points
    #    in the cell.
    #
    #      +------+------+
    #      |  A   |## B #|    Leaf L meets the open cell A and the flush blocked cell B (#) beside A. Its rows are
    #      |   +--+--+ ##|      (L, A, A), over the box that L and A share;
    #      |   | L|  |## |      (L, B, A), over the part within L of the face between A and B, since rounding may
    #      +---+--+--+---+                 place free points of A at this face in B.
    met_leaf, met_cell = overlapping_leaves(contents.tree, mesh.tree)
    is_open = mesh.state[met_cell] != CellState.BLOCKED
    # For pair p of a flush and an open cell, the leaves in the flush cell are met_leaf[by_cell[first[p] : last[p]]].
    by_cell = np.argsort(met_cell, kind="stable")
    flush, beside = mesh.flush_pairs
    first, last = (np.searchsorted(met_cell[by_cell], flush, side=side) for side in ("left", "right"))
    pair, place = ragged_indices(last - first)
    leaf = np.append(met_leaf[is_open], met_leaf[by_cell[first[pair] + place]])
    held_in = np.append(met_cell[is_open], flush[pair])
    bounded_by = np.append(met_cell[is_open], beside[pair])
    # The mesh also counts cells as blocked from which no goal can be reached, though they may hold free points: the
    # space does not call these cells blocked. A leaf that meets one has no upper bound.
    blocked = np.flatnonzero(mesh.state == CellState.BLOCKED)
    may_be_free = blocked[field.space.classify(*(end[blocked] for end in mesh.boxes)) != CellState.BLOCKED]
    unbounded = met_leaf[np.isin(met_cell, may_be_free)]  # leaves, some of which may repeat
    # 2. The box of each row, in fractions of the domain: what both cells share, within the leaf. (A cell shares its
    #    whole box with itself.) The box lies in `held_in`; across the seam of a periodic axis, `shift`, in periods,
    #    moves it into `bounded_by`.
    lo, hi, shift = mesh.shared_boxes(held_in, bounded_by)
    leaf_lo, leaf_hi = (end[leaf] for end in cells.fractions)
    lo, hi = np.maximum(lo, leaf_lo), np.minimum(hi, leaf_hi)
    is_met = (lo <= hi).all(axis=1)  # the leaf need not reach the face of its flush cell
    leaf, bounded_by, shift, lo, hi = (column[is_met] for column in (leaf, bounded_by, shift, lo, hi))
    # 3. The leaf's function at the corners of each box.
    coefficients = filled_coefficients(contents)
    is_lost = np.isinf(coefficients[:, 0])
    if contents.cut_off is not None:
        is_lost &= ~contents.cut_off
    if is_lost[leaf].any():
        reason = "some leaves answer inf, although some of their points, which no sample met, may reach the goal"
        raise ValueError(f"Nothing can be proven: {reason}. Allow more max_bytes, or leave it out.")
    coefficients = np.where(np.isinf(coefficients[:, :1]), 0.0, coefficients)
    at = lo[:, None] + (hi - lo)[:, None] * corners
    t = np.ldexp(at, cells.depth[leaf][:, None]) - cells.position[leaf][:, None]  # local coordinates of the leaf
    weights = basis(1, t.reshape(-1, mesh.dim)).reshape(len(leaf), len(corners), -1)
    values = np.einsum("nij,nj->ni", weights, coefficients[leaf])
    # 4. The worst bounds of each leaf. They begin at 0, since a certificate holds lower <= 0 <= upper.
    local_lo, local_hi = (mesh.local(bounded_by, end + shift) for end in (lo, hi))
    below, above = field.bounds_over(bounded_by, local_lo, local_hi, values)
    lower, upper = np.zeros((2, len(cells)))
    upper[unbounded] = np.inf
    np.minimum.at(lower, leaf, below)
    np.maximum.at(upper, leaf, above)
    # 5. Rounding may place a point in the leaf that is up to e_k = outside[k] beyond the leaf's box along axis k, in
    #    the leaf's local coordinates t. Let across_k be the largest difference of the leaf's function f between two
    #    corners along axis k. f is multilinear: df/dt_k is the average of these differences, with weights of sum 1.
    #    In the box weights are at least 0. Beyond it, their absolute values sum up to |t_j| + |1 - t_j| <= 1 + 2 e_j
    #    along each other axis j. So, up to such a point, f changes by at most
    #        sum over k of e_k * across_k * (product over j != k of 1 + 2 e_j).
    #    The product over all axes, which is simpler, is no less.
    outside = PLACING * np.ldexp(1.0, cells.depth)
    across = [np.abs(coefficients[:, bits == 1] - coefficients[:, bits == 0]).max(axis=1) for bits in corners.T]
    across = np.stack(across, axis=1)
    changes = np.sum(outside * across, axis=1) * np.prod(1 + 2 * outside, axis=1)
    if isinstance(field.space, VoxelSpace) and field.program.costs.cost_map is None:
        upper = np.minimum(upper, _above_voxel_paths(field, field.space, cells, coefficients, across))
    rounding = contents.leaf.rounding_bounds(contents.domain, cells, coefficients) + changes
    return replace(contents, certificate=Certificate.of(lower, upper, rounding, Proof.OPEN_LEAVES), straight=straight)


def _straight_bound_of(field: CostToGoField, max_bytes: int | float) -> StraightBound | None:
    costs = field.program.costs
    return straight_bound(field.mesh.domain, costs.motion_cost, costs.least_rate, field.program.at, max_bytes)


def straight_bound(
    domain: Box, motion_cost: MotionCost, least_rate: float, goals: Goals, max_bytes: int | float
) -> StraightBound | None:
    """Return the data of a lower bound: the least cost of straight motions to the goals, minus a margin for rounding.

    ``goals`` are fractions of the domain, and ``least_rate`` is the least cost of a motion whose norm is 1.

    The bound is 0 everywhere if there are more than 64 goals, if the goals take more than 40 % of ``max_bytes``, or
    if squares of costs overflow or vanish in 32 bits. If squares of lengths overflow or vanish in 32 bits, the result
    is None.
    """
    # A query computes, in 32 bits, the least over goals g of
    #   sum over blocks of rate * |(x - g)[axes of the block]|  -  margin.
    # Smaller rates allow for the relative errors of lengths, and the margin for the errors of coordinates of x - g.
    # Let L be the largest coordinate along an axis. In units of UNIT * L, the errors are 1 each for the roundings of
    # x, of g and of both differences in (x - corner) - g, and 2 for the corner of the domain, which is rounded
    # outward. This makes 6, and the subtraction of the margin adds at most 1: 8 is enough. On periodic axes, the way
    # around the period has its own roundings. `largest`, the sum of L over the axes, bounds the 1-norm of x - g.
    largest = float(largest_coordinates(domain).sum())
    if not _LEAST_LENGTH < largest < _MOST_LENGTH:
        return None
    blocks = motion_cost.blocks
    rates = (1 - _LENGTH_MARGIN) * least_rate * np.array([weight for _, weight in blocks])
    costs = rates * largest
    # A number takes 4 bytes: coordinates of goals, the group and about one rate for each axis.
    fits = 4 * (len(goals) + 2) * domain.dim <= _STRAIGHT_BYTES * max_bytes and len(goals) <= MOST_GOALS
    if not (fits and ((costs > _LEAST_LENGTH) & (costs < _MOST_LENGTH)).all()):  # one goal with the rate 0
        goals, rates, blocks = np.zeros((1, domain.dim)), np.zeros(1), ((tuple(range(domain.dim)), 0.0),)
    groups = np.array([np.isin(np.arange(domain.dim), axes) for axes, _ in blocks], float)
    rates = np.float32(rates).astype(float)
    margin = (16 if domain.is_periodic else 8) * UNIT * largest * rates.sum()
    goals = np.float32(goals * domain.width).astype(float)
    is_simple = len(goals) == len(rates) == 1 and not domain.is_periodic  # the form of files of release 0.2
    return StraightBound(goals, groups, rates, float(np.float32(margin)), is_simple)


def _above_voxel_paths(
    field: CostToGoField, space: VoxelSpace, cells: Cells, coefficients: AtCorners, across: Points
) -> Float[np.ndarray, " leaves"]:
    """Return an upper bound of (cost-to-go - leaf function) in each leaf, from paths along the centers of voxels.

    ``cells`` are the leaves, and ``coefficients`` the values of each leaf function f at the corners of its leaf.
    ``across`` is the largest change of each leaf's f across the leaf, by axis, ``(leaves, dim)``. The bound is
    ``inf`` if the leaf overlaps a free voxel without a path to a goal. All bounds are ``inf`` if the robot has a
    radius, more than 2**24 voxels, or not three axes.
    """
    # From a free point x of a leaf, a path leads straight to the center c of its voxel, and on from center to center.
    # Let p be c clipped to the leaf's box. Along each axis, p lies between c and x: |x - p| <= |x - c| <= side / 2.
    # Also, |x - p| <= width of the leaf, as both are in the leaf. So
    #   cost-to-go(x) <= |x - c| + length(c) <= |sides| / 2 + length(c)
    #            f(x) >= f(p) - sum over axes of across * min(side / (2 * width of the leaf), 1)
    # An upper bound of cost-to-go(x) - f(x) is the sum of both (`spare`), plus the largest length(c) - f(p).
    grid = space.grid
    if grid.dim != 3 or space.radius > 0 or space.free.size > _MOST_VOXELS:
        return np.full(len(cells), np.inf)
    # 1. Lengths of paths from centers of voxels to goals, through the center of a free voxel that holds the goal.
    lengths = np.full(grid.padded.shape, np.inf)
    for goal in field.goals[:_VOXEL_GOALS]:
        # A goal on faces lies in several voxels: take a free one. Voxel number k has its center at k - 1/2, as
        # numbers start at 1.
        ends = np.stack(grid.numbers(goal[:, None]))[:, :, 0]  # least and largest number along each axis
        goal_voxel = next(voxel for voxel in product(*ends.T.tolist()) if grid.padded[voxel])
        center = space.domain.at((np.array(goal_voxel) - 0.5) / space.free.shape)
        to_goal = float(np.linalg.norm(goal - center))
        lengths = np.minimum(lengths, VoxelGraph(space.free, center, bounds=space.domain).lengths + to_goal)
    # 2. The part of the bound that is equal for all voxels of a leaf, with a margin for rounding.
    widths = space.domain.width * np.ldexp(1.0, -cells.depth)
    largest = max(float(np.abs(coefficients).max()), float(lengths[np.isfinite(lengths)].max()))
    spare = (1 + ROUNDING) * np.linalg.norm(grid.sides) / 2 + ROUNDING * largest
    spare = spare + np.sum(across * np.minimum(grid.sides / (2 * widths), 1.0), axis=1)
    # 3. The largest length(c) - f(p) over the free voxels that hold points of each leaf.
    lo, hi = cells.grown_boxes(space.domain)
    first = np.clip(grid.numbers(lo.T)[0].T, 1, space.free.shape)
    counts = np.clip(grid.numbers(hi.T)[1].T, 1, space.free.shape) - first + 1
    above = np.full(len(cells), -np.inf)
    for batch in parts(counts.prod(axis=1), _PAIRS_AT_ONCE):
        leaf, voxel = enumerate_boxes(first[batch], counts[batch])
        is_free = grid.padded[tuple(voxel.T)]
        leaf, voxel = leaf[is_free] + batch.start, voxel[is_free]
        at = np.ldexp((voxel - 0.5) / space.free.shape, cells.depth[leaf]) - cells.position[leaf]
        function = np.sum(basis(1, np.clip(at, 0.0, 1.0)) * coefficients[leaf], axis=1)
        np.maximum.at(above, leaf, lengths[tuple(voxel.T)] - function)
    return np.maximum(above + spare, 0.0)
