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


def test_there_are_some_and_they_are_small():
    assert len(NAMES) >= 8
    assert sum(path.stat().st_size for path in Path(FOLDER).iterdir()) < 100_000


def test_answers_are_equal_to_the_bit(vector):
    path, x, table = vector
    f = load_numpy(path)
    expected = of_bits(table["distances"])
    np.testing.assert_array_equal(f(x), expected)  # any NaN is like any other
    is_number = ~np.isnan(expected)
    np.testing.assert_array_equal(f(x)[is_number].view(np.uint32), expected[is_number].view(np.uint32))
    if "waypoints" in table:
        expected = [[float.fromhex(along) for along in point] for point in table["waypoints"]]
        np.testing.assert_array_equal(f.waypoint(x), np.array(expected, table["type"]))


def test_files_are_read_by_jax_alike(vector):
    path, x, table = vector
    np.testing.assert_allclose(load(path)(x), of_bits(table["distances"]), rtol=1e-5, atol=1e-5)
