r"""The container of a PLR file: a header, the domain, a bit stream that begins with the tree, and a checksum.

All numbers are little-endian. Layout of version 2, of version 3 for domains with a periodic axis, and of
version 4 for leaves of folded points, whether or not an axis is periodic:

    4s      magic, b"PLR\n"
    u8      version
    u8      number of axes
    u8      code of the leaf model; 255 for distances of pairs of points (see ``plr/pairs/stored.py``)
    u8      what it keeps of a proof: 0 nothing, 1 the largest error, 2 bounds of every leaf as well
    u32     number of leaves
    u32     size of the whole file in bytes
    f64     lower corner of the domain, one number an axis; then the upper corner. Of each periodic axis, of which
              version 3 has one or more and version 2 none, the two are exchanged: the upper end comes first
    ...     of version 4, how points are folded (see ``plr/folding/codec.py``); leaves are then of the box of those
    ...     bit stream, least significant bit first, the last byte filled up with zeros:
              the tree over the leaves, whose boxes follow from the splits: level by level from the root, for every
                node 1 bit (is it split?), then for every split node its axis in ``ceil(log2(dim))`` bits
              what the leaf model keeps of the leaves (see its ``codec.py``), in the order of the tree's traversal,
                lower half first
              what it keeps of a proof (see ``plr/certificate/certificate.py``)
    u32     CRC-32 of all bytes before
"""

import struct
import zlib
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from plr_jax.geometry.box import Box
from plr_jax.plr.file.bits import BitReader, BitWriter
from plr_jax.plr.folding.codec import folding_to_bytes, read_folding
from plr_jax.plr.folding.folding import Folding
from plr_jax.plr.partition.tree import MAX_DEPTH, Level

VERSION, _PERIODIC_VERSION, _FOLDED_VERSION = 2, 3, 4
_VERSIONS = (VERSION, _PERIODIC_VERSION, _FOLDED_VERSION)
PAIRS_CODE = 255
"""Code that stands for a leaf model in files of distances between pairs of points."""
_MAGIC = b"PLR\n"
_START_OF_CONTINUOUS = b"CPL\n\x01"  # in version 1, continuous PLRs had a format of their own
_HEADER = struct.Struct("<4sBBBBII")
HEADER_SIZE = _HEADER.size
_CRC = struct.Struct("<I")


@dataclass(frozen=True)
class Container:
    """What every PLR file has; its body is the bit stream. With a ``folding``, points are folded."""

    domain: Box
    leaf_code: int
    num_leaves: int
    body: bytes
    proof_code: int = 0
    folding: Folding | None = None

    @property
    def folded_domain(self) -> Box:
        """The box that the leaves partition."""
        return self.domain if self.folding is None else self.folding.box

    def to_bytes(self) -> bytes:
        """The bytes of the file."""
        domain = self.domain
        first, second = np.where(domain.periodic, (domain.hi, domain.lo), (domain.lo, domain.hi))
        content = np.concatenate([first, second]).astype("<f8").tobytes()
        if self.folding is not None:
            content += folding_to_bytes(self.folding)
        content += self.body
        size = HEADER_SIZE + len(content) + _CRC.size
        version = _PERIODIC_VERSION if domain.is_periodic else VERSION
        version = version if self.folding is None else _FOLDED_VERSION
        header = _HEADER.pack(_MAGIC, version, domain.dim, self.leaf_code, self.proof_code, self.num_leaves, size)
        return header + content + _CRC.pack(zlib.crc32(header + content))

    @staticmethod
    def from_bytes(data: bytes) -> "Container":
        """What a file's bytes hold; raises ``ValueError`` saying what is wrong with them."""
        if not data.startswith((_MAGIC, _START_OF_CONTINUOUS)):
            raise ValueError("it does not start like a PLR file")
        version = data[4] if len(data) > len(_MAGIC) else VERSION
        if version not in _VERSIONS:
            remedy = "update plr_jax" if version > VERSION else "build it again"
            versions = f"versions {VERSION} to {_FOLDED_VERSION}"
            raise ValueError(f"it has format version {version}, this release reads {versions}; {remedy}")
        if len(data) < HEADER_SIZE + _CRC.size:
            raise ValueError("the data end too early")
        _, _, dim, leaf_code, proof_code, num_leaves, size = _HEADER.unpack_from(data)
        if len(data) != size:
            number = f"{len(data)}" if len(data) < size else "more"
            raise ValueError(f"it has {number} bytes, its header states {size}: the file is truncated or corrupt")
        (crc,) = _CRC.unpack(data[-_CRC.size :])
        if zlib.crc32(data[: -_CRC.size]) != crc:
            raise ValueError("its checksum does not match: the file is corrupt")
        content = data[HEADER_SIZE : -_CRC.size]
        if dim == 0 or len(content) < 16 * dim:
            raise ValueError(f"it states {dim} axes, and holds {len(content)} bytes for them and the leaves")
        corners = np.frombuffer(content[: 16 * dim], "<f8").astype(np.float64).reshape(2, dim)
        domain = Box(corners[0], corners[1]) if version == VERSION else _periodic_domain(corners, version)
        folding, body = None, content[16 * dim :]
        if version == _FOLDED_VERSION:
            folding, body = read_folding(body, domain)
        return Container(domain, leaf_code, num_leaves, body, proof_code, folding)


