"""The command line in a process of its own: how it starts, and what is left when it is ended."""

import os
import subprocess
import sys


def script(code, *arguments, **environment):
    """A process of its own, in which the code runs."""
    command = [sys.executable, "-c", code, *map(str, arguments)]
    return subprocess.run(command, check=False, capture_output=True, text=True, env={**os.environ, **environment})


def test_an_interrupt_while_the_command_loads_is_no_traceback(tmp_path):
    (tmp_path / "typer.py").write_text("import os, signal\nos.kill(os.getpid(), signal.SIGINT)\n")
    path = os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])
    # A job in the background starts with Ctrl-C ignored, and so would the process.
    in_front = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"
    done = script(f"{in_front}; from plr_jax.cli import main; main()", PYTHONPATH=path)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")


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
