"""PLRs from static servers: with ranges, without, and from servers that send something else."""

import http.server
import re
import threading
import time
from contextlib import contextmanager, suppress
from itertools import chain, repeat

import numpy as np
import pytest

import plr_jax
from plr_jax.plr.file.container import Header

SCENE = plr_jax.scenes.maze()
ORACLE = plr_jax.VisibilityGraph(SCENE.workspace, SCENE.goals[0])
X = SCENE.workspace.sample_free(500, seed=0)


class Static(http.server.BaseHTTPRequestHandler):
    """A static server: one file, ranges, an ETag; ``server.change`` may spoil what is sent."""

    protocol_version = "HTTP/1.1"

    def do_GET(self):
        server = self.server
        server.requests.append(self.headers.get("Range"))
        data, headers = server.files[self.path], {"ETag": f'"{hash(server.files[self.path])}"'}
        match = re.fullmatch(r"bytes=(\d+)-(\d+)", self.headers.get("Range", ""))
        status, body = 200, data
        if match and server.knows_ranges:
            start, end = int(match[1]), min(int(match[2]) + 1, len(data))
            status, body = (206, data[start:end]) if start < len(data) else (416, b"")
            headers["Content-Range"] = f"bytes {start}-{end - 1}/{len(data)}"
        self.send_response(status)
        for name, value in headers.items():
            self.send_header(name, value)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        closes, self.close_connection = self.close_connection, True
        with suppress(ConnectionError):  # who has read enough hangs up
            for begin in range(0, len(body), 1 << 14):
                server.sent += self.wfile.write(body[begin : begin + (1 << 14)])
            self.close_connection = closes

    def log_message(self, *_):
        pass


@contextmanager
def serving(handler=Static, knows_ranges=True, **files):
    """A server on this machine of some files, and the address of its first one."""
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    server.daemon_threads = True
    server.files = {f"/{name}": data for name, data in files.items()}
    server.requests, server.sent, server.knows_ranges = [], 0, knows_ranges
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield server, f"http://127.0.0.1:{server.server_address[1]}/{next(iter(files), 'file')}"
    finally:
        server.shutdown()
        server.server_close()


@pytest.fixture(scope="module")
def layers():
    """Three PLRs with proofs, coarse to fine, and the bytes of their progressive file."""
    plrs = [
        plr_jax.construct(ORACLE, SCENE.workspace.bounds, max_bytes=size, leaf=leaf, certified=True)
        for size, leaf in ((300, "cone"), (1500, "plane"), (9000, "cone"))
    ]
    return plrs, plr_jax.progressive(plrs).to_bytes()


@pytest.mark.parametrize("knows_ranges", [True, False])
def test_as_much_as_is_wanted_comes_in_one_request(layers, knows_ranges):
    plrs, data = layers
    marks = (*Header.read(data).marks, len(data))
    with serving(knows_ranges=knows_ranges, file=data) as (server, url):
        for mark, plr in zip(marks, plrs, strict=True):
            for most in {mark, min(mark + 40, len(data))}:
                server.requests.clear()
                found = plr_jax.open_url(url, max_bytes=most)
                assert found.to_bytes() == data[:mark] and found.max_error == plr.max_error
                np.testing.assert_array_equal(found.numpy()(X), plr.numpy()(X))
                assert server.requests == [f"bytes=0-{most - 1}"]
        whole = plr_jax.open_url(url)
        assert whole.to_bytes() == data and len(server.requests) == 2


def test_a_server_without_ranges_is_not_read_to_the_end(layers):
    data = layers[1] + bytes(1 << 24)  # whatever follows
    with serving(knows_ranges=False, file=data) as (server, url):
        assert plr_jax.open_url(url, max_bytes=2000).to_bytes() == data[: Header.read(data).marks[1]]
        assert server.sent < 1 << 23


