"""The release: distributions that are complete and work alone, with metadata that package indexes accept."""

import os
import re
import subprocess
import sys
import tarfile
from pathlib import Path

import pytest
from page_helpers import blocks

import plr_jax

ROOT = Path(__file__).parent.parent


@pytest.fixture(scope="module")
def distributions(tmp_path_factory) -> list[Path]:
    folder = tmp_path_factory.mktemp("distributions")
    build = [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(folder), str(ROOT)]
    subprocess.run(build, check=True, capture_output=True)
    return sorted(folder.iterdir())


@pytest.mark.full
def test_distributions_build_and_pass_twine(distributions):
    stem = f"plr_jax-{plr_jax.__version__}"
    assert [path.name for path in distributions] == [f"{stem}-py3-none-any.whl", f"{stem}.tar.gz"]
    check = [sys.executable, "-m", "twine", "check", "--strict", *distributions]
    subprocess.run(check, check=True, capture_output=True)
    with tarfile.open(distributions[1]) as archive:
        packed = {name.partition("/")[2] for name in archive.getnames()}
    assert packed >= {path.name for path in ROOT.glob("[A-Z]*.*")} | {"LICENSE", "plr_jax/py.typed"}


@pytest.mark.full
def test_wheel_works_in_an_empty_environment(distributions, tmp_path):
    """The README's first example and the demo run where only the wheel was installed: 50 CPU seconds."""
    scripts = tmp_path / "venv" / "bin"
    environment = {**os.environ, "PATH": f"{scripts}:{os.environ['PATH']}", "PYTHONPATH": ""}
    wheel, _ = distributions
    example = blocks((ROOT / "README.md").read_text(), "python")[0]
    for command in (
        [sys.executable, "-m", "venv", tmp_path / "venv"],
        [scripts / "pip", "install", "--quiet", wheel],
        [scripts / "python", "-c", f"{example}\nassert {str(tmp_path)!r} in plr_jax.__file__"],
        [scripts / "plr-jax", "demo", "--output", "demo"],
    ):
        subprocess.run(command, check=True, capture_output=True, cwd=tmp_path, env=environment)
    assert (tmp_path / "maze.plr").stat().st_size <= 1024
    sizes = {path.name: path.stat().st_size for path in (tmp_path / "demo").iterdir()}
    assert sizes.keys() >= {"maze.plr", "four_rooms.html", "four_rooms.gif"} and all(sizes.values())


def test_changelog_and_citation_have_the_version():
    releases = re.findall(r"^## (\d+\.\d+\.\d+)", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert releases[0] == plr_jax.__version__
    assert f"version: {plr_jax.__version__}\n" in (ROOT / "CITATION.cff").read_text()
