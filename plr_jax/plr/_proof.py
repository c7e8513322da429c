"""Proofs of leaves, from the sources of their domain, or of some of them alone."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from plr_jax._types import CellSources
from plr_jax.geometry.convex_pieces import Pieces
from plr_jax.plr._file import Contents, body_of_leaves, filled_coefficients
from plr_jax.plr.certificate.bounds import LeafBounds, LeafFunctions, prove_bounds
from plr_jax.plr.certificate.certificate import Certificate, Proof
from plr_jax.plr.partition.cells import tree_of_levels
from plr_jax.plr.sampling.cell_memory import sources_down

_COARSEST = 1e-4  # of a domain's shorter side, to which its free space is known if something is to be proven


def certificate_of(contents: Contents, root: CellSources, proof: Proof) -> Certificate:
    """The proof for leaves, from the sources of their grown domain."""
    domain, cells, leaf = contents.domain, contents.cells, contents.leaf
    if root.slack > _COARSEST * domain.width.min():
        raise ValueError(
            f"Nothing is proven of {domain}: its free space is known to {root.slack:.2g} only, above "
            f"{_COARSEST:g} of the shorter side: it is too far from the origin for its size, too narrow for its "
            "length, or small beside its workspace. Choose an origin that is near, cut it in parts, or build it "
            "without a proof."
        )
    coefficients = filled_coefficients(contents)
    visible = _of_leaves(root, contents)
    if (blind := np.flatnonzero(np.isinf(coefficients[np.unique(visible.cell), 0]))).size:
        lo, hi = cells.boxes(domain)
        at = np.unique(visible.cell)[blind[0]]
        raise ValueError(
            f"Nothing can be proven: the leaf from {lo[at].tolist()} to {hi[at].tolist()} answers inf, although some "
            "of its points reach the goal, which no sample met. Build the PLR with certified=True."
        )
    coefficients = np.where(np.isinf(coefficients[:, :1]), 0.0, coefficients)
    functions = functions_of(contents, coefficients, np.arange(len(cells)))
    rounding = leaf.rounding(domain, cells, coefficients)
    return certificate_of_bounds(contents, prove_bounds(functions, visible), rounding, proof)


def certificate_of_bounds(
    contents: Contents,
    bounds: LeafBounds,
    rounding: Float[np.ndarray, "leaves"],
    proof: Proof,
    before: Certificate | None = None,
) -> Certificate:
    """What a file keeps of bounds of leaves, and of what queries round; with the classes before, if these will do."""
    volume = np.ldexp(1.0, -contents.cells.depth.sum(axis=1))
    return Certificate.of(bounds, rounding, proof, volume, len(body_of_leaves(contents).to_bytes()), before)


def _of_leaves(root: CellSources, contents: Contents) -> CellSources:
    """The sources of all leaves as cells, found down the tree."""
    tree = tree_of_levels(contents.levels, contents.domain.dim)
    parts, leaves = [], []
    for nodes, visible in sources_down(tree, root, contents.domain):
        is_leaf = tree.child[nodes] < 0
        parts.append(visible.of_cells(np.flatnonzero(is_leaf)))
        leaves.append(nodes[is_leaf])
    order = np.argsort(np.concatenate(leaves))
    place = np.argsort(np.argsort(tree.node_of_leaf))
    return parts[0].append(*parts[1:]).of_cells(order[place])


def functions_of(
    contents: Contents, coefficients: Float[np.ndarray, "all_leaves terms"], leaf: Int[np.ndarray, "leaves"]
) -> LeafFunctions:
    """What some leaves hold, numbered as they are given."""
    return _Functions(contents, coefficients[leaf], *contents.cells[leaf].boxes(contents.domain))


@dataclass(frozen=True, eq=False)
class _Functions:
    """What the leaves hold, for :func:`prove_bounds`."""

    contents: Contents
    coefficients: Float[np.ndarray, "leaves terms"]
    lo: Float[np.ndarray, "leaves dim"]
    hi: Float[np.ndarray, "leaves dim"]

    def values(self, leaf: Int[np.ndarray, "n"], x: Float[np.ndarray, "n dim"]) -> Float[np.ndarray, "n"]:
        return self.contents.leaf.values(self.lo[leaf], self.hi[leaf], self.coefficients[leaf], x)

    def below_cones(
        self,
        leaf: Int[np.ndarray, "n"],
        pieces: Pieces,
        apex: Float[np.ndarray, "n 2"],
        offset: Float[np.ndarray, "n"],
    ) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
        functions = self.lo[leaf], self.hi[leaf], self.coefficients[leaf]
        return self.contents.leaf.below_cones(*functions, pieces, apex, offset)
