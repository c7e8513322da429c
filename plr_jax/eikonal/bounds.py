"""Proven bounds of the cost-to-go on a mesh of cells, an estimate between them, and a PLR that stores both."""

import warnings
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import parts, ragged_indices
from plr_jax.eikonal.elements import basis, to_bernstein
from plr_jax.eikonal.estimate import GridEstimate
from plr_jax.eikonal.goals import Goals, Points, nearest_goals
from plr_jax.eikonal.mesh import CellIndex, Mesh
from plr_jax.eikonal.paths import NodePaths
from plr_jax.eikonal.program import ROUNDING, SlopeProgram
from plr_jax.geometry.box import Box
from plr_jax.geometry.reach import Reach
from plr_jax.oracles import VoxelGraph
from plr_jax.plr._file import DecodedFile, cut_off_leaves, filled_coefficients
from plr_jax.plr._plr import PLR, plr_of_leaves
from plr_jax.plr.certificate import MOST_GOALS, Certificate, LeafBounds, Proof, StraightBound
from plr_jax.plr.container import frame_size
from plr_jax.plr.frame import enumerate_boxes
from plr_jax.plr.growth import best_axis, largest_error
from plr_jax.plr.leaf_faces import overlapping_leaves
from plr_jax.plr.leaves import StoredValues, TiedPartition, leaf_model
from plr_jax.plr.leaves.base import UNIT, Rules, check_limits, largest_coordinates
from plr_jax.plr.sampling import Sampler, least_squares, sample_pattern
from plr_jax.plr.tree import PLACING, Cells, corner_bits
from plr_jax.spaces import CellState, CheckedSpace, ConfigurationSpace, MotionCost, SeesBoxes, VoxelSpace

_MOST_VOXELS = 1 << 24  # most voxels of spaces in which paths from voxel to voxel give upper bounds
_VOXEL_GOALS = 8  # goals to which such paths lead; any of all goals serve
_PAIRS_AT_ONCE = 1 << 20  # pairs of a leaf and a voxel handled together
_BOXES_AT_ONCE = 1 << 10  # boxes handled together; beyond five axes each has thousands of points
# Step of stored values as a share of the mean gap between the bounds; least step as a share of the largest value.
_STEP_PER_GAP, _SMALLEST_STEP, _SMALLEST_STEP_UNPROVEN = 0.02, 2.0**-22, 2.0**-15
# A warning tells if an estimate leaves its bounds by `_OFF` of the lower bound, or of `_NEAR` of the largest one.
_OFF, _NEAR = 0.1, 0.01
# Relative margin for the length of a straight line in 32 bits; range of lengths whose squares 32 bits hold.
_OF_LENGTHS, _TINIEST, _LARGEST = 2.0**-20, 1e-15, 1e15
_STRAIGHT_BYTES = 0.4  # most bytes of goals for straight lines, as a share of the file
Numbers: TypeAlias = Float[np.ndarray, " n"]
AtCorners: TypeAlias = Float[np.ndarray, "n corners"]
CellCorners: TypeAlias = Float[np.ndarray, "cells corners"]


@dataclass(frozen=True, eq=False)
class MeshEstimate:
    """An estimate of the cost-to-go that is multilinear in each cell of a mesh, and ``inf`` in blocked cells."""

    mesh: Mesh
    corner_values: CellCorners  # 0 in blocked cells
    reach: Reach | None  # if known: which boxes hold points that paths join to a goal, and which hold others

    def __call__(self, x: Points) -> Numbers:
        mesh = self.mesh
        at = (mesh.domain.wrapped(x) - mesh.domain.lo) / mesh.domain.width
        cell = mesh.locate(at)
        values = np.sum(basis(1, np.clip(mesh.local(cell, at), 0, 1)) * self.corner_values[cell], axis=1)
        return np.where(mesh.state[cell] == CellState.BLOCKED, np.inf, values)


