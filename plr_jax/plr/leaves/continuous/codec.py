"""What a file keeps of leaves that are tied: which faces are, and one number for each free value.

As bits:

    offset and step as 32-bit floats
    unreachable leaves, in the order of the tree's traversal, as a set
    faces that are not tied, among those of two reachable leaves, sorted by lower leaf, upper leaf and axis, as a set
    for every level of masters the codes, as signed numbers

A value is ``offset + step * code``; masters, their order and their levels follow from the tree and the ties (see
``space.py``). What is stored of a code is by how much it differs from the rounded prediction from coarser ones: for
smooth functions a few bits. Sets, Exp-Golomb codes and those of signed numbers are as in ``plr/coding.py``.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import product_in_order
from plr_jax.plr.coding import BitReader, BitWriter
from plr_jax.plr.frame import LARGEST
from plr_jax.plr.leaves.continuous.space import NodalSpace, monomials, nodal_space
from plr_jax.plr.partition.cells import Cells, Tree, tree_of
from plr_jax.plr.partition.faces import SharedFaces, shared_faces

# Leaves as polynomials of the place in their cells.


def numbers_of_polynomials(
    order: int, cells: Cells, coefficients: Float[np.ndarray, "leaves terms"]
) -> Float[np.ndarray, "leaves count"]:
    """What a query reads of every leaf: the numbers of its cell, and coefficients by powers of the place in it.

    Along each axis the number 1 is the domain, and the halves of ``i`` are ``2 i`` and ``2 i + 1``. The exponent of
    such a number, as a 32-bit float, says how many such intervals span the domain.
    """
    is_inf = np.isinf(coefficients[:, 0])
    powers = product_in_order(np.where(is_inf[:, None], 0.0, coefficients), monomials(order, cells.dim))
    powers[is_inf, 0] = np.inf
    return np.concatenate([np.ldexp(1.0, cells.depth) + cells.position, powers], axis=1)


def polynomial(powers: int, coefficients: Sequence[Any], t: Sequence[Any]) -> Any:
    """Horner's rule along the first coordinate, whose coefficients are polynomials of the others."""
    if not t:
        return coefficients[0]
    stride = len(coefficients) // powers
    parts = [coefficients[power * stride : (power + 1) * stride] for power in range(powers)]
    total, *others = (polynomial(powers, part, t[1:]) for part in reversed(parts))
    for term in others:
        total = total * t[0] + term
    return total


@dataclass(frozen=True, eq=False)
class TiedPartition:
    """Leaves, the faces they share, and across which of them functions are continuous: none of unreachable ones."""

    tree: Tree
    unreachable: Bool[np.ndarray, "leaves"]
    faces: SharedFaces
    tied: Bool[np.ndarray, "faces"]

    @cached_property
    def space(self) -> NodalSpace:
        """The continuous functions on these leaves."""
        return nodal_space(self.tree, self.faces[self.tied], self.unreachable)

    def between_reachable(self) -> Bool[np.ndarray, "faces"]:
        """Which faces may be tied."""
        return ~(self.unreachable[self.faces.lower] | self.unreachable[self.faces.upper])


@dataclass(frozen=True, eq=False)
class StoredValues:
    """Values of the masters as integers of one step: ``offset + step * code``."""

    partition: TiedPartition
    offset: float
    step: float
    code: Int[np.ndarray, "masters"]

    @staticmethod
    def rounded(partition: TiedPartition, values: Float[np.ndarray, "masters"], step: float) -> "StoredValues":
        """The nearest that can be stored; the step as a 32-bit float."""
        if np.abs(values).max(initial=0.0) > LARGEST:
            raise ValueError(f"Distances must be within {LARGEST:g} to be stored; scale them down.")
        offset, step = float(np.float32(values.mean())), float(np.float32(step))
        return StoredValues(partition, offset, step, np.rint((values - offset) / step).astype(np.int64))

    def decode(self) -> Float[np.ndarray, "masters"]:
        """The values."""
        return self.offset + self.step * self.code


def write_values(body: BitWriter, stored: StoredValues) -> None:
    """Append ties and values."""
    partition, space = stored.partition, stored.partition.space
    body.write_floats(np.array([stored.offset, stored.step]))
    body.write_set(partition.unreachable)
    body.write_set(~partition.tied[partition.between_reachable()])
    surplus = stored.code - np.rint(space.prediction @ stored.code).astype(np.int64)
    for level in _level_slices(space.level):
        body.write_signed(surplus[level])


def read_values(body: BitReader, cells: Cells, periodic: tuple[bool, ...] = ()) -> StoredValues:
    """The next ties and values of leaves in a domain of ``periodic`` axes.

    Raises ``ValueError`` saying what is wrong with them.
    """
    offset, step = body.read_floats(2).tolist()
    if not (np.isfinite(offset) and 0 < step < np.inf):
        raise ValueError(f"it states a step of {step} from {offset}")
    tree = tree_of(cells)
    if (np.diff(tree.order) < 0).any():
        raise ValueError("its tree splits its leaves along other axes first than the tree of tied leaves does")
    faces = shared_faces(tree, periodic)
    partition = TiedPartition(tree, body.read_set(len(cells)), faces, np.zeros(len(faces), bool))
    may_be_tied = partition.between_reachable()
    partition.tied[may_be_tied] = ~body.read_set(int(np.count_nonzero(may_be_tied)))
    space = partition.space
    code = np.zeros(len(space.masters), np.int64)
    for level in _level_slices(space.level):
        surplus = body.read_signed(level.stop - level.start)
        code[level] = surplus + np.rint(space.prediction[level] @ code).astype(np.int64)
    return StoredValues(partition, offset, step, code)


def _level_slices(level: Int[np.ndarray, "masters"]) -> list[slice]:
    """Runs of masters of one level, which depend on earlier ones alone."""
    starts = np.flatnonzero(np.diff(level, prepend=-1)).tolist()
    return [slice(start, end) for start, end in zip(starts, [*starts[1:], len(level)], strict=True)]
