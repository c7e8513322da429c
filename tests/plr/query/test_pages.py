from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plr_helpers import UNIT, chain, leaf_by_position, random_partition, tables_of_numbers

from plr_jax import Box
from plr_jax.plr import Plane
from plr_jax.plr import query as lookup_module
from plr_jax.plr.tables import _place_pages, build_pages, build_tables
from plr_jax.plr.tree import Cells

lookup, evaluate_tables = map(jax.jit, (lookup_module.lookup, lookup_module.evaluate_tables))


@dataclass(frozen=True)
class DeepPlane(Plane):
    """Planes as of a leaf model whose trees are deep."""

    least_bytes = 0.5
    has_deep_trees = True


def tables_of(cells, num_bytes=512):
    return tables_of_numbers(cells, num_bytes, DeepPlane())


def partition_around_corners(seed, num_leaves=500, max_axis_depth=13):
    """Leaves of the plane that are split, one after another, where they hold some of a few random points."""
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
    """In leaves' centers and at multiples of 2**-16, which are exact; many lie on cell borders."""
    x = np.random.default_rng(seed).integers(0, 2**16 + 1, size=(800, cells.dim)) / 2.0**16
    x[: min(500, len(cells))] = ((cells.position + 0.5) * 2.0**-cells.depth)[:500]
    expected = leaf_by_position(cells, x)
    np.testing.assert_array_equal(lookup(tables, jnp.asarray(x, jnp.float32)), expected)
    np.testing.assert_array_equal(evaluate_tables(tables, jnp.asarray(x, jnp.float32)), expected)


@settings(max_examples=20)
@given(seed=st.integers(0, 1000), dim=st.sampled_from([1, 2, 3, 4]), num_splits=st.integers(0, 100))
def test_pages_lead_to_the_leaf_that_holds_the_point(seed, dim, num_splits):
    cells = random_partition(seed, dim, num_splits)
    tables = tables_of(cells)
    assert tables.pages is not None
    assert_finds_leaves(tables, cells, seed)


@pytest.mark.parametrize(("max_axis_depth", "num_words", "num_slots"), [(10, 2**12, 2**13), (13, 2**14, 2**16)])
def test_small_trees_as_deep_as_one_another_have_pages_of_one_shape(max_axis_depth, num_words, num_slots):
    """They change no answer."""
    for seed in range(4):
        cells = partition_around_corners(seed, max_axis_depth=max_axis_depth)
        assert (cells.depth.max(axis=0) == max_axis_depth).all()
        tables = tables_of(cells)
        assert tables.blocks is None and tables.pages is not None and tables.pages.words.shape == (num_words,)
        assert tables.leaf_of_slot.shape == (num_slots,) and tables.numbers.shape == (3, num_slots)
        assert_finds_leaves(tables, cells, seed)
        rng, domain = np.random.default_rng(seed), Box((-3, 1), (5.3, 2))
        numbers = rng.normal(size=(len(cells), 3))
        paged, other = (build_tables(domain, cells, numbers, leaf, 512) for leaf in (DeepPlane(), Plane()))
        assert paged.pages is not None and other.pages is None
        x = jnp.asarray(rng.uniform((-3.1, 0.9), (5.4, 2.1), size=(5000, 2)), jnp.float32)
        np.testing.assert_array_equal(evaluate_tables(paged, x), evaluate_tables(other, x))


@settings(max_examples=30)
@given(seed=st.integers(0, 1000), dim=st.sampled_from([1, 2, 3]))
def test_pages_never_share_a_slot(seed, dim):
    rng = np.random.default_rng(seed)
    page_bits = rng.integers(0, 5, size=dim)
    shape = rng.integers(0, page_bits + 1, size=(rng.integers(1, 40), dim))
    start, end = _place_pages(shape, page_bits, 7)
    below = [page_bits[axis + 1 :].sum() for axis in range(dim)]
    used = []
    for first, page in zip(start, shape, strict=True):
        if page.any():
            axes = [np.arange(2**bits) << (most - bits) for bits, most in zip(page, page_bits, strict=True)]
            grid = np.meshgrid(*[axis << right for axis, right in zip(axes, below, strict=True)])
            used.append(first + np.sum(grid, axis=0).ravel())
        else:
            assert first == 0
    used = np.concatenate([*used, []])
    assert len(np.unique(used)) == len(used)
    assert used.min(initial=7) >= 7 and used.max(initial=0) < max(end, 1)


def test_pages_fill_the_gaps_of_others():
    """A grid of 4 by 4 holds pages of 2 by 4, 2 by 2 and twice 1 by 2."""
    shape = np.array([[0, 1], [1, 2], [0, 1], [1, 1]])
    assert _place_pages(shape, np.array([2, 2]), 0)[1] == 16


def test_blocks_are_as_coarse_as_the_slots_allow():
    cells = partition_around_corners(0)
    paged = [build_pages(cells, slots) for slots in (2**16, 2**14, 600)]
    assert [found and len(found.pages.words) for found in paged] == [2**14, 2**16, None]


@pytest.mark.parametrize("axes", [[0] * 23, [0] * 22 + [1] * 6, [0, 1] * 14, [0, 1, 2] * 9, [*range(20)]])
def test_leaves_of_any_depth_are_found(axes):
    cells = chain(axes)
    x = np.ldexp(cells.position + 0.25, -cells.depth)
    np.testing.assert_array_equal(lookup(tables_of(cells, 1000), jnp.asarray(x, jnp.float32)), np.arange(len(cells)))


def test_large_trees_have_no_pages_nor_have_models_without_deep_trees():
    cells = random_partition(0, 2, 20)
    small, large = (tables_of(cells, num_bytes) for num_bytes in (2**13, 2**20))
    assert small.leaf_of_slot.shape == (2**16,) and large.leaf_of_slot.shape == (2**13,)
    position = np.stack(np.meshgrid(*2 * [np.arange(2**8)], indexing="ij"), axis=-1).reshape(-1, 2)
    assert tables_of(Cells(np.full_like(position, 8), position), 2**16).pages is None
    assert tables_of_numbers(chain([0, 1] * 7), 512).pages is None
    assert build_tables(UNIT, chain([0, 1]), np.zeros((3, 3)), DeepPlane(), 200).pages is not None
    with pytest.raises(ValueError, match=r"too deep for a query's tables: \[22, 22\] splits"):
        tables_of(chain([0] * 22 + [1] * 22), 200)
