"""Any number of workers of any kind, some killed, and processes that are killed and resumed: the same bytes."""

import os
import random
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context

import pytest
from distributed import Client, LocalCluster

import plr_jax
from experiments._scale_work import FatalOnce, build, family
from plr_jax.plr import _construct_many

MAZE = plr_jax.scenes.maze().workspace
OPTIONS = {"leaf": "cone", "max_bytes": 200}
NUM_GOALS = 6
FORKS = get_context("forkserver")
FORKS.set_forkserver_preload(["experiments._scale_work"])


@pytest.fixture(scope="module")
def oracles():
    return family("maze", NUM_GOALS, 0)


@pytest.fixture(scope="module")
def expected(oracles):
    return files_of(plr_jax.construct_many(oracles, MAZE.bounds, **OPTIONS))


@pytest.fixture
def parts_of_one(monkeypatch):
    monkeypatch.setattr(_construct_many, "_MEMBERS_AT_ONCE", 1)


@pytest.fixture(scope="module")
def cluster():
    with LocalCluster(2, threads_per_worker=1, dashboard_address=None) as cluster, Client(cluster) as client:
        yield client


def files_of(plrs):
    return [plr.to_bytes() for plr in plrs]


def processes(count):
    return ProcessPoolExecutor(count, mp_context=FORKS)


@pytest.mark.usefixtures("parts_of_one")
@pytest.mark.parametrize("pool", [ThreadPoolExecutor, processes])
@pytest.mark.parametrize("count", [1, 2, 8])
def test_any_number_of_threads_or_processes_gives_the_same_bytes(oracles, expected, pool, count):
    with pool(count) as executor:
        assert files_of(plr_jax.construct_many(oracles, MAZE.bounds, executor=executor, **OPTIONS)) == expected


@pytest.mark.usefixtures("parts_of_one")
def test_a_cluster_gives_the_same_bytes(oracles, expected, cluster):
    plrs = plr_jax.construct_many(oracles, MAZE.bounds, executor=cluster.get_executor(), **OPTIONS)
    assert files_of(plrs) == expected


@pytest.mark.usefixtures("parts_of_one")
@pytest.mark.parametrize("kind", ["processes", "cluster"])
def test_a_killed_worker_changes_nothing(oracles, expected, kind, request, tmp_path):
    fatal = FatalOnce((0.4, 0.6), tmp_path / "killed", os.getpid())
    alone = plr_jax.construct(fatal, MAZE.bounds, **OPTIONS).to_bytes()
    some = [*oracles[:3], fatal, *oracles[3:]]
    if kind == "cluster":
        plrs = plr_jax.construct_many(
            some, MAZE.bounds, executor=request.getfixturevalue("cluster").get_executor(), **OPTIONS
        )
    else:
        with processes(2) as executor:
            plrs = plr_jax.construct_many(some, MAZE.bounds, executor=executor, **OPTIONS)
    assert (tmp_path / "killed").exists()
    assert files_of(plrs) == [*expected[:3], alone, *expected[3:]]


def test_killed_at_random_moments_and_resumed_the_file_is_the_same(tmp_path):
    work, files = ("maze", "cone", 130, 120, 0), [tmp_path / name for name in ("undisturbed", "killed")]
    build(*work, files[0])
    sizes, moments = [], random.Random(0)
    for _ in range(3):
        process = FORKS.Process(target=build, args=(*work, files[1]))
        process.start()
        enough = moments.uniform(0, 0.6) * files[0].stat().st_size
        while process.is_alive() and not (files[1].exists() and files[1].stat().st_size > enough):
            time.sleep(1e-3)
        process.kill()
        process.join()
        sizes.append(files[1].stat().st_size)
    assert min(sizes) < files[0].stat().st_size
    build(*work, files[1])
    assert files[1].read_bytes() == files[0].read_bytes()
