"""Headers of C: they compile without a warning, as C99 and as C++, are small, and answer as ``plr.numpy()`` does."""

import platform
import re
import shutil
import subprocess

import numpy as np
import pytest
from portable_helpers import case, hard_points, is_far, same_bits

from experiments._c_headers import STRICT, compiled_header, object_for_size, section_bytes
from plr_jax.plr.portable.c import CWriter

MOST_CODE = 2048  # bytes


@pytest.fixture(scope="module")
def compiler():
    found = shutil.which("cc")
    if found is None:
        pytest.skip("headers are compiled where there is a C compiler called cc")
    return found


# Those of which the text has parts that no other has.
KINDS = "maze of planes, maze of gradients, cones in space, one leaf, random planes on a line, random values, deep"
KINDS += ", values in six dimensions, around, smooth around, folded car of planes, far cones, far around"
KINDS += ", far folded car"


@pytest.mark.full
@pytest.mark.parametrize("name", KINDS.split(", "))
def test_answers_are_those_of_numpy_and_code_is_small_and_valid_c_plus_plus_too(name, tmp_path, compiler):
    plr = case(name)
    in_c, f, x = compiled_header(plr, tmp_path), plr.numpy(), hard_points(plr, 20_000)
    assert in_c.real == x.dtype and same_bits(in_c(x), f(x))
    if plr.leaf.name == "cone":
        assert same_bits(in_c.waypoints(x), f.waypoint(x))
    text = plr.c_header("plr_here")
    real = re.search(r"float plr_here_distance\(const (float|double) x\[", text)[1]
    assert real == ("double" if is_far(plr) else "float")
    assert f"\n   Coordinates are {real}: " in text[: text.index("*/")]
    if (plus := shutil.which("c++")) is not None:
        (tmp_path / "plr_here.h").write_text(text)
        (tmp_path / "a.cpp").write_text('#include "plr_here.h"\n#include "plr_here.h"\nint main() { return 0; }\n')
        subprocess.run([plus, *STRICT, "-fsyntax-only", tmp_path / "a.cpp"], check=True)
    if shutil.which("size") is not None and shutil.which("nm") is not None and platform.machine() == "x86_64":
        compiled = object_for_size(plr, tmp_path)
        sizes = section_bytes(compiled)
        assert 0 < sizes["code"] <= MOST_CODE
        told = int(re.search(r"Compiled, its tables take ([\d,]+) bytes", text)[1].replace(",", ""))
        assert told <= sizes["data"] <= told + 256  # with the constants of its code
        missing = subprocess.run(["nm", "-u", compiled], check=True, capture_output=True, text=True).stdout
        assert set(missing.split()) <= {"U", "sqrtf", "_GLOBAL_OFFSET_TABLE_"}


@pytest.mark.full
@pytest.mark.parametrize("names", [("a", "b"), ("a", "A"), ("a", "a_H"), ("Maze", "maze")])
def test_two_headers_live_side_by_side(names, tmp_path, compiler):
    text = "".join(case(of).c_header(name) for of, name in zip(("folded car", "maze of cones"), names, strict=True))
    call = "".join(f"{name}_distance(&x[{i}]) + " for i, name in enumerate(names))
    main = f"int main(void) {{ static const float x[4] = {{0}}; return {call}0 > 0; }}\n"
    (tmp_path / "a.c").write_text(text + main)
    subprocess.run([compiler, "-std=c99", *STRICT, "-fsyntax-only", tmp_path / "a.c"], check=True)


@pytest.mark.usefixtures("unchecked_types")
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


@pytest.mark.full
@pytest.mark.parametrize("name", ["far around", "far folded car", "around"])
def test_no_conversion_is_undefined(name, compiler, tmp_path):
    """Of numbers that are none and infinite ones, too: what no integer holds is not converted to one."""
    plr = case(name)
    rows = ", ".join("{" + ", ".join([value] * plr.dim) + "}" for value in ("NAN", "INFINITY", "-INFINITY", "1e30f"))
    real = "double" if is_far(plr) else "float"
    main = f"int main(void) {{ static const {real} x[4][{plr.dim}] = {{{rows}}}; int i, finite = 0;"
    main += " for (i = 0; i < 4; ++i) finite += here_distance(x[i]) < INFINITY; return finite; }"
    (tmp_path / "a.c").write_text(plr.c_header("here") + main)
    traps = ["-fsanitize=float-cast-overflow", "-fsanitize-undefined-trap-on-error"]
    subprocess.run([compiler, "-std=c99", *traps, "a.c", "-o", "a", "-lm"], cwd=tmp_path, check=True)
    subprocess.run(["./a"], cwd=tmp_path, check=True)
