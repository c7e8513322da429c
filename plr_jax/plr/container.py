"""The outer structure of PLR files: header, checksums and layers of bits, as ``portable/FORMAT.md`` describes it."""

import os
import struct
import zlib
from copy import copy
from dataclasses import dataclass, replace
from decimal import Context, Decimal
from functools import cached_property
from itertools import accumulate
from typing import Any

import numpy as np
from jaxtyping import UInt8

from plr_jax._arrays import padded, padded_size, shortened
from plr_jax.geometry.box import Box
from plr_jax.plr.coding import ByteReader, signed_varint, varint
from plr_jax.plr.folding import Folding

VERSION = 5  # version of files without the parts below; release 0.2 reads no other version
_NAMING_GOALS = 1  # added to the version if a file names goals
_WITH_CUT_OFF = 2  # added to the version if a file names leaves that answer ``inf``
PAIRS_CODE = 7  # in place of a leaf model's code, in files of distances between pairs of points
MOST_LABEL_BYTES = 1000
MOST_BYTES = 2**28  # largest size of a file
MOST_AXES = 255  # most axes of a domain
MAGIC = b"P\xb5"  # first bytes of every file of this version
GRID_MAGIC = b"PGP\n"  # first bytes of files of distances between cells of a grid (``pairs/FORMAT.md``)
BUILDING_MAGIC = b"PBD\n"  # first bytes of files of buildings: floors and links, then a file of this version
_EARLIER = b"PLR\n", b"CPL\n"  # first bytes of files of earlier versions
MOST_LAYERS = 32
_MOST_IN_BITS = 15  # most axes that fit into four bits of the header's first byte
# Flags in the header's second byte.
_FOLDED = 1 << 5  # mirror symmetries follow the domain
_EXTENDED = 1 << 6  # a label and the sizes of layers follow
_FLOATS = 1 << 7  # the domain's corners are floats, not decimal numbers
_CRC = struct.Struct("<I")
_START = 2**12  # bytes that are read before the first bytes are checked
_ORTHOGONAL = 1e-9  # tolerance for entries of ``axes @ axes.T``
_MOST_DECIMALS = 22  # 10**22 is the largest power of ten that a 64-bit float holds exactly
_LARGEST = 2**53  # 64-bit floats hold all integers up to this one exactly
_EXACT = Context(prec=40, traps=[])  # used instead of the caller's context; coordinates have at most 17 digits
_SIZE_BYTES = 4


@dataclass(frozen=True)
class Layer:
    """A layer of a file: encoded leaves and their proof, with the codes of the leaf model and the proof's kind."""

    leaf_code: int
    body: bytes  # encoded tree, leaves and proof
    proof_code: int = 0


@dataclass(frozen=True)
class Header:
    """The header of a file: the domain, and the kinds of data in the file's layers."""

    container: "Container"  # the described file; of its layers, only the codes of the last one count
    sizes: tuple[int, ...] = ()  # bytes of each layer but the last

    @cached_property
    def data(self) -> bytes:
        """The bytes of the header, as ``portable/FORMAT.md`` describes them."""
        # After MAGIC, from the highest bit down:
        #   first byte   | number of axes, 0 if a varint follows: 4 | version: 4 |
        #   second byte  | floats: 1 | extended: 1 | folded: 1 | kind of proof: 2 | leaf model: 3 |
        file, dim, folding = self.container, self.container.domain.dim, self.container.folding
        domain, is_floats = domain_to_bytes(file.domain)
        if dim > MOST_AXES:
            raise ValueError(f"A domain must have at most {MOST_AXES} axes, got {dim}.")
        fits = dim <= _MOST_IN_BITS
        label = file.label.encode()
        flags = _FOLDED * (folding is not None) | _EXTENDED * bool(label or self.sizes) | _FLOATS * is_floats
        version = VERSION + _NAMING_GOALS * file.names_goals + _WITH_CUT_OFF * file.has_cut_off
        kinds = file.last.leaf_code | file.last.proof_code << 3 | flags
        parts = [MAGIC, bytes([version | (dim * fits) << 4, kinds]), b"" if fits else varint(dim), domain]
        if folding is not None:
            parts.append(folding_to_bytes(folding))
        if flags & _EXTENDED:
            parts += [varint(len(label)), label, varint(len(self.sizes)), *map(varint, self.sizes)]
        return b"".join(parts)

    @property
    def marks(self) -> tuple[int, ...]:
        """The position in the file, in bytes, at which each layer but the last ends."""
        return tuple(accumulate(self.sizes, initial=len(self.data)))[1:]

    @staticmethod
    def read(data: bytes) -> "Header":
        """Decode the header at the beginning of a file's bytes.

        ``ValueError`` if it is invalid, or encoded in another way than :attr:`data` encodes it.
        """
        # 1. Magic bytes, version and number of axes.
        if data.startswith(_EARLIER):
            raise ValueError(f"it must have format version {VERSION}, but has an earlier one; build it again")
        reader = ByteReader(data)
        if data[: len(MAGIC)] != MAGIC:
            raise ValueError("it does not start like a PLR file")
        *_, first, second = reader.take(len(MAGIC) + 2)
        newest = VERSION + _NAMING_GOALS + _WITH_CUT_OFF
        if not VERSION <= (version := first & 15) <= newest:
            remedy = "update plr_jax" if version > VERSION else "build it again"
            readable = f"this release reads versions {VERSION} to {newest}"
            raise ValueError(f"it has format version {version}, {readable}; {remedy}")
        names_goals, has_cut_off = (bool(version - VERSION & bit) for bit in (_NAMING_GOALS, _WITH_CUT_OFF))
        if version > VERSION and second & 7 == PAIRS_CODE:
            raise ValueError("it names goals or leaves of distances between any two points")
        if not 1 <= (dim := first >> 4 or reader.varint()) <= MOST_AXES:
            raise ValueError(f"it must have 1 to {MOST_AXES} axes, but states {dim}")
        # 2. Domain, mirror symmetries, label and sizes of layers.
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
                raise ValueError("it is a progressive file of PLRs, which only plr_jax 0.1 reads; build it again")
            sizes = tuple(reader.varint() for _ in range(count))
        # 3. Every header has one encoding: no other one decodes to it.
        last = Layer(second & 7, b"", second >> 3 & 3)
        header = Header(Container(domain, (last,), folding, label, names_goals, has_cut_off), sizes)
        if header.data != data[: reader.at]:
            raise ValueError("its header is not in canonical form")
        return header


