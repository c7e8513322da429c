"""The README is short, its Python and its commands run, and the API pages have all public names."""

import io
import json
import re
import shlex
import sys
from inspect import getdoc
from pathlib import Path

import pdoc.__main__
import pytest

import plr_jax
from plr_jax.cli import main

README = (Path(__file__).parent.parent / "README.md").read_text()
PYTHON = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
SHELL = [line for block in re.findall(r"```sh\n(.*?)```", README, re.DOTALL) for line in block.splitlines()]
COMMANDS = [line for line in SHELL if "venv" not in line]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Where all commands have run, in their order and in this process: ``[echo "..." |] PROGRAM ...``."""
    folder = tmp_path_factory.mktemp("readme")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for command in COMMANDS:
            echo, _, program = command.rpartition("|")
            patch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(f"{''.join(shlex.split(echo)[1:])}\n".encode())))
            patch.setattr(sys, "argv", shlex.split(program))
            if sys.argv[0] == "pdoc":
                pdoc.__main__.cli()
                continue
            assert sys.argv[0] == "plr-jax"
            with pytest.raises(SystemExit) as end:
                main()
            assert not end.value.code, command
    return folder


def test_the_readme_is_short_and_has_code():
    assert len(README.encode()) <= 8_000
    assert len(PYTHON) == 5 and len(COMMANDS) == 6
    demo, tests = (line for line in SHELL if "venv" in line)
    assert demo.endswith("plr-jax demo") and tests.endswith("pytest")


@pytest.mark.parametrize(
    "code",
    [pytest.param(code, marks=pytest.mark.full if "construct_pairs" in code else ()) for code in PYTHON],
    ids=["first", "own map", "every goal", "several robots", "gradient"],
)
@pytest.mark.usefixtures("unchecked_types")
def test_python_blocks_run(code, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    fewer_points = re.sub(r"(sample_free\()[\d_]+", r"\g<1>16", code)
    exec(compile(fewer_points, "README.md", "exec"), {})


def test_commands_write_what_they_say(folder):
    assert (folder / "maze.plr").stat().st_size <= 8192
    assert "maze_distance(" in (folder / "maze.h").read_text()
    assert "<title>maze" in (folder / "maze.html").read_text()
    assert json.loads((folder / "path.json").read_text())["status"] == "SOLVED"


def test_api_pages_tell_all_public_names(folder):
    for module in (plr_jax, plr_jax.metrics, plr_jax.pairs, plr_jax.plot, plr_jax.plr, plr_jax.scenes):
        page = (folder / "site" / f"{module.__name__.replace('.', '/')}.html").read_text()
        for name in module.__all__:
            public = getattr(module, name)
            if type(public) is type(plr_jax):  # a page of its own
                assert f'href="plr_jax/{name}.html"' in page
            elif name != "DistanceFn":
                begin = re.split("[:`'\"]", getdoc(public).splitlines()[0])[0].strip()
                section = page.split(f'<section id="{name}">')[1].split("</section>")[0]
                assert begin and begin in re.sub("<[^>]+>", "", section), name
