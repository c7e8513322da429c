"""Progress bars of long calls: one style, on terminals and in notebooks, for calls that take over two seconds."""

import os
import sys
import threading
from contextlib import AbstractContextManager
from typing import Any

_DELAY = 2.0  # seconds until a bar appears
_COLUMNS = 80  # width of a bar in a notebook, in characters
_PROCESS = os.getpid()  # processes that fork from it show no bars


class Progress(AbstractContextManager["Progress"]):
    """A count of finished work, shown as a bar while a ``with`` block of the main thread takes over two seconds.

    The bar appears on a terminal, or in the output of a notebook's cell, and vanishes at the end of the block. Pipes,
    and notebooks that run as a batch, get no bar. ``total`` is the count at the end or an upper bound of it; None if
    it is unknown.
    """

    def __init__(self, name: str, unit: str, total: int | None = None):
        self._bar: Any = None
        if (file := _watched_file()) is not None:
            from tqdm import tqdm

            # With miniters, tqdm's own thread draws nothing; in a notebook, it might draw in a later cell.
            of_file: Any = {} if file is sys.stderr else {"ncols": _COLUMNS, "position": 0, "ascii": False}
            options = {"total": total, "unit": f" {unit}", "delay": _DELAY, "leave": False, "miniters": 1}
            self._bar = tqdm(desc=name, file=file, **options, **of_file)

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.close()

    def update(self, count: int = 1, note: str = "") -> None:
        """Add to the count of finished work; a ``note`` replaces the text that the bar shows after the count."""
        if self._bar is not None:
            if note:
                self._bar.set_postfix_str(note, refresh=False)
            self._bar.update(count)


def _watched_file() -> Any:
    """Return a file that shows bars to a person: a notebook's cell or a terminal; None if there is none."""
    if threading.current_thread() is not threading.main_thread() or os.getpid() != _PROCESS:
        return None
    # Kernels refuse to ask for input if a notebook runs as a batch (nbconvert, nbclient, papermill). Outputs of a
    # batch are saved, and should not depend on how long calls take.
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    if getattr(getattr(shell, "kernel", None), "_allow_stdin", False):
        return _CellOutput()
    return sys.stderr if getattr(sys.stderr, "isatty", bool)() else None


class _CellOutput:
    """A file whose last line is shown in the output of a notebook's cell, in the place of the line before."""

    def __init__(self) -> None:
        self._line, self._options = "", {"raw": True, "display_id": f"plr_jax-{id(self)}"}

    def write(self, text: str) -> None:
        from IPython.display import display

        if (line := text.strip()) != self._line:
            display({"text/plain": line} if line else {}, **self._options)  # without content, it takes no room
            self._line, self._options["update"] = line, True
