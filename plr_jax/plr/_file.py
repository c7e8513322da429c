"""Encode PLRs as files and decode them (layout: ``portable/FORMAT.md``); prove the error bounds that files store.

:func:`relative_to_origin` and :func:`filled_coefficients` prepare the leaf data of a decoded file for queries.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from plr_jax._arrays import sum_of_columns
from plr_jax._progress import Progress
from plr_jax._types import CellSources, Reach
from plr_jax.geometry.box import Box
from plr_jax.plr import certificate as proofs
from plr_jax.plr.certificate import Certificate, Errors, LeafFunctions, Proof, StraightBound
from plr_jax.plr.coding import BitReader, BitWriter, read_tree, write_tree
from plr_jax.plr.container import Container, Layer
from plr_jax.plr.folding import Folding
from plr_jax.plr.frame import FRACTION_BITS, LARGEST, Corner, table_corners
from plr_jax.plr.leaf_faces import neighbor_of_largest_contact
from plr_jax.plr.leaves import Cone, code_of_leaf, leaf_of_code, read_goals, write_goals
from plr_jax.plr.leaves.base import Coefficients, LeafModel, LinearLeafModel
from plr_jax.plr.tree import Tree

_COARSEST = 1e-4  # largest uncertainty of free space for a proof, in units of the domain's shorter side


@dataclass(frozen=True, eq=False)
class DecodedFile:
    """The content of a PLR file, decoded."""

    domain: Box  # covered by the leaves; the PLR's domain, unless the file has mirror symmetries
    leaf: LeafModel
    tree: Tree
    stored: Any
    certificate: Certificate | None = None
    straight: StraightBound | None = None  # a lower bound of the distance, and of the PLR's answers
    folding: Folding | None = None  # mirror symmetries that map all points of the PLR's domain to ``domain``
    cut_off: Bool[np.ndarray, " leaves"] | None = None  # leaves that answer ``inf``; None: no leaf does for certain


def cut_off_leaves(reach: Reach | None, tree: Tree) -> Bool[np.ndarray, " leaves"] | None:
    """Return whether each leaf holds free points that cannot reach the goal, and no point that can reach it.

    Return None if ``reach`` is None, that is, if it is unknown which points can reach the goal.
    """
    return None if reach is None else reach.is_cut_off(*tree.leaves.fractions)


def encode(contents: DecodedFile) -> bytes:
    """Return the bytes of a PLR's file."""
    body = body_of_leaves(contents)
    proof = proofs.write_proof(body, contents.certificate, contents.straight)
    domain = contents.domain if contents.folding is None else contents.folding.domain
    goals = contents.stored.sources.goals if isinstance(contents.leaf, Cone) else None
    if goals is not None:
        write_goals(body, goals)
    has_cut_off = contents.cut_off is not None and bool(contents.cut_off.any())
    if contents.cut_off is not None and has_cut_off:
        body.write_set(contents.cut_off)
    layer = Layer(code_of_leaf(contents.leaf), body.to_bytes(), int(proof))
    return Container(domain, (layer,), contents.folding, "", goals is not None, has_cut_off).to_bytes()


def body_of_leaves(contents: DecodedFile) -> BitWriter:
    """Encode the tree and the leaves of a PLR; return the writer, so that a proof can be appended."""
    body = BitWriter()
    write_tree(body, contents.tree)
    contents.leaf.write(body, contents.domain, contents.tree.leaves, contents.stored)
    return body


def decode(data: bytes) -> DecodedFile:
    """Decode the bytes of a PLR's file; ``ValueError`` if they are invalid."""
    container = Container.from_bytes(data)
    layer = container.last
    # 1. The tree and its leaves.
    leaf = leaf_of_code(layer.leaf_code)
    if container.folding is not None and isinstance(leaf, Cone):
        raise ValueError("its points are folded, but its leaves have sources, which cannot be folded")
    leaf.check_domain(container.folded_domain)
    body = BitReader(layer.body)
    tree = read_tree(body, container.domain.dim)
    cells = tree.leaves
    if (deepest := cells.depth.max()) > FRACTION_BITS:
        raise ValueError(f"it splits a cell {deepest} times along one axis, more than {FRACTION_BITS}")
    stored = leaf.read(body, container.folded_domain, cells)
    # 2. The proof, then goals and cut-off leaves, if the header says so.
    if layer.proof_code not in tuple(Proof):
        raise ValueError(f"its proof must be of kind 0 to {max(Proof)}, got {layer.proof_code}; update plr_jax")
    certificate, straight = proofs.read_proof(body, Proof(layer.proof_code), cells)
    if container.names_goals:
        if not isinstance(leaf, Cone):
            raise ValueError("it names goals, but its leaves have no sources")
        goals = read_goals(body, int(np.count_nonzero(stored.sources.is_root)))
        stored = replace(stored, sources=replace(stored.sources, goals=goals))
    cut_off = body.read_set(len(cells)) if container.has_cut_off else None
    body.require_end("its leaves need")
    return DecodedFile(container.folded_domain, leaf, tree, stored, certificate, straight, container.folding, cut_off)


