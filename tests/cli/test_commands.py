import subprocess
import sys

import numpy as np
import pytest
from cli_helpers import mistake, run

import plr_jax
from plr_jax import Box, construct, scenes
from plr_jax._io import load, save


def test_query_prints_what_the_plr_answers(maze, tmp_path):
    points = np.random.default_rng(0).random((50, 2))
    (tmp_path / "points.csv").write_text("x,y\n" + "".join(f"{x!r},{y!r}\n" for x, y in points.tolist()))
    result = run("query", maze, tmp_path / "points.csv")
    assert result.exit_code == 0, result.output
    answers = np.array(result.stdout.split(), np.float32)  # nine digits tell 32-bit floats apart
    np.testing.assert_array_equal(answers, load(maze).numpy()(points))


def test_query_reads_standard_input_and_prints_gradients(maze):
    result = run("query", maze, "--gradient", input="0.1,0.1\n3,3\n")
    plr = load(maze)
    first, outside = (list(map(float, line.split(","))) for line in result.stdout.splitlines())
    x, shift = np.array([0.1, 0.1]), 2e-3
    assert first[0] == pytest.approx(float(plr(x)), rel=1e-6)
    for axis in range(2):
        step = shift * np.eye(2)[axis]
        assert first[1 + axis] == pytest.approx(float(plr(x + step) - plr(x - step)) / (2 * shift), abs=1e-3)
    assert outside[0] == np.inf


def test_the_gradient_of_nan_is_nan(maze):
    result = run("query", maze, "--gradient", input="nan,0.1\na,b\n0.1,0.1\n0.1,nan\n")
    rows = [list(map(float, line.split(","))) for line in result.stdout.splitlines()]
    np.testing.assert_array_equal(np.isnan(rows), np.array([[True], [True], [False], [True]]) & np.ones(3, bool))


def test_one_bad_row_is_one_bad_row(plane):
    result = run("query", plane, input="0.1,0.2\na,b\nnan,1\n0.3,0.4\n")
    assert result.exit_code == 0
    first, bad, unknown, last = result.stdout.splitlines()
    assert (bad, unknown) == ("nan", "nan") and np.isfinite([float(first), float(last)]).all()
    said = "stdin, line 2: expected 2 comma-separated numbers, got 'a,b'"
    assert result.stderr == f"Warning: {said}; the answer is nan.\n"
    strict = run("query", plane, "--strict", input="0.1,0.2\na,b\n0.3,0.4\n")
    assert (strict.exit_code, strict.stdout) == (2, first + "\n")
    assert strict.stderr == f"Error: {said}.\n"


def test_query_explains_mistakes(plane, tmp_path):
    assert "stdin has no points" in mistake("query", plane, input="")
    assert "No such file" in mistake("query", plane, tmp_path / "none.csv")
    assert "No such file" in mistake("query", tmp_path / "none.plr", input="0,0\n")
    (tmp_path / "foreign.plr").write_text("not a PLR at all, but long enough to hold a header")
    assert "foreign.plr" in mistake("query", tmp_path / "foreign.plr", input="0,0\n")
    (tmp_path / "points.csv").write_bytes(b"\xff\xfe\x00")
    assert "points.csv is not a text file" in mistake("query", plane, tmp_path / "points.csv")
    assert "is a directory" in mistake("query", plane, tmp_path).lower()


def test_export_writes_a_header(plane, tmp_path):
    result = run("export", plane, "--c", "-o", tmp_path / "level_1.h")
    assert result.exit_code == 0, result.output
    text = (tmp_path / "level_1.h").read_text()
    assert text == load(plane).c_header("level_1")
    assert run("export", plane, "--c", "-o", tmp_path / "b.h", "--name", "level_1").exit_code == 0
    assert (tmp_path / "b.h").read_text() == text
    assert "identifier of C" in mistake("export", plane, "--c", "-o", tmp_path / "1.h")
    assert "--c is for a header of C99" in mistake("export", plane, "-o", tmp_path / "a.h")
    assert "must end in .h" in mistake("export", plane, "--c", "-o", tmp_path / "a.txt")
    assert "No such folder" in mistake("export", tmp_path / "none.plr", "--c", "-o", tmp_path / "none" / "a.h")


def test_info_says_what_is_in_the_file(maze):
    result = run("info", maze)
    plr = load(maze)
    assert result.exit_code == 0
    assert f"leaf       {maze.stem}\n" in result.stdout
    assert "label      maze --goal=0.06,0.07\n" in result.stdout
    assert "[0.0, 0.0] to [1.0, 1.0] (2-D)" in result.stdout
    assert f"{plr.num_leaves:,}, of which 0 unreachable" in result.stdout
    assert f"{plr.num_bytes:,} in the file, {plr.resident_bytes:,} in memory" in result.stdout


