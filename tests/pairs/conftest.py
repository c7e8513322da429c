"""Pairs of the maze and of one wall, made once: queries of each are compiled once for a number of points."""

import pytest
from pair_helpers import MAZE, WALL

from plr_jax import construct_pairs


@pytest.fixture(scope="session")
def maze():
    return construct_pairs(MAZE, max_bytes=1024)


@pytest.fixture(scope="session")
def wall():
    return construct_pairs(WALL, max_bytes=512)
