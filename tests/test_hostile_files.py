"""Damaged files of every kind are read, or refused by name; ``hostile_files.py`` tries more of them."""

import pytest
from hostile_files import attempt, hostile
from hostile_readers import READERS, Reader

from plr_jax.plr.container import Container, Header

pytestmark = pytest.mark.full

NUM_FILES = 60


@pytest.mark.parametrize("name", READERS)
def test_damaged_files_load_or_raise_error_naming_file(name, tmp_path):
    reader = READERS[name]
    valid, path = reader.valid(), tmp_path / f"file{reader.suffix}"
    for data in valid:
        path.write_bytes(data)
        assert not attempt(reader, path).message
    for number in range(NUM_FILES):
        path.write_bytes(data := hostile(reader, valid, 0, number))
        outcome = attempt(reader, path)
        assert outcome.kind in ("read", "refused", "too slow"), (number, outcome, data[:500])


@pytest.mark.parametrize("name", [name for name, reader in READERS.items() if reader.suffix == ".plr"])
def test_checksums_of_damaged_files_are_repaired(name):
    repaired = READERS[name].repaired
    for data in READERS[name].valid():
        start = len(Header.read(data).data)
        changed = repaired(data[:start] + bytes([data[start] ^ 1]) + data[start + 1 :])
        assert repaired(data) == data != changed and Container.from_bytes(changed)


@pytest.mark.parametrize(
    ("error", "kind"),
    [(ValueError("something is wrong"), "error without the file's name"), (TypeError("unhashable"), "TypeError")],
)
def test_failures_of_readers_are_found(error, kind, tmp_path):
    def read(path):
        raise error

    outcome = attempt(Reader(read, "", list), tmp_path / "file")
    assert outcome.kind == kind and outcome.failed
