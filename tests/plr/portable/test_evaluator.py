"""Answers of ``plr.numpy()``, against a slow reader that follows the words of the format, and against ``plr(x)``."""

import os
import subprocess
import sys

import jax
import numpy as np
import pytest
from portable_helpers import CASES, SlowReader, case, hard_points, is_far, same_bits

from plr_jax import Box, VisibilityGraph, certify, construct, load_numpy, save, scenes
from plr_jax.plr.portable.evaluator import LeafTable


@pytest.fixture(params=CASES)
def plr(request):
    return case(request.param)


def test_answers_are_those_of_the_words(plr):
    x = hard_points(plr, 80)
    assert same_bits(plr.numpy()(x), SlowReader(plr)(x))
    wide = hard_points(plr, 30, seed=1).astype(np.float64) * (1 + 1e-12)
    assert same_bits(plr.numpy()(wide), SlowReader(plr)(wide))


@pytest.mark.parametrize("name", ["maze of cones", "cones in space", "far cones"])
def test_waypoints_are_those_of_the_words(name):
    plr = case(name)
    x = hard_points(plr, 80)
    assert same_bits(plr.numpy().waypoint(x), SlowReader(plr).waypoint(x))


def test_single_points_are_answered_as_in_batches(plr):
    f, x = plr.numpy(), hard_points(plr, 40).astype(np.float64)
    batch = f(x)
    for given in (map(tuple, x.tolist()), x.tolist(), x):
        assert same_bits([f(point) for point in given], batch)
    assert isinstance(f(tuple(x[0].tolist())), np.float32)
    for factor in (1 - 1e-9, 1 + 1e-9, 1 + 1e-7):  # of 64 bits, beside faces
        assert same_bits([f(tuple(point)) for point in (x * factor).tolist()], f(x * factor))
    x[::2, 0] = np.nan
    x[::3, -1] = plr.domain.hi[-1] + 2 * plr.domain.width[-1]
    assert same_bits([f(tuple(point)) for point in x.tolist()], f(x))


def test_answers_are_those_of_jax_bit_for_bit(plr):
    x = hard_points(plr, 4000, seed=2)
    x[np.abs(x) < np.finfo(np.float32).tiny] = 0  # for which XLA takes what is smaller
    if is_far(plr):  # in 64 bits, host code wraps by an exact remainder: farther around, it is elsewhere
        x = x[~((np.abs(x) > 1e9) & np.isfinite(x)).any(axis=1)]
    answer, expected = np.asarray(plr(x)), plr.numpy()(x)
    if is_far(plr):
        np.testing.assert_allclose(answer, expected, rtol=3e-7)
        assert np.mean(answer == expected) > 0.99 * np.mean(~np.isnan(expected))
        return
    np.testing.assert_array_equal(answer, expected)  # but for the sign of zero
    assert same_bits(answer[expected != 0], expected[expected != 0])
    np.testing.assert_array_equal(jax.jit(lambda x: 2 * plr(x))(x), 2 * expected)


def test_its_text_says_what_it_is():
    oracle = VisibilityGraph(scenes.maze().workspace, scenes.maze().goals[0])
    plr = construct(oracle, oracle.workspace.bounds, max_bytes=200)
    size = f"dim=2, num_leaves={plr.num_leaves}"
    assert repr(plr.numpy()) == f"NumpyPLR('plane', {size}, Box([0.0, 0.0], [1.0, 1.0]))"
    proven = certify(plr, oracle)
    said = f"NumpyPLR('plane', {size}, max_error={proven.max_error:.3g}, Box([0.0, 0.0], [1.0, 1.0]))"
    assert repr(proven.numpy()) == said


def test_bounds_and_waypoints_are_those_of_the_plr():
    plr = case("maze of cones")
    x, f = hard_points(plr, 500), plr.numpy()
    x[np.abs(x) < np.finfo(np.float32).tiny] = 0  # for which XLA takes what is smaller
    np.testing.assert_array_equal(f.waypoint(x), plr.waypoint(x))
    for mine, theirs in zip(f.bounds(x), plr.bounds(x), strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=3e-7)
    far = case("far cones")
    x = hard_points(far, 100)
    assert f.max_error == plr.max_error and far.numpy().max_error is None
    assert f.domain == plr.domain and f.dim == 2
    np.testing.assert_array_equal(far.numpy().waypoint(x), far.waypoint(x))
    assert far.numpy().waypoint(x).dtype == np.float64


