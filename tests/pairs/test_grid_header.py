"""Headers of grids: they compile without a warning, as C99 and as C++, and answer what Python does."""

import ctypes
import shutil
import subprocess

import numpy as np
import pytest
from grid_helpers import all_pairs, drawn, mosaic

from experiments._c_headers import STRICT, compiled_library
from plr_jax import GridGraph, construct_grid_pairs
from plr_jax.pairs import grid_corners

ISLANDS = np.indices((9, 12)).sum(axis=0) % 2 == 0


pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="headers are compiled by a C compiler called cc")


def compiled(pairs, folder):
    """The functions of a header, with its table open."""
    header = pairs.c_header("here")
    (folder / "here.h").write_text(header.text)
    signatures = {
        "many": (
            "void",
            "const uint32_t *a, const uint32_t *b, int32_t *s, size_t n",
            "here_steps_of_pairs(a, b, s, n)",
        ),
        "opened": ("int", "const void *data, size_t size", "return here_open(data, size)"),
        "checked": ("int", "void", "return here_check()"),
        "units": ("int32_t", "uint32_t a, uint32_t b", "return here_units(a, b)"),
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


def answers(library, start, end):
    steps = np.empty(len(start), np.int32)
    pointers = [ctypes.c_void_p(one.ctypes.data) for one in (start, end, steps)]
    library.many(*pointers, ctypes.c_size_t(len(steps)))
    return steps


@pytest.mark.parametrize("connectivity", [4, 8])
@pytest.mark.parametrize(
    "free", [mosaic(0, 2, 11), ISLANDS, drawn("."), drawn("##")], ids=["mosaic", "islands", "one", "none"]
)
def test_answers_are_those_of_python(free, connectivity, tmp_path):
    pairs = construct_grid_pairs(GridGraph(free, connectivity=connectivity))
    library, header = compiled(pairs, tmp_path)
    is_open, room = opened(library, header.table)
    assert is_open == 1 and library.checked() == 1
    x, y = all_pairs(np.ones_like(free))
    start, end = ((points[:, 1] * free.shape[1] + points[:, 0]).astype(np.uint32) for points in (x, y))
    found = answers(library, start, end)
    expected = np.asarray(pairs.window(y, x, 0))[:, 0, 0]
    np.testing.assert_array_equal(found, expected)
    if connectivity == 4:
        np.testing.assert_array_equal(found, np.where(np.isinf(pairs(x, y)), -1, pairs(x, y)))
    outside = np.array([free.size, 2**32 - 1], np.uint32)
    assert (answers(library, outside, start[[0, 0]]) == -1).all() and (
        answers(library, start[[0, 0]], outside) == -1
    ).all()
    del room


def test_labels_of_many_corners_are_read_as_well(tmp_path, monkeypatch):
    monkeypatch.setattr(grid_corners, "MOST_IN_TABLE", 0)
    test_answers_are_those_of_python(mosaic(3, 2, 9), 8, tmp_path)


def test_other_tables_are_refused_and_headers_are_valid_c_plus_plus(tmp_path):
    pairs = [construct_grid_pairs(GridGraph(mosaic(seed, 2, 8))) for seed in range(2)]
    library, header = compiled(pairs[0], tmp_path)
    assert opened(library, pairs[1].c_header("here").table)[0] == 0
    assert opened(library, header.table[:-1])[0] == 0 and opened(library, b"x" + header.table[1:])[0] == 0
    damaged = header.table[:100] + bytes([header.table[100] ^ 1]) + header.table[101:]
    taken, room = opened(library, damaged)
    assert taken == 1 and library.checked() == 0
    del room
    if (plus := shutil.which("c++")) is not None:
        (tmp_path / "a.cpp").write_text(
            '#include "here.h"\n#include "here.h"\nint main() { return here_steps(0, 1); }\n'
        )
        subprocess.run([plus, *STRICT, "-Wno-unused-function", "-fsyntax-only", tmp_path / "a.cpp"], check=True)
    with pytest.raises(ValueError, match="identifier of C"):
        pairs[0].c_header("1")
