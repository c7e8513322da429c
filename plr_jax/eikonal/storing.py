"""PLRs of what has been found of a cost-to-go, with the proof: on its own mesh, or on a smaller partition."""

import numpy as np
from jaxtyping import Float, Int

from plr_jax.eikonal.elements import basis
from plr_jax.eikonal.field import CostToGoField
from plr_jax.plr._assembly import plr_of_leaves
from plr_jax.plr._file import Contents
from plr_jax.plr._filled import filled_coefficients
from plr_jax.plr._plr import PLR
from plr_jax.plr.certificate.branch_and_bound import LeafBounds
from plr_jax.plr.certificate.certificate import Certificate, Proof
from plr_jax.plr.file.container import frame_size
from plr_jax.plr.growth.limits import check_limits
from plr_jax.plr.growth.rules import best_axis, largest_error
from plr_jax.plr.leaves import leaf_model
from plr_jax.plr.leaves.base import CornerLeafModel, Rules
from plr_jax.plr.partition.cells import PLACING, Cells
from plr_jax.plr.partition.pairs import overlapping_leaves
from plr_jax.plr.partition.tree import Tree, corner_bits, levels_of, tree_of
from plr_jax.plr.sampling.cell_fit import Sampler
from plr_jax.plr.sampling.pattern import sample_pattern
from plr_jax.plr.sampling.plane_fits import least_squares
from plr_jax.spaces import CellState

_STEP_PER_GAP = 0.02  # of stored values, over the mean distance of the bounds
_SMALLEST_STEP = 2.0**-22  # of the largest value


def plr_on_mesh(field: CostToGoField, is_proven: bool) -> PLR:
    """One leaf a cell of the mesh: estimates at corners, tied across open faces."""
    mesh, model = field.mesh, _model()
    closed, values = mesh.state == CellState.BLOCKED, field.corner_values
    stored = model.of_corners(mesh.tree, mesh.all_faces, mesh.is_open_face, closed, values, _step(field))
    contents = Contents(mesh.domain, model, levels_of(mesh.cells)[0], mesh.cells, stored)
    return plr_of_leaves(_with_proof(contents, mesh.tree, field) if is_proven else contents)


def plr_of_bytes(field: CostToGoField, max_bytes: int, seed: int, is_proven: bool) -> PLR:
    """The best partition whose file has at most so many bytes, grown from the estimate."""
    model, domain = _model(), field.mesh.domain
    proof = Proof.OPEN_LEAVES if is_proven else Proof.NONE
    unit, frame = (model.least_bytes, False, model.bytes_without_budget), frame_size(domain)
    limits = check_limits(domain.dim, *unit, None, None, max_bytes, None, proof, frame)
    pattern = sample_pattern(domain.dim, model.num_samples, 0.0, seed)
    sampler = Sampler(field.estimates, domain, None, pattern, pattern, limits.max_axis_depth, least_squares, None)
    cells, stored = model.construct(sampler, Rules(largest_error, best_axis), limits)
    contents = Contents(domain, model, levels_of(cells)[0], cells, stored)
    return plr_of_leaves(_with_proof(contents, tree_of(cells), field) if is_proven else contents)


def _model() -> CornerLeafModel:
    model = leaf_model("continuous")
    assert isinstance(model, CornerLeafModel)
    return model


def _step(field: CostToGoField) -> float:
    least = max(_SMALLEST_STEP * float(np.abs(field.corner_values).max()), float(np.finfo(np.float32).tiny))
    return max(_STEP_PER_GAP * field.mean_gap, least)


def _with_proof(contents: Contents, tree: Tree, field: CostToGoField) -> Contents:
    """The leaves, with bounds of each over all cells of the mesh that meet it."""
    mesh, num_leaves = field.mesh, len(contents.cells)
    leaf, cell = overlapping_leaves(tree, mesh.tree)
    is_open = mesh.state[cell] != CellState.BLOCKED
    leaf, cell = leaf[is_open], cell[is_open]
    lo, hi = _intersections(contents.cells, leaf, mesh.cells, cell)
    corners = corner_bits(mesh.dim)
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
    below, above = field.bounds_over(cell, mesh.local(cell, lo), mesh.local(cell, hi), values)
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


def _intersections(
    a: Cells, i: Int[np.ndarray, "n"], b: Cells, j: Int[np.ndarray, "n"]
) -> tuple[Float[np.ndarray, "n dim"], Float[np.ndarray, "n dim"]]:
    """What pairs of cells have in common, as fractions of the domain."""
    ends = [
        (np.ldexp(c.position[k], -c.depth[k]), np.ldexp(c.position[k] + 1.0, -c.depth[k]))
        for c, k in ((a, i), (b, j))
    ]
    return np.maximum(ends[0][0], ends[1][0]), np.minimum(ends[0][1], ends[1][1])
