"""Readers without JAX, in NumPy, C and JavaScript, answer as a slow reader that follows the words of the format."""

import pickle
import platform
import re
import shutil
import subprocess
import sys
import zlib
from functools import partial

import jax
import numpy as np
import pytest
import shapely
from hostile_files import mutated
from portable_helpers import SlowReader, case, compiled_answers, full, hard_points, is_far, same_bits
from vectors import FOLDER, read_vector, vector_names

from experiments._c_headers import STRICT, compiled_header, object_for_size, section_bytes, stack_bytes
from experiments._js_modules import NodeModule
from plr_jax import Box, Euclidean, VisibilityGraph, Workspace, construct, construct_pairs, load_numpy, stack
from plr_jax.guides import c_and_javascript
from plr_jax.plr import NumpyPLR
from plr_jax.plr._file import decode, encode
from plr_jax.plr.portable.c import CEmitter
from plr_jax.plr.portable.javascript import JavaScriptEmitter, float32_literal, js_cone_reader, js_file_reader
from plr_jax.plr.portable.numpy import LeafTable
from plr_jax.scenes import maze

TINY = np.finfo(np.float32).tiny  # XLA takes smaller numbers for 0

# The reader in NumPy, ``plr.numpy()``, against a slow reader that follows the words of the format, and ``plr(x)``.


QUICK = ("one leaf", "random planes on a line", "random planes", "deep", "maze of cones", "maze of gradients")
QUICK += ("around twice", "folded car", "far cones", "far around")
LONG = ("values in six dimensions", "cones in space", "folded car of planes", "far folded car", "straight lines")


@pytest.fixture(params=[*QUICK, *full(*LONG)])
def plr(request):
    return case(request.param)


