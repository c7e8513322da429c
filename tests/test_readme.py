"""The README's Python runs, and so do its commands."""

import io
import json
import re
import shlex
import sys
from pathlib import Path

import pytest

from plr_jax.cli import main

README = (Path(__file__).parent.parent / "README.md").read_text()
PYTHON = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
COMMANDS = [
    line
    for block in re.findall(r"```sh\n(.*?)```", README, re.DOTALL)
    for line in block.splitlines()
    if line and "venv" not in line
]


def test_the_readme_has_code():
    assert PYTHON and COMMANDS


@pytest.mark.parametrize("code", PYTHON, ids=range(len(PYTHON)))
def test_python_blocks_run(code, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    fewer_points = re.sub(r"(sample_free\()[\d_]+", r"\g<1>1_000", code)
    exec(compile(fewer_points, "README.md", "exec"), {"__name__": "__main__"})


def run_command(command, monkeypatch):
    """Run ``plr-jax ...``, or ``echo "..." | plr-jax ...``, as a shell would, but in this process."""
    echo, _, ours = command.rpartition("|")
    monkeypatch.setattr(sys, "stdin", io.StringIO("".join(shlex.split(echo)[1:]) + "\n"))
    monkeypatch.setattr(sys, "argv", shlex.split(ours))
    assert sys.argv[0] == "plr-jax"
    with pytest.raises(SystemExit) as ended:
        main()
    assert not ended.value.code, command


def test_commands_run_in_order(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for command in COMMANDS:
        run_command(command, monkeypatch)
        for flag in re.finditer(r"--(?:output|animation|picture) (\S+)", command):
            assert (tmp_path / flag[1]).stat().st_size > 0
    plans = [json.loads(path.read_text()) for path in tmp_path.glob("*.json")]
    assert all(plan["status"] == "SOLVED" for plan in plans)