def test_the_server_of_the_standard_library_will_do(layers, tmp_path):
    (tmp_path / "maze.plr").write_bytes(layers[1])

    class Quiet(http.server.SimpleHTTPRequestHandler):
        def __init__(self, *args):
            super().__init__(*args, directory=tmp_path)

        def log_message(self, *_):
            pass

    with serving(Quiet) as (_, url):
        found = plr_jax.open_url(url.replace("/file", "/maze.plr"), max_bytes=400)
    assert found.to_bytes() == layers[1][: found.num_bytes] and found.max_error == layers[0][0].max_error


def test_where_no_mark_fits_it_says_what_would(layers):
    first = Header.read(layers[1]).marks[0]
    with serving(file=layers[1], one=layers[0][2].to_bytes()) as (_, url):
        with pytest.raises(ValueError, match=f"its first mark is at {first}: give a larger max_bytes, got 200"):
            plr_jax.open_url(url, max_bytes=200)
        with pytest.raises(ValueError, match="and no marks: give a larger max_bytes"):
            plr_jax.open_url(url.replace("/file", "/one"), max_bytes=500)
        with pytest.raises(ValueError, match="end too early"):
            plr_jax.open_url(url, max_bytes=3)


@pytest.fixture(scope="module")
def pairs():
    return plr_jax.construct_pairs(SCENE.workspace, max_bytes=4000)


def test_the_first_parts_of_pairs_answer_all(pairs):
    data, y = pairs.to_bytes(), X[::-1]
    marks = Header.read(data).marks
    with serving(file=data) as (_, url):
        assert plr_jax.open_url(url).to_bytes() == data
        parts = [plr_jax.open_url(url, max_bytes=mark) for mark in marks]
    assert [part.num_bytes for part in parts] == list(marks)
    np.testing.assert_allclose(parts[0](X, y), pairs(X, y), rtol=0, atol=1e-6)


def test_one_goal_of_pairs_takes_their_first_part_alone(pairs):
    data, goal = pairs.to_bytes(), SCENE.goals[0]
    mark = Header.read(data).marks[0]
    with serving(file=data) as (server, url):
        found = plr_jax.open_url(url, goal=goal)
        assert server.requests == ["bytes=0-4095"]
        with pytest.raises(ValueError, match=f"first {mark} bytes, more than"):
            plr_jax.open_url(url, 50, goal=goal)
    assert np.abs(found.numpy()(X) - ORACLE(X)).mean() < 1e-5


def test_a_larger_first_part_takes_a_second_request():
    """A round room of many corners, with a triangle in it."""
    angles = np.linspace(0, 2 * np.pi, 1000, endpoint=False)
    wall = 20 + 20 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    room = plr_jax.Workspace.from_polygons([{"outer": wall, "holes": [[(10, 15), (30, 15), (20, 25)]]}])
    data = plr_jax.construct_pairs(room, max_bytes=10_000).to_bytes()
    mark = Header.read(data).marks[0]
    assert 4096 < mark < len(data)
    goal, x = np.array([20.5, 38.0]), room.sample_free(200, seed=1)
    with serving(file=data) as (server, url):
        found = plr_jax.open_url(url, goal=goal)
        assert server.requests == ["bytes=0-4095", f"bytes=4096-{mark - 1}"]
    assert np.abs(found.numpy()(x) - plr_jax.VisibilityGraph(room, goal)(x)).mean() < 0.01


@pytest.mark.parametrize(
    ("url", "shown"),
    [
        *((url, repr(url)) for url in ("file:///etc/passwd", "ftp://host/file", "maze.plr", 3, "", "http:")),
        ("http://anne:secret@localhost:1/a", "'http://***@localhost:1/a'"),
        ("https://anne:secret@host/a@b", "'https://***@host/a@b'"),
        ("http://anne:sec@ret@host", "'http://***@host'"),
        ("http://anne:sec ret@host/a", "'http://***@host/a'"),
        ("http://anne@host?secret", "'http://***@host?secret'"),
        ("HTTPS://anne:secret@host/a", "'HTTPS://***@host/a'"),
        ("ftp://anne:secret@host/a", "'ftp://***@host/a'"),
        ("anne:secret@host/a", "'***@host/a'"),
    ],
)
@pytest.mark.usefixtures("unchecked_types")
def test_other_addresses_are_refused_and_no_error_shows_a_password(url, shown):
    with pytest.raises(ValueError, match="url must") as caught:
        plr_jax.open_url(url)
    assert f"got {shown}" in str(caught.value) and "anne" not in str(caught.value)


