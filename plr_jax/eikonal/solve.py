"""Straight from a configuration space to a PLR, without an oracle and without a roadmap."""

import warnings

import numpy as np
from jaxtyping import Float, Int
from tqdm import tqdm

from plr_jax._arrays import as_bool, as_finite, as_finite_point, require_integer, runs, shortened
from plr_jax._types import ArrayLike
from plr_jax.eikonal.elements import basis
from plr_jax.eikonal.estimate import MOST_AXES, swept_estimate
from plr_jax.eikonal.field import CostToGoField, MeshEstimate
from plr_jax.eikonal.lower import SlopeSolver
from plr_jax.eikonal.mesh import Mesh, SampledSpace, coarse_mesh
from plr_jax.eikonal.paths import guided_paths, shortest_paths
from plr_jax.plr._assembly import plr_of_leaves
from plr_jax.plr._file import Contents, filled_coefficients
from plr_jax.plr._plr import PLR
from plr_jax.plr.certificate.bounds import LeafBounds
from plr_jax.plr.certificate.certificate import Certificate, Proof
from plr_jax.plr.file.container import frame_size
from plr_jax.plr.growth.best_first import best_axis, largest_error
from plr_jax.plr.growth.limits import ConstructionInterrupted, check_limits
from plr_jax.plr.leaves import leaf_model
from plr_jax.plr.leaves.base import CornerLeafModel, Rules
from plr_jax.plr.partition.cells import PLACING, Cells, Tree, corner_bits, levels_of, tree_of
from plr_jax.plr.partition.faces import overlapping_leaves
from plr_jax.plr.sampling.cell_fit import Sampler, least_squares, sample_pattern
from plr_jax.spaces import CellState, ConfigurationSpace, CostMap, FreeTest, require_space

# PLRs of what has been found of a cost-to-go, with the proof: on its own mesh, or on a smaller partition.


_STEP_PER_GAP = 0.02  # of stored values, over the mean distance of the bounds
_SMALLEST_STEP_UNPROVEN = 2.0**-15  # of the largest value, which estimates are not worth
_SMALLEST_STEP = 2.0**-22  # of the largest value


def plr_on_mesh(estimate: MeshEstimate, field: CostToGoField | None) -> PLR:
    """One leaf a cell of the mesh: estimates at corners, tied across open faces."""
    mesh, model = estimate.mesh, _model()
    closed, values = mesh.state == CellState.BLOCKED, estimate.corner_values
    step = _SMALLEST_STEP_UNPROVEN * float(values.max()) if field is None else _STEP_PER_GAP * field.mean_gap
    step = max(step, _SMALLEST_STEP * float(np.abs(values).max()), float(np.finfo(np.float32).tiny))
    stored = model.of_corners(mesh.tree, mesh.all_faces, mesh.is_open_face, closed, values, step)
    contents = Contents(mesh.domain, model, levels_of(mesh.cells)[0], mesh.cells, stored)
    return plr_of_leaves(contents if field is None else _with_proof(contents, mesh.tree, field))


def plr_of_bytes(estimate: MeshEstimate, max_bytes: int, seed: int, field: CostToGoField | None) -> PLR:
    """The best partition whose file has at most so many bytes, grown from the estimate."""
    model, domain = _model(), estimate.mesh.domain
    proof = Proof.NONE if field is None else Proof.OPEN_LEAVES
    unit, frame = (model.least_bytes, False, model.bytes_without_budget), frame_size(domain)
    limits = check_limits(domain.dim, *unit, None, None, max_bytes, None, proof, frame)
    pattern = sample_pattern(domain.dim, model.num_samples, 0.0, seed)
    sampler = Sampler(estimate, domain, None, pattern, pattern, limits.max_axis_depth, least_squares, None)
    cells, stored = model.construct(sampler, Rules(largest_error, best_axis), limits)
    contents = Contents(domain, model, levels_of(cells)[0], cells, stored)
    return plr_of_leaves(contents if field is None else _with_proof(contents, tree_of(cells), field))