@dataclass(frozen=True, eq=False)
class CostToGoField:
    """A proven lower bound of the cost-to-go on a mesh, a proven upper bound, and an estimate between them."""

    program: SlopeProgram  # of the lower bound
    values: Float[np.ndarray, " dofs"]  # its solution, at most 0 at goals; before rescaling, slopes may be too large
    paths: NodePaths  # paths to the goal, whose costs are upper bounds
    nodal_estimate: Float[np.ndarray, " nodes"]  # at the corners of cells; inf where unknown
    nodal_goal: Int[np.ndarray, " nodes"] | None  # the goal of the estimated path from each node, without a guide
    space: ConfigurationSpace
    reach: Reach | None  # of the estimate
    guide: GridEstimate | None  # an estimate interpolated on a grid, for up to three axes; of the other part

    @property
    def mesh(self) -> Mesh:
        return self.program.space.mesh

    @property
    def goals(self) -> Points:
        return self.mesh.domain.at(self.program.at)

    @cached_property
    def _nodal(self) -> Float[np.ndarray, "cells nodes"]:
        return (self.program.space.values @ self.values).reshape(len(self.mesh.state), -1)

    @cached_property
    def _rescaling(self) -> tuple[Float[np.ndarray, " levels"], Float[np.ndarray, " levels"]]:
        return self.program.rescaling(self.values)

    @cached_property
    def _lower_at_corners(self) -> CellCorners:
        # The larger of two proven bounds: the rescaled solution, and the cost of a straight motion at the least rate.
        is_corner = np.isin(self.program.space.lattice, (0, 1)).all(axis=1)
        proven = np.interp(self._nodal[:, is_corner], *self._rescaling)
        mesh, costs = self.mesh, self.program.costs
        places = mesh.domain.at(self.paths.points)
        if len(self.goals) == 1:
            straight = costs.motion_cost.norm(mesh.domain.difference(places, self.goals))
        else:
            straight = nearest_goals(self.goals, mesh.domain, costs.motion_cost, places)[0][:, 0]
        return np.maximum(proven, (costs.least_rate * straight)[mesh.corners])

    @cached_property
    def _upper_at_corners(self) -> CellCorners:
        is_open = self.mesh.state != CellState.BLOCKED
        return np.where(is_open[:, None], self.paths.cost[self.mesh.corners], np.inf)

    @cached_property
    def estimate(self) -> MeshEstimate:
        # Where the estimate is unknown, its excess over the lower bound continues that of nearby corners.
        mesh, lower, upper = self.mesh, self._lower_at_corners, self._upper_at_corners
        node, cell = mesh.corners[mesh.open_cells], mesh.open_cells
        excess = np.where(np.isfinite(self.nodal_estimate), self.nodal_estimate, np.nan)[node] - lower[cell]
        is_off = np.maximum(-excess, excess + lower[cell] - upper[cell]) > _OFF * np.maximum(
            lower[cell], _NEAR * lower.max()
        )
        if is_off.any() and not isinstance(self.space, CheckedSpace):  # nothing is proven of a sampled space
            warnings.warn(
                f"At {is_off.mean():.1%} of the corners of cells the estimate was more than a tenth outside of its "
                "bounds. The PLR answers the nearer bound there. Allow more max_leaves.",
                stacklevel=5,
            )
        values = np.zeros(mesh.corners.shape)
        values[cell] = np.minimum(lower[cell] + _filled(np.maximum(excess, 0.0), node), upper[cell])
        return MeshEstimate(mesh, values, self.reach)

    def which(self, x: Points) -> CellIndex:
        """Return the index of the goal to which the estimated path from each point leads."""
        mesh = self.mesh
        if self.nodal_goal is None:
            assert self.guide is not None
            return self.guide.which(x)
        at = (mesh.domain.wrapped(x) - mesh.domain.lo) / mesh.domain.width
        node = mesh.corners[mesh.locate(at)]
        offset = mesh.domain.difference(mesh.domain.at(mesh.nodes[node]), x[:, None])
        straight = self.program.costs.motion_cost.norm(offset.reshape(-1, mesh.dim)).reshape(node.shape)
        total = self.nodal_estimate[node] + straight * self.program.costs.least_rate
        best = node[np.arange(len(x)), total.argmin(axis=1)]
        distance, nearest = nearest_goals(self.goals, mesh.domain, self.program.costs.motion_cost, x)
        is_near = distance[:, 0] * self.program.costs.least_rate <= total.min(axis=1)
        return np.where(is_near | np.isinf(self.nodal_estimate[best]), nearest[:, 0], self.nodal_goal[best])

    @property
    def mean_gap(self) -> float:
        is_known = np.isfinite(self._upper_at_corners)
        return float((self._upper_at_corners - self._lower_at_corners)[is_known].mean()) if is_known.any() else 0.0

    def bounds_over(self, cell: CellIndex, lo: Points, hi: Points, corners: AtCorners) -> tuple[Numbers, Numbers]:
        """Bound the difference between the cost-to-go and a multilinear function from below and above in each box.

        A box lies in the mesh cell of index ``cell``, which is not blocked; its corners ``lo`` and ``hi`` are local
        coordinates of this cell, from 0 to 1. ``corners`` are the function's values at all corners of the box. The
        bounds also hold at points slightly outside of the box, which rounding may assign to it. An upper bound is
        ``inf`` if paths are not known from all free points of the box.
        """
        mesh, space, dim = self.mesh, self.program.space, self.mesh.dim
        below, above = np.empty(len(cell)), np.empty(len(cell))
        grid = np.array(list(product((0.0, 0.5, 1.0), repeat=dim)))
        middles = 0.25 + corner_bits(dim) / 2
        vertices = np.stack([np.flatnonzero(np.all(np.abs(grid - middle) <= 0.25, axis=1)) for middle in middles])
        for some in parts(np.ones(len(cell), np.int64), _BOXES_AT_ONCE):
            c, spare = cell[some], self._spare[cell[some]]
            # 1. Lower bounds: control values of the difference bound it.
            at = lo[some, None] + (hi - lo)[some, None] * space.lattice
            weights = basis(space.degree, at.reshape(-1, dim)).reshape(*at.shape[:2], -1)
            control = np.einsum("nij,nj->ni", weights, self._nodal[c]) @ to_bernstein(space.degree, dim).T
            function, highest = corners[some] @ basis(1, space.lattice).T, control.max(axis=1)
            bent = np.interp(highest, *self._rescaling) - highest  # rescaling lowers the highest value the most
            straight = self._below_straight(*(mesh.domain.at(mesh.fractions(c, end[some])) for end in (lo, hi)))
            proven = (control - function).min(axis=1) + bent
            below[some] = np.maximum(proven, (straight - corners[some]).min(axis=1)) - spare
            # 2. Upper bounds by straight motions to corners of the cell, or to its targets. Costs are convex, so the
            #    largest is at a vertex of a part of the box.
            at = lo[some, None] + (hi - lo)[some, None] * grid
            function = corners[some] @ basis(1, grid).T
            most = np.full((len(c), len(vertices)), np.inf)
            for corner, place in enumerate(corner_bits(dim)):
                change = ((place - at) * mesh.widths[c][:, None]).reshape(-1, dim)
                straight = self.program.costs.of_motions(change, np.repeat(c, at.shape[1])).reshape(at.shape[:2])
                by_corner = self._upper_at_corners[c, corner, None] + straight - function
                by_corner[~self._sees[c, corner]] = np.inf
                most = np.minimum(most, by_corner[:, vertices].max(axis=2))
            x = mesh.fractions(c[:, None], at)
            for target in self._targets[:, c]:
                change = (self.paths.points[target, None] - x) * mesh.domain.width
                straight = self.program.costs.motion_cost.norm(change.reshape(-1, dim)).reshape(at.shape[:2])
                by_target = self.paths.cost[target, None] + straight - function
                by_target[target < 0] = np.inf
                most = np.minimum(most, by_target[:, vertices].max(axis=2))
            above[some] = most.max(axis=1) + spare
        return below, above

    def _below_straight(self, lo: Points, hi: Points) -> AtCorners:
        # Values at the corners of boxes of a function below the cost to the nearest goal, concave over each box.
        costs, domain, bits = self.program.costs, self.mesh.domain, corner_bits(self.mesh.dim)
        if domain.is_periodic:  # costs of motions either way around are not convex
            return np.zeros((len(lo), len(bits)))
        # The tangent of the cost to the nearest goal, and for others the cost from the middle less half a diagonal's.
        # With a norm, the cost to goal g is |x - g| >= s . (x - g) for the gradient s of the norm at the middle; that
        # to all other goals is at least the middle's less the norm of half the diagonal.
        distance, nearest = nearest_goals(self.goals, domain, costs.motion_cost, (lo + hi) / 2, 2)
        goal = self.goals[nearest[:, 0]]
        middle, slope = (lo + hi) / 2 - goal, np.zeros_like(lo)
        for axes, weight in costs.motion_cost.blocks:
            length = np.linalg.norm(middle[:, axes], axis=1, keepdims=True)
            slope[:, axes] = weight * middle[:, axes] / np.maximum(length, np.finfo(float).tiny)
        corners = lo[:, None] + (hi - lo)[:, None] * bits - goal[:, None]
        others = distance[:, 1] - np.linalg.norm(costs.motion_cost.scale * (hi - lo) / 2, axis=1)
        return costs.least_rate * np.minimum(np.einsum("nk,nck->nc", slope, corners), others[:, None])

    @cached_property
    def _targets(self) -> Int[np.ndarray, "targets cells"]:
        # Three nodes ahead of each cell on paths to a goal; -1 if not every straight motion from the cell is free.
        mesh, paths = self.mesh, self.paths
        if self.program.costs.cost_map is not None:
            return np.full((0, len(mesh.state)), -1)
        cells, costs = np.arange(len(mesh.state)), self._upper_at_corners
        nearest, farthest = (mesh.corners[cells, corner] for corner in (costs.argmin(axis=1), costs.argmax(axis=1)))
        ahead = paths.next[nearest]
        target = np.stack([ahead, paths.next[ahead], paths.next[farthest]])
        free = np.flatnonzero(np.isfinite(costs).any(axis=1) & (mesh.state == CellState.FREE))
        place = mesh.domain.at(paths.points[target[:, free]])
        lo, hi = (np.broadcast_to(end[free], place.shape) for end in mesh.grown_boxes)
        hull = np.minimum(lo, place).reshape(-1, mesh.dim), np.maximum(hi, place).reshape(-1, mesh.dim)
        sees = (self.space.classify(*hull) == CellState.FREE).reshape(3, -1)
        visible = np.full_like(target, -1)
        visible[:, free] = np.where(sees, target[:, free], -1)
        return visible

    @cached_property
    def _spare(self) -> Float[np.ndarray, " cells"]:
        # A margin for rounding: of values, and of points just outside a cell that count as inside.
        costs, beside = self.program.costs, PLACING * self.mesh.domain.width
        margin = costs.motion_cost.norm(beside[None]) * costs.upper
        if costs.pulls is not None:
            margin = margin + (np.abs(costs.pulls) @ beside).max(axis=0)
        return ROUNDING * max(np.abs(self._nodal).max(), self._lower_at_corners.max()) + margin

    @cached_property
    def _sees(self) -> Bool[np.ndarray, "cells corners"]:
        # Whether all straight motions to a corner are free, from the cell and from points just outside.
        mesh, (lo, hi) = self.mesh, self.mesh.grown_boxes
        free = np.flatnonzero(mesh.state == CellState.FREE)
        is_clear = self.space.classify(lo[free], hi[free]) == CellState.FREE
        # Around other free cells, each part of the grown box must be free or blocked. From a free part the shortest
        # motion to the cell is free, and beside a flush wall the other parts are blocked.
        beside = np.flatnonzero(~is_clear)
        ends, axes = np.stack([lo, *mesh.boxes, hi])[:, free[beside]], np.arange(mesh.dim)
        clear = np.ones(len(beside), bool)
        for part in product(range(3), repeat=mesh.dim):
            begin, end = ends[part, :, axes].T, ends[np.add(part, 1), :, axes].T
            some = np.flatnonzero((begin < end).all(axis=1))  # none at the border of the domain
            clear[some] &= self.space.classify(begin[some], end[some]) != CellState.MIXED
        is_clear[beside] = clear
        sees = np.zeros((len(mesh.state), 2**mesh.dim), bool)
        sees[free[is_clear]] = True
        if isinstance(self.space, SeesBoxes):
            cell, corner = np.nonzero(np.isfinite(self._upper_at_corners) & ~sees)
            q = np.stack(mesh.boxes)[corner_bits(mesh.dim)[corner], cell[:, None], np.arange(mesh.dim)]
            sees[cell, corner] = self.space.sees_boxes(q, lo[cell], hi[cell])
        return sees