def test_what_is_no_plr_names_its_address():
    plr = plr_jax.construct(lambda x: x[:, 0], ([0, 0], [1, 1]), max_leaves=4)
    good = plr.to_bytes()
    bad = {"empty": b"", "page": b"<html>", "flipped": good[:-9] + b"\xff" + good[-8:], "cut": good[:-3]}
    with serving(file=good, **bad, **{"a@b": good}) as (_, url):
        for name in ("file", "a@b"):  # an at sign behind the host is no user's name
            assert plr_jax.open_url(url.replace("file", name)).to_bytes() == good
        for name in bad:
            with pytest.raises(ValueError, match=f"/{name} cannot be read as a PLR|no bytes beyond"):
                plr_jax.open_url(url.replace("/file", f"/{name}"))
        with pytest.raises(ValueError, match="no distances of pairs"):
            plr_jax.open_url(url, goal=(0.5, 0.5))
    with pytest.raises(OSError, match="cannot be reached"):  # the server is not there any more
        plr_jax.open_url(url)


def raw(*parts, pause=0.0, again=()):
    """A handler that sends these bytes, whatever it is asked for."""

    class Handler(Static):
        def do_GET(self):
            self.close_connection = True
            with suppress(ConnectionError):
                for part in chain(parts, again):
                    self.wfile.write(part)
                    time.sleep(pause)

    return Handler


PARTIAL = b"HTTP/1.1 206 Partial\r\nContent-Length: 10\r\n"


@pytest.mark.parametrize(
    ("handler", "error", "message"),
    [
        (raw(b"HTTP/1.1 404 Gone\r\nContent-Length: 0\r\n\r\n"), OSError, "answered 404"),
        (raw(b"HTTP/1.1 500 Ill\r\nContent-Length: 0\r\n\r\n"), OSError, "answered 500"),
        (raw(b"HTTP/1.1 500 \x1b[2J\r\nContent-Length: 0\r\n\r\n"), OSError, r"answered 500 '\\x1b\[2J'"),
        (raw(b"\x1b[2J\r\n"), OSError, r"BadStatusLine '\\x1b\[2J"),
        (raw(b""), OSError, "cannot be reached|does not answer as a web server does"),
        (raw(b"SSH-2.0\r\n"), OSError, "does not answer as a web server does"),
        (raw(b"HTTP/1.1 200 OK\r\n" + b"X: y\r\n" * 500 + b"\r\n"), OSError, "does not answer as a web server"),
        (raw(b"HTTP/1.1 302 X\r\nLocation: file:///etc/passwd\r\n\r\n"), OSError, "302|not allowed|unknown"),
        (raw(b"HTTP/1.1 200 OK\r\nContent-Length: 100\r\n\r\nPLR"), OSError, "broke off after 3 of 100"),
        (raw(b"HTTP/1.1 200 OK\r\nContent-Encoding: gzip\r\n\r\nPLR"), ValueError, "sent as 'gzip'"),
        (raw(PARTIAL + b"\r\n0123456789"), ValueError, "and sent others"),
        (raw(PARTIAL + b"Content-Range: bytes 5-14/20\r\n\r\n0123456789"), ValueError, "and sent others"),
        (raw(PARTIAL + b"Content-Range: bytes 0-99999999999/1\r\n\r\n0123456789"), ValueError, "and sent others"),
        (raw(PARTIAL + b"Content-Range: bytes 0-9/x\r\n\r\n0123456789"), ValueError, "and sent others"),
        (raw(b"HTTP/1.1 200 OK\r\n\r\n", *[b"x"] * 1000, pause=0.01), OSError, "within 0.3 s"),
        (raw(*[b"HTTP/1.1 200 OK"[i : i + 1] for i in range(15)], pause=0.1), OSError, "within 0.3 s|timed out"),
    ],
)
def test_strange_servers_give_clear_errors_in_time(handler, error, message):
    with serving(handler) as (_, url):
        began = time.monotonic()
        with pytest.raises(error, match=message):
            plr_jax.open_url(url, max_bytes=1000, timeout=0.3 if "within" in message else 10.0)
        assert time.monotonic() - began < 5  # which hung once


