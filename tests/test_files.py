import errno
import os
import re
import stat
from itertools import pairwise

import numpy as np
import pytest

from plr_jax import Solution, scenes
from plr_jax._files import json_of, text_of, write_atomically, yaml_of

DEEP = "expected lists and mappings at most 32 deep"
MANY_DIGITS = "Exceeds the limit"
ALIASES = "a: &a [x, x]\n" + "".join(f"{b}: &{b} [*{a}, *{a}]\n" for a, b in pairwise("abcdefghi"))
HEADER = "type octile\nheight {}\nwidth 2\nmap\n..\n"
HOSTILE = {
    ("a.json", scenes.load, scenes.read_polygons, Solution.load): [
        ("[" * 100_000, "recursion"),
        ("[" * 33 + "]" * 33, DEEP),
        ('{"a":' * 33 + "1" + "}" * 33, DEEP),
        ("[" + "1" * 400 + "]", "larger integer"),
        ("[" + "1" * 5000 + "]", MANY_DIGITS),
        (b'{"a": "\xff"}', "expected text in UTF-8"),
    ],
    ("b.json", scenes.load, scenes.read_polygons): [(b" " * (2**24 + 1), "at most 16,777,216 bytes")],
    ("a.yaml", scenes.read_map_server, scenes.read_cost_map): [
        (ALIASES, "neither aliases nor tags are read.* line 2"),
        ("a: &a {x: 1}\nb: {<<: [*a, *a]}", "neither aliases nor tags"),
        ("a: !!python/name:os.system", "neither aliases nor tags"),
        ("[" * 5000, f"({DEEP}|exceeded maximum nesting depth)"),  # some parsers have a limit of their own
        ("- " * 33 + "1", DEEP),
        ("1" * 400, "larger integer"),
        ("1" * 5000, "at most 1000 characters"),
        ("2001-99-99", "month must be in"),
        ("0x_", "invalid literal"),
        ("? [1]\n: 2", "unhashable"),
        ("\x00", "control characters"),
        (b"\xff", "expected text in UTF-8"),
    ],
    ("a.map", scenes.read_map): [(HEADER.format("9" * 5000), MANY_DIGITS), (HEADER.format("9" * 50), "header says")],
}


def test_hostile_file_raises(tmp_path):
    for (name, *readers), table in HOSTILE.items():
        for content, message in table:
            (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
            for read in readers:
                with pytest.raises(ValueError, match=re.escape(f"{name}: ") + "(?s:.*)" + message):
                    read(tmp_path / name)


def test_largest_allowed_documents_are_read(tmp_path):
    path = tmp_path / "a"
    path.write_text("[" * 32 + "1" + "]" * 32)
    assert np.ravel(json_of(path)) == np.ravel(yaml_of(path)) == [1]
    path.write_text(f"[{2**1023}, -{2**1023}]")
    assert json_of(path) == yaml_of(path) == [2**1023, -(2**1023)]
    path.write_bytes(b" " * 2**24)
    assert len(text_of(path)) == 2**24
    path.write_text("'" + "long " * 1000 + "'")
    assert yaml_of(path) == "long " * 1000


def test_yaml_numbers_of_other_languages_are_read(tmp_path):
    path = tmp_path / "a.yaml"
    path.write_text("[1e-05, -2E3, 1.5e3, 3.e+2, .5e1, 1.0e-3, 7, '1e3', e5, 1e5x]")
    assert yaml_of(path) == [1e-5, -2000, 1500, 300, 5, 1e-3, 7, "1e3", "e5", "1e5x"]


def test_byte_order_mark_is_skipped(tmp_path):
    scenes.save(scenes.maze(), tmp_path / "a.json")
    (tmp_path / "b.json").write_bytes(b"\xef\xbb\xbf" + (tmp_path / "a.json").read_bytes())
    assert scenes.is_scene(tmp_path / "b.json")
    assert scenes.load(tmp_path / "b.json").starts.tolist() == scenes.maze().starts.tolist()
    (tmp_path / "c.map").write_text("\ufefftype octile\nheight 1\nwidth 2\nmap\n..\n", encoding="utf-8")
    assert scenes.read_map(tmp_path / "c.map").free_space.area == 2


def test_name_with_zero_byte_raises():
    for read in (scenes.load, scenes.read_polygons, scenes.read_map_server, scenes.read_map):
        with pytest.raises(ValueError, match=re.escape("a\0b: ")):
            read("a\0b")


@pytest.mark.parametrize(("step", "error"), [("fsync", OSError), ("replace", OSError), ("fsync", KeyboardInterrupt)])
def test_failed_write_keeps_only_old_file(step, error, tmp_path, monkeypatch):
    path = tmp_path / "file"
    write_atomically(path, b"old")

    def fail(*_):
        raise error("disk full")

    monkeypatch.setattr(os, step, fail)
    with pytest.raises(error, match="disk full"):
        write_atomically(path, b"new")
    assert path.read_bytes() == b"old" and os.listdir(tmp_path) == ["file"]


def test_permissions_are_those_of_replaced_file(tmp_path):
    path, usual = tmp_path / "file", tmp_path / "usual"
    write_atomically(path, b"old")
    usual.write_bytes(b"")
    assert stat.S_IMODE(path.stat().st_mode) == stat.S_IMODE(usual.stat().st_mode)
    for mode in (0o600, 0o664, 0o755, 0o444):
        path.chmod(mode)
        write_atomically(path, b"new")
        assert stat.S_IMODE(path.stat().st_mode) == mode


def test_longest_name_of_file_system_is_written(tmp_path):
    for length in (246, 255):
        path = tmp_path / ("x" * length)
        write_atomically(path, b"one")
        write_atomically(path, b"two")
        assert path.read_bytes() == b"two"


def test_error_names_file_not_temporary_file(tmp_path, monkeypatch):
    link = tmp_path / "link"
    link.symlink_to(link)
    for path in (tmp_path / "none" / "file", tmp_path / ("x" * 256), link, tmp_path):
        with pytest.raises(OSError) as caught:
            write_atomically(path, b"")
        assert caught.value.filename == str(path) and caught.value.filename2 is None

    def full(*_):
        raise OSError(errno.ENOSPC, "disk full", "temporary", None, "other")

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(OSError, match=r"disk full: '[^']*file'$"):
        write_atomically(tmp_path / "file", b"new")


def test_links_are_followed_and_pipes_stay(tmp_path):
    target, link, pipe = tmp_path / "target", tmp_path / "link", tmp_path / "pipe"
    target.write_bytes(b"old")
    link.symlink_to(target)
    write_atomically(link, b"new")
    assert link.is_symlink() and target.read_bytes() == b"new"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    write_atomically(pipe, b"through")
    assert pipe.is_fifo() and os.read(reader, 100) == b"through"
    os.close(reader)
