"""The command ``plr-jax``: build, query, inspect and draw piecewise linear regressions, and plan with them.

``app`` has what all commands share, ``inputs`` reads maps, ``rows`` reads tables of points; ``build``, ``files`` and
``plan`` hold the commands. Heavy libraries are imported inside the commands, so that ``--help`` answers at once, and
``query`` answers without JAX.
"""

import os
import signal
import sys
import threading
from types import FrameType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import typer

INTERRUPTED_EXIT, BROKEN_PIPE_EXIT, TERMINATED_EXIT = 130, 141, 143
_SOON = 0.01  # seconds: a callback of the garbage collector ends within this time


def main() -> None:
    """Run the command line; the entry point of ``plr-jax``.

    Ctrl-C ends the command with exit code 130, also while it loads. SIGTERM ends it with 143. No file is left
    half-written.
    """
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # not a job in the background
        signal.signal(signal.SIGINT, _stop)
    signal.signal(signal.SIGTERM, _stop)
    sys.unraisablehook = _resend_lost_signal
    try:
        load_app()()
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED_EXIT)


def _stop(number: int, frame: FrameType | None) -> None:
    """End the command by an exception, which cleans up. During an import, end the process at once.

    Libraries swallow an exception in a half-done import, or abort the process. During imports no file is open for
    writing, so there is nothing to clean up.
    """
    interrupted = number == signal.SIGINT
    while frame is not None:
        if frame.f_code.co_name == "_find_and_load":  # of Python's own importlib
            os.write(2, b"Interrupted.\n" if interrupted else b"")
            os._exit(INTERRUPTED_EXIT if interrupted else TERMINATED_EXIT)
        frame = frame.f_back
    raise KeyboardInterrupt if interrupted else SystemExit(TERMINATED_EXIT)


def _resend_lost_signal(lost: "sys.UnraisableHookArgs") -> None:
    """Send a signal again if its exception was lost in a callback of the garbage collector, as JAX has."""
    number = {KeyboardInterrupt: signal.SIGINT, SystemExit: signal.SIGTERM}.get(lost.exc_type)
    if number is None:
        sys.__unraisablehook__(lost)
    else:
        threading.Timer(_SOON, os.kill, (os.getpid(), number)).start()


def load_app() -> "typer.Typer":
    """Import the commands, which registers them in the order of the help, and return the application."""
    from plr_jax.cli import build, files, plan  # noqa: F401
    from plr_jax.cli.app import app

    return app
