"""Files of all leaf models: they are read as written; invalid files raise before they cost much memory."""

import os
import pickle
from functools import partial

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plr_helpers import (
    LINEAR,
    UNIT,
    assert_refused_for_little,
    chain,
    contents_of_planes,
    quarters_in_another_order,
    random_contents,
    sealed,
    three_leaves,
    walled,
)

from plr_jax import Box, BuildOptions, construct, from_bytes, load, load_numpy, save
from plr_jax.plr import Plane
from plr_jax.plr import container as container_module
from plr_jax.plr._file import decode, encode
from plr_jax.plr._plr import plr_of_leaves
from plr_jax.plr.coding import BitWriter, write_tree
from plr_jax.plr.container import Container, Layer
from plr_jax.plr.leaves import code_of_leaf, leaf_model, leaf_names
from plr_jax.plr.leaves.continuous import StoredValues
from plr_jax.plr.leaves.plane import StoredCoefficients
from plr_jax.plr.tree import Cells, tree_of

MOST = 50 * 2**20


@pytest.mark.parametrize("model", [Plane(coefficient_bits=5), "smooth"])
def test_saved_and_pickled_plrs_are_equal(model, tmp_path):
    plr = construct(walled, UNIT, leaf=model, max_bytes=200, options=BuildOptions(num_samples=32))
    (tmp_path / "a.plr").write_bytes(b"something else")
    save(plr, tmp_path / "a.plr")
    assert [path.name for path in tmp_path.iterdir()] == ["a.plr"]
    assert (tmp_path / "a.plr").stat().st_size == plr.num_bytes == len(plr.to_bytes())
    for again in (from_bytes(plr.to_bytes()), load(str(tmp_path / "a.plr")), pickle.loads(pickle.dumps(plr))):
        assert again.to_bytes() == plr.to_bytes() and again.leaf == plr.leaf
        assert jax.tree.structure(again) == jax.tree.structure(plr)
        for one, other in zip(jax.tree.leaves(again), jax.tree.leaves(plr), strict=True):
            np.testing.assert_array_equal(one, other, strict=True)


@given(st.integers(0, 1000), st.sampled_from([1, 2, 3, 18]), st.sampled_from(LINEAR), st.integers(0, 7))
def test_files_are_read_as_written(seed, dim, leaf, wraps):
    dim = min(dim, leaf_model(leaf).max_dim)
    contents = random_contents(seed, dim, leaf, periodic=tuple(bool(wraps >> axis & 1) for axis in range(dim)))
    data = encode(contents)
    again = decode(data)
    assert again.domain == contents.domain and again.leaf.name == leaf
    np.testing.assert_array_equal(again.tree.leaves.depth, contents.tree.leaves.depth)
    np.testing.assert_array_equal(again.tree.leaves.position, contents.tree.leaves.position)
    expected = contents.leaf.coefficients(contents.tree.leaves, contents.stored)
    np.testing.assert_array_equal(again.leaf.coefficients(again.tree.leaves, again.stored), expected)
    if isinstance(contents.stored, StoredValues):
        for name in ("tied", "unreachable"):
            found, written = (getattr(each.stored.partition, name) for each in (again, contents))
            np.testing.assert_array_equal(found, written)
    assert encode(again) == data


@pytest.mark.parametrize(("dim", "grow"), [(1, "chain"), (3, "anywhere"), (8, "chain")])
def test_files_of_deepest_trees_can_be_read(dim, grow):
    """Rules of the caller split as deep as construction goes."""
    rng = np.random.default_rng(dim)

    def should_split(fit):
        in_chain = (fit.cells.position == 0).all(axis=1) & (grow == "chain")
        return np.where(in_chain, 1.0 + fit.cells.depth.sum(axis=1), rng.random(len(fit)) + 1e-3)

    def split(fit):
        return np.argmax((fit.cells.depth < fit.max_axis_depth) * (1 + rng.random(fit.cells.depth.shape)), axis=1)

    options = BuildOptions(num_samples=dim + 1, should_split=should_split, split=split)
    limits = {"domain": (np.zeros(dim), np.ones(dim)), "leaf": Plane(coefficient_bits=4), "max_leaves": 200}
    plr = construct(lambda x: np.sum((x - 0.01) ** 2, axis=1), **limits, options=options)
    again = from_bytes(plr.to_bytes())
    assert again.num_leaves == plr.num_leaves > 15
    np.testing.assert_array_equal(again.tables.leaf_of_slot, plr.tables.leaf_of_slot)