def _model() -> CornerLeafModel:
    model = leaf_model("continuous")
    assert isinstance(model, CornerLeafModel)
    return model


def _with_proof(contents: Contents, tree: Tree, field: CostToGoField) -> Contents:
    """The leaves, with bounds of each over all cells of the mesh that meet it."""
    mesh, num_leaves, corners = field.mesh, len(contents.cells), corner_bits(field.mesh.dim)
    leaf, within, cell = _answering(tree, mesh)
    lo, hi, turn = mesh.shared_boxes(within, cell)
    position, depth = contents.cells.position[leaf], contents.cells.depth[leaf]
    lo, hi = np.maximum(lo, np.ldexp(position, -depth)), np.minimum(hi, np.ldexp(position + 1.0, -depth))
    meet = (lo <= hi).all(axis=1)
    leaf, cell, turn, lo, hi = (each[meet] for each in (leaf, cell, turn, lo, hi))
    coefficients = filled_coefficients(contents)
    if np.isinf(coefficients[leaf, 0]).any():
        raise ValueError(
            "Nothing can be proven: some leaves answer inf, although some of their points, which no sample met, may "
            "reach the goal. Allow more max_bytes, or leave it out."
        )
    coefficients = np.where(np.isinf(coefficients[:, :1]), 0.0, coefficients)
    at = lo[:, None] + (hi - lo)[:, None] * corners
    t = np.ldexp(at, contents.cells.depth[leaf][:, None]) - contents.cells.position[leaf][:, None]
    weights = basis(1, t.reshape(-1, mesh.dim)).reshape(len(leaf), len(corners), -1)
    values = np.einsum("nij,nj->ni", weights, coefficients[leaf])
    below, above = field.bounds_over(cell, mesh.local(cell, lo + turn), mesh.local(cell, hi + turn), values)
    lower, upper = np.zeros(num_leaves), np.zeros(num_leaves)
    np.minimum.at(lower, leaf, below)
    np.maximum.at(upper, leaf, above)
    rounding = contents.leaf.rounding(contents.domain, contents.cells, coefficients)
    rounding = rounding + _changes_beside(contents.cells, coefficients)
    certificate = Certificate.of(LeafBounds(lower, upper), rounding, Proof.OPEN_LEAVES)
    return Contents(contents.domain, contents.leaf, contents.levels, contents.cells, contents.stored, certificate)


def _changes_beside(cells: Cells, coefficients: Float[np.ndarray, "leaves corners"]) -> Float[np.ndarray, "leaves"]:
    """How far the functions of leaves change, at the most, from a leaf to where a query may place points in it."""
    beside, corners = PLACING * np.ldexp(1.0, cells.depth), corner_bits(cells.dim)
    across = [coefficients[:, bits == 1] - coefficients[:, bits == 0] for bits in corners.T]
    steepest = np.stack([np.abs(change).max(axis=1) for change in across], axis=1)
    return np.sum(beside * steepest, axis=1) * np.prod(1 + 2 * beside, axis=1)


def _answering(tree: Tree, mesh: Mesh) -> Int[np.ndarray, "3 boxes"]:
    """Leaves, cells that they meet, and the open cells that bound the cost-to-go of free points placed in both.

    Those are the cells themselves, and of what is flush with open cells these, at what they have in common.
    """
    leaf, cell = overlapping_leaves(tree, mesh.tree)
    order = np.argsort(cell, kind="stable")
    flush, beside = mesh.flush_pairs
    first, last = (np.searchsorted(cell[order], flush, side=side) for side in ("left", "right"))
    pair, place = runs(last - first)
    is_open = mesh.state[cell] != CellState.BLOCKED
    own = np.stack([leaf, cell, cell])[:, is_open]
    return np.append(own, [leaf[order[first[pair] + place]], flush[pair], beside[pair]], axis=1)