@pytest.mark.parametrize("escape", ["\x1b]0;title\x07\x1b[2J", "\x9b2J", "\r\n\u2028", "\u202e"])
def test_no_terminal_obeys_a_label(escape, plane, tmp_path):
    path, shown = tmp_path / "hostile.plr", escape.encode("unicode_escape").decode()
    save(load(plane).with_label(f"'{escape}.png' --goal=0,0"), path)
    told = run("info", path)
    assert f"label      '{shown}.png' --goal=0,0\n" in told.stdout
    drawn = run("plot", path, "-o", tmp_path / "a.png")
    refused = run("plot", path, "--kind", "error", "-o", tmp_path / "a.png")
    assert (drawn.exit_code, refused.exit_code) == (0, 2)
    for said in (told.stdout, drawn.output, refused.output):
        assert all(char.isprintable() or char == "\n" for char in said)
    assert drawn.stderr.count("\n") == refused.stderr.count("\n") == 1


def test_info_names_periodic_axes(tmp_path):
    domain = Box((0, -1), (1, 1), periodic=(False, True))
    save(construct(lambda x: x[:, 0] + np.cos(np.pi * x[:, 1]), domain, max_leaves=5), tmp_path / "angle.plr")
    result = run("info", tmp_path / "angle.plr")
    assert "[0.0, -1.0] to [1.0, 1.0] (2-D, periodic along axes [1])" in result.stdout


def test_info_tells_domains_without_what_arithmetic_made_of_their_last_digits(tmp_path):
    save(construct(lambda x: x[:, 0], Box((0,), (146 * 0.05,)), max_leaves=2), tmp_path / "line.plr")
    assert "domain     [0.0] to [7.3] (1-D)\n" in run("info", tmp_path / "line.plr").stdout


def test_what_cannot_be_written_is_found_out_before_any_work(tmp_path, monkeypatch):
    def work(*_):
        pytest.fail("this is work")

    for name in ("scenes.maze", "_io.load"):
        monkeypatch.setattr(f"plr_jax.{name}", work)
    loop = tmp_path / "loop"
    loop.symlink_to(loop)
    (tmp_path / "file").touch()
    cases = [(tmp_path / "none" / "a.png", "No such folder"), (tmp_path, "Is a directory"), (loop, "Too many levels")]
    cases += [(tmp_path / ("x" * 300), "File name too long"), (tmp_path / "file" / "a.png", "Not a directory")]
    for path, message in cases:
        assert message in mistake("build", "maze", "-o", path)
    (tmp_path / "folder.png").mkdir()
    assert "No such folder" in mistake("plot", "a.plr", "-o", tmp_path / "none" / "a.png")
    assert "folder.png: Is a directory" in mistake("plot", "a.plr", "-o", tmp_path / "folder.png")


def test_what_is_read_is_not_written_over(plane, tmp_path):
    (tmp_path / "a.map").write_text("type octile\nheight 1\nwidth 2\nmap\n..\n")
    scenes.save(scenes.four_rooms(2), tmp_path / "team.json")
    (tmp_path / "header.h").symlink_to(plane)
    (tmp_path / "oracle.npz").write_bytes(b"oracle")
    files = {path: path.read_bytes() for path in tmp_path.iterdir()}
    commands = [
        ("build", tmp_path / "a.map", "--goal", "1,0.5", "-o", tmp_path / "a.map"),
        ("build", "maze", "--oracle", tmp_path / "oracle.npz", "-o", tmp_path / "oracle.npz"),
        ("export", plane, "--c", "-o", tmp_path / "header.h"),
        ("plan", tmp_path / "team.json", "-o", tmp_path / "team.json"),
    ]
    for command in commands:
        assert "is read, and would be written over" in mistake(*command)
    assert files == {path: path.read_bytes() for path in tmp_path.iterdir()}


def test_demo_writes_what_it_says(tmp_path, monkeypatch):
    from plr_jax.cli import _demo

    pair = scenes.four_rooms(2)
    monkeypatch.setattr("plr_jax.scenes.four_rooms", lambda num_robots: pair)
    monkeypatch.setattr(_demo, "_PLR_POINTS", 1000)
    monkeypatch.setattr(_demo, "_ORACLE_POINTS", 100)
    monkeypatch.setattr(_demo, "DEFAULT_BYTES", 500)
    monkeypatch.setattr(_demo, "_GIF_SECONDS", 1)
    result = run("demo", "--output", tmp_path / "new" / "folder")
    assert result.exit_code == 0, result.output
    pictures = ("maze_distance.png", "maze_error.png", "maze_surface.png", "four_rooms.html", "four_rooms.gif")
    for name in ("maze.plr", *pictures):
        path = tmp_path / "new" / "folder" / name
        assert path.stat().st_size > 0
        assert str(path) in result.stdout
    words = ("bytes in the file", "max 0.0", "mean 0.0", "PLR / oracle", "times the lower bound", "Valid: clearance")
    for word in words:
        assert word in result.stdout


def test_the_package_runs_as_a_module():
    done = subprocess.run([sys.executable, "-m", "plr_jax", "--help"], check=False, capture_output=True, text=True)
    assert done.returncode == 0 and "build" in done.stdout


def test_help_has_an_example():
    for command in ([], ["build"], ["query"], ["export"], ["info"], ["plot"], ["plan"], ["demo"]):
        result = run(*command, "--help")
        assert result.exit_code == 0
        assert f"plr-jax {command[0] if command else 'demo'}" in result.stdout


def test_the_version_is_that_of_the_package():
    assert run("--version").stdout == f"plr-jax {plr_jax.__version__}\n"