def _filled(values: CellCorners, node: Int[np.ndarray, "cells corners"]) -> CellCorners:
    # Average the known values of a cell at its unknown corners, and such averages at a node, until nothing changes.
    values, num = values.copy(), int(node.max()) + 1
    while True:
        is_known = np.isfinite(values)
        count = is_known.sum(axis=1, keepdims=True)
        near = np.where(is_known, values, 0.0).sum(axis=1, keepdims=True) / np.maximum(count, 1)
        use = ~is_known & (count > 0)
        if not use.any():
            return np.where(is_known, values, 0.0)
        total = np.bincount(node[use], np.broadcast_to(near, values.shape)[use], num)
        weight = np.bincount(node[use], minlength=num)
        fill = np.divide(total, weight, out=np.full(num, np.nan), where=weight > 0)
        values = np.where(is_known, values, fill[node])


def plr_on_mesh(estimate: MeshEstimate, field: CostToGoField | None, max_bytes: float) -> PLR | None:
    """Return a PLR whose leaves are the cells of the mesh, or None if its file takes more than ``max_bytes``."""
    mesh = estimate.mesh
    closed, values = mesh.state == CellState.BLOCKED, estimate.corner_values
    step = _SMALLEST_STEP_UNPROVEN * float(values.max()) if field is None else _STEP_PER_GAP * field.mean_gap
    step = max(step, _SMALLEST_STEP * float(np.abs(values).max()), float(np.finfo(np.float32).tiny))
    partition = TiedPartition(mesh.tree, closed, mesh.all_faces, mesh.is_open_face)
    stored = StoredValues.quantize_corners(partition, values, step)
    cut_off = cut_off_leaves(estimate.reach, mesh.tree)
    contents = DecodedFile(mesh.domain, leaf_model("continuous"), mesh.tree, stored, cut_off=cut_off)
    plr = plr_of_leaves(contents)
    if field is not None and plr.num_bytes <= max_bytes:
        plr = plr_of_leaves(_with_proof(contents, field, _line_of(field, max_bytes)))
    return plr if plr.num_bytes <= max_bytes else None


