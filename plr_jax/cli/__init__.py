"""The command ``plr-jax``: build, query, inspect and draw piecewise linear regressions, and plan with them."""

import os
import signal
import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import typer

INTERRUPTED_EXIT, TERMINATED_EXIT = 130, 143


def main() -> None:
    """Run the command line; the entry point of ``plr-jax``.

    Interrupted, while it loads as well, it ends with exit code 130; terminated, with 143, and leaves no half-written
    file.
    """
    in_front = signal.getsignal(signal.SIGINT) is signal.default_int_handler  # Ctrl-C means no job in the background
    if in_front:
        # An exception would not always come through a half-done import, and nothing is to be cleaned up yet.
        signal.signal(signal.SIGINT, lambda *_: os._exit(INTERRUPTED_EXIT))
    app = load_app()
    if in_front:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(TERMINATED_EXIT))
    try:
        app()
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED_EXIT)


def load_app() -> "typer.Typer":
    """The application with all its commands, imported only here."""
    # Importing the commands registers them; the help lists them in this order.
    from plr_jax.cli import _commands, _plan  # noqa: F401
    from plr_jax.cli._app import app

    return app
