"""Pairs in NumPy and in JavaScript: alike to the bit, and near what JAX answers."""

import re
import shutil

import numpy as np
import pytest
from pair_helpers import MAZE, exact, two_batches

from experiments._js_modules import NodeModule
from plr_jax import Workspace, construct_pairs
from plr_jax.pairs.portable import crossings

_OF_ROWS = """
export const distanceOfRow = z => distance(z.slice(0, 2), z.slice(2));
export const waypointOfRow = z => waypoint(z.slice(0, 2), z.slice(2));
export const boundsOfRow = z => bounds(z.slice(0, 2), z.slice(2));
"""
FAR_WALL = np.add((5e5, 4e6), [(30, 0), (40, 0), (40, 45.5), (30, 45.5)])
FAR = Workspace(((5e5, 4e6), (5e5 + 100, 4e6 + 60)), [FAR_WALL])
TOUCHING = Workspace(((0, 0), (10, 10)), [[(2, 2), (5, 2), (5, 5), (2, 5)], [(5, 5), (8, 5), (8, 8), (5, 8)]])
SLIVERS = [[(5, 5), (5, 9), (5.01, 9)], [(5, 5), (1, 2), (1, 2 + 1e-5)], [(5, 5 - 4e-5), (9, 1), (9, 1.01)]]
THIN = Workspace(((5e5, 4e6), (5e5 + 100, 4e6 + 100)), (5e5, 4e6) + 10 * np.array(SLIVERS), squeeze=True)
SQUEEZED = Workspace(TOUCHING.bounds, TOUCHING.obstacles, squeeze=True)


@pytest.fixture(scope="module", params=["maze", "far", "touching", "squeezed"])
def workspace(request):
    return {"maze": MAZE, "far": FAR, "touching": TOUCHING, "thin": THIN, "squeezed": SQUEEZED}[request.param]


@pytest.fixture(scope="module")
def pairs(workspace):
    return construct_pairs(workspace, max_bytes=600)