def relative_to_origin(contents: DecodedFile, origin: Corner) -> tuple[Box, Float[np.ndarray, "leaves count"]]:
    """Return the leaves' domain and the numbers of each leaf that a query reads, for points relative to ``origin``.

    From such a point, the query subtracts the domain's lower corner in 32-bit floats; the numbers are coefficients of
    functions of this difference. If the PLR is folded, ``origin`` is not used: folded points are relative to the
    center of the mirrors.
    """
    origin = origin if contents.folding is None else np.zeros(contents.domain.dim)
    domain = contents.domain.moved(-origin)
    corner = origin + table_corners(domain)[0]
    cells, coefficients = contents.tree.leaves, filled_coefficients(contents)
    numbers = contents.leaf.leaf_parameters(contents.domain, cells, coefficients, corner)
    if not (np.abs(numbers) < LARGEST)[~np.isinf(numbers)].all():  # also false for NaN
        raise ValueError(f"its distances and slopes must be below {LARGEST:g} for 32-bit floats; scale them down")
    return domain, numbers


def filled_coefficients(contents: DecodedFile, given: Coefficients | None = None) -> Coefficients:
    """Return the coefficients of each leaf's function.

    A leaf without a function gets the plane of a neighbor with a function. If it has no such neighbor, or is cut off
    from the goal, its first coefficient is ``inf``: the leaf answers ``inf``. Coefficients that are ``given``
    take the place of those in the file.
    """
    # 1. Find the leaves without a function. Leaves that are cut off answer ``inf``.
    leaf, cells = contents.leaf, contents.tree.leaves
    coefficients = leaf.coefficients(cells, contents.stored) if given is None else given.copy()
    unreachable = coefficients[:, 0] == np.inf
    if not (np.abs(coefficients[~unreachable]) < LARGEST).all():
        raise ValueError(f"its distances must be below {LARGEST:g} for 32-bit floats; scale them down")
    if contents.cut_off is not None:
        unreachable &= ~contents.cut_off
    if unreachable.any() and isinstance(leaf, LinearLeafModel):
        periodic = contents.domain.periodic
        # 2. The neighbor, or donor, shares the largest face, edge or corner. Not all leaves have one.
        borrower = np.flatnonzero(unreachable)
        reachable = np.flatnonzero(np.isfinite(coefficients[:, 0]))
        donor = neighbor_of_largest_contact(contents.tree, borrower, reachable, periodic)
        borrower, donor = borrower[donor >= 0], donor[donor >= 0]
        # 3. The donor's plane rises by `half` from its center to its side. At the borrower's center, `along` half
        #    widths of the donor away, it is center + half . along. The borrower is `widths` times as wide as the
        #    donor.
        center, half = leaf.mean_planes(*cells[donor].boxes(contents.domain), coefficients[donor])
        widths = np.ldexp(1.0, cells.depth[donor] - cells.depth[borrower])
        place = (cells.position + 0.5) * np.ldexp(1.0, -cells.depth)  # centers, in fractions of the domain
        apart = place[borrower] - place[donor]
        apart -= np.where(periodic, np.rint(apart), 0.0)  # the short way around periodic axes
        along = 2 * apart * np.ldexp(1.0, cells.depth[donor])
        coefficients[borrower] = leaf.coefficients_of_planes(center + sum_of_columns(half * along), half * widths)
    if contents.cut_off is not None:
        coefficients[contents.cut_off, 0] = np.inf
    return coefficients


