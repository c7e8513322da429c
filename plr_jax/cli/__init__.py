"""The command ``plr-jax``. Commands write ``plr_jax.name``, which is imported in use, so that ``--help`` is fast."""

import os
import signal
import sys
import threading
from types import FrameType
from typing import Any

INTERRUPTED_EXIT, BROKEN_PIPE_EXIT, TERMINATED_EXIT = 130, 141, 143
_SOON = 0.01  # seconds; callbacks of the garbage collector end within this time


def main() -> None:
    """Run the command ``plr-jax``.

    Ctrl-C ends it with exit code 130, SIGTERM with 143, even while modules are being imported.
    """
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # background jobs ignore Ctrl-C
        signal.signal(signal.SIGINT, _stop)
    signal.signal(signal.SIGTERM, _stop)
    sys.unraisablehook = _resend_lost_signal
    try:
        load_app()()
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED_EXIT)


def _stop(number: int, frame: FrameType | None) -> None:
    """Handle SIGINT or SIGTERM by raising an exception, so that cleanup runs.

    During an import, end the process at once instead.
    """
    interrupted = number == signal.SIGINT
    while frame is not None:
        # In an incomplete import, some libraries swallow an exception, or abort. No file is open for writing then.
        if frame.f_code.co_name == "_find_and_load":
            os.write(2, b"Interrupted.\n" if interrupted else b"")
            os._exit(INTERRUPTED_EXIT if interrupted else TERMINATED_EXIT)
        frame = frame.f_back
    raise KeyboardInterrupt if interrupted else SystemExit(TERMINATED_EXIT)


def _resend_lost_signal(lost: "sys.UnraisableHookArgs") -> None:
    """Send SIGINT or SIGTERM again if Python dropped the exception that the handler of the signal raised.

    Python drops exceptions in callbacks of the garbage collector, and reports them to this hook as ``lost``.
    """
    number = {KeyboardInterrupt: signal.SIGINT, SystemExit: signal.SIGTERM}.get(lost.exc_type)
    if number is None:
        sys.__unraisablehook__(lost)
    else:
        threading.Timer(_SOON, os.kill, (os.getpid(), number)).start()


def load_app() -> Any:
    from plr_jax.cli import build, files, plan  # noqa: F401
    from plr_jax.cli.app import app

    return app
