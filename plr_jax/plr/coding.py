"""Pack integers, floats, sets and trees into the bytes of a PLR file, as bit streams and varints."""

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from plr_jax._arrays import ragged_indices
from plr_jax.plr.tree import MAX_DEPTH, Tree, tree_of_axes

_BITS = 7  # bits of the value in each byte of a varint
_MOST_BYTES = 10  # of a varint
_MAX_WIDTH = 62  # most bits of an integer, so that sums and shifts fit 64 bits
_COUNT_BITS = 32  # of the number of a set's members
_ORDER_BITS = 5  # of the order of Exp-Golomb codes
_MAX_CODED = 2**40  # limit of integers in Exp-Golomb codes, not included


def varint(value: int) -> bytes:
    """Encode an integer >= 0 as LEB128: 7 bits in each byte, the lowest bits first."""
    more, last = [], value
    while last >> _BITS:
        more.append(1 << _BITS | last & (1 << _BITS) - 1)
        last >>= _BITS
    return bytes([*more, last])


def signed_varint(value: int) -> bytes:
    """Encode a signed integer ``v`` as the varint of ``2 * v``, or of ``-2 * v - 1`` if ``v`` is negative."""
    return varint(2 * abs(value) - (value < 0))


class ByteReader:
    """A reader of consecutive bytes and varints; methods raise ``ValueError`` if the data end too early."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self.at = 0

    def take(self, count: int) -> bytes:
        self.at += count
        if self.at > len(self._data):
            raise ValueError("the data end too early")
        return self._data[self.at - count : self.at]

    def byte(self) -> int:
        return self.take(1)[0]

    def varint(self) -> int:
        """Read an integer >= 0 in LEB128: 7 bits in each byte, the lowest bits first.

        The highest bit of a byte is 1 if another byte follows. ``ValueError`` if there are more than 10 bytes.
        """
        value = 0
        for place in range(_MOST_BYTES):
            byte = self.byte()
            value |= (byte & (1 << _BITS) - 1) << _BITS * place
            if byte < 1 << _BITS:
                return value
        raise ValueError("its header holds a number that is too large")

    def signed_varint(self) -> int:
        code = self.varint()
        return -(code // 2) - 1 if code % 2 else code // 2


class BitWriter:
    """A writer of unsigned integers of given bit widths, least significant bit first."""

    def __init__(self) -> None:
        self.num_bits = 0
        self._written: list[tuple[Int[np.ndarray, " _"], Int[np.ndarray, " _"] | int]] = []

    def write(self, values: Int[np.ndarray, " n"], widths: Int[np.ndarray, " n"] | int) -> "BitWriter":
        self.num_bits += len(values) * widths if isinstance(widths, int) else int(widths.sum())
        self._written.append((values, widths))
        return self

    def write_unary(self, values: Int[np.ndarray, " n"]) -> "BitWriter":
        """Append each value ``v`` as ``v`` zeros and a one."""
        # Integers 0, 1, 0, 1, ... in v, 1, v, 1, ... bits.
        widths = np.stack([values, np.ones_like(values)], axis=1).ravel()
        return self.write(np.arange(len(widths)) % 2, widths)

    def write_floats(self, values: Float[np.ndarray, " n"]) -> "BitWriter":
        return self.write(bits_of_floats(values), 32)

    def write_doubles(self, values: Float[np.ndarray, " n"]) -> "BitWriter":
        return self.write(values.astype("<f8").view("<u4").astype(np.int64), 32)

    def write_set(self, member: Bool[np.ndarray, " n"]) -> "BitWriter":
        """Append a subset of ``range(n)``: how many members it has, then the gaps between them, Exp-Golomb coded."""
        gaps = np.diff(np.flatnonzero(member), prepend=-1) - 1
        return self.write(np.array([len(gaps)]), _COUNT_BITS).write_coded(gaps)

    def write_coded(self, values: Int[np.ndarray, " n"]) -> "BitWriter":
        """Append Exp-Golomb codes of integers >= 0; an empty array appends nothing.

        All values share an order ``k``, which comes first, in 5 bits. For a value ``v``, the leading one of
        ``v + 2**k`` is bit ``k + e``, with ``e >= 0``. The counts ``e`` of all values follow in unary (``e`` zeros
        and a one), then, for all values, the ``k + e`` bits of ``v + 2**k`` below the leading one.
        """
        if not len(values):
            return self
        if values.max() >= _MAX_CODED:
            advice = "the distances vary too much. Scale the distances down or shrink the domain."
            raise ValueError(f"Stored integers must be below 2**40, got {values.max():,}: {advice}")
        # Choose the order k that takes the fewest bits: 2 * e + 1 + k for each value.
        orders = range(min(int(values.max()).bit_length() + 1, 1 << _ORDER_BITS))  # higher orders only add bits
        order = min(orders, key=lambda order: int((2 * _extra_bits(values, order) + order).sum()))
        extra = _extra_bits(values, order)
        # v + 2**k has a leading one at bit k + e; the bits below it are left after the mask.
        self.write(np.array([order]), _ORDER_BITS).write_unary(extra)
        return self.write((values + (1 << order)) & ((1 << (order + extra)) - 1), order + extra)

    def write_signed(self, values: Int[np.ndarray, " n"]) -> "BitWriter":
        """Append signed integers as Exp-Golomb codes of ``2 * v - 1`` for positive ``v``, else of ``-2 * v``."""
        return self.write_coded(2 * np.abs(values) - (values > 0))

    def to_bytes(self) -> bytes:
        bits = [_bits_of(values, widths) for values, widths in self._written]
        return np.packbits(np.concatenate(bits), bitorder="little").tobytes()


def _bits_of(values: Int[np.ndarray, " n"], widths: Int[np.ndarray, " n"] | int) -> UInt8[np.ndarray, " bits"]:
    """Return the bits of integers one after the other; integer ``i`` has ``widths[i]`` bits, the lowest bit first."""
    if isinstance(widths, int):
        bits = (values[:, None] >> np.arange(widths)) & 1
    else:
        field, within = ragged_indices(widths)
        bits = (values[field] >> within) & 1
    return bits.astype(np.uint8).ravel()


class BitReader:
    """A reader of the bits of :class:`BitWriter`; methods raise ``ValueError`` if the data end too early."""

    def __init__(self, data: bytes) -> None:
        self._bits = np.unpackbits(np.frombuffer(data, np.uint8), bitorder="little")
        self._at = 0

    def read(self, widths: Int[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
        """Read unsigned integers of the given bit widths."""
        bits = self._take(int(widths.sum()))
        field, within = ragged_indices(widths)
        values = np.zeros(len(widths), np.int64)
        np.add.at(values, field, bits << within)
        return values

    def read_fixed_width(self, num_values: int, width: int) -> Int[np.ndarray, " n"]:
        return self._take(num_values * width).reshape(num_values, width) @ (np.int64(1) << np.arange(width))

    def read_unary(self, num_values: int) -> Int[np.ndarray, " n"]:
        if len(ends := np.flatnonzero(self._bits[self._at :])[:num_values]) < num_values:  # the ones
            raise ValueError("the data end too early")
        self._at += int(ends[-1]) + 1 if num_values else 0
        return np.diff(ends, prepend=-1) - 1

    def read_floats(self, num_values: int) -> Float[np.ndarray, " n"]:
        return floats_of_bits(self.read_fixed_width(num_values, 32))

    def read_doubles(self, num_values: int) -> Float[np.ndarray, " n"]:
        return self.read_fixed_width(2 * num_values, 32).astype("<u4").view("<f8").astype(np.float64)

    def read_set(self, universe: int) -> Bool[np.ndarray, " n"]:
        """Read a subset of ``range(universe)``, and return whether each number is a member."""
        is_member = np.zeros(universe, bool)
        is_member[self.read_members(universe)] = True
        return is_member

    def read_members(self, universe: int) -> Int[np.ndarray, " members"]:
        """Read a subset of ``range(universe)`` as a sorted array of its members.

        Memory does not depend on ``universe``.
        """
        if (num_members := int(self.read_fixed_width(1, _COUNT_BITS)[0])) > universe:
            raise ValueError(f"it names {num_members} members of {universe}")
        gaps = self.read_coded(num_members)
        members = np.cumsum(gaps + 1) - 1
        if (gaps >= universe).any() or members.max(initial=-1) >= universe:  # sums of larger gaps may overflow
            raise ValueError(f"it names a member beyond the last of {universe}")
        return members

    def read_coded(self, num_values: int) -> Int[np.ndarray, " n"]:
        """Read the Exp-Golomb codes of :meth:`BitWriter.write_coded`."""
        if not num_values:
            return np.zeros(0, np.int64)
        order = int(self.read_fixed_width(1, _ORDER_BITS)[0])
        extra = self.read_unary(num_values)
        if order + extra.max() > _MAX_WIDTH:
            raise ValueError("it holds a number that is too large")
        # Put the leading one of v + 2**k back, then subtract 2**k.
        values = self.read(order + extra) + (np.int64(1) << (order + extra)) - (1 << order)
        if values.max() >= _MAX_CODED:
            raise ValueError("it holds a number that is too large")
        return values

    def read_signed(self, num_values: int) -> Int[np.ndarray, " n"]:
        code = self.read_coded(num_values)
        return np.where(code % 2, (code + 1) // 2, -(code // 2))

    def _take(self, num_bits: int) -> Int[np.ndarray, " bits"]:
        if len(bits := self._bits[self._at : self._at + num_bits]) < num_bits:
            raise ValueError("the data end too early")
        self._at += num_bits
        return bits.astype(np.int64)

    def at_end(self) -> bool:
        """Return whether all bits were read, except for zeros that pad the last byte."""
        return len(self._bits) - self._at < 8 and not self._bits[self._at :].any()

    def require_end(self, needed_by: str) -> None:
        """Raise a ``ValueError`` unless all bits were read; ``needed_by`` ends the message, as "its cells need"."""
        if not self.at_end():
            raise ValueError(f"it holds more data than {needed_by}")


def bits_of_floats(values: Float[np.ndarray, "*n"]) -> Int[np.ndarray, "*n"]:
    return values.astype(np.float32).view(np.uint32).astype(np.int64)


def floats_of_bits(bits: Int[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    with np.errstate(invalid="ignore"):  # a signaling NaN becomes a quiet one
        return bits.astype(np.uint32).view(np.float32).astype(np.float64)


def _extra_bits(values: Int[np.ndarray, " n"], order: int) -> Int[np.ndarray, " n"]:
    # floor(log2(v + 2**order)) - order
    return (np.frexp((values + (1 << order)).astype(float))[1] - 1 - order).astype(np.int64)


def bits_of_set(num_members: int, universe: int) -> int:
    """Return the most bits that a subset of ``range(universe)`` with ``num_members`` members takes in a PLR file.

    For an empty set, the result is 0: files leave the set out, although :meth:`BitWriter.write_set` could write it.
    """
    # A gap ``g`` takes at most ``2 log2(g + 1) + 1`` bits, a concave function, so equal gaps take the most.
    of_gaps = num_members * (1 + 2 * np.log2(max(universe, 1) / max(num_members, 1)))
    return _COUNT_BITS + _ORDER_BITS + int(np.ceil(of_gaps)) if num_members else 0


def body_size(dim: int, num_leaves: int, num_bits: int) -> int:
    """Return the number of bytes in a file of a tree with ``num_leaves`` leaves and ``num_bits`` bits of data.

    The bytes hold the splits of the tree, then the data.
    """
    tree_bits = 2 * num_leaves - 1 + (num_leaves - 1) * _axis_bits(dim)
    return int(-(-(tree_bits + num_bits) // 8))


def write_tree(body: BitWriter, tree: Tree) -> None:
    """Append each level of a tree: a bit per node (1 if split), then ``ceil(log2(dim))`` bits for each split axis."""
    first, num_nodes = 0, 1  # of the nodes of a level, which have consecutive numbers
    for split in tree.splits:
        body.write((tree.child[first : first + num_nodes] >= 0).astype(np.int64), 1)
        body.write(tree.axis[split], _axis_bits(tree.cells.dim))
        first += num_nodes
        num_nodes = 2 * len(split)


def read_tree(body: BitReader, dim: int) -> Tree:
    """Decode a tree, level by level: which nodes are split, and along which axes."""
    axes, num_nodes = [], 1
    while num_nodes:
        if len(axes) > MAX_DEPTH:
            raise ValueError(f"its tree is deeper than {MAX_DEPTH}")
        inner = body.read_fixed_width(num_nodes, 1) == 1
        axis = body.read_fixed_width(int(np.count_nonzero(inner)), _axis_bits(dim))
        if (axis >= dim).any():
            raise ValueError(f"it splits axis {axis.max()} of {dim}")
        axes.append(np.full(num_nodes, -1))
        axes[-1][inner] = axis
        num_nodes = 2 * len(axis)
    return tree_of_axes(axes, dim)


def _axis_bits(dim: int) -> int:
    return (dim - 1).bit_length()