_MAX_CELLS = {1: 2_000, 2: 10_000}
_MAX_CELLS_BEYOND = 50_000
_BOXES_PER_CELL = 4  # of the grid of the estimate
_BESIDE = 1e-6  # of the domain, by which a goal that is free to a tolerance may be outside


def solve_eikonal(
    space: ConfigurationSpace | FreeTest,
    goal: ArrayLike,
    *,
    cost_map: CostMap | None = None,
    max_leaves: int | None = None,
    max_bytes: int | None = None,
    tolerance: int | float | None = None,
    certified: bool = True,
    seed: int = 0,
) -> PLR:
    """Build a PLR of the cost-to-go of a configuration space: no oracle, no roadmap.

    Cells are halved where that matters, and proven free, blocked, or neither. The largest function that is 0 at the
    goal, continuous across every face that is not proven blocked, and nowhere steeper than a step costs, is a lower
    bound of the cost of every path, in any dimension. Paths through cells that are proven free bound it from above.
    The PLR itself is an estimate between the two. Where costs vary, that is a semi-Lagrangian one of second order, on
    a grid of four times as many nodes; else mixed cells count as free or blocked for it, by one motion each.
    ``plr.bounds`` has both bounds: as what is proven of a PLR always, they hold for every point from which the goal
    can be reached.

    Args:
        space: What is free, and what motions cost. Of one that only tests configurations (:class:`FreeTest`), cells
            count as free or blocked if all samples in them are: the PLR is an estimate, of which nothing is proven.
        goal: The goal, ``(dim,)``, free.
        cost_map: A factor of the cost of motions that differs from place to place, such as the reciprocal of a
            speed, whose bounds over boxes are known; None: 1 everywhere.
        max_leaves: Most cells. None: 2,000 on a line, 10,000 in the plane, 50,000 in more dimensions.
        max_bytes: Most bytes of the file. The leaves are then others than the cells: as few as that allows, grown
            from what was found on the cells. None: a leaf a cell, in as many bytes as that takes.
        tolerance: The mean distance of the lower bound to the truth, as estimated, at which no more cells are halved,
            in units of cost, at least 0; None: 0, so that all of ``max_leaves`` are used.
        certified: Whether bounds are proven. If not, of up to three axes, the PLR is an estimate alone, found by
            sweeps over a grid, once these are compiled within a fraction of a second. Its cells are about equally
            wide along every axis, and there is no ``tolerance``.
        seed: Seed of samples.

    Returns:
        The PLR, of continuous leaves. ``plr(x)`` is finite wherever a cell is connected to the goal's by faces that
        are not proven blocked. Upper bounds are ``inf`` where no path was found. If interrupted (Ctrl-C) once there
        is a first solution, that of the cells there are, with a ``ConstructionInterrupted`` warning. If the lower
        bound, which is proven all the same, was still rising when iterations ran out, a ``UserWarning`` says so.

    Raises:
        ValueError: If the space is none, the goal is not a free configuration of it, a limit is out of its range or
            too small (for one leaf, for four cells along each periodic axis, for cells at most 200,000 times as long
            as wide, for samples in all open cells or, without proof, for a free motion from a corner of a cell to the
            goal), ``certified=False`` comes with more than three axes or a tolerance, bounds of the cost map are not
            positive and finite, or it is directional and the space's cost no length.

    References:
        Section VII of the paper asks for it. The dual of the program is Beckmann's flow, 1952; see ``program.py``.
    """
    require_space(space)
    if cost_map is not None and not isinstance(cost_map, CostMap):
        raise ValueError(f"cost_map must be a CostMap, such as LipschitzCost, got {shortened(cost_map)}.")
    require_integer("seed", seed, 0)
    most = _MAX_CELLS.get(space.domain.dim, _MAX_CELLS_BEYOND)
    if max_leaves is not None:
        require_integer("max_leaves", max_leaves, 1)
        most = int(max_leaves)
    if max_bytes is not None:
        require_integer("max_bytes", max_bytes, 1)
    if not as_bool("certified", certified) and (space.domain.dim > MOST_AXES or tolerance is not None):
        got = f"{space.domain.dim} axes" + ("" if tolerance is None else f" and tolerance={tolerance}")
        raise ValueError(
            f"certified=False is for up to {MOST_AXES} axes, without a tolerance, got {got}: leave it out."
        )
    tolerance = 0.0 if tolerance is None else as_finite("tolerance", tolerance)
    at = _fraction(space, goal)
    is_proven = isinstance(space, ConfigurationSpace)
    cells = space if isinstance(space, ConfigurationSpace) else SampledSpace(space, int(seed))
    if certified:
        field = _field(cells, cost_map, at, most, tolerance)
        estimate, proven = field.estimate, field if is_proven else None
    else:
        estimate, proven = _swept(cells, cost_map, at, most), None
    if max_bytes is None:
        return plr_on_mesh(estimate, proven)
    return plr_of_bytes(estimate, int(max_bytes), int(seed), proven)


