"""The command ``plr-jax``: build, query, inspect and draw piecewise linear regressions, and plan with them."""

import os
import signal
import sys
import threading
from types import FrameType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import typer

INTERRUPTED_EXIT, BROKEN_PIPE_EXIT, TERMINATED_EXIT = 130, 141, 143
_SOON = 0.01  # seconds, in which a callback ends


def main() -> None:
    """Run the command line; the entry point of ``plr-jax``.

    Interrupted, while it loads as well, it ends with exit code 130; terminated, with 143, and leaves no half-written
    file.
    """
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # Ctrl-C means no job in the background
        signal.signal(signal.SIGINT, _stop)
    signal.signal(signal.SIGTERM, _stop)
    sys.unraisablehook = _send_again
    try:
        load_app()()
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED_EXIT)


def _stop(number: int, frame: FrameType | None) -> None:
    """End the command by an exception, which cleans up; within an import, at once.

    An exception does not always come through a half-done import: libraries swallow it, or abort the process. No file
    is open for writing then, and nothing else is to be cleaned up.
    """
    interrupted = number == signal.SIGINT
    while frame is not None:
        if frame.f_code.co_name == "_find_and_load":  # of Python's own importlib
            os.write(2, b"Interrupted.\n" if interrupted else b"")
            os._exit(INTERRUPTED_EXIT if interrupted else TERMINATED_EXIT)
        frame = frame.f_back
    raise KeyboardInterrupt if interrupted else SystemExit(TERMINATED_EXIT)


def _send_again(lost: "sys.UnraisableHookArgs") -> None:
    """Send a signal again whose exception went nowhere, as from a callback of the garbage collector; JAX has one."""
    number = {KeyboardInterrupt: signal.SIGINT, SystemExit: signal.SIGTERM}.get(lost.exc_type)
    if number is None:
        sys.__unraisablehook__(lost)
    else:
        threading.Timer(_SOON, os.kill, (os.getpid(), number)).start()


def load_app() -> "typer.Typer":
    """The application with all its commands, imported only here."""
    # Importing the commands registers them; the help lists them in this order.
    from plr_jax.cli import _commands, _export, _plan  # noqa: F401
    from plr_jax.cli._app import app

    return app
