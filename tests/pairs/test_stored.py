"""Files of pairs: outlines, corners, distances and lists are read as they were written; nothing else is read."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely
from pair_helpers import MAZE, serpentine, stored_ring, two_batches
from piece_helpers import TEN, WORKSPACES, box
from scipy.sparse import csr_array
from scipy.sparse.csgraph import floyd_warshall

from plr_jax import Box, Workspace
from plr_jax.pairs.construct import outline_of, with_open_contacts
from plr_jax.pairs.pair_plr import pairs_from_bytes
from plr_jax.pairs.stored import PairsFileData, distances_by_rows, read_outline
from plr_jax.plr.coding import BitReader, BitWriter
from plr_jax.plr.container import PAIRS_CODE, Container, Header
from plr_jax.plr.tree import Cells


def outline(workspace):
    width = float(workspace.bounds.width.max())
    found = outline_of(workspace.boundary, workspace.bounds.lo, width, workspace.tolerance)
    return with_open_contacts(*found) if workspace.squeeze else found


@pytest.mark.parametrize("squeeze", [False, True])
@pytest.mark.parametrize("kind", WORKSPACES)
@pytest.mark.parametrize("seed", range(3))
def test_outline_is_the_boundary_of_free_space_and_is_read_as_written(kind, seed, squeeze):
    workspace = kind(np.random.default_rng(seed), squeeze)
    found, vertex = outline(workspace)
    boundary, finest = workspace.boundary, 10 * 2.0**-24
    np.testing.assert_allclose(found.positions, boundary.vertices[vertex], atol=finest)
    ends = np.sort(found.moved_walls(0.0).reshape(-1, 2, 2).round(5), axis=0)
    np.testing.assert_allclose(ends, np.sort(boundary.segments.round(5), axis=0), atol=2e-5)
    x = np.random.default_rng(seed).uniform(0, 10, (500, 2))
    clear = shapely.distance(shapely.boundary(workspace.free_space), shapely.points(x)) > 1e-4
    np.testing.assert_array_equal(found.contains(x)[clear], workspace.is_free(x)[clear])
    body = BitWriter()
    found.write(body)
    again = read_outline(BitReader(body.to_bytes()), found.origin)
    for name in ("step", "points", "first", "may_squeeze"):
        np.testing.assert_array_equal(getattr(again, name), getattr(found, name))


def test_moved_walls_grow_or_shrink_free_space():
    found, _ = outline(Workspace(TEN, [box(4, 4, 6, 6)]))
    for distance in (0.25, -0.5):
        moved = {tuple(point) for point in found.moved_points(distance).tolist()}
        inner, outer = box(*[4 + distance] * 2, *[6 - distance] * 2), box(*[-distance] * 2, *[10 + distance] * 2)
        assert moved == {tuple(point) for point in [*inner.tolist(), *outer.tolist()]}


@pytest.mark.parametrize("squeeze", [False, True])
def test_touching_walls_are_open_only_with_squeeze(squeeze):
    found, _ = outline(Workspace(TEN, [box(2, 2, 5, 5), box(5, 5, 8, 8)], squeeze=squeeze))
    assert found.may_squeeze == squeeze and found.is_contact.sum() == (0 if squeeze else 2)
    # Corners (5, 5) move into both obstacles. Walls from the contact, there and back, part the sides.
    walls = {tuple(wall) for wall in found.moved_walls(0.1).round(9).tolist()}
    into = {(5.0, 5.0, corner, corner) for corner in (4.9, 5.1)}
    assert (into <= walls) != squeeze and ({wall[2:] + wall[:2] for wall in into} <= walls) != squeeze
    ends = {tuple(wall[:2]) for wall in found.moved_walls(0.1, moves_all=True).round(9).tolist()}
    assert {(4.9, 4.9), (5.1, 5.1)} <= ends and (5.0, 5.0) not in ends


def test_ends_of_thin_obstacles_stay_when_walls_move():
    found, _ = outline(Workspace(TEN, [box(5, 0, 5.25, 8)]))
    assert sorted(found.positions[found.ends_sight(0.2)].tolist()) == [[5, 8], [5.25, 8]]
    assert not found.ends_sight(0.1).any()


FIELDS = ("corner", "edges", "rounding", "points")


@pytest.fixture(scope="module")
def stored(maze):
    return maze.stored


def test_distances_between_corners_equal_shortest_paths_over_edges(monkeypatch):
    rng = np.random.default_rng(0)
    points = rng.uniform(0, 1, (12, 2))
    edges = np.argwhere(np.triu(rng.random((12, 12)) < 0.2, 1))
    lengths = np.full((12, 12), np.inf)
    lengths[tuple(edges.T)] = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
    expected = floyd_warshall(lengths, directed=False)
    for at_once in (1, 12, 24, 50, 1000):
        monkeypatch.setattr("plr_jax.pairs.stored._DISTANCES_AT_ONCE", at_once)
        first, rows = zip(*distances_by_rows(points, edges), strict=True)
        np.testing.assert_allclose(np.concatenate(rows), expected)
        np.testing.assert_array_equal(first, np.cumsum([0, *map(len, rows[:-1])]))
    assert list(distances_by_rows(points[:0], edges[:0])) == []


def check_read_as_written(stored):
    again = PairsFileData.from_bytes(stored.to_bytes())
    assert again.to_bytes() == stored.to_bytes()
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(again, name), getattr(stored, name))
    np.testing.assert_array_equal(again.lists.toarray(), stored.lists.toarray())
    np.testing.assert_array_equal(again.outline.is_thin, stored.outline.is_thin)


@pytest.mark.parametrize("seed", range(5))
def test_files_are_read_as_written(seed):
    rng, cells, count = np.random.default_rng(seed), Cells.root(2), 9 + 50 * (seed % 2)
    for _ in range(seed * 3):
        row, rest = rng.integers(len(cells)), np.arange(len(cells))
        halves = cells[np.array([row])].split(rng.integers(2, size=1))
        cells = cells[rest[:row]].append(halves, cells[rest[row + 1 :]])
    lists = rng.random((len(cells), count)) < 0.4  # some lists are empty
    joined = [(i, j) for j in range(count) for i in range(j) if rng.random() < 0.3]
    check_read_as_written(stored_ring(rng.integers(0, 99, (count, 2)), (100, 100), joined, cells, lists, 0.5))


def test_edges_between_last_corners_are_read_as_written():
    check_read_as_written(serpentine(8192, [(0, 1), (8189, 8190), (0, 8191), (8190, 8191)]))


def test_files_of_too_large_tables_raise(stored, monkeypatch):
    ring = stored_ring([(0, 0), (9, 0), (9, 9)], (9, 9), cells=Cells.root(2).split(np.zeros(1, int)))
    ring = replace(ring, lists=csr_array(np.ones((2, 3), bool)))
    monkeypatch.setattr("plr_jax.pairs.stored._MOST_ENTRIES_A_BYTE", 0)
    for most, message in ((5, "more entries"), (6, None)):
        monkeypatch.setattr("plr_jax.pairs.stored._LEAST_ENTRIES", most)
        check_refused(ring, message)
    most = len(stored.cells) * len(stored.corner)
    monkeypatch.undo()
    for fewer, message in ((0, None), (1, f"{len(stored.cells):,} leaves and 12 corners, more than tables")):
        monkeypatch.setattr("plr_jax.pairs.stored._MOST_NUMBERS", most - fewer)
        check_refused(stored, message)


def check_refused(file, message, **changes):
    """Fails unless a file, some of whose parts are changed, is refused; or read, if there is no message."""
    data = replace(Container.from_bytes(file.to_bytes()), **changes).to_bytes()
    if message is None:
        assert PairsFileData.from_bytes(data).to_bytes() == file.to_bytes()
    else:
        with pytest.raises(ValueError, match=message):
            PairsFileData.from_bytes(data)


def test_malformed_files_raise(stored):
    layers = first, lists = Container.from_bytes(stored.to_bytes()).layers
    check_refused(stored, None)

    def with_layer(place, **changes):
        return {"layers": tuple(replace(layer, **changes) if i == place else layer for i, layer in enumerate(layers))}

    for place, message in enumerate(("too early|corners need", "leaves need")):
        check_refused(stored, message, **with_layer(place, body=layers[place].body + bytes(9)))
        check_refused(stored, "proofs", **with_layer(place, proof_code=1))
    for code in (0, (PAIRS_CODE + 1) % 16):
        check_refused(stored, "one goal; use load", **with_layer(0, leaf_code=code))
    for number in (np.nan, np.inf, -1.0):
        body = np.float32(number).tobytes() + first.body[4:]
        check_refused(stored, "its rounding error must be", **with_layer(0, body=body))
    check_refused(stored, "more data than its outline needs", layers=(first, first, lists))
    check_refused(stored, "its pairs have 4 layers", layers=(first, lists, lists, lists))
    check_refused(stored, "cut off before its lists", layers=(first,))
    for domain in (Box((0,), (1,)), Box((0, 0), (1, 1), periodic=(True, False)), Box((0, 0, 0), (1, 1, 1))):
        check_refused(stored, "must be a box in the plane", domain=domain)
    check_refused(stored, r"1e\+19 wide, more than 1e\+18", domain=Box((0, 0), (1e19, 1)))


@pytest.mark.full
def test_files_of_plr_jax_0_1_are_read_and_cut_files_raise(maze):
    """Three layers, of which the second one holds the joined pairs."""
    data = (Path(__file__).parent / "maze_of_0_1.plr").read_bytes()
    old, marks = PairsFileData.from_bytes(data), Header.read(data).marks
    for name in ("corner", "edges", "rounding", "points"):
        np.testing.assert_array_equal(getattr(old, name), getattr(maze.stored, name))
    check_read_as_written(old)
    x, y = two_batches(MAZE, 100)
    np.testing.assert_array_equal(pairs_from_bytes(data)(x, y), maze(x, y))
    assert len(marks) == 2 and len(old.cells) == 873
    for whole in (data, maze.to_bytes()):
        for size in range(0, len(whole), 7):
            with pytest.raises(ValueError):
                PairsFileData.from_bytes(whole[:size])
        for mark in Header.read(whole).marks:
            with pytest.raises(ValueError, match="cut off before its lists of corners"):
                PairsFileData.from_bytes(whole[:mark])
