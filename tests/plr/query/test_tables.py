import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plr_helpers import UNIT, chain, random_partition, walled

from plr_jax import VisibilityGraph, scenes
from plr_jax.geometry.box import Box
from plr_jax.plr import Plane, construct
from plr_jax.plr.partition.cells import Cells
from plr_jax.plr.query.frame import table_corners
from plr_jax.plr.query.grid import byte_class, max_axis_depth, max_entries, rows_of_class, slot_bits_of_rows
from plr_jax.plr.query.pages import pack_blocks
from plr_jax.plr.query.tables import build_tables


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


@pytest.mark.parametrize(
    ("leaf", "num_goals", "limits"),
    [
        ("plane", 12, {"max_leaves": 400}),
        ("plane", 4, {"max_bytes": 2048}),
        ("continuous", 2, {"max_leaves": 400}),  # each takes as long as several with planes
        ("continuous", 2, {"max_bytes": 2048}),
    ],
)
def test_all_goals_of_a_maze_have_tables_of_one_shape(leaf, num_goals, limits):
    workspace = scenes.maze().workspace
    oracles = [VisibilityGraph(workspace, goal) for goal in workspace.sample_free(12, seed=0)[:num_goals]]
    plrs = [construct(oracle, workspace.bounds, leaf=leaf, num_samples=24, **limits) for oracle in oracles]
    assert all(shapes(plr) == shapes(plrs[0]) for plr in plrs[1:])


def test_tables_larger_than_the_file_allows_are_refused():
    cells = chain([0] * 22 + [1] * 22)
    with pytest.raises(ValueError, match=r"too deep for a query's tables: \[22, 22\] splits .* Lower max_depth"):
        build_tables(UNIT, cells, np.zeros((45, 3)), Plane(), 200)


def test_beyond_32_kilobytes_tables_are_as_large_as_their_leaves_need():
    cells = random_partition(0, 2, 3)
    small, large = (build_tables(UNIT, cells, np.zeros((4, 3)), Plane(), n) for n in (2**15, 2**15 + 1))
    assert small.numbers.shape == (3, 2**14) and large.numbers.shape == (3, 4)


def test_leaves_are_counted_in_16_bits_while_they_can_be():
    for rows, kind in ((2**8, np.uint16), (2**9, np.uint32)):
        position = np.stack(np.meshgrid(np.arange(rows), np.arange(2**8), indexing="ij"), axis=-1).reshape(-1, 2)
        cells = Cells(np.tile([rows.bit_length() - 1, 8], (len(position), 1)), position)
        assert build_tables(UNIT, cells, np.zeros((len(cells), 3)), Plane(), 2**20).leaf_of_slot.dtype == kind


@settings(max_examples=50, deadline=None)
@given(lo=st.floats(-1e6, 1e6), width=st.floats(1e-3, 1e6))
def test_corners_are_rounded_outward(lo, width):
    domain = Box([lo], [lo + width])
    low, high = table_corners(domain)
    assert low.dtype == np.float32 and low[0] <= domain.lo[0] and high[0] >= domain.hi[0]
    assert np.nextafter(low, np.float32(np.inf))[0] > domain.lo[0]
    assert np.nextafter(high, np.float32(-np.inf))[0] < domain.hi[0]


@pytest.mark.parametrize(
    ("num_bytes", "expected"), [(1, 8), (256, 8), (257, 9), (2048, 11), (2049, 12), (4096, 12), (10**6, 20)]
)
def test_a_class_is_the_power_of_two_that_holds_the_bytes(num_bytes, expected):
    assert byte_class(num_bytes) == expected


def test_tables_have_room_for_as_many_leaves_as_a_file_can_hold():
    assert rows_of_class(11, 2) == 1024
    assert rows_of_class(11, 1) == 2048
    assert rows_of_class(11, 0.5) == 4096


@pytest.mark.parametrize(
    ("rows", "expected"), [(128, 14), (1024, 14), (1025, 16), (4096, 16), (4097, 18), (2**30, 18)]
)
def test_slots_grow_with_the_leaves(rows, expected):
    assert slot_bits_of_rows(rows) == expected


@pytest.mark.parametrize("dim", [1, 2])
@pytest.mark.parametrize(
    ("least_bytes", "of_class"),
    [(1, of_class) for of_class in range(8, 15)] + [(2, of_class) for of_class in range(8, 16)],
)
def test_on_a_line_and_in_the_plane_the_cells_of_a_class_fit_its_table(dim, least_bytes, of_class):
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
    assert entries[0] == 2**20 and entries[-1] == 2**27
    assert max_entries(2**13) == 2**22
