"""Pairs of the cells of a grid: exact, never above the truth, and a file of a few bytes that gives them back."""

import struct
import zlib
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from grid_helpers import all_pairs, drawn, mosaic, pairs_of_tiles
from hypothesis import given
from hypothesis import strategies as st

from plr_jax import GridGraph, GridPairs, construct_grid_pairs, load, save, scenes
from plr_jax._types import BoundingFn, DimensionedFn
from plr_jax.pairs.grid_pairs import decode_grid, encode_grid

ROOMS = drawn(".......#", ".##....#", ".##.##..", "....##..", "##......", "...##.#.", ".#.##.##", ".#....#.")
"""With a cell in the last row that no path joins to the others."""
X, Y = all_pairs(ROOMS)  # asked for again and again, so that queries are compiled once


@pytest.fixture(scope="module", params=[4, 8])
def rooms(request):
    return GridGraph(ROOMS, connectivity=request.param)


@pytest.fixture(scope="module")
def pairs(rooms):
    return construct_grid_pairs(rooms)


@pytest.fixture(scope="module")
def answers(pairs):
    return np.asarray(pairs(X, Y))


def test_answers_and_their_bounds_are_those_of_the_graph_and_symmetric(rooms, pairs, answers):
    truth = rooms.between(X, Y)
    lower, upper = (np.asarray(bound, np.float64) for bound in pairs.bounds(X, Y))
    np.testing.assert_array_equal(lower, answers)
    assert (lower <= truth).all() and (truth <= upper).all() and (upper <= lower * (1 + 2e-6)).all()
    np.testing.assert_array_equal(pairs(Y, X), answers)
    free = np.resize(np.argwhere(ROOMS)[:, ::-1], X.shape)
    np.testing.assert_array_equal(pairs(free, free + 0.75), 0)


@pytest.mark.parametrize(("connectivity", "seed"), [(4, 0), (8, 1)])
def test_all_pairs_of_many_random_grids_are_exact_and_never_above_the_truth(connectivity, seed):
    graph = GridGraph(mosaic(seed, 12, 8), connectivity=connectivity)
    x, y = pairs_of_tiles(12, 8)
    truth = graph.between(x, y)
    found = np.asarray(construct_grid_pairs(graph)(x, y), np.float64)
    assert (found <= truth).all()
    np.testing.assert_allclose(found, truth, rtol=1e-6)
    assert connectivity == 8 or (found == truth).all()


@pytest.mark.parametrize("free", [drawn("#"), drawn("..", "##", "..")])
@pytest.mark.parametrize("connectivity", [4, 8])
def test_grids_without_corners(free, connectivity):
    graph = GridGraph(free, connectivity=connectivity)
    pairs = construct_grid_pairs(graph)
    x, y = (np.concatenate([points, np.zeros((1, 2))]) for points in all_pairs(free))
    np.testing.assert_allclose(pairs(x, y), graph.between(x, y), rtol=1e-6)
    assert pairs.num_corners <= 1


def test_published_lengths(data_dir):
    scenario = scenes.read_scen(data_dir / "movingai/dao/den520d.map.scen")
    cells = scenes.read_cells(data_dir / "movingai/dao/den520d.map")
    pairs = construct_grid_pairs(GridGraph(cells, connectivity=8))
    np.testing.assert_allclose(pairs(scenario.starts, scenario.goals), scenario.octile_lengths, rtol=1e-5, atol=5e-3)
    assert pairs.num_bytes < 1300


def test_outside_blocked_and_not_joined_are_inf(pairs):
    bad = [[7, 0], [-0.01, 0], [0, 8], [8, 0], [np.nan, 0], [0, np.inf], [-1e30, 0], [1e300, 0], [-1e300, 0], [7, 7]]
    x, zero = np.resize(bad, X.shape), np.zeros_like(X)
    with np.errstate(over="raise"):
        assert np.isinf(pairs(x, zero)).all() and np.isinf(pairs(zero, x)).all()
    np.testing.assert_array_equal(np.isinf(pairs(x, x + 0.5)), (x != 7).any(axis=1))
    nearly = np.resize([np.nextafter(1.0, 0), 0], X.shape)  # as a 32-bit float it would be the next cell's
    np.testing.assert_array_equal(pairs(nearly, zero), 0)


def test_distances_to_a_goal_are_those_of_pairs(pairs):
    cells = np.argwhere(np.ones_like(ROOMS))[:, ::-1] + 0.5
    for goal in ([0, 0], [7.2, 7.9], [3, 3]):
        to_goal = pairs.to(goal)
        np.testing.assert_array_equal(to_goal(cells), pairs(np.resize(cells, X.shape), np.resize(goal, X.shape))[:64])
        assert to_goal.dim == 2 and isinstance(to_goal, DimensionedFn) and isinstance(to_goal, BoundingFn)
    assert to_goal(cells.reshape(8, 8, 2)).shape == (8, 8)


