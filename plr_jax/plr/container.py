r"""The container of a PLR file: a header, layers of bits that each begin with a tree, and checksums.

Layout of version 5, with numbers as :func:`varint` writes them:

    2s      magic, b"P\xb5"
    u8      low four bits: version; high four: number of axes, 0 for more than 15
    u8      three bits: code of the leaf model; 7 for distances of pairs of points (see ``pairs/stored.py``)
            two bits: what it keeps of a proof (see ``plr/certificate.py``)
            one bit: are points folded?
            one bit: is there a label, or are there several layers?
            one bit: is the domain kept in floats?
    ...     number of axes, if there are more than 15
    ...     the domain (see ``domain_to_bytes``)
    ...     how points are folded, if they are (see ``folding_to_bytes``); leaves are then of the box of those
    ...     the label, if that bit is set: its length in bytes, and it in UTF-8; then the number of layers but the
            last one, and of each its size in bytes
    ...     layers. Each but the last one begins with
      u8      the code of its leaf model, and four bits left of it, what it keeps of a proof
            and all have a bit stream, least significant bit first, the last byte filled up with zeros:
              the tree over the leaves, whose boxes follow from the splits (see ``write_tree`` in ``coding.py``)
              what the leaf model keeps of the leaves (see ``leaves/plane.py``, ``leaves/continuous.py``
                and ``leaves/cone/codec.py``), in the order of the tree's traversal, lower half first
              what it keeps of a proof
      u32     CRC-32 of all bytes before from the start of the file, but for other checksums, little-endian

A PLR has one layer. Files of several, which plr_jax 0.1 wrote, are refused. The layers of pairs each add to the ones
before. A file that is cut off behind one of them, at a *mark*, has a valid checksum; readers of pairs refuse it.
"""

import os
import struct
import zlib
from dataclasses import dataclass, replace
from decimal import Context, Decimal
from functools import cached_property
from itertools import accumulate
from typing import Any

import numpy as np
from jaxtyping import Bool, UInt8

from plr_jax._arrays import padded, padded_size, shortened
from plr_jax.geometry.box import Box
from plr_jax.plr.coding import ByteReader, signed_varint, varint
from plr_jax.plr.folding import Folding

VERSION = 5
PAIRS_CODE = 7
"""Code that stands for a leaf model in files of distances between pairs of points."""
MOST_LABEL_BYTES = 1000
MOST_BYTES = 2**28
"""Bytes of the largest file."""
MOST_AXES = 255
"""Of a domain."""
MAGIC = b"P\xb5"
"""What every file of this version begins with."""
GRID_MAGIC = b"PGP\n"
"""What files of pairs of cells of a grid begin with (see ``pairs/grid_pairs.py``)."""
_EARLIER = b"PLR\n", b"CPL\n"  # magic of versions before
MOST_LAYERS = 32
_MOST_IN_BITS = 15
_FOLDED, _EXTENDED, _FLOATS = 1 << 5, 1 << 6, 1 << 7
_CRC = struct.Struct("<I")


@dataclass(frozen=True)
class Layer:
    """A PLR, or a part of what is known of pairs; its body is the bit stream."""

    leaf_code: int
    body: bytes
    proof_code: int = 0


