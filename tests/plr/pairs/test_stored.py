"""What a file of pairs holds: numbers of pairs, distances and lists, read as they were written."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse.csgraph import floyd_warshall

from plr_jax import Box, construct_pairs, scenes
from plr_jax.pairs.pair_plr import pairs_from_bytes
from plr_jax.pairs.stored import (
    Stored,
    _number_of_pair,
    _pair_of_number,
    _read_lists,
    _write_lists,
    distances_by_rows,
)
from plr_jax.plr.file.bits import BitReader, BitWriter
from plr_jax.plr.file.container import PAIRS_CODE, Container, Header
from plr_jax.plr.partition.cells import Cells, levels_of, tree_of_levels


@pytest.fixture(scope="module")
def stored():
    return construct_pairs(scenes.maze().workspace, max_bytes=600).stored


def test_pairs_have_the_numbers_of_an_enumeration():
    pairs = np.array([(i, j) for j in range(60) for i in range(j)])
    np.testing.assert_array_equal(_number_of_pair(pairs), np.arange(len(pairs)))
    np.testing.assert_array_equal(_pair_of_number(np.arange(len(pairs))), pairs)
    last = np.array([(8190, 8191), (0, 8191), (8189, 8190)])
    np.testing.assert_array_equal(_pair_of_number(_number_of_pair(last)), last)


def test_distances_between_corners_are_those_over_the_edges(monkeypatch):
    rng = np.random.default_rng(0)
    points = rng.uniform(0, 1, (12, 2))
    edges = np.argwhere(np.triu(rng.random((12, 12)) < 0.2, 1))
    lengths = np.full((12, 12), np.inf)
    lengths[tuple(edges.T)] = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
    expected = floyd_warshall(lengths, directed=False)
    for at_once in (1, 12, 24, 50, 1000):
        monkeypatch.setattr("plr_jax.pairs.stored._AT_ONCE", at_once)
        first, rows = zip(*distances_by_rows(points, edges), strict=True)
        np.testing.assert_allclose(np.concatenate(rows), expected)
        np.testing.assert_array_equal(first, np.cumsum([0, *map(len, rows[:-1])]))
    assert list(distances_by_rows(points[:0], edges[:0])) == []


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
    for name in ("corner", "joined", "leaf", "listed", "rounding", "rounding_of_outline", "points"):
        np.testing.assert_array_equal(getattr(again, name), getattr(stored, name))


def test_files_of_other_kinds_and_with_more_data_are_refused(stored):
    whole = Container.from_bytes(stored.to_bytes())
    layers = first, pairs, lists = whole.layers

    def read(*layers, **given):
        return Stored.from_bytes(Container(**{"domain": whole.domain, "layers": layers, **given}).to_bytes())

    assert read(*layers).to_bytes() == stored.to_bytes()
    for place, message in ((0, "end too early|more data than its corners need"), (1, "corners"), (2, "leaves")):
        longer = list(layers)
        longer[place] = replace(layers[place], body=layers[place].body + bytes(9))
        with pytest.raises(ValueError, match=message):
            read(*longer)
    for place in range(3):
        for code in (0, PAIRS_CODE + 1):
            others = list(layers)
            others[place] = replace(layers[place], leaf_code=code % 16)
            if place < 2 or code < 8:
                with pytest.raises(ValueError, match="one goal; use load"):
                    read(*others)
        proven = list(layers)
        proven[place] = replace(layers[place], proof_code=1)
        with pytest.raises(ValueError, match="proofs"):
            read(*proven)
    with pytest.raises(ValueError, match="its pairs have 2 layers of lists"):
        read(first, pairs, lists, lists)
    for domain in (Box((0,), (1,)), Box((0, 0), (1, 1), periodic=(True, False)), Box((0, 0, 0), (1, 1, 1))):
        with pytest.raises(ValueError, match="they ought to be of a region in the plane"):
            read(*layers, domain=domain)
    with pytest.raises(ValueError, match=r"1e\+19 wide, more than 1e\+18"):
        read(*layers, domain=Box((0, 0), (1e19, 1)))


def test_more_leaves_and_corners_than_tables_are_made_of_are_refused(stored, monkeypatch):
    most = len(stored.cells) * len(stored.corner)
    monkeypatch.setattr("plr_jax.pairs.stored._MOST_NUMBERS", most)
    assert len(Stored.from_bytes(stored.to_bytes()).cells) == len(stored.cells) > 1
    monkeypatch.setattr("plr_jax.pairs.stored._MOST_NUMBERS", most - 1)
    with pytest.raises(ValueError, match=f"{len(stored.cells)} leaves and 12 corners, more than tables are made of"):
        Stored.from_bytes(stored.to_bytes())


def test_cut_off_at_a_mark_there_is_one_leaf_of_all_corners(stored):
    data = stored.to_bytes()
    marks = Header.read(data).marks
    assert len(marks) == 2
    for mark in marks:
        cut = Stored.from_bytes(data[:mark])
        assert len(cut.cells) == 1 and cut.leaf.tolist() == [0] * len(stored.corner)
        np.testing.assert_array_equal(cut.listed, np.arange(len(stored.corner)))
        assert (cut.joined is None) == (mark == marks[0])
        for name in ("corner", "edges", "rounding_of_outline", "points"):
            np.testing.assert_array_equal(getattr(cut, name), getattr(stored, name))
    for size in set(range(len(data))) - {*marks}:
        with pytest.raises(ValueError):
            Stored.from_bytes(data[:size])


def test_pairs_that_are_cut_off_have_the_same_distances(stored):
    data = stored.to_bytes()
    whole = pairs_from_bytes(data)
    x, y = scenes.maze().workspace.sample_free(400, 0).reshape(2, 200, 2)
    assert np.isfinite(whole(x, y)).all()
    for mark in Header.read(data).marks:
        cut = pairs_from_bytes(data[:mark])
        np.testing.assert_allclose(cut(x, y), whole(x, y), rtol=1e-6)
        to_goal = np.asarray(cut.to(y[0])(x))
        assert np.abs(to_goal - whole(x, y[0])).mean() < 1e-4  # one leaf is halved as often as that takes


def test_distances_that_err_by_no_number_are_refused(stored):
    whole = Container.from_bytes(stored.to_bytes())
    for place in (0, 1):
        for number in (np.nan, np.inf, -1.0):
            layers = list(whole.layers)
            layers[place] = replace(layers[place], body=np.float32(number).tobytes() + layers[place].body[4:])
            with pytest.raises(ValueError, match="its distances err by"):
                Stored.from_bytes(replace(whole, layers=tuple(layers)).to_bytes())
