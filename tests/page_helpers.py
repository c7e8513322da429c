"""Helpers for tests of pages: find the examples of a Markdown page, and run them."""

import io
import re
import shlex
import sys
from pathlib import Path

import pdoc.__main__
import pytest

from plr_jax.cli import main

ROOT = Path(__file__).parent.parent


def blocks(page: str, language: str) -> list[str]:
    """Return the fenced blocks of a language, in their order."""
    return re.findall(rf"```{language}\n(.*?)```", page, re.DOTALL)


def run_page(page: str, folder: Path) -> None:
    """Run the Python and shell blocks of a page from top to bottom, all Python in one namespace."""
    names: dict[str, object] = {"__name__": "page"}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for language, code in re.findall(r"```(python|sh)\n(.*?)```", page, re.DOTALL):
            if language == "python":
                run_python(code, names)
            else:
                run_commands(code.splitlines(), folder)


def run_python(code: str, names: dict[str, object]) -> None:
    """Run a block of Python, with smaller numbers of points in place of large ones."""
    exec(compile(re.sub(r"(sample_free\()[\d_]+", r"\g<1>16", code), "page", "exec"), names)


def run_commands(commands: list[str], folder: Path) -> None:
    """Run lines ``[echo "..." |] PROGRAM ...`` of a shell in a folder, in this process."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for command in commands:
            echo, _, program = command.rpartition("|")
            patch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(f"{''.join(shlex.split(echo)[1:])}\n".encode())))
            patch.setattr(sys, "argv", shlex.split(program))
            if sys.argv[0] == "pdoc":  # its templates are in the repository
                patch.setattr(sys, "argv", [str(ROOT / word) if word == ".pdoc" else word for word in sys.argv])
                pdoc.__main__.cli()
                continue
            assert sys.argv[0] == "plr-jax", command
            with pytest.raises(SystemExit) as end:
                main()
            assert not end.value.code, command