def _fraction(space: FreeTest, goal: ArrayLike) -> Float[np.ndarray, "dim"]:
    """The goal as a fraction of the domain; ``ValueError`` if one cannot be there."""
    domain = space.domain
    goal = as_finite_point("goal", goal)
    if goal.shape != (domain.dim,):
        raise ValueError(f"goal must have {domain.dim} coordinates, as the space has axes, got {goal.size}.")
    at = (domain.wrapped(goal[None])[0] - domain.lo) / domain.width
    if not (np.abs(at - 0.5) <= 0.5 + _BESIDE).all() or not space.is_free(goal[None])[0]:
        raise ValueError(f"goal must be a free configuration of the space, {goal.tolist()} is not.")
    return np.clip(at, 0.0, 1.0)


def _swept(
    space: ConfigurationSpace, cost_map: CostMap | None, goal: Float[np.ndarray, "dim"], most: int
) -> MeshEstimate:
    """The estimate alone, on cells that are about equally wide along every axis."""
    mesh = coarse_mesh(space, space.motion_cost.scale, most, most)
    costs = swept_estimate(space, cost_map, goal, _BOXES_PER_CELL * most)(mesh.nodes)
    if not np.isfinite(costs).any():
        raise ValueError(
            f"max_leaves must be so many that a corner of a cell has a free motion to the goal, got {most}: allow "
            "more, or leave out certified=False."
        )
    is_reached = np.isfinite(costs)[mesh.corners].any(axis=1)
    mesh = mesh.without(np.logical_not(is_reached))
    return MeshEstimate.of_nodes(mesh, costs)


def _field(
    space: ConfigurationSpace, cost_map: CostMap | None, goal: Float[np.ndarray, "dim"], most: int, tolerance: float
) -> CostToGoField:
    solver = SlopeSolver(space, cost_map, goal, most, tolerance)
    with tqdm(desc="solve_eikonal", total=most, unit=" cells", delay=3, leave=False, disable=None) as progress:
        try:
            solver.refine(progress)
        except KeyboardInterrupt:
            if not solver.has_solution:
                raise
            message = f"Interrupted at {len(solver.mesh.state):,} of {most:,} cells: the PLR is of these."
            warnings.warn(message, ConstructionInterrupted, stacklevel=3)
    program, mesh = solver.program, solver.mesh
    if cost_map is None or mesh.dim > MOST_AXES:
        paths = shortest_paths(mesh, program.costs, goal, space)
        likely = shortest_paths(solver.likely_mesh(), program.costs.midway, goal, space).cost[:-1]
    else:
        guide = swept_estimate(space, cost_map, goal, _BOXES_PER_CELL * most)
        paths, likely = guided_paths(mesh, program.costs, goal, space, guide), guide(mesh.nodes)
    return CostToGoField(program, solver.values, paths, likely, space)
