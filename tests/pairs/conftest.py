"""Fixtures of tests of pairs: pairs of the maze and of one wall, built once, so that few queries are compiled."""

import pytest
from pair_helpers import MAZE, WALL

from plr_jax import construct_pairs
from plr_jax.pairs import pair_plr


@pytest.fixture(scope="session")
def maze():
    return construct_pairs(MAZE, max_bytes=1024)


@pytest.fixture(scope="session")
def wall():
    return construct_pairs(WALL, max_bytes=512)


@pytest.fixture
def compiled(monkeypatch):
    """Make the compiled function answer small batches too, instead of NumPy."""
    monkeypatch.setattr(pair_plr, "_FEW_TESTS", 0)


@pytest.fixture(params=["few", "compiled"])
def either_way(request):
    """Run a test twice: with small batches answered in NumPy, and by the compiled function."""
    if request.param == "compiled":
        request.getfixturevalue("compiled")