def test_a_stream_without_end_is_not_read_to_its_end():
    endless = raw(b"HTTP/1.1 200 OK\r\n\r\n", again=repeat(bytes(1 << 16)))
    with serving(endless) as (_, url), pytest.raises(ValueError, match="does not start like a PLR file"):
        plr_jax.open_url(url, max_bytes=1000)


def test_all_of_a_file_is_all_of_it(layers):
    """A server may send less than what it was asked for; then the rest is asked for, or it is an error."""
    data = layers[1]
    mark = Header.read(data).marks[1]

    class Sparing(Static):
        def do_GET(self):
            first, last = map(int, re.fullmatch(r"bytes=(\d+)-(\d+)", self.headers["Range"]).groups())
            self.headers.replace_header("Range", f"bytes={first}-{min(last, first + 999)}")
            super().do_GET()

    with serving(Sparing, file=data) as (server, url):
        assert plr_jax.open_url(url).to_bytes() == data
        assert len(server.requests) == -(-len(data) // 1000)
    promised = b"HTTP/1.1 206 X\r\nContent-Range: bytes 0-%d/%d\r\nConnection: close\r\n\r\n"
    for head, error in (
        (b"HTTP/1.1 200 OK\r\nConnection: close\r\n\r\n", "goes on to beyond"),
        (promised % (mark - 1, len(data)), "and sent others"),
        (promised % (mark - 1, 10**17), "and sent others"),
    ):
        with serving(raw(head, data[:mark])) as (_, url), pytest.raises((ValueError, OSError), match=error):
            plr_jax.open_url(url)


def test_nobody_reads_on_after_a_timeout():
    before = threading.active_count()
    with serving(raw(b"HTTP/1.1 200 OK\r\n\r\n", *[b"x"] * 100, pause=0.05)) as (_, url):
        with pytest.raises(TimeoutError):
            plr_jax.open_url(url, timeout=0.2)
        deadline = time.monotonic() + 5
        while threading.active_count() > before + 1 and time.monotonic() < deadline:
            time.sleep(0.05)
    names = [thread.name for thread in threading.enumerate()]
    assert not any("request" in name and "process_request" not in name for name in names), names


@pytest.mark.parametrize("timeout", [0, -1, float("inf"), 1e300, float("nan"), "1"])
@pytest.mark.usefixtures("unchecked_types")
def test_times_that_are_none_are_refused(timeout):
    with pytest.raises(ValueError, match="timeout must be"):
        plr_jax.open_url("http://127.0.0.1/file", timeout=timeout)


def test_a_file_that_changes_between_requests(layers):
    """Of which the server sends less than what it is asked for, so that there are two."""
    data = layers[1]

    class Changing(Static):
        def do_GET(self):
            first = int(re.match(r"bytes=(\d+)", self.headers["Range"])[1])
            self.headers.replace_header("Range", f"bytes={first}-{first + 999}")
            super().do_GET()
            self.server.files["/file"] = data + b"new"

    with serving(Changing, file=data) as (_, url), pytest.raises(ValueError, match="has changed since"):
        plr_jax.open_url(url)