def certificates_of(contents: Sequence[DecodedFile], visible: CellSources, proof: Proof) -> list[Certificate]:
    """Prove bounds of each leaf's error, and encode them for files of PLRs of one leaf model and one domain.

    The cells of ``visible`` are the leaves of all PLRs, one PLR after another. It has the corners (or the goal) to
    which shortest paths from each leaf may go first.
    """
    # 1. Concatenate the functions of all leaves. A leaf without a function may have no point that reaches the goal.
    domain, leaf = contents[0].domain, contents[0].leaf
    if visible.slack > _COARSEST * domain.width.min():
        expected = f"free space known to {_COARSEST:g} of the domain's shorter side"
        cause = "The domain is too far from the origin, too narrow, or small beside its workspace"
        advice = "move the origin, divide the domain, or build the PLR without a proof"
        raise ValueError(f"A proof needs {expected}, got {visible.slack:.2g} in {domain}. {cause}: {advice}.")
    lo, hi = map(np.concatenate, zip(*(file.tree.leaves.boxes(domain) for file in contents), strict=True))
    coefficients = np.concatenate([filled_coefficients(file) for file in contents])
    seen = np.unique(visible.cell)
    if len(blind := seen[np.isinf(coefficients[seen, 0])]):
        lower, upper = (corner[blind[0]].tolist() for corner in (lo, hi))
        expected = "a finite function in every leaf with points that reach the goal"
        got = f"inf in the leaf from {lower} to {upper}, where no sample met such a point"
        raise ValueError(f"A proof needs {expected}, got {got}. Build the PLR with certified=True.")
    coefficients = np.where(np.isinf(coefficients[:, :1]), 0.0, coefficients)
    # 2. For each PLR, find out which bounds suffice for its file.
    ends = np.cumsum([0, *(len(file.tree.leaves) for file in contents)]).tolist()
    targets = []
    for file, leaves in zip(contents, (slice(*rows) for rows in pairwise(ends)), strict=True):
        rounding = leaf.rounding_bounds(domain, file.tree.leaves, coefficients[leaves])
        volume = np.ldexp(1.0, -file.tree.leaves.depth.sum(axis=1))
        num_bytes = len(body_of_leaves(file).to_bytes())
        encode_bounds = partial(Certificate.of, rounding=rounding, proof=proof, volume=volume, num_bytes=num_bytes)
        targets.append(_SufficientBounds(leaves, rounding, encode_bounds))

    def sufficient(least: Errors, most: Errors, recompute: bool) -> tuple[Errors, Errors]:
        bounds = [target(least[target.leaves], most[target.leaves], recompute) for target in targets]
        low, high = map(np.concatenate, zip(*bounds, strict=True))
        progress.update()
        return low, high

    # 3. Prove the bounds together, and encode them for each file.
    with Progress("certify", "rounds") as progress:
        lower, upper = proofs.prove_bounds(LeafFunctions(leaf, lo, hi, coefficients), visible, sufficient)
    return [target.encode(lower[target.leaves], upper[target.leaves]) for target in targets]


@dataclass(eq=False)
class _SufficientBounds:
    """A function that tells a proof how tight the error bounds of one PLR's leaves must be.

    Bounds suffice if tighter bounds would hardly change the PLR's file. A proof of several PLRs has one such function
    for each PLR, and can stop once the bounds of all leaves suffice.
    """

    leaves: slice  # the PLR's leaves among all
    rounding: Errors
    encode: Callable[..., Certificate]  # ``Certificate.of`` for this PLR
    last: Certificate | None = None  # certificate of the attained errors that were encoded last
    attained: Float[np.ndarray, "3 leaves"] | None = None  # arguments of the last call, one in each row

    def __call__(self, least: Errors, most: Errors, recompute: bool) -> tuple[Errors, Errors]:
        """Return lower and upper error bounds that suffice for each of the PLR's leaves.

        ``least`` and ``most`` are the smallest and largest errors found so far in each leaf. If ``recompute`` is
        False, the bounds may be those that sufficed for errors of an earlier call, which saves time. A proof passes
        True in its first round, and whenever all pieces of free space have bounds that suffice.
        """
        # Tighter bounds would hardly change the file of the attained errors. Encode this file again only if attained
        # errors changed, since late in a proof, few PLRs still improve. If `recompute` is False, an earlier file
        # whose leaves share one bound will do as long as this bound holds all attained errors.
        last, attained = self.last, np.stack([least, most, np.full(len(least), recompute)])
        is_changed = self.attained is None or not np.array_equal(self.attained, attained)
        holds_all = last is not None and last.codes is None and max(most.max(), -least.min()) <= last.scale
        if last is None or (is_changed and (recompute or not holds_all)):
            self.last = last = self.encode(least, most, before=None if recompute else last)
        self.attained = attained
        return last.sufficient_bounds(least, most, self.rounding)
