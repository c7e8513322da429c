"""The leaves of a PLR after its map has changed."""

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from plr_jax._arrays import shortened
from plr_jax._types import ChangingFn, DistanceFn
from plr_jax.plr._file import Contents, filled_coefficients
from plr_jax.plr._proof import certificate_of_bounds, functions_of
from plr_jax.plr.certificate.bounds import LeafBounds, prove_bounds
from plr_jax.plr.file.container import frame_size
from plr_jax.plr.growth.limits import BudgetTooSmall, check_limits
from plr_jax.plr.leaves.base import FamilyLeafModel, ProvenLeaves
from plr_jax.plr.partition.cells import tree_of_levels


@dataclass(frozen=True, eq=False)
class Origin:
    """What a PLR was made of, which its file does not hold.

    Attributes:
        oracle: The distance function.
        max_bytes: The budget; None if there was none.
        max_leaves: Most leaves, likewise.
        tolerance: Errors that do not count, likewise.
        bounds: What is proven of each leaf; None: what the file has of it.
        priced: What the leaf model knows of the nodes of the tree; None: nothing yet.
    """

    oracle: DistanceFn
    max_bytes: int | None
    max_leaves: int | None = None
    tolerance: int | float | None = None
    bounds: LeafBounds | None = None
    priced: Any = None


def can_be_updated(contents: Contents) -> bool:
    """Whether they are certified cones."""
    return contents.certificate is not None and isinstance(contents.leaf, FamilyLeafModel)


def require_updatable(contents: Contents) -> None:
    """Raise ``ValueError`` if they are no certified cones."""
    if not can_be_updated(contents):
        not_ = "not " if contents.certificate is None else ""
        raise ValueError(
            f"Only a PLR of certified cones can be updated, got one of kind {contents.leaf.name!r} that is {not_}"
            "certified: construct it with leaf='cone' and certified=True."
        )


def updated_contents(contents: Contents, origin: Origin, oracle: DistanceFn, label: str) -> tuple[Contents, Origin]:
    """What :meth:`PLR.updated` makes of leaves, for a file with a label, and what it remembers of them."""
    certificate, model, domain, before = contents.certificate, contents.leaf, contents.domain, origin.oracle
    assert certificate is not None and isinstance(model, FamilyLeafModel), "see require_updatable"
    if not isinstance(oracle, ChangingFn) or not isinstance(before, ChangingFn):
        got = f"{shortened(oracle)} and {shortened(before)}"
        raise ValueError(f"oracle and before must be of a map that changes, two VisibilityGraphs, got {got}.")
    frame = frame_size(domain)
    of_label, max_bytes = frame_size(domain, label=label) - frame, origin.max_bytes
    if max_bytes is not None and (max_bytes := max_bytes - of_label) < 1:
        raise ValueError(f"max_bytes={origin.max_bytes} leaves no room beside the label, of {of_label} bytes.")
    unit = model.least_bytes, model.has_deep_trees, model.bytes_without_budget
    of_origin = origin.max_leaves, max_bytes, origin.tolerance
    limits = check_limits(domain.dim, *unit, None, *of_origin, certificate.proof, frame)
    tree, bounds = tree_of_levels(contents.levels, domain.dim), origin.bounds
    if bounds is None:
        lower, upper = np.broadcast_to(certificate.bounds(), (2, len(contents.cells))).astype(np.float64)
        bounds = LeafBounds(lower, upper)
    proven = ProvenLeaves(domain, tree, contents.stored, bounds, origin.priced)
    try:
        found = model.updated(proven, oracle, before, limits)
    except BudgetTooSmall as error:
        raise BudgetTooSmall(limits.max_bytes + of_label, error.num_bytes + of_label) from None
    new = Contents(domain, model, found.levels, found.cells, found.stored)
    bounds, coefficients = found.bounds, filled_coefficients(new)
    rounding, anew = model.rounding(domain, new.cells, coefficients), found.anew
    enough = partial(certificate.enough, rounding=rounding[anew])
    proven = prove_bounds(functions_of(new, coefficients, anew), found.visible, enough)
    bounds.lower[anew], bounds.upper[anew] = proven.lower, proven.upper
    new = replace(new, certificate=certificate_of_bounds(new, bounds, rounding, certificate.proof, certificate))
    return new, replace(origin, oracle=oracle, bounds=bounds, priced=found.priced)
