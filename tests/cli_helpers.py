"""Run commands of the command line in this process."""

import warnings

from typer.testing import CliRunner

from plr_jax.cli import load_app

_RUNNER, _APP = CliRunner(), load_app()


def run(*arguments, **kwargs):
    """Run a command with Python's own filters of warnings: tests make errors of warnings, which commands print."""
    with warnings.catch_warnings():
        warnings.simplefilter("default")
        warnings.simplefilter("ignore", DeprecationWarning)
        warnings.simplefilter("ignore", PendingDeprecationWarning)
        return _RUNNER.invoke(_APP, [str(argument) for argument in arguments], **kwargs)


def done(*arguments, **kwargs):
    """Return the output of a command that must succeed without a warning."""
    result = run(*arguments, **kwargs)
    assert (result.exit_code, result.stderr) == (0, ""), result.output
    return result.stdout


def mistake(*arguments, **kwargs):
    """Return the error of a command, which must be one line with exit code 2."""
    result = run(*arguments, **kwargs)
    assert result.exit_code == 2, result.output
    assert result.stdout == ""
    assert result.stderr.startswith("Error: ")
    assert result.stderr.count("\n") == 1
    return result.stderr