def test_compiled_functions_take_it_or_close_over_it_and_promote_nothing():
    pairs = construct_grid_pairs(GridGraph(ROOMS, connectivity=8))
    x, y, answers = jnp.asarray(X, jnp.float32), jnp.asarray(Y, jnp.float32), np.asarray(pairs(X, Y))
    np.testing.assert_array_equal(jax.jit(lambda pairs, x: pairs(x, y))(pairs, x), answers)
    np.testing.assert_array_equal(jax.vmap(pairs)(x[:50], y[:50]), answers[:50])
    with jax.numpy_rank_promotion("raise"), jax.numpy_dtype_promotion("strict"):
        np.testing.assert_array_equal(pairs(x, y), answers)
        np.testing.assert_array_equal(pairs.bounds(x, y)[0], answers)
    assert pairs(x.reshape(-1, 2, 2)[:3], y[0]).shape == (3, 2)
    assert pairs(x[0], y[0]).shape == () and pairs(x[:0], y[:0]).shape == (0,)


def test_files_answer_alike(rooms, pairs, answers, tmp_path):
    save(pairs, tmp_path / "rooms.pairs")
    assert (tmp_path / "rooms.pairs").stat().st_size == pairs.num_bytes == len(pairs.to_bytes())
    loaded = load(tmp_path / "rooms.pairs")
    np.testing.assert_array_equal(loaded(X, Y), answers)
    assert loaded.to_bytes() == pairs.to_bytes() and str(rooms.connectivity) in repr(loaded)
    assert isinstance(loaded, GridPairs)
    (tmp_path / "cut").write_bytes(pairs.to_bytes()[:-1])
    with pytest.raises(ValueError, match=r"cut cannot be read as a PLR or as pairs: .* the file is truncated"):
        load(tmp_path / "cut")


def test_a_budget_is_kept_exactly_or_by_bounds_or_refused(rooms, pairs):
    size = pairs.resident_bytes
    assert construct_grid_pairs(rooms, max_bytes=size).to_bytes() == pairs.to_bytes()
    assert pairs.num_landmarks == 0 < pairs.num_corners
    bounded = construct_grid_pairs(rooms, max_bytes=size - 1)
    assert bounded.resident_bytes < size and bounded.num_landmarks > 0 == bounded.num_corners
    with pytest.raises(ValueError, match=r"max_bytes must be at least 142 .*got 100"):
        construct_grid_pairs(rooms, max_bytes=100)
    with pytest.raises(ValueError, match=r"max_bytes must be at least .* for this grid, got 3"):
        construct_grid_pairs(drawn("##"), max_bytes=3)
    least = construct_grid_pairs(np.ones((9, 9), bool)).resident_bytes  # less than one landmark takes
    with pytest.raises(ValueError, match=rf"max_bytes must be at least {least} for this grid, got {least - 1}"):
        construct_grid_pairs(np.ones((9, 9), bool), max_bytes=least - 1)


def test_no_table_is_larger_than_those_that_files_are_read_to_have(rooms, monkeypatch):
    monkeypatch.setattr("plr_jax.pairs.grid_pairs.MOST_BYTES", 100)
    assert construct_grid_pairs(rooms, max_bytes=10**30).num_landmarks > 0


@pytest.fixture(scope="module")
def bounded(rooms):
    return construct_grid_pairs(rooms, max_bytes=400)


def test_bounds_of_few_bytes_hold_and_tell_what_no_path_joins(rooms, bounded):
    truth = rooms.between(X, Y)
    lower, upper = (np.asarray(bound, np.float64) for bound in bounded.bounds(X, Y))
    np.testing.assert_array_equal(lower, bounded(X, Y))
    np.testing.assert_array_equal(lower, bounded(Y, X))
    assert (lower <= truth).all() and (truth <= upper).all()
    np.testing.assert_array_equal(np.isinf([lower, upper]), [np.isinf(truth)] * 2)
    across, down = abs(X - Y).T
    manhattan = (
        across + down if rooms.connectivity == 4 else abs(across - down) + np.sqrt(2) * np.minimum(across, down)
    )
    joined = np.isfinite(truth)
    assert (lower >= manhattan * (1 - 1e-6))[joined].all() and (lower > manhattan + 1)[joined].any()


def test_bounds_answer_alike_everywhere(bounded, tmp_path):
    answers = np.asarray(bounded(X, Y))
    save(bounded, tmp_path / "rooms.pairs")
    loaded = load(tmp_path / "rooms.pairs")
    assert isinstance(loaded, GridPairs) and loaded.to_bytes() == bounded.to_bytes() and "landmarks" in repr(loaded)
    np.testing.assert_array_equal(loaded(X, Y), answers)
    np.testing.assert_array_equal(jax.jit(lambda pairs, x, y: pairs(x, y))(bounded, X, Y), answers)
    goal, cells = np.array([3, 3]), np.argwhere(np.ones_like(ROOMS))[:, ::-1]
    to_goal = np.asarray(bounded.to(goal)(cells))
    np.testing.assert_array_equal(to_goal, bounded(cells, goal))
    window = np.asarray(bounded.window([goal + 0.5, goal], [[3, 3], [-1, 0]], 9))
    square = np.where(np.isinf(to_goal), -1, np.floor(to_goal)).reshape(8, 8)
    np.testing.assert_array_equal(window[0], np.pad(square, ((6, 5), (6, 5)), constant_values=-1))
    assert (window[1] == -1).all()
    with jax.enable_x64(True):
        assert bounded.window([goal], [goal], 1).dtype == jnp.int32
    with pytest.raises(ValueError, match="C is written of exact distances"):
        bounded.c_header("rooms")


