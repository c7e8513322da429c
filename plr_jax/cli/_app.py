"""The application, and what all its commands have in common: their errors and exit codes."""

import contextlib
import functools
import os
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
from plr_jax.cli._inputs import numbers_of

app = typer.Typer(
    name="plr-jax",
    help="Distance functions over maps, compressed into kilobytes of planes, and plans for several robots.",
    epilog="Start with: plr-jax demo",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _print_version(asked: bool) -> bool:
    if asked:
        typer.echo(f"plr-jax {plr_jax.__version__}")
        raise typer.Exit
    return asked


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version and exit.", callback=_print_version, is_eager=True)
    ] = False,
) -> None:
    """What stands before a command."""


def command(*examples: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Register a command that answers a user's mistake with a line and exit code 2, Ctrl-C with 130.

    Warnings are lines as well.
    """

    def register(function: Callable[..., None]) -> Callable[..., None]:
        @functools.wraps(function)
        def run(*args: object, **kwargs: object) -> None:
            try:
                with _warnings_as_lines():
                    function(*args, **kwargs)
            except KeyboardInterrupt:
                typer.echo("Interrupted.", err=True)
                raise typer.Exit(INTERRUPTED_EXIT) from None
            except BrokenPipeError:  # a reader such as `head` that has seen enough
                # Send what is still to be written nowhere, or Python would complain about it at its end.
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
    """What an error says; of the system, file and reason alone, which read better than "[Errno 2] ..."."""
    if not isinstance(error, OSError):
        return str(error)
    where = f"{error.filename}: " if error.filename else ""
    return f"{where}{error.strerror or error}"


class _Command(TyperCommand):
    """A command that says what is wrong with a goal of several arguments."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        for place, option in enumerate(args):
            given = [text.rstrip(",") for text in takewhile(_is_coordinate, args[place + 1 :])]
            if option in ("--goal", "-g") and len(given) > 1:
                raise typer.BadParameter(f"a goal is one argument X,Y: write {option} {','.join(given)}.", ctx)
        return super().parse_args(ctx, args)


def _is_coordinate(text: str) -> bool:
    return bool(numbers_of(text.rstrip(",")))


_LINE_ERASED = "\r\x1b[K"  # back to the beginning of the line, and all of it erased


@contextmanager
def saying(what: str) -> Iterator[None]:
    """Say on a terminal what is being done, until it is."""
    if not sys.stderr.isatty():
        yield
        return
    sys.stderr.write(f"{what} ...")
    sys.stderr.flush()
    try:
        yield
    finally:
        sys.stderr.write(_LINE_ERASED)
        sys.stderr.flush()


def warn(message: str) -> None:
    """Say one line on standard error, whatever the message, and go on."""
    if sys.stderr.isatty():
        sys.stderr.write(_LINE_ERASED)
    typer.echo("Warning: " + _as_line(message), err=True)


@contextmanager
def _warnings_as_lines() -> Iterator[None]:
    """Show warnings once each, without the line of code that they came from."""
    told: set[str] = set()

    def show(message: Warning | str, *_: object, **__: object) -> None:
        if (text := str(message)) not in told:
            told.add(text)
            warn(text)

    with warnings.catch_warnings():
        warnings.showwarning = show
        yield


def fail(message: str, code: int = 2) -> NoReturn:
    """End with one line on standard error, whatever the message."""
    typer.echo("Error: " + _as_line(message), err=True)
    raise typer.Exit(code)


def _as_line(message: str) -> str:
    return printable(" ".join(line.strip() for line in message.splitlines()))


def printable(text: str) -> str:
    r"""A text from outside, of which a terminal shows what it would else obey: control characters as ``\x1b``."""
    return "".join(char if char.isprintable() else char.encode("unicode_escape").decode() for char in text)
