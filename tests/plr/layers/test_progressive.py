import numpy as np
import pytest
from plr_helpers import UNIT, cone, points

import plr_jax
from plr_jax.plr.file.container import MOST_LAYERS, Header

FIELDS = [
    plr_jax.construct(cone, UNIT, leaf=leaf, max_bytes=size)
    for leaf, size in (("plane", 60), ("cone", 120), ("smooth", 400), ("continuous", 900))
]
X = points(500, 0)


def test_every_prefix_that_ends_at_a_mark_is_the_coarser_plr():
    whole = plr_jax.progressive(FIELDS)
    data = whole.to_bytes()
    assert whole.num_bytes == len(data) and len(whole.file_marks) == 3
    np.testing.assert_array_equal(whole(X), FIELDS[-1](X))
    for mark, plr in zip((*whole.file_marks, len(data)), FIELDS, strict=True):
        found = plr_jax.from_bytes(data[:mark])
        assert found.to_bytes() == data[:mark] and found.leaf == plr.leaf
        np.testing.assert_array_equal(found(X), plr(X))
        np.testing.assert_array_equal(found.cells.position, plr.cells.position)


def test_any_other_prefix_is_refused():
    whole = plr_jax.progressive(FIELDS)
    data, ends = whole.to_bytes(), {*whole.file_marks, whole.num_bytes}
    for size in set(range(len(data))) - ends:
        with pytest.raises(ValueError, match=r"end too early|checksum|start like"):
            plr_jax.from_bytes(data[:size])


def test_all_layers_together_are_hardly_more_than_their_bodies():
    whole = plr_jax.progressive(FIELDS)
    assert whole.num_bytes <= sum(plr.num_bytes for plr in FIELDS)  # whose headers are saved


def test_it_is_a_plr_like_any_other(tmp_path):
    whole = plr_jax.progressive(FIELDS[2:])
    plr_jax.save(whole, tmp_path / "layers.plr")
    again = plr_jax.load(tmp_path / "layers.plr")
    assert again.to_bytes() == whole.to_bytes() and again.num_leaves == FIELDS[-1].num_leaves
    np.testing.assert_array_equal(again.numpy()(X), FIELDS[-1].numpy()(X))
    certified = plr_jax.progressive([FIELDS[2], whole])  # only the last layers count
    assert certified.to_bytes() == whole.to_bytes()


@pytest.mark.usefixtures("unchecked_types")
def test_labels():
    plr = FIELDS[0].with_label("maze to 0.06, 0.07 \N{LONG RIGHTWARDS ARROW}")
    assert plr.label.startswith("maze") and FIELDS[0].label == ""
    assert plr_jax.from_bytes(plr.to_bytes()).label == plr.label
    assert plr.num_bytes == FIELDS[0].num_bytes + len(plr.label.encode()) + 2
    np.testing.assert_array_equal(plr(X), FIELDS[0](X))
    whole = plr_jax.progressive([plr, FIELDS[-1].with_label("the last one's")])
    assert whole.label == plr_jax.from_bytes(whole.to_bytes()[: whole.file_marks[0]]).label == "the last one's"
    assert plr.with_label("").to_bytes() == FIELDS[0].to_bytes()
    for label in ("x" * 1001, "é" * 501, 3, "\ud800"):
        with pytest.raises(ValueError):
            plr.with_label(label)


@pytest.mark.usefixtures("unchecked_types")
def test_what_is_no_list_of_finer_and_finer_plrs_is_refused():
    other = plr_jax.construct(cone, ([0, 0], [1, 2]), max_leaves=50)
    for plrs, message in (
        ([], "1 to 33"),
        (FIELDS[:1] * (MOST_LAYERS + 2), "1 to 33"),
        (FIELDS[::-1], "more bytes than the one before"),
        ([FIELDS[0], FIELDS[0]], "more bytes than the one before"),
        ([FIELDS[0], other], "one domain"),
        ([FIELDS[0], 3], "must be PLRs"),
        (3, "must be a list"),
    ):
        with pytest.raises(ValueError, match=message):
            plr_jax.progressive(plrs)


def test_the_header_of_a_map_of_few_decimals_is_short():
    plr = plr_jax.construct(cone, UNIT, max_leaves=4)
    assert len(Header.read(plr.to_bytes()).data) == 9