def test_what_a_plr_has_not_is_refused():
    f = case("around").numpy()
    with pytest.raises(ValueError, match="Nothing is proven"):
        f.bounds([[0.0, 1.2]])
    with pytest.raises(ValueError, match="have no sources"):
        f.waypoint([[0.0, 1.2]])


NO_POINTS = [
    0.5,
    [],
    [0.1],
    [0.1, 0.2, 0.3],
    [[0.1]],
    "ab",
    ["a", "b"],
    [1j, 0],
    [[1], [2, 3]],
    [None, 1],
    [5.0, "a"],
]
NO_POINTS += [[5.0, None], [5.0, 1j], [5.0, [1, 2]]]


@pytest.mark.parametrize("x", NO_POINTS)
def test_points_of_another_kind_are_refused(x):
    with pytest.raises(ValueError, match="Points must"):
        case("maze of planes").numpy()(x)


def test_points_come_in_any_shape_and_type():
    f = case("maze of planes").numpy()
    x = np.random.default_rng(0).random((3, 4, 2))
    assert f(x).shape == (3, 4) and f(x[:0]).shape == (0, 4)
    assert same_bits(f(np.asfortranarray(x)), f(x)) and same_bits(f(x[::-1, ::2]), f(x)[::-1, ::2])
    assert same_bits(f(x.astype(np.float16)), f(x.astype(np.float16).astype(np.float32)))
    assert f([0, 1]) == f(np.array([0, 1])) == f((0.0, 1.0))
    assert np.isnan(f(np.ma.masked_array([[0.5, 0.5]], [[True, False]]))).all()


def test_chunks_do_not_show(monkeypatch):
    plr = case("around")
    x = hard_points(plr, 300)
    whole = plr.numpy()(x)
    monkeypatch.setattr("plr_jax.plr.portable.evaluator._CHUNK", 7)
    assert same_bits(plr.numpy()(x), whole)


@pytest.mark.parametrize("bits", [0, 1, 5])
def test_the_table_may_be_as_small_as_one_likes(bits, monkeypatch):
    monkeypatch.setattr("plr_jax.plr.portable.evaluator._MOST_BITS", bits)
    for name in ("deep", "random planes", "maze of values"):
        plr, x = case(name), hard_points(case(name), 100)
        f = plr.numpy()
        assert not f._table.is_flat
        assert same_bits(f(x), SlowReader(plr)(x)) and same_bits([f(tuple(p)) for p in x.tolist()], f(x))


def test_a_point_that_rounding_puts_below_the_domain_has_the_leaf_beside_it():
    """As 32-bit floats resolve 1e-6 there, the lower end is rounded to one below it."""
    lo = 11 + 0.45 * 2.0**-20
    plr = construct(lambda x: np.where(x[:, 0] < 12, 1.0, 50.0), Box((lo, 0), (15, 1)), max_leaves=30)
    lowest = np.array([[np.float32(lo), 0.5]], np.float32)
    assert float(lowest[0, 0]) < lo and not is_far(plr)
    assert plr(lowest)[0] == pytest.approx(1) and plr.numpy()(lowest)[0] == pytest.approx(1)


@pytest.mark.parametrize("name", ["far planes", "far cones", "far car"])
def test_far_from_the_origin_the_domain_begins_at_its_corner_itself(name):
    plr = case(name)
    f, middle = plr.numpy(), (plr.domain.lo + plr.domain.hi) / 2
    for corner, outward in ((plr.domain.lo, -np.inf), (plr.domain.hi, np.inf)):
        x = np.tile(middle, (3, 1))
        beyond = corner[0] + np.sign(outward) * 1e-6 * plr.domain.width[0]
        x[:, 0] = corner[0], np.nextafter(corner[0], -outward), beyond
        for answers in (f(x), plr(x), [f(tuple(point)) for point in x.tolist()]):
            assert np.isfinite(answers).tolist() == [True, True, False]


