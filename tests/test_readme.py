"""The README is short, its Python and its commands run, and the API pages have all public names."""

import json
import re
from inspect import getdoc
from pathlib import Path

import pytest
from page_helpers import blocks, run_commands, run_python

import plr_jax

README = (Path(__file__).parent.parent / "README.md").read_text()
PYTHON = blocks(README, "python")
SHELL = [line for block in blocks(README, "sh") for line in block.splitlines()]
COMMANDS = [line for line in SHELL if "venv" not in line]
SLOW = "construct_pairs", "grid_distance", "solve_eikonal"
MAX_BYTES = 12_000


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Where all commands have run, in their order and in this process."""
    folder = tmp_path_factory.mktemp("readme")
    run_commands(COMMANDS, folder)
    return folder


def test_the_readme_is_short_and_has_code():
    assert len(README.encode()) <= MAX_BYTES
    assert len(PYTHON) == 9 and len(COMMANDS) == 6
    demo, tests = (line for line in SHELL if "venv" in line)
    assert demo.endswith("plr-jax demo") and tests.endswith("pytest")


def test_every_link_leads_to_a_file():
    targets = re.findall(r"\]\((?!http)([^)]+)\)", README)
    assert targets and all((Path(__file__).parent.parent / target).exists() for target in targets)


@pytest.mark.parametrize("blocks_run", ["quick", pytest.param("all", marks=pytest.mark.full)])
@pytest.mark.usefixtures("unchecked_types")
def test_python_blocks_run_one_after_the_other(blocks_run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = {}
    for code in PYTHON:
        if blocks_run == "all" or not any(word in code for word in SLOW):
            run_python(code, names)
    assert (tmp_path / "maze.plr").stat().st_size <= 1024 and names["descent"].reached.all()


def test_commands_write_what_they_say(folder):
    assert (folder / "maze.plr").stat().st_size <= 8192
    assert "maze_distance(" in (folder / "maze.h").read_text()
    assert "<title>maze" in (folder / "maze.html").read_text()
    assert json.loads((folder / "path.json").read_text())["status"] == "SOLVED"


def test_api_pages_tell_all_public_names(folder):
    modules = plr_jax, plr_jax.guides, plr_jax.metrics, plr_jax.pairs, plr_jax.plot, plr_jax.plr, plr_jax.scenes
    for module in modules:
        page = (folder / "site" / f"{module.__name__.replace('.', '/')}.html").read_text()
        for name in module.__all__:
            public = getattr(module, name)
            if type(public) is type(plr_jax):  # a page of its own
                assert f'href="{module.__name__.rpartition(".")[2]}/{name}.html"' in page
            elif name != "DistanceFn":
                begin = re.split("[:`'\"]", getdoc(public).splitlines()[0])[0].strip()
                section = page.split(f'<section id="{name}">')[1].split("</section>")[0]
                assert begin and begin in re.sub("<[^>]+>", "", section), name


def test_guides_link_to_the_api_and_classes_show_their_call(folder):
    for name in plr_jax.guides.__all__:
        page = (folder / "site" / "plr_jax" / "guides" / f"{name}.html").read_text()
        assert 'href="../../plr_jax.html#' in page or name == "command_line"
    page = (folder / "site" / "plr_jax.html").read_text()
    for name in (
        "PLR",
        "PairPLR",
        "GridPairs",
        "VisibilityGraph",
        "GridDistance",
        "NumpyPLR",
        "PLRStack",
        "HeuristicFn",
    ):
        assert f'id="{name}.__call__"' in page, name