TEXT, TYPE = cast(Any, "here"), cast(Any, 3)


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda pairs: pairs([[0, 0, 0]], [[0, 0]]), r"x must have shape \(\.\.\., 2\), got \(1, 3\)"),
        (lambda pairs: pairs([0, 0], jnp.zeros(3)), r"y must have shape"),
        (lambda pairs: pairs(np.zeros((2, 2)), np.zeros((3, 2))), "must be of one shape"),
        (lambda pairs: pairs(TEXT, [0, 0]), "x must be points"),
        (lambda pairs: pairs(jnp.zeros(2, complex), jnp.zeros(2)), "real"),
        (lambda pairs: pairs.to([7, 0]), "The goal must be in a free cell"),
        (lambda pairs: construct_grid_pairs(TEXT), "graph must be a grid, such as GridGraph"),
        (lambda pairs: construct_grid_pairs(GridGraph(ROOMS), max_bytes=0), "max_bytes must be an integer >= 1"),
        (
            lambda pairs: construct_grid_pairs(GridGraph(ROOMS), checkpoint=TYPE),
            "checkpoint must be the path of a file",
        ),
        (lambda pairs: GridPairs.from_bytes(TEXT), "bytes of a file"),
    ],
)
def test_bad_input_is_refused(pairs, call, message):
    with pytest.raises(ValueError, match=message):
        call(pairs)


@given(st.integers(1, 12), st.integers(1, 12), st.floats(0, 1), st.sampled_from([4, 8]))
def test_what_is_written_is_read(rows, columns, share, connectivity):
    free = np.random.default_rng(rows + columns).random((rows, columns)) < share
    for num_landmarks in (0, 7 * int(free.any())):
        found, *rest = decode_grid(encode_grid(free, connectivity, num_landmarks))
        np.testing.assert_array_equal(found, free)
        assert rest == [connectivity, num_landmarks]


def test_layout():
    data = encode_grid(np.array([[True], [True], [False]]), 8)
    # Cells 0 and 2 differ from the one above: two gaps, 0 and 1, in a code of order 0.
    bits = [0, 1] + [0] * 30 + [0] * 5 + [1] + [0, 1] + [0]
    body = np.packbits(bits, bitorder="little").tobytes()
    assert data[:-4] == b"PGP\n" + struct.pack("<BBIII", 1, 8, 3, 1, len(data)) + body
    bounded = encode_grid(np.array([[True], [True], [False]]), 8, 5)
    assert bounded[:-4] == b"PGP\n" + struct.pack("<BBIIII", 2, 8, 3, 1, len(data) + 4, 5) + body


def test_no_file_is_larger_than_the_bound():
    free = np.indices((64, 64)).sum(axis=0) % 2 == 0
    assert len(encode_grid(free, 4)) < 4 * free.size + 64


def sealed(data):
    """Bytes with their size and checksum put right."""
    data = data[:14] + struct.pack("<I", len(data)) + data[18:-4]
    return data + struct.pack("<I", zlib.crc32(data))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: b"", "does not start like"),
        (lambda d: b"PLR\n" + d[4:], "does not start like"),
        (lambda d: d[:20], "end too early"),
        (lambda d: d[:4] + b"\3" + d[5:], "format version 3"),
        (lambda d: sealed(d[:4] + b"\2" + d[5:18] + bytes(4) + d[18:]), "states 0 landmarks"),
        (lambda d: sealed(d[:4] + b"\2" + d[5:18] + d[-4:]), "end too early"),
        (lambda d: encode_grid(np.zeros((9, 14), bool), 4, 1), "states 1 landmarks of 0 free cells"),
        (lambda d: encode_grid(np.ones((2048, 2048), bool), 4, 1024), "1024 landmarks of 4194304 free cells"),
        (lambda d: d[:-1], "truncated"),
        (lambda d: d + b"\0", "its header states"),
        (lambda d: d[:-6] + bytes([d[-6] ^ 1]) + d[-5:], "checksum"),
        (lambda d: sealed(d[:5] + b"\6" + d[6:]), "connectivity of 6"),
        (lambda d: sealed(d[:6] + bytes(4) + d[10:]), "0 x 14 cells"),
        (lambda d: sealed(d[:6] + b"\xff\xff\xff\xff" + d[10:]), "not 1 to"),
        (lambda d: sealed(d[:6] + b"\2\0\0\0" + d[10:]), "names"),
        (lambda d: sealed(d[:-6] + d[-4:]), "end too early"),
        (lambda d: sealed(d[:-4] + b"\0" + d[-4:]), "more data than"),
        (lambda d: sealed(d[:18] + b"\xff\xff\xff\xff" + d[22:]), "names 4294967295 members of 126"),
    ],
)
def test_damaged_files_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        decode_grid(change(encode_grid(np.random.default_rng(0).random((9, 14)) > 0.3, 4)))
