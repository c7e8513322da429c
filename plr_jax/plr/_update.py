"""A PLR after its map has changed."""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from plr_jax._arrays import require_integer, shortened
from plr_jax._types import ChangingFn, DistanceFn
from plr_jax.plr._certify import certificate_of_bounds, functions_of
from plr_jax.plr._file import Contents, filled_coefficients
from plr_jax.plr.certificate.bounds import LeafBounds, prove_bounds
from plr_jax.plr.certificate.certificate import Certificate, Proof
from plr_jax.plr.file.container import frame_size
from plr_jax.plr.growth.limits import check_limits
from plr_jax.plr.leaves.base import FamilyLeafModel, ProvenLeaves
from plr_jax.plr.partition.cells import levels_of, tree_of_levels

if TYPE_CHECKING:
    from plr_jax.plr._plr import PLR


def update(plr: "PLR", oracle: DistanceFn, before: DistanceFn, *, max_bytes: int | None = None) -> "PLR":
    """The PLR of a map that has changed here and there, with its proof, far sooner than one made from nothing.

    Of certified cones. Leaves in which all distances are proven to have changed by one number stay, with their
    sources, whose distances are kept in one place. The others get the best cones anew: they are put together where
    one will do, and halved where they err most, within the budget. That is not the best partition, which
    :func:`construct` finds: after many changes, or large ones, its error is less. If no such leaves fit into the
    bytes, all is constructed anew.

    Args:
        plr: The PLR.
        oracle: The oracle of the map as it is now, such as ``before.with_workspace(workspace)``, for the same goal.
        before: The one that the PLR is of.
        max_bytes: Most bytes of the file; None: as many as it has now. Who gives a budget gives it again: else what
            one change spares, the next ones lack.

    Returns:
        The PLR, of the same domain, label and kind of proof. ``bounds`` hold as those of a new one do.

    Raises:
        ValueError: If it is not one of cones with a proof, the oracles are no visibility graphs of one goal,
            ``before`` is found to be another one, or as for :func:`construct`.
    """
    from plr_jax.plr._assembly import plr_of_leaves
    from plr_jax.plr._construct import construct
    from plr_jax.plr._plr import PLR

    contents = plr._contents if isinstance(plr, PLR) else None
    certificate = None if contents is None else contents.certificate
    if contents is None or certificate is None or not isinstance(model := contents.leaf, FamilyLeafModel):
        raise ValueError(
            f"Only a PLR of certified cones can be updated, got {shortened(plr)}: construct it with leaf='cone' and "
            "certified=True."
        )
    if not isinstance(oracle, ChangingFn) or not isinstance(before, ChangingFn):
        got = f"{shortened(oracle)} and {shortened(before)}"
        raise ValueError(f"oracle and before must be of a map that changes, two VisibilityGraphs, got {got}.")
    require_integer("max_bytes", plr.num_bytes if max_bytes is None else max_bytes, 1)
    domain, frame = contents.domain, frame_size(contents.domain)
    most_bytes = (
        (plr.num_bytes if max_bytes is None else int(max_bytes)) + frame - frame_size(domain, label=plr.label)
    )
    unit = model.least_bytes, model.has_deep_trees, model.bytes_without_budget
    limits = check_limits(domain.dim, *unit, None, None, max(1, most_bytes), None, certificate.proof, frame)
    tree = tree_of_levels(contents.levels, domain.dim)
    leaves = ProvenLeaves(domain, tree, contents.stored, _bounds_of(plr, certificate))
    found = model.updated(leaves, oracle, before, limits)
    if found is None:
        options = {"max_bytes": max(1, most_bytes), "leaf_bounds": certificate.proof is Proof.LEAVES}
        return construct(oracle, domain, leaf=model, certified=True, **options).with_label(plr.label)
    new = Contents(domain, model, levels_of(found.cells)[0], found.cells, found.stored)
    bounds, coefficients = found.bounds, filled_coefficients(new)
    proven = prove_bounds(functions_of(new, coefficients, found.anew), found.visible)
    bounds.lower[found.anew], bounds.upper[found.anew] = proven.lower, proven.upper
    rounding = model.rounding(domain, new.cells, coefficients)
    certificate = certificate_of_bounds(new, bounds, rounding, certificate.proof)
    result = plr_of_leaves(replace(new, certificate=certificate)).with_label(plr.label)
    vars(result)["_leaf_bounds"] = bounds
    return result


def _bounds_of(plr: "PLR", certificate: Certificate) -> LeafBounds:
    """What is proven of each leaf: as it was found, or as the file has it."""
    if (bounds := vars(plr).get("_leaf_bounds")) is not None:
        return bounds
    lower, upper = np.broadcast_to(certificate.bounds(), (2, plr.num_leaves)).astype(np.float64)
    return LeafBounds(lower, upper)
