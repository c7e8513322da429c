"""The README is short, and its Python and its commands run."""

import json
import re
from pathlib import Path

import pytest
from page_helpers import blocks, run_page

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
