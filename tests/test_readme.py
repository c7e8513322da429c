"""The README's Python runs, and so do its commands."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

README = (Path(__file__).parent.parent / "README.md").read_text()
PYTHON = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
COMMANDS = [
    line
    for block in re.findall(r"```sh\n(.*?)```", README, re.DOTALL)
    for line in block.splitlines()
    if "venv" not in line
]


def test_the_readme_has_code():
    assert len(PYTHON) == 4 and len(COMMANDS) == 5


@pytest.mark.parametrize("code", PYTHON, ids=["first", "own map", "several robots", "gradient"])
def test_python_blocks_run(code, tmp_path):
    subprocess.run([sys.executable, "-c", code], cwd=tmp_path, check=True, timeout=120)


def test_commands_run_in_order(tmp_path):
    program = f'"{Path(sys.executable).parent / "plr-jax"}"'
    for command in COMMANDS:
        subprocess.run(command.replace("plr-jax", program), shell=True, cwd=tmp_path, check=True, timeout=120)
    assert (tmp_path / "maze.plr").stat().st_size <= 2048
    assert (tmp_path / "maze.png").read_bytes().startswith(b"\x89PNG")
    assert json.loads((tmp_path / "path.json").read_text())["status"] == "SOLVED"
    assert (tmp_path / "four_rooms.gif").read_bytes().startswith(b"GIF89a")