@dataclass(frozen=True)
class Container:
    """The content of a file: its header and its *layers*, each of which has encoded leaves and a proof.

    A PLR file has one layer. A file of distances between any two points may have several.
    """

    domain: Box
    layers: tuple[Layer, ...]
    folding: Folding | None = None
    label: str = ""
    names_goals: bool = False  # whether the layer, of cones, names the goals to which their paths lead
    has_cut_off: bool = False  # whether the layer names leaves that answer ``inf``

    @property
    def last(self) -> Layer:
        return self.layers[-1]

    @property
    def folded_domain(self) -> Box:
        return self.domain if self.folding is None else self.folding.box

    def to_bytes(self) -> bytes:
        """Encode the file: the header, then each layer with a checksum of the header and of all layers so far."""
        *first, last = self.layers
        parts = [*(bytes([layer.leaf_code | layer.proof_code << 4]) + layer.body for layer in first), last.body]
        data = Header(self, tuple(len(part) + _CRC.size for part in parts[:-1])).data
        crc = zlib.crc32(data)
        for part in parts:
            crc = zlib.crc32(part, crc)
            data += part + _CRC.pack(crc)
        return data

    @staticmethod
    def from_bytes(data: bytes) -> "Container":
        """Decode a file; ``ValueError`` if it is invalid. A file of several layers may lack its last layers."""
        if len(data) > MOST_BYTES:
            raise ValueError(f"it has more than {MOST_BYTES:,} bytes")
        header = Header.read(data)
        last = header.container.last
        start, crc, layers = len(header.data), zlib.crc32(header.data), []
        for end in (*header.marks, len(data)):
            if layers and start == len(data):
                break  # the file was cut off after a layer
            is_last = len(layers) == len(header.sizes)
            if not start + (not is_last) + _CRC.size <= end <= len(data):
                raise ValueError("the data end too early")
            part, checksum = data[start : end - _CRC.size], data[end - _CRC.size : end]
            if (crc := zlib.crc32(part, crc)) != _CRC.unpack(checksum)[0]:
                raise ValueError("its checksum does not match: the file is truncated or corrupt")
            layers.append(replace(last, body=part) if is_last else Layer(part[0] & 15, part[1:], part[0] >> 4))
            start = end
        return replace(header.container, layers=tuple(layers))


def frame_size(domain: Box, folding: Folding | None = None, label: str = "") -> int:
    """Return the size in bytes of a PLR file without its leaves and proof: the header and the checksum."""
    return len(Container(domain, (Layer(0, b""),), folding, label).to_bytes())


def holds_pairs(data: bytes) -> bool:
    """Return True if a file stores distances between any two points, False if it stores a PLR.

    ``ValueError`` if ``data``, the bytes of the file, are neither.
    """
    return data.startswith(GRID_MAGIC) or Header.read(data).container.last.leaf_code == PAIRS_CODE


