import struct

import numpy as np
import pytest
from plr_helpers import sealed

from plr_jax import Box, ReedsShepp, construct, from_bytes
from plr_jax.plr.file.domain import ByteReader, folding_to_bytes, read_folding
from plr_jax.plr.folding.choice import folding_of

WINDOW = Box((-2, -2, -np.pi), (2, 2, np.pi), periodic=(False, False, True))
START = 4 + 48  # of the folding in a file: after the header and the domain


@pytest.mark.parametrize("heading", [0.0, 0.4])
def test_a_folding_is_read_as_it_was_written(heading):
    folding = folding_of(ReedsShepp((0.1, 0.2, heading), 1), WINDOW)
    reader = ByteReader(folding_to_bytes(folding) + b"rest")
    again = read_folding(reader, WINDOW)
    assert reader.take(4) == b"rest" and folding_to_bytes(again) == folding_to_bytes(folding)
    assert (again.mirrors, again.radial, again.box) == (folding.mirrors, folding.radial, folding.box)


@pytest.mark.parametrize(
    ("at", "change", "message"),
    [
        (0, struct.pack("<d", np.nan), "not finite"),
        (0, struct.pack("<d", 7.0), "does not cut the domain"),
        (24, b"\2", "mark of 2"),
        (25, b"\377", "end too early"),
        (26, b"\0\0\1", "no axis of its own"),
        (32, b"\0\0\1", "length along a periodic axis"),
    ],
)
def test_files_of_foldings_that_nobody_writes_are_refused(at, change, message):
    data = construct(ReedsShepp((0, 0, 0), 1), WINDOW, max_leaves=4).to_bytes()
    assert data[3] >> 5 & 1
    content = data[: START + at] + change + data[START + at + len(change) : -4]
    with pytest.raises(ValueError, match=message):
        from_bytes(sealed(content))


def test_axes_that_are_not_orthogonal_are_refused():
    data = construct(ReedsShepp((0, 0, 0.4), 1), WINDOW, max_leaves=4).to_bytes()
    at = START + 25
    with pytest.raises(ValueError, match="not orthogonal"):
        from_bytes(sealed(data[:at] + struct.pack("<d", 0.5) + data[at + 8 : -4]))


def test_folded_points_with_sources_are_refused():
    data = construct(ReedsShepp((0, 0, 0), 1), WINDOW, max_leaves=4).to_bytes()
    with pytest.raises(ValueError, match="its points are folded, but its leaves have sources"):
        from_bytes(sealed(data[:3] + bytes([data[3] | 3]) + data[4:-4]))
