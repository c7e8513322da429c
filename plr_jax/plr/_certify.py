"""Proving how far a PLR can be from the distance function that it stands for."""

from typing import TYPE_CHECKING

from plr_jax._arrays import as_bool, shortened
from plr_jax._types import CellwiseFn, ChangingFn, DistanceFn
from plr_jax.geometry.box import Box
from plr_jax.plr._proof import Origin, certificate_of
from plr_jax.plr.certificate import Proof
from plr_jax.plr.leaves import Cone
from plr_jax.plr.tree import grown_domain

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
    from plr_jax.plr._plr import (
        PLR,  # and JAX, which no proof needs
        with_certificate,
    )

    if not isinstance(plr, PLR):
        raise ValueError(f"Only a PLR can be certified, got {shortened(plr)}.")
    if plr.tables.folding is not None:
        raise ValueError(
            "Nothing can be proven of a PLR whose points are folded, as by the symmetries of its distance function. "
            "Build it with certified=True."
        )
    proof = Proof.LEAVES if as_bool("leaf_bounds", leaf_bounds) else Proof.CLASSES
    root = require_certifiable(oracle, plr.domain).cell_sources(grown_domain(plr.domain))
    certified = with_certificate(plr, certificate_of(plr._contents, root, proof))
    if isinstance(plr.leaf, Cone) and isinstance(oracle, ChangingFn):
        certified.origin = Origin(oracle, certified.num_bytes)
    return certified


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
