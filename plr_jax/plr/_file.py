"""A PLR's file: the tree of its leaves, and what their model keeps of them.

See ``file/container.py`` for the layout, the same on every machine.
"""

from dataclasses import dataclass
from typing import Any

from plr_jax.geometry.box import Box
from plr_jax.plr.certificate.certificate import Certificate, Proof, read_certificate
from plr_jax.plr.file.bits import BitReader, BitWriter
from plr_jax.plr.file.container import Container, Layer
from plr_jax.plr.file.tree import read_tree, write_tree
from plr_jax.plr.folding.folding import Folding
from plr_jax.plr.leaves import code_of_leaf, leaf_of_code
from plr_jax.plr.leaves.base import LeafModel, SourcedLeafModel
from plr_jax.plr.partition.cells import Cells
from plr_jax.plr.partition.tree import Level, tree_of_levels
from plr_jax.plr.query.grid import FRACTION_BITS


@dataclass(frozen=True, eq=False)
class Contents:
    """What the last layer of a file holds: the levels of a tree, and its leaves in the order of its traversal.

    They partition ``domain``, which is the box of a folding, where points are folded.
    """

    domain: Box
    leaf: LeafModel
    levels: list[Level]
    cells: Cells
    stored: Any
    certificate: Certificate | None = None
    folding: Folding | None = None


def encode(contents: Contents) -> bytes:
    """The bytes of the file that holds these leaves."""
    body = BitWriter()
    write_tree(body, contents.levels, contents.domain.dim)
    contents.leaf.write(body, contents.domain, contents.cells, contents.stored)
    proof = Proof.NONE
    if contents.certificate is not None:
        contents.certificate.write(body)
        proof = contents.certificate.proof
    domain = contents.domain if contents.folding is None else contents.folding.domain
    layer = Layer(code_of_leaf(contents.leaf), body.to_bytes(), int(proof))
    return Container(domain, (layer,), contents.folding).to_bytes()


def decode(data: bytes) -> Contents:
    """What a file's bytes hold; raises ``ValueError`` saying what is wrong with them."""
    container = Container.from_bytes(data)
    layer, dim = container.last, container.domain.dim
    leaf = leaf_of_code(layer.leaf_code)
    leaf.check_dim(dim)
    body = BitReader(layer.body)
    levels = read_tree(body, dim)
    cells = tree_of_levels(levels, dim).leaves
    if (deepest := cells.depth.max()) > FRACTION_BITS:
        raise ValueError(f"a cell is split {deepest} times along one axis; a query resolves {FRACTION_BITS}")
    if container.folding is not None and isinstance(leaf, SourcedLeafModel):
        raise ValueError("its points are folded, but its leaves have sources, which are not")
    stored = leaf.read(body, container.folded_domain, cells)
    if layer.proof_code not in tuple(Proof):
        raise ValueError(f"it has a proof of kind {layer.proof_code}, this release knows kinds 0 to {max(Proof)}")
    certificate = read_certificate(body, Proof(layer.proof_code), len(cells))
    if not body.at_end():
        raise ValueError("it holds more data than its leaves need")
    return Contents(container.folded_domain, leaf, levels, cells, stored, certificate, container.folding)


def decode_cells(data: bytes) -> Cells:
    """The leaves alone that a file's bytes hold, in the order of the tree's traversal."""
    container = Container.from_bytes(data)
    dim = container.domain.dim
    return tree_of_levels(read_tree(BitReader(container.last.body), dim), dim).leaves
