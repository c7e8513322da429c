"""Every public name is in a guide, and the examples of every guide run."""

import inspect
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from page_helpers import SLOW, SMALLER, blocks, run_page

import plr_jax
from plr_jax import guides

PUBLIC_MODULES = [plr_jax, *filter(inspect.ismodule, (getattr(plr_jax, name) for name in plr_jax.__all__))]
PAGES = {name: getattr(guides, name).__doc__ for name in guides.__all__}
README = (Path(__file__).parent.parent / "README.md").read_text()
MAX_LINES = 120
IS_SLOW = {name: any(text in page for text in (*SLOW, *SMALLER)) for name, page in PAGES.items()}
RUNS = [(name, True) for name in PAGES]
RUNS += [pytest.param(name, False, marks=pytest.mark.full) for name in PAGES if IS_SLOW[name]]


def test_every_public_name_is_in_a_guide():
    text = "\n".join(PAGES.values())
    assert {f"plr_jax.{n}" for n in plr_jax.__all__ if n != "guides"} <= set(re.findall(r"plr_jax\.\w+", text))
    named = set(re.findall(r"\w+", text + guides.__doc__))
    examples = (plr_jax.plot, plr_jax.scenes)  # one of their names stands for many
    ours = [module for module in PUBLIC_MODULES if module not in examples]
    assert not [f"{module.__name__}.{name}" for module in ours for name in module.__all__ if name not in named]


def test_index_and_readme_name_all_pages():
    for name, page in PAGES.items():
        assert len(page.splitlines()) <= MAX_LINES and blocks(page, "(?:python|sh)"), name
        assert f"`plr_jax.guides.{name}`" in guides.__doc__ and f"guides/{name}.py" in README
    assert {path.stem for path in Path(guides.__file__).parent.glob("[!_]*.py")} == PAGES.keys()


def test_every_name_in_a_guide_exists():
    for page in [guides.__doc__, *PAGES.values()]:
        for dotted in re.findall(r"\bplr_jax((?:\.[A-Za-z]\w*)+)", page):
            found = plr_jax
            for name in dotted[1:].split("."):
                found = getattr(found, name)


def test_index_lists_every_callable_class():
    public = {name: getattr(module, name) for module in PUBLIC_MODULES for name in module.__all__}
    classes = {name: value for name, value in public.items() if inspect.isclass(value)}
    called = {name for name, each in classes.items() if any("__call__" in vars(base) for base in each.__mro__)}
    rows = re.findall(r"^\| (`plr_jax.*?) \|", guides.__doc__, re.MULTILINE)
    assert called == set(re.findall(r"plr_jax\.(?:\w+\.)?(\w+)`", "".join(rows)))


def test_slow_statements_are_on_a_page():
    text = "\n".join([README, *PAGES.values()])
    assert [slow for slow in (*SLOW, *SMALLER) if slow not in text] == []


@pytest.mark.parametrize(("name", "is_quick"), RUNS)
@pytest.mark.usefixtures("unchecked_types")
def test_guide_examples_run_from_top_to_bottom(name, is_quick, tmp_path):
    run_page(PAGES[name], tmp_path, is_quick)
    for code in blocks(PAGES[name], "c"):
        (tmp_path / "main.c").write_text(code)
        if shutil.which("cc"):
            (command,) = re.findall("^cc .*", PAGES[name], re.MULTILINE)
            subprocess.run([*command.split(), "-o", "main"], cwd=tmp_path, check=True)
            answer = subprocess.run(["./main"], cwd=tmp_path, check=True, capture_output=True, text=True).stdout
            assert answer.splitlines()[0] == "2.045286, by way of (0.790000, 0.830000)"
    for code in blocks(PAGES[name], "js"):
        (tmp_path / "main.mjs").write_text(code)
        if shutil.which("node"):
            subprocess.run(["node", "main.mjs"], cwd=tmp_path, check=True, capture_output=True)
