"""Damaged files of every kind are read or refused by name. In memory and time: by the experiment itself."""

import pytest
from hostile_files import MOST_GROWTH, Outcome, attempt, hostile, trial
from hostile_readers import READERS, Reader

from plr_jax.plr.container import Container, Header

pytestmark = pytest.mark.full

NUMBER = 60


@pytest.mark.parametrize("name", READERS)
def test_damaged_files_are_read_or_refused_by_name(name, tmp_path):
    reader = READERS[name]
    valid, path = reader.valid(), tmp_path / f"file{reader.suffix}"
    for data in valid:
        path.write_bytes(data)
        assert attempt(reader, path).kind == "read"
    for number in range(NUMBER):
        path.write_bytes(data := hostile(reader, valid, 0, number))
        outcome = attempt(reader, path)
        assert outcome.kind in ("read", "refused"), (number, outcome, data[:500])
        assert (data == hostile(reader, valid, 0, number)) and outcome.growth < MOST_GROWTH
    if reader.suffix == ".plr":  # mutated ones have checksums that fit
        for data in valid:
            assert reader.repaired(data) == data
            if not {len(data), len(data) - 9} & set(Header.read(data).marks):  # of which nothing can be cut off
                cut = reader.repaired(data[:-9])
                assert len(cut) == len(data) - 9
                assert len(Container.from_bytes(cut).layers) == len(Container.from_bytes(data).layers)
            start = len(Header.read(data).data)
            changed = data[:start] + bytes([data[start] ^ 1]) + data[start + 1 :]
            assert reader.repaired(changed) != changed and Container.from_bytes(reader.repaired(changed))


def unnamed(path):
    raise ValueError("something is wrong")


def crash(path):
    raise TypeError("unhashable")


@pytest.mark.parametrize(("read", "kind"), [(unnamed, "error without the file's name"), (crash, "TypeError")])
def test_failures_are_told_apart(read, kind, tmp_path):
    outcome = attempt(Reader(read, "", list), tmp_path / "file")
    assert outcome.kind == kind and outcome.failed
    assert not Outcome("refused").failed


def test_files_of_trials_that_do_not_fail_are_not_kept(tmp_path):
    for number in range(5):
        assert not trial("map", number, tmp_path, seed=1).failed
    assert list(tmp_path.iterdir()) == []
