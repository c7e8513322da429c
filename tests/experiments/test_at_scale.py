"""What the section "At scale" says: its files and commands, with a worker that is killed half-way."""

import os
import re
import shlex
import signal
import socket
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
from distributed import Client

import plr_jax

README = (Path(__file__).parents[2] / "experiments" / "README.md").read_text().split("\n## At scale\n")[1]
FLEET, LOOP = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
SCHEDULER, WORKERS, WORK = re.findall(r"```sh\n(.*?)```", README, re.DOTALL)[0].splitlines()
NUM_GOALS, MAX_BYTES = 150, 120


def free_port():
    with socket.socket() as any_port:
        any_port.bind(("127.0.0.1", 0))
        return any_port.getsockname()[1]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Where the commands have run, and a worker was killed."""
    folder, port = tmp_path_factory.mktemp("scale"), str(free_port())
    fewer = FLEET.replace("1_000", str(NUM_GOALS)).replace("1_024", str(MAX_BYTES))
    assert fewer.count(str(NUM_GOALS)) == fewer.count(str(MAX_BYTES)) == 1
    (folder / "fleet.py").write_text(fewer)
    programs = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])

    def started(command):
        command = shlex.split(command.replace("8786", port).removesuffix("&"))
        process = subprocess.Popen(
            command,
            cwd=folder,
            env={**os.environ, "PATH": programs},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        stack.callback(process.wait)
        stack.callback(process.terminate)
        return process

    with ExitStack() as stack:
        started(SCHEDULER)
        started(WORKERS)
        client = stack.enter_context(Client(f"tcp://127.0.0.1:{port}", timeout=60))
        client.wait_for_workers(2, timeout=60)
        work = started(WORK)
        while not client.run_on_scheduler(lambda dask_scheduler: len(dask_scheduler.tasks)):
            assert work.poll() is None
            time.sleep(0.01)
        os.kill(next(iter(client.run(os.getpid).values())), signal.SIGKILL)
        assert not (folder / "0.plr").exists()
        assert work.wait(120) == 0
    return folder


def test_the_fleets_files_are_those_of_one_process(folder):
    workspace = plr_jax.scenes.maze().workspace
    first, *others = workspace.sample_free(NUM_GOALS, seed=0)
    oracle = plr_jax.VisibilityGraph(workspace, first)
    some = [oracle, *map(oracle.with_goal, others[:5])]
    plrs = plr_jax.construct_many(some, workspace.bounds, leaf="cone", max_bytes=MAX_BYTES)
    for number, plr in enumerate(plrs):
        assert (folder / f"{number}.plr").read_bytes() == plr.to_bytes()
    assert len(list(folder.glob("*.plr"))) == NUM_GOALS


def test_the_loop_answers_all_points(folder, monkeypatch):
    monkeypatch.chdir(folder)
    x = plr_jax.scenes.maze().workspace.sample_free(2_500, seed=1).astype(np.float32)
    x.tofile("points.f32")
    assert "2**22" in LOOP
    exec(compile(LOOP.replace("2**22", "1024"), "README.md", "exec"), {})
    np.testing.assert_array_equal(np.fromfile("distances.f32", np.float32), plr_jax.load("0.plr")(x))
