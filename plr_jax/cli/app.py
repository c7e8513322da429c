"""The command-line application, and the errors, warnings and exit codes that all commands share."""

import os
import re
import sys
import warnings
from collections.abc import Callable
from functools import cache
from typing import Annotated, Any, NoReturn

import typer
from typer.core import TyperCommand, TyperGroup

import plr_jax
from plr_jax.cli import BROKEN_PIPE_EXIT, INTERRUPTED_EXIT


class _Commands(TyperGroup):
    """The group of all subcommands, which prints each error or warning as one line, and equal warnings only once."""

    def invoke(self, ctx: Any) -> Any:
        warn_once = cache(warn)

        def show(message: Warning | str, category: type[Warning], *_: object, **__: object) -> None:
            if issubclass(category, plr_jax.ConstructionInterrupted):
                raise KeyboardInterrupt  # as Ctrl-C would: the command must not go on with an incomplete PLR
            warn_once(str(message))

        try:
            with warnings.catch_warnings():  # restores `showwarning` at the end
                warnings.showwarning = show
                return super().invoke(ctx)
        except KeyboardInterrupt:
            fail_interrupted("Interrupted.")
        except BrokenPipeError:  # the reader of a pipe, such as `head`, has ended
            # Send the rest of the output to the null device, or Python reports an error when it flushes.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            raise typer.Exit(BROKEN_PIPE_EXIT) from None
        except (OSError, ValueError) as error:
            fail(reason_of(error))


app = typer.Typer(
    cls=_Commands,
    name="plr-jax",
    help="Compress distance functions over maps into kilobytes, query them, and plan for several robots.",
    epilog="Start with: plr-jax demo",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _print_version(is_asked: bool) -> bool:
    if is_asked:
        typer.echo(f"plr-jax {plr_jax.__version__}")
        raise typer.Exit
    return is_asked  # Typer passes the result on as the option's value


_VERSION = typer.Option("--version", help="Print the version and exit.", callback=_print_version, is_eager=True)


@app.callback()
def _options(version: Annotated[bool, _VERSION] = False) -> None:
    pass


class _Command(TyperCommand):
    """A subcommand. The section "Args" of its function's docstring has the help of its arguments and options."""

    def __init__(self, *arguments: Any, help: str | None, params: list[Any], **options: Any):
        help, _, entries = (help or "").partition("\n\nArgs:\n")  # `python -OO` drops docstrings
        # An entry is "    name: text", and its next lines are indented by 8 spaces.
        texts = dict(re.findall(r"^ {4}(\w+): (.+(?:\n {8}.+)*)", entries, re.MULTILINE))
        for param in params:
            param.help = " ".join(texts.get(param.name, "").split())
        super().__init__(*arguments, help=help, params=params, **options)


def command(*examples: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Return a decorator that registers a function as a subcommand; ``examples`` of its use end the help text."""
    return app.command(cls=_Command, epilog="\n\n".join(["Examples:", *examples]))


def reason_of(error: OSError | ValueError) -> str:
    """Return an error's message; for an ``OSError``, the file name and the reason without the error number."""
    if not isinstance(error, OSError):
        return str(error)
    where = f"{error.filename}: " if error.filename else ""
    return f"{where}{error.strerror or error}"


def warn(message: str) -> None:
    """Print a warning as one line on standard error."""
    typer.echo("Warning: " + _as_line(message), err=True)


def fail(message: str, code: int = 2) -> NoReturn:
    """Print an error as one line on standard error, and end the command with an exit code."""
    typer.echo("Error: " + _as_line(message), err=True)
    raise typer.Exit(code)


def fail_interrupted(message: str) -> NoReturn:
    """Print a message as one line on standard error, and end the command with the exit code of Ctrl-C, 130."""
    typer.echo(_as_line(message), err=True)
    raise typer.Exit(INTERRUPTED_EXIT)


def printable(text: str) -> str:
    r"""Replace control characters in a text by escapes such as ``\x1b``, so that terminals do not act on them."""
    return "".join(char if char.isprintable() else char.encode("unicode_escape").decode() for char in text)


def _as_line(message: str) -> str:
    return printable(" ".join(line.strip() for line in message.splitlines()))
