"""Coarser PLRs of a PLR, with bounds proven from the two alone, and files that begin with them."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float

from plr_jax._arrays import as_bool, require_integer, shortened
from plr_jax.plr._assembly import plr_of_leaves, with_certificate
from plr_jax.plr._construct import construct, proof_of
from plr_jax.plr._file import Contents, filled_coefficients
from plr_jax.plr._plr import PLR
from plr_jax.plr._proof import certificate_of_bounds
from plr_jax.plr.certificate.bounds import LeafBounds
from plr_jax.plr.certificate.certificate import Certificate, Proof
from plr_jax.plr.file.container import layered
from plr_jax.plr.file.held import held
from plr_jax.plr.growth.limits import BudgetTooSmall
from plr_jax.plr.leaves.base import UNIT
from plr_jax.plr.partition.cells import Cells, tree_of_levels
from plr_jax.plr.partition.faces import overlapping_leaves

# Files that are PLRs wherever they are cut off at a mark.


def progressive(plrs: Sequence[PLR]) -> PLR:
    """The last of some PLRs, in a file that begins with the others, the coarsest one first.

    Its first bytes, up to a mark, are a file of the first PLR, with its proof; those up to the next mark are one of
    the second, and so on. So who fetches the file has a distance function early (see :func:`open_url`), and need not
    fetch the rest. Each PLR is complete in itself: of sizes in steps of eight, all of them together take a seventh
    more than the last.

    Args:
        plrs: PLRs of one domain, at least one and at most 33, each with more bytes than the one before. They may
            differ in all else: their leaf models, their proofs.

    Returns:
        A PLR that answers as the last one, and has its proof and its label. ``file_marks`` says where its file may be
        cut off; ``num_bytes`` are those of all of it.

    Raises:
        ValueError: If they are not such PLRs.
    """
    if not isinstance(plrs, Iterable):
        raise ValueError(f"plrs must be a list of PLRs, the coarsest one first, got {shortened(plrs)}.")
    plrs = list(plrs)
    for plr in plrs:
        if not isinstance(plr, PLR):
            raise ValueError(f"plrs must be PLRs, got {shortened(plr)}.")
    whole = layered([plr.container for plr in plrs])
    return replace(plrs[-1], file=held(whole.to_bytes()))


_PAIRS_AT_ONCE = 1 << 12
_MOST_TRIES = 8
_ROUNDINGS_OF_RADIUS = 8
_MORE = 1.001  # for what is rounded here, in 64 bits


def coarsen(plr: PLR, max_bytes: int, *, leaf_bounds: bool = False, seed: int = 0) -> PLR:
    """A smaller PLR of what a PLR answers, which needs no oracle and comes with a proof.

    Its leaves are of the same model, found from samples of the PLR. How far its functions can be from those of the
    PLR is bounded over all cells that two of their leaves have in common, rounding included. So ``bounds`` and
    ``max_error`` are proven: of the distance, if a proof of ``plr`` is; else of what ``plr`` answers.

    A file does not say where obstacles are, so what a PLR answers there counts as well. Where the oracle is at hand,
    a PLR of so many bytes that :func:`construct` builds is far better among obstacles.

    Args:
        plr: The PLR. Where it answers ``inf``, nothing is said; where it answers less than 0, as no distance is, the
            lower bound is 0 all the same.
        max_bytes: Largest size of the coarser PLR's file.
        leaf_bounds: Whether to keep bounds of every leaf, 2 bytes each; else of classes, as :func:`certify` does.
        seed: Seed of the samples' scrambling.

    Returns:
        The coarser PLR, with the label of ``plr``. That itself if it has so few bytes, with the proof that it has; if
        it has none and there is room for one, with that of its answers, which is of rounding alone.

    Raises:
        ValueError: If it is no PLR, ``max_bytes`` is too small for one leaf with its proof, or the coarser PLR would
            answer ``inf`` where ``plr`` does not.
    """
    if not isinstance(plr, PLR):
        raise ValueError(f"Only a PLR can be coarsened, got {shortened(plr)}.")
    require_integer("max_bytes", max_bytes, 1)
    proof = proof_of(True, as_bool("leaf_bounds", leaf_bounds))
    fine = plr._contents
    if plr.num_bytes <= max_bytes:
        whole = plr if plr.max_error is not None else with_certificate(plr, _certificate(fine, fine, proof))
        if whole.num_bytes <= max_bytes:
            return whole
    unfolded = plr_of_leaves(replace(fine, folding=None, certificate=None))
    framed = plr_of_leaves(replace(fine, certificate=None)).with_label(plr.label)
    around = framed.num_bytes - unfolded.num_bytes  # by a folding and a label
    build = partial(construct, lambda x: np.asarray(unfolded(x)), unfolded.domain, leaf=plr.leaf.name, seed=seed)
    of_proof = -(-proof.num_bits(1, 0) // 8)
    room = int(max_bytes) - around - of_proof
    for _ in range(_MOST_TRIES):
        try:
            found = build(max_bytes=max(room, 1))._contents
        except BudgetTooSmall as error:
            least = error.num_bytes + around + of_proof
            what = "one leaf with its proof, and with folding and label where there are some,"
            raise BudgetTooSmall(float(max_bytes), least, what) from error
        taken = len(plr_of_leaves(found).to_bytes())
        size = taken + around + -(-proof.num_bits(len(found.cells), taken) // 8)
        if size <= max_bytes:
            break
        room = min(taken - 1, room * int(max_bytes) // size)  # at least a leaf less
    else:
        raise ValueError(f"max_bytes={max_bytes:,} is too small for a coarser PLR with a proof.")
    coarse = replace(found, folding=fine.folding)
    return plr_of_leaves(replace(coarse, certificate=_certificate(coarse, fine, proof))).with_label(plr.label)


def _certificate(coarse: Contents, fine: Contents, proof: Proof) -> Certificate:
    """Bounds of what the fine PLR stands for, minus what the coarse one answers."""
    dim, domain = coarse.domain.dim, coarse.domain
    trees = [tree_of_levels(contents.levels, dim) for contents in (coarse, fine)]
    (of_coarse, coarse_rounding), (of_fine, fine_rounding) = _functions(coarse), _functions(fine)
    below, above = _band(fine) + fine_rounding * np.array([[-1.0], [1.0]])
    if np.isinf(above).any():
        proof = Proof.OPEN_LEAVES
    own, other = overlapping_leaves(*trees)
    first, second = trees[0].leaves[own], trees[1].leaves[other]
    is_deeper = first.depth >= second.depth  # along each axis, where one holds the other
    common = Cells(
        np.where(is_deeper, first.depth, second.depth), np.where(is_deeper, first.position, second.position)
    )
    answers = ~np.isinf(of_fine[2][other, 0])
    if (answers & np.isinf(of_coarse[2][own, 0])).any():
        raise ValueError("A coarser PLR of so few bytes would answer inf where this one does not; give it more.")
    lower, upper = np.zeros(len(coarse.cells)), np.zeros(len(coarse.cells))
    pairs = np.flatnonzero(answers)
    for begin in range(0, len(pairs), _PAIRS_AT_ONCE):
        some = pairs[begin : begin + _PAIRS_AT_ONCE]
        i, j = own[some], other[some]
        box = common[some].grown_boxes(domain)
        fine_there, coarse_there = tuple(part[j] for part in of_fine), tuple(part[i] for part in of_coarse)
        least, most = fine.leaf.differences(*box, fine_there, coarse_there)
        np.minimum.at(lower, i, least + below[j])
        np.maximum.at(upper, i, most + above[j])
    return certificate_of_bounds(coarse, LeafBounds(lower, upper), coarse_rounding, proof)


def _functions(contents: Contents) -> tuple[Any, Float[np.ndarray, "leaves"]]:
    """Corners and coefficients of all leaves, and what queries of them round."""
    coefficients = filled_coefficients(contents)
    finite = np.where(np.isinf(coefficients[:, :1]), 0.0, coefficients)
    rounding = contents.leaf.rounding(contents.domain, contents.cells, finite)
    if (folding := contents.folding) is not None:  # which rounds points, and the length that is added
        farthest = np.maximum(np.abs(folding.box.lo), np.abs(folding.box.hi))
        rounding = 2 * rounding + _ROUNDINGS_OF_RADIUS * UNIT * folding.radius(farthest)
    return (*contents.cells.boxes(contents.domain), coefficients), _MORE * rounding


def _band(contents: Contents) -> Float[np.ndarray, "2 leaves_or_one"]:
    """Bounds of what a PLR stands for, minus what it answers: of its proof; else it stands for its answers."""
    return np.zeros((2, 1)) if contents.certificate is None else contents.certificate.bounds()
