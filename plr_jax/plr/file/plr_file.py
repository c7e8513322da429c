r"""The PLR file: a few kilobytes, the same on every machine.

All numbers are little-endian. Layout of version 1:

    4s      magic, b"PLR\\n"
    u8      version
    u8      dim
    u8      bits of a center value; 32 means 32-bit floats
    u8      reserved, 0
    u32     number of leaves
    u32     size of the whole file in bytes
    f64     lower corner of the domain, dim times; then the upper corner
    f32     offset, then step; 0 and 1 for floats
    ...     bit stream, least significant bit first, the last byte filled up with zeros:
              tree, level by level from the root: for every node 1 bit (is it split?), then for every split node
                its axis in ceil(log2(dim)) bits
              for every axis, for every depth from 0 to the deepest of the leaves along it: the width of a
                half-difference in 6 bits
              center of every leaf; all bits set (floats: inf) mark a leaf without a reachable sample
              for every axis, the half-difference of every other leaf: a two's-complement number (or a float's bit
                pattern) of the width that belongs to the leaf's depth along the axis
    u32     CRC-32 of all bytes before

Leaves come in the order of the tree's traversal, lower half first. The boxes follow from the splits. In the local
coordinates of its cell, from -1 to 1 along every axis, a plane is ``offset + step * center + step * half . u``, which
rounding has moved by at most ``(1 + dim) * step / 2`` (see ``_planes.py``). Unreachable leaves are filled from their
neighbors after reading (see ``_neighbors.py``).
"""

import numpy as np
from jaxtyping import Int

from plr_jax.geometry.box import Box
from plr_jax.plr.file.bits import BitReader, BitWriter
from plr_jax.plr.file.container import FileKind, frame, framed_size, read_span, unframe, write_span
from plr_jax.plr.leaves.plane.codec import FLOAT_BITS, MAX_BITS, MIN_BITS, StoredPlanes, unreachable_code
from plr_jax.plr.partition.cells import Cells
from plr_jax.plr.partition.levels import MAX_DEPTH, Level, cells_of, levels_of

KIND = FileKind(b"PLR\n", 1, "a PLR file")
_WIDTH_BITS = 6


def encode(domain: Box, cells: Cells, planes: StoredPlanes) -> tuple[bytes, Int[np.ndarray, "leaves"]]:
    """The bytes of a file that holds these leaves, and the order in which it has them, that of the tree."""
    levels, order = levels_of(cells)
    body = BitWriter()
    write_tree(body, levels, domain.dim)
    _write_planes(body, cells.depth[order], planes[order])
    content = write_span(domain, planes.offset, planes.step) + body.to_bytes()
    return frame(KIND, domain.dim, planes.bits, len(cells), content), order


def decode(data: bytes) -> tuple[Box, Cells, StoredPlanes]:
    """Domain, leaves and planes of a file's bytes; raises ``ValueError`` saying what is wrong with them."""
    dim, bits, num_leaves, content = unframe(KIND, data)
    if dim == 0 or not (bits == FLOAT_BITS or MIN_BITS <= bits <= MAX_BITS):
        raise ValueError(f"it states {dim} axes and {bits}-bit values")
    domain, offset, step, rest = read_span(content, dim)
    body = BitReader(rest)
    cells = read_leaves(body, dim, num_leaves)
    planes = _read_planes(body, cells.depth, bits, offset, step)
    if not body.at_end():
        raise ValueError("it holds more data than its leaves need")
    return domain, cells, planes


def write_tree(body: BitWriter, levels: list[Level], dim: int) -> None:
    """Append a tree as the layout above says."""
    for level in levels:
        body.write(level.inner.astype(np.int64), 1)
        body.write(level.axis, _axis_bits(dim))


def read_leaves(body: BitReader, dim: int, num_leaves: int) -> Cells:
    """The leaves of the tree that comes next; raises ``ValueError`` if it is none with so many."""
    cells = cells_of(_read_tree(body, dim), dim)
    if len(cells) != num_leaves:
        raise ValueError(f"its tree has {len(cells)} leaves, its header states {num_leaves}")
    return cells


def _read_tree(body: BitReader, dim: int) -> list[Level]:
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
    return levels


def _write_planes(body: BitWriter, depth: Int[np.ndarray, "leaves dim"], planes: StoredPlanes) -> None:
    widths, stored = planes.widths(depth), ~planes.unreachable
    for axis_widths in widths:
        body.write(axis_widths, _WIDTH_BITS)
    body.write(planes.center, planes.bits)
    for axis, axis_widths in enumerate(widths):
        width = axis_widths[depth[stored, axis]]
        body.write(planes.half[stored, axis] & ((1 << width) - 1), width)


def _read_planes(
    body: BitReader, depth: Int[np.ndarray, "leaves dim"], bits: int, offset: float, step: float
) -> StoredPlanes:
    widths = [body.read_alike(int(deepest) + 1, _WIDTH_BITS) for deepest in depth.max(axis=0)]
    if max(axis_widths.max() for axis_widths in widths) > FLOAT_BITS:
        raise ValueError(f"it states numbers of more than {FLOAT_BITS} bits")
    center = body.read_alike(len(depth), bits)
    half = np.zeros(depth.shape, np.int64)
    stored = center != unreachable_code(bits)
    for axis, axis_widths in enumerate(widths):
        width = axis_widths[depth[stored, axis]]
        code = body.read(width)
        half[stored, axis] = code - np.where(code >= (1 << width) / 2, 1 << width, 0)
    return StoredPlanes(bits, offset, step, center, half)


def _axis_bits(dim: int) -> int:
    return (dim - 1).bit_length()


def size_in_bytes(cells: Cells, planes: StoredPlanes) -> int:
    """Size of the file that ``encode`` would give, without encoding."""
    leaves, dim = cells.depth.shape
    stored = ~planes.unreachable
    bits = 2 * leaves - 1 + (leaves - 1) * _axis_bits(dim) + leaves * planes.bits
    for axis, widths in enumerate(planes.widths(cells.depth)):
        bits += _WIDTH_BITS * len(widths) + widths[cells.depth[stored, axis]].sum()
    return framed_size(dim, int(bits))
