"""Tables and lookups: the leaf that contains a point, against the cells' own integers."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from plr_helpers import UNIT, chain, leaf_by_position, random_partition, tables_of_numbers

from plr_jax import Box
from plr_jax.plr import Plane, query, tables
from plr_jax.plr.sizes import byte_class, max_axis_depth, max_entries, rows_of_class, slot_bits_of_rows
from plr_jax.plr.tables import build_pages, build_tables
from plr_jax.plr.tree import Cells


def test_table_sizes_and_types_of_leaf_indices():
    """Beyond 32 kilobytes, tables are as large as their leaves need."""
    small, large = (tables_of_numbers(random_partition(0, 2, 3), n) for n in (2**15, 2**15 + 1))
    assert small.leaf_parameters.shape == (3, 2**14) and large.leaf_parameters.shape == (3, 4)
    for rows, kind in ((2**8, np.uint16), (2**9, np.uint32)):
        position = np.stack(np.meshgrid(np.arange(rows), np.arange(2**8), indexing="ij"), axis=-1).reshape(-1, 2)
        cells = Cells(np.tile([rows.bit_length() - 1, 8], (len(position), 1)), position)
        assert tables_of_numbers(cells, 2**20).leaf_of_slot.dtype == kind


def test_size_class_is_the_power_of_two_that_holds_the_bytes():
    sizes = (1, 256, 257, 2048, 2049, 4096, 10**6)
    assert [byte_class(num_bytes) for num_bytes in sizes] == [8, 8, 9, 11, 12, 12, 20]
    assert [rows_of_class(11, least_bytes) for least_bytes in (2, 1, 0.5)] == [1024, 2048, 4096]
    rows = (128, 1024, 1025, 4096, 4097, 2**30)
    assert [slot_bits_of_rows(number) for number in rows] == [14, 14, 16, 16, 18, 18]


@pytest.mark.parametrize("dim", [1, 2])
@pytest.mark.parametrize("least_bytes", [1, 2])
def test_deepest_cells_of_a_size_class_fit_its_table(dim, least_bytes):
    for of_class in range(8, 14 + least_bytes):
        rows = rows_of_class(of_class, least_bytes)
        assert dim * max_axis_depth(dim, of_class, least_bytes, False) <= slot_bits_of_rows(rows)


@pytest.mark.parametrize(("dim", "expected"), [(1, [14, 16, 18, 18]), (2, [14] * 4), (3, [9] * 4)])
def test_deep_trees_have_the_depth_limit_of_their_dimension(dim, expected):
    assert [max_axis_depth(dim, of_class, 0.5, True) for of_class in (8, 11, 14, None)] == expected


def test_depth_limits_grow_with_bytes():
    for dim in (1, 2, 3, 5, 8, 28, 50):
        depths = [max_axis_depth(dim, of_class, 2, False) for of_class in (*range(8, 30), None)]
        assert depths == sorted(depths) and depths[0] >= 1 and depths[-1] <= 18


def test_allocation_limits_grow_with_the_file_up_to_a_maximum():
    entries = [max_entries(1 << bits) for bits in range(8, 40)]
    assert entries == sorted(entries)
    assert entries[0] == 2**20 and entries[-1] == 2**27 and max_entries(2**13) == 2**22


def lookup(tables, x):
    """Return the leaf of each point, operation by operation: each shape of tables would take a program."""
    return query.lookup(tables, jnp.asarray(x, jnp.float32))


def evaluate_tables(tables, x):
    return query.evaluate_tables(tables, jnp.asarray(x, jnp.float32))


@pytest.mark.parametrize("kind", ["flat", "blocks", "pages"])
@given(seed=st.integers(0, 1000), dim=st.sampled_from([1, 2, 4, 10]), num_splits=st.integers(0, 60))
def test_lookup_finds_the_leaf_that_contains_the_point(kind, seed, dim, num_splits):
    cells = random_partition(seed, dim, num_splits)
    bits = cells.depth.max(axis=0)
    assume(bits.max() <= 15 and bits.sum() <= 20 and (kind == "flat" or num_splits) and (kind != "pages" or dim < 10))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tables, "slot_bits_of_rows", lambda rows: 0 if kind == "blocks" else 20)
        found = tables_of(cells) if kind == "pages" else tables_of_numbers(cells, 40_000)
    assert (found.blocks is not None, found.pages is not None) == (kind == "blocks", kind == "pages")
    assert_finds_leaves(found, cells, seed)


def test_answers_do_not_depend_on_the_layout_of_parameters(monkeypatch):
    """Large tables store all parameters of a leaf side by side."""
    cells = random_partition(0, 2, 40)
    numbers = np.random.default_rng(0).normal(size=(41, 3))
    small = build_tables(UNIT, cells, numbers, Plane(), 1000)
    monkeypatch.setattr(tables, "_MAX_COLUMN_BYTES", 0)
    large = build_tables(UNIT, cells, numbers, Plane(), 1000)
    assert small.leaf_parameters.ndim == 2 and large.leaf_parameters.ndim == 1
    x = np.random.default_rng(0).random((800, 2)).astype(np.float32)  # as many as elsewhere, which compiles less
    np.testing.assert_array_equal(evaluate_tables(large, x), evaluate_tables(small, x))
    np.testing.assert_array_equal(query.evaluate_points(large, x), query.evaluate_points(small, x))


@dataclass(frozen=True)
class DeepPlane(Plane):
    """Planes as of a leaf model whose trees are deep."""

    least_bytes = 0.5
    has_deep_trees = True


def tables_of(cells, num_bytes=512):
    return tables_of_numbers(cells, num_bytes, DeepPlane())


def partition_around_corners(seed, num_leaves=500, max_axis_depth=13):
    """Return leaves of a plane that is split again and again around a few random points."""
    rng = np.random.default_rng(seed)
    corners, leaves = rng.random((12, 2)), Cells.root(2)
    while len(leaves) < num_leaves:
        place = np.floor(corners[:, None] * 2.0**leaves.depth) == leaves.position
        of_corner = place.all(axis=2).argmax(axis=1)
        chosen = of_corner[rng.integers(len(corners))] if rng.random() < 0.7 else rng.integers(len(leaves))
        axis = np.argmin(leaves.depth[chosen])
        if leaves.depth[chosen, axis] < max_axis_depth:
            halves = leaves[[chosen]].split(np.array([axis]))
            leaves = leaves[:chosen].append(halves, leaves[chosen + 1 :])
    return leaves


def assert_finds_leaves(tables, cells, seed=0):
    """Compare answers at centers of leaves, and at multiples of 2**-16, which are exact; many lie on cell borders."""
    x = np.random.default_rng(seed).integers(0, 2**16 + 1, size=(800, cells.dim)) / 2.0**16
    x[: min(500, len(cells))] = ((cells.position + 0.5) * 2.0**-cells.depth)[:500]
    expected = leaf_by_position(cells, x)
    np.testing.assert_array_equal(lookup(tables, x), expected)
    np.testing.assert_array_equal(evaluate_tables(tables, x), expected)


@pytest.mark.parametrize(("max_axis_depth", "num_words", "num_slots"), [(10, 2**12, 2**13), (13, 2**16, 2**14)])
def test_pages_have_the_shape_of_their_depth(max_axis_depth, num_words, num_slots):
    cells = partition_around_corners(0, max_axis_depth=max_axis_depth)
    assert (cells.depth.max(axis=0) == max_axis_depth).all()
    tables = tables_of(cells)
    assert tables.blocks is None and tables.pages is not None and tables.pages.words.shape == (num_words,)
    assert tables.leaf_of_slot.shape == (num_slots,) and tables.leaf_parameters.shape == (3, num_slots)
    assert_finds_leaves(tables, cells)
    rng, domain = np.random.default_rng(0), Box((-3, 1), (5.3, 2))
    numbers = rng.normal(size=(len(cells), 3))
    paged, other = (build_tables(domain, cells, numbers, leaf, 512) for leaf in (DeepPlane(), Plane()))
    assert paged.pages is not None and other.pages is None
    x = rng.uniform((-3.1, 0.9), (5.4, 2.1), size=(5000, 2)).astype(np.float32)
    np.testing.assert_array_equal(query.evaluate_points(paged, x), query.evaluate_points(other, x))


def test_blocks_are_as_coarse_as_the_slots_allow():
    cells = partition_around_corners(0)
    paged = [build_pages(cells, slots, 3) for slots in ([2**16], [2**14], [600])]
    assert [found and len(found[0].words) for found in paged] == [2**14, 2**16, None]


def test_leaves_of_the_greatest_depth_are_found_by_pages_and_blocks():
    for axes in ([0] * 23, [0] * 22 + [1] * 6, [0, 1] * 14, [0, 1, 2] * 9, [*range(20)]):
        cells = chain(axes)
        x = np.ldexp(cells.position + 0.25, -cells.depth)  # the finest are one last bit wide, whose middle is rounded
        for paged_or_not in (tables_of(cells, 1000), tables_of_numbers(cells, 1000)):
            found = jax.jit(query.lookup)(paged_or_not, x.astype(np.float32))
            np.testing.assert_array_equal(found, np.arange(len(cells)))


def test_large_trees_and_shallow_models_have_no_pages():
    cells = random_partition(0, 2, 20)
    small, large = (tables_of(cells, num_bytes) for num_bytes in (2**13, 2**20))
    assert small.leaf_of_slot.shape == (2**16,) and large.leaf_of_slot.shape == (2**13,)
    position = np.stack(np.meshgrid(*2 * [np.arange(2**8)], indexing="ij"), axis=-1).reshape(-1, 2)
    assert tables_of(Cells(np.full_like(position, 8), position), 2**16).pages is None
    assert tables_of_numbers(chain([0, 1] * 7), 512).pages is None
    assert build_tables(UNIT, chain([0, 1]), np.zeros((3, 3)), DeepPlane(), 200).pages is not None
    with pytest.raises(ValueError, match=r"too deep for a query's tables: \[22, 22\] splits"):
        tables_of(chain([0] * 22 + [1] * 22), 200)