def test_single_points_and_small_arrays_equal_batches(plr):
    f, x = plr.numpy(), hard_points(plr, 12).astype(np.float64)
    for answers in (f, f.waypoint) if plr.leaf.name == "cone" else (f,):
        expected = answers(x)
        parts = np.array_split(np.arange(len(x)), len(x) // 8)
        assert same_bits(np.concatenate([answers(x[part]) for part in parts]), expected)
        assert same_bits([answers(tuple(point)) for point in x.tolist()], expected)
    for given in (x.tolist(), x):
        assert same_bits([f(point) for point in given], f(x))
    assert isinstance(f(tuple(x[0].tolist())), np.float32)
    assert same_bits(pickle.loads(pickle.dumps(f))(x), f(x))
    for factor in (1 - 1e-9, 1 + 1e-9, 1 + 1e-7):  # beside faces, in 64 bits
        assert same_bits([f(tuple(point)) for point in (x * factor).tolist()], f(x * factor))
    x[::2, 0] = np.nan
    x[::3, -1] = plr.domain.hi[-1] + 2 * plr.domain.width[-1]
    for outside in ("inf", "clamp", "nan"):
        assert same_bits([f(tuple(p), outside=outside) for p in x.tolist()], f(x, outside=outside))
        assert same_bits(f(x[:8], outside=outside), f(x, outside=outside)[:8])


def points_around(plr):
    """Return hard points, points beside faces of cells, and points of a box five times as wide as the domain."""
    x, rng = hard_points(plr, 500, seed=2), np.random.default_rng(1)
    around = plr.domain.lo + plr.domain.width * rng.uniform(-2, 3, (1000, plr.dim))
    beside = rng.integers(0, 129, (1000, plr.dim)) / 128 + rng.uniform(-1, 1, (1000, plr.dim)) * 2.0**-22
    x = np.concatenate([x, around.astype(x.dtype), (plr.domain.lo + plr.domain.width * beside).astype(x.dtype)])
    x[np.abs(x) < TINY] = 0
    return x


def test_numpy_answers_outside_the_domain(plr):
    f, x = plr.numpy(), points_around(plr)
    is_outside, is_finite = np.isinf(f(x)), np.isfinite(x).all(axis=1)
    assert is_outside.sum() > 20 and np.isnan(f(x, outside="nan"))[is_outside].all()
    clamped = f(x, outside="clamp")
    assert np.isinf(clamped[is_outside & ~is_finite]).all() and np.isfinite(clamped[is_finite]).all()
    for outside in ("clamp", "nan"):
        assert same_bits(f(x, outside=outside)[~is_outside], f(x)[~is_outside])


FULL = ("maze of planes", "random planes on a line", "cones in space", "random values", "around", "smooth around")


@pytest.mark.parametrize("name", ["maze of gradients", "deep", "folded car", "estimate of planes", *full(*FULL)])
def test_numpy_answers_equal_compiled_answers(name):
    plr = case(name)
    f, x = plr.numpy(), points_around(plr)

    @jax.jit
    def compiled(x):
        clamped = plr(x, outside="clamp")
        return plr(x), clamped, 0.5 * clamped  # nothing is fused with what a caller computes

    clamped = f(x, outside="clamp")
    for answer, expected in zip(map(np.asarray, compiled(x)), (f(x), clamped, 0.5 * clamped), strict=True):
        np.testing.assert_array_equal(answer, expected)  # but for the sign of zero
        assert same_bits(answer[expected != 0], expected[expected != 0].astype(np.float32))


SIX = "values_in_six_dimensions"  # takes a second to trace; values in fewer dimensions are quick


@pytest.mark.parametrize("name", [*full(SIX), *(name for name in vector_names() if name != SIX)])
def test_stored_answers_are_reproduced_bit_for_bit(name):
    """Every reader must give the answers in ``tests/plr/vectors``, and files keep their bytes."""
    (x, expected, waypoints), path = read_vector(name), FOLDER / f"{name}.plr"
    f, plr = load_numpy(path), case(name)
    known = ((x == 0) | ~(np.abs(x) < TINY)).all(axis=1)
    assert same_bits(f(x), expected) and same_bits(SlowReader(plr)(x[::4]), expected[::4])
    if waypoints is not None:
        assert same_bits(f.waypoint(x), waypoints)
        np.testing.assert_array_equal(plr.waypoint(x)[known], waypoints[known])
    assert encode(decode(path.read_bytes())) == path.read_bytes()
    answer = compiled_answers(plr, x)
    if is_far(plr) and any(plr.domain.periodic):  # JAX wraps by an exact remainder
        near = ~((np.abs(x) > 1e9) & np.isfinite(x)).any(axis=1)  # farther around, answers differ
        np.testing.assert_allclose(answer[near], expected[near], rtol=3e-7)
        assert np.mean((answer == expected)[near]) > 0.9
        return
    assert known.mean() > 0.8
    assert same_bits(answer[known], expected[known])


def test_numpy_bounds_equal_those_of_jax():
    plr, plain = case("maze of cones"), case("random planes").numpy()
    size = f"NumpyPLR('cone', dim=2, num_leaves={plr.num_leaves}, max_error={plr.max_error:.3g}"
    assert repr(plr.numpy()) == f"{size}, Box([0.0, 0.0], [1.0, 1.0]))"
    x, f = hard_points(plr, 500), plr.numpy()
    x[np.abs(x) < TINY] = 0
    for mine, theirs in zip(f.bounds(x), jax.jit(plr.bounds)(x), strict=True):
        assert same_bits(mine, theirs)
    assert f.max_error == plr.max_error and f.domain == plr.domain and f.dim == 2 and plain.max_error is None
    assert f.to_bytes() == plr.to_bytes()
    for call, message in ((plain.bounds, "Nothing is proven"), (plain.waypoint, "have no sources")):
        with pytest.raises(ValueError, match=message):
            call(np.zeros((1, 5)))


SHAPES = (0.5, [], [0.1], [0.1, 0.2, 0.3], [[0.1]], np.zeros((3, 3)))


@pytest.mark.parametrize(
    ("x", "message"),
    [
        *((x, rf"shape \(\.\.\., 2\), got {re.escape(str(np.shape(x)))}") for x in SHAPES),
        *((x, "real numbers") for x in ("ab", ["a", "b"], [1j, 0], jax.numpy.zeros((2, 2), complex), [5.0, "a"])),
        *((x, "Points must") for x in ([[1], [2, 3]], [None, 1], [5.0, None], [5.0, 1j], [5.0, [1, 2]])),
    ],
)
@pytest.mark.usefixtures("unchecked_types")
def test_points_of_wrong_shape_or_type_raise(x, message):
    for answer in (case("maze of planes"), case("maze of planes").numpy()):
        with pytest.raises(ValueError, match=message):
            answer(x)


@pytest.mark.usefixtures("unchecked_types")
def test_traced_points_raise_where_numpy_would_have_to_read_them():
    plr, pairs = case("maze of cones"), construct_pairs(Workspace(((0, 0), (1, 1))), max_bytes=100)
    reader, both = plr.numpy(), partial(jax.grad(pairs), y=[0.5, 0.5])
    of_reader = (jax.grad(reader), jax.jit(reader.leaf), jax.vmap(reader.bounds), jax.jit(reader.waypoint))
    calls = [(call, jax.numpy.full(2, 0.5)) for call in of_reader]
    of_lists = (jax.grad(plr), jax.grad(plr.lower), jax.jit(plr.waypoint), jax.jit(partial(stack([plr]), 0)), both)
    for call, x in [*calls, *((call, [0.5, 0.5]) for call in of_lists)]:
        with pytest.raises(
            ValueError, match=r"Tracer.* JAX traces them: use load instead of load_numpy, and pass one"
        ):
            call(x)


def test_points_of_any_layout_and_type_get_the_same_answers(monkeypatch):
    f = case("maze of planes").numpy()
    x = np.random.default_rng(0).random((3, 4, 2))
    expected = f(x)
    assert expected.shape == (3, 4) and f(x[:0]).shape == (0, 4)
    assert same_bits(f(np.asfortranarray(x)), expected) and same_bits(f(x[::-1, ::2]), expected[::-1, ::2])
    for half in (x.astype(np.float16), jax.numpy.asarray(x, jax.numpy.bfloat16)):
        assert same_bits(f(half), f(np.asarray(half, np.float32)))
    assert f([0, 1]) == f(np.array([0, 1])) == f((0.0, 1.0))
    assert np.isnan(f(np.ma.masked_array([[0.5, 0.5]], [[True, False]]))).all()
    monkeypatch.setattr("plr_jax.plr.portable.numpy._CHUNK", 7)
    assert same_bits(f(x), expected)


@pytest.mark.parametrize("bits", [0, 1, 5])
def test_lookup_tables_of_any_size_give_the_same_answers(bits, monkeypatch):
    one = case("one leaf").numpy()._table
    assert isinstance(one, LeafTable) and one.is_flat and len(one.table) == 1
    names = ("deep", "random planes", "maze of values")
    expected = [case(name).numpy()(hard_points(case(name), 20)) for name in names]
    monkeypatch.setattr("plr_jax.plr.portable.numpy._MOST_BITS", bits)
    for name, answers in zip(names, expected, strict=True):
        f, x = NumpyPLR(case(name).to_bytes()), hard_points(case(name), 20)
        assert not f._table.is_flat
        assert same_bits(f(x), answers) and same_bits([f(tuple(p)) for p in x.tolist()], answers)


def test_point_rounded_below_the_domain_is_in_the_lowest_leaf():
    """As 32-bit floats resolve 1e-6 there, the lower end is rounded to one below it."""
    lo = 11 + 0.45 * 2.0**-20
    plr = construct(lambda x: np.where(x[:, 0] < 12, 1.0, 50.0), Box((lo, 0), (15, 1)), max_leaves=30)
    lowest = np.array([[np.float32(lo), 0.5]], np.float32)
    assert float(lowest[0, 0]) < lo and not is_far(plr)
    assert plr(lowest)[0] == pytest.approx(1) and plr.numpy()(lowest)[0] == pytest.approx(1)


def test_subnormal_coordinates_beyond_an_end_at_zero_are_outside():
    """XLA computes with them as with 0."""
    tiny = np.array([-1e-38, -1e-45, 0, -0.0, 1e-45, 1e-38], np.float32)
    x = np.concatenate([np.stack([tiny, tiny * 0 - 0.5], 1), np.stack([tiny * 0 + 0.5, tiny], 1)])
    plr = construct(Euclidean((0.5, -0.5)), Box((0, -1), (1, 0)), max_leaves=5)
    for answers in (plr.numpy(), jax.jit(plr)):
        np.testing.assert_array_equal(np.isinf(answers(x)), (x[:, 0] < 0) | (x[:, 1] > 0))


def test_files_of_earlier_releases_with_straight_lines_raise():
    refused = {path.stem for path in FOLDER.glob("*.plr")} - set(vector_names())
    assert len(refused) == 3 and sum(path.stat().st_size for path in FOLDER.iterdir()) < 500_000
    for name in refused:
        with pytest.raises(ValueError, match=r"cannot be read as a PLR.*straight lines.* plr_jax 0.1 reads"):
            load_numpy(FOLDER / f"{name}.plr")


def test_files_are_read_without_jax():
    code = f"""
import pathlib, sys
import plr_jax
folder = pathlib.Path({str(FOLDER)!r})
f = plr_jax.load_numpy(folder / "maze_of_cones.plr")
print(f((0.93, 0.95)), f.waypoint([0.93, 0.95]), f.bounds([[0.93, 0.95]]))
heavy = {{"jax", "scipy", "shapely", "networkx", "matplotlib", "typer"}} & set(sys.modules)
for path in folder.glob("*.json"):
    plr_jax.load_numpy(path.with_suffix(".plr"))
heavy |= {{"jax"}} & set(sys.modules)
sys.exit(str(heavy) if heavy else 0)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0 and done.stderr == "", done.stderr
    assert float(done.stdout.split()[0]) == pytest.approx(float(case("maze of cones")([0.93, 0.95])), rel=1e-6)


# Headers of C: they compile without a warning, as C99 and as C++, are small, and answer as ``plr.numpy()`` does.


@pytest.fixture
def compiler():
    return shutil.which("cc") or pytest.skip("needs a C compiler called cc")


# Each has parts of the text that no other has.
KINDS = ("maze of planes", "maze of gradients", "cones in space", "one leaf", "random planes on a line", "deep")
KINDS += ("values in six dimensions", "smooth around", "folded car of planes", "far cones", "far folded car")
KINDS += ("straight lines", "estimate of planes")
COMPACT = pytest.mark.parametrize("compact", [False, True], ids=["tables", "compact"])


def cost_of(text):
    """Return what a header says about itself: bytes of tables, code and stack, and the types of its numbers."""
    said = r"On a Cortex-M4: (\S+) bytes of tables, at most (\S+) of code, (\S+) of stack; (.*) numbers\."
    *limits, kinds = re.search(said, text).groups()
    return [*(int(limit.replace(",", "")) for limit in limits), kinds]


@pytest.mark.full
@COMPACT
@pytest.mark.parametrize("name", KINDS)
def test_c_headers_are_valid_and_small_and_answer_as_numpy(name, compact, tmp_path, compiler):
    plr = case(name)
    in_c, f, x = compiled_header(plr, tmp_path, compact), plr.numpy(), hard_points(plr, 5000)
    assert in_c.real == x.dtype and same_bits(in_c(x), f(x))
    if plr.leaf.name == "cone":
        assert same_bits(in_c.waypoints(x), f.waypoint(x))
    text = plr.c_header("plr_here", compact)
    assert f"\n   Coordinates are {'double' if is_far(plr) else 'float'}: " in text
    if (plus := shutil.which("c++")) is not None:
        (tmp_path / "plr_here.h").write_text(text)
        (tmp_path / "a.cpp").write_text('#include "plr_here.h"\n#include "plr_here.h"\nint main() { return 0; }\n')
        subprocess.run([plus, *STRICT, "-fsyntax-only", tmp_path / "a.cpp"], check=True)
    if shutil.which("size") is not None and shutil.which("nm") is not None and platform.machine() == "x86_64":
        compiled = object_for_size(plr, tmp_path, compact)
        sizes = section_bytes(compiled)
        assert 0 < sizes["code"] <= (4608 if compact else 2048) and stack_bytes(compiled) <= 4096
        tables, _, _, kinds = cost_of(text)
        assert tables <= sizes["data"] <= tables + 256  # with the constants of its code
        if kinds == "float" and shutil.which("objdump") is not None:
            code = subprocess.run(["objdump", "-d", compiled], check=True, capture_output=True, text=True).stdout
            assert "addss" in code and not re.search(r"\b(cvtss2sd|cvtps2pd|(add|sub|mul|div)sd)\b", code)
        missing = subprocess.run(["nm", "-u", compiled], check=True, capture_output=True, text=True).stdout
        assert set(missing.split()) <= {"U", "sqrtf", "_GLOBAL_OFFSET_TABLE_", *["memcpy", "memset"] * compact}


WALKER = """
#undef main
int main(void)
{
    float x[2], next[2];
    while (scanf("%f %f", &x[0], &x[1]) == 2) {
        int steps = 0;
        printf("%.9g %.9g", x[0], x[1]);
        maze_waypoint(x, next);
        do
            printf(" %.9g %.9g", next[0], next[1]);
        while (++steps < 99 && maze_distance(next) > 1e-5f && arrive(x, next));
        puts("");
    }
}
"""


@pytest.mark.full
@pytest.mark.parametrize("is_hall", [False, True], ids=["maze", "hall"])
def test_robots_that_follow_waypoints_as_in_the_guide_arrive(is_hall, tmp_path, compiler):
    """Even where a file is so small that the leaf at a corner measures distances from this corner."""
    workspace, goal = maze().workspace, maze().goals[0]
    if is_hall:  # of 30 m by 20 m, with 27 shelves, for a robot with a radius of 0.35 m
        shelves = [shapely.box(x, y, x + 1.2, y + 4) for x in range(2, 28, 3) for y in (2, 8, 14)]
        grown = [shelf.buffer(0.35, join_style="mitre") for shelf in shelves]
        workspace, goal = Workspace(((0.35, 0.35), (29.65, 19.65)), grown), (29.0, 19.0)
    plr = construct(VisibilityGraph(workspace, goal), workspace.bounds, leaf="cone", max_bytes=1024 * (1 + is_hall))
    (tmp_path / "maze.h").write_text(plr.c_header("maze", compact=is_hall))
    code = re.findall(r"^```c\n(.*?)^```", str(c_and_javascript.__doc__), re.MULTILINE | re.DOTALL)[0]
    (tmp_path / "walk.c").write_text(f"#define main example\n{code}{WALKER}")
    command = [compiler, "-std=c99", "-O2", "-ffp-contract=off", "walk.c", "-o", "walk", "-lm"]
    subprocess.run(command, cwd=tmp_path, check=True)
    starts = workspace.sample_free(10_000, seed=1)
    given = "\n".join(f"{x:.9g} {y:.9g}" for x, y in starts)
    done = subprocess.run([tmp_path / "walk"], input=given, check=True, capture_output=True, text=True)
    paths = [np.array(line.split(), float).reshape(-1, 2) for line in done.stdout.splitlines()]
    assert len(paths) == len(starts)
    size = workspace.bounds.width.max()
    np.testing.assert_allclose([path[-1] for path in paths], np.broadcast_to(goal, starts.shape), atol=1e-6 * size)
    # Few starts, in leaves beside corners, do not see their waypoint. All later segments are free.
    outer = shapely.box(*workspace.bounds.lo, *workspace.bounds.hi)
    inner = shapely.difference(outer, workspace.free_space).buffer(-1e-4 * size)
    shapely.prepare(inner)
    later = [shapely.MultiPoint(path) if len(path) < 3 else shapely.LineString(path[1:]) for path in paths]
    assert not shapely.intersects(inner, later).any()
    lengths = shapely.length([shapely.LineString(path) for path in paths])
    np.testing.assert_allclose(lengths, VisibilityGraph(workspace, goal)(starts), rtol=0.01, atol=1e-3 * size)


ARM = ["arm-none-eabi-gcc", "-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16"]
ARM += ["-fno-math-errno", "-ffunction-sections"]


def stack_of_calls(graph):
    """Return the bytes of stack of the longest chain of calls in what GCC writes for ``-fcallgraph-info=su``."""
    frames = {name: int(size) for name, size in re.findall(r'title: "(\S+)" label: "\S+?\\n.*\\n(\d+) bytes', graph)}
    calls = {name: set() for name in frames}
    for caller, called in re.findall(r'sourcename: "(\S+)" targetname: "(\S+)"', graph):
        calls[caller] |= {called} & frames.keys()

    def deepest(name):  # the only recursion calls itself 8 times
        below = max((deepest(other) for other in calls[name] - {name}), default=0)
        return frames[name] * (9 if name in calls[name] else 1) + below

    return max(map(deepest, frames))


@pytest.mark.full
@COMPACT
@pytest.mark.parametrize("name", ["maze of cones", "maze of values", *KINDS])
def test_c_headers_take_as_little_on_a_small_machine_as_they_say(name, compact, tmp_path):
    if shutil.which(ARM[0]) is None:
        pytest.skip("needs the cross compiler arm-none-eabi-gcc, with newlib")
    compiled = object_for_size(case(name), tmp_path, compact, [*ARM, "-fcallgraph-info=su"])
    tables, code, stack, kinds = cost_of(case(name).c_header("here", compact))
    link = ["-nostartfiles", "--specs=nosys.specs", "-Wl,--gc-sections,-e,f", compiled.name, "-o", "linked", "-lm"]
    link += ["-Wl,-u,g"] * (case(name).leaf.name == "cone")
    subprocess.run([*ARM, *link], cwd=tmp_path, check=True, capture_output=True)
    sizes = section_bytes(tmp_path / "linked")
    assert tables <= sizes["code"] + sizes["data"] <= tables + code
    assert stack_of_calls(compiled.with_suffix(".ci").read_text()) <= stack
    symbols = subprocess.run(["nm", "linked"], cwd=tmp_path, check=True, capture_output=True, text=True).stdout
    assert kinds == "float and double" or "__aeabi_dmul" not in symbols


@pytest.mark.full
@pytest.mark.parametrize("compact", [(False, True), (True, True)])
@pytest.mark.parametrize("names", [("a", "A"), ("a", "a_H")])
def test_two_headers_compile_side_by_side(names, compact, tmp_path, compiler):
    headers = zip(("folded car", "maze of cones"), names, compact, strict=True)
    text = "".join(case(of).c_header(name, is_compact) for of, name, is_compact in headers)
    call = "".join(f"{name}_distance(&x[{i}]) + " for i, name in enumerate(names))
    main = f"int main(void) {{ static const float x[4] = {{0}}; return {call}0 > 0; }}\n"
    (tmp_path / "a.c").write_text(text + main)
    subprocess.run([compiler, "-std=c99", *STRICT, "-fsyntax-only", tmp_path / "a.c"], check=True)


@COMPACT
@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize("name", ["", "1a", "a b", "a-b", "é", None, "_a", "a;"])
def test_names_that_are_no_c_identifiers_raise(name, compact):
    with pytest.raises(ValueError, match="a C identifier"):
        case("one leaf").c_header(name, compact)


@pytest.mark.full
@COMPACT
@pytest.mark.parametrize("name", ["far folded car", "around"])
def test_c_headers_convert_no_value_that_integers_lack(name, compact, compiler, tmp_path):
    plr = case(name)
    rows = ", ".join("{" + ", ".join([value] * plr.dim) + "}" for value in ("NAN", "INFINITY", "-INFINITY", "1e30f"))
    real = "double" if is_far(plr) else "float"
    main = f"int main(void) {{ static const {real} x[4][{plr.dim}] = {{{rows}}}; int i, finite = 0;"
    main += " for (i = 0; i < 4; ++i) finite += here_distance(x[i]) < INFINITY; return finite; }"
    (tmp_path / "a.c").write_text(plr.c_header("here", compact) + main)
    traps = ["-fsanitize=float-cast-overflow", "-fsanitize-undefined-trap-on-error"]
    subprocess.run([compiler, "-std=c99", *traps, "a.c", "-o", "a", "-lm"], cwd=tmp_path, check=True)
    subprocess.run(["./a"], cwd=tmp_path, check=True)


# Compact bytes are small, are read while a program runs, and do no harm if they are damaged.


READER = """
#include <stdio.h>
#include <stdlib.h>

int main(void)
{
    uint32_t size, i, axis;
    while (fread(&size, 4, 1, stdin) == 1) {
        unsigned char *bytes = (unsigned char *)malloc(size ? size : 1); /* so that no byte behind them may be read */
        struct plr_jax f;
        int error = fread(bytes, 1, size, stdin) != size;
        error = error ? 9 : plr_jax_open(&f, bytes, size);
        printf("%d", error);
        for (i = 0; !error && i < 40u; ++i) {
            float x[PLR_JAX_MAX_DIM], way[PLR_JAX_MAX_DIM];
            double y[PLR_JAX_MAX_DIM], far_way[PLR_JAX_MAX_DIM];
            for (axis = 0; axis < plr_jax_dim(&f); ++axis) {
                y[axis] = (double)((i * 7u + axis * 11u) & 31u) / 31.0;
                x[axis] = (float)y[axis];
            }
            printf(" %.9g", (double)plr_jax_distance(&f, x));
            if (plr_jax_is_far(&f)) {
                plr_jax_waypoint_far(&f, y, far_way);
                (void)plr_jax_distance_far(&f, y);
            } else {
                plr_jax_waypoint(&f, x, way);
            }
        }
        printf("\\n");
        free(bytes);
    }
    return 0;
}
"""


@pytest.fixture
def read_in_c(tmp_path, compiler):
    """Return a function from byte strings to the lines that ``READER`` prints; memory errors end the program."""
    (tmp_path / "reader.c").write_text(case("one leaf").c_header("here", compact=True) + READER)
    traps = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-O1"]
    command = [compiler, "-std=c99", *STRICT, *traps, "reader.c", "-o", "reader", "-lm"]
    subprocess.run(command, cwd=tmp_path, check=True)

    def read(every):
        given = b"".join(len(data).to_bytes(4, "little") + data for data in every)
        done = subprocess.run([tmp_path / "reader"], input=given, capture_output=True, check=False, timeout=200)
        assert done.returncode == 0, done.stderr.decode()
        return done.stdout.decode().splitlines()

    return read


def with_checksum(data):
    return data[:-4] + zlib.crc32(data[:-4]).to_bytes(4, "little")


@pytest.mark.full
def test_compact_bytes_are_read_and_damaged_ones_refused(read_in_c):
    names = ("maze of planes", "maze of values", "maze of gradients", "maze of cones")
    every = [case(name).c_bytes() for name in names]
    x = np.array([[i * 7 & 31, (i * 7 + 11) & 31] for i in range(40)]) / 31
    for name, line in zip(names, read_in_c(every), strict=True):
        error, *answers = line.split()
        assert error == "0" and same_bits(np.array(answers, np.float32), case(name).numpy()(x.astype(np.float32)))
    data = every[0]
    flipped = data[:99] + bytes([data[99] ^ 1]) + data[100:]
    wide = case("random planes").c_bytes()
    wide = with_checksum(wide[:8] + bytes([7]) + wide[9:])
    damaged = [b"", data[:3], b"P\xb5" + data[2:], data[:-1], data + b"\0", data[:50], flipped, wide]
    assert read_in_c(damaged) == ["1", "1", "1", "2", "2", "2", "3", "4"]


@pytest.mark.full
def test_forged_compact_bytes_cause_no_memory_error(read_in_c):
    """With a size and a checksum that fit them; sanitizers watch every access, shift and sum."""
    rng, every = np.random.default_rng(0), []
    for name in KINDS:
        data = case(name).c_bytes()
        for end in [72, len(data)] * 150:  # damage to the header, or anywhere
            changed = mutated(data[:end], rng, text=False) + data[end:]
            every.append(with_checksum(changed[:4] + len(changed).to_bytes(4, "little") + changed[8:]))
    assert sum(line[0] == "0" for line in read_in_c(every)) > len(every) / 2


# Modules of JavaScript answer as ``plr.numpy()`` does, to the bit, and need nothing else.


needs_node = pytest.mark.skipif(shutil.which("node") is None, reason="needs Node, as node")


@needs_node
@pytest.mark.full
@pytest.mark.parametrize("name", [*KINDS, "maze of cones"])
def test_javascript_modules_answer_as_numpy(name, tmp_path):
    plr = case(name)
    in_node, f, x = NodeModule(plr.js_module(), tmp_path), plr.numpy(), hard_points(plr, 5_000).astype(np.float64)
    x = np.concatenate([x, x[: len(x) // 2] * (1 + 1e-9)])  # of 64 bits
    found = in_node(x)[:, 0]
    assert same_bits(found.astype(np.float32), f(x)) and same_bits(found, f(x).astype(np.float64))
    if plr.leaf.name == "cone":
        assert same_bits(in_node(x, "waypoint", plr.dim), f.waypoint(x).astype(np.float64))
    if f.max_error is not None:
        assert same_bits(in_node(x, "bounds", 2), np.stack(f.bounds(x), axis=1).astype(np.float64))


@needs_node
@pytest.mark.full
@pytest.mark.parametrize("name", ["maze of cones", "far cones", "cones of exits"])
def test_javascript_reads_files_of_cones(name, tmp_path):
    plr = case(name)
    text = "\n".join([js_file_reader(), js_cone_reader()])
    file = f"Uint8Array.from({list(plr.to_bytes())})"
    opened = f"(file => coneReader(readCones(file, file.layers[0])))(readContainer({file}))"
    in_node = NodeModule(f"{text}\nexport const {{ distance, waypoint, bounds }} = {opened};", tmp_path)
    x, f = hard_points(plr, 2_000).astype(np.float64), plr.numpy()
    assert same_bits(in_node(x)[:, 0], f(x).astype(np.float64))
    assert same_bits(in_node(x, "waypoint", 2), f.waypoint(x).astype(np.float64))
    if f.max_error is not None:
        assert same_bits(in_node(x, "bounds", 2), np.stack(f.bounds(x), axis=1).astype(np.float64))


def test_javascript_modules_export_functions_and_import_nothing():
    for name, exported in (("maze of cones", {"distance", "waypoint", "bounds"}), ("folded car", {"distance"})):
        text = case(name).js_module()
        assert set(re.findall(r"^export function (\w+)", text, re.MULTILINE)) == exported
        assert not re.search(r"\bimport\b|\brequire\b|https?:", text)


def test_float_literals_are_read_as_the_same_number():
    rng = np.random.default_rng(0)
    numbers = rng.integers(0, 2**31, 3_000, dtype=np.uint32).view(np.float32)
    numbers = np.append(numbers[~np.isnan(numbers)], np.array([0.1, -0.0, np.inf], np.float32))
    for number in numbers:
        read = np.float32(float(float32_literal(number).replace("Infinity", "inf")))
        assert same_bits(read, number) and len(float32_literal(number)) < 24


@pytest.mark.parametrize(
    ("build", "in_c", "in_javascript"),
    [
        (lambda x, y, z: x + y + z, "x + y + z", "f(f(x + y) + z)"),
        (lambda x, y, z: x + (y + z), "x + (y + z)", "f(x + f(y + z))"),
        (lambda x, y, z: x - (y - z) * x, "x - (y - z) * x", "f(x - f(f(y - z) * x))"),
        (lambda x, y, z: x * (y * z), "x * (y * z)", "f(x * f(y * z))"),
        (lambda x, y, z: -(x + y) * z, "-(x + y) * z", "f(-f(x + y) * z)"),
        (lambda x, y, z: x - np.float32(-0.5), "x + 0.5f", "f(x + 0.5)"),
        (lambda x, y, z: x - np.float32(0.1), "x - 0.1f", "f(x - 0.10000000149011612)"),
        (lambda x, y, z: x - np.float32(0), "x", "x"),
        (lambda x, y, z: x * np.float32(1) + np.float64(0.1), "x + 0.1", "x + 0.1"),
        (lambda x, y, z: np.float32(-1e-30) * x, "-1e-30f * x", "f(-1.0000000031710769e-30 * x)"),
        (lambda x, y, z: (x < y) & (z >= np.float32(np.inf)), "x < y && z >= INFINITY", "x < y && z >= Infinity"),
    ],
)
def test_generated_expressions_keep_order_and_rounding(build, in_c, in_javascript):
    for do, text in ((CEmitter("a"), in_c), (JavaScriptEmitter(), in_javascript)):
        assert str(build(*(do.atom(name) for name in "xyz"))) == text
