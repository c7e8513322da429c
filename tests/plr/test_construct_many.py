"""Many PLRs at once: as good as those that are built alone, and the same whoever builds them."""

import warnings
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context

import numpy as np
import pytest

import plr_jax
from plr_jax.plr import _construct_many
from plr_jax.plr.partition.cells import levels_of

MAZE = plr_jax.scenes.maze().workspace
NUM_GOALS = 7


@pytest.fixture(scope="module")
def oracles():
    first = plr_jax.VisibilityGraph(MAZE, (0.06, 0.07))
    return [first, *(first.with_goal(goal) for goal in MAZE.sample_free(NUM_GOALS - 1, seed=4))]


@pytest.fixture(scope="module")
def family(oracles):
    return plr_jax.construct_many(oracles, MAZE.bounds, leaf="cone", max_bytes=300)


def errors_of(plr, oracle, x):
    return np.abs(np.asarray(plr(x), np.float64) - oracle(x))


def test_members_are_about_as_good_as_alone_and_fill_the_budget(oracles, family):
    x, alone, together = MAZE.sample_free(4000, seed=1), [], []
    for plr, oracle in zip(family, oracles, strict=True):
        assert 0.95 * 300 <= plr.num_bytes <= 300
        together.append(errors_of(plr, oracle, x).mean())
        alone.append(errors_of(plr_jax.construct(oracle, MAZE.bounds, leaf="cone", max_bytes=300), oracle, x).mean())
    assert np.mean(together) < 1.3 * np.mean(alone)
    assert np.max(together) < 2 * np.max(alone)


def test_a_members_sources_are_those_of_its_own_goal(oracles, family):
    for plr, oracle in zip(family, oracles, strict=True):
        stored = plr.stored.sources
        for point, offset in zip(stored.points, stored.offsets, strict=True):
            to_source = np.linalg.norm(oracle.sources.points - point, axis=1)
            assert to_source.min() < 1e-6
            np.testing.assert_allclose(offset, oracle.sources.distances[to_source.argmin()], atol=1e-6)


def test_a_members_tree_is_a_partition_and_its_file_is_read_back(family):
    for plr in family:
        again = plr_jax.from_bytes(plr.to_bytes())
        x = MAZE.sample_free(500, seed=2)
        np.testing.assert_array_equal(np.asarray(plr(x)), np.asarray(again(x)))
        volume = np.ldexp(1.0, -plr.cells.depth.sum(axis=1))
        assert volume.sum() == 1
        assert len(levels_of(plr.cells)[1]) == plr.num_leaves


@pytest.mark.parametrize("at_once", [1, 3])
def test_bytes_do_not_depend_on_who_is_built_together(oracles, family, monkeypatch, at_once):
    monkeypatch.setattr(_construct_many, "_MEMBERS_AT_ONCE", at_once)
    with ThreadPoolExecutor(3) as threads:
        others = plr_jax.construct_many(oracles[::-1], MAZE.bounds, leaf="cone", max_bytes=300, executor=threads)
    assert [plr.to_bytes() for plr in others[::-1]] == [plr.to_bytes() for plr in family]


def test_processes_give_the_same_bytes(oracles, family):
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as processes:
        others = plr_jax.construct_many(oracles, MAZE.bounds, leaf="cone", max_bytes=300, executor=processes)
    assert [plr.to_bytes() for plr in others] == [plr.to_bytes() for plr in family]


def test_the_limits_hold(oracles):
    x = MAZE.sample_free(3000, seed=1)
    for plr in plr_jax.construct_many(oracles[:3], MAZE.bounds, leaf="cone", max_leaves=90):
        assert 80 <= plr.num_leaves <= 90
    for plr in plr_jax.construct_many(oracles[:3], MAZE.bounds, leaf="cone", max_bytes=400, max_depth=7):
        assert plr.depth <= 7
    few = plr_jax.construct_many(oracles[:3], MAZE.bounds, leaf="cone", max_bytes=4000, tolerance=0.05)
    for plr, oracle in zip(few, oracles, strict=False):
        assert plr.num_bytes < 400
        assert errors_of(plr, oracle, x).max() < 0.051


@pytest.mark.parametrize("max_leaves", [1, 2, 5])
def test_a_few_leaves(oracles, max_leaves):
    (plr,) = plr_jax.construct_many(oracles[:1], MAZE.bounds, leaf="cone", max_leaves=max_leaves)
    assert 1 <= plr.num_leaves <= max_leaves
    assert np.isfinite(np.asarray(plr(MAZE.sample_free(50, seed=0)))).all()


