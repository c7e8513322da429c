"""What the files of both kinds of PLR have around their bit stream: a header, the domain, a step, and a checksum."""

import struct
import zlib
from dataclasses import dataclass

import numpy as np

from plr_jax.geometry.box import Box

_HEADER = struct.Struct("<4sBBBBII")
HEADER_SIZE = _HEADER.size
_SPAN = struct.Struct("<ff")
_CRC = struct.Struct("<I")


@dataclass(frozen=True)
class FileKind:
    """A kind of file.

    Attributes:
        magic: The first four bytes.
        version: The format version.
        name: What messages call the kind.
    """

    magic: bytes
    version: int
    name: str


def frame(kind: FileKind, dim: int, variant: int, num_leaves: int, content: bytes) -> bytes:
    """The bytes of a file: header, content and checksum. The byte ``variant`` means what the kind says."""
    size = _HEADER.size + len(content) + _CRC.size
    data = _HEADER.pack(kind.magic, kind.version, dim, variant, 0, num_leaves, size) + content
    return data + _CRC.pack(zlib.crc32(data))


def framed_size(dim: int, num_bits: int) -> int:
    """Size of a file whose body has so many bits."""
    return int(_HEADER.size + 16 * dim + _SPAN.size - (-num_bits // 8) + _CRC.size)


def file_size(data: bytes) -> int:
    """Size that a file's header, its first ``HEADER_SIZE`` bytes, states."""
    return _HEADER.unpack_from(data)[-1]


def unframe(kind: FileKind, data: bytes) -> tuple[int, int, int, bytes]:
    """Dimension, variant, number of leaves and content of a file; raises ``ValueError`` saying what is wrong."""
    if data[: len(kind.magic)] != kind.magic:
        raise ValueError(f"it does not start like {kind.name}")
    if len(data) < _HEADER.size + _CRC.size:
        raise ValueError("the data end too early")
    _, version, dim, variant, _, num_leaves, size = _HEADER.unpack_from(data)
    if version != kind.version:
        raise ValueError(
            f"it has format version {version}, this release reads version {kind.version}; update plr_jax"
        )
    if len(data) != size:
        raise ValueError(f"it has {len(data)} bytes, its header states {size}: the file is truncated or corrupt")
    (crc,) = _CRC.unpack(data[-_CRC.size :])
    if zlib.crc32(data[: -_CRC.size]) != crc:
        raise ValueError("its checksum does not match: the file is corrupt")
    return dim, variant, num_leaves, data[_HEADER.size : -_CRC.size]


def write_span(domain: Box, offset: float, step: float) -> bytes:
    """The domain, and what values are multiples of: how a file's content begins."""
    return np.concatenate([domain.lo, domain.hi]).astype("<f8").tobytes() + _SPAN.pack(offset, step)


def read_span(content: bytes, dim: int) -> tuple[Box, float, float, bytes]:
    """Domain, offset and step, and the rest of a file's content; raises ``ValueError`` if it does not begin so."""
    if len(content) < 16 * dim + _SPAN.size:
        raise ValueError("the data end too early")
    corners = np.frombuffer(content[: 16 * dim], "<f8").astype(np.float64)
    domain = Box(corners[:dim], corners[dim:])
    offset, step = _SPAN.unpack_from(content, 16 * dim)
    if not (np.isfinite(offset) and 0 < step < np.inf):
        raise ValueError(f"it states a step of {step} from {offset}")
    return domain, offset, step, content[16 * dim + _SPAN.size :]
