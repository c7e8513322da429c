"""The section "Many machines" of experiments/README.md, with a worker that is killed half-way."""

import re
import runpy
import signal
import sys
import time
from os import kill
from pathlib import Path
from threading import Thread

import numpy as np
import pytest
from distributed import LocalCluster

import plr_jax

pytestmark = pytest.mark.full

README = (Path(__file__).parents[2] / "experiments" / "README.md").read_text().split("\n## Many machines\n")[1]
FLEET, LOOP = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
WORKSPACE = plr_jax.scenes.maze().workspace
NUM_GOALS, MAX_BYTES = 30, 120


def killed_while_it_works(cluster):
    while not cluster.scheduler.tasks:
        time.sleep(0.01)
    kill(cluster.workers[0].pid, signal.SIGKILL)


def test_fleet_survives_a_killed_worker(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    fewer = FLEET.replace("1_000", str(NUM_GOALS)).replace("1_024", str(MAX_BYTES))
    assert fewer.count(str(NUM_GOALS)) == fewer.count(str(MAX_BYTES)) == 1
    Path("fleet.py").write_text(fewer)
    with LocalCluster(host="127.0.0.1", n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        monkeypatch.setattr(sys, "argv", ["fleet.py", cluster.scheduler_address])
        (thread := Thread(target=killed_while_it_works, args=[cluster])).start()
        runpy.run_path("fleet.py", run_name="__main__")
        thread.join()
    first, *others = WORKSPACE.sample_free(NUM_GOALS, seed=0)
    oracle = plr_jax.VisibilityGraph(WORKSPACE, first)
    some = [oracle, *map(oracle.with_goal, others[:5])]
    plrs = plr_jax.construct_many(some, WORKSPACE.bounds, leaf="cone", max_bytes=MAX_BYTES)
    for number, plr in enumerate(plrs):
        assert Path(f"{number}.plr").read_bytes() == plr.to_bytes()
    assert len(list(tmp_path.glob("*.plr"))) == NUM_GOALS

    x = WORKSPACE.sample_free(2_500, seed=1).astype(np.float32)
    x.tofile("points.f32")
    assert "2**22" in LOOP
    exec(compile(LOOP.replace("2**22", "1024"), "README.md", "exec"), {})
    np.testing.assert_array_equal(np.fromfile("distances.f32", np.float32), plrs[0](x))
