"""Pairs of the maze and of one wall, made once: queries of each are compiled once for a number of points."""

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
    """Answer few pairs by the compiled function too, not in NumPy."""
    monkeypatch.setattr(pair_plr, "_FEW_TESTS", 0)


@pytest.fixture(params=["few", "compiled"])
def either_way(request):
    """Answer few pairs in NumPy, then by the compiled function."""
    if request.param == "compiled":
        request.getfixturevalue("compiled")
