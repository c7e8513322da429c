"""The answers in ``tests/plr/vectors``: what every reader of the format must give, bit for bit."""

import json
from pathlib import Path

import numpy as np
import pytest
from vectors import FOLDER, vector_names

from plr_jax import load, load_numpy

NAMES = vector_names()


@pytest.fixture(params=NAMES)
def vector(request):
    """Path of a file, points, and what is answered there."""
    table = json.loads((FOLDER / f"{request.param}.json").read_text())
    x = np.array([[float.fromhex(along) for along in point] for point in table["points"]], table["type"])
    return FOLDER / f"{request.param}.plr", x, table


def of_bits(texts):
    return np.array([int(text, 16) for text in texts], np.uint32).view(np.float32)


def require_same_bits(answer, expected):
    """Arrays are equal to the bit, but any NaN is like any other."""
    np.testing.assert_array_equal(answer, expected)
    is_number = ~np.isnan(expected)
    np.testing.assert_array_equal(np.signbit(answer)[is_number], np.signbit(expected)[is_number])


def test_there_are_some_and_they_are_small():
    assert len(NAMES) >= 8
    assert sum(path.stat().st_size for path in Path(FOLDER).iterdir()) < 300_000


def test_answers_are_equal_to_the_bit(vector):
    path, x, table = vector
    f = load_numpy(path)
    require_same_bits(f(x), of_bits(table["distances"]))
    if "waypoints" in table:
        expected = [[float.fromhex(along) for along in point] for point in table["waypoints"]]
        require_same_bits(f.waypoint(x), np.array(expected, table["type"]))


def test_files_are_read_by_jax_alike(vector):
    path, x, table = vector
    plr = load(path)
    answer, expected = np.asarray(plr(x)), of_bits(table["distances"])
    if x.dtype == np.float64 and plr.container.folding is not None:  # far from the origin, host code folds and wraps
        near = ~((np.abs(x) > 1e9) & np.isfinite(x)).any(axis=1)  # farther around, it is elsewhere
        np.testing.assert_allclose(answer[near], expected[near], rtol=3e-7)
        assert np.mean((answer == expected)[near]) > 0.9
        return
    known = ((x == 0) | ~(np.abs(x) < np.finfo(np.float32).tiny)).all(axis=1)  # XLA takes what is smaller for 0
    assert known.mean() > 0.8
    require_same_bits(answer[known], expected[known])
