import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plr_helpers import chain, random_partition, three_leaves

from plr_jax.plr.file.bits import BitReader, BitWriter
from plr_jax.plr.file.tree_bits import read_leaves, tree_bits, write_tree
from plr_jax.plr.partition.tree import levels_of


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
    assert body.num_bits == tree_bits(3, 2) == 7


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 1000), dim=st.integers(1, 5), num_splits=st.integers(0, 40))
def test_what_is_read_is_what_was_written(seed, dim, num_splits):
    cells = random_partition(seed, dim, num_splits)
    body = written(cells)
    assert body.num_bits == tree_bits(num_splits + 1, dim)
    found = read_leaves(BitReader(body.to_bytes()), dim, num_splits + 1)
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
        read_leaves(BitReader(data), dim, num_leaves)
