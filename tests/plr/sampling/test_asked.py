"""Distance functions that take long: whoever answers, and however often the process ends, the PLR is the same."""

from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import suppress
from multiprocessing import get_context

import numpy as np
import pytest

import plr_jax
from plr_jax.plr.sampling import asked

WORKSPACE = plr_jax.Workspace(((0, 0), (10, 6)), [[(3, 0), (4, 0), (4, 4), (3, 4)]])
HEADINGS = plr_jax.Box((-3, -3, -np.pi), (3, 3, np.pi), periodic=(False, False, True))


@pytest.fixture(scope="module")
def roadmap():
    return plr_jax.Roadmap.from_workspace(WORKSPACE, goal=[9, 1], num_samples=200)


class Counted:
    """A distance function that ends the process, in a manner of speaking, when it is asked once too often."""

    def __init__(self, distance_fn, most=10**9):
        self.distance_fn, self.most, self.count = distance_fn, most, 0

    def __call__(self, x):
        self.count += 1
        if self.count > self.most:
            raise RuntimeError("killed")
        return self.distance_fn(x)


@pytest.mark.parametrize("leaf", ["plane", "continuous", "cone"])
@pytest.mark.parametrize("count", [1, 3])
def test_any_number_of_workers_gives_the_same_bytes(roadmap, leaf, count, monkeypatch):
    monkeypatch.setattr(asked, "_AT_ONCE", 50)
    expected = plr_jax.construct(roadmap, WORKSPACE.bounds, leaf=leaf, max_leaves=20)
    with ThreadPoolExecutor(count) as executor:
        plr = plr_jax.construct(roadmap, WORKSPACE.bounds, leaf=leaf, max_leaves=20, executor=executor)
    assert plr.to_bytes() == expected.to_bytes()


def test_processes_give_the_same_bytes(roadmap):
    expected = plr_jax.construct(roadmap, WORKSPACE.bounds, max_leaves=20)
    with ProcessPoolExecutor(1, mp_context=get_context("forkserver")) as executor:
        plr = plr_jax.construct(roadmap, WORKSPACE.bounds, max_leaves=20, executor=executor)
    assert plr.to_bytes() == expected.to_bytes()


class Breaking(Executor):
    """It answers a few times, loses one answer, and then refuses."""

    def __init__(self):
        self.count = 0

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


def test_what_dead_workers_leave_is_asked_here(roadmap):
    expected = plr_jax.construct(roadmap, WORKSPACE.bounds, max_leaves=20)
    executor = Breaking()
    plr = plr_jax.construct(roadmap, WORKSPACE.bounds, max_leaves=20, executor=executor)
    assert executor.count > 4
    assert plr.to_bytes() == expected.to_bytes()


@pytest.mark.parametrize("leaf", ["plane", "cone"])
def test_whenever_it_ends_it_goes_on_where_it_was(roadmap, leaf, tmp_path):
    def build(distance_fn, name):
        options = {"leaf": leaf, "max_leaves": 20, "checkpoint": tmp_path / name}
        return plr_jax.construct(distance_fn, WORKSPACE.bounds, **options).to_bytes()

    whole = Counted(roadmap)
    expected = build(whole, "whole")
    runs = [Counted(roadmap, 3) for _ in range(whole.count)]  # that are asked once for what they are, and twice more
    for run in runs:
        with suppress(RuntimeError):
            plr = build(run, "parts")
            break
    assert plr == expected
    ended = runs.index(run)
    assert ended > 2 and 2 * ended + run.count - 1 == whole.count - 1
    assert (tmp_path / "parts").read_bytes() == (tmp_path / "whole").read_bytes()
    nothing = Counted(roadmap, 1)
    assert build(nothing, "whole") == expected


def test_folded_distances_are_kept_as_well(tmp_path):
    car = plr_jax.ReedsShepp(goal=(0, 0, 0), radius=1)
    options = {"leaf": "continuous", "max_leaves": 30}
    expected = plr_jax.construct(car, HEADINGS, **options)
    for _ in range(2):
        plr = plr_jax.construct(car, HEADINGS, checkpoint=tmp_path / "car", **options)
        assert plr.to_bytes() == expected.to_bytes()


@pytest.mark.usefixtures("unchecked_types")
def test_what_is_wrong_is_said(roadmap, tmp_path):
    plr_jax.construct(roadmap, WORKSPACE.bounds, max_leaves=2, checkpoint=tmp_path / "work")
    with pytest.raises(ValueError, match="work is the checkpoint of other work"):
        plr_jax.construct(plr_jax.Euclidean((9, 1)), WORKSPACE.bounds, checkpoint=tmp_path / "work")
    with pytest.raises(ValueError, match=r"executor must be a concurrent.futures.Executor or None, got 4"):
        plr_jax.construct(roadmap, WORKSPACE.bounds, executor=4)