def plr_of_bytes(estimate: MeshEstimate, max_bytes: int, seed: int, field: CostToGoField | None) -> PLR:
    """Return a PLR of at most ``max_bytes`` bytes, fitted to an estimate; ``field`` has its bounds, if any."""
    straight = None if field is None else _line_of(field, max_bytes)
    of_straight = 0 if straight is None else straight.num_bytes
    model, domain = leaf_model("continuous"), estimate.mesh.domain
    proof = Proof.NONE if field is None else Proof.OPEN_LEAVES
    limits = check_limits(model, domain.dim, None, None, max_bytes, None, proof, frame_size(domain) + of_straight)
    pattern = sample_pattern(domain.dim, model.num_samples, 0.0, seed)

    def distances(x: Points) -> Numbers:
        on_mesh = estimate(x)
        on_grid = on_mesh if field is None or field.guide is None else field.guide(x)
        return np.where(np.isfinite(on_grid), on_grid, on_mesh)

    rules = limits.max_axis_depth, least_squares, None, estimate.reach
    sampler = Sampler(distances, domain, None, pattern, pattern, *rules)
    tree, stored = model.construct(sampler, Rules(largest_error, best_axis), limits)
    contents = DecodedFile(domain, model, tree, stored, cut_off=cut_off_leaves(estimate.reach, tree))
    return plr_of_leaves(contents if field is None else _with_proof(contents, field, straight))