@pytest.mark.parametrize("leaf", LINEAR)
def test_bodies_too_short_or_too_long_raise(leaf):
    data = encode(random_contents(1, 2, leaf))
    for size in range(9, len(data) - 4, 5):
        with pytest.raises(ValueError):
            decode(sealed(data[:size]))
    with pytest.raises(ValueError, match="more data than its leaves need"):
        decode(sealed(data[:-4] + b"\0"))


SOME = Container.from_bytes(encode(random_contents(0, 2, "plane"))).last
NUM_KINDS = len(leaf_names())


@pytest.mark.parametrize(
    ("container", "message"),
    [
        (
            Container(UNIT, (Layer(NUM_KINDS, SOME.body),)),
            f"it has leaves of kind {NUM_KINDS}, this release knows kinds 0 to {NUM_KINDS - 1}",
        ),
        (Container(Box(np.zeros(10), np.ones(10)), (Layer(1, b""),)), "up to 6 dimensions, got 10"),
        (Container(UNIT, (Layer(7, b"body"),)), "any two points; read it with load"),
    ],
)
def test_files_of_unknown_kinds_raise(container, message):
    with pytest.raises(ValueError, match=message):
        from_bytes(container.to_bytes())


@pytest.mark.parametrize("read", [load, load_numpy])
def test_errors_name_the_file_and_what_is_wrong(read, tmp_path):
    path, data = tmp_path / "bad.plr", encode(random_contents(0, 2, "plane"))
    with pytest.raises(FileNotFoundError):
        read(path)
    for bad, message in (
        (b"PK\x03\x04" + data[4:], "does not start like a PLR file"),
        (data[:30] + b"\xaa\xaa" + data[32:], "checksum"),
    ):
        path.write_bytes(bad)
        with pytest.raises(ValueError, match=f"bad.plr cannot be read as a PLR.*: .*{message}"):
            read(path)


@pytest.mark.parametrize("read", [load, load_numpy])
def test_huge_files_raise_before_they_are_read(read, tmp_path, monkeypatch):
    path, plr = tmp_path / "long.plr", encode(random_contents(0, 2, "plane"))
    monkeypatch.setattr(container_module, "MOST_BYTES", 2**20)
    for start, message, most in (
        (plr, "long.plr cannot be read as .*: it has more than 1,048,576 bytes", 4 * 2**20),
        (b"", "does not start like a PLR file", 2**18),
    ):
        path.write_bytes(start)
        os.truncate(path, 1 << 40)
        assert_refused_for_little(read, path, message, most)


# Files that are crafted bit by bit.


def with_body(leaf, cells, write):
    """Return a file of the given cells whose leaf parameters are written by hand."""
    body = BitWriter()
    write_tree(body, tree_of(cells))
    write(body)
    layer = Layer(code_of_leaf(leaf_model(leaf)), body.to_bytes())
    return Container(Box(np.zeros(cells.dim), np.ones(cells.dim)), (layer,)).to_bytes()


def step(body, bits, offset, width):
    """Write planes: the bits of a center, the quantization, then the widths of half-differences."""
    body.write(np.array([bits]), 6).write_floats(np.array([offset, width]))
    return body.write(np.zeros(4, np.int64), 6).write(np.full(3, 77), 8)


def sets(body, counts):
    """Write a step, and the sizes of the sets of unreachable leaves and of faces that are not tied."""
    return body.write_floats(np.array([0.0, 1.0])).write(np.array(counts), 32)


def values(body):
    body.write_floats(np.array([3e38, 3e38])).write(np.array([0, 0]), 32)
    body.write_coded(np.full(4, 5)).write_coded(np.full(3, 5))


def wide(body):
    body.write(np.array([8]), 6).write_floats(np.array([0.0, 1.0])).write(np.array([0, 33, 1, 1]), 6)


