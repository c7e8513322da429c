import contextlib
import hashlib
import struct
import zlib

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plr_helpers import random_partition, three_leaves, walled

from plr_jax.geometry.box import Box
from plr_jax.plr import construct, from_bytes, load, save
from plr_jax.plr.file.plr_file import decode, encode, size_in_bytes
from plr_jax.plr.leaves.plane.codec import StoredPlanes, encode_planes
from plr_jax.plr.partition.tree import levels_of

SQUARE = Box((0, 0), (1, 1))


@given(
    seed=st.integers(0, 1000),
    dim=st.integers(1, 5),
    num_splits=st.integers(0, 40),
    bits=st.sampled_from([4, 11, 16, 20, 32]),
)
def test_encode_and_decode_are_inverse(seed, dim, num_splits, bits):
    rng = np.random.default_rng(seed)
    cells = random_partition(seed, dim, num_splits)
    center = np.where(rng.random(len(cells)) < 0.2, np.inf, rng.normal(size=len(cells)))
    center[0] = 1.0
    planes = encode_planes(center, rng.normal(size=(len(cells), dim)), bits)
    domain = Box(rng.normal(size=dim) - 5, rng.normal(size=dim) + 5)
    data, _ = encode(domain, cells, planes)
    assert len(data) == size_in_bytes(cells, planes)
    order = levels_of(cells)[1]
    again_domain, again_cells, again_planes = decode(data)
    assert again_domain == domain
    np.testing.assert_array_equal(again_cells.depth, cells.depth[order])
    np.testing.assert_array_equal(again_cells.position, cells.position[order])
    np.testing.assert_array_equal(again_planes.center, planes.center[order])
    np.testing.assert_array_equal(again_planes.half, planes.half[order])
    assert (again_planes.bits, again_planes.offset, again_planes.step) == (planes.bits, planes.offset, planes.step)


@pytest.mark.parametrize(
    "limits", [{"max_leaves": 60}, {"max_bytes": 900}, {"max_bytes": 900, "coefficient_bits": 16}]
)
def test_a_loaded_plr_equals_the_saved_one_bit_for_bit(limits, tmp_path):
    plr = construct(walled, SQUARE, **limits)
    save(plr, tmp_path / "walled.plr")
    again = load(str(tmp_path / "walled.plr"))
    assert (tmp_path / "walled.plr").stat().st_size == plr.num_bytes
    assert again.to_bytes() == plr.to_bytes()
    x = np.random.default_rng(0).random((10_000, 2))
    np.testing.assert_array_equal(np.asarray(again(x)).view(np.int32), np.asarray(plr(x)).view(np.int32))


def test_rounding_is_as_the_step_says():
    exact = construct(walled, SQUARE, max_leaves=60)
    rounded = construct(walled, SQUARE, max_leaves=60, coefficient_bits=8)
    x = np.random.default_rng(0).random((10_000, 2))
    difference = np.abs(np.asarray(exact(x)) - np.asarray(rounded(x)))
    assert 0 < difference.max() <= 1.5 * rounded.planes.step + 1e-6


def test_saving_leaves_no_other_files_and_replaces(tmp_path):
    for leaves in (4, 8):
        save(construct(walled, SQUARE, max_leaves=leaves), tmp_path / "a.plr")
    assert [path.name for path in tmp_path.iterdir()] == ["a.plr"]
    assert load(tmp_path / "a.plr").num_leaves == 8


def test_the_format_stays_as_it_is():
    planes = StoredPlanes(8, 0.5, 0.25, np.array([7, 255, 2]), np.array([[3, -2], [0, 0], [-5, 1]]))
    data, _ = encode(Box((-1, 0), (1, 3)), three_leaves(), planes)
    assert hashlib.sha256(data).hexdigest() == "a53e2916719ff77ebb7a40406a0d97a2734505034fe96e18a95bd89461458bad"


def reseal(data):
    """The bytes of a file with the size and checksum that they ought to have."""
    data = data[:12] + struct.pack("<I", len(data) + 4) + data[16:]
    return data + struct.pack("<I", zlib.crc32(data))


@pytest.fixture(scope="module")
def data():
    return construct(walled, SQUARE, max_bytes=400).to_bytes()


def test_every_truncation_is_refused(data):
    for size in range(len(data)):
        with pytest.raises(ValueError):
            from_bytes(data[:size])
    with pytest.raises(ValueError, match="truncated or corrupt"):
        from_bytes(data + b"\0")


def test_every_flipped_bit_is_refused(data):
    for position in range(len(data)):
        for bit in (0, 7):
            corrupt = bytearray(data)
            corrupt[position] ^= 1 << bit
            with pytest.raises(ValueError):
                from_bytes(bytes(corrupt))


@given(st.data())
def test_a_forged_body_with_a_right_checksum_is_refused_or_read(data, draw):
    """No bytes, however made, may crash the reader with anything but ValueError."""
    body = bytearray(data[: -struct.calcsize("<I")])
    for _ in range(draw.draw(st.integers(1, 8))):
        body[draw.draw(st.integers(5, len(body) - 1))] = draw.draw(st.integers(0, 255))
    forged = reseal(bytes(body[: draw.draw(st.integers(16, len(body)))]))
    with contextlib.suppress(ValueError):
        assert decode(forged)[1].depth.shape[1] > 0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda data: b"PK\x03\x04" + data[4:], "does not start like a PLR file"),
        (lambda data: b"", "does not start like a PLR file"),
        (lambda data: reseal(data[:40]), "end too early"),
        (lambda data: reseal(data[:48] + struct.pack("<ff", 0, np.nan) + data[56:-4]), "states a step of nan"),
        (lambda data: reseal(data[:48] + struct.pack("<ff", 0, 0) + data[56:-4]), "states a step of 0"),
        (lambda data: data[:4] + b"\x09" + data[5:], "format version 9.*update plr_jax"),
        (lambda data: data[:-50], "truncated"),
        (lambda data: data[:60] + b"\xaa\xaa" + data[62:], "checksum"),
    ],
)
def test_load_says_what_is_wrong(data, change, message, tmp_path):
    path = tmp_path / "bad.plr"
    path.write_bytes(change(data))
    with pytest.raises(ValueError, match=message) as error:
        load(path)
    assert "bad.plr" in str(error.value)


def test_a_missing_file_is_an_os_error(tmp_path):
    with pytest.raises(FileNotFoundError):
        load(tmp_path / "none.plr")


@pytest.mark.parametrize("options", [{"max_leaves": 60}, {"max_bytes": 700}], ids=["floats", "integers"])
def test_what_is_built_equals_what_its_file_holds_bit_for_bit(options):
    plr = construct(walled, Box((0, 0), (1, 1)), **options)
    again = from_bytes(plr.to_bytes())
    for mine, theirs in zip(jax.tree_util.tree_leaves(plr), jax.tree_util.tree_leaves(again), strict=True):
        np.testing.assert_array_equal(mine, theirs)
