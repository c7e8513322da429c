"""What holds a file tells its bytes, whatever it answers."""

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import plr_jax
from plr_jax._arrays import padded_size
from plr_jax.plr import container as held_module


@pytest.fixture(scope="module", params=["one goal", "pairs"])
def held(request):
    if request.param == "pairs":
        return plr_jax.construct_pairs(plr_jax.Workspace(((0, 0), (1, 1))), max_bytes=200)
    return plr_jax.construct(plr_jax.Euclidean((0.0, 0.0)), ((0, 0), (1, 1)), max_leaves=8)


def test_labels_are_of_the_file_alone_and_bytes_are_those_of_the_file(held, tmp_path):
    assert held.label == "" and held.with_label("") is held
    assert held.resident_bytes == sum(a.nbytes for a in jax.tree_util.tree_leaves(held.tables)) > 0
    labeled = held.with_label("Räume, goal (0, 0)")
    assert labeled.label == "Räume, goal (0, 0)" and type(labeled) is type(held)
    again = labeled.with_label("")
    assert again.to_bytes() == held.to_bytes() and labeled.num_bytes > held.num_bytes == again.num_bytes
    for one, other in zip(*map(jax.tree_util.tree_leaves, (labeled.tables, held.tables)), strict=True):
        np.testing.assert_array_equal(one, other)
    assert held.with_label("x" * 1000).label == "x" * 1000
    for one in (held, labeled):
        plr_jax.save(one, tmp_path / "file")
        assert (tmp_path / "file").read_bytes() == one.to_bytes() and len(one.to_bytes()) == one.num_bytes
        again = plr_jax.load(tmp_path / "file")
        assert type(again) is type(held) and again.label == one.label and again.to_bytes() == one.to_bytes()


@given(st.binary(max_size=2000), st.integers(-6, 6))
def test_bytes_are_padded_to_few_sizes_and_their_number_comes_last(data, more):
    """Also about the sizes themselves, which are powers of two."""
    data = (data + bytes(1000))[: max(0, padded_size(len(data)) + more)]
    array = held_module.held(data)
    assert len(array).bit_count() == 1 and len(data) + 4 <= len(array) <= 2 * (len(data) + 4)
    found = held_module.HeldFile()
    found.file = array
    assert found.to_bytes() == data and found.num_bytes == len(data)


def test_of_several_there_are_no_bytes():
    several = held_module.HeldFile()
    several.file = np.stack([held_module.held(b"one"), held_module.held(b"two")])
    with pytest.raises(ValueError, match="Bytes are those of one, but these arrays are those of several"):
        several.to_bytes()


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize("label", ["x" * 1001, "ä" * 501, "\ud800", b"text", None, 3])
def test_labels_that_are_no_text_or_too_long_are_refused(held, label):
    with pytest.raises(ValueError, match="A label is a text of at most 1,000 bytes, got"):
        held.with_label(label)
