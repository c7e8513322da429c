"""Trees in files: by hand, read as they were written, and nothing else read as one."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plr_helpers import chain, random_partition, three_leaves

from plr_jax.plr.file.bits import BitReader, BitWriter, body_size, read_tree, write_tree
from plr_jax.plr.partition.cells import levels_of, tree_of_levels


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
    assert body_size(2, 3, 1) == 1 and body_size(2, 3, 2) == 2
    assert body_size(2, 1, 31) == 4 == body_size(2, 1, 24)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 1000), dim=st.integers(1, 20), num_splits=st.integers(0, 40))
def test_the_tree_that_is_read_is_what_was_written(seed, dim, num_splits):
    cells = random_partition(seed, dim, num_splits)
    body = written(cells)
    assert len(body.to_bytes()) == body_size(dim, num_splits + 1, 0)
    reader = BitReader(body.to_bytes())
    found = tree_of_levels(read_tree(reader, dim), dim).leaves
    assert reader.at_end()
    order = levels_of(cells)[1]
    np.testing.assert_array_equal(found.depth, cells.depth[order])
    np.testing.assert_array_equal(found.position, cells.position[order])


@pytest.mark.parametrize(
    ("data", "dim", "message"),
    [
        (bits_of("1 11"), 3, "it splits axis 3 of 3"),
        (bits_of("1111"), 2, "end too early"),
        (b"", 2, "end too early"),
        (b"\xff" * 100, 1, "end too early"),
        (written(chain([0] * 61)).to_bytes(), 1, "its tree is deeper than 60"),
    ],
)
def test_what_is_no_tree_is_refused(data, dim, message):
    with pytest.raises(ValueError, match=message):
        read_tree(BitReader(data), dim)
