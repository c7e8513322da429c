"""Many cores: whether the files of a fleet's goals depend on who builds them, or on killed workers.

A row of the table is one ``construct_many`` of the same oracles by workers of a kind, and whether all files are those
of one thread. A worker of the last rows, whose leaves are planes, is killed half-way. Seconds are with the start of
the workers, on two shared cores: they say nothing of what more cores gain.
"""

import os
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from hashlib import sha256
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from experiments._runner import Section, run
from experiments._scale_work import FatalOnce, family, files_of

SCENE = "maze"
GOALS = 150, 200
"""Number of goals, and bytes of each file."""

Rows = list[dict[str, Any]]


def goals(seed: int, smoke: bool) -> dict[str, Any]:
    num_goals, max_bytes = (70, 100) if smoke else GOALS
    oracles, half = family(SCENE, num_goals, seed), num_goals // 2
    how = {"scene": SCENE, "leaf": "cone", "max_bytes": max_bytes}
    rows = _workers(partial(files_of, oracles, **how), (2,) if smoke else (1, 2, 8))
    # Of the distance that kills its process nothing is known of cells, so that there are no cones of it.
    how |= {"leaf": "plane"}
    alone = files_of(oracles, **how)
    with tempfile.TemporaryDirectory() as folder:
        for kind, pool in (("processes", _processes), ("Dask", _cluster)):
            fatal = FatalOnce((0.4, 0.6), Path(folder, kind), os.getpid())
            begun = time.perf_counter()
            with pool(2) as executor:
                files = files_of([*oracles[:half], fatal, *oracles[half:]], **how, executor=executor)
            assert fatal.marker.exists()
            rows.append(_row(f"{kind}, one killed", 2, begun, files[:half] + files[half + 1 :], alone))
    return {"goals": num_goals, "bytes": max_bytes, "workers": rows}


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


def _processes(count: int) -> ProcessPoolExecutor:
    context = get_context("forkserver")
    context.set_forkserver_preload(["experiments._scale_work"])  # processes begin with all modules
    return ProcessPoolExecutor(count, mp_context=context)


@contextmanager
def _cluster(count: int) -> Iterator[Executor]:
    from distributed import Client, LocalCluster

    cluster = LocalCluster(count, threads_per_worker=1, dashboard_address=None)  # type: ignore[reportArgumentType]
    with cluster, Client(cluster) as client:
        yield client.get_executor()


SECTIONS = {"goals": Section(goals)}

if __name__ == "__main__":
    run("scale", "Whoever builds for a fleet, also if a worker is killed: the same bytes.", SECTIONS)