def _periodic_domain(corners: Float[np.ndarray, "2 dim"], version: int) -> Box:
    """The domain of versions whose periodic axes have the upper end first; version 3 is for such alone."""
    periodic = corners[0] > corners[1]
    if version == _PERIODIC_VERSION and not periodic.any():
        raise ValueError(f"it has format version {_PERIODIC_VERSION}, but none of its axes is periodic")
    lo, hi = np.where(periodic, corners[::-1], corners)
    return Box(lo, hi, tuple(map(bool, periodic)))


def container_size(dim: int, num_leaves: int, num_bits: int) -> int:
    """Size of a file of so many leaves, of which the model keeps so many bits."""
    tree_bits = 2 * num_leaves - 1 + (num_leaves - 1) * _axis_bits(dim)
    return int(HEADER_SIZE + 16 * dim - (-(tree_bits + num_bits) // 8) + _CRC.size)


def is_header(data: bytes) -> bool:
    """Whether a file that begins so may be one of this version."""
    return len(data) >= HEADER_SIZE and data.startswith(_MAGIC) and data[4] in _VERSIONS


def file_size(header: bytes) -> int:
    """Size that a file's header, its first ``HEADER_SIZE`` bytes, states."""
    return _HEADER.unpack_from(header)[-1]


def write_tree(body: BitWriter, levels: list[Level], dim: int) -> None:
    """Append a tree."""
    for level in levels:
        body.write(level.inner.astype(np.int64), 1)
        body.write(level.axis, _axis_bits(dim))


def read_tree(body: BitReader, dim: int, num_leaves: int) -> list[Level]:
    """The tree that comes next; raises ``ValueError`` if it is none with so many leaves."""
    levels, num_nodes = [], 1
    while num_nodes:
        if len(levels) > MAX_DEPTH:
            raise ValueError(f"its tree is deeper than {MAX_DEPTH}")
        inner = body.read_alike(num_nodes, 1) == 1
        axis = body.read_alike(int(np.count_nonzero(inner)), _axis_bits(dim))
        if (axis >= dim).any():
            raise ValueError(f"it splits axis {axis.max()} of {dim}")
        levels.append(Level(inner, axis))
        num_nodes = 2 * len(axis)
    found = 1 + sum(len(level.axis) for level in levels)
    if found != num_leaves:
        raise ValueError(f"its tree has {found} leaves, its header states {num_leaves}")
    return levels


def _axis_bits(dim: int) -> int:
    return (dim - 1).bit_length()
