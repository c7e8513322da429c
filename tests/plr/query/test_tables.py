import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plr_helpers import UNIT, random_partition, tables_of_numbers, walled

from plr_jax import Box, construct
from plr_jax.plr.frame import byte_class, max_axis_depth, max_entries, rows_of_class, slot_bits_of_rows, table_corners
from plr_jax.plr.tables import pack_blocks
from plr_jax.plr.tree import Cells


def shapes(plr):
    """Shape and type of every array that a query reads."""
    tables = plr.tables
    assert tables.blocks is None
    return [(array.shape, array.dtype) for array in (tables.frame, tables.bits, tables.leaf_of_slot, tables.numbers)]


@pytest.mark.parametrize(("dim", "num_words"), [(1, 1), (5, 1), (6, 2), (12, 2), (20, 3)])
def test_axes_that_do_not_fit_the_first_word_come_in_more(dim, num_words):
    rng = np.random.default_rng(dim)
    shape = rng.integers(0, 8, size=(50, dim))
    offset = np.append(rng.integers(0, 2**17, size=50), 2**17 - 1)
    shift = rng.integers(0, 23, size=dim)
    blocks = pack_blocks(shape, offset, shift)
    np.testing.assert_array_equal(blocks.shift, shift)
    assert len(blocks.words) == num_words and sum(blocks.axes) == dim
    words = [np.asarray(word).astype(int) for word in blocks.words]
    fields = [(word >> (3 * slot)) & 7 for word, axes in zip(words, blocks.axes, strict=True) for slot in range(axes)]
    np.testing.assert_array_equal(np.stack(fields, axis=1), shape)
    np.testing.assert_array_equal(words[0] >> (3 * blocks.axes[0]), offset[:-1])


def test_tables_of_a_class_have_one_shape():
    """The class of 2 KB: 2**14 slots, and 1,024 planes of at least two bytes."""
    first = construct(walled, UNIT, max_leaves=100)
    second = construct(lambda x: 3 * walled(x), UNIT, max_leaves=130)
    assert 1024 < first.num_bytes < second.num_bytes <= 2048
    assert shapes(first) == shapes(second)
    assert first.tables.numbers.shape == (3, 1024) and first.tables.leaf_of_slot.shape == (2**14,)


def test_beyond_32_kilobytes_tables_are_as_large_as_their_leaves_need():
    """Leaves are counted in 16 bits while they can be."""
    small, large = (tables_of_numbers(random_partition(0, 2, 3), n) for n in (2**15, 2**15 + 1))
    assert small.numbers.shape == (3, 2**14) and large.numbers.shape == (3, 4)
    for rows, kind in ((2**8, np.uint16), (2**9, np.uint32)):
        position = np.stack(np.meshgrid(np.arange(rows), np.arange(2**8), indexing="ij"), axis=-1).reshape(-1, 2)
        cells = Cells(np.tile([rows.bit_length() - 1, 8], (len(position), 1)), position)
        assert tables_of_numbers(cells, 2**20).leaf_of_slot.dtype == kind


@given(lo=st.floats(-1e6, 1e6), width=st.floats(1e-3, 1e6))
def test_corners_are_rounded_outward(lo, width):
    domain = Box([lo], [lo + width])
    low, high = table_corners(domain)
    assert low.dtype == np.float32 and low[0] <= domain.lo[0] and high[0] >= domain.hi[0]
    assert np.nextafter(low, np.float32(np.inf))[0] > domain.lo[0]
    assert np.nextafter(high, np.float32(-np.inf))[0] < domain.hi[0]


def test_a_class_is_the_power_of_two_that_holds_the_bytes_and_has_room_for_as_many_leaves_as_a_file_can_hold():
    sizes = (1, 256, 257, 2048, 2049, 4096, 10**6)
    assert [byte_class(num_bytes) for num_bytes in sizes] == [8, 8, 9, 11, 12, 12, 20]
    assert [rows_of_class(11, least_bytes) for least_bytes in (2, 1, 0.5)] == [1024, 2048, 4096]
    rows = (128, 1024, 1025, 4096, 4097, 2**30)
    assert [slot_bits_of_rows(number) for number in rows] == [14, 14, 16, 16, 18, 18]


@pytest.mark.parametrize("dim", [1, 2])
@pytest.mark.parametrize("least_bytes", [1, 2])
def test_on_a_line_and_in_the_plane_the_cells_of_a_class_fit_its_table(dim, least_bytes):
    for of_class in range(8, 14 + least_bytes):
        rows = rows_of_class(of_class, least_bytes)
        assert dim * max_axis_depth(dim, of_class, least_bytes, False) <= slot_bits_of_rows(rows)


@pytest.mark.parametrize(("dim", "expected"), [(1, [14, 16, 18, 18]), (2, [13, 13, 14, 14]), (3, [9] * 4)])
def test_deep_trees_are_as_deep_in_the_smallest_files(dim, expected):
    assert [max_axis_depth(dim, of_class, 0.5, True) for of_class in (8, 11, 14, None)] == expected


@pytest.mark.parametrize("dim", [1, 2, 3, 5, 8, 28, 50])
def test_more_bytes_never_mean_larger_cells(dim):
    depths = [max_axis_depth(dim, of_class, 2, False) for of_class in (*range(8, 30), None)]
    assert depths == sorted(depths) and depths[0] >= 1 and depths[-1] <= 18


def test_what_a_reader_allocates_grows_with_the_file_up_to_an_end():
    entries = [max_entries(1 << bits) for bits in range(8, 40)]
    assert entries == sorted(entries)
    assert entries[0] == 2**20 and entries[-1] == 2**27 and max_entries(2**13) == 2**22
