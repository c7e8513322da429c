import hashlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plr_helpers import random_contents, three_leaves

from plr_jax.geometry.box import Box
from plr_jax.plr import Continuous
from plr_jax.plr._file import Contents, decode, encode
from plr_jax.plr.file.bits import BitReader, BitWriter
from plr_jax.plr.file.container import Container
from plr_jax.plr.leaves.continuous.codec import StoredValues, TiedPartition, read_values, write_values
from plr_jax.plr.partition.cells import levels_of, tree_of
from plr_jax.plr.partition.faces import shared_faces


@settings(deadline=None, max_examples=20)
@given(seed=st.integers(0, 1000), dim=st.integers(1, 3))
def test_what_is_read_is_what_was_written(seed, dim):
    contents = random_contents(seed, dim, "continuous")
    stored = contents.stored
    body = BitWriter()
    write_values(body, stored)
    reader = BitReader(body.to_bytes())
    again = read_values(reader, contents.cells)
    assert reader.at_end()
    np.testing.assert_array_equal(again.partition.tree.leaves.position, stored.partition.tree.leaves.position)
    np.testing.assert_array_equal(again.partition.unreachable, stored.partition.unreachable)
    np.testing.assert_array_equal(again.partition.tied, stored.partition.tied)
    np.testing.assert_array_equal(again.code, stored.code)
    np.testing.assert_array_equal(again.decode(), stored.decode())


def hash_of_leaves(data):
    """Of what a file keeps of a tree and its leaves, besides what all files have."""
    return hashlib.sha256(Container.from_bytes(data).last.body).hexdigest()


def test_the_format_stays_as_it_is():
    tree = tree_of(three_leaves())
    partition = TiedPartition(tree, np.zeros(3, bool), shared_faces(tree), np.array([True, False, True]))
    stored = StoredValues(partition, 0.5, 0.25, 3 * np.arange(8) ** 2 - 7)
    data = encode(Contents(Box((-1, 0), (1, 3)), Continuous(), levels_of(tree.leaves)[0], tree.leaves, stored))
    assert hash_of_leaves(data) == "60c20ec2ce8e3fbe2bff3084245fa7d9d42a9f87aaa60582cf58e38d384d5d6e"


def test_the_format_of_a_torus_stays_as_it_is():
    tree, periodic = tree_of(three_leaves()), (True, True)
    faces = shared_faces(tree, periodic)
    tied = np.array([True, False, True, True, True, False, True])
    partition = TiedPartition(tree, np.zeros(3, bool), faces, tied)
    stored = StoredValues(partition, 0.5, 0.25, 3 * np.arange(len(partition.space.masters)) ** 2 - 7)
    domain = Box((-1, 0), (1, 3), periodic)
    data = encode(Contents(domain, Continuous(), levels_of(tree.leaves)[0], tree.leaves, stored))
    assert hash_of_leaves(data) == "0ee745206b59221ce517a3d4d2c56102d9649cfabed6850a98624992fd81d21d"
    np.testing.assert_array_equal(decode(data).stored.partition.tied, tied)


@settings(deadline=None, max_examples=20)
@given(seed=st.integers(0, 1000), dim=st.integers(1, 3), data=st.data())
def test_ties_across_seams_are_read_as_they_were_written(seed, dim, data):
    periodic = tuple(data.draw(st.lists(st.booleans(), min_size=dim, max_size=dim)))
    contents = random_contents(seed, dim, "continuous", periodic=periodic)
    again = decode(encode(contents))
    assert again.domain == contents.domain
    np.testing.assert_array_equal(again.stored.partition.faces.axis, contents.stored.partition.faces.axis)
    np.testing.assert_array_equal(again.stored.partition.tied, contents.stored.partition.tied)
    np.testing.assert_array_equal(again.stored.code, contents.stored.code)


def test_values_are_rounded_to_the_nearest():
    tree = tree_of(three_leaves())
    faces = shared_faces(tree)
    partition = TiedPartition(tree, np.zeros(3, bool), faces, np.ones(3, bool))
    values = np.random.default_rng(0).normal(size=len(partition.space.masters))
    stored = StoredValues.rounded(partition, values, 0.1)
    assert np.abs(stored.decode() - values).max() <= 0.05 + 1e-6
    np.testing.assert_allclose(stored.step, 0.1, rtol=1e-6)


def test_which_faces_may_be_tied():
    tree = tree_of(three_leaves())
    faces = shared_faces(tree)  # of leaves 0 and 1, 0 and 2, 1 and 2
    partition = TiedPartition(tree, np.array([False, True, False]), faces, np.zeros(3, bool))
    assert partition.between_reachable().tolist() == [False, True, False]


def test_values_beyond_floats_are_refused():
    tree = tree_of(three_leaves())
    partition = TiedPartition(tree, np.zeros(3, bool), shared_faces(tree), np.zeros(3, bool))
    with pytest.raises(ValueError, match="scale them down"):
        StoredValues.rounded(partition, np.full(12, 1e31), 1.0)
