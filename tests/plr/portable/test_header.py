"""Headers of C: they compile without a warning, as C99 and as C++, are small, and answer as ``plr.numpy()`` does."""

import ctypes
import platform
import re
import shutil
import subprocess

import numpy as np
import pytest
from portable_helpers import CASES, case, hard_points, is_far

from plr_jax.plr.portable.text import CWriter

STRICT = ["-Wall", "-Wextra", "-Werror", "-pedantic", "-Wconversion", "-Wshadow", "-ffp-contract=off"]
MOST_CODE = 2048  # bytes


@pytest.fixture(scope="module")
def compiler():
    found = shutil.which("cc")
    if found is None:
        pytest.skip("headers are compiled where there is a C compiler called cc")
    return found


@pytest.fixture(params=CASES)
def plr(request):
    return case(request.param)


def header(plr, folder):
    (folder / "plr_here.h").write_text(plr.c_header("plr_here"))
    return folder / "plr_here.h"


def has_waypoints(plr):
    return plr.leaf.name == "cone"


def compiled(plr, folder, compiler):
    """Answers, and waypoints of cones, of a program of its own."""
    header(plr, folder)
    real, dim = "double" if is_far(plr) else "float", plr.dim
    lines = ['#include "plr_here.h"', f"void distances(const {real} *x, float *value, uint32_t n);"]
    lines += [f"void distances(const {real} *x, float *value, uint32_t n) {{"]
    lines += [f"    for (uint32_t i = 0; i < n; ++i) {{ value[i] = plr_here_distance(x + {dim} * i); }}", "}"]
    if has_waypoints(plr):
        lines += [f"void waypoints(const {real} *x, {real} *way, uint32_t n);"]
        lines += [f"void waypoints(const {real} *x, {real} *way, uint32_t n) {{"]
        lines += [
            f"    for (uint32_t i = 0; i < n; ++i) {{ plr_here_waypoint(x + {dim} * i, way + {dim} * i); }}",
            "}",
        ]
    (folder / "all.c").write_text("\n".join(lines) + "\n")
    options = ["-std=c99", *STRICT, "-O2", "-shared", "-fPIC"]
    subprocess.run([compiler, *options, folder / "all.c", "-o", folder / "all.so", "-lm"], check=True)
    return ctypes.CDLL(str(folder / "all.so"))


def called(function, x, answers):
    function(
        *(ctypes.c_void_p(array.ctypes.data) for array in (x, answers)),
        ctypes.c_uint32(len(x)),
    )
    return answers


def test_answers_are_those_of_numpy_bit_for_bit(plr, tmp_path, compiler):
    library, f = compiled(plr, tmp_path, compiler), plr.numpy()
    x = np.ascontiguousarray(hard_points(plr, 20_000))
    value, expected = called(library.distances, x, np.empty(len(x), np.float32)), f(x)
    is_nan = np.isnan(expected)
    np.testing.assert_array_equal(np.isnan(value), is_nan)
    np.testing.assert_array_equal(value[~is_nan].view(np.uint32), expected[~is_nan].view(np.uint32))
    if has_waypoints(plr):
        np.testing.assert_array_equal(called(library.waypoints, x, np.empty_like(x)), f.waypoint(x))


def test_the_comment_says_of_which_type_coordinates_are(plr):
    text = plr.c_header("plr_here")
    real = re.search(r"float plr_here_distance\(const (float|double) x\[", text)[1]
    assert real == ("double" if is_far(plr) else "float")
    assert f"\n   Coordinates are {real}: " in text[: text.index("*/")]


def test_headers_are_valid_c_plus_plus_too(plr, tmp_path, compiler):
    if (plus := shutil.which("c++")) is None:
        pytest.skip("headers are compiled as C++ where there is a compiler called c++")
    header(plr, tmp_path)
    (tmp_path / "a.cpp").write_text('#include "plr_here.h"\n#include "plr_here.h"\nint main() { return 0; }\n')
    subprocess.run([plus, *STRICT, "-fsyntax-only", tmp_path / "a.cpp"], check=True)


def test_code_is_small_and_asks_for_nothing(plr, tmp_path, compiler):
    if shutil.which("size") is None or shutil.which("nm") is None or platform.machine() != "x86_64":
        pytest.skip("the size of code is limited on x86-64, where there are size and nm")
    header(plr, tmp_path)
    real = "double" if is_far(plr) else "float"
    asked = f"float f(const {real} *x);\nfloat f(const {real} *x) {{ return plr_here_distance(x); }}\n"
    if has_waypoints(plr):
        arguments = f"const {real} *x, {real} *way"
        asked += f"void g({arguments});\nvoid g({arguments}) {{ plr_here_waypoint(x, way); }}\n"
    (tmp_path / "a.c").write_text('#include "plr_here.h"\n' + asked)
    subprocess.run([compiler, "-std=c99", *STRICT, "-Os", "-c", "a.c", "-o", "a.o"], check=True, cwd=tmp_path)
    sizes = subprocess.run(["size", "-A", "a.o"], check=True, cwd=tmp_path, capture_output=True, text=True).stdout
    assert 0 < int(re.search(r"^\.text\s+(\d+)", sizes, re.MULTILINE)[1]) <= MOST_CODE
    missing = subprocess.run(["nm", "-u", "a.o"], check=True, cwd=tmp_path, capture_output=True, text=True).stdout
    assert set(missing.split()) <= {"U", "sqrtf", "_GLOBAL_OFFSET_TABLE_"}


def test_two_headers_live_side_by_side(tmp_path, compiler):
    text = case("car").c_header("a") + case("maze of cones").c_header("b")
    (tmp_path / "a.c").write_text(text + "int main(void) { return 0; }\n")
    subprocess.run([compiler, "-std=c99", *STRICT, "-fsyntax-only", tmp_path / "a.c"], check=True)


@pytest.mark.parametrize("name", ["", "1a", "a b", "a-b", "é", None, "_a", "a;"])
def test_names_are_identifiers(name):
    with pytest.raises(ValueError, match="identifier of C"):
        case("one leaf").c_header(name)


@pytest.mark.parametrize(
    ("build", "text"),
    [
        (lambda x, y, z: x + y + z, "x + y + z"),
        (lambda x, y, z: x + (y + z), "x + (y + z)"),
        (lambda x, y, z: x - (y - z) * x, "x - (y - z) * x"),
        (lambda x, y, z: x * (y * z), "x * (y * z)"),
        (lambda x, y, z: -(x + y) * z, "-(x + y) * z"),
        (lambda x, y, z: x - np.float32(-0.5), "x + 0.5f"),
        (lambda x, y, z: x - np.float32(0), "x"),
        (lambda x, y, z: x * np.float32(1) + np.float64(0.1), "x + 0.1"),
        (lambda x, y, z: np.float32(-1e-30) * x, "-1e-30f * x"),
        (lambda x, y, z: (x < y) & (z >= np.float32(np.inf)), "x < y && z >= INFINITY"),
    ],
)
def test_texts_keep_the_order_of_operations(build, text):
    do = CWriter("a")
    assert str(build(*(do.atom(name) for name in "xyz"))) == text
