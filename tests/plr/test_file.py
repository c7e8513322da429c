"""Files of all leaf models: what is written is read, and what has been damaged since is refused."""

import contextlib
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plr_helpers import contents_of_planes, random_contents, sealed, three_leaves, walled

from plr_jax.geometry.box import Box
from plr_jax.plr import Plane, construct, from_bytes
from plr_jax.plr._file import decode, decode_cells, encode
from plr_jax.plr.file.container import Container
from plr_jax.plr.leaves.plane.codec import StoredPlanes

MODELS = ("plane", "continuous", "smooth")


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 1000), dim=st.integers(1, 3), leaf=st.sampled_from(MODELS))
def test_what_is_read_is_what_was_written(seed, dim, leaf):
    contents = random_contents(seed, min(dim, 2) if leaf == "smooth" else dim, leaf)
    data = encode(contents)
    again = decode(data)
    assert again.domain == contents.domain and again.leaf.name == leaf
    np.testing.assert_array_equal(again.cells.depth, contents.cells.depth)
    np.testing.assert_array_equal(again.cells.position, contents.cells.position)
    np.testing.assert_array_equal(again.leaf.unreachable(again.stored), contents.leaf.unreachable(contents.stored))
    expected = contents.leaf.coefficients(contents.cells, contents.stored)
    np.testing.assert_array_equal(again.leaf.coefficients(again.cells, again.stored), expected)
    assert encode(again) == data
    np.testing.assert_array_equal(decode_cells(data).position, contents.cells.position)


def test_a_file_of_planes_by_hand():
    """8-bit centers; the widths of half-differences of depths 0 and 1 along each axis."""
    planes = StoredPlanes(8, 0.5, 0.25, np.array([7, 255, 2]), np.array([[3, -2], [0, 0], [-5, 1]]))
    domain, cells = Box((-1, 0), (1, 3)), three_leaves()
    fields = [(1, 1), (0, 1), (0, 1), (1, 1), (1, 1), (0, 1), (0, 1)]  # the tree: see test_container.py
    fields += [(8, 6), *((int(bits), 32) for bits in np.array([0.5, 0.25], np.float32).view(np.uint32))]
    # Along x all leaves are of depth 1: 3 and -5 take 4 bits. Along y the lower one is of depth 0: -2 takes 3 bits,
    # the uppermost of depth 1: 1 takes 2 bits.
    fields += [(0, 6), (4, 6), (3, 6), (2, 6)]
    fields += [(7, 8), (255, 8), (2, 8), (3, 4), (16 - 5, 4), (8 - 2, 3), (1, 2)]
    bits = "".join(f"{value:0{width}b}"[::-1] for value, width in fields)
    body = np.packbits([int(bit) for bit in bits], bitorder="little").tobytes()
    header = b"PLR\n" + bytes([2, 2, 0, 0]) + struct.pack("<II", 3, 0)
    expected = sealed(header + struct.pack("<4d", -1, 0, 1, 3) + body)
    assert encode(contents_of_planes(cells, planes, domain)) == expected


@pytest.mark.parametrize("dim", [1, 2, 3, 8])
@pytest.mark.parametrize("max_leaves", [30, 200])
@pytest.mark.parametrize("grow", ["chain", "anywhere"])
def test_every_file_that_construct_writes_can_be_read(dim, max_leaves, grow):
    """Whatever rules the caller gives, as deep as construction goes."""
    rng = np.random.default_rng(dim)

    def should_split(fit):
        in_chain = (fit.cells.position == 0).all(axis=1) & (grow == "chain")
        return np.where(in_chain, 1.0 + fit.cells.depth.sum(axis=1), rng.random(len(fit)) + 1e-3)

    def split(fit):
        return np.argmax((fit.cells.depth < fit.max_axis_depth) * (1 + rng.random(fit.cells.depth.shape)), axis=1)

    plr = construct(
        lambda x: np.sum((x - 0.01) ** 2, axis=1),
        (np.zeros(dim), np.ones(dim)),
        max_leaves=max_leaves,
        num_samples=dim + 1,
        should_split=should_split,
        split=split,
        leaf=Plane(coefficient_bits=4),
    )
    again = from_bytes(plr.to_bytes())
    assert again.num_leaves == plr.num_leaves > 15
    np.testing.assert_array_equal(again.tables.leaf_of_slot, plr.tables.leaf_of_slot)


@pytest.fixture(scope="module", params=MODELS)
def data(request):
    return construct(walled, ((0, 0), (1, 1)), leaf=request.param, max_bytes=150, num_samples=32).to_bytes()


def test_every_truncation_is_refused(data):
    for size in range(len(data)):
        with pytest.raises(ValueError):
            decode(data[:size])
    for size in range(16 + 32, len(data) - 4, 5):  # with a checksum that is right
        with pytest.raises(ValueError):
            decode(sealed(data[:size]))


def test_every_flipped_bit_is_refused(data):
    for position in range(len(data)):
        for bit in (0, 7):
            corrupt = bytearray(data)
            corrupt[position] ^= 1 << bit
            with pytest.raises(ValueError):
                decode(bytes(corrupt))


@settings(max_examples=40, deadline=None)
@given(st.data())
def test_a_forged_body_with_a_right_checksum_is_refused_or_read(data, draw):
    """No bytes, however made, may crash the reader with anything but ValueError."""
    body = bytearray(data[:-4])
    for _ in range(draw.draw(st.integers(1, 8))):
        body[draw.draw(st.integers(5, len(body) - 1))] = draw.draw(st.integers(0, 255))
    forged = sealed(bytes(body[: draw.draw(st.integers(16, len(body)))]))
    with contextlib.suppress(ValueError):
        assert from_bytes(forged).num_leaves > 0


def test_more_data_than_leaves_need_are_refused(data):
    with pytest.raises(ValueError, match="more data than its leaves need"):
        decode(sealed(data[:-4] + b"\0"))


def test_a_model_that_is_not_known_or_not_for_so_many_axes_is_refused(data):
    with pytest.raises(ValueError, match="it has leaves of kind 4, this release knows kinds 0 to 3"):
        decode(sealed(data[:6] + b"\x04" + data[7:-4]))
    ten_axes = Container(Box(np.zeros(10), np.ones(10)), 1, 1, b"").to_bytes()
    with pytest.raises(ValueError, match="up to 6 dimensions, got 10"):
        decode(ten_axes)


@pytest.mark.parametrize("leaf", MODELS)
def test_a_number_of_leaves_that_the_tree_has_not_is_refused(leaf):
    contents = random_contents(0, 2, leaf)
    data = encode(contents)
    for num_leaves in (0, 1, 2**32 - 1):
        with pytest.raises(ValueError, match=f"its header states {num_leaves}"):
            from_bytes(sealed(data[:8] + struct.pack("<I", num_leaves) + data[12:-4]))
