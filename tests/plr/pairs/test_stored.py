"""What a file of pairs holds: numbers of pairs, distances and lists, read as they were written."""

import numpy as np
import pytest
from scipy.sparse.csgraph import floyd_warshall

from plr_jax import construct_pairs, scenes
from plr_jax.plr.file.bits import BitReader, BitWriter
from plr_jax.plr.file.container import Container
from plr_jax.plr.pairs.stored import (
    Stored,
    _number_of_pair,
    _pair_of_number,
    _read_lists,
    _write_lists,
    shortest_distances,
)
from plr_jax.plr.partition.cells import Cells
from plr_jax.plr.partition.tree import levels_of, tree_of_levels


@pytest.fixture(scope="module")
def stored():
    return construct_pairs(scenes.maze().workspace, max_bytes=600).stored


def test_pairs_have_the_numbers_of_an_enumeration():
    pairs = np.array([(i, j) for j in range(60) for i in range(j)])
    np.testing.assert_array_equal(_number_of_pair(pairs), np.arange(len(pairs)))
    np.testing.assert_array_equal(_pair_of_number(np.arange(len(pairs))), pairs)
    last = np.array([(8190, 8191), (0, 8191), (8189, 8190)])
    np.testing.assert_array_equal(_pair_of_number(_number_of_pair(last)), last)


def test_distances_between_corners_are_those_over_the_edges():
    rng = np.random.default_rng(0)
    points = rng.uniform(0, 1, (12, 2))
    edges = np.argwhere(np.triu(rng.random((12, 12)) < 0.2, 1))
    lengths = np.full((12, 12), np.inf)
    lengths[tuple(edges.T)] = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
    np.testing.assert_allclose(shortest_distances(points, edges), floyd_warshall(lengths, directed=False))
    assert shortest_distances(points[:0], edges[:0]).shape == (0, 0)


@pytest.mark.parametrize("seed", range(5))
def test_lists_are_read_as_they_were_written(seed):
    rng, cells = np.random.default_rng(seed), Cells.root(2)
    for _ in range(seed * 3):
        row = rng.integers(len(cells))
        rest = np.delete(np.arange(len(cells)), row)
        cells = cells[rest].append(cells[np.array([row])].split(rng.integers(2, size=1)))
    tree, count = tree_of_levels(levels_of(cells)[0], 2), 9
    leaf, listed = np.nonzero(rng.random((len(cells), count)) < 0.4)  # some lists are empty
    body = BitWriter()
    _write_lists(body, tree, leaf, listed, count)
    again = _read_lists(BitReader(body.to_bytes()), tree, count, 1000)
    np.testing.assert_array_equal(again, (leaf, listed))


def test_lists_longer_than_a_file_may_have_are_refused():
    tree = tree_of_levels(levels_of(Cells.root(2).split(np.zeros(1, int)))[0], 2)
    body = BitWriter()
    leaf, listed = np.nonzero(np.ones((2, 9), bool))
    _write_lists(body, tree, leaf, listed, 9)
    with pytest.raises(ValueError, match="more entries"):
        _read_lists(BitReader(body.to_bytes()), tree, 9, 17)


def test_a_file_is_read_as_it_was_written(stored):
    again = Stored.from_bytes(stored.to_bytes())
    assert again.to_bytes() == stored.to_bytes()
    for name in ("corner", "edges", "leaf", "listed", "rounding", "points", "distances"):
        np.testing.assert_array_equal(getattr(again, name), getattr(stored, name))


def test_files_of_other_kinds_and_with_more_data_are_refused(stored):
    whole = Container.from_bytes(stored.to_bytes())
    longer = Container(whole.domain, whole.leaf_code, whole.num_leaves, whole.body + bytes(9)).to_bytes()
    with pytest.raises(ValueError, match="more data than its leaves need"):
        Stored.from_bytes(longer)
    with pytest.raises(ValueError, match="one goal; use load"):
        Stored.from_bytes(Container(whole.domain, 0, whole.num_leaves, whole.body).to_bytes())
