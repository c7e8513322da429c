r"""The file of a continuous PLR: a tree, which faces are tied, and one number for each free value.

All numbers are little-endian. Layout of version 1:

    4s      magic, b"CPL\\n"
    u8      version
    u8      dim
    u8      order of continuity: 0 values, 1 values and gradients
    u8      reserved, 0
    u32     number of leaves
    u32     size of the whole file in bytes
    f64     lower corner of the domain, dim times; then the upper corner
    f32     offset, then step
    ...     bit stream, least significant bit first, the last byte filled up with zeros:
              tree, as in a PLR file (``_file.py``)
              unreachable leaves, in the order of the tree's traversal, as a set
              faces that are not tied, among those of two reachable leaves, sorted by lower and upper leaf, as a set
              for every level of masters the codes, as signed numbers
    u32     CRC-32 of all bytes before

A value is ``offset + step * code``; masters, their order and their levels follow from the tree and the ties (see
``_nodal_space.py``). What is stored of a code is by how much it differs from the rounded prediction from coarser
ones: for smooth functions a few bits. A set is the number of its members in 32 bits and before each member the
number of those left out. Numbers are Exp-Golomb codes, whose order, the best one, comes first in 5 bits: for all of
them in unary how many bits each has beyond the order, then these and as many more as the order says. A signed number
is twice its absolute value, minus one if it is positive.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax.geometry.box import Box
from plr_jax.plr.file.bits import BitReader, BitWriter
from plr_jax.plr.file.container import FileKind, frame, read_span, unframe, write_span
from plr_jax.plr.file.plr_file import read_leaves, write_tree
from plr_jax.plr.leaves.continuous.basis import MAX_DIM_OF_ORDER
from plr_jax.plr.leaves.continuous.space import NodalSpace, nodal_space
from plr_jax.plr.leaves.plane.codec import LARGEST
from plr_jax.plr.partition.cells import Cells
from plr_jax.plr.partition.faces import SharedFaces, Tree, shared_faces, tree_of
from plr_jax.plr.partition.levels import levels_of

KIND = FileKind(b"CPL\n", 1, "the file of a continuous PLR")
_COUNT_BITS, _ORDER_BITS = 32, 5
_MAX_CODE = 2**40


@dataclass(frozen=True, eq=False)
class Partition:
    """The leaves, and what of them hangs together.

    Attributes:
        tree: The tree over the leaves.
        unreachable: Leaves without a function; none has a tied face.
        tied: Faces across which functions are continuous.
    """

    tree: Tree
    unreachable: Bool[np.ndarray, "leaves"]
    faces: SharedFaces
    tied: Bool[np.ndarray, "faces"]

    def space(self) -> NodalSpace:
        """The continuous functions on these leaves."""
        return nodal_space(self.tree, self.faces[self.tied], self.unreachable)

    def between_reachable(self) -> Bool[np.ndarray, "faces"]:
        """Which faces may be tied."""
        return ~(self.unreachable[self.faces.lower] | self.unreachable[self.faces.upper])


@dataclass(frozen=True, eq=False)
class StoredValues:
    """Values of the masters as integers of one step: ``offset + step * code``."""

    offset: float
    step: float
    code: Int[np.ndarray, "masters"]

    @staticmethod
    def rounded(values: Float[np.ndarray, "masters"], step: float) -> "StoredValues":
        """The nearest that can be stored; the step as a 32-bit float."""
        if np.abs(values).max(initial=0.0) > LARGEST:
            raise ValueError(f"Distances must be within {LARGEST:g} to be stored; scale them down.")
        offset, step = float(np.float32(values.mean())), float(np.float32(step))
        return StoredValues(offset, step, np.rint((values - offset) / step).astype(np.int64))

    def decode(self) -> Float[np.ndarray, "masters"]:
        """The values."""
        return self.offset + self.step * self.code


def encode(domain: Box, order: int, partition: Partition, space: NodalSpace, values: StoredValues) -> bytes:
    """The bytes of a file."""
    body = BitWriter()
    levels, _ = levels_of(partition.tree.leaves)
    write_tree(body, levels, domain.dim)
    _write_set(body, partition.unreachable)
    _write_set(body, ~partition.tied[partition.between_reachable()])
    surprise = values.code - _rounded(space.prediction @ values.code.astype(float))
    for level in _level_slices(space.level):
        _write_numbers(body, _unsigned(surprise[level]))
    content = write_span(domain, values.offset, values.step) + body.to_bytes()
    return frame(KIND, domain.dim, order, len(partition.unreachable), content)


def decode(data: bytes) -> tuple[Box, int, Partition, NodalSpace, StoredValues]:
    """What a file's bytes hold; raises ``ValueError`` saying what is wrong with them."""
    domain, order, offset, step, partition, body = _open(data)
    space = partition.space()
    code = np.zeros(len(space.masters), np.int64)
    for level in _level_slices(space.level):
        surprise = _signed(_read_numbers(body, level.stop - level.start))
        code[level] = surprise + _rounded(space.prediction[level] @ code.astype(float))
    if not body.at_end():
        raise ValueError("it holds more data than its leaves need")
    return domain, order, partition, space, StoredValues(offset, step, code)