def ends(pairs, n=1500):
    """Pairs of points, everywhere, on a coarse lattice, outside, alike, and some of no number."""
    rng, domain = np.random.default_rng(0), pairs.domain
    x = domain.lo + domain.width * rng.uniform(-0.05, 1.05, (2, n, 2))
    x[:, : n // 3] = domain.lo + domain.width * rng.integers(0, 21, (2, n // 3, 2)) / 20
    x[1, ::50] = x[0, ::50]
    x[0, 5], x[1, 6, 1], x[0, 7] = np.nan, np.inf, domain.hi
    return x


def test_numpy_distances_are_exact_within_bounds(workspace, pairs):
    x, y = two_batches(workspace, 300)
    f, scale = pairs.numpy(), workspace.bounds.width.max()
    np.testing.assert_allclose(f(x, y), exact(workspace, x, y), atol=3e-6 * scale)
    lower, upper = f.bounds(x, y)
    truth = exact(workspace, x, y)
    assert (lower <= truth).all() and (truth <= upper).all() and np.isfinite(upper).mean() > 0.95
    farthest = np.abs([workspace.bounds.lo, workspace.bounds.hi]).max()
    assert (lower >= truth - 1e-5 * scale - 3e-6 * farthest).all()


@pytest.mark.full
@pytest.mark.usefixtures("compiled")
@pytest.mark.parametrize("workspace", ["far", "touching"], indirect=True)
def test_numpy_answers_equal_jax_but_for_rounding(workspace, pairs):
    f, (x, y), scale = pairs.numpy(), ends(pairs), workspace.bounds.width.max()
    found, theirs = f(x, y), np.asarray(pairs(x, y))
    assert np.array_equal(np.isnan(found), np.isnan(theirs))
    is_free = workspace.is_free(x) & workspace.is_free(y)  # of others answers mean nothing
    np.testing.assert_allclose(found[is_free], theirs[is_free], rtol=0, atol=1e-6 * scale)


def test_numpy_answers_are_symmetric_and_infinite_outside(pairs):
    f, (x, y) = pairs.numpy(), ends(pairs)
    found = f(x, y)
    np.testing.assert_array_equal(f(y, x), found)
    is_outside = ((x < pairs.domain.lo) | (x > pairs.domain.hi)).any(axis=1)
    assert np.isinf(found[is_outside & ~np.isnan(found)]).all() and is_outside.any()
    np.testing.assert_array_equal(np.isnan(found), np.isnan(x + y).any(axis=1))
    assert f(x[10], y[10]) == found[10] and f(x[:0], y[:0]).shape == (0,)
    assert f(x[20:23, None], y[None, 30:34]).shape == (3, 4)


@pytest.mark.parametrize("workspace", ["touching", pytest.param("thin", marks=pytest.mark.full)], indirect=True)
def test_javascript_answers_equal_numpy_bit_for_bit(pairs, tmp_path):
    if shutil.which("node") is None:
        pytest.skip("modules are run where there is Node, as node")
    x, y = ends(pairs)
    rows, f, text = np.concatenate([x, y], axis=1), pairs.numpy(), pairs.js_module()
    assert not re.search(r"\bimport\b|\brequire\b|https?:", text)
    module = NodeModule(text + _OF_ROWS, tmp_path)
    assert np.array_equal(module(rows, "distanceOfRow")[:, 0], f(x, y), equal_nan=True)
    for found, expected in zip(module(rows, "boundsOfRow", 2).T, f.bounds(x, y), strict=True):
        assert np.array_equal(found, expected, equal_nan=True)
    # The way to the waypoint and from there on is as long as the distance.
    is_free = np.isfinite(f(x, y)) & np.isfinite(f.bounds(x, y)[1])
    x, y = x[is_free], y[is_free]
    onward = module(np.concatenate([x, y], axis=1), "waypointOfRow", 2)
    legs = np.linalg.norm(onward - x, axis=1) + f(onward, y)
    np.testing.assert_allclose(legs, f(x, y), atol=1e-5 * pairs.domain.width.max())


@pytest.mark.parametrize("in_line", [False, True])
def test_crossings_near_segment_ends_equal_exact_arithmetic(in_line):
    rng, n = np.random.default_rng(0), 2_000
    p, q = rng.uniform(-0.5, 0.5, (2, n, 2)).astype(np.float32)
    along = (q - p) / np.linalg.norm(q - p, axis=1, keepdims=True)
    aside = np.stack([-along[:, 1], along[:, 0]], axis=1)
    # The wall begins 1e-3 onward from p, at most 1e-7 beside the segment.
    a = (p + 1e-3 * along + rng.uniform(-1e-7, 1e-7, (n, 1)) * aside).astype(np.float32)
    leads = rng.choice([-0.1, 0.1], (n, 1)) * aside
    b = (a + (0.1 * along + 1e-5 * leads if in_line else leads)).astype(np.float32)
    inward, outward = crossings(p.T, q.T, np.concatenate([a, b], axis=1).T)
    # 64 bits hold differences of points exactly, and their products nearly.
    p, q, a, b = (each.astype(float) for each in (p, q, a, b))

    def sine(u, v):
        return (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]) / (np.linalg.norm(u, axis=1) * np.linalg.norm(v, axis=1))

    of_a, of_b, of_p, of_q = sine(q - p, a - p), sine(q - p, b - p), sine(b - a, p - a), sine(b - a, q - a)
    told = (np.abs([of_a, of_b, of_p, of_q]) > 2.0**-22).all(axis=0)  # more than rounding
    crosses = of_p * of_q < 0
    np.testing.assert_array_equal(inward[told], (crosses & (of_a < 0) & (of_b > 0))[told])
    np.testing.assert_array_equal(outward[told], (crosses & (of_b < 0) & (of_a > 0))[told])
    assert told.mean() > 0.8 and 0.1 < (inward | outward)[told].mean() < 0.7


def test_wrong_points_raise():
    f = construct_pairs(SQUEEZED, max_bytes=600).numpy()
    for bad in ([1, 2, 3], 5.0, ["a", "b"]):
        with pytest.raises(ValueError, match="Points must"):
            f(bad, [1, 2])
    with pytest.raises(ValueError, match="must broadcast"):
        f(np.zeros((2, 2)), np.zeros((3, 2)))
