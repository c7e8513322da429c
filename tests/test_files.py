import errno
import json
import os
import re
import stat

import numpy as np
import pytest

from plr_jax import scenes
from plr_jax._files import json_of, text_of, write_atomically, yaml_of

DEEP = "expected lists and mappings at most 32 deep"
MANY_DIGITS = "Exceeds the limit"
ALIASES = "a: &a [x, x]\n" + "".join(f"{b}: &{b} [*{a}, *{a}]\n" for a, b in zip("abcdefgh", "bcdefghi", strict=True))


HEADER = "type octile\nheight {}\nwidth 2\nmap\n..\n"
HOSTILE = {
    "a.json": [
        ("[" * 100_000, "recursion"),
        ("[" * 200 + "]" * 200, DEEP),
        ("[" * 33 + "]" * 33, DEEP),
        ('{"a":' * 33 + "1" + "}" * 33, DEEP),
        ("[" + "1" * 400 + "]", "larger integer"),
        ("[-" + "1" * 400 + "]", "larger integer"),
        ("[" + "1" * 5000 + "]", MANY_DIGITS),
        (b'{"a": "\xff"}', "expected text in UTF-8"),
        (b" " * (2**24 + 1), "at most 16,777,216 bytes"),
    ],
    "a.yaml": [
        (ALIASES, "neither aliases nor tags are read.* line 2"),
        ("a: &a {x: 1}\nb: {<<: [*a, *a]}", "neither aliases nor tags"),
        ("a: &a [*a]", "neither aliases nor tags"),
        ("a: !!python/name:os.system", "neither aliases nor tags"),
        ("!!timestamp foo", "neither aliases nor tags"),
        ("[" * 500, DEEP),
        ("[" * 5000, f"({DEEP}|exceeded maximum nesting depth)"),  # some parsers have a limit of their own
        ("- " * 33 + "1", DEEP),
        ("1" * 400, "larger integer"),
        ("1" * 5000, "at most 1000 characters"),
        ("1:" * 5000 + "1", "at most 1000 characters"),
        ("2001-99-99", "month must be in"),
        ("0x_", "invalid literal"),
        ("? [1]\n: 2", "unhashable"),
        ("\x00", "control characters"),
        (b"\xff", "expected text in UTF-8"),
    ],
    "a.map": [
        (HEADER.format("9" * 5000), MANY_DIGITS),
        (HEADER.format("9" * 50), "as the header says"),
        (b" " * (2**24 + 1), "at most 16,777,216 bytes"),
    ],
    "a.scen": [
        (b"version 1\n\xff", "expected text"),
        ("version 1\n" + "x" * 10**6, r"line 2: .{1,400}$"),
    ],
}
READERS = {
    "a.json": (scenes.load, scenes.read_polygons),
    "a.yaml": (scenes.read_map_server, scenes.read_cost_map),
    "a.map": (scenes.read_map,),
    "a.scen": (scenes.read_scen,),
}


@pytest.mark.parametrize(
    ("name", "number"), [(name, number) for name, table in HOSTILE.items() for number in range(len(table))]
)
def test_hostile_files_are_refused_by_name(name, number, tmp_path):
    path, (content, message) = tmp_path / name, HOSTILE[name][number]
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    for read in READERS[name]:
        with pytest.raises(ValueError, match=re.escape(f"{name}: ") + "(?s:.*)" + message):
            read(path)


def test_documents_may_be_as_deep_and_as_large_as_allowed(tmp_path):
    path = tmp_path / "a"
    path.write_text("[" * 32 + "1" + "]" * 32)
    assert np.ravel(json_of(path)) == np.ravel(yaml_of(path)) == [1]
    path.write_text(f"[{2**1023}, -{2**1023}]")
    assert json_of(path) == yaml_of(path) == [2**1023, -(2**1023)]
    path.write_bytes(b" " * 2**24)
    assert len(text_of(path)) == 2**24
    path.write_text("'" + "long " * 1000 + "'")
    assert yaml_of(path) == "long " * 1000


def test_numbers_in_yaml_may_be_written_as_other_languages_write_them(tmp_path):
    path = tmp_path / "a.yaml"
    path.write_text("[1e-05, -2E3, 1.5e3, 3.e+2, .5e1, 1.0e-3, 7, '1e3', e5, 1e5x]")
    assert yaml_of(path) == [1e-5, -2000, 1500, 300, 5, 1e-3, 7, "1e3", "e5", "1e5x"]


def test_a_byte_order_mark_is_no_part_of_a_text(tmp_path):
    scenes.save(scenes.maze(), tmp_path / "a.json")
    (tmp_path / "b.json").write_bytes(b"\xef\xbb\xbf" + (tmp_path / "a.json").read_bytes())
    assert scenes.is_scene(tmp_path / "b.json")
    np.testing.assert_array_equal(scenes.load(tmp_path / "b.json").starts, scenes.maze().starts)
    square = json.dumps({"outer": [[0, 0], [4, 0], [4, 4], [0, 4]]})
    (tmp_path / "c.json").write_text("\ufeff" + square, encoding="utf-8")
    assert scenes.read_polygons(tmp_path / "c.json").free_space.area == 16
    (tmp_path / "d.map").write_text("\ufefftype octile\nheight 1\nwidth 2\nmap\n..\n", encoding="utf-8")
    assert scenes.read_map(tmp_path / "d.map").free_space.area == 2


def test_a_name_that_no_file_can_have_is_refused():
    for read in (scenes.load, scenes.read_polygons, scenes.read_map_server, scenes.read_map):
        with pytest.raises(ValueError, match=re.escape("a\0b: ")):
            read("a\0b")


@pytest.mark.parametrize(("step", "error"), [("fsync", OSError), ("replace", OSError), ("fsync", KeyboardInterrupt)])
def test_a_failure_or_an_interrupt_leaves_the_old_file_and_nothing_else(step, error, tmp_path, monkeypatch):
    path = tmp_path / "file"
    write_atomically(path, b"old")

    def fail(*_):
        raise error("disk full")

    monkeypatch.setattr(os, step, fail)
    with pytest.raises(error, match="disk full"):
        write_atomically(path, b"new")
    assert path.read_bytes() == b"old" and os.listdir(tmp_path) == ["file"]


def test_a_file_has_the_permissions_of_any_new_file_or_of_the_one_that_it_replaces(tmp_path):
    path, usual = tmp_path / "file", tmp_path / "usual"
    write_atomically(path, b"old")
    usual.write_bytes(b"")
    assert stat.S_IMODE(path.stat().st_mode) == stat.S_IMODE(usual.stat().st_mode)
    for mode in (0o600, 0o664, 0o755, 0o444):
        path.chmod(mode)
        write_atomically(path, b"new")
        assert stat.S_IMODE(path.stat().st_mode) == mode


@pytest.mark.parametrize("length", [200, 246, 255])
def test_a_name_may_be_as_long_as_the_file_system_takes(length, tmp_path):
    path = tmp_path / ("x" * length)
    for data in (b"one", b"two"):
        write_atomically(path, data)
        assert path.read_bytes() == data


def test_errors_name_the_file_and_not_a_temporary_one(tmp_path, monkeypatch):
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


def test_a_link_is_followed_and_a_pipe_is_not_replaced(tmp_path):
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