def decode_partition(data: bytes) -> tuple[Box, Partition]:
    """The domain and its leaves alone, without what their values need."""
    domain, _, _, _, partition, _ = _open(data)
    return domain, partition


def _open(data: bytes) -> tuple[Box, int, float, float, Partition, BitReader]:
    """Domain, order, offset, step and leaves of a file, and what follows them in it."""
    dim, order, num_leaves, content = unframe(KIND, data)
    if order >= len(MAX_DIM_OF_ORDER) or not 1 <= dim <= MAX_DIM_OF_ORDER[order]:
        raise ValueError(f"it states {dim} axes and continuity of order {order}")
    domain, offset, step, rest = read_span(content, dim)
    body = BitReader(rest)
    partition = _read_partition(body, read_leaves(body, dim, num_leaves))
    return domain, order, offset, step, partition, body


def _read_partition(body: BitReader, cells: Cells) -> Partition:
    tree = tree_of(cells)
    faces = shared_faces(tree)
    unreachable = _read_set(body, len(cells))
    partition = Partition(tree, unreachable, faces, np.zeros(len(faces), bool))
    may_be_tied = partition.between_reachable()
    partition.tied[may_be_tied] = ~_read_set(body, int(np.count_nonzero(may_be_tied)))
    return partition


def _level_slices(level: Int[np.ndarray, "masters"]) -> list[slice]:
    """Runs of masters of one level, which depend on earlier ones alone."""
    starts = np.flatnonzero(np.diff(level, prepend=-1)).tolist()
    return [slice(start, end) for start, end in zip(starts, [*starts[1:], len(level)], strict=True)]


def _rounded(prediction: Float[np.ndarray, "n"]) -> Int[np.ndarray, "n"]:
    return np.rint(prediction).astype(np.int64)


def _unsigned(values: Int[np.ndarray, "n"]) -> Int[np.ndarray, "n"]:
    return 2 * np.abs(values) - (values > 0)


def _signed(values: Int[np.ndarray, "n"]) -> Int[np.ndarray, "n"]:
    return np.where(values % 2, (values + 1) // 2, -(values // 2))


def _write_set(body: BitWriter, member: Bool[np.ndarray, "n"]) -> None:
    gaps = np.diff(np.flatnonzero(member), prepend=-1) - 1
    body.write(np.array([len(gaps)]), _COUNT_BITS)
    _write_numbers(body, gaps)


def _read_set(body: BitReader, size: int) -> Bool[np.ndarray, "n"]:
    gaps = _read_numbers(body, int(body.read_alike(1, _COUNT_BITS)[0]))
    index = np.cumsum(gaps + 1) - 1
    if (index >= size).any():
        raise ValueError(f"it names member {index.max()} of {size}")
    member = np.zeros(size, bool)
    member[index] = True
    return member


def _write_numbers(body: BitWriter, values: Int[np.ndarray, "n"]) -> None:
    """Exp-Golomb codes of numbers >= 0, nothing for none."""
    if not len(values):
        return
    if values.max() >= _MAX_CODE:
        raise ValueError("The distances vary too much for their values to be stored; scale them or limit the domain.")
    orders = range(min(int(values.max()).bit_length() + 1, 1 << _ORDER_BITS))  # beyond them each adds a bit
    order = min(orders, key=lambda order: int((2 * _extra_bits(values, order) + order).sum()))
    extra = _extra_bits(values, order)
    body.write(np.array([order]), _ORDER_BITS).write_unary(extra)
    body.write((values + (1 << order)) & ((1 << (order + extra)) - 1), order + extra)


def _read_numbers(body: BitReader, num_values: int) -> Int[np.ndarray, "n"]:
    if not num_values:
        return np.zeros(0, np.int64)
    order = int(body.read_alike(1, _ORDER_BITS)[0])
    extra = body.read_unary(num_values)
    if extra.max() > np.log2(_MAX_CODE):
        raise ValueError("it holds a number that is too large")
    return body.read(order + extra) + (1 << (order + extra)) - (1 << order)


def _extra_bits(values: Int[np.ndarray, "n"], order: int) -> Int[np.ndarray, "n"]:
    """Bits of ``values + 2**order`` beyond the order and the leading one."""
    return (np.frexp((values + (1 << order)).astype(float))[1] - 1 - order).astype(np.int64)
