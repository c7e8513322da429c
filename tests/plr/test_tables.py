import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plr_helpers import cone, evaluate_by_search, leaf_by_search, random_partition, walled

from plr_jax._box import Box
from plr_jax.plr import _tables, construct
from plr_jax.plr._tables import build_tables, lookup, table_corners


def leaf_by_position(cells, x):
    """Leaf of points of the unit cube, from the cells' own integers."""
    slots = np.floor(x[:, None] * 2.0**cells.depth).astype(int)
    found = (np.minimum(slots, 2**cells.depth - 1) == cells.position).all(axis=2)
    assert (found.sum(axis=1) == 1).all()
    return found.argmax(axis=1)


@pytest.mark.parametrize("flat_bits", [20, 0], ids=["flat", "two-level"])
@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 1000), dim=st.integers(1, 4), num_splits=st.integers(1, 60))
def test_lookup_finds_the_leaf_that_holds_the_point(flat_bits, seed, dim, num_splits):
    cells = random_partition(seed, dim, num_splits)
    cells = cells if cells.depth.max() < 15 else cells[:1]
    if len(cells) == 1:
        return
    original, _tables.MAX_FLAT_BITS = _tables.MAX_FLAT_BITS, flat_bits
    try:
        tables = build_tables(
            Box(np.zeros(dim), np.ones(dim)), cells, np.zeros((len(cells), dim)), np.zeros(len(cells))
        )
    finally:
        _tables.MAX_FLAT_BITS = original
    assert (tables.blocks is None) == (flat_bits == 20 and cells.depth.max(axis=0).sum() <= 20)
    # Multiples of 2**-16 are exact, and many lie on cell borders.
    x = np.random.default_rng(seed).integers(0, 2**16 + 1, size=(200, dim)) / 2.0**16
    np.testing.assert_array_equal(lookup(tables, jnp.asarray(x, jnp.float32)), leaf_by_position(cells, x))


def test_two_levels_answer_as_a_search_through_all_leaves():
    plr = construct(lambda x: cone(x - 0.013), Box([0.0] * 4, [1.0] * 4), max_leaves=3000)
    assert plr.tables.blocks is not None
    x = np.random.default_rng(0).random((3000, 4)).astype(np.float32)
    np.testing.assert_array_equal(lookup(plr.tables, jnp.asarray(x)), leaf_by_search(plr, x))
    np.testing.assert_allclose(plr(x), evaluate_by_search(plr, x), atol=1e-5)


def test_tables_are_padded_so_that_like_plrs_share_compiled_code():
    first = construct(walled, Box((0, 0), (1, 1)), max_leaves=140)
    second = construct(lambda x: 3 * walled(x), Box((0, 0), (1, 1)), max_leaves=200)
    assert len(first.tables.intercept) == len(second.tables.intercept) == 256
    assert bin(len(first.tables.leaf_of_slot)).count("1") == 1


@given(lo=st.floats(-1e6, 1e6), width=st.floats(1e-3, 1e6))
def test_corners_are_rounded_outward(lo, width):
    domain = Box([lo], [lo + width])
    low, high = table_corners(domain)
    assert low.dtype == np.float32 and low[0] <= domain.lo[0] and high[0] >= domain.hi[0]
    assert np.nextafter(low, np.float32(np.inf))[0] > domain.lo[0]
    assert np.nextafter(high, np.float32(-np.inf))[0] < domain.hi[0]