@dataclass(frozen=True)
class Header:
    """What stands before the layers.

    Attributes:
        domain: The box that the file covers.
        leaf_code: Of the last layer.
        proof_code: Of the last layer.
        folding: How points are folded; None if they are not.
        label: What is said of the file, any text.
        sizes: Bytes of all layers but the last one.
    """

    domain: Box
    leaf_code: int
    proof_code: int = 0
    folding: Folding | None = None
    label: str = ""
    sizes: tuple[int, ...] = ()

    @cached_property
    def data(self) -> bytes:
        """Its bytes."""
        dim, (domain, is_floats) = self.domain.dim, domain_to_bytes(self.domain)
        if dim > MOST_AXES:
            raise ValueError(f"A file has room for {MOST_AXES} axes, got a domain of {dim}.")
        fits, label = dim <= _MOST_IN_BITS, self.label.encode()
        flags = _FOLDED * (self.folding is not None) | _EXTENDED * bool(label or self.sizes) | _FLOATS * is_floats
        parts = [MAGIC, bytes([VERSION | (dim * fits) << 4, self.leaf_code | self.proof_code << 3 | flags])]
        parts += [b"" if fits else varint(dim), domain]
        if self.folding is not None:
            parts.append(folding_to_bytes(self.folding))
        if flags & _EXTENDED:
            parts += [varint(len(label)), label, varint(len(self.sizes)), *map(varint, self.sizes)]
        return b"".join(parts)

    @property
    def marks(self) -> tuple[int, ...]:
        """Where a file may be cut off: the ends of all layers but the last one, in bytes from its start."""
        return tuple(accumulate(self.sizes, initial=len(self.data)))[1:]

    @staticmethod
    def read(data: bytes) -> "Header":
        """The header that a file's bytes begin with; raises ``ValueError`` saying what is wrong with it."""
        if data.startswith(_EARLIER):
            raise ValueError(f"it has a format version before {VERSION}, which this release reads; build it again")
        reader = ByteReader(data)
        if data[: len(MAGIC)] != MAGIC:
            raise ValueError("it does not start like a PLR file")
        reader.take(len(MAGIC))
        first, second = reader.take(2)
        if (version := first & 15) != VERSION:
            remedy = "update plr_jax" if version > VERSION else "build it again"
            raise ValueError(f"it has format version {version}, this release reads version {VERSION}; {remedy}")
        if not 1 <= (dim := first >> 4 or reader.varint()) <= MOST_AXES:
            raise ValueError(f"it states {dim} axes, which are 1 to {MOST_AXES}")
        domain = read_domain(reader, dim, bool(second & _FLOATS))
        folding = read_folding(reader, domain) if second & _FOLDED else None
        label, sizes = "", ()
        if second & _EXTENDED:
            if (length := reader.varint()) > MOST_LABEL_BYTES:
                raise ValueError(f"it states a label of {length} bytes, more than {MOST_LABEL_BYTES}")
            try:
                label = reader.take(length).decode()
            except UnicodeDecodeError:
                raise ValueError("its label is no text") from None
            if (count := reader.varint()) > MOST_LAYERS:
                raise ValueError(f"it states {count} layers, more than {MOST_LAYERS}")
            if count and second & 7 != PAIRS_CODE:
                raise ValueError("it begins with coarser PLRs, as progressive made them; plr_jax 0.1 reads it")
            sizes = tuple(reader.varint() for _ in range(count))
        header = Header(domain, second & 7, second >> 3 & 3, folding, label, sizes)
        if header.data != data[: reader.at]:
            raise ValueError("its header is not written in the one way there is")
        return header


@dataclass(frozen=True)
class Container:
    """What every PLR file has. With a ``folding``, points are folded.

    Of pairs that were cut off at a mark, ``layers`` are those that there still are.
    """

    domain: Box
    layers: tuple[Layer, ...]
    folding: Folding | None = None
    label: str = ""

    @property
    def last(self) -> Layer:
        """The last layer, which is the only one of a PLR."""
        return self.layers[-1]

    @property
    def folded_domain(self) -> Box:
        """The box that the leaves partition."""
        return self.domain if self.folding is None else self.folding.box

    def to_bytes(self) -> bytes:
        """The bytes of the file."""
        *first, last = self.layers
        parts = [*(bytes([layer.leaf_code | layer.proof_code << 4]) + layer.body for layer in first), last.body]
        sizes = tuple(len(part) + _CRC.size for part in parts[:-1])
        data = Header(self.domain, last.leaf_code, last.proof_code, self.folding, self.label, sizes).data
        crc = zlib.crc32(data)
        for part in parts:
            crc = zlib.crc32(part, crc)
            data += part + _CRC.pack(crc)
        return data

    @staticmethod
    def from_bytes(data: bytes) -> "Container":
        """What a file's bytes hold, cut off at a mark or not; raises ``ValueError`` saying what is wrong."""
        if len(data) > MOST_BYTES:
            raise ValueError(f"it has more than {MOST_BYTES:,} bytes")
        header = Header.read(data)
        start, crc, layers = len(header.data), zlib.crc32(header.data), []
        for end in (*header.marks, len(data)):
            if layers and start == len(data):
                break  # cut off
            is_last = len(layers) == len(header.sizes)
            if not start + (not is_last) + _CRC.size <= end <= len(data):
                raise ValueError("the data end too early")
            part, checksum = data[start : end - _CRC.size], data[end - _CRC.size : end]
            if (crc := zlib.crc32(part, crc)) != _CRC.unpack(checksum)[0]:
                raise ValueError("its checksum does not match: the file is truncated or corrupt")
            codes = (header.leaf_code, header.proof_code) if is_last else (part[0] & 15, part[0] >> 4)
            layers.append(Layer(codes[0], part if is_last else part[1:], codes[1]))
            start = end
        return Container(header.domain, tuple(layers), header.folding, header.label)