def read_bytes(path: str | os.PathLike) -> bytes:
    """Read at most ``MOST_BYTES + 1`` bytes of a file, or at most 4,096 if it is no file of a PLR or of pairs."""
    with open(path, "rb") as file:
        data = file.read(_START)
        if data.startswith((MAGIC, GRID_MAGIC, BUILDING_MAGIC)):  # another file may be endless, such as a device
            data += file.read(MOST_BYTES + 1 - len(data))
        return data


def folding_to_bytes(folding: Folding) -> bytes:
    marks = np.array([*folding.mirrors, (0,) * folding.domain.dim], np.uint8)
    axes = folding.axes.astype("<f8").tobytes() if folding.is_turned else b""
    center, num_mirrors = folding.center.astype("<f8").tobytes(), bytes([len(folding.mirrors)])
    return center + bytes([folding.is_turned]) + axes + num_mirrors + marks.tobytes()


def read_folding(reader: ByteReader, domain: Box) -> Folding:
    """Decode the mirror symmetries of a domain; ``ValueError`` if a mirror is invalid or does not cut the domain."""
    # 1. Read the center, the axes if they are rotated, and a row of ``marks`` for each mirror: 1 where it reverses an
    #    axis. Release 0.1 marked straight lines in one more row.
    dim = domain.dim
    center = np.frombuffer(reader.take(8 * dim), "<f8").astype(np.float64)
    axes = unit = np.eye(dim)
    if reader.byte():
        axes = np.frombuffer(reader.take(8 * dim * dim), "<f8").astype(np.float64).reshape(dim, dim)
    marks = np.frombuffer(reader.take(dim * (reader.byte() + 1)), np.uint8).reshape(-1, dim)
    mirrors = tuple(tuple(map(bool, row)) for row in marks[:-1])
    if marks[-1].any():
        raise ValueError("it stores distances minus straight lines, which only plr_jax 0.1 reads; build it again")
    # 2. Check them.
    if not (np.isfinite(center).all() and np.isfinite(axes).all()):
        raise ValueError("its folding has values that are not finite")
    periodic = np.array(domain.periodic)
    if np.abs(axes).max() > 2 or np.abs(axes @ axes.T - unit).max() > _ORTHOGONAL or (axes != unit)[periodic].any():
        raise ValueError("the axes of its folding are not orthogonal, or rotate a periodic axis")
    if not mirrors:
        raise ValueError("its folding has no mirrors")
    folding = Folding(domain, center, axes, mirrors)
    if folding.cutting_mirrors != mirrors:
        raise ValueError("its folding has a mirror that does not cut the domain")
    return folding


def domain_to_bytes(domain: Box) -> tuple[bytes, bool]:
    """Encode a domain as in ``portable/FORMAT.md``; also return whether its coordinates are stored as floats."""
    numbers = np.where(domain.periodic, (domain.hi, domain.lo), (domain.lo, domain.hi)).ravel()
    floats = numbers.astype("<f8").tobytes()
    # Decimal numbers are integers divided by one power of ten, if this is exact and the integers are not too large.
    shortest = [Decimal(repr(number)) for number in numbers.tolist()]
    decimals = max(0, *(-int(number.normalize(_EXACT).as_tuple().exponent) for number in shortest))
    integers = [int(number.scaleb(decimals, _EXACT)) for number in shortest]
    if decimals > _MOST_DECIMALS or max(map(abs, integers)) > _LARGEST:
        return floats, True
    # The decimal form of -0.0 decodes to 0.0, which is equal and makes the same box.
    is_exact = [integer / float(10**decimals) for integer in integers] == numbers.tolist()
    data = bytes([decimals]) + b"".join(map(signed_varint, integers))
    return (data, False) if is_exact and len(data) <= len(floats) else (floats, True)


def read_domain(reader: ByteReader, dim: int, is_floats: bool) -> Box:
    """Decode a domain whose coordinates are stored as floats or as decimal numbers.

    The file has the lower corner, then the upper corner. On a periodic axis, the upper end comes first.
    """
    if is_floats:
        numbers = np.frombuffer(reader.take(16 * dim), "<f8").astype(np.float64)
    else:
        if (decimals := reader.byte()) > _MOST_DECIMALS:
            raise ValueError(f"its domain has coordinates of {decimals} decimals, more than {_MOST_DECIMALS}")
        integers = [reader.signed_varint() for _ in range(2 * dim)]
        if max(map(abs, integers)) > _LARGEST:
            raise ValueError("its domain has coordinates that are too large")
        numbers = np.array(integers, np.float64) / float(10**decimals)
    corners = numbers.reshape(2, dim)
    periodic = corners[0] > corners[1]
    return Box(*np.where(periodic, corners[::-1], corners), periodic=tuple(map(bool, periodic)))


_EXPECTED = "The arrays must be those that were built with the file, but were replaced, as by jax.tree.map."
_ADVICE = "to store other distances, fit them with construct."
_REPLACED = f"{_EXPECTED} The file, its proof and exports belong to the old arrays: {_ADVICE}"


