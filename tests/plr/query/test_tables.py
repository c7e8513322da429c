import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from plr_helpers import cone, evaluate_by_search, leaf_by_search, random_partition, walled

from plr_jax.geometry.box import Box
from plr_jax.plr import construct
from plr_jax.plr.query.tables import _pack_blocks, build_tables, lookup, table_corners


def leaf_by_position(cells, x):
    """Leaf of points of the unit cube, from the cells' own integers."""
    slots = np.floor(x[:, None] * 2.0**cells.depth).astype(int)
    found = (np.minimum(slots, 2**cells.depth - 1) == cells.position).all(axis=2)
    assert (found.sum(axis=1) == 1).all()
    return found.argmax(axis=1)


@pytest.mark.parametrize("flat_bits", [20, 0], ids=["flat", "two-level"])
@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 1000), dim=st.integers(1, 10), num_splits=st.integers(1, 60))
def test_lookup_finds_the_leaf_that_holds_the_point(flat_bits, seed, dim, num_splits):
    cells = random_partition(seed, dim, num_splits)
    bits = cells.depth.max(axis=0)
    assume(bits.max() <= 15 and bits.sum() <= 20)
    domain, planes = Box(np.zeros(dim), np.ones(dim)), np.zeros((len(cells), dim))
    tables = build_tables(domain, cells, np.column_stack([planes[:, 0], planes]), max_flat_bits=flat_bits)
    assert (tables.blocks is None) == (flat_bits == 20)
    # Multiples of 2**-16 are exact, and many lie on cell borders.
    x = np.random.default_rng(seed).integers(0, 2**16 + 1, size=(200, dim)) / 2.0**16
    np.testing.assert_array_equal(lookup(tables, jnp.asarray(x, jnp.float32)), leaf_by_position(cells, x))


def test_edges_belong_to_the_first_and_last_cells():
    cells = random_partition(0, 2, 30)
    tables = build_tables(Box((0, 0), (1, 1)), cells, np.zeros((31, 3)))
    below_one = np.nextafter(np.float32(1), np.float32(0))
    for high in (np.float32(1), below_one):
        x = np.array([[0, 0], [high, 0], [0, high], [high, high]], np.float32)
        expected = leaf_by_position(cells, np.minimum(x, 1 - 2.0**-20))
        np.testing.assert_array_equal(lookup(tables, jnp.asarray(x)), expected)


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


def test_ten_axes():
    plr = construct(lambda x: cone(x - 0.013), Box([0.0] * 10, [1.0] * 10), max_leaves=1000)
    x = np.random.default_rng(0).random((500, 10)).astype(np.float32)
    np.testing.assert_array_equal(lookup(plr.tables, jnp.asarray(x)), leaf_by_search(plr, x))


def test_two_levels_answer_as_a_search_through_all_leaves():
    plr = construct(lambda x: cone(x - 0.013), Box([0.0] * 4, [1.0] * 4), max_leaves=3000)
    assert plr.tables.blocks is not None
    x = np.random.default_rng(0).random((3000, 4)).astype(np.float32)
    np.testing.assert_array_equal(lookup(plr.tables, jnp.asarray(x)), leaf_by_search(plr, x))
    np.testing.assert_allclose(plr(x), evaluate_by_search(plr, x), atol=1e-5)


def test_tables_are_padded_so_that_like_plrs_share_compiled_code():
    first = construct(walled, Box((0, 0), (1, 1)), max_leaves=140)
    second = construct(lambda x: 3 * walled(x), Box((0, 0), (1, 1)), max_leaves=200)
    assert first.tables.planes.shape == second.tables.planes.shape == (3, 256)
    assert bin(len(first.tables.leaf_of_slot)).count("1") == 1


@given(lo=st.floats(-1e6, 1e6), width=st.floats(1e-3, 1e6))
def test_corners_are_rounded_outward(lo, width):
    domain = Box([lo], [lo + width])
    low, high = table_corners(domain)
    assert low.dtype == np.float32 and low[0] <= domain.lo[0] and high[0] >= domain.hi[0]
    assert np.nextafter(low, np.float32(np.inf))[0] > domain.lo[0]
    assert np.nextafter(high, np.float32(-np.inf))[0] < domain.hi[0]
