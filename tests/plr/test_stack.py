"""Many PLRs as one function: of an index and a point, or of a point for each."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from plr_helpers import UNIT, walled

from plr_jax import PLR, Box, Euclidean, VisibilityGraph, construct, scenes, stack
from plr_jax.plr import _stack as trie
from plr_jax.plr import points as points_module

ROOM = scenes.maze().workspace
GOALS = ((0.1, 0.1), (0.3, 0.9), (0.9, 0.6), (0.5, 0.05))
INDEX = np.random.default_rng(0).integers(0, 4, 500)
X = np.random.default_rng(0).uniform(-0.1, 1.1, (500, 2)).astype(np.float32)


def built(leaf, goals=GOALS, **limits):
    return [construct(VisibilityGraph(ROOM, goal), UNIT, leaf=leaf, **limits) for goal in goals]


@pytest.fixture(scope="module", params=["plane", "continuous", "smooth", "cone"])
def plrs(request):
    return built(request.param, max_leaves=60)


def assert_alike(stacked, plrs, x=X):
    """Equal but for what a compiler rounds at once in one function and apart in another."""
    expected = np.choose(INDEX, [np.asarray(plr(x)) for plr in plrs])
    np.testing.assert_allclose(np.asarray(stacked(INDEX, x)), expected, rtol=4e-7, atol=2e-7)
    assert np.isfinite(expected).any()


def test_each_point_is_answered_by_its_own_plr(plrs, monkeypatch):
    """Those of too many pages for a trie keep tables of their own."""
    together = stack(plrs)
    assert [each.common is None for each in together.groups] == [False]
    monkeypatch.setattr(trie, "_MOST_ENTRIES", 1)
    apart = stack(plrs)
    assert all(each.common is None for each in apart.groups)
    for stacked in (together, apart):
        assert_alike(stacked, plrs)
    x, index = jnp.asarray(X[:60]), jnp.asarray(INDEX[:60])
    np.testing.assert_allclose(jax.jit(lambda s, i, p: s(i, p))(together, index, x), together(index, x), rtol=1e-6)
    np.testing.assert_allclose(jax.vmap(together)(index, x), together(index, x), rtol=1e-6)
    slopes = jax.vmap(jax.grad(together, argnums=1))(index, x)
    expected = np.array([jax.vmap(jax.grad(plr))(x) for plr in plrs])[index, np.arange(60)]
    np.testing.assert_allclose(slopes, expected, rtol=1e-5, atol=1e-6)


def test_plrs_of_all_models_and_sizes_and_of_folded_and_periodic_points_in_one():
    sizes = (("plane", 9), ("smooth", 30), ("cone", 200), ("plane", 2000))
    mixed = [built(leaf, GOALS[:1], max_leaves=n)[0] for leaf, n in sizes]
    folded = [construct(Euclidean((0.5, 0.5)), UNIT, max_leaves=20) for _ in range(4)]
    around = Box((0, 0), (1, 1), (True, False))
    periodic = [
        construct(lambda q, k=k: np.sin(2 * np.pi * q[:, 0]) + k * q[:, 1] + 2, around, max_leaves=20)
        for k in range(4)
    ]
    for plrs, x in ((mixed, X), (folded, X), (periodic, jnp.asarray(X))):
        assert_alike(stack(plrs), plrs, x)


def test_indices_broadcast_and_others_give_nan():
    plrs = [construct(walled, UNIT, max_leaves=9)] * 4
    f, x = stack(plrs), np.array([[0.1, 0.2], [0.9, 0.9]], np.float32)
    shapes = [f(2, x).shape, f(np.arange(4)[:, None], x).shape, f(1, x[0]).shape]
    assert shapes == [(2,), (4, 2), ()] and len(f) == 4 and f.dim == 2
    assert np.isnan(np.asarray(f(np.array([-1, 4]), x))).all()
    np.testing.assert_allclose(stack(plrs[:1])(0, x), plrs[0](x), rtol=4e-7)


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda plr: stack([plr])(0.5, np.zeros((1, 2))), "index must hold integers"),
        (lambda plr: stack([plr])(0, np.zeros((1, 3))), r"shape \(\.\.\., 2\)"),
        (stack, "must be a list of PLRs"),
        (lambda plr: stack([plr, 7]), "number 1 is 7"),
        (lambda plr: stack([]), "at least one"),
        (lambda plr: PLR.stack([plr, plr])(np.zeros((5, 3, 3))), r"shape \(n, 2, dof\), got \(5, 3, 3\)"),
        (lambda plr: PLR.stack([plr, plr])(np.zeros((5, 2))), r"shape \(n, 2, dof\), got \(5, 2\)"),
        (lambda plr: PLR.stack([plr, plr])(np.zeros((5, 2, 1))), "The PLR of robot 0 has 2 dimensions, got 1"),
    ],
)
def test_what_is_wrong_is_said(call, message):
    with pytest.raises(ValueError, match=message):
        call(construct(walled, UNIT, max_leaves=9))


# A point for each.


@pytest.fixture(scope="module")
def team():
    """PLRs of all leaf models, of other sizes and dimensions, one far from the origin, one around."""
    return [
        construct(walled, UNIT, max_leaves=40),
        construct(lambda x: walled(x[:, :2]) + 0.1 * x[:, 2], Box([0.0] * 3, [1.0] * 3), max_leaves=60),
        construct(walled, UNIT, leaf="continuous", max_leaves=20),
        construct(walled, UNIT, leaf="smooth", max_leaves=20),
        construct(walled, Box((0, 0), (1, 1), (True, False)), max_leaves=40),
        construct(lambda x: np.hypot(*(x - 1e6 - 0.3).T), Box((1e6, 1e6), (1e6 + 2, 1e6 + 2)), max_leaves=40),
    ]


@pytest.mark.full
@pytest.mark.parametrize("n", [0, 1, 60])
def test_a_team_equals_the_plrs_bit_for_bit(team, n, monkeypatch):
    q = 2 * np.random.default_rng(1).random((n, 6, 3)) - 0.5
    q[:, -1] += 1e6
    q[:1, :, 0] = np.nan
    found = PLR.stack(team)(q)
    assert found.shape == (n, 6) and found.dtype == np.float64
    for i, plr in enumerate(team):
        np.testing.assert_array_equal(found[:, i], np.asarray(plr(q[:, i, : plr.dim]), np.float64))
    monkeypatch.setattr(points_module, "_CHUNK", 4)
    np.testing.assert_array_equal(PLR.stack(team[:2])(q[:, :2]), found[:, :2])