def _with_proof(contents: DecodedFile, field: CostToGoField, straight: StraightBound | None) -> DecodedFile:
    """Add proven bounds to each leaf: the worst bounds of the cells of the mesh that it meets."""
    mesh, tree, corners = field.mesh, contents.tree, corner_bits(field.mesh.dim)
    cells, num_leaves = tree.leaves, len(tree.leaves)
    # 1. Pairs of a leaf and a cell that it meets, with the open cell whose bounds hold there: the cell itself or, for
    #    a flush blocked cell, each open cell beside it, over what they share. The worst bounds count.
    leaf, cell = own_leaf, own_cell = overlapping_leaves(tree, mesh.tree)
    order = np.argsort(cell, kind="stable")
    flush, beside = mesh.flush_pairs
    first, last = (np.searchsorted(cell[order], flush, side=side) for side in ("left", "right"))
    pair, place = ragged_indices(last - first)
    is_open = mesh.state[cell] != CellState.BLOCKED
    open_pairs, flush_leaves = (leaf[is_open], cell[is_open]), leaf[order[first[pair] + place]]
    leaf = np.append(open_pairs[0], flush_leaves)
    within, cell = np.append(open_pairs[1], flush[pair]), np.append(open_pairs[1], beside[pair])
    # Free points without a path have no upper bound.
    closed = np.flatnonzero(mesh.state == CellState.BLOCKED)
    closed = closed[field.space.classify(*(end[closed] for end in mesh.boxes)) != CellState.BLOCKED]
    is_cut_off = np.isin(np.arange(num_leaves), own_leaf[np.isin(own_cell, closed)])
    # 2. The boxes that they share, and the leaf's function at their corners.
    lo, hi, turn = mesh.shared_boxes(within, cell)
    position, depth = cells.position[leaf], cells.depth[leaf]
    lo, hi = np.maximum(lo, np.ldexp(position, -depth)), np.minimum(hi, np.ldexp(position + 1.0, -depth))
    meet = (lo <= hi).all(axis=1)
    leaf, cell, turn, lo, hi = (column[meet] for column in (leaf, cell, turn, lo, hi))
    coefficients = filled_coefficients(contents)
    is_lost = np.isinf(coefficients[:, 0]) & (True if contents.cut_off is None else ~contents.cut_off)
    if is_lost[leaf].any():
        raise ValueError(
            "Nothing can be proven: some leaves answer inf, although some of their points, which no sample met, may "
            "reach the goal. Allow more max_bytes, or leave it out."
        )
    coefficients = np.where(np.isinf(coefficients[:, :1]), 0.0, coefficients)
    at = lo[:, None] + (hi - lo)[:, None] * corners
    t = np.ldexp(at, cells.depth[leaf][:, None]) - cells.position[leaf][:, None]
    weights = basis(1, t.reshape(-1, mesh.dim)).reshape(len(leaf), len(corners), -1)
    values = np.einsum("nij,nj->ni", weights, coefficients[leaf])
    # 3. The worst bounds of each leaf, and the change of its function to points that rounding places in it.
    below, above = field.bounds_over(cell, mesh.local(cell, lo + turn), mesh.local(cell, hi + turn), values)
    lower, upper = np.zeros(num_leaves), np.where(is_cut_off, np.inf, 0.0)
    np.minimum.at(lower, leaf, below)
    np.maximum.at(upper, leaf, above)
    beside = PLACING * np.ldexp(1.0, cells.depth)
    across = [np.abs(coefficients[:, bits == 1] - coefficients[:, bits == 0]).max(axis=1) for bits in corners.T]
    across = np.stack(across, axis=1)
    changes = np.sum(beside * across, axis=1) * np.prod(1 + 2 * beside, axis=1)
    if isinstance(field.space, VoxelSpace) and field.program.costs.cost_map is None:
        upper = np.minimum(upper, _above_voxel_paths(field, field.space, cells, coefficients, across))
    rounding = contents.leaf.rounding_bounds(contents.domain, cells, coefficients) + changes
    certificate = Certificate.of(LeafBounds(lower, upper), rounding, Proof.OPEN_LEAVES)
    return replace(contents, certificate=certificate, straight=straight)


