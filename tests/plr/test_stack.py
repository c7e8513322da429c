"""Many PLRs as one function of an index and a point."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import plr_jax
from plr_jax.plr.query import trie

ROOM = plr_jax.scenes.maze().workspace
DOMAIN = plr_jax.Box((0, 0), (1, 1))
GOALS = ((0.1, 0.1), (0.3, 0.9), (0.9, 0.6), (0.5, 0.05))


def built(leaf, **limits):
    return [plr_jax.construct(plr_jax.VisibilityGraph(ROOM, goal), DOMAIN, leaf=leaf, **limits) for goal in GOALS]


@pytest.fixture(scope="module", params=["plane", "continuous", "smooth", "cone"])
def plrs(request):
    return built(request.param, max_leaves=60)


@pytest.fixture(scope="module")
def pairs():
    rng = np.random.default_rng(0)
    return rng.integers(0, len(GOALS), 500), rng.uniform(-0.1, 1.1, (500, 2)).astype(np.float32)


def one_by_one(plrs, index, x):
    return np.array([plrs[i](point[None])[0] for i, point in zip(index, x, strict=True)])


def assert_alike(found, expected):
    """Equal but for what a compiler rounds at once in one function and apart in another."""
    np.testing.assert_allclose(np.asarray(found), expected, rtol=4e-7, atol=2e-7)


def test_each_point_is_answered_by_its_own_plr(plrs, pairs):
    index, x = pairs
    expected = one_by_one(plrs, index, x)
    assert np.isinf(expected).any()
    assert_alike(plr_jax.stack(plrs)(index, x), expected)


def test_those_of_too_many_pages_for_a_trie_keep_tables_of_their_own(plrs, pairs, monkeypatch):
    index, x = pairs
    assert [each.common is None for each in plr_jax.stack(plrs).groups] == [False]
    monkeypatch.setattr(trie, "_MOST_ENTRIES", 1)
    apart = plr_jax.stack(plrs)
    assert all(each.common is None for each in apart.groups)
    assert_alike(apart(index, x), one_by_one(plrs, index, x))


def test_jit_vmap_and_grad(plrs, pairs):
    index, x = (jnp.asarray(each[:60]) for each in pairs)
    f = plr_jax.stack(plrs)
    np.testing.assert_allclose(jax.jit(lambda s, i, p: s(i, p))(f, index, x), f(index, x), rtol=1e-6)
    np.testing.assert_allclose(jax.vmap(f)(index, x), f(index, x), rtol=1e-6)
    slopes = jax.vmap(jax.grad(f, argnums=1))(index, x)
    expected = [jax.grad(plrs[int(i)])(point) for i, point in zip(index, x, strict=True)]
    np.testing.assert_allclose(slopes, np.array(expected), rtol=1e-5, atol=1e-6)


def test_plrs_of_all_models_and_sizes_in_one(pairs):
    index, x = pairs
    mixed = [
        built(leaf, max_leaves=n)[0] for leaf, n in (("plane", 9), ("smooth", 30), ("cone", 200), ("plane", 2000))
    ]
    assert_alike(plr_jax.stack(mixed)(index, x), one_by_one(mixed, index, x))


def test_plrs_of_folded_points_and_periodic_domains(pairs):
    index, x = pairs
    folded = [plr_jax.construct(plr_jax.Euclidean((0.5, 0.5)), DOMAIN, max_leaves=20) for _ in range(4)]
    assert_alike(plr_jax.stack(folded)(index, x), one_by_one(folded, index, x))
    around = plr_jax.Box((0, 0), (1, 1), (True, False))
    periodic = [
        plr_jax.construct(lambda q, k=k: np.sin(2 * np.pi * q[:, 0]) + k * q[:, 1] + 2, around, max_leaves=20)
        for k in range(4)
    ]
    inside = jnp.asarray(x)
    assert_alike(plr_jax.stack(periodic)(index, inside), one_by_one(periodic, index, inside))


def test_indices_broadcast_and_others_give_nan(plrs):
    f = plr_jax.stack(plrs)
    x = np.array([[0.1, 0.2], [0.9, 0.9]], np.float32)
    assert f(2, x).shape == (2,)
    assert f(np.arange(4)[:, None], x).shape == (4, 2)
    assert f(1, x[0]).shape == ()
    assert np.isnan(np.asarray(f(np.array([-1, 4]), x))).all()
    assert len(f) == 4
    assert f.dim == 2


def test_one_alone_is_a_stack(plrs):
    x = np.array([[0.1, 0.2]], np.float32)
    assert_alike(plr_jax.stack(plrs[:1])(0, x), np.asarray(plrs[0](x)))


@pytest.mark.usefixtures("unchecked_types")
def test_what_is_wrong_is_said(plrs):
    f = plr_jax.stack(plrs)
    with pytest.raises(ValueError, match="index must hold integers"):
        f(0.5, np.zeros((1, 2)))
    with pytest.raises(ValueError, match=r"shape \(\.\.\., 2\)"):
        f(0, np.zeros((1, 3)))
    with pytest.raises(ValueError, match="must be a list of PLRs"):
        plr_jax.stack(plrs[0])
    with pytest.raises(ValueError, match="number 1 is 7"):
        plr_jax.stack([plrs[0], 7])
    with pytest.raises(ValueError, match="at least one"):
        plr_jax.stack([])
