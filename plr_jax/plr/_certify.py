"""Proving how far a PLR can be from the distance function that it stands for."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from plr_jax._arrays import as_bool, shortened
from plr_jax._types import CellSources, CellwiseFn, DistanceFn
from plr_jax.geometry.box import Box
from plr_jax.geometry.convex_pieces import Pieces
from plr_jax.plr._file import Contents, body_of_leaves, filled_coefficients
from plr_jax.plr.certificate.bounds import LeafBounds, LeafFunctions, prove_bounds
from plr_jax.plr.certificate.certificate import Certificate, Proof
from plr_jax.plr.partition.cells import grown_domain, tree_of_levels

if TYPE_CHECKING:
    from plr_jax.plr._plr import PLR


def certify(plr: "PLR", oracle: DistanceFn, *, leaf_bounds: bool = False) -> "PLR":
    """Prove bounds of the distance for a PLR that exists.

    Nothing is sampled: the oracle says, for whole cells, which sources some of their points may use and which all of
    them can. The proof holds for all points of the domain from which the goal can be reached. It is about this
    oracle: where that is itself an approximation, as of an inflated workspace, so is the proof. Where free space
    touches itself in a point, the cell there holds both sides, and the proven error is at least half of the jump.

    Args:
        plr: The PLR, of any leaf model, in the plane.
        oracle: The distance function, one that answers for whole cells, as ``VisibilityGraph`` does.
        leaf_bounds: Whether to keep bounds of every leaf, 2 bytes each; else of a few classes of leaves, in at most a
            128th of what the leaves take, if that is 10 bytes at least; of smaller PLRs the largest error alone.

    Returns:
        The same PLR with this proof instead of any it had, in ``max_error`` and ``bounds``.

    Raises:
        ValueError: If it is no PLR in the plane, its domain has a periodic axis or lies so far from the origin that
            free space is known worse than to a 10,000th of its shorter side, ``leaf_bounds`` is no bool, the oracle
            does not answer for cells, or a leaf answers ``inf`` although some of its points reach the goal: then
            nothing can be proven.
    """
    from plr_jax.plr._assembly import with_certificate
    from plr_jax.plr._plr import PLR  # and JAX, which no proof needs

    if not isinstance(plr, PLR):
        raise ValueError(f"Only a PLR can be certified, got {shortened(plr)}.")
    if plr.tables.folding is not None:
        raise ValueError(
            "Nothing can be proven of a PLR whose points are folded, as by the symmetries of its distance function. "
            "Build it with certified=True."
        )
    proof = Proof.LEAVES if as_bool("leaf_bounds", leaf_bounds) else Proof.CLASSES
    root = require_certifiable(oracle, plr.domain).cell_sources(grown_domain(plr.domain))
    return with_certificate(plr, certificate_of(plr._contents, root, proof))


def require_certifiable(oracle: DistanceFn, domain: Box) -> CellwiseFn:
    """A distance function about which something can be proven; raises ``ValueError`` if it is none."""
    if domain.dim != 2 or not isinstance(oracle, CellwiseFn):
        raise ValueError(
            "A proof needs a distance function in the plane that answers for whole cells, such as VisibilityGraph, "
            f"got a {type(oracle).__name__} in {domain.dim} dimensions. Build the PLR without one, and measure its "
            "error."
        )
    if domain.is_periodic:
        raise ValueError(
            f"A proof is of Euclidean distances in the plane, which has no periodic axis, got {domain}. Build the "
            "PLR without one, and measure its error."
        )
    return oracle


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
    contents: Contents, bounds: LeafBounds, rounding: Float[np.ndarray, "leaves"], proof: Proof
) -> Certificate:
    """What a file keeps of bounds of leaves, and of what queries round."""
    volume = np.ldexp(1.0, -contents.cells.depth.sum(axis=1))
    return Certificate.of(bounds, rounding, proof, volume, len(body_of_leaves(contents).to_bytes()))


def _of_leaves(root: CellSources, contents: Contents) -> CellSources:
    """The sources of all leaves as cells, found down the tree."""
    tree = tree_of_levels(contents.levels, contents.domain.dim)
    visible, nodes, parts, leaves = root, np.zeros(1, np.int64), [], []
    while len(nodes):
        is_leaf = tree.child[nodes] < 0
        parts.append(visible.of_cells(np.flatnonzero(is_leaf)))
        leaves.append(nodes[is_leaf])
        inner = np.flatnonzero(~is_leaf)
        parent, axis = np.repeat(inner, 2), np.repeat(tree.axis[nodes[inner]], 2)
        nodes = (tree.child[nodes[inner], None] + np.arange(2)).ravel()
        is_upper = np.arange(len(nodes)) % 2 == 1
        lo, hi = tree.cells[nodes].grown_boxes(contents.domain)
        visible = visible.parts(parent, axis, is_upper, lo, hi)
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