class FileBacked:
    """A base class of objects that keep the bytes of their file: PLRs, and distances between any two points.

    Such an object is a pytree of arrays. JAX may make a new object from other arrays (``jax.tree.map``). The file of
    the new object then does not belong to its arrays.
    """

    tables: Any
    file: Any
    array_names = "tables", "file"  # attributes that make the object a pytree
    is_from_arrays = False  # whether JAX made the object from a pytree's arrays, which may differ from the file's

    def to_bytes(self) -> bytes:
        """Return the bytes that :func:`save` writes.

        ``ValueError`` if the arrays of several objects are stacked, or were replaced, as by ``jax.tree.map``.
        """
        data = self.file_bytes
        self.require_arrays_of_file()
        return data

    @property
    def file_bytes(self) -> bytes:
        """The bytes of the file, without a check that the object's arrays still belong to it.

        ``ValueError`` if the arrays of several objects are stacked, or the array ``file`` itself was replaced.
        """
        if np.ndim(self.file) != 1:
            raise ValueError(f"One object is needed, but its arrays are stacked: file has shape {self.file.shape}.")
        data = np.asarray(self.file).tobytes()[: self.num_bytes]
        if self.is_from_arrays and not data.startswith(MAGIC):
            raise ValueError(_REPLACED)
        return data

    def require_arrays_of_file(self) -> None:
        if not self.has_arrays_of_file:
            raise ValueError(_REPLACED)

    @cached_property
    def has_arrays_of_file(self) -> bool:
        """Whether the arrays that a query reads equal the arrays that the file decodes to.

        If JAX made the object from arrays, the first use of this property decodes the file.
        """
        if not self.is_from_arrays:
            return True
        import jax  # only needed here

        made_of: Any = type(self)
        try:
            of_file = jax.tree.leaves(made_of(padded_file(self.file_bytes)))
        except ValueError:  # bytes of no file
            return False
        arrays = jax.tree.leaves(self)
        pairs = zip(arrays, of_file, strict=False)
        return len(arrays) == len(of_file) and all(np.array_equal(*pair, equal_nan=True) for pair in pairs)

    def tree_flatten_with_keys(self) -> tuple[tuple[tuple[Any, Any], ...], None]:
        from jax.tree_util import GetAttrKey  # only needed here

        return tuple((GetAttrKey(name), getattr(self, name)) for name in self.array_names), None

    @classmethod
    def tree_unflatten(cls, _: None, children: tuple[Any, ...]) -> Any:
        new = object.__new__(cls)
        new.__dict__.update(zip(cls.array_names, children, strict=True), is_from_arrays=True)
        return new

    @property
    def num_bytes(self) -> int:
        """Size of the file in bytes."""
        return int.from_bytes(np.asarray(self.file)[-_SIZE_BYTES:].tobytes(), "little")

    @property
    def table_class(self) -> int:
        """Size of the file in bytes, without its label; the sizes of lookup tables depend on this size."""
        header = Header.read(self.file_bytes)
        unlabeled = replace(header, container=replace(header.container, label=""))
        return self.num_bytes - len(header.data) + len(unlabeled.data)

    @property
    def label(self) -> str:
        """Text attached to the file, such as a map's name, or ``""``; it may contain control characters."""
        return Header.read(self.file_bytes).container.label

    def with_label(self, label: str) -> Any:
        """Return a copy whose file stores another label, a text of at most 1,000 bytes (else ``ValueError``).

        The copy shares all lookup tables.
        """
        try:
            fits = isinstance(label, str) and len(label.encode()) <= MOST_LABEL_BYTES
        except UnicodeEncodeError:  # half a surrogate pair
            fits = False
        if not fits:
            raise ValueError(f"label must be text of up to {MOST_LABEL_BYTES:,} UTF-8 bytes, got {shortened(label)}.")
        if label == self.label:
            return self
        labeled = copy(self)
        labeled.__dict__["file"] = padded_file(replace(Container.from_bytes(self.to_bytes()), label=label).to_bytes())
        return labeled

    @property
    def resident_bytes(self) -> int:
        """Memory in bytes of the lookup tables that a query reads."""
        import jax  # only needed here

        return sum(array.nbytes for array in jax.tree_util.tree_leaves(self.tables))


def padded_file(data: bytes) -> UInt8[np.ndarray, "padded"]:
    """Return a file's bytes as an array, padded with zeros to a power of two; the last 4 bytes have its size."""
    file = padded(np.frombuffer(data, np.uint8), padded_size(len(data) + _SIZE_BYTES))
    file[-_SIZE_BYTES:] = np.frombuffer(len(data).to_bytes(_SIZE_BYTES, "little"), np.uint8)
    return file
