"""Many PLRs as one function: of an index and a point, or of a point for each; and their one table."""

import pickle
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plr_helpers import UNIT, chain, leaf_by_position, random_partition, tables_of_numbers, walled

from plr_jax import PLR, Box, Euclidean, VisibilityGraph, construct, scenes, stack
from plr_jax.plr import query as lookup
from plr_jax.plr._stack import build_trie, trie_levels
from plr_jax.plr.tree import Cells

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


def test_each_point_is_answered_by_its_own_plr(plrs):
    together = stack(plrs)
    assert len(together.groups) == 1
    assert_alike(together, plrs)
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
    # Indices beyond 32 bits do not wrap, in NumPy (two points) or compiled (many).
    for index in (2**32, 2**32 + 1, -(2**32), np.uint64(2**64 - 1)):
        for num in (1, 40_000):
            assert np.isnan(np.asarray(f(np.full(2 * num, index), np.tile(x, (num, 1))))).all()
    np.testing.assert_allclose(stack(plrs[:1])(0, x), plrs[0](x), rtol=4e-7)


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda plr: stack([plr])(0.5, np.zeros((1, 2))), "index must hold integer indices"),
        (lambda plr: stack([plr])(0, np.zeros((1, 3))), r"shape \(\.\.\., 2\)"),
        (stack, "must be a list of PLRs"),
        (lambda plr: stack([plr, 7]), "got 7 at index 1"),
        (lambda plr: stack([]), "at least one"),
        (lambda plr: PLR.stack([plr, plr])(np.zeros((5, 3, 3))), r"shape \(n, 2, dof\), got \(5, 3, 3\)"),
        (lambda plr: PLR.stack([plr, plr])(np.zeros((5, 2))), r"shape \(n, 2, dof\), got \(5, 2\)"),
        (
            lambda plr: PLR.stack([plr, plr])(np.zeros((5, 2, 1))),
            "The PLR of robot 0 needs 2 coordinates, got configurations of 1",
        ),
    ],
)
def test_what_is_wrong_is_said(call, message):
    with pytest.raises(ValueError, match=message):
        call(construct(walled, UNIT, max_leaves=9))


# One table of several partitions, against the cells' own integers.


find_row = jax.jit(lookup.find_row)
POINTS = 600


def levels_of_all(partitions):
    return trie_levels(np.max([cells.depth.max(axis=0) for cells in partitions], axis=0))


def assert_finds_rows(partitions, rows, seed=0):
    """In leaves' centers and at multiples of 2**-16, many of which lie on cell borders; of every partition."""
    dim, levels = partitions[0].dim, levels_of_all(partitions)
    trie = build_trie(partitions, rows, levels)
    tables = tables_of_numbers(Cells.root(dim), 100)
    for number, (cells, row) in enumerate(zip(partitions, rows, strict=True)):
        x = np.random.default_rng(seed).integers(0, 2**16 + 1, size=(POINTS, dim)) / 2.0**16
        x[: min(len(cells), 400)] = ((cells.position + 0.5) * 2.0**-cells.depth)[:400]
        which = jnp.full(len(x), number, jnp.uint32)
        of_partition = replace(trie, start=trie.start + (which << np.uint32(levels[1].sum())))
        found = find_row(replace(tables, trie=of_partition), jnp.asarray(x, jnp.float32))
        np.testing.assert_array_equal(found, row[leaf_by_position(cells, x)])


def one_row_a_leaf(partitions):
    first = np.cumsum([0, *map(len, partitions)])
    return [begin + np.arange(len(cells)) for begin, cells in zip(first, partitions, strict=False)]


@given(seed=st.integers(0, 1000), dim=st.sampled_from([1, 2, 3, 4]), sizes=st.lists(st.integers(0, 100), min_size=1))
def test_every_point_finds_its_leaf_in_its_own_partition(seed, dim, sizes):
    partitions = [random_partition(seed + i, dim, size) for i, size in enumerate(sizes[:4])]
    assert_finds_rows(partitions, one_row_a_leaf(partitions), seed)


@pytest.mark.parametrize("axes", [[0] * 22, [0, 1] * 13, [0] * 13 + [1] * 13, [0, 1, 2] * 7, [1] * 13])
def test_deep_leaves_are_found_beside_shallow_ones(axes):
    deep = chain([*axes, *range(max(axes) + 1)][-len(axes) :])
    partitions = [Cells.root(deep.dim), deep, random_partition(0, deep.dim, 30)]
    assert_finds_rows(partitions, one_row_a_leaf(partitions))


def test_too_deep_partitions_and_such_of_too_many_pages_are_refused():
    too_deep = chain([0, 1] * 22)
    thin = Cells(np.full((1 << 17, 2), (17, 0)), np.stack([np.arange(1 << 17), np.zeros(1 << 17, int)], axis=1))
    for partitions in ([too_deep], [thin, chain([1] * 17)]):
        with pytest.raises(ValueError, match="too deep for a stack"):
            build_trie(partitions, one_row_a_leaf(partitions), levels_of_all(partitions))
    build_trie([thin], one_row_a_leaf([thin]), levels_of_all([thin]))


def test_one_point_may_be_asked_of_several_plrs_also_after_other_calls_and_under_jit():
    first, second = (construct(lambda x, k=k: k + x[:, 0], Box((0, 0), (1, 1)), max_leaves=2) for k in (1, 2))
    stacked, x = stack([first, second]), np.array([0.25, 0.5])
    for index in ([0, 1], [[1, 0, 0]]):
        np.testing.assert_allclose(stacked(np.array(index), x), 1.25 + np.array(index), atol=1e-6)
        np.testing.assert_allclose(
            jax.jit(lambda i: stacked(i, x))(np.array(index)), 1.25 + np.array(index), atol=1e-6
        )
    assert stacked(np.zeros(0, int), x).shape == (0,)
    again = pickle.loads(pickle.dumps(stacked))
    np.testing.assert_array_equal(again(np.array([1]), x), stacked(np.array([1]), x))
