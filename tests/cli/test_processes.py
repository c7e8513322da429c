"""The command line in a process of its own: how it starts, and what is left when it is ended."""

import os
import subprocess
import sys

import pytest


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


@pytest.mark.parametrize(("end", "code", "said"), [(INTERRUPT, 130, "Interrupted.\n"), (TERMINATE, 143, "")])
@pytest.mark.parametrize("swallow", ["try: {}\nexcept BaseException: pass", "gc.callbacks.append(lambda *_: {})"])
def test_no_import_within_a_command_swallows_a_signal(tmp_path, swallow, end, code, said):
    library = with_module(tmp_path, "library", swallow.format(end) + "\ngc.collect()\n")
    done = script(IN_FRONT + "cli.load_app = lambda: lambda: __import__('library')\ncli.main()", **library)
    assert (done.returncode, done.stdout, done.stderr) == (code, "", said)


@pytest.mark.parametrize(("end", "code"), [(INTERRUPT, 130), (TERMINATE, 143)])
def test_a_signal_in_a_callback_of_the_garbage_collector_is_not_lost(end, code):
    command = f"""
import gc, time
def callback(*_):
    gc.callbacks.remove(callback)
    {end}
def command():
    gc.callbacks.append(callback)
    gc.collect()
    time.sleep(60)
cli.load_app = lambda: command
"""
    done = script(IN_FRONT + command + "cli.main()")
    assert (done.returncode, done.stdout, done.stderr) == (code, "", "")


def test_an_interrupt_after_all_imports_is_an_exception():
    command = f"def command():\n try: {INTERRUPT}\n finally: print('cleaned up')\ncli.load_app = lambda: command\n"
    done = script(IN_FRONT + command + "cli.main()")
    assert (done.returncode, done.stdout, done.stderr) == (130, "cleaned up\n", "")


def test_a_command_that_is_terminated_leaves_no_half_written_file(tmp_path):
    code = """
import os, pathlib, signal, sys
from plr_jax import _atomic, cli
os.fsync = lambda _: os.kill(os.getpid(), signal.SIGTERM)
cli.load_app = lambda: lambda: _atomic.write_atomically(pathlib.Path(sys.argv[1]), b"data")
cli.main()
"""
    done = script(code, tmp_path / "file")
    assert (done.returncode, done.stderr) == (143, "")
    assert list(tmp_path.iterdir()) == []


def test_help_loads_nothing_heavy():
    code = (
        "import sys; from plr_jax.cli import load_app\n"
        "try: load_app()(['--help'])\n"
        "except SystemExit: pass\n"
        "sys.exit(' '.join({'jax', 'scipy', 'shapely', 'matplotlib', 'networkx'} & set(sys.modules)) or 0)"
    )
    done = script(code)
    assert done.returncode == 0, done.stderr
