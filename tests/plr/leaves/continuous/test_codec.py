import hashlib
import struct
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plr_helpers import random_partition, three_leaves

from plr_jax.geometry.box import Box
from plr_jax.plr import construct
from plr_jax.plr.file.bits import BitReader, BitWriter
from plr_jax.plr.leaves.continuous.codec import (
    Partition,
    StoredValues,
    _read_numbers,
    _read_set,
    _write_numbers,
    _write_set,
    decode,
    encode,
)
from plr_jax.plr.partition.faces import shared_faces, tree_of


def random_file(seed, dim):
    rng = np.random.default_rng(seed)
    tree = tree_of(random_partition(seed, dim, 20))
    faces = shared_faces(tree)
    unreachable = rng.random(21) < 0.2
    partition = Partition(tree, unreachable, faces, rng.random(len(faces)) < 0.8)
    partition.tied[~partition.between_reachable()] = False
    space = partition.space()
    values = StoredValues.rounded(rng.normal(size=len(space.masters)) if len(space.masters) else np.zeros(0), 0.01)
    return Box(np.zeros(dim), np.full(dim, 2.0)), 0, partition, space, values


@settings(deadline=None, max_examples=30)
@given(seed=st.integers(0, 1000), dim=st.integers(1, 3))
def test_what_is_read_is_what_was_written(seed, dim):
    domain, order, partition, space, values = random_file(seed, dim)
    data = encode(domain, order, partition, space, values)
    read_domain, read_order, read_partition, read_space, read_values = decode(data)
    assert (read_domain, read_order) == (domain, order)
    np.testing.assert_array_equal(read_partition.tree.leaves.position, partition.tree.leaves.position)
    np.testing.assert_array_equal(read_partition.unreachable, partition.unreachable)
    np.testing.assert_array_equal(read_partition.tied, partition.tied)
    np.testing.assert_array_equal(read_values.decode(), values.decode())
    assert encode(read_domain, read_order, read_partition, read_space, read_values) == data


@settings(deadline=None, max_examples=30)
@given(values=st.lists(st.integers(0, 2**39)))
def test_numbers_of_any_size(values):
    body = BitWriter()
    _write_numbers(body, np.array(values, np.int64))
    body.write(np.array([1]), 1)
    reader = BitReader(body.to_bytes())
    assert _read_numbers(reader, len(values)).tolist() == values
    assert reader.read_alike(1, 1)[0] == 1


@settings(deadline=None, max_examples=30)
@given(member=st.lists(st.booleans()))
def test_sets(member):
    body = BitWriter()
    _write_set(body, np.array(member, bool))
    assert _read_set(BitReader(body.to_bytes()), len(member)).tolist() == member


def test_a_set_beyond_its_size_is_refused():
    body = BitWriter()
    _write_set(body, np.ones(5, bool))
    with pytest.raises(ValueError, match="member 4 of 4"):
        _read_set(BitReader(body.to_bytes()), 4)


def test_the_format_stays_as_it_is():
    tree = tree_of(three_leaves())
    partition = Partition(tree, np.zeros(3, bool), shared_faces(tree), np.array([True, False, True]))
    values = StoredValues(0.5, 0.25, 3 * np.arange(8) ** 2 - 7)
    data = encode(Box((-1, 0), (1, 3)), 0, partition, partition.space(), values)
    assert hashlib.sha256(data).hexdigest() == "edf061e51a457e1a345fd57a383ba0c6bb7ab2bb05a5fd04411514d64bd3a9fb"


def resigned(data):
    return data[:-4] + struct.pack("<I", zlib.crc32(data[:-4]))


def test_files_that_are_not_whole_are_refused():
    data = encode(*random_file(3, 2))
    for broken, message in (
        (b"PLR\n" + data[4:], "does not start like"),
        (data[:10], "too early"),
        (data[:-1], "truncated or corrupt"),
        (data[:60] + bytes([data[60] ^ 1]) + data[61:], "checksum"),
        (resigned(data[:4] + b"\x09" + data[5:]), "format version 9"),
        (resigned(data[:6] + b"\x02" + data[7:]), "continuity of order 2"),
        (construct(lambda x: x[:, 0], ((0, 0), (1, 1)), max_leaves=2).to_bytes(), "does not start like"),
    ):
        with pytest.raises(ValueError, match=message):
            decode(broken)


def test_values_beyond_floats_are_refused():
    with pytest.raises(ValueError, match="scale them down"):
        StoredValues.rounded(np.array([1e31]), 1.0)
