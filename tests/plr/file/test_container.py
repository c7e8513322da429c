import struct
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plr_helpers import chain, random_partition, sealed, three_leaves

from plr_jax.geometry.box import Box
from plr_jax.plr.file.bits import BitReader, BitWriter
from plr_jax.plr.file.container import (
    HEADER_SIZE,
    Container,
    container_size,
    file_size,
    is_header,
    read_tree,
    write_tree,
)
from plr_jax.plr.partition.tree import levels_of, tree_of_levels

CONTAINER = Container(Box((-1, 0), (1, 3)), 2, 77, b"body")


def test_the_layout_by_hand():
    header = b"PLR\n" + bytes([2, 2, 2, 0]) + struct.pack("<II", 77, 16 + 32 + 4 + 4)
    content = header + struct.pack("<4d", -1, 0, 1, 3) + b"body"
    expected = content + struct.pack("<I", zlib.crc32(content))
    assert CONTAINER.to_bytes() == expected
    assert Container.from_bytes(expected) == CONTAINER
    assert len(expected) == container_size(2, 1, 31) == container_size(2, 1, 24) == file_size(expected[:HEADER_SIZE])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda data: b"PK\x03\x04" + data[4:], "does not start like a PLR file"),
        (lambda data: b"", "does not start like a PLR file"),
        (lambda data: b"PL", "does not start like a PLR file"),
        (lambda data: data[:19], "the data end too early"),
        (
            lambda data: data[:4] + b"\x09" + data[5:],
            "format version 9, this release reads versions 2 to 4; update plr_jax",
        ),
        (
            lambda data: data[:4] + b"\x01" + data[5:],
            "format version 1, this release reads versions 2 to 4; build it again",
        ),
        (
            lambda data: b"CPL\n\x01" + data[5:],
            "format version 1, this release reads versions 2 to 4; build it again",
        ),
        (lambda data: data[:-5], "it has 51 bytes, its header states 56: the file is truncated or corrupt"),
        (lambda data: data + b"\0", "truncated or corrupt"),
        (lambda data: data[:40] + b"\xaa" + data[41:], "checksum does not match"),
        (lambda data: sealed(data[:5] + b"\0" + data[6:-4]), "it states 0 axes"),
        (lambda data: sealed(data[:5] + b"\x05" + data[6:-4]), "it states 5 axes, and holds 36 bytes"),
        (lambda data: sealed(data[:16] + struct.pack("<d", float("nan")) + data[24:-4]), "finite"),
        (lambda data: sealed(data[:16] + struct.pack("<d", 1.0) + data[24:-4]), "positive width"),
    ],
)
def test_what_is_no_container_is_refused(change, message):
    with pytest.raises(ValueError, match=message):
        Container.from_bytes(change(CONTAINER.to_bytes()))


def test_periodic_axes_have_the_upper_end_first():
    container = Container(Box((-1, 0), (1, 3), periodic=(False, True)), 2, 77, b"body")
    header = b"PLR\n" + bytes([3, 2, 2, 0]) + struct.pack("<II", 77, 16 + 32 + 4 + 4)
    content = header + struct.pack("<4d", -1, 3, 1, 0) + b"body"
    expected = content + struct.pack("<I", zlib.crc32(content))
    assert container.to_bytes() == expected and is_header(expected[:HEADER_SIZE])
    assert Container.from_bytes(expected) == container
    assert container != CONTAINER


@pytest.mark.parametrize(
    ("corners", "message"),
    [
        ((-1, 0, 1, 3), "format version 3, but none of its axes is periodic"),
        ((-1, 3, 1, 3), "none of its axes is periodic"),
        ((1, 0, -1, 0), "positive width along every axis, got lo=0 and hi=0 on axis 1"),
        ((1, np.nan, -1, 0), "finite"),
        ((np.inf, 0, -1, 1), "finite"),
    ],
)
def test_corners_that_make_no_periodic_domain_are_refused(corners, message):
    data = Container(Box((-1, 0), (1, 3), periodic=(True, True)), 2, 77, b"body").to_bytes()
    with pytest.raises(ValueError, match=message):
        Container.from_bytes(sealed(data[:16] + struct.pack("<4d", *corners) + data[48:-4]))


def test_the_magic_of_continuous_plrs_came_with_version_1_alone():
    data = CONTAINER.to_bytes()
    with pytest.raises(ValueError, match="does not start like a PLR file"):
        Container.from_bytes(sealed(b"CPL\n" + data[4:-4]))


def test_every_flipped_bit_is_refused():
    data = CONTAINER.to_bytes()
    for position in range(len(data)):
        for bit in range(8):
            corrupt = bytearray(data)
            corrupt[position] ^= 1 << bit
            with pytest.raises(ValueError):
                Container.from_bytes(bytes(corrupt))


def test_every_truncation_is_refused():
    data = CONTAINER.to_bytes()
    for size in range(len(data)):
        with pytest.raises(ValueError):
            Container.from_bytes(data[:size])


def bits_of(text):
    """Bytes of a stream of bits, the least significant first."""
    return np.packbits([int(bit) for bit in text.replace(" ", "")], bitorder="little").tobytes()


def written(cells):
    body = BitWriter()
    write_tree(body, levels_of(cells)[0], cells.dim)
    return body


def test_a_tree_of_three_leaves_by_hand():
    body = written(three_leaves())
    # The root is split along axis 0; its lower half is a leaf, its upper half is split along axis 1 into two.
    assert body.to_bytes() == bits_of("1 0  01 1  00")
    assert body.num_bits == 7


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 1000), dim=st.integers(1, 5), num_splits=st.integers(0, 40))
def test_the_tree_that_is_read_is_what_was_written(seed, dim, num_splits):
    cells = random_partition(seed, dim, num_splits)
    body = written(cells)
    assert len(body.to_bytes()) == container_size(dim, num_splits + 1, 0) - container_size(dim, 1, -1)
    found = tree_of_levels(read_tree(BitReader(body.to_bytes()), dim, num_splits + 1), dim).leaves
    order = levels_of(cells)[1]
    np.testing.assert_array_equal(found.depth, cells.depth[order])
    np.testing.assert_array_equal(found.position, cells.position[order])


@pytest.mark.parametrize(
    ("data", "dim", "num_leaves", "message"),
    [
        (bits_of("1 0  01 1  00"), 2, 4, "its tree has 3 leaves, its header states 4"),
        (bits_of("1 0  01 1  00"), 2, 2**32 - 1, "its tree has 3 leaves, its header states 4294967295"),
        (bits_of("1 11"), 3, 2, "it splits axis 3 of 3"),
        (bits_of("1111"), 2, 2, "end too early"),
        (b"", 2, 1, "end too early"),
        (b"\xff" * 100, 1, 800, "end too early"),
        (written(chain([0] * 61)).to_bytes(), 1, 62, "its tree is deeper than 60"),
    ],
)
def test_what_is_no_tree_is_refused(data, dim, num_leaves, message):
    with pytest.raises(ValueError, match=message):
        read_tree(BitReader(data), dim, num_leaves)
