"""Pairs of the cells of a grid: exact, never above the truth, and a file of a few bytes that gives them back."""

import ctypes
import shutil
import struct
import subprocess
import zlib
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from grid_helpers import all_pairs, drawn, mosaic, pairs_of_tiles, published_queries
from hypothesis import given
from hypothesis import strategies as st

from experiments._c_headers import STRICT, compiled_library
from plr_jax import GridGraph, GridPairs, construct_grid_pairs, load, save, scenes
from plr_jax._types import BoundingFn, DimensionedFn
from plr_jax.pairs import grid_corners
from plr_jax.pairs.grid_pairs import decode_grid, encode_grid

ROOMS = drawn(".......#", ".##....#", ".##.##..", "....##..", "##......", "...##.#.", ".#.##.##", ".#....#.")
"""With a cell in the last row that no path joins to the others."""
X, Y = all_pairs(ROOMS)  # so few that NumPy answers, without compiling


@pytest.fixture(scope="module", params=[4, 8])
def rooms(request):
    return GridGraph(ROOMS, connectivity=request.param)


@pytest.fixture(scope="module")
def pairs(rooms):
    return construct_grid_pairs(rooms)


@pytest.fixture(scope="module")
def answers(pairs):
    return np.asarray(pairs(X, Y))


def test_answers_equal_the_graph_within_bounds_and_symmetric(rooms, pairs, answers):
    truth = rooms.between(X, Y)
    lower, upper = (np.asarray(bound, np.float64) for bound in pairs.bounds(X, Y))
    np.testing.assert_array_equal(lower, answers)
    assert (lower <= truth).all() and (truth <= upper).all() and (upper <= lower * (1 + 2e-6)).all()
    np.testing.assert_array_equal(pairs(Y, X), answers)
    free = np.resize(np.argwhere(ROOMS)[:, ::-1], X.shape)
    np.testing.assert_array_equal(pairs(free, free + 0.75), 0)


def test_labels_answer_as_tables_do(rooms, answers, monkeypatch):
    monkeypatch.setattr(grid_corners, "MOST_IN_TABLE", 0)
    np.testing.assert_array_equal(construct_grid_pairs(rooms)(X, Y), answers)


@pytest.mark.full
@pytest.mark.parametrize("connectivity", [4, 8])
def test_compiled_answers_are_exact_and_never_above_the_truth(connectivity):
    graph = GridGraph(mosaic(connectivity, 12, 8), connectivity=connectivity)
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


def test_lengths_equal_published_lengths(data_dir):
    starts, goals, lengths = published_queries(data_dir / "movingai/dao/den520d.map.scen")
    cells = scenes.read_cells(data_dir / "movingai/dao/den520d.map")
    pairs = construct_grid_pairs(GridGraph(cells, connectivity=8))
    np.testing.assert_allclose(pairs(starts, goals), lengths, rtol=1e-5, atol=5e-3)
    assert pairs.num_bytes < 1300 < pairs.resident_bytes


def test_outside_blocked_or_unreachable_is_inf(pairs):
    bad = [[7, 0], [-0.01, 0], [0, 8], [8, 0], [np.nan, 0], [0, np.inf], [-1e30, 0], [1e300, 0], [-1e300, 0], [7, 7]]
    x, zero = np.resize(bad, X.shape), np.zeros_like(X)
    with np.errstate(over="raise"):
        assert np.isinf(pairs(x, zero)).all() and np.isinf(pairs(zero, x)).all()
    np.testing.assert_array_equal(np.isinf(pairs(x, x + 0.5)), (x != 7).any(axis=1))
    nearly = np.resize([np.nextafter(1.0, 0), 0], X.shape)  # as a 32-bit float it would be the next cell's
    np.testing.assert_array_equal(pairs(nearly, zero), 0)


@pytest.mark.parametrize("connectivity", [8, pytest.param(4, marks=pytest.mark.full)])
def test_distances_to_a_goal_equal_pairs(connectivity):
    cells = np.argwhere(np.ones_like(ROOMS))[:, ::-1].reshape(8, 8, 2) + 0.5
    pairs = construct_grid_pairs(GridGraph(ROOMS, connectivity=connectivity))
    for goal in ([0, 0], [7.2, 7.9], [3, 3]):
        to_goal = pairs.to(goal)
        np.testing.assert_array_equal(to_goal(cells), pairs(cells, goal))
        assert to_goal.dim == 2 and isinstance(to_goal, DimensionedFn) and isinstance(to_goal, BoundingFn)