def require_label(label: str) -> None:
    """Raise ``ValueError`` unless a file has room for this label."""
    try:
        fits = isinstance(label, str) and len(label.encode()) <= MOST_LABEL_BYTES
    except UnicodeEncodeError:  # half a surrogate pair
        fits = False
    if not fits:
        raise ValueError(f"A label is a text of at most {MOST_LABEL_BYTES:,} bytes, got {shortened(label)}.")


def frame_size(domain: Box, folding: Folding | None = None, label: str = "") -> int:
    """Bytes of a file of one layer besides its bit stream."""
    return len(Header(domain, 0, folding=folding, label=label).data) + _CRC.size


# Files as bytes, of which no more is read than may be a PLR.


_START = 2**12


def holds_pairs(data: bytes) -> bool:
    """Whether a file's bytes are of pairs, of points or of cells of a grid; ``ValueError`` if of nothing known."""
    return data.startswith(GRID_MAGIC) or Header.read(data).leaf_code == PAIRS_CODE


def read_bytes(path: str | os.PathLike) -> bytes:
    """What a file holds: all of it, or one byte more than a file may have; of what is no PLR file only the start."""
    with open(path, "rb") as file:
        data = file.read(_START)
        if data.startswith((MAGIC, GRID_MAGIC)):  # or there is nothing to read for, and it may not end
            data += file.read(MOST_BYTES + 1 - len(data))
        return data


# What a file keeps of a folding, after the domain: floats little-endian.
#
# f64     the center, one number an axis
# u8      1 if folded coordinates run along axes of their own, else 0
# f64     of such the axes, row by row
# u8      number of mirrors
# u8      for each mirror one number an axis, 1 if it is reversed, else 0; then zeros, one an axis


_ORTHOGONAL = 1e-9


def folding_to_bytes(folding: Folding) -> bytes:
    """What the file keeps."""
    marks = np.array([*folding.mirrors, (0,) * folding.domain.dim], np.uint8)
    axes = folding.axes.astype("<f8").tobytes() if folding.is_turned else b""
    center, num_mirrors = folding.center.astype("<f8").tobytes(), bytes([len(folding.mirrors)])
    return center + bytes([folding.is_turned]) + axes + num_mirrors + marks.tobytes()


def read_folding(reader: ByteReader, domain: Box) -> Folding:
    """The next folding; raises ``ValueError`` saying what is wrong with it."""
    dim = domain.dim
    center = np.frombuffer(reader.take(8 * dim), "<f8").astype(np.float64)
    axes = np.eye(dim)
    if _flags(reader.take(1))[0]:
        axes = np.frombuffer(reader.take(8 * dim * dim), "<f8").astype(np.float64).reshape(dim, dim)
    marks = _flags(reader.take(dim * (reader.byte() + 1))).reshape(-1, dim)
    mirrors = tuple(tuple(map(bool, row)) for row in marks[:-1])
    if marks[-1].any():
        raise ValueError(
            "it stores what a distance is more than a straight line, which plr_jax 0.1 reads; build it again"
        )
    if not (np.isfinite(center).all() and np.isfinite(axes).all()):
        raise ValueError("its folding has numbers that are not finite")
    unit, periodic = np.eye(dim), np.array(domain.periodic)
    if np.abs(axes).max() > 2 or np.abs(axes @ axes.T - unit).max() > _ORTHOGONAL or (axes != unit)[periodic].any():
        raise ValueError("the axes of its folding are not orthogonal, or turn a periodic one")
    if not mirrors:
        raise ValueError("its folding folds nothing")
    folding = Folding(domain, center, axes, mirrors)
    if folding.cutting_mirrors != mirrors:
        raise ValueError("its folding has a mirror that does not cut the domain")
    return folding


def _flags(data: bytes) -> Bool[np.ndarray, "n"]:
    numbers = np.frombuffer(data, np.uint8)
    if (numbers > 1).any():
        raise ValueError(f"its folding has a mark of {numbers.max()}, which is 0 or 1")
    return numbers == 1


# The domain as a file keeps it. Most maps have corners of few decimals, so it is multiples of a power of ten, or else
# 64-bit floats:
#
#     of decimals  u8      how many: a number is an integer divided by 10 to their power, rounded as floats are
#                  ...     signed numbers, those integers: the lower corner, one an axis, then the upper corner
#     of floats    f64     the same corners, little-endian
#
# Of each periodic axis the two ends are exchanged: the upper one comes first.


