"""Many cores and machines: whoever builds the PLRs of a fleet's goals, and however often they are killed.

A row of the table is one ``construct_many`` of the same oracles by workers of a kind, and whether all files are those
of one thread. A worker of the last rows, whose leaves are planes, is killed half-way. Then processes build with a
checkpoint, are killed at random moments, and others go on: is the checkpoint, which holds all files, that of a
process that was left alone?
Seconds are with the start of the workers, on two shared cores: they say nothing of what more cores gain.
"""

import os
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache, partial
from hashlib import sha256
from multiprocessing import get_context
from multiprocessing.context import ForkServerContext
from pathlib import Path
from typing import Any

import numpy as np

from experiments._runner import Section, run
from experiments._scale_work import FatalOnce, build, family, files_of

SCENE, NUM_KILLS = "maze", 20
CONES, PLANES = ("cone", 150, 200), ("plane", 60, 512)
"""Leaves, goals, and bytes of each file: parts of several goals are for workers, of one for kills."""
_EARLIEST = 0.05  # of the time that a process takes

Rows = list[dict[str, Any]]


def goals(seed: int, smoke: bool) -> dict[str, Any]:
    cones, planes = (("cone", 70, 100), ("plane", 3, 100)) if smoke else (CONES, PLANES)
    scene, (leaf, num_goals, max_bytes) = SCENE, cones
    oracles, half = family(scene, num_goals, seed), num_goals // 2
    how = {"scene": scene, "leaf": leaf, "max_bytes": max_bytes}
    rows = _workers(partial(files_of, oracles, **how), (2,) if smoke else (1, 2, 8))
    # Of the distance that kills its process nothing is known of cells, so that there are no cones of it.
    how |= {"leaf": planes[0]}
    alone = files_of(oracles, **how)
    with tempfile.TemporaryDirectory() as folder:
        for kind, pool in (("processes", _processes), ("Dask", _cluster)):
            fatal = FatalOnce((0.4, 0.6), Path(folder, kind), os.getpid())
            begun = time.perf_counter()
            with pool(2) as executor:
                files = files_of([*oracles[:half], fatal, *oracles[half:]], **how, executor=executor)
            assert fatal.marker.exists()
            rows.append(_row(f"{kind}, one killed", 2, begun, files[:half] + files[half + 1 :], alone))
    kills = _kills(partial(build, scene, *planes, seed), 2 if smoke else NUM_KILLS, seed)
    return {"cones": cones[1:], "planes": planes[1:], "workers": rows, "kills": kills}


def _workers(made: Callable[..., list[bytes]], counts: tuple[int, ...]) -> Rows:
    """Every kind of workers, so many of them."""
    rows, expected = [], None
    for kind, pool in (("threads", ThreadPoolExecutor), ("processes", _processes), ("Dask", _cluster)):
        for count in counts:
            begun = time.perf_counter()
            with pool(count) as executor:
                files = made(executor=executor)
            expected = expected or files
            rows.append(_row(kind, count, begun, files, expected))
    return rows


def _row(kind: str, count: int, begun: float, files: list[bytes], expected: list[bytes]) -> dict[str, Any]:
    seconds, digest = time.perf_counter() - begun, sha256(b"".join(files)).hexdigest()
    return {"kind": kind, "workers": count, "seconds": seconds, "digest": digest, "same": files == expected}


@cache
def _forks() -> ForkServerContext:
    """Processes that begin with all modules."""
    context = get_context("forkserver")
    context.set_forkserver_preload(["experiments._scale_work"])
    return context


def _processes(count: int) -> ProcessPoolExecutor:
    return ProcessPoolExecutor(count, mp_context=_forks())


@contextmanager
def _cluster(count: int) -> Iterator[Executor]:
    from distributed import Client, LocalCluster

    cluster = LocalCluster(count, threads_per_worker=1, dashboard_address=None)  # type: ignore[reportArgumentType]
    with cluster, Client(cluster) as client:
        yield client.get_executor()


def _kills(made: Callable[..., Any], count: int, seed: int) -> Rows:
    """Processes that are killed at moments drawn from the time that one takes, each resumed by another."""
    with tempfile.TemporaryDirectory() as folder:
        begun = time.perf_counter()
        expected, _ = _process(made, Path(folder, "alone"), np.inf)
        whole, rows, moments = time.perf_counter() - begun, [], np.random.default_rng(seed)
        for number in range(count):
            path, moment = Path(folder, f"killed {number}"), moments.uniform(_EARLIEST, 1) * whole
            at_kill, was_killed = _process(made, path, moment)
            resumed, _ = _process(made, path, np.inf)
            share = len(at_kill) / len(expected)
            rows.append({"moment": moment, "killed": was_killed, "share": share, "same": resumed == expected})
    return rows


def _process(made: Callable[..., Any], path: Path, seconds: float) -> tuple[bytes, bool]:
    """The checkpoint after a process that is killed after so many seconds, and whether that was before its end."""
    process = _forks().Process(target=made, kwargs={"checkpoint": path})
    process.start()
    process.join(None if seconds == np.inf else seconds)
    process.kill()
    process.join()
    return (path.read_bytes() if path.exists() else b""), process.exitcode != 0


SECTIONS = {"goals": Section(goals)}

if __name__ == "__main__":
    run("scale", "Whoever builds for a fleet, however often killed: the same bytes.", SECTIONS)
