import struct
import zlib

import pytest
from plr_helpers import sealed

from plr_jax.geometry.box import Box
from plr_jax.plr.file.container import HEADER_SIZE, Container, container_size, file_size

CONTAINER = Container(Box((-1, 0), (1, 3)), 2, 77, b"body")


def test_the_layout_by_hand():
    header = b"PLR\n" + bytes([2, 2, 2, 0]) + struct.pack("<II", 77, 16 + 32 + 4 + 4)
    content = header + struct.pack("<4d", -1, 0, 1, 3) + b"body"
    expected = content + struct.pack("<I", zlib.crc32(content))
    assert CONTAINER.to_bytes() == expected
    assert Container.from_bytes(expected) == CONTAINER
    assert len(expected) == container_size(2, 32) == container_size(2, 25) == file_size(expected[:HEADER_SIZE])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda data: b"PK\x03\x04" + data[4:], "does not start like a PLR file"),
        (lambda data: b"", "does not start like a PLR file"),
        (lambda data: b"PL", "does not start like a PLR file"),
        (lambda data: data[:19], "the data end too early"),
        (
            lambda data: data[:4] + b"\x09" + data[5:],
            "format version 9, this release reads version 2; update plr_jax",
        ),
        (
            lambda data: data[:4] + b"\x01" + data[5:],
            "format version 1, this release reads version 2; build it again",
        ),
        (lambda data: b"CPL\n\x01" + data[5:], "format version 1, this release reads version 2; build it again"),
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
