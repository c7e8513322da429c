r"""The file of the distances between all pairs of cells of a grid: the grid, from which all else follows.

All numbers are little-endian:

    4s      magic, b"PGP\n"
    u8      version, 1
    u8      connectivity, 4 or 8
    u32     number of rows
    u32     number of columns
    u32     size of the whole file in bytes
    ...     bit stream, see ``plr/file/bits.py``: the set of the cells that differ from the one above, in row-major
            order; above the first row all are blocked
    u32     CRC-32 of all bytes before
"""

import struct
import zlib

import numpy as np
from jaxtyping import Bool

from plr_jax.plr.file.bits import BitReader, BitWriter
from plr_jax.plr.grid_pairs.lengths import CONNECTIVITIES

MOST_CELLS = 2**22
"""Cells of the largest grid."""

_MAGIC, _VERSION = b"PGP\n", 1
_HEADER, _CRC = struct.Struct("<4sBBIII"), struct.Struct("<I")
MOST_BYTES = _HEADER.size + _CRC.size + 4 * MOST_CELLS
"""More than any file has: a cell that differs from the one above takes less than 4 bytes."""


def encode_grid(free: Bool[np.ndarray, "rows columns"], connectivity: int) -> bytes:
    """The bytes of a grid's file."""
    body = BitWriter().write_set(np.diff(free, axis=0, prepend=False).ravel()).to_bytes()
    size = _HEADER.size + len(body) + _CRC.size
    data = _HEADER.pack(_MAGIC, _VERSION, connectivity, *free.shape, size) + body
    return data + _CRC.pack(zlib.crc32(data))


def decode_grid(data: bytes) -> tuple[Bool[np.ndarray, "rows columns"], int]:
    """The cells and the connectivity that a file's bytes hold; raises ``ValueError`` saying what is wrong."""
    if not data.startswith(_MAGIC):
        raise ValueError("it does not start like a file of pairs of a grid")
    if len(data) < _HEADER.size + _CRC.size:
        raise ValueError("the data end too early")
    _, version, connectivity, rows, columns, size = _HEADER.unpack_from(data)
    if version != _VERSION:
        raise ValueError(f"it has format version {version}, this release reads version {_VERSION}")
    if len(data) != size:
        raise ValueError(f"it has {len(data)} bytes, its header states {size}: the file is truncated or corrupt")
    if zlib.crc32(data[: -_CRC.size]) != _CRC.unpack(data[-_CRC.size :])[0]:
        raise ValueError("its checksum does not match: the file is corrupt")
    if connectivity not in CONNECTIVITIES:
        raise ValueError(f"it states a connectivity of {connectivity}, not 4 or 8")
    if not 0 < rows * columns <= MOST_CELLS:
        raise ValueError(f"it states {rows} x {columns} cells, not 1 to {MOST_CELLS}")
    body = BitReader(data[_HEADER.size : -_CRC.size])
    differs = body.read_set(rows * columns).reshape(rows, columns)
    if not body.at_end():
        raise ValueError("it holds more data than its cells need")
    return np.logical_xor.accumulate(differs, axis=0), connectivity
