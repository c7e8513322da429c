"""Distance functions that take long: whoever answers, and however often the process ends, the PLR is the same."""

from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import suppress
from multiprocessing import get_context

import numpy as np
import pytest

import plr_jax
from plr_jax.plr import work as asked

WORKSPACE = plr_jax.Workspace(((0, 0), (10, 6)), [[(3, 0), (4, 0), (4, 4), (3, 4)]])
HEADINGS = plr_jax.Box((-3, -3, -np.pi), (3, 3, np.pi), periodic=(False, False, True))


@pytest.fixture(scope="module")
def roadmap():
    return plr_jax.Roadmap.from_workspace(WORKSPACE, goal=[9, 1], num_samples=100)


def build(distance_fn, **options):
    options = plr_jax.BuildOptions(**options)
    return plr_jax.construct(distance_fn, WORKSPACE.bounds, max_leaves=12, options=options).to_bytes()


class Counted:
    """A distance function that ends the process, in a manner of speaking, when it is asked once too often."""

    def __init__(self, distance_fn, most=10**9):
        self.distance_fn, self.most, self.count = distance_fn, most, 0

    def __call__(self, x):
        self.count += 1
        if self.count > self.most:
            raise RuntimeError("killed")
        return self.distance_fn(x)


class Breaking(Executor):
    """It answers a few times, loses one answer, and then refuses."""

    count = 0

    def submit(self, fn, /, *args, **kwargs):
        self.count += 1
        future = Future()
        if self.count == 4:
            future.set_exception(BrokenExecutor("a worker died"))
        elif self.count > 4:
            raise BrokenExecutor("a worker has died")
        else:
            future.set_result(fn(*args, **kwargs))
        return future


def test_workers_give_the_same_bytes_and_what_dead_ones_leave_is_asked_here(roadmap, monkeypatch):
    monkeypatch.setattr(asked, "_AT_ONCE", 50)
    expected, breaking = build(roadmap), Breaking()
    with ThreadPoolExecutor(3) as executor:
        assert build(roadmap, executor=executor) == expected
    assert build(roadmap, executor=breaking) == expected
    assert breaking.count > 4
    with ProcessPoolExecutor(1, mp_context=get_context("forkserver")) as executor:
        assert build(roadmap, executor=executor) == expected


def test_whenever_it_ends_it_goes_on_where_it_was(roadmap, tmp_path):
    whole = Counted(roadmap)
    expected = build(whole, checkpoint=tmp_path / "whole")
    runs = [Counted(roadmap, 3) for _ in range(whole.count)]  # that are asked once for what they are, and twice more
    for run in runs:
        with suppress(RuntimeError):
            plr = build(run, checkpoint=tmp_path / "parts")
            break
    assert plr == expected
    ended = runs.index(run)
    assert ended > 2 and 2 * ended + run.count - 1 == whole.count - 1
    assert (tmp_path / "parts").read_bytes() == (tmp_path / "whole").read_bytes()
    assert build(Counted(roadmap, 1), checkpoint=tmp_path / "whole") == expected


def test_folded_distances_are_kept_as_well(tmp_path):
    car = plr_jax.ReedsShepp(goal=(0, 0, 0), radius=1)
    files = {
        plr_jax.construct(
            car, HEADINGS, leaf="continuous", max_leaves=30, options=plr_jax.BuildOptions(checkpoint=path)
        ).to_bytes()
        for path in (None, tmp_path / "car", tmp_path / "car")
    }
    assert len(files) == 1


@pytest.mark.usefixtures("unchecked_types")
def test_what_is_wrong_is_said(roadmap, tmp_path):
    build(roadmap, checkpoint=tmp_path / "work")
    with pytest.raises(ValueError, match="work is the checkpoint of other work"):
        build(plr_jax.Euclidean((9, 1)), checkpoint=tmp_path / "work")
    with pytest.raises(ValueError, match=r"executor must be a concurrent.futures.Executor or None, got 4"):
        build(roadmap, executor=4)
