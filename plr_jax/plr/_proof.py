"""Prove error bounds of all leaves of a PLR, and encode them for its file."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from plr_jax._types import CellSources
from plr_jax.plr._file import DecodedFile, body_of_leaves, filled_coefficients
from plr_jax.plr.certificate import Certificate, Errors, LeafBounds, LeafFunctions, Proof, prove_bounds

_COARSEST = 1e-4  # largest uncertainty of free space for a proof, in units of the domain's shorter side


def certificate_of(contents: DecodedFile, visible: CellSources, proof: Proof) -> Certificate:
    """Prove bounds of each leaf's error, and encode them for the PLR's file.

    ``visible`` has, for each leaf, the corners (or the goal) to which shortest paths from the leaf may go first.
    """
    return certificates_of([contents], visible, proof)[0]


def certificates_of(contents: Sequence[DecodedFile], visible: CellSources, proof: Proof) -> list[Certificate]:
    """Prove the bounds of several PLRs of one leaf model and one domain at once; see :func:`certificate_of`.

    The cells of ``visible`` are the leaves of all PLRs, one PLR after another.
    """
    # 1. Concatenate the functions of all leaves. A leaf without a function may have no point that reaches the goal.
    domain, leaf = contents[0].domain, contents[0].leaf
    if visible.slack > _COARSEST * domain.width.min():
        raise ValueError(
            f"A proof needs free space known to {_COARSEST:g} of the domain's shorter side, got {visible.slack:.2g} "
            f"in {domain}. The domain is too far from the origin, too narrow, or small beside its workspace: move "
            "the origin, divide the domain, or build the PLR without a proof."
        )
    lo, hi = map(np.concatenate, zip(*(file.tree.leaves.boxes(domain) for file in contents), strict=True))
    coefficients = np.concatenate([filled_coefficients(file) for file in contents])
    seen = np.unique(visible.cell)
    if len(blind := seen[np.isinf(coefficients[seen, 0])]):
        raise ValueError(
            "A proof needs a finite function in every leaf with points that reach the goal, got inf in the leaf from "
            f"{lo[blind[0]].tolist()} to {hi[blind[0]].tolist()}, where no sample met such a point. Build the PLR "
            "with certified=True."
        )
    coefficients = np.where(np.isinf(coefficients[:, :1]), 0.0, coefficients)
    # 2. For each PLR, find out which bounds suffice for its file.
    ends = np.cumsum([0, *(len(file.tree.leaves) for file in contents)]).tolist()
    targets = []
    for file, leaves in zip(contents, (slice(*rows) for rows in pairwise(ends)), strict=True):
        rounding = leaf.rounding_bounds(domain, file.tree.leaves, coefficients[leaves])
        volume = np.ldexp(1.0, -file.tree.leaves.depth.sum(axis=1))
        num_bytes = len(body_of_leaves(file).to_bytes())
        certificate = partial(Certificate.of, proof=proof, volume=volume, num_bytes=num_bytes)
        targets.append(_Targets(leaves, rounding, certificate))

    def sufficient(least: Errors, most: Errors, recompute: bool) -> tuple[Errors, Errors]:
        bounds = [target(least[target.leaves], most[target.leaves], recompute) for target in targets]
        low, high = map(np.concatenate, zip(*bounds, strict=True))
        return low, high

    # 3. Prove the bounds together, and encode them for each file.
    proven = prove_bounds(LeafFunctions(leaf, lo, hi, coefficients), visible, sufficient)
    return [target.encode(proven.lower[target.leaves], proven.upper[target.leaves]) for target in targets]


@dataclass(eq=False)
class _Targets:
    """A function of attained errors that returns error bounds that suffice for the file of one PLR.

    A proof of several PLRs uses one such function for each PLR to tell when it can stop.
    """

    leaves: slice  # the PLR's leaves among all
    rounding: Errors
    certificate: Callable[..., Certificate]  # ``Certificate.of`` for this PLR
    last: Certificate | None = None  # certificate of the attained errors that were encoded last
    attained: Float[np.ndarray, "3 leaves"] | None = None  # arguments of the last call

    def encode(self, lower: Errors, upper: Errors, before: Certificate | None = None) -> Certificate:
        return self.certificate(LeafBounds(lower, upper), self.rounding, before=before)

    def __call__(self, least: Errors, most: Errors, recompute: bool) -> tuple[Errors, Errors]:
        """Return lower and upper error bounds of the PLR's leaves; tighter bounds would hardly change its file.

        ``least`` and ``most`` are the smallest and largest errors found so far in each leaf. If ``recompute`` is
        False, bounds for an earlier file may be returned.
        """
        # Tighter bounds would hardly change the file of the attained errors. Encode this file again only if attained
        # errors changed, since late in a proof, few PLRs still improve. If `recompute` is False, an earlier file
        # whose leaves share one bound will do as long as this bound holds all attained errors.
        attained = np.stack([least, most, np.full(len(least), recompute)])
        last = self.last
        if last is None or self.attained is None or not np.array_equal(self.attained, attained):
            self.attained = attained
            if last is None or recompute or last.codes is not None or max(most.max(), -least.min()) > last.scale:
                self.last = last = self.encode(least, most, None if recompute else last)
        return last.sufficient_bounds(least, most, self.rounding)
