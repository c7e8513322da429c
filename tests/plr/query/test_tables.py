import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plr_helpers import UNIT, chain, random_partition, walled

from plr_jax import VisibilityGraph, scenes
from plr_jax.geometry.box import Box
from plr_jax.plr import Plane, construct
from plr_jax.plr.query.tables import _pack_blocks, build_tables, check_depth, table_corners


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
    blocks = _pack_blocks(shape, offset, shift)
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


def test_cells_too_deep_for_a_query_are_refused():
    check_depth(chain([0] * 23))
    with pytest.raises(ValueError, match="a cell is split 24 times along one axis; a query resolves 23"):
        check_depth(chain([0] * 24))


def test_tables_larger_than_the_file_allows_are_refused():
    cells = chain([0] * 22 + [1] * 22)
    with pytest.raises(ValueError, match=r"too deep for a query's tables: \[22, 22\] splits .* Lower max_depth"):
        build_tables(UNIT, cells, np.zeros((45, 3)), Plane(), 200)


def test_room_for_more_leaves_than_16_bits_count():
    cells = random_partition(0, 2, 3)
    assert build_tables(UNIT, cells, np.zeros((4, 3)), Plane(), 2**17).leaf_of_slot.dtype == np.uint16
    assert build_tables(UNIT, cells, np.zeros((4, 3)), Plane(), 2**17 + 1).leaf_of_slot.dtype == np.uint32


@settings(max_examples=50, deadline=None)
@given(lo=st.floats(-1e6, 1e6), width=st.floats(1e-3, 1e6))
def test_corners_are_rounded_outward(lo, width):
    domain = Box([lo], [lo + width])
    low, high = table_corners(domain)
    assert low.dtype == np.float32 and low[0] <= domain.lo[0] and high[0] >= domain.hi[0]
    assert np.nextafter(low, np.float32(np.inf))[0] > domain.lo[0]
    assert np.nextafter(high, np.float32(-np.inf))[0] < domain.hi[0]
