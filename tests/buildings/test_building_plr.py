"""PLRs of buildings: answers, proofs, routes, files, and readers without JAX."""

import ctypes
import pickle
import shutil
import subprocess
from dataclasses import replace
from typing import Any

import jax
import numpy as np
import pytest
from building_scenes import GOAL, samples, two_floors

from experiments._c_headers import STRICT
from plr_jax import Building, load, load_numpy, save
from plr_jax.buildings import BuildingPLR
from plr_jax.buildings.floors import NO_PATH, Floors
from plr_jax.plr.growth import BudgetTooSmall

BUILDING = two_floors()
ORACLE = BUILDING.oracle(*GOAL)
FLOOR, X = samples(BUILDING, 300)
PLR = ORACLE.construct(max_bytes=2000, certified=True)
PROVEN = PLR.max_error or np.inf


@pytest.fixture(scope="module")
def far() -> BuildingPLR:
    building = two_floors((5e5, 4e6), (5e5 + 3, 4e6 - 7))
    return building.oracle(0, (5e5 + 10, 4e6 + 1)).construct(max_bytes=2000, certified=True)


def test_distances_are_within_the_proven_bounds():
    exact, (lower, upper) = ORACLE(FLOOR, X), map(np.asarray, PLR.bounds(FLOOR, X))
    assert (lower <= exact).all() and (exact <= upper).all()
    assert np.abs(np.asarray(PLR(FLOOR, X)) - exact).max() <= PROVEN < 1
    assert np.mean(np.asarray(PLR.which(FLOOR, X)) == ORACLE.which(FLOOR, X)) > 0.97


def test_answers_are_equal_inside_jit_from_a_file_and_in_numpy(tmp_path):
    save(PLR, path := tmp_path / "building.plr")
    assert path.stat().st_size == PLR.num_bytes
    x = X.astype(np.float32)
    expected = np.asarray(PLR(FLOOR, x))
    readers: list[Any] = [load(path), load_numpy(path), PLR.numpy(), pickle.loads(pickle.dumps(load_numpy(path)))]
    for plr in readers:
        np.testing.assert_array_equal(plr(FLOOR, x), expected)
        np.testing.assert_array_equal(plr.bounds(FLOOR, x), PLR.bounds(FLOOR, x))
        np.testing.assert_array_equal(plr.which(FLOOR, x), PLR.which(FLOOR, x))
    compiled: Any = jax.jit(lambda plr, floor, x: (plr(floor, x), plr.which(floor, x)))
    for plr in (PLR, load(path)):
        np.testing.assert_array_equal(compiled(plr, FLOOR, x)[0], expected)
        np.testing.assert_array_equal(compiled(plr, FLOOR, x)[1], PLR.which(FLOOR, x))
    assert compiled._cache_size() == 1, "a loaded PLR has the compiled code of another"
    gradient = jax.vmap(jax.grad(PLR, argnums=1))(FLOOR, x)
    np.testing.assert_allclose(np.linalg.norm(gradient, axis=1), 1, atol=1e-5)


def test_points_outside_and_unknown_floors(far):
    for plr, (x0, y0) in ((PLR, (0, 0)), (far, (5e5, 4e6))):
        outside = np.array([(x0 - 0.5, y0 + 1), (x0 + 20.5, y0 + 1), (x0 + 1, y0 + 10.5), (np.inf, y0)])
        for f in (plr, plr.numpy()):
            assert np.isinf(f(0, outside)).all()
            assert np.isnan(f(0, (np.nan, y0)))
            assert np.isfinite(f(0, [(x0, y0), (x0 + 20, y0 + 10)])).all(), "bounds are closed"
    for floor in (-1, 2, [0, 5]):
        with pytest.raises(ValueError, match="floor must be at least 0 and less than 2"):
            PLR(floor, X[:2])
    with pytest.raises(ValueError, match="floor must be an integer"):
        PLR(0.5, X[0])
    with pytest.raises(ValueError, match="shape"):
        PLR(0, [1.0, 2.0, 3.0])
    for x in (X[:2], jax.numpy.asarray(X[:2])):
        with pytest.raises(ValueError, match=r"of shape .* as the points"):
            PLR([0, 0, 0], x)
    assert np.isnan(jax.jit(PLR)(np.array([-1, 2]), X[:2].astype(np.float32))).all()
    assert PLR.which(0, [(-1.0, 0.0)]).tolist() == [NO_PATH]


@pytest.mark.parametrize("given", [None, BUILDING])
def test_routes_lead_to_the_goal_over_links(given):
    routes = PLR.trace(FLOOR, X, given)
    exact = ORACLE(FLOOR, X)
    for floor, x, route, length in zip(FLOOR.tolist(), X, routes, exact, strict=True):
        assert route.legs[0][0] == floor and np.allclose(route.legs[0][1][0], x, atol=1e-9)
        assert route.legs[-1][0] == GOAL[0] and np.allclose(route.legs[-1][1][-1], GOAL[1], atol=1e-6)
        assert length - 1e-5 <= route.length <= length + 2 * PROVEN or given is not None
        for (before, points), (after, more), link in zip(route.legs, route.legs[1:], route.links, strict=False):
            ends = [(before, *points[-1].round(5)), (after, *more[0].round(5))]
            link = BUILDING.links[link]
            stated = [(place[0], *place[1]) for place in (link.start, link.end)]
            assert ends == stated or (link.both_ways and ends[::-1] == stated)
        for leg, points in route.legs if given else ():
            assert BUILDING.floors[leg].is_visible(points[:-1], points[1:], 1e-5).all()


