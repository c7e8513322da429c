"""Many PLRs as one function: of an index and a point, or of a point for each; and their one table."""

import pickle
from dataclasses import replace
from itertools import cycle

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plr_helpers import UNIT, chain, leaf_by_position, random_partition, tables_of_numbers, walled

from plr_jax import PLR, Box, Euclidean, VisibilityGraph, construct, scenes, stack
from plr_jax.plr._stack import build_trie, trie_levels
from plr_jax.plr.leaves import leaf_names
from plr_jax.plr.query import find_row
from plr_jax.plr.tree import Cells

ROOM = scenes.maze().workspace
GOALS = ((0.1, 0.1), (0.3, 0.9), (0.9, 0.6), (0.5, 0.05))
INDEX = np.random.default_rng(0).integers(0, 4, 500)
X = np.random.default_rng(0).uniform(-0.1, 1.1, (500, 2)).astype(np.float32)


def built(leaf, goals=GOALS, max_leaves=16):
    return [construct(VisibilityGraph(ROOM, goal), UNIT, leaf=leaf, max_leaves=max_leaves) for goal in goals]


def periodic(k):
    around = Box((0, 0), (1, 1), (True, False))
    return construct(lambda q: np.sin(2 * np.pi * q[:, 0]) + k * q[:, 1] + 2, around, max_leaves=20)


@pytest.fixture(scope="module")
def mixed():
    """PLRs of one goal, of all leaf models and of several sizes."""
    return [built(leaf, GOALS[:1], n)[0] for leaf, n in zip(leaf_names(), cycle((9, 30, 20, 60)), strict=False)]


def test_stack_equals_its_plrs(mixed):
    """Up to operations that a compiler fuses in one function and not in the other."""
    folded = [construct(Euclidean((0.5, 0.5)), UNIT, max_leaves=20)] * 4
    for plrs in (built("plane"), built("cone"), mixed, folded, list(map(periodic, range(4)))):
        stacked = stack(plrs)
        assert len(stacked.groups) == len({plr.leaf.name for plr in plrs})
        expected = np.choose(INDEX, [np.asarray(plr(X)) for plr in plrs])
        np.testing.assert_allclose(np.asarray(stacked(INDEX, X)), expected, rtol=4e-7, atol=2e-7)
        assert np.isfinite(expected).any()


def test_stack_under_jit_vmap_and_grad(mixed):
    plrs, index, x = [mixed[0], mixed[3]], INDEX[:60] % 2, X[:60]
    stacked = stack(plrs)
    value, slope = jax.jit(lambda s, i, p: jax.vmap(jax.value_and_grad(s, argnums=1))(i, p))(stacked, index, x)
    np.testing.assert_allclose(value, stacked(index, x), rtol=1e-6)
    slope, inside = np.asarray(slope), np.isfinite(value)
    assert inside.sum() > 30 and not slope[~inside].any()
    for i, plr in enumerate(plrs):
        here = inside & (index == i)
        at, leaf = x[here].astype(float), plr.numpy().leaf(x[here])
        for axis, step in enumerate(1e-5 * np.eye(2)):
            above, below = (plr.values_in_leaves(leaf, at + sign * step) for sign in (1, -1))
            np.testing.assert_allclose(slope[here, axis], (above - below) / 2e-5, atol=2e-4)


def test_indices_broadcast_and_unknown_indices_give_nan():
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
        (lambda plr: PLR.stack([plr, plr])(np.zeros((5, 3, 3))), r"shape \(n, 2, dof\), got \(5, 3, 3\)"),
        (lambda plr: PLR.stack([plr, plr])(np.zeros((5, 2))), r"shape \(n, 2, dof\), got \(5, 2\)"),
        (lambda plr: PLR.stack([plr, plr])(np.zeros((5, 2, 1))), "robot 0 needs 2 coordinates, got .* of 1"),
    ],
)
def test_wrong_arguments_raise(call, message):
    with pytest.raises(ValueError, match=message):
        call(construct(walled, UNIT, max_leaves=9))


# One table of several partitions, against the cells' own integers.


def levels_of_all(partitions):
    return trie_levels(np.max([cells.depth.max(axis=0) for cells in partitions], axis=0))


def rows_of(partitions):
    """Return a row for each leaf of all partitions."""
    first = np.cumsum([0, *map(len, partitions)])
    return [begin + np.arange(len(cells)) for begin, cells in zip(first, partitions, strict=False)]


def assert_points_find_rows(partitions, seed=0):
    """Ask at leaf centers and at multiples of 2**-16, many of which lie on cell borders, in every partition."""
    dim, levels, rows = partitions[0].dim, levels_of_all(partitions), rows_of(partitions)
    tables = replace(tables_of_numbers(Cells.root(dim), 100), trie=build_trie(partitions, rows, levels))
    for number, (cells, row) in enumerate(zip(partitions, rows, strict=True)):
        x = np.random.default_rng(seed).integers(0, 2**16 + 1, size=(600, dim)) / 2.0**16
        x[: min(len(cells), 400)] = ((cells.position + 0.5) * 2.0**-cells.depth)[:400]
        start = tables.trie.start + np.full(len(x), number << levels[1].sum(), np.uint32)
        with jax.disable_jit():  # else a condition for each shape of a trie would be compiled
            found = find_row(replace(tables, trie=replace(tables.trie, start=start)), jnp.asarray(x, jnp.float32))
        np.testing.assert_array_equal(found, row[leaf_by_position(cells, x)])


@given(seed=st.integers(0, 1000), dim=st.sampled_from([1, 2, 3, 4]), sizes=st.lists(st.integers(0, 100), min_size=1))
def test_every_point_finds_its_leaf_in_each_partition(seed, dim, sizes):
    assert_points_find_rows([random_partition(seed + i, dim, size) for i, size in enumerate(sizes[:4])], seed)


@pytest.mark.parametrize("axes", [[0] * 22, [0, 1] * 13, [0] * 13 + [1] * 13, [0, 1, 2] * 7, [1] * 13])
def test_deep_leaves_are_found_beside_shallow_leaves(axes):
    deep = chain([*axes, *range(max(axes) + 1)][-len(axes) :])
    assert_points_find_rows([Cells.root(deep.dim), deep, random_partition(0, deep.dim, 30)])


def test_too_deep_partitions_are_refused():
    """Also if only their pages together would be too many."""
    too_deep = chain([0, 1] * 22)
    thin = Cells(np.full((1 << 17, 2), (17, 0)), np.stack([np.arange(1 << 17), np.zeros(1 << 17, int)], axis=1))
    for partitions in ([too_deep], [thin, chain([1] * 17)]):
        with pytest.raises(ValueError, match="too deep for a stack"):
            build_trie(partitions, rows_of(partitions), levels_of_all(partitions))
    build_trie([thin], rows_of([thin]), levels_of_all([thin]))


def test_one_point_is_answered_by_several_plrs():
    first, second = (construct(lambda x, k=k: k + x[:, 0], UNIT, max_leaves=2) for k in (1, 2))
    stacked, x = stack([first, second]), np.array([0.25, 0.5])
    again = pickle.loads(pickle.dumps(stacked))
    for index in (np.array([0, 1]), np.array([[1, 0, 0]])):
        for ask in (stacked, again, jax.jit(stacked)):
            np.testing.assert_allclose(ask(index, x), 1.25 + index, atol=1e-6)
    assert stacked(np.zeros(0, int), x).shape == (0,)
