import struct
import zlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plr_jax.pairs.grid_pairs import MOST_BYTES, MOST_CELLS, decode_grid, encode_grid

GRID = np.random.default_rng(0).random((9, 14)) > 0.3


def sealed(data):
    """Bytes with their size and checksum put right."""
    data = data[:14] + struct.pack("<I", len(data)) + data[18:-4]
    return data + struct.pack("<I", zlib.crc32(data))


@given(st.integers(1, 12), st.integers(1, 12), st.floats(0, 1), st.sampled_from([4, 8]))
def test_what_is_written_is_read(rows, columns, share, connectivity):
    free = np.random.default_rng(rows + columns).random((rows, columns)) < share
    found, found_connectivity = decode_grid(encode_grid(free, connectivity))
    np.testing.assert_array_equal(found, free)
    assert found_connectivity == connectivity


def test_layout():
    data = encode_grid(np.array([[True], [True], [False]]), 8)
    # Cells 0 and 2 differ from the one above: two gaps, 0 and 1, in a code of order 0.
    bits = [0, 1] + [0] * 30 + [0] * 5 + [1] + [0, 1] + [0]
    body = np.packbits(bits, bitorder="little").tobytes()
    assert data[:-4] == b"PGP\n" + struct.pack("<BBIII", 1, 8, 3, 1, len(data)) + body


def test_no_file_is_larger_than_the_bound():
    free = np.indices((64, 64)).sum(axis=0) % 2 == 0
    assert len(encode_grid(free, 4)) < MOST_BYTES * free.size / MOST_CELLS + 64


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: b"", "does not start like"),
        (lambda d: b"PLR\n" + d[4:], "does not start like"),
        (lambda d: d[:20], "end too early"),
        (lambda d: d[:4] + b"\2" + d[5:], "format version 2"),
        (lambda d: d[:-1], "truncated"),
        (lambda d: d + b"\0", "its header states"),
        (lambda d: d[:-6] + bytes([d[-6] ^ 1]) + d[-5:], "checksum"),
        (lambda d: sealed(d[:5] + b"\6" + d[6:]), "connectivity of 6"),
        (lambda d: sealed(d[:6] + bytes(4) + d[10:]), "0 x 14 cells"),
        (lambda d: sealed(d[:6] + b"\xff\xff\xff\xff" + d[10:]), "not 1 to"),
        (lambda d: sealed(d[:6] + b"\2\0\0\0" + d[10:]), "names"),
        (lambda d: sealed(d[:-6] + d[-4:]), "end too early"),
        (lambda d: sealed(d[:-4] + b"\0" + d[-4:]), "more data than"),
        (lambda d: sealed(d[:18] + b"\xff\xff\xff\xff" + d[22:]), "names 4294967295 members of 126"),
    ],
)
def test_damaged_files_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        decode_grid(change(encode_grid(GRID, 4)))
