import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from plr_helpers import UNIT, chain, leaf_by_position, random_partition
from plr_helpers import tables_of_numbers as tables_of

from plr_jax import VisibilityGraph, construct, scenes
from plr_jax.plr import Plane
from plr_jax.plr import query as lookup_module
from plr_jax.plr import tables as tables_module
from plr_jax.plr._plr import leaf_of
from plr_jax.plr.tables import build_tables

# Compiled: operation by operation each shape would be compiled for each of them.
lookup, evaluate_tables, outside_domain = map(
    jax.jit, (lookup_module.lookup, lookup_module.evaluate_tables, lookup_module.outside_domain)
)


@pytest.mark.parametrize("flat_bits", [20, 0], ids=["flat", "two-level"])
@settings(max_examples=15)
@given(seed=st.integers(0, 1000), dim=st.sampled_from([1, 2, 10]), num_splits=st.integers(1, 60))
def test_lookup_finds_the_leaf_that_holds_the_point(flat_bits, seed, dim, num_splits):
    cells = random_partition(seed, dim, num_splits)
    bits = cells.depth.max(axis=0)
    assume(bits.max() <= 15 and bits.sum() <= 20)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tables_module, "MAX_FLAT_BITS", flat_bits)
        tables = tables_of(cells, 40_000)  # of a class with few sizes of tables, each of which is compiled
    assert (tables.blocks is None) == (flat_bits == 20)
    # Multiples of 2**-16 are exact, and many lie on cell borders.
    x = np.random.default_rng(seed).integers(0, 2**16 + 1, size=(200, dim)) / 2.0**16
    np.testing.assert_array_equal(lookup(tables, jnp.asarray(x, jnp.float32)), leaf_by_position(cells, x))


@pytest.mark.parametrize("axes", [[0] * 23, [0, 1] * 14, [0, 1, 2] * 9], ids=["line", "plane", "space"])
def test_cells_as_deep_as_a_query_resolves(axes):
    cells = chain(axes)
    tables = tables_of(cells, 1000)
    x = np.ldexp(cells.position + 0.25, -cells.depth)  # the finest are one last bit wide, whose middle is rounded
    assert tables.blocks is not None
    np.testing.assert_array_equal(lookup(tables, jnp.asarray(x, jnp.float32)), np.arange(len(cells)))


def test_large_tables_have_a_leafs_numbers_side_by_side_and_answer_alike(monkeypatch):
    cells = random_partition(0, 2, 40)
    numbers = np.random.default_rng(0).normal(size=(41, 3))
    small = build_tables(UNIT, cells, numbers, Plane(), 1000)
    monkeypatch.setattr(tables_module, "_MAX_COLUMN_BYTES", 0)
    large = build_tables(UNIT, cells, numbers, Plane(), 1000)
    assert small.numbers.ndim == 2 and large.numbers.ndim == 1
    x = jnp.asarray(np.random.default_rng(0).random((500, 2)), jnp.float32)
    np.testing.assert_array_equal(evaluate_tables(large, x), evaluate_tables(small, x))


def test_points_beside_borders_are_answered_by_the_leaf_that_is_found_for_them():
    """A block and what lies within it are of one rounding, also where a compiler computes them apart."""
    problem = scenes.floor_plan()
    oracle = VisibilityGraph(problem.workspace, problem.goals[0][:2])
    plr = construct(oracle, problem.workspace.bounds, leaf="continuous", max_bytes=4096, certified=True)
    assert plr.tables.blocks is not None
    rng, (lo, hi) = np.random.default_rng(0), plr.leaf_boxes
    leaf = rng.integers(plr.num_leaves, size=20_000)
    x, axis = lo[leaf] + (hi - lo)[leaf] * rng.random((len(leaf), 2)), rng.integers(2, size=len(leaf))
    beside = rng.uniform(-1, 1, len(leaf)) * 2.0**-22 * plr.domain.width[axis]
    border = np.where(rng.random(len(leaf)) < 0.5, lo[leaf, axis], hi[leaf, axis])
    x[np.arange(len(leaf)), axis] = border + beside
    x = np.clip(x, plr.domain.lo, plr.domain.hi).astype(np.float32).astype(float)
    found = plr.values_in_leaves(leaf_of(plr, x), x)
    np.testing.assert_allclose(np.asarray(plr(x), float), found, rtol=0, atol=1e-3)
