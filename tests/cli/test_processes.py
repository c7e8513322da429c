"""The command line in a process of its own: how it starts, and what is left when it is ended."""

import contextlib
import os
import subprocess
import sys

import pytest


def script(code, *arguments, **environment):
    """Run code in a process of its own."""
    command = [sys.executable, "-c", code, *map(str, arguments)]
    return subprocess.run(command, check=False, capture_output=True, text=True, env={**os.environ, **environment})


# A job in the background starts with Ctrl-C ignored, and so would the process.
IN_FRONT = "import gc, os, signal, time\nsignal.signal(signal.SIGINT, signal.default_int_handler)\n"
IN_FRONT += "from plr_jax import cli\n"
INTERRUPT, TERMINATE = (f"os.kill(os.getpid(), signal.{name})" for name in ("SIGINT", "SIGTERM"))


def with_module(folder, name, code):
    """Return the environment of a process that finds a module of this name and code."""
    (folder / f"{name}.py").write_text("import gc, os, signal\n" + code)
    return {"PYTHONPATH": os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")])}


def test_interrupt_during_start_prints_no_traceback(tmp_path):
    done = script(IN_FRONT + "cli.main()", **with_module(tmp_path, "typer", INTERRUPT))
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "Interrupted.\n")


@pytest.mark.parametrize(
    ("swallow", "end", "code", "printed"),
    [
        ("try: {}\nexcept BaseException: pass", INTERRUPT, 130, "Interrupted.\n"),
        ("gc.callbacks.append(lambda *_: {})", TERMINATE, 143, ""),
    ],
)
def test_imports_cannot_swallow_signals(tmp_path, swallow, end, code, printed):
    library = with_module(tmp_path, "library", swallow.format(end) + "\ngc.collect()\n")
    done = script(IN_FRONT + "cli.load_app = lambda: lambda: __import__('library')\ncli.main()", **library)
    assert (done.returncode, done.stdout, done.stderr) == (code, "", printed)


IN_COLLECTOR = f"""
def callback(*_):
    gc.callbacks.remove(callback)
    {INTERRUPT}
def command():
    gc.callbacks.append(callback)
    gc.collect()
    time.sleep(60)
"""
WITH_CLEANUP = f"def command():\n try: {INTERRUPT}\n finally: print('cleaned up')\n"


@pytest.mark.parametrize(("command", "printed"), [(IN_COLLECTOR, ""), (WITH_CLEANUP, "cleaned up\n")])
def test_interrupt_ends_a_command_after_its_cleanup(command, printed):
    done = script(IN_FRONT + command + "cli.load_app = lambda: command\ncli.main()")
    assert (done.returncode, done.stdout, done.stderr) == (130, printed, "")


def test_terminated_command_leaves_no_half_written_file(tmp_path):
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


COMMAND = """
import pathlib, re, sys
from plr_jax.cli import load_app
for arguments in (["--help"], sys.argv[1:]):
    try: load_app()(arguments)
    except SystemExit as end: assert not end.code
print(*{'jax', 'scipy', 'shapely', 'matplotlib', 'networkx'} & set(sys.modules), file=sys.stderr)
status = pathlib.Path("/proc/self/status")
print(re.search(r"VmHWM:\\s+(\\d+)", status.read_text())[1] if status.exists() else 0, file=sys.stderr)
"""


def queried_in_process(maze, rows, folder):
    """Query as many points in a process of its own; return its largest memory in MB."""
    (folder / "points.csv").write_text("0.123456,0.654321\n" * rows)
    done = script(COMMAND, "query", maze, folder / "points.csv", "--bounds")
    heavy, kilobytes = done.stderr.splitlines()
    assert done.stdout.count("\n") > rows and heavy == ""
    return int(kilobytes) / 1024


def test_help_and_query_import_no_heavy_library(maze, tmp_path):
    assert queried_in_process(maze, 1, tmp_path) < 200


@pytest.mark.full
@pytest.mark.skipif(sys.platform != "linux", reason="memory is read from a file of Linux")
def test_query_memory_does_not_grow_with_the_table(maze, tmp_path):
    few, many = (queried_in_process(maze, rows, tmp_path) for rows in (1_000, 500_000))
    assert many < min(few + 40, 200)


def test_closed_pipe_ends_query_quietly(maze):
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


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="there is no device that is full")
@pytest.mark.parametrize(
    ("redirected", "message"), [("<&-", "Standard input is closed"), ("> /dev/full", "No space left on device\n")]
)
def test_closed_and_full_streams_are_explained(maze, redirected, message):
    command = f'echo 0.1,0.2 | "{sys.executable}" -m plr_jax query "{maze}" {redirected}'
    done = subprocess.run(["sh", "-c", command], check=False, capture_output=True, text=True)
    assert done.returncode == 2 and done.stderr.startswith(f"Error: {message}") and done.stderr.count("\n") == 1
