"""The README is short, its Python and its commands run, and the API pages have all public names."""

import json
import re
import sys
from inspect import getdoc
from pathlib import Path

import pytest
from page_helpers import blocks, run_page

import plr_jax

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text()
MAX_BYTES = 12_000


def test_readme_is_short_and_its_links_exist():
    assert len(README.encode()) <= MAX_BYTES
    assert len(blocks(README, "python")) == 11
    demo, tests = re.findall("^python3 -m venv .*", README, re.MULTILINE)
    assert demo.endswith("plr-jax demo") and tests.endswith("pytest")
    targets = re.findall(r"\]\((?!http)([^)]+)\)", README)
    assert targets and all((ROOT / target).exists() for target in targets)


@pytest.mark.parametrize("is_quick", [True, pytest.param(False, marks=pytest.mark.full)])
@pytest.mark.usefixtures("unchecked_types")
def test_readme_snippets_run(is_quick, tmp_path):
    names = run_page(README, tmp_path, is_quick)
    assert names["plr"].num_bytes <= (512 if is_quick else 1024) and names["descent"].reached.all()
    assert (tmp_path / "maze.plr").stat().st_size <= (512 if is_quick else 8192)
    assert "maze_distance(" in (tmp_path / "maze.h").read_text()
    assert "<title>maze" in (tmp_path / "maze.html").read_text()
    assert json.loads((tmp_path / "path.json").read_text())["status"] == "SOLVED"


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Run the README's command for API pages, which takes some seconds, in this process."""
    import pdoc.__main__

    folder = tmp_path_factory.mktemp("readme")
    (command,) = (line for block in blocks(README, "sh") for line in block.splitlines() if line.startswith("pdoc "))
    templates = str(ROOT / ".pdoc")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr(sys, "argv", [templates if word == ".pdoc" else word for word in command.split()])
        pdoc.__main__.cli()
    return folder / "site"


@pytest.mark.full
def test_api_pages_show_all_public_names(site):
    modules = plr_jax, plr_jax.guides, plr_jax.metrics, plr_jax.pairs, plr_jax.plot, plr_jax.plr, plr_jax.scenes
    for module in modules:
        page = (site / f"{module.__name__.replace('.', '/')}.html").read_text()
        for name in module.__all__:
            public = getattr(module, name)
            if type(public) is type(plr_jax):  # a page of its own
                assert f'href="{module.__name__.rpartition(".")[2]}/{name}.html"' in page
            elif name != "DistanceFn":
                begin = re.split("[:`'\"]", getdoc(public).splitlines()[0])[0].strip()
                section = page.split(f'<section id="{name}">')[1].split("</section>")[0]
                assert begin and begin in re.sub("<[^>]+>", "", section), name
    for name in plr_jax.guides.__all__:
        page = (site / "plr_jax" / "guides" / f"{name}.html").read_text()
        assert 'href="../../plr_jax.html#' in page or name == "command_line"
    page = (site / "plr_jax.html").read_text()
    for name in ("PLR", "PairPLR", "VisibilityGraph", "GridDistance", "HeuristicFn"):
        assert f'id="{name}.__call__"' in page, name
