"""The command line in a process of its own: how it starts, and what is left when it is ended."""

import contextlib
import os
import subprocess
import sys

import pytest

from plr_jax import VisibilityGraph, construct, save, scenes


def script(code, *arguments, **environment):
    """A process of its own, in which the code runs."""
    command = [sys.executable, "-c", code, *map(str, arguments)]
    return subprocess.run(command, check=False, capture_output=True, text=True, env={**os.environ, **environment})


# A job in the background starts with Ctrl-C ignored, and so would the process.
IN_FRONT = "import os, signal; signal.signal(signal.SIGINT, signal.default_int_handler)\nfrom plr_jax import cli\n"
INTERRUPT, TERMINATE = (f"os.kill(os.getpid(), signal.{name})" for name in ("SIGINT", "SIGTERM"))


def with_module(folder, name, code):
    """The environment of a process that finds a module of some name here."""
    (folder / f"{name}.py").write_text("import gc, os, signal\n" + code)
    return {"PYTHONPATH": os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")])}


def test_an_interrupt_while_the_command_loads_is_no_traceback(tmp_path):
    done = script(IN_FRONT + "cli.main()", **with_module(tmp_path, "typer", INTERRUPT))
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "Interrupted.\n")


@pytest.mark.parametrize(
    ("swallow", "end", "code", "said"),
    [
        ("try: {}\nexcept BaseException: pass", INTERRUPT, 130, "Interrupted.\n"),
        ("gc.callbacks.append(lambda *_: {})", TERMINATE, 143, ""),
    ],
)
def test_no_import_within_a_command_swallows_a_signal(tmp_path, swallow, end, code, said):
    library = with_module(tmp_path, "library", swallow.format(end) + "\ngc.collect()\n")
    done = script(IN_FRONT + "cli.load_app = lambda: lambda: __import__('library')\ncli.main()", **library)
    assert (done.returncode, done.stdout, done.stderr) == (code, "", said)


def test_a_signal_in_a_callback_of_the_garbage_collector_is_not_lost():
    command = f"""
import gc, time
def callback(*_):
    gc.callbacks.remove(callback)
    {INTERRUPT}
def command():
    gc.callbacks.append(callback)
    gc.collect()
    time.sleep(60)
cli.load_app = lambda: command
"""
    done = script(IN_FRONT + command + "cli.main()")
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")


def test_an_interrupt_after_all_imports_is_an_exception():
    command = f"def command():\n try: {INTERRUPT}\n finally: print('cleaned up')\ncli.load_app = lambda: command\n"
    done = script(IN_FRONT + command + "cli.main()")
    assert (done.returncode, done.stdout, done.stderr) == (130, "cleaned up\n", "")


def test_a_command_that_is_terminated_leaves_no_half_written_file(tmp_path):
    code = """
import os, pathlib, signal, sys
from plr_jax import _files, cli
os.fsync = lambda _: os.kill(os.getpid(), signal.SIGTERM)
cli.load_app = lambda: lambda: _files.write_atomically(pathlib.Path(sys.argv[1]), b"data")
cli.main()
"""
    done = script(code, tmp_path / "file")
    assert (done.returncode, done.stderr) == (143, "")
    assert list(tmp_path.iterdir()) == []


@pytest.fixture(scope="module")
def maze(tmp_path_factory):
    problem = scenes.maze()
    oracle = VisibilityGraph(problem.workspace, problem.goals[0])
    path = tmp_path_factory.mktemp("maze") / "maze.plr"
    save(construct(oracle, problem.workspace.bounds, leaf="cone", max_bytes=300, certified=True), path)
    return path


COMMAND = """
import sys
from plr_jax.cli import load_app
try: load_app()(sys.argv[1:])
except SystemExit as end: assert not end.code
print(*{'jax', 'scipy', 'shapely', 'matplotlib', 'networkx'} & set(sys.modules), file=sys.stderr)
"""


def test_help_and_query_import_no_heavy_library(maze, tmp_path):
    assert script(COMMAND, "--help").stderr == "\n"
    (tmp_path / "points.csv").write_text("0.1,0.2\n")
    done = script(COMMAND, "query", maze, tmp_path / "points.csv", "--bounds")
    assert done.stderr == "\n" and len(done.stdout.split(",")) == 3


def test_a_reader_that_has_seen_enough_ends_query_quietly(maze):
    query = [sys.executable, "-m", "plr_jax", "query", str(maze)]
    with subprocess.Popen(query, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        process.stdin.write(b"0.1,0.2\n")
        process.stdin.flush()
        assert float(process.stdout.readline()) > 0  # answered before the table ends
        process.stdout.close()
        with contextlib.suppress(BrokenPipeError):
            process.stdin.write(b"0.1,0.2\n" * 100_000)
            process.stdin.close()
        assert (process.stderr.read(), process.wait()) == (b"", 141)


@pytest.mark.parametrize(
    ("redirected", "message"),
    [
        (">&-", "Standard output is closed"),
        ("<&-", "Standard input is closed"),
        pytest.param(
            "> /dev/full",
            "No space left on device\n",
            marks=pytest.mark.skipif(not os.path.exists("/dev/full"), reason="there is no device that is full"),
        ),
    ],
)
def test_what_is_closed_or_full_is_told(maze, redirected, message):
    command = f'echo 0.1,0.2 | "{sys.executable}" -m plr_jax query "{maze}" {redirected}'
    done = subprocess.run(["sh", "-c", command], check=False, capture_output=True, text=True)
    assert done.returncode == 2 and done.stderr.startswith(f"Error: {message}") and done.stderr.count("\n") == 1


@pytest.mark.skipif(sys.platform != "linux", reason="memory is read as Linux tells it")
def test_query_takes_little_memory_whatever_the_table(maze, tmp_path):
    code = (
        COMMAND
        + """
import pathlib, re
print(re.search(r"VmHWM:\\s+(\\d+)", pathlib.Path("/proc/self/status").read_text())[1], file=sys.stderr)
"""
    )
    taken = []
    for rows in (1_000, 500_000):
        (tmp_path / "points.csv").write_text("0.123456,0.654321\n" * rows)
        done = script(code, "query", maze, tmp_path / "points.csv")
        assert done.stdout.count("\n") == rows
        taken.append(int(done.stderr) / 1024)
    assert taken[1] < min(taken[0] + 40, 200)
