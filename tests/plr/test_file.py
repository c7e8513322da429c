"""Files of all leaf models: what is written is read, and what has been damaged since is refused."""

import contextlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plr_helpers import UNIT, contents_of_planes, points, random_contents, sealed, three_leaves, walled

from plr_jax import VisibilityGraph, Workspace
from plr_jax._io import load, save
from plr_jax.geometry.box import Box
from plr_jax.plr import Plane, construct, from_bytes, progressive
from plr_jax.plr._file import decode, decode_cells, encode
from plr_jax.plr.file.container import Container, Header, Layer
from plr_jax.plr.leaves.plane import StoredPlanes

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
    fields = [(1, 1), (0, 1), (0, 1), (1, 1), (1, 1), (0, 1), (0, 1)]  # the tree: see test_tree.py
    fields += [(8, 6), *((int(bits), 32) for bits in np.array([0.5, 0.25], np.float32).view(np.uint32))]
    # Along x all leaves are of depth 1: 3 and -5 take 4 bits. Along y the lower one is of depth 0: -2 takes 3 bits,
    # the uppermost of depth 1: 1 takes 2 bits.
    fields += [(0, 6), (4, 6), (3, 6), (2, 6)]
    fields += [(7, 8), (255, 8), (2, 8), (3, 4), (16 - 5, 4), (8 - 2, 3), (1, 2)]
    bits = "".join(f"{value:0{width}b}"[::-1] for value, width in fields)
    body = np.packbits([int(bit) for bit in bits], bitorder="little").tobytes()
    header = b"P\xb5" + bytes([5 | 2 << 4, 0, 0, 1, 0, 2, 6])  # see test_container.py
    assert encode(contents_of_planes(cells, planes, domain)) == sealed(header + body)


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


def test_every_truncation_with_a_right_checksum_is_refused(data):
    for size in range(9, len(data) - 4, 5):
        with pytest.raises(ValueError):
            decode(sealed(data[:size]))


@settings(max_examples=40, deadline=None)
@given(st.data())
def test_a_forged_body_with_a_right_checksum_is_refused_or_read(data, draw):
    """No bytes, however made, may crash the reader with anything but ValueError."""
    body = bytearray(data[:-4])
    for _ in range(draw.draw(st.integers(1, 8))):
        body[draw.draw(st.integers(3, len(body) - 1))] = draw.draw(st.integers(0, 255))
    forged = sealed(bytes(body[: draw.draw(st.integers(9, len(body)))]))
    with contextlib.suppress(ValueError):
        assert from_bytes(forged).num_leaves > 0


def test_more_data_than_leaves_need_are_refused(data):
    with pytest.raises(ValueError, match="more data than its leaves need"):
        decode(sealed(data[:-4] + b"\0"))


def test_a_model_that_is_not_known_or_not_for_so_many_axes_is_refused(data):
    with pytest.raises(ValueError, match="it has leaves of kind 4, this release knows kinds 0 to 3"):
        decode(sealed(data[:3] + bytes([data[3] & ~7 | 4]) + data[4:-4]))
    ten_axes = Container(Box(np.zeros(10), np.ones(10)), (Layer(1, b""),)).to_bytes()
    with pytest.raises(ValueError, match="up to 6 dimensions, got 10"):
        decode(ten_axes)


LAYERS = [
    ("cone", {"certified": True}),
    ("continuous", {"num_samples": 32}),
    ("plane", {"certified": True, "leaf_bounds": True}),
    ("smooth", {"num_samples": 32}),
]


@pytest.fixture(scope="module")
def layered():
    """PLRs of one map, of all models and kinds of proofs, and the file of all of them."""
    wall = [[0.4, 0], [0.5, 0], [0.5, 0.7], [0.4, 0.7]]
    oracle, sizes = VisibilityGraph(Workspace(((0, 0), (1, 1)), [wall]), (0.1, 0.1)), (200, 400, 800, 1600)
    plrs = [
        construct(oracle, UNIT, leaf=leaf, max_bytes=size, **options)
        for size, (leaf, options) in zip(sizes, LAYERS, strict=True)
    ]
    layers = tuple(Container.from_bytes(plr.to_bytes()).last for plr in plrs)
    return plrs, Container(UNIT, layers, label="walls").to_bytes()


def ends(data):
    return (*Header.read(data).marks, len(data))


def test_up_to_each_mark_a_file_is_the_coarser_plr(layered, tmp_path):
    plrs, data = layered
    x = points(500, 3)
    assert len(ends(data)) == len(plrs)
    for end, plr, (leaf, options) in zip(ends(data), plrs, LAYERS, strict=True):
        (tmp_path / "cut.plr").write_bytes(data[:end])
        cut = load(tmp_path / "cut.plr")
        assert cut.leaf.name == leaf and cut.num_leaves == plr.num_leaves and cut.domain == plr.domain
        np.testing.assert_array_equal(cut(x), plr(x))
        assert cut.to_bytes() == data[:end] and cut.num_bytes == end
        if "certified" in options:
            assert cut.max_error == plr.max_error
        if "leaf_bounds" in options:
            np.testing.assert_array_equal(cut.bounds(x), plr.bounds(x))


def test_the_cells_of_the_last_layer_there_is_are_read_alone(layered):
    plrs, data = layered
    for end, plr in zip(ends(data), plrs, strict=True):
        np.testing.assert_array_equal(decode_cells(data[:end]).position, plr.cells.position)


def test_progressive_files_are_such_and_keep_their_label_when_they_are_written_again(layered, tmp_path):
    plrs, data = layered
    whole = progressive(plrs).with_label("walls")
    assert whole.to_bytes() == data and whole.file_marks == ends(data)[:-1] and whole.label == "walls"
    save(whole, tmp_path / "whole.plr")
    assert load(tmp_path / "whole.plr").to_bytes() == data
    for number, mark in enumerate(whole.file_marks):
        assert from_bytes(data[:mark]).label == "walls"
        assert from_bytes(data[:mark]).file_marks == whole.file_marks[:number]
    assert whole.with_label("").with_label("walls").to_bytes() == data
    assert from_bytes(whole.with_label("").to_bytes()).label == ""


@pytest.mark.parametrize(
    ("code", "message"), [(4, "leaves of kind 4"), (8, "leaves of kind 8"), (7, "use load_pairs")]
)
def test_a_coarser_layer_of_a_model_that_is_not_known_is_refused_where_it_is_the_last(code, message):
    data = Container(UNIT, (Layer(code, b"body"), Layer(0, b"body"))).to_bytes()
    with pytest.raises(ValueError, match=message):
        from_bytes(data[: ends(data)[0]])


def test_a_coarser_layer_of_a_proof_that_is_not_known_is_refused_where_it_is_the_last():
    layer = Container.from_bytes(encode(random_contents(0, 2, "plane"))).last
    data = Container(UNIT, (Layer(0, layer.body, 9), layer)).to_bytes()
    with pytest.raises(ValueError, match="a proof of kind 9, this release knows kinds 0 to 3"):
        from_bytes(data[: ends(data)[0]])


def test_plrs_of_more_than_fifteen_axes_are_read_as_they_were_written():
    plr = construct(lambda x: np.abs(x).sum(axis=1), (np.zeros(18), np.ones(18)), max_leaves=5, num_samples=64)
    again = from_bytes(plr.to_bytes())
    x = points(100, 0, 18)
    np.testing.assert_array_equal(again(x), plr(x))
    assert again.to_bytes() == plr.to_bytes() and again.domain == plr.domain