def test_tracing_promotes_nothing_and_batches_broadcast():
    pairs = construct_grid_pairs(GridGraph(ROOMS, connectivity=8))
    x, y = jnp.asarray(X, jnp.float32), jnp.asarray(Y, jnp.float32)
    with jax.numpy_rank_promotion("raise"), jax.numpy_dtype_promotion("strict"):
        for each in jax.eval_shape(lambda pairs, x: pairs.bounds(x, y), pairs, x):
            assert each.shape == x.shape[:1] and each.dtype == np.float32
    assert pairs(x.reshape(-1, 2, 2)[:3], y[0]).shape == (3, 2)
    assert pairs(x[0], y[0]).shape == () and pairs(x[:0], y[:0]).shape == (0,)


def test_loaded_files_answer_as_before(rooms, pairs, answers, tmp_path):
    save(pairs, tmp_path / "rooms.pairs")
    assert (tmp_path / "rooms.pairs").stat().st_size == pairs.num_bytes == len(pairs.to_bytes())
    loaded = load(tmp_path / "rooms.pairs")
    np.testing.assert_array_equal(loaded(X, Y), answers)
    assert loaded.to_bytes() == pairs.to_bytes() and str(rooms.connectivity) in repr(loaded)
    assert isinstance(loaded, GridPairs)
    (tmp_path / "cut").write_bytes(pairs.to_bytes()[:-1])
    with pytest.raises(ValueError, match=r"cut cannot be read as a PLR or as pairs: .* the file is truncated"):
        load(tmp_path / "cut")


TEXT = cast(Any, "here")


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda pairs: pairs([[0, 0, 0]], [[0, 0]]), r"x must have shape \(\.\.\., 2\), got \(1, 3\)"),
        (lambda pairs: pairs([0, 0], jnp.zeros(3)), r"y must have shape"),
        (lambda pairs: pairs(np.zeros((2, 2)), np.zeros((3, 2))), "must broadcast"),
        (lambda pairs: pairs(TEXT, [0, 0]), "x must be points"),
        (lambda pairs: pairs(jnp.zeros(2, complex), jnp.zeros(2)), "real"),
        (lambda pairs: pairs.to([7, 0]), "The goal must be in a free cell"),
        (lambda pairs: construct_grid_pairs(TEXT), "graph must be a grid, such as GridGraph"),
        (lambda pairs: construct_grid_pairs(GridGraph(ROOMS, connectivity=8, squeeze=True)), "not have squeeze=True"),
        (lambda pairs: GridPairs.from_bytes(TEXT), "bytes of a file"),
    ],
)
def test_wrong_arguments_raise(pairs, call, message):
    with pytest.raises(ValueError, match=message):
        call(pairs)


@given(st.integers(1, 12), st.integers(1, 12), st.floats(0, 1), st.sampled_from([4, 8]))
def test_decoded_grid_equals_encoded_grid(rows, columns, share, connectivity):
    free = np.random.default_rng(rows + columns).random((rows, columns)) < share
    found, again = decode_grid(encode_grid(free, connectivity))
    np.testing.assert_array_equal(found, free)
    assert again == connectivity


def test_layout_of_file_by_hand():
    data = encode_grid(np.array([[True], [True], [False]]), 8)
    # Cells 0 and 2 differ from the one above: two gaps, 0 and 1, in a code of order 0.
    bits = [0, 1] + [0] * 30 + [0] * 5 + [1] + [0, 1] + [0]
    body = np.packbits(bits, bitorder="little").tobytes()
    assert data[:-4] == b"PGP\n" + struct.pack("<BBIII", 1, 8, 3, 1, len(data)) + body


def test_largest_file_is_within_bound():
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
        (lambda d: d[:4] + b"\2" + d[5:], "format version 2"),
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
def test_damaged_files_raise(change, message):
    with pytest.raises(ValueError, match=message):
        decode_grid(change(encode_grid(np.random.default_rng(0).random((9, 14)) > 0.3, 4)))


# --- headers of C: they compile without a warning, as C99 and as C++ -------------------------------------------