def test_certified_bounds_hold_the_distance(oracles):
    x = MAZE.sample_free(3000, seed=6)
    plrs = plr_jax.construct_many(
        oracles[:2], MAZE.bounds, leaf="cone", max_bytes=400, certified=True, leaf_bounds=True
    )
    for plr, oracle in zip(plrs, oracles, strict=False):
        alone = plr_jax.construct(oracle, MAZE.bounds, leaf="cone", max_bytes=400, certified=True, leaf_bounds=True)
        lower, upper = plr.bounds(x)
        distance = oracle(x)
        assert (np.asarray(lower) <= distance).all()
        assert (distance <= np.asarray(upper)).all()
        assert plr.num_bytes <= 400
        assert errors_of(plr, oracle, x).max() <= plr.max_error < 1.5 * alone.max_error


def test_goals_of_two_workspaces_and_other_functions_in_one_list(oracles, family):
    rooms = plr_jax.scenes.four_rooms(2).workspace
    other = plr_jax.VisibilityGraph(rooms, (1.37, 5.23))
    euclidean = plr_jax.Euclidean((0.2, 0.3))
    several = [oracles[1], euclidean, oracles[2]]
    plrs = plr_jax.construct_many(several, MAZE.bounds, leaf="cone", max_bytes=300)
    assert [plrs[i].to_bytes() for i in (0, 2)] == [plr.to_bytes() for plr in family[1:3]]
    alone = plr_jax.construct(euclidean, MAZE.bounds, leaf="cone", max_bytes=300)
    assert plrs[1].to_bytes() == alone.to_bytes()
    mixed = plr_jax.construct_many([other, oracles[0]], rooms.bounds, leaf="cone", max_bytes=300)
    x = rooms.sample_free(2000, seed=0)
    assert errors_of(mixed[0], other, x).mean() < 0.02


def test_planes_are_those_of_construct(oracles):
    plrs = plr_jax.construct_many(oracles[:2], MAZE.bounds, max_leaves=30, seed=3)
    for plr, oracle in zip(plrs, oracles, strict=False):
        assert plr.to_bytes() == plr_jax.construct(oracle, MAZE.bounds, max_leaves=30, seed=3).to_bytes()


def test_paths_of_members_arrive(oracles, family):
    starts = MAZE.sample_free(200, seed=3)
    for plr, oracle in zip(family, oracles, strict=True):
        traces = plr_jax.trace(plr, starts)
        assert (np.asarray(traces.status) == plr_jax.TraceStatus.ARRIVED).mean() > 0.99
        for start, path in zip(starts[:20], traces.paths, strict=False):
            length = np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
            assert length >= oracle(start[None])[0] - 1e-6


class Failing(Executor):
    """One of its parts, by number, fails with some error."""

    def __init__(self, number: int, error: BaseException):
        self.left, self.error = number, error

    def submit(self, fn, /, *args, **kwargs):
        future: Future = Future()
        self.left -= 1
        if self.left == -1:
            future.set_exception(self.error)
        else:
            future.set_result(fn(*args, **kwargs))
        return future


def test_what_a_dead_worker_had_is_built_again(oracles, family, monkeypatch):
    monkeypatch.setattr(_construct_many, "_MEMBERS_AT_ONCE", 4)
    dying = Failing(0, BrokenExecutor("a worker died"))
    plrs = plr_jax.construct_many(oracles, MAZE.bounds, leaf="cone", max_bytes=300, executor=dying)
    assert [plr.to_bytes() for plr in plrs] == [plr.to_bytes() for plr in family]


def test_what_is_done_before_an_interrupt_is_kept(oracles, family, monkeypatch):
    monkeypatch.setattr(_construct_many, "_MEMBERS_AT_ONCE", 4)
    with pytest.warns(plr_jax.ConstructionInterrupted, match="4 of 7"):
        interrupted = Failing(1, KeyboardInterrupt())
        plrs = plr_jax.construct_many(oracles, MAZE.bounds, leaf="cone", max_bytes=300, executor=interrupted)
    done = [plr is not None for plr in plrs]
    assert done == [True] * 4 + [False] * 3
    assert plrs[0].to_bytes() == family[0].to_bytes()


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize(
    ("functions", "options", "message"),
    [
        (lambda oracles: [], {}, "at least, got none"),
        (lambda oracles: 3, {}, "must be a list of distance functions"),
        (lambda oracles: [oracles[0], 5], {}, "number 1 is 5"),
        (list, {"executor": 4}, "executor must be"),
        (list, {"leaf": "cone", "max_bytes": 10}, "too small: one leaf takes"),
        (list, {"seed": -1}, "seed must be"),
    ],
)
def test_what_is_wrong_is_said(oracles, functions, options, message):
    with pytest.raises(ValueError, match=message):
        plr_jax.construct_many(functions(oracles), MAZE.bounds, **options)


def test_nothing_is_warned_of(oracles):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        plr_jax.construct_many(oracles[:2], MAZE.bounds, leaf="cone", max_bytes=200)