def test_starts_without_a_path_have_no_route():
    (route,) = PLR.trace(0, [(-1.0, 2.0)])
    assert (route.legs, route.links, route.length) == ([], [], np.inf)
    for wrong in (BUILDING.floors[0], Building(BUILDING.floors[:1])):
        with pytest.raises(ValueError, match="must be the Building of this PLR"):
            PLR.trace(0, X[:1], wrong)


@pytest.mark.parametrize("is_compact", [False, True])
@pytest.mark.parametrize("is_far", [False, True])
def test_c_equals_numpy(is_compact, is_far, far, tmp_path):
    if shutil.which("gcc") is None:
        pytest.skip("C is tried where gcc is")
    plr = far if is_far else PLR
    coordinate, dtype = ("double", np.float64) if is_far else ("float", np.float32)
    x = (X + (plr.floors.lo - BUILDING.plane_floors.lo)[FLOOR]).astype(dtype)
    x[:4] = [(np.nan, 1), (-1e9, 1), plr.floors.lo[0], plr.floors.hi[0]]
    (tmp_path / "home.h").write_text(plr.c_header("home", compact=is_compact))
    head = f"void all(int n, const int *k, const {coordinate} *x, float *y)"
    body = "{ for (int i = 0; i < n; i++) y[i] = home_distance(k[i], x + 2 * i); }"
    (tmp_path / "home.c").write_text(f'#include "home.h"\n{head} {body}\n')
    command = ["gcc", *STRICT, "-shared", "-fPIC", "home.c", "-o", "home.so", "-lm"]
    subprocess.run(command, cwd=tmp_path, check=True)
    floor, y = np.append(FLOOR[:-2], [-1, 2]).astype(np.int32), np.zeros(len(x), np.float32)
    ctypes.CDLL(str(tmp_path / "home.so")).all(
        len(x), *(each.ctypes.data_as(ctypes.c_void_p) for each in (floor, x, y))
    )
    np.testing.assert_array_equal(y[:-2], plr.numpy()(FLOOR[:-2], x[:-2]))
    assert np.isnan(y[-2:]).all()


def test_c_compiles_strictly_if_bounds_are_no_floats(tmp_path):
    if shutil.which("gcc") is None:
        pytest.skip("C is tried where gcc is")
    building = two_floors((0.1, 0.7), (-5.3, 3.9))
    plr = building.oracle(0, (10.1, 1.7)).construct(max_bytes=1000)
    (tmp_path / "home.c").write_text(plr.c_header("home"))
    subprocess.run(["gcc", *STRICT, "-Wno-unused-function", "-fsyntax-only", "home.c"], cwd=tmp_path, check=True)


def test_damaged_files_are_refused(tmp_path):
    data, path = PLR.to_bytes(), tmp_path / "damaged.plr"
    text = BUILDING.plane_floors.text
    wrong = [Floors.of_text(text).to_bytes(), b"PBD\n", data[:40], data[:-1], data[:8] + bytes(20) + data[28:]]
    for bad in wrong:
        path.write_bytes(bad)
        for read in (load, load_numpy):
            with pytest.raises(ValueError, match=r"damaged.plr cannot be read"):
                read(path)
    floors = PLR.floors
    twice = {name: np.tile(getattr(floors, name), (2, 1)) for name in ("lo", "hi")}
    for other in (replace(floors, hi=floors.hi + 5), replace(floors, **twice)):
        path.write_bytes(other.to_bytes() + PLR.plane.to_bytes())
        for read in (load, load_numpy):
            with pytest.raises(ValueError, match="its floors do not lie in its domain"):
                read(path)
    for old, new in (
        ('"goals":0', '"goals":-1'),
        ('"goals":0', '"goals":9999999999'),
        ("[[0,[2.0", "[[7,[2.0"),
        ('"lo":[[0.0', '"lo":[[99.0'),
        ("9.0,true", "-9.0,true"),
    ):
        assert old in text
        with pytest.raises(ValueError, match="floors and links are invalid"):
            Floors.of_text(text.replace(old, new, 1))


def test_one_floor_without_links_is_a_plr_of_the_floor():
    plr = Building(BUILDING.floors[:1]).oracle(*GOAL).construct(max_bytes=500)
    assert plr.floors.domain.width.tolist() == [22, 12]
    np.testing.assert_allclose(plr(0, X[:9]), Building(BUILDING.floors[:1]).oracle(*GOAL)(0, X[:9]), atol=0.2)


def test_too_small_budgets_are_named_with_the_bytes_of_floors_and_links():
    with pytest.raises(BudgetTooSmall, match=r"^max_bytes=100 is too small: one leaf takes") as caught:
        ORACLE.construct(max_bytes=100)
    needed = caught.value.num_bytes
    assert ORACLE.construct(max_bytes=needed).num_bytes == needed
    with pytest.raises(BudgetTooSmall):
        ORACLE.construct(max_bytes=needed - 1)


def test_names_in_c_are_checked_as_given():
    for name in ("", "my home", "2nd"):
        with pytest.raises(ValueError, match=f"name must be a C identifier, such as plr_maze, got '{name}'"):
            PLR.c_header(name)