def _line_of(field: CostToGoField, max_bytes: int | float) -> StraightBound | None:
    costs = field.program.costs
    return straight_bound(field.mesh.domain, costs.motion_cost, costs.least_rate, field.program.at, max_bytes)


def straight_bound(
    domain: Box, motion_cost: MotionCost, least_rate: float, goals: Goals, max_bytes: int | float
) -> StraightBound | None:
    """Return the least cost of straight motions to goals, less a margin for rounding.

    ``goals`` are fractions of the domain, and ``least_rate`` is the least cost of a motion whose norm is 1. The bound
    is 0 if there are more than 64 goals, if goals take more than 40 % of ``max_bytes``, or if 32 bits do not hold the
    squares of costs; None if 32 bits do not hold the squares of lengths.
    """
    largest, blocks = float(largest_coordinates(domain).sum()), motion_cost.blocks
    if not _TINIEST < largest < _LARGEST:
        return None
    # Rates cover the rounding of lengths, the margin that of coordinates to 32 bits.
    rates = (1 - _OF_LENGTHS) * least_rate * np.array([weight for _, weight in blocks])
    sizes = rates * largest
    if (
        4 * (len(goals) + 2) * domain.dim > _STRAIGHT_BYTES * max_bytes
        or len(goals) > MOST_GOALS
        or not ((sizes > _TINIEST) & (sizes < _LARGEST)).all()
    ):
        goals, rates, blocks = np.zeros((1, domain.dim)), np.zeros(1), ((tuple(range(domain.dim)), 0.0),)
    groups = np.array([np.isin(np.arange(domain.dim), axes) for axes, _ in blocks], float)
    rates = np.float32(rates).astype(float)
    margin = (16 if domain.is_periodic else 8) * UNIT * largest * rates.sum()
    goals = np.float32(goals * domain.width).astype(float)
    is_simple = len(goals) == len(rates) == 1 and not domain.is_periodic
    return StraightBound(goals, groups, rates, float(np.float32(margin)), is_simple)


