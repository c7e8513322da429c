"""A proof, told by what has changed since another one.

its kind, in 2 bits; is the largest error another one, and which
of every different pair of codes of bounds before, is it gone; how many are new, and which
of every pair before, do its leaves have another one now, and which
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Int

from plr_jax.plr.certificate.certificate import Certificate, Proof
from plr_jax.plr.file.range_coder import RARE, Coder

_PROOF_BITS, _PAIR_BITS = 2, 16


@dataclass(frozen=True, eq=False)
class Bounds:
    """A proof whose bounds stand in a table: of a pair of codes each, the lower one in the higher bits.

    Attributes:
        proof: Its kind.
        scale: The largest error; 0 if nothing is proven.
        pairs: The different pairs, ascending; none if leaves have no bounds of their own.
        of_leaf: The pair of every leaf, 0 if there are none.
    """

    proof: Proof
    scale: float
    pairs: list[int]
    of_leaf: Int[np.ndarray, "leaves"]

    @classmethod
    def of(cls, certificate: Certificate | None, num_leaves: int) -> "Bounds":
        """The table of a certificate."""
        if certificate is None:
            return cls(Proof.NONE, 0.0, [], np.zeros(num_leaves, np.int64))
        if certificate.codes is None:
            return cls(certificate.proof, certificate.scale, [], np.zeros(num_leaves, np.int64))
        lower, upper = certificate.codes.astype(np.int64)
        pairs, of_leaf = np.unique(lower << 8 | upper, return_inverse=True)
        return cls(certificate.proof, certificate.scale, pairs.tolist(), of_leaf)

    @property
    def certificate(self) -> Certificate | None:
        """The certificate of the table."""
        if self.proof is Proof.NONE:
            return None
        pair = np.array(self.pairs, np.int64)[self.of_leaf] if self.pairs else None
        codes = None if pair is None else np.stack([pair >> 8, pair & 255]).astype(np.uint8)
        return Certificate(self.scale, codes, self.proof)


def coded_bounds(
    coder: Coder, before: Bounds, after: Bounds | None, moved: dict[int, int]
) -> tuple[Bounds, Int[np.ndarray, "pairs_before"]]:
    """Bounds after a change, but for leaves, and which pair leaves of each pair before have now.

    They are encoded if they are given, with what has become of some pairs, by their indices; else decoded.
    """
    proof = Proof(coder.number(after and int(after.proof), _PROOF_BITS))
    scale = before.scale
    if coder.bit("has another largest error", after and int(after.scale != scale), RARE):
        scale = coder.float32(after and after.scale)
    present = set(after.pairs) if after else set[int]()
    kept = [pair for pair in before.pairs if not coder.bit("pair is gone", after and int(pair not in present), RARE)]
    new = sorted(present.difference(kept))
    count = coder.count("new pairs", after and len(new))
    pairs = sorted({*kept, *(coder.number(new[i] if after else None, _PAIR_BITS) for i in range(count))})
    now = np.zeros(max(len(before.pairs), 1), np.int64)  # a pair of all leaves stands for none
    for each, pair in enumerate(before.pairs if pairs else []):
        stays = pairs.index(pair) if pair in kept else -1
        to = moved.get(each, max(stays, 0)) if after else None
        if stays >= 0 and not coder.bit("pair has moved", None if to is None else int(to != stays), RARE):
            now[each] = stays
        else:
            now[each] = coder.symbol("pair", to, len(pairs))
    return Bounds(proof, scale, pairs, np.zeros(0, np.int64)), now
