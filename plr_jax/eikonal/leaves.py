"""PLRs of what has been found of a cost-to-go, with the proof: on its own mesh, or on a smaller partition."""

import numpy as np
from jaxtyping import Float, Int

from plr_jax._arrays import runs
from plr_jax.eikonal.elements import basis
from plr_jax.eikonal.field import CostToGoField, MeshEstimate
from plr_jax.eikonal.mesh import Mesh
from plr_jax.plr._file import Contents, filled_coefficients
from plr_jax.plr._plr import PLR, plr_of_leaves
from plr_jax.plr.certificate import Certificate, LeafBounds, Proof
from plr_jax.plr.container import frame_size
from plr_jax.plr.growth.best_first import best_axis, largest_error
from plr_jax.plr.leaves import leaf_model
from plr_jax.plr.leaves.base import CornerLeafModel, Rules, check_limits
from plr_jax.plr.partition.cells import PLACING, Cells, Tree, corner_bits, levels_of, tree_of
from plr_jax.plr.partition.faces import overlapping_leaves
from plr_jax.plr.sampling.cell_fit import Sampler, least_squares, sample_pattern
from plr_jax.spaces import CellState

_STEP_PER_GAP = 0.02  # of stored values, over the mean distance of the bounds
_SMALLEST_STEP_UNPROVEN = 2.0**-15  # of the largest value, which estimates are not worth
_SMALLEST_STEP = 2.0**-22  # of the largest value


def plr_on_mesh(estimate: MeshEstimate, field: CostToGoField | None, max_bytes: float) -> PLR | None:
    """One leaf a cell of the mesh: estimates at corners, tied across open faces; None if the file is too large."""
    mesh, model = estimate.mesh, _model()
    closed, values = mesh.state == CellState.BLOCKED, estimate.corner_values
    step = _SMALLEST_STEP_UNPROVEN * float(values.max()) if field is None else _STEP_PER_GAP * field.mean_gap
    step = max(step, _SMALLEST_STEP * float(np.abs(values).max()), float(np.finfo(np.float32).tiny))
    stored = model.of_corners(mesh.tree, mesh.all_faces, mesh.is_open_face, closed, values, step)
    contents = Contents(mesh.domain, model, levels_of(mesh.cells)[0], mesh.cells, stored)
    plr = plr_of_leaves(contents)
    if field is not None and plr.num_bytes <= max_bytes:
        plr = plr_of_leaves(_with_proof(contents, mesh.tree, field))
    return plr if plr.num_bytes <= max_bytes else None


def plr_of_bytes(estimate: MeshEstimate, max_bytes: int, seed: int, field: CostToGoField | None) -> PLR:
    """The best partition whose file has at most so many bytes, grown from the estimate."""
    model, domain = _model(), estimate.mesh.domain
    proof = Proof.NONE if field is None else Proof.OPEN_LEAVES
    limits = check_limits(model, domain.dim, None, None, max_bytes, None, proof, frame_size(domain))
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
