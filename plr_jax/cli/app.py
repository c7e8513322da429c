"""The command-line application, and the errors, warnings, exit codes and progress that all commands share."""

import contextlib
import functools
import os
import re
import sys
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import takewhile
from typing import Annotated, Any, NoReturn

import typer
from typer.core import TyperCommand

import plr_jax
from plr_jax.cli import BROKEN_PIPE_EXIT, INTERRUPTED_EXIT

app = typer.Typer(
    name="plr-jax",
    help="Compress distance functions over maps into kilobytes, query them, and plan for several robots.",
    epilog="Start with: plr-jax demo",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)
_ERASE_LINE = "\r\x1b[K"
_NUMBER = re.compile(r"\s*[-+]?((\d+(\.\d*)?|\.\d+)(e[-+]?\d+)?|inf(inity)?|nan)\s*", re.ASCII | re.IGNORECASE)


def _print_version(is_asked: bool) -> bool:
    if is_asked:
        typer.echo(f"plr-jax {plr_jax.__version__}")
        raise typer.Exit
    return is_asked


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version and exit.", callback=_print_version, is_eager=True)
    ] = False,
) -> None:
    pass


class _Command(TyperCommand):
    """A command that rejects ``--goal 1 2`` with a hint: a goal must be one argument, ``--goal 1,2``."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        for place, option in enumerate(args):
            texts = (text.rstrip(",") for text in args[place + 1 :])
            given = list(takewhile(numbers_of, texts)) if option in ("--goal", "-g") else []
            if len(given) > 1:
                raise typer.BadParameter(f"a goal must be one argument X,Y: write {option} {','.join(given)}.", ctx)
        return super().parse_args(ctx, args)


def command(*examples: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Return a decorator that registers a function as a command and prints errors and warnings on one line."""

    def register(function: Callable[..., None]) -> Callable[..., None]:
        @functools.wraps(function)
        def run(*args: object, **kwargs: object) -> None:
            shown: set[str] = set()

            def show(message: Warning | str, *_: object, **__: object) -> None:
                if str(message) not in shown:
                    shown.add(str(message))
                    warn(str(message))

            try:
                with warnings.catch_warnings():
                    warnings.showwarning = show
                    function(*args, **kwargs)
            except KeyboardInterrupt:
                typer.echo("Interrupted.", err=True)
                raise typer.Exit(INTERRUPTED_EXIT) from None
            except BrokenPipeError:  # the reader of a pipe, such as `head`, has ended
                # Send the rest of the output to the null device, or Python reports an error when it flushes.
                with contextlib.suppress(OSError, ValueError):
                    null = os.open(os.devnull, os.O_WRONLY)
                    os.dup2(null, sys.stdout.fileno())
                    os.close(null)
                raise typer.Exit(BROKEN_PIPE_EXIT) from None
            except (OSError, ValueError) as error:
                fail(reason_of(error))

        return app.command(epilog="\n\n".join(["Examples:", *examples]), cls=_Command)(run)

    return register


def reason_of(error: OSError | ValueError) -> str:
    """Return an error's message; for a system error, the file and the reason without the error number."""
    if not isinstance(error, OSError):
        return str(error)
    where = f"{error.filename}: " if error.filename else ""
    return f"{where}{error.strerror or error}"


@contextmanager
def progress(what: str) -> Iterator[None]:
    if not sys.stderr.isatty():
        yield
        return
    sys.stderr.write(f"{what} ...")
    sys.stderr.flush()
    try:
        yield
    finally:
        sys.stderr.write(_ERASE_LINE)
        sys.stderr.flush()


def warn(message: str) -> None:
    if sys.stderr.isatty():
        sys.stderr.write(_ERASE_LINE)
    typer.echo("Warning: " + _as_line(message), err=True)


def fail(message: str, code: int = 2) -> NoReturn:
    typer.echo("Error: " + _as_line(message), err=True)
    raise typer.Exit(code)


def finish_or_stop(function: Callable[..., Any], *args: Any, **kwargs: Any) -> tuple[Any, bool]:
    """Call a function that returns partial work on Ctrl-C; return its result, and whether it was interrupted."""
    from plr_jax.plr import ConstructionInterrupted

    show, interrupted = warnings.showwarning, False

    def note(message: Any, *others: Any, **named: Any) -> None:
        nonlocal interrupted
        if isinstance(message, ConstructionInterrupted):
            interrupted = True
        else:
            show(message, *others, **named)

    with warnings.catch_warnings():
        warnings.simplefilter("always", ConstructionInterrupted)
        warnings.showwarning = note
        return function(*args, **kwargs), interrupted


def numbers_of(line: str) -> list[float]:
    """Return the comma-separated numbers of a line, also nan and inf; an empty list if a field is no number."""
    texts = line.split(",")
    return [float(text) for text in texts] if all(map(_NUMBER.fullmatch, texts)) else []


def printable(text: str) -> str:
    r"""Replace control characters of foreign text by escapes such as ``\x1b``, so that terminals ignore them."""
    return "".join(char if char.isprintable() else char.encode("unicode_escape").decode() for char in text)


def _as_line(message: str) -> str:
    return printable(" ".join(line.strip() for line in message.splitlines()))