compiles_c = pytest.mark.skipif(shutil.which("cc") is None, reason="headers are compiled by a C compiler called cc")
ISLANDS = np.indices((9, 12)).sum(axis=0) % 2 == 0


def compiled(pairs, folder):
    """The functions of a header, with its table open."""
    header = pairs.c_header("here")
    (folder / "here.h").write_text(header.text)
    signatures = {
        "many": ("void", "uint32_t *a, uint32_t *b, int32_t *s, size_t n", "here_steps_of_pairs(a, b, s, n)"),
        "opened": ("int", "const void *data, size_t size", "return here_open(data, size)"),
        "checked": ("int", "void", "return here_check()"),
    }
    code = ['#include "here.h"']
    for name, (of, arguments, call) in signatures.items():
        code += [f"{of} {name}({arguments});", f"{of} {name}({arguments}) {{ {call}; }}"]
    return compiled_library("\n".join(code) + "\n", folder), header


def opened(library, data):
    """Whether a table is taken, at an address that 64 divides."""
    room = np.zeros(len(data) + 64, np.uint8)
    begin = -room.ctypes.data % 64
    room[begin : begin + len(data)] = np.frombuffer(data, np.uint8)
    pointer = ctypes.c_void_p(room[begin:].ctypes.data)
    return library.opened(pointer, ctypes.c_size_t(len(data))), room


def answered(library, start, end):
    steps = np.empty(len(start), np.int32)
    pointers = [ctypes.c_void_p(one.ctypes.data) for one in (start, end, steps)]
    library.many(*pointers, ctypes.c_size_t(len(steps)))
    return steps


@compiles_c
@pytest.mark.parametrize("connectivity", [8, pytest.param(4, marks=pytest.mark.full)])
@pytest.mark.parametrize(
    ("free", "has_labels"),
    [
        (mosaic(0, 2, 7), False),
        (mosaic(3, 2, 7), True),
        *(pytest.param(free, False, marks=pytest.mark.full) for free in (ISLANDS, drawn("."), drawn("##"))),
    ],
)
def test_c_headers_return_path_lengths_rounded_down(free, has_labels, connectivity, tmp_path, monkeypatch):
    if has_labels:
        monkeypatch.setattr(grid_corners, "MOST_IN_TABLE", 0)
    graph = GridGraph(free, connectivity=connectivity)
    library, header = compiled(construct_grid_pairs(graph), tmp_path)
    is_open, room = opened(library, header.table)  # the library reads the room
    assert is_open == 1 and library.checked() == 1
    x, y = all_pairs(np.ones_like(free))
    start, end = ((points[:, 1] * free.shape[1] + points[:, 0]).astype(np.uint32) for points in (x, y))
    lengths = graph.between(x, y)
    expected = np.where(np.isfinite(lengths), lengths + 1e-9, -1).astype(int)
    np.testing.assert_array_equal(answered(library, start, end), expected)
    outside = np.array([free.size, 2**32 - 1], np.uint32)
    assert (answered(library, outside, start[[0, 0]]) == -1).all()
    assert (answered(library, start[[0, 0]], outside) == -1).all()
    del room


@compiles_c
def test_c_headers_refuse_other_tables_and_are_c_plus_plus(tmp_path):
    pairs = [construct_grid_pairs(GridGraph(mosaic(seed, 2, 8))) for seed in range(2)]
    library, header = compiled(pairs[0], tmp_path)
    assert opened(library, pairs[1].c_header("here").table)[0] == 0
    assert opened(library, header.table[:-1])[0] == 0 and opened(library, b"x" + header.table[1:])[0] == 0
    damaged = header.table[:100] + bytes([header.table[100] ^ 1]) + header.table[101:]
    taken, room = opened(library, damaged)
    assert taken == 1 and library.checked() == 0
    del room
    if (plus := shutil.which("c++")) is not None:
        code = '#include "here.h"\n#include "here.h"\nint main() { return here_steps(0, 1); }\n'
        (tmp_path / "a.cpp").write_text(code)
        subprocess.run([plus, *STRICT, "-Wno-unused-function", "-fsyntax-only", tmp_path / "a.cpp"], check=True)
    with pytest.raises(ValueError, match="a C identifier"):
        pairs[0].c_header("1")
