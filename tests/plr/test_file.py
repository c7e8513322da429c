"""Files of all leaf models: what is written is read, and what nobody wrote is refused before it costs much."""

import contextlib
import struct
import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plr_helpers import chain, contents_of_planes, random_contents, sealed, three_leaves, walled

from plr_jax.geometry.box import Box
from plr_jax.plr import Plane, construct, from_bytes
from plr_jax.plr._file import Contents, decode, decode_cells, encode
from plr_jax.plr._plr import with_stored
from plr_jax.plr.file.bits import BitWriter
from plr_jax.plr.file.container import Container, write_tree
from plr_jax.plr.leaves import code_of_leaf, leaf_model
from plr_jax.plr.leaves.plane.codec import StoredPlanes, encode_planes
from plr_jax.plr.partition.cells import Cells
from plr_jax.plr.partition.tree import Level, levels_of, tree_of_levels

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
    with pytest.raises(ValueError, match="it has leaves of kind 3, this release knows kinds 0 to 2"):
        decode(sealed(data[:6] + b"\x03" + data[7:-4]))
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


def quarters_in_another_order():
    """Quarters of a square, first split along axis 1, in the order of that tree, and its levels."""
    inner = np.array([True, True])
    levels = [
        Level(inner[:1], np.array([1])),
        Level(inner, np.array([0, 0])),
        Level(np.zeros(4, bool), np.zeros(0, int)),
    ]
    return levels, tree_of_levels(levels, 2).leaves


def test_planes_of_a_tree_that_splits_in_another_order_stay_in_their_leaves():
    levels, cells = quarters_in_another_order()
    contents = Contents(
        Box((0, 0), (1, 1)), Plane(), levels, cells, encode_planes(np.arange(4.0), np.zeros((4, 2)), 32)
    )
    plr = from_bytes(encode(contents))
    again = with_stored(plr, plr.stored)
    assert again.to_bytes() == plr.to_bytes()
    for each in (plr, again, from_bytes(again.to_bytes())):
        assert each(np.array([[0.1, 0.1], [0.9, 0.1], [0.1, 0.9], [0.9, 0.9]])).tolist() == [0, 1, 2, 3]


def test_continuous_leaves_of_a_tree_that_splits_in_another_order_are_refused():
    body = BitWriter()
    write_tree(body, quarters_in_another_order()[0], 2)
    sets(body, [0, 0])
    with pytest.raises(ValueError, match="splits its leaves along other axes first"):
        from_bytes(
            Container(Box((0, 0), (1, 1)), code_of_leaf(leaf_model("continuous")), 4, body.to_bytes()).to_bytes()
        )


def with_body(leaf, dim, cells, write):
    """A file of some cells, whose leaves' numbers are written by hand."""
    body = BitWriter()
    write_tree(body, levels_of(cells)[0], dim)
    write(body)
    return Container(Box(np.zeros(dim), np.ones(dim)), code_of_leaf(leaf_model(leaf)), len(cells), body.to_bytes())


@pytest.mark.parametrize(
    ("bits", "offset", "step", "message"),
    [
        (8, 0.0, np.nan, "it states a step of nan from 0.0"),
        (8, 0.0, 0.0, "it states a step of 0.0"),
        (8, 0.0, -1.0, "it states a step of -1.0"),
        (8, 0.0, np.inf, "it states a step of inf"),
        (8, np.nan, 1.0, "it states a step of 1.0 from nan"),
        (3, 0.0, 1.0, "it states 3-bit values"),
        (33, 0.0, 1.0, "it states 33-bit values"),
        (8, 0.0, 1e30, "too large for 32-bit floats"),
    ],
)
def test_planes_of_impossible_numbers_are_refused(bits, offset, step, message):
    def write(body):
        body.write(np.array([bits]), 6).write_floats(np.array([offset, step]))
        body.write(np.zeros(4, np.int64), 6).write(np.full(3, 77), 8)

    with pytest.raises(ValueError, match=message):
        from_bytes(with_body("plane", 2, three_leaves(), write).to_bytes())


@pytest.mark.parametrize("number", [np.nan, -np.inf, 1e31])
@pytest.mark.parametrize("where", ["center", "half"])
def test_float_planes_that_are_not_finite_are_refused(number, where):
    bits = np.array([1.0, number, 2.0]).astype(np.float32).view(np.uint32).astype(np.int64)
    zeros = np.zeros(3, np.int64)
    center, half = (bits, zeros) if where == "center" else (zeros, bits)
    planes = StoredPlanes(32, 0.0, 1.0, center, np.stack([half, zeros], axis=1))
    cells = three_leaves()
    data = encode(contents_of_planes(cells, planes))
    with pytest.raises(ValueError, match="too large for 32-bit floats"):
        from_bytes(data)


def test_half_differences_of_more_than_32_bits_are_refused():
    def write(body):
        body.write(np.array([8]), 6).write_floats(np.array([0.0, 1.0])).write(np.array([0, 33, 1, 1]), 6)

    with pytest.raises(ValueError, match="numbers of more than 32 bits"):
        from_bytes(with_body("plane", 2, three_leaves(), write).to_bytes())


EMPTY = np.zeros(3, bool)


