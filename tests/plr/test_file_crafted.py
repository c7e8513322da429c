"""Files that nobody writes, crafted bit by bit: refused, saying why, before they cost much memory."""

import tracemalloc

import numpy as np
import pytest
from plr_helpers import chain, contents_of_planes, random_contents, three_leaves

from plr_jax.geometry.box import Box
from plr_jax.plr import Plane, from_bytes
from plr_jax.plr._assembly import with_stored
from plr_jax.plr._file import Contents, decode, encode
from plr_jax.plr.file.bits import BitWriter, write_tree
from plr_jax.plr.file.container import Container, Layer
from plr_jax.plr.leaves import code_of_leaf, leaf_model
from plr_jax.plr.leaves.plane import StoredPlanes, encode_planes
from plr_jax.plr.partition.cells import Cells, Level, levels_of, tree_of_levels


def with_body(leaf, dim, cells, write):
    """A file of some cells, whose leaves' numbers are written by hand."""
    body = BitWriter()
    write_tree(body, levels_of(cells)[0], dim)
    write(body)
    layer = Layer(code_of_leaf(leaf_model(leaf)), body.to_bytes())
    return Container(Box(np.zeros(dim), np.ones(dim)), (layer,))


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
    layer = Layer(code_of_leaf(leaf_model("continuous")), body.to_bytes())
    with pytest.raises(ValueError, match="splits its leaves along other axes first"):
        from_bytes(Container(Box((0, 0), (1, 1)), (layer,)).to_bytes())


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
