"""Fixtures of tests of pairs: the pairs of the maze, and answers of compiled functions for small batches too."""

import pytest
from pair_helpers import MAZE

from plr_jax import construct_pairs
from plr_jax.pairs import pair_plr


@pytest.fixture(scope="session")
def maze():
    return construct_pairs(MAZE, max_bytes=1024)


@pytest.fixture
def compiled(monkeypatch):
    """Make the compiled function answer small batches too, instead of NumPy."""
    monkeypatch.setattr(pair_plr, "_FEW_TESTS", 0)


@pytest.fixture(params=["few", pytest.param("compiled", marks=pytest.mark.full)])
def either_way(request):
    """Run a test with small batches answered in NumPy; in the full tier also by the compiled function."""
    if request.param == "compiled":
        request.getfixturevalue("compiled")