@pytest.mark.parametrize(
    ("write", "message"),
    [
        (lambda body: body.write_floats(np.array([0.0, np.nan])), "it states a step of nan"),
        (lambda body: body.write_floats(np.array([np.inf, 1.0])), "it states a step of 1.0 from inf"),
        (lambda body: sets(body, [2**32 - 1]), "it names 4294967295 members of 3"),
        (lambda body: sets(body, [0, 2**32 - 1]), "it names 4294967295 members of 3"),
        (lambda body: sets(body, [2]).write_coded(np.array([2**39, 2**39])), "a member beyond the last of 3"),
        (lambda body: sets(body, [1]).write(np.array([31]), 5).write_unary(np.array([70])), "too large|too early"),
        (lambda body: sets(body, [1]).write(np.array([0]), 5).write_unary(np.array([63])), "too large"),
        (lambda body: values(body, 0, 63), "a number that is too large"),
        (lambda body: values(body, 31, 100), "a number that is too large"),
        (lambda body: values(body, 20, 30), "a number that is too large"),
        (lambda body: sets(body, [0, 0]), "too early"),
    ],
)
@pytest.mark.parametrize("leaf", ["continuous", "smooth"])
def test_crafted_values_are_refused(leaf, write, message):
    container = with_body(leaf, 2, three_leaves(), write)
    with pytest.raises(ValueError, match=message):
        from_bytes(container.to_bytes())


def sets(body, counts):
    """A step, and how many members the sets of unreachable leaves and of faces that are not tied have."""
    body.write_floats(np.array([0.0, 1.0]))
    for count in counts:
        body.write(np.array([count]), 32)
    return body


def values(body, order, extra):
    """Codes of the four coarsest values, all ones, each of an order and so many bits beyond it."""
    sets(body, [0, 0]).write(np.array([order]), 5).write_unary(np.full(4, extra))
    return body.write(np.ones(4 * (order + extra), np.int64), 1)


def test_values_beyond_floats_are_refused():
    def write(body):
        body.write_floats(np.array([3e38, 3e38])).write(np.array([0, 0]), 32)
        body.write_coded(np.full(4, 5)).write_coded(np.full(3, 5))

    with pytest.raises(ValueError, match="too large for 32-bit floats"):
        from_bytes(with_body("continuous", 2, three_leaves(), write).to_bytes())


MEGABYTES = 50 * 2**20


def refused_for_little(data, why=r"too deep for a query's tables|a query resolves 23"):
    """Whether a file is refused before much memory is allocated for it."""
    tracemalloc.start()
    with pytest.raises(ValueError, match=why):
        from_bytes(data)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak < MEGABYTES


@pytest.mark.parametrize(
    ("leaf", "axes"),
    [
        ("plane", [*range(8)] * 7),
        ("plane", [0] * 11 + [1] * 11 + [2] * 11 + [3] * 10),
        ("plane", ([0, 1, 2, 3] * 11)[:43]),
        ("plane", [0] * 22 + [1] * 21),
        ("plane", [0] * 60),
        ("continuous", [0] * 11 + [1] * 11 + [2] * 11 + [3] * 10),
        ("continuous", ([0, 1, 2, 3] * 11)[:43]),
        ("continuous", [0] * 22 + [1] * 21),
        ("smooth", [0] * 22 + [1] * 21),
        ("smooth", [0] * 60),
    ],
)
def test_small_files_of_huge_tables_are_refused_before_they_are_built(leaf, axes):
    contents = random_contents(0, max(axes) + 1, leaf, chain(axes))
    assert refused_for_little(encode(contents))


def test_the_smallest_of_such_files():
    """The crafted files of 266, 193 and 154 bytes that once took up to 14 GB: all leaves but one are unreachable."""
    for axes, size in (([*range(8)] * 7, 280), ([0] * 11 + [1] * 11 + [2] * 11 + [3] * 10, 200), ([0, 1] * 21, 160)):
        cells = chain(axes)
        planes = StoredPlanes(4, 0.0, 1.0, np.r_[0, np.full(len(cells) - 1, 15)], np.zeros(cells.depth.shape, int))
        domain = Box(np.zeros(cells.dim), np.ones(cells.dim))
        data = encode(contents_of_planes(cells, planes, domain))
        assert len(data) < size
        assert refused_for_little(data)


def test_cells_too_deep_for_a_query_are_refused():
    at_most, too_deep = (encode(random_contents(0, 1, "plane", chain([0] * depth))) for depth in (23, 24))
    assert decode(at_most).cells.depth.max() == 23
    with pytest.raises(ValueError, match="a cell is split 24 times along one axis; a query resolves 23"):
        decode(too_deep)


def crossed_halves(dim, axes_of_halves):
    """The halves of a box along the first axis, each with all its leaves split along one axis after another."""
    halves = Cells.root(dim).split(np.array([0]))
    parts = [halves[[0]], halves[[1]]]
    for side, axes in enumerate(axes_of_halves):
        for axis in axes:
            parts[side] = parts[side].split(np.full(len(parts[side]), axis))
    return parts[0].append(parts[1])


def all_tied(cells):
    """A file of continuous leaves, all tied, without the values that no reader should get to."""
    return with_body("continuous", cells.dim, cells, lambda body: sets(body, [0, 0])).to_bytes()


def test_continuous_leaves_that_share_too_many_faces_are_refused_before_they_are_listed():
    data = all_tied(crossed_halves(3, [[1] * 10, [2] * 10]))
    assert len(data) < 1500
    assert refused_for_little(data, "its 2048 leaves share more than 262144 faces")


def test_continuous_leaves_that_hang_on_one_another_too_often_are_refused_before_that_is_worked_out():
    data = all_tied(crossed_halves(6, [[1, 2, 3, 1, 2, 3], [4, 5, 4, 5, 4, 5]]))
    assert len(data) < 300
    assert refused_for_little(data, "its tied leaves hang on one another by")


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