_MOST_DECIMALS = 22  # powers of ten up to this one, and integers below the next, are exact in 64 bits
_LARGEST = 2**53
_EXACT = Context(prec=40, traps=[])  # whatever the caller has set: numbers have at most 17 digits


def domain_to_bytes(domain: Box) -> tuple[bytes, bool]:
    """What the file keeps, and whether that is floats."""
    first, second = np.where(domain.periodic, (domain.hi, domain.lo), (domain.lo, domain.hi))
    numbers = np.concatenate([first, second])
    floats, decimals = numbers.astype("<f8").tobytes(), _decimals(numbers.tolist())
    return (floats, True) if decimals is None or len(decimals) > len(floats) else (decimals, False)


def read_domain(reader: ByteReader, dim: int, is_floats: bool) -> Box:
    """The next domain; raises ``ValueError`` saying what is wrong with it."""
    if is_floats:
        numbers = np.frombuffer(reader.take(16 * dim), "<f8").astype(np.float64)
    else:
        if (decimals := reader.byte()) > _MOST_DECIMALS:
            raise ValueError(f"its domain has numbers of {decimals} decimals, more than {_MOST_DECIMALS}")
        integers = [reader.signed_varint() for _ in range(2 * dim)]
        if max(map(abs, integers)) > _LARGEST:
            raise ValueError("its domain has numbers that are too large")
        numbers = np.array(integers, np.float64) / float(10**decimals)
    corners = numbers.reshape(2, dim)
    periodic = corners[0] > corners[1]
    lo, hi = np.where(periodic, corners[::-1], corners)
    return Box(lo, hi, tuple(map(bool, periodic)))


def _decimals(numbers: list[float]) -> bytes | None:
    """The numbers as integers over one power of ten; None where that is not exact."""
    shortest = [Decimal(repr(number)) for number in numbers]
    decimals = max(0, *(-int(number.normalize(_EXACT).as_tuple().exponent) for number in shortest))
    integers = [int(number.scaleb(decimals, _EXACT)) for number in shortest]
    if decimals > _MOST_DECIMALS or max(map(abs, integers)) > _LARGEST:
        return None
    # A zero may be negative, which no integer is; a box does not tell them apart.
    if [integer / float(10**decimals) for integer in integers] != numbers:
        return None
    return bytes([decimals]) + b"".join(map(signed_varint, integers))


_SIZE_BYTES = 4


class FileBacked:
    """What is made of a file's bytes alone: the bytes, their label, and how much memory the tables take."""

    tables: Any
    file: Any

    def to_bytes(self) -> bytes:
        """The bytes of the file, which :func:`save` writes; ``ValueError`` where the arrays are those of several."""
        if np.ndim(self.file) != 1:
            raise ValueError(f"Bytes are those of one, but these arrays are those of several: {self.file.shape}.")
        return np.asarray(self.file).tobytes()[: self.num_bytes]

    @property
    def num_bytes(self) -> int:
        """Bytes of the file."""
        return int.from_bytes(np.asarray(self.file)[-_SIZE_BYTES:].tobytes(), "little")

    @property
    def label(self) -> str:
        """What the file says of itself: which map, which goal. Empty if it says nothing.

        Any text that who wrote the file chose; it may hold control characters, which a terminal obeys.
        """
        return Header.read(self.to_bytes()).label

    def with_label(self, label: str) -> Any:
        """The same with another label.

        Args:
            label: Any text of up to 1,000 bytes in UTF-8, which the file then takes more.

        Returns:
            What answers alike, bit for bit.

        Raises:
            ValueError: If it is no text, or longer.
        """
        require_label(label)
        if label == self.label:
            return self
        made_of: Any = type(self)
        return made_of(padded_file(replace(Container.from_bytes(self.to_bytes()), label=label).to_bytes()))

    @property
    def resident_bytes(self) -> int:
        """Bytes of the tables that a query reads."""
        import jax  # which no file needs

        return sum(array.nbytes for array in jax.tree_util.tree_leaves(self.tables))


def padded_file(data: bytes) -> UInt8[np.ndarray, "padded"]:
    """Bytes of a file as an array of one of few sizes: padded with zeros, and last of all how many they are."""
    file = padded(np.frombuffer(data, np.uint8), padded_size(len(data) + _SIZE_BYTES))
    file[-_SIZE_BYTES:] = np.frombuffer(len(data).to_bytes(_SIZE_BYTES, "little"), np.uint8)
    return file
