import pickle
import tracemalloc

import jax
import numpy as np
import pytest
from plr_helpers import UNIT, points, walled

from plr_jax._io import load, load_pairs, save
from plr_jax.plr import Plane, construct, from_bytes, load_numpy
from plr_jax.plr.file import container
from plr_jax.plr.file import container as reading


def assert_same(one, other):
    """Whether two PLRs are the same bit for bit, in all that a query reads."""
    assert one.to_bytes() == other.to_bytes()
    leaves, structure = jax.tree_util.tree_flatten(one)
    other_leaves, other_structure = jax.tree_util.tree_flatten(other)
    assert structure == other_structure
    for mine, theirs in zip(leaves, other_leaves, strict=True):
        assert mine.dtype == theirs.dtype
        np.testing.assert_array_equal(mine, theirs)


def test_a_loaded_plr_equals_the_saved_one_bit_for_bit(plr, tmp_path):
    save(plr, tmp_path / "walled.plr")
    assert (tmp_path / "walled.plr").stat().st_size == plr.num_bytes == len(plr.to_bytes())
    again = load(str(tmp_path / "walled.plr"))
    assert_same(again, plr)
    x = points(1000, 0)
    np.testing.assert_array_equal(np.asarray(again(x)).view(np.int32), np.asarray(plr(x)).view(np.int32))


@pytest.mark.parametrize("model", [Plane(coefficient_bits=16), Plane(coefficient_bits=5), "continuous", "smooth"])
def test_what_is_built_under_a_budget_equals_what_its_file_holds(model):
    plr = construct(walled, UNIT, leaf=model, max_bytes=200, num_samples=32)
    assert_same(from_bytes(plr.to_bytes()), plr)


def test_a_pickled_plr_is_the_same(plr):
    again = pickle.loads(pickle.dumps(plr))
    assert_same(again, plr)
    assert (again.num_leaves, again.leaf) == (plr.num_leaves, plr.leaf)


def test_saving_leaves_no_other_files_and_replaces(tmp_path):
    for leaves in (4, 8):
        save(construct(walled, UNIT, max_leaves=leaves), tmp_path / "a.plr")
    assert [path.name for path in tmp_path.iterdir()] == ["a.plr"]
    assert load(tmp_path / "a.plr").num_leaves == 8


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda data: b"PK\x03\x04" + data[4:], "does not start like a PLR file"),
        (lambda data: data[:60] + b"\xaa\xaa" + data[62:], "checksum"),
    ],
)
def test_load_says_what_is_wrong_with_which_file(plr, change, message, tmp_path):
    path = tmp_path / "bad.plr"
    path.write_bytes(change(plr.to_bytes()))
    with pytest.raises(ValueError, match=f"bad.plr cannot be read as a PLR: .*{message}"):
        load(path)


def test_a_missing_file_is_an_os_error(tmp_path):
    with pytest.raises(FileNotFoundError):
        load(tmp_path / "none.plr")


def refused_for_little(read, path, message, most):
    """Whether a file is refused for no more memory than what may be read of it."""
    tracemalloc.start()
    with pytest.raises(ValueError, match=message):
        read(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak < most


@pytest.mark.parametrize("read", [load, load_numpy])
def test_of_a_file_that_goes_on_no_more_is_read_than_a_plr_may_have(read, tmp_path, monkeypatch):
    path, data = tmp_path / "long.plr", construct(walled, UNIT, max_leaves=4).to_bytes()
    most = 2**20
    for module in (reading, container):
        monkeypatch.setattr(module, "MOST_BYTES", most)
    with open(path, "wb") as file:
        file.write(data)
        file.truncate(1 << 40)
    message = "long.plr cannot be read as a PLR: it has more than 1,048,576 bytes"
    assert refused_for_little(read, path, message, 3 * most)


@pytest.mark.parametrize("read", [load, load_numpy, load_pairs])
@pytest.mark.parametrize(
    ("start", "message"), [(b"", "does not start like a PLR file"), (b"PLR\n\x02", "a format version before 5")]
)
def test_of_other_files_only_the_start_is_read(read, start, message, tmp_path):
    path = tmp_path / "long.plr"
    with open(path, "wb") as file:
        file.write(start)
        file.truncate(1 << 40)
    assert refused_for_little(read, path, message, 2**18)