@pytest.mark.parametrize(
    ("leaf", "write", "message"),
    [
        ("plane", partial(step, bits=8, offset=0.0, width=np.nan), "it states a step of nan from 0.0"),
        ("plane", partial(step, bits=8, offset=0.0, width=-1.0), "it states a step of -1.0"),
        ("plane", partial(step, bits=8, offset=np.nan, width=1.0), "it states a step of 1.0 from nan"),
        ("plane", partial(step, bits=3, offset=0.0, width=1.0), "it states 3-bit values"),
        ("plane", partial(step, bits=33, offset=0.0, width=1.0), "it states 33-bit values"),
        ("plane", partial(step, bits=8, offset=0.0, width=1e30), "for 32-bit floats"),
        ("plane", wide, "numbers of more than 32 bits"),
        ("continuous", lambda body: body.write_floats(np.array([0.0, np.nan])), "it states a step of nan"),
        ("continuous", lambda body: body.write_floats(np.array([np.inf, 1.0])), "it states a step of 1.0 from inf"),
        ("continuous", partial(sets, counts=[2**32 - 1]), "it names 4294967295 members of 3"),
        ("continuous", partial(sets, counts=[0, 2**32 - 1]), "it names 4294967295 members of 3"),
        ("continuous", partial(sets, counts=[0, 0]), "too early"),
        ("continuous", values, "for 32-bit floats"),
    ],
)
def test_invalid_leaf_parameters_raise(leaf, write, message):
    with pytest.raises(ValueError, match=message):
        from_bytes(with_body(leaf, three_leaves(), write))


@pytest.mark.parametrize(("center", "half"), [(np.nan, 0), (0, -np.inf), (1e31, 0), (0, 1e31)])
def test_float_planes_that_are_not_finite_raise(center, half):
    center, half = np.float32([[1, center, 2], [1, half, 2]]).view(np.uint32).astype(np.int64)
    planes = StoredCoefficients(32, 0.0, 1.0, center, np.stack([half, 0 * half], axis=1))
    data = encode(contents_of_planes(three_leaves(), planes))
    with pytest.raises(ValueError, match="for 32-bit floats"):
        from_bytes(data)


def test_trees_that_split_in_another_order_hold_only_planes():
    contents = quarters_in_another_order()
    plr = from_bytes(encode(contents))
    assert plr.to_bytes() == plr_of_leaves(contents).to_bytes()
    assert plr(np.array([[0.1, 0.1], [0.9, 0.1], [0.1, 0.9], [0.9, 0.9]])).tolist() == [0, 1, 2, 3]
    body = BitWriter()
    write_tree(body, contents.tree)
    layer = Layer(code_of_leaf(leaf_model("continuous")), sets(body, [0, 0]).to_bytes())
    with pytest.raises(ValueError, match="splits in another order"):
        from_bytes(Container(UNIT, (layer,)).to_bytes())


@pytest.mark.parametrize(("axes", "most"), [([*range(8)] * 7, 280), ([0, 1] * 21, 160)])
def test_small_files_of_huge_tables_raise_before_allocation(axes, most):
    """Files of 266 and 154 bytes once took up to 14 GB: all leaves but one are unreachable."""
    cells = chain(axes)
    planes = StoredCoefficients(4, 0.0, 1.0, np.r_[0, np.full(len(cells) - 1, 15)], np.zeros(cells.depth.shape, int))
    files = [encode(contents_of_planes(cells, planes, Box(np.zeros(cells.dim), np.ones(cells.dim))))]
    assert len(files[0]) < most
    files += [encode(random_contents(0, cells.dim, leaf, cells)) for leaf in ["continuous"] if cells.dim < 3]
    for data in files:
        assert_refused_for_little(from_bytes, data, "too deep for a query's tables|more than 23", MOST)


def test_cells_too_deep_for_a_query_raise():
    at_most, too_deep = (encode(random_contents(0, 1, "plane", chain([0] * depth))) for depth in (23, 24))
    assert decode(at_most).tree.leaves.depth.max() == 23
    with pytest.raises(ValueError, match="it splits a cell 24 times along one axis, more than 23"):
        decode(too_deep)


@pytest.mark.parametrize(
    ("dim", "axes_of_halves", "message"),
    [
        (3, [[1] * 10, [2] * 10], "its 2048 leaves share more than 262144 faces"),
        (6, [[1, 2, 3] * 2, [4, 5] * 3], "the constraints of its tied leaves may have at most"),
    ],
)
def test_too_many_constraints_of_tied_leaves_raise_early(dim, axes_of_halves, message):
    """Each half of a box has all its leaves split along one axis after another."""
    halves = Cells.root(dim).split(np.array([0]))
    parts = [halves[[0]], halves[[1]]]
    for side, axes in enumerate(axes_of_halves):
        for axis in axes:
            parts[side] = parts[side].split(np.full(len(parts[side]), axis))
    data = with_body("continuous", parts[0].append(parts[1]), partial(sets, counts=[0, 0]))
    assert_refused_for_little(from_bytes, data, message, MOST)
