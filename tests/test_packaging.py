"""The release: distributions that are complete, with metadata that package indexes accept."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

import plr_jax

ROOT = Path(__file__).parent.parent


@pytest.mark.full
def test_distributions_build_and_pass_twine(tmp_path):
    build = [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(tmp_path), str(ROOT)]
    subprocess.run(build, check=True, capture_output=True)
    names = sorted(path.name for path in tmp_path.iterdir())
    version = plr_jax.__version__
    assert names == [f"plr_jax-{version}-py3-none-any.whl", f"plr_jax-{version}.tar.gz"]
    check = [sys.executable, "-m", "twine", "check", "--strict", *(str(tmp_path / name) for name in names)]
    subprocess.run(check, check=True, capture_output=True)


def test_changelog_and_citation_have_the_version():
    releases = re.findall(r"^## (\d+\.\d+\.\d+)", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert releases[0] == plr_jax.__version__
    assert f"version: {plr_jax.__version__}\n" in (ROOT / "CITATION.cff").read_text()
