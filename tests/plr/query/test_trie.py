"""One table of several partitions, against the cells' own integers."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from plr_helpers import chain, leaf_by_position, random_partition, tables_of_numbers

from plr_jax.plr import query as lookup
from plr_jax.plr._stack import build_trie, can_be_in_trie, trie_levels
from plr_jax.plr.tree import Cells

find_row = jax.jit(lookup.find_row)
POINTS = 600


def levels_of_all(partitions):
    return trie_levels(np.max([cells.depth.max(axis=0) for cells in partitions], axis=0))


def assert_finds_rows(partitions, rows, seed=0):
    """In leaves' centers and at multiples of 2**-16, many of which lie on cell borders; of every partition."""
    dim, levels = partitions[0].dim, levels_of_all(partitions)
    assert all(can_be_in_trie(cells, levels) for cells in partitions)
    trie = build_trie(partitions, rows, levels)
    tables = tables_of_numbers(Cells.root(dim), 100)
    for number, (cells, row) in enumerate(zip(partitions, rows, strict=True)):
        x = np.random.default_rng(seed).integers(0, 2**16 + 1, size=(POINTS, dim)) / 2.0**16
        x[: min(len(cells), 400)] = ((cells.position + 0.5) * 2.0**-cells.depth)[:400]
        which = jnp.full(len(x), number, jnp.uint32)
        found = find_row(replace(tables, trie=trie.of(which, int(levels[1].sum()))), jnp.asarray(x, jnp.float32))
        np.testing.assert_array_equal(found, row[leaf_by_position(cells, x)])


def one_row_a_leaf(partitions):
    first = np.cumsum([0, *map(len, partitions)])
    return [begin + np.arange(len(cells)) for begin, cells in zip(first, partitions, strict=False)]


@settings(max_examples=10)
@given(seed=st.integers(0, 1000), dim=st.sampled_from([1, 2, 3, 4]), sizes=st.lists(st.integers(0, 100), min_size=1))
def test_every_point_finds_its_leaf_in_its_own_partition(seed, dim, sizes):
    partitions = [random_partition(seed + i, dim, size) for i, size in enumerate(sizes[:4])]
    assume(all(can_be_in_trie(cells, levels_of_all(partitions)) for cells in partitions))
    assert_finds_rows(partitions, one_row_a_leaf(partitions), seed)


@pytest.mark.parametrize("axes", [[0] * 17, [0, 1] * 13, [0] * 13 + [1] * 13, [0, 1, 2] * 7, [1] * 13])
def test_deep_leaves_are_found_beside_shallow_ones(axes):
    deep = chain([*axes, *range(max(axes) + 1)][-len(axes) :])
    partitions = [Cells.root(deep.dim), deep, random_partition(0, deep.dim, 30)]
    assert_finds_rows(partitions, one_row_a_leaf(partitions))


def test_leaves_of_the_same_numbers_share_a_row():
    cells = random_partition(1, 2, 60)
    assert_finds_rows([cells, cells], [np.arange(len(cells)) % 3, 3 + np.arange(len(cells)) % 2])


def test_too_deep_partitions_and_such_of_too_many_pages_are_left_out():
    too_deep = chain([0] * 18)
    assert not can_be_in_trie(too_deep, levels_of_all([too_deep]))
    thin = Cells(np.full((1 << 13, 2), (13, 0)), np.stack([np.arange(1 << 13), np.zeros(1 << 13, int)], axis=1))
    assert not can_be_in_trie(thin, levels_of_all([thin, chain([1] * 13)]))
    assert can_be_in_trie(thin, levels_of_all([thin]))
