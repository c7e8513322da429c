"""Encode PLRs as files and decode them (layout: ``portable/FORMAT.md``), and prepare the leaf data for queries."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from plr_jax._arrays import sum_of_columns
from plr_jax.geometry.box import Box
from plr_jax.geometry.reach import Reach
from plr_jax.plr.certificate import Certificate, Proof, StraightBound, read_proof, write_proof
from plr_jax.plr.coding import BitReader, BitWriter, read_tree, write_tree
from plr_jax.plr.container import Container, Layer
from plr_jax.plr.folding import Folding
from plr_jax.plr.frame import FRACTION_BITS, LARGEST, Corner, table_corners
from plr_jax.plr.leaf_faces import neighbor_of_largest_contact
from plr_jax.plr.leaves import Cone, code_of_leaf, leaf_of_code, read_goals, write_goals
from plr_jax.plr.leaves.base import LeafModel, LinearLeafModel
from plr_jax.plr.tree import Tree


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

    Return None if ``reach`` is None, that is, if such points are unknown.
    """
    return None if reach is None else reach.is_cut_off(*tree.leaves.fractions)


def encode(contents: DecodedFile) -> bytes:
    """Return the bytes of a PLR's file."""
    body = body_of_leaves(contents)
    proof = write_proof(body, contents.certificate, contents.straight)
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
    leaf.check_domain(container.folded_domain)
    body = BitReader(layer.body)
    tree = read_tree(body, container.domain.dim)
    cells = tree.leaves
    if (deepest := cells.depth.max()) > FRACTION_BITS:
        raise ValueError(f"it splits a cell {deepest} times along one axis, more than {FRACTION_BITS}")
    if container.folding is not None and isinstance(leaf, Cone):
        raise ValueError("its points are folded, but its leaves have sources, which cannot be folded")
    stored = leaf.read(body, container.folded_domain, cells)
    # 2. The proof, then goals and cut-off leaves, if the header says so.
    if layer.proof_code not in tuple(Proof):
        raise ValueError(f"its proof must be of kind 0 to {max(Proof)}, got {layer.proof_code}; update plr_jax")
    certificate, straight = read_proof(body, Proof(layer.proof_code), len(cells), cells.dim)
    if container.names_goals:
        if not isinstance(leaf, Cone):
            raise ValueError("it names goals, but its leaves have no sources")
        goals = read_goals(body, int(np.count_nonzero(stored.sources.is_root)))
        stored = replace(stored, sources=replace(stored.sources, goals=goals))
    cut_off = body.read_set(len(cells)) if container.has_cut_off else None
    if not body.at_end():
        raise ValueError("it holds more data than its leaves need")
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


def filled_coefficients(contents: DecodedFile) -> Float[np.ndarray, "leaves terms"]:
    """Return the coefficients of each leaf's function.

    A leaf without a function gets the plane of a neighbor with a function. If it has no such neighbor, or is cut off
    from the goal, its first coefficient is ``inf``: the leaf answers ``inf``.
    """
    # 1. Find the leaves without a function. Leaves that are cut off answer ``inf``.
    leaf, cells = contents.leaf, contents.tree.leaves
    coefficients = leaf.coefficients(cells, contents.stored)
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
        donor = neighbor_of_largest_contact(cells, borrower, reachable, periodic)
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
