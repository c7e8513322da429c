"""Continuous leaves in files: the format stays, what is read is what was written, values are rounded."""

import hashlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plr_helpers import random_contents, three_leaves

from plr_jax import Box
from plr_jax.plr import Continuous
from plr_jax.plr._file import Contents, decode, encode
from plr_jax.plr.container import Container
from plr_jax.plr.faces import shared_faces
from plr_jax.plr.leaves.continuous import StoredValues, TiedPartition
from plr_jax.plr.tree import levels_of, tree_of


@settings(deadline=None, max_examples=40)
@given(seed=st.integers(0, 1000), dim=st.integers(1, 3), data=st.data())
def test_what_is_read_is_what_was_written(seed, dim, data):
    """Ties across the seams of a torus, too."""
    periodic = tuple(data.draw(st.lists(st.booleans(), min_size=dim, max_size=dim)))
    contents = random_contents(seed, dim, "continuous", periodic=periodic)
    again, stored = decode(encode(contents)), contents.stored
    assert again.domain == contents.domain
    for name in ("tree.leaves.position", "unreachable", "faces.axis", "tied"):
        found, expected = again.stored.partition, stored.partition
        for part in name.split("."):
            found, expected = getattr(found, part), getattr(expected, part)
        np.testing.assert_array_equal(found, expected)
    np.testing.assert_array_equal(again.stored.code, stored.code)
    np.testing.assert_array_equal(again.stored.decode(), stored.decode())


def partition_of(tied, unreachable=(False, False, False), periodic=()):
    """The faces between three leaves are those of leaves 0 and 1, 0 and 2, 1 and 2, unless there are seams too."""
    tree = tree_of(three_leaves())
    return TiedPartition(tree, np.array(unreachable), shared_faces(tree, periodic), np.array(tied))


@pytest.mark.parametrize(
    ("periodic", "tied", "expected"),
    [
        ((), (1, 0, 1), "60c20ec2ce8e3fbe2bff3084245fa7d9d42a9f87aaa60582cf58e38d384d5d6e"),
        ((True, True), (1, 0, 1, 1, 1, 0, 1), "0ee745206b59221ce517a3d4d2c56102d9649cfabed6850a98624992fd81d21d"),
    ],
)
def test_the_format_stays_as_it_is(periodic, tied, expected):
    partition = partition_of(np.array(tied, bool), periodic=periodic)
    stored = StoredValues(partition, 0.5, 0.25, 3 * np.arange(len(partition.space.masters)) ** 2 - 7)
    leaves, domain = partition.tree.leaves, Box((-1, 0), (1, 3), periodic or None)
    data = encode(Contents(domain, Continuous(), levels_of(leaves)[0], leaves, stored))
    assert hashlib.sha256(Container.from_bytes(data).last.body).hexdigest() == expected


def test_values_are_rounded_to_the_nearest_within_floats():
    partition = partition_of((True, True, True))
    values = np.random.default_rng(0).normal(size=len(partition.space.masters))
    stored = StoredValues.rounded(partition, values, 0.1)
    assert np.abs(stored.decode() - values).max() <= 0.05 + 1e-6
    np.testing.assert_allclose(stored.step, 0.1, rtol=1e-6)
    with pytest.raises(ValueError, match="scale them down"):
        StoredValues.rounded(partition, np.full(len(values), 1e31), 1.0)


def test_which_faces_may_be_tied():
    partition = partition_of((False, False, False), (False, True, False))
    assert partition.between_reachable().tolist() == [False, True, False]