def test_far_from_the_origin_answers_are_as_good_as_at_it():
    """Both store a plane that its leaves hold but for what rounding makes of it: 4e6 is rounded to 0.25."""
    width, slope = np.array([2000.3, 1500.7]), np.array([0.7, -0.4])
    errors = []
    for lo in (np.zeros(2), np.array([5e5, 4e6]) + 0.3):
        plr = construct(lambda x, lo=lo: 2000 + (x - lo) @ slope, Box(lo, lo + width), max_leaves=8)
        x = lo + width * np.random.default_rng(0).random((4000, 2))
        truth = 2000 + (x - lo) @ slope
        errors.append([np.abs(answer - truth).mean() for answer in (plr.numpy()(x), np.asarray(plr(x), float))])
    np.testing.assert_allclose(errors[1], errors[0], rtol=0.02)


def test_outside_is_what_is_asked_for(plr):
    """Against ``plr(x)``, within what rounding comes to; and a single point is answered as in a batch."""
    f, x = plr.numpy(), hard_points(plr, 100, seed=3)
    around = np.random.default_rng(1).uniform(-2, 3, (1000, plr.dim))
    x = np.concatenate([x, plr.domain.lo + plr.domain.width * around])
    is_outside = np.isinf(f(x))
    assert is_outside.sum() > 20
    for outside in ("inf", "clamp", "nan"):
        answer = f(x, outside=outside)
        assert same_bits(answer[~is_outside], f(x)[~is_outside])
        assert same_bits([f(tuple(point), outside=outside) for point in x.tolist()], answer)
    assert np.isnan(f(x, outside="nan"))[is_outside].all()
    clamped = f(x, outside="clamp")
    finite = np.isfinite(x).all(axis=1)
    assert np.isinf(clamped[is_outside & ~finite]).all() and np.isfinite(clamped[finite]).all()
    theirs = np.asarray(plr(x, outside="clamp"))
    if not is_far(plr):  # where host code wraps by an exact remainder
        x = x.astype(np.float32)
        for query in (plr, jax.jit(plr, static_argnames="outside")):
            np.testing.assert_array_equal(query(x, outside="clamp"), f(x, outside="clamp"))
        return
    close = np.isclose(clamped[finite], theirs[finite], rtol=1e-4, atol=1e-3 * plr.domain.width.max())
    assert close.mean() > 0.97  # the others are beside a face across which the function jumps


def test_another_word_is_refused():
    for x in ([0.5, 0.5], [[0.5, 0.5]]):
        with pytest.raises(ValueError, match="outside must be 'inf', 'clamp' or 'nan'"):
            case("maze of planes").numpy()(x, outside="clip")


def test_a_file_is_read_without_jax(tmp_path):
    for name in ("maze of planes", "maze of values", "maze of gradients", "car", "maze of cones"):
        save(case(name), tmp_path / f"{name}.plr")
    code = f"""
import pathlib, sys
import plr_jax
f = plr_jax.load_numpy({str(tmp_path / "maze of cones.plr")!r})
print(f((0.93, 0.95)), f.waypoint([0.93, 0.95]), f.bounds([[0.93, 0.95]]))
heavy = {{"jax", "scipy", "shapely", "networkx", "matplotlib", "typer"}} & set(sys.modules)
for path in pathlib.Path({str(tmp_path)!r}).iterdir():
    plr_jax.load_numpy(path)
heavy |= {{"jax"}} & set(sys.modules)
sys.exit(str(heavy) if heavy else 0)
"""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=dict(os.environ), check=False
    )
    assert done.returncode == 0 and done.stderr == "", done.stderr
    assert float(done.stdout.split()[0]) == pytest.approx(float(case("maze of cones")([0.93, 0.95])), rel=1e-6)


def test_files_that_are_none_are_refused(tmp_path):
    (tmp_path / "a.plr").write_bytes(b"no PLR")
    with pytest.raises(ValueError, match=r"a\.plr cannot be read as a PLR"):
        load_numpy(tmp_path / "a.plr")
    with pytest.raises(FileNotFoundError):
        load_numpy(tmp_path / "b.plr")


def test_tables_of_one_leaf_ask_nothing():
    f = case("one leaf").numpy()
    assert isinstance(f._table, LeafTable) and f._table.is_flat and len(f._table.table) == 1
    assert not is_far(case("one leaf"))


def test_points_of_16_bits_are_those_of_32():
    plr = case("maze of cones")
    x = jax.numpy.array([(0.25, 0.75), (0.5, 0.125)], jax.numpy.bfloat16)
    np.testing.assert_array_equal(plr.numpy()(x), plr.numpy()(np.asarray(x, np.float32)))
