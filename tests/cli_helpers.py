"""Commands of the command line, run in this process."""

from typer.testing import CliRunner

from plr_jax.cli import load_app

_RUNNER, _APP = CliRunner(), load_app()


def run(*arguments, **kwargs):
    return _RUNNER.invoke(_APP, [str(argument) for argument in arguments], **kwargs)


def mistake(*arguments, **kwargs):
    """What a command says about a mistake; fails unless that is one line with exit code 2."""
    result = run(*arguments, **kwargs)
    assert result.exit_code == 2, result.output
    assert result.stdout == ""
    assert result.stderr.startswith("Error: ")
    assert result.stderr.count("\n") == 1
    return result.stderr


def built(leaf, folder):
    path = folder / f"{leaf}.plr"
    result = run("build", "maze", "-o", path, "--max-bytes", 300, "--leaf", leaf)
    assert result.exit_code == 0, result.output
    return path