def _above_voxel_paths(
    field: CostToGoField,
    space: VoxelSpace,
    cells: Cells,
    coefficients: Float[np.ndarray, "leaves corners"],
    across: Float[np.ndarray, "leaves dim"],
) -> Float[np.ndarray, " leaves"]:
    # Upper bounds of the cost-to-go minus each leaf's function, by paths along centers of voxels, or inf.
    grid = space.grid
    above = np.full(len(cells), np.inf)
    if grid.dim != 3 or space.radius > 0 or space.free.size > _MOST_VOXELS:
        return above
    # 1. Lengths of paths from centers of voxels to goals, through the center of a free voxel that holds the goal.
    lengths = np.full(grid.padded.shape, np.inf)
    for goal in field.goals[:_VOXEL_GOALS]:
        ends = np.stack(grid.numbers(goal[:, None]))[:, :, 0]
        holds = next(at for at in product(*ends.T.tolist()) if grid.padded[at])
        center = space.domain.at((np.array(holds) - 0.5) / space.free.shape)
        last = float(np.linalg.norm(goal - center))
        lengths = np.minimum(lengths, VoxelGraph(space.free, center, bounds=space.domain).lengths + last)
    # 2. Voxels that hold points of each leaf. The motion to the center is at most half a diagonal long, and along it
    #    the function changes by a share of its change across the leaf. The leaf's point nearest to the center counts.
    widths = space.domain.width * np.ldexp(1.0, -cells.depth)
    largest = max(float(np.abs(coefficients).max()), float(lengths[np.isfinite(lengths)].max()))
    spare = (1 + ROUNDING) * np.linalg.norm(grid.sides) / 2 + ROUNDING * largest
    spare = spare + np.sum(across * np.minimum(grid.sides / (2 * widths), 1.0), axis=1)
    lo, hi = cells.grown_boxes(space.domain)
    shape = np.array(grid.padded.shape)
    first = np.clip(grid.numbers(lo.T)[0].T, 1, shape - 2)
    last_voxel = np.clip(grid.numbers(hi.T)[1].T, 1, shape - 2)
    counts = last_voxel - first + 1
    above[:] = -np.inf
    for some in parts(counts.prod(axis=1), _PAIRS_AT_ONCE):
        leaf, voxel = enumerate_boxes(first[some], counts[some])
        leaf = leaf + some.start
        is_free = grid.padded[tuple(voxel.T)]
        leaf, voxel = leaf[is_free], voxel[is_free]
        at = np.ldexp((voxel - 0.5) / space.free.shape, cells.depth[leaf]) - cells.position[leaf]
        function = np.sum(basis(1, np.clip(at, 0.0, 1.0)) * coefficients[leaf], axis=1)
        np.maximum.at(above, leaf, lengths[tuple(voxel.T)] - function)
    return np.maximum(above + spare, 0.0)
