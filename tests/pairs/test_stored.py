"""What a file of pairs holds: pairs of corners, distances and lists, read as they were written; nothing else is."""

from dataclasses import replace

import numpy as np
import pytest
from pair_helpers import serpentine, stored_ring
from scipy.sparse.csgraph import floyd_warshall

from plr_jax import Box
from plr_jax.pairs.stored import Stored, distances_by_rows
from plr_jax.plr.container import PAIRS_CODE, Container
from plr_jax.plr.partition.cells import Cells

FIELDS = ("corner", "joined", "leaf", "listed", "rounding", "rounding_of_outline", "points")


@pytest.fixture(scope="module")
def stored(maze):
    return maze.stored


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


def check_read_as_written(stored):
    again = Stored.from_bytes(stored.to_bytes())
    assert again.to_bytes() == stored.to_bytes()
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(again, name), getattr(stored, name))


@pytest.mark.parametrize("seed", range(5))
def test_a_file_is_read_as_it_was_written(seed):
    rng, cells, count = np.random.default_rng(seed), Cells.root(2), 9 + 50 * (seed % 2)
    for _ in range(seed * 3):
        row, rest = rng.integers(len(cells)), np.arange(len(cells))
        halves = cells[np.array([row])].split(rng.integers(2, size=1))
        cells = cells[rest[:row]].append(halves, cells[rest[row + 1 :]])
    lists = np.nonzero(rng.random((len(cells), count)) < 0.4)  # some lists are empty
    joined = [(i, j) for j in range(count) for i in range(j) if rng.random() < 0.3]
    check_read_as_written(stored_ring(rng.integers(0, 99, (count, 2)), (100, 100), joined, cells, lists, 0.5))


def test_the_last_of_all_pairs_have_numbers_of_their_own():
    check_read_as_written(serpentine(8192, [(0, 1), (8189, 8190), (0, 8191), (8190, 8191)]))


def test_more_than_tables_and_files_may_hold_is_refused(stored, monkeypatch):
    ring = stored_ring([(0, 0), (9, 0), (9, 9)], (9, 9), cells=Cells.root(2).split(np.zeros(1, int)))
    ring = replace(ring, leaf=np.repeat([0, 1], 3), listed=np.tile([0, 1, 2], 2))
    monkeypatch.setattr("plr_jax.pairs.stored._MOST_ENTRIES_A_BYTE", 0)
    for most, message in ((5, "more entries"), (6, None)):
        monkeypatch.setattr("plr_jax.pairs.stored._LEAST_ENTRIES", most)
        check_refused(ring, message)
    most = len(stored.cells) * len(stored.corner)
    monkeypatch.undo()
    for fewer, message in (
        (0, None),
        (1, f"{len(stored.cells):,} leaves and 12 corners, more than tables are made of"),
    ):
        monkeypatch.setattr("plr_jax.pairs.stored._MOST_NUMBERS", most - fewer)
        check_refused(stored, message)


def check_refused(file, message, **changes):
    """Fails unless a file, some of whose parts are changed, is refused; or read, if there is no message."""
    data = replace(Container.from_bytes(file.to_bytes()), **changes).to_bytes()
    if message is None:
        assert Stored.from_bytes(data).to_bytes() == file.to_bytes()
    else:
        with pytest.raises(ValueError, match=message):
            Stored.from_bytes(data)


def test_files_of_other_kinds_and_with_more_data_are_refused(stored):
    layers = first, pairs, lists = Container.from_bytes(stored.to_bytes()).layers
    check_refused(stored, None)

    def with_layer(place, **changes):
        return {"layers": tuple(replace(layer, **changes) if i == place else layer for i, layer in enumerate(layers))}

    for place, message in enumerate(("end too early|more data than its corners need", "corners", "leaves")):
        check_refused(stored, message, **with_layer(place, body=layers[place].body + bytes(9)))
        check_refused(stored, "proofs", **with_layer(place, proof_code=1))
        for code in (0, (PAIRS_CODE + 1) % 16)[: 2 if place < 2 else 1]:
            check_refused(stored, "one goal; use load|coarser PLRs", **with_layer(place, leaf_code=code))
    for place, number in ((place, number) for place in (0, 1) for number in (np.nan, np.inf, -1.0)):
        body = np.float32(number).tobytes() + layers[place].body[4:]
        check_refused(stored, "its distances err by", **with_layer(place, body=body))
    check_refused(stored, "its pairs have 2 layers of lists", layers=(first, pairs, lists, lists))
    for domain in (Box((0,), (1,)), Box((0, 0), (1, 1), periodic=(True, False)), Box((0, 0, 0), (1, 1, 1))):
        check_refused(stored, "they ought to be of a region in the plane", domain=domain)
    check_refused(stored, r"1e\+19 wide, more than 1e\+18", domain=Box((0, 0), (1e19, 1)))


def test_cut_off_at_a_mark_there_is_one_leaf_of_all_corners(stored, maze):
    data, marks = stored.to_bytes(), maze.file_marks
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
