"""Many PLRs at once, and executors: bytes do not depend on workers, and interrupts keep what is finished."""

import pickle
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from functools import partial
from multiprocessing import get_context

import numpy as np
import pytest

import plr_jax
from plr_jax.plr import _construct_many, sampling
from plr_jax.plr.leaves.cone import worst_first

# Many PLRs at once.


MAZE = plr_jax.scenes.maze().workspace
CONES = {"leaf": "cone", "max_bytes": 240}


@pytest.fixture(scope="module")
def oracles():
    first = plr_jax.VisibilityGraph(MAZE, (0.06, 0.07))
    return [first, *(first.with_goal(goal) for goal in MAZE.sample_free(6, seed=4)[:2])]


def many(oracles, executor=None, **limits):
    options = plr_jax.BuildOptions(executor=executor)
    return plr_jax.construct_many(oracles, MAZE.bounds, **CONES | limits, options=options)


def files_of(plrs):
    return [plr.to_bytes() for plr in plrs]


@pytest.fixture(scope="module")
def family(oracles):
    return many(oracles)


def errors_of(plr, oracle, x):
    return np.abs(np.asarray(plr(x), np.float64) - oracle(x))


def test_family_errs_less_than_single_constructions_and_has_sources_of_its_own_goals(oracles, family):
    x, alone, together = MAZE.sample_free(1000, seed=1), [], []
    for plr, oracle in zip(family, oracles, strict=True):
        assert plr.num_bytes <= 240
        assert np.ldexp(1.0, -plr.cells.depth.sum(axis=1)).sum() == 1
        np.testing.assert_array_equal(plr_jax.from_bytes(plr.to_bytes())(x), plr(x))
        together.append(errors_of(plr, oracle, x).mean())
        alone.append(errors_of(plr_jax.construct(oracle, MAZE.bounds, **CONES), oracle, x).mean())
        stored = plr.stored.sources
        to_source = np.linalg.norm(oracle.sources.points[:, None] - stored.points, axis=2)
        assert to_source.min(axis=0).max() < 1e-6
        np.testing.assert_allclose(stored.offsets, oracle.sources.distances[to_source.argmin(axis=0)], atol=1e-6)
        assert (np.asarray(plr_jax.trace(plr, x[:200]).status) == plr_jax.TraceStatus.ARRIVED).mean() > 0.99
    assert np.mean(together) < np.mean(alone)
    assert np.max(together) < 2 * np.max(alone)


@pytest.mark.parametrize("certified", [False, True])
def test_limits_hold(oracles, certified):
    x, build = MAZE.sample_free(1000, seed=1), partial(many, oracles[:1], max_bytes=None, certified=certified)
    for most in (1, 2, 60):
        (plr,) = build(max_leaves=most)
        assert most * 8 / 9 - 2 <= plr.num_leaves <= most and np.isfinite(np.asarray(plr(x))).all()
    assert 0.95 * 200 <= build(max_bytes=200)[0].num_bytes <= 200
    assert build(max_bytes=200, max_depth=7)[0].depth <= 7
    (few,) = build(max_bytes=1000, tolerance=0.05)
    assert few.num_bytes < 400 and errors_of(few, oracles[0], x).max() < 0.051


@pytest.mark.parametrize("certified", [True, "leaves"])
def test_certified_families_fill_files_and_err_at_most_as_single_constructions(oracles, certified):
    x, limits = MAZE.sample_free(3000, seed=6), {"leaf": "cone", "max_bytes": 512, "certified": certified}
    (plr,), oracle = many(oracles[:1], **limits), oracles[0]
    lower, upper = map(np.asarray, plr.bounds(x))
    assert (lower <= oracle(x)).all() and (oracle(x) <= upper).all()
    assert 0.98 * 512 <= plr.num_bytes <= 512
    alone = plr_jax.construct(oracle, MAZE.bounds, **limits)
    assert errors_of(plr, oracle, x).max() <= plr.max_error <= alone.max_error


@pytest.mark.filterwarnings("ignore:The goal cannot be reached")
def test_certified_families_include_goals_without_a_path():
    halves = plr_jax.Workspace(((0, 0), (8, 4)), [[(4, 0), (5, 0), (5, 4), (4, 4)]])
    left = plr_jax.VisibilityGraph(halves, (1, 1))
    build = partial(plr_jax.construct_many, leaf="cone", max_bytes=300, certified=True)
    both = [left, left.with_goal((6, 1))]
    assert all(plr.max_error < 1e-5 for plr in build(both, halves.bounds))
    for oracles in (both, both[1:]):
        with pytest.raises(ValueError, match="reach"):
            build(oracles, ((0, 0), (4, 4)))


def test_planes_equal_single_constructions(oracles):
    planes = {"leaf": "plane", "max_leaves": 30, "seed": 3}
    (plane,) = many(oracles[:1], **planes, max_bytes=None)
    assert plane.to_bytes() == plr_jax.construct(oracles[0], MAZE.bounds, **planes).to_bytes()


def test_bytes_do_not_depend_on_groups_and_threads(oracles, monkeypatch):
    proven = many(oracles, certified="leaves")
    for at_once, leaves, boxes in ((64, 1, 1 << 12), (2, 1 << 15, 7)):
        monkeypatch.setattr(_construct_many, "_MEMBERS_AT_ONCE", at_once)
        monkeypatch.setattr(worst_first, "_LEAVES_AT_ONCE", leaves)
        monkeypatch.setattr(worst_first, "_BOXES_AT_ONCE", boxes)
        with ThreadPoolExecutor(3) as threads:
            assert files_of(many(oracles[::-1], executor=threads, certified="leaves")) == files_of(proven)[::-1]


class Failing(Executor):
    """An executor in which the part with this number fails; after a ``BrokenExecutor`` it takes no more parts.

    It pickles tasks and results, as processes do.
    """

    def __init__(self, number: int, error: BaseException):
        self.left, self.error = number, error

    def submit(self, fn, /, *args, **kwargs):
        future, self.left = Future(), self.left - 1
        if self.left < -1 and isinstance(self.error, BrokenExecutor):
            raise self.error
        if self.left == -1:
            future.set_exception(self.error)
        else:
            fn, args, kwargs = pickle.loads(pickle.dumps((fn, args, kwargs)))
            future.set_result(pickle.loads(pickle.dumps(fn(*args, **kwargs))))
        return future


def test_parts_of_dead_workers_are_built_again_and_interrupts_keep_finished_ones(oracles, family, monkeypatch):
    monkeypatch.setattr(_construct_many, "_MEMBERS_AT_ONCE", 1)
    assert files_of(many(oracles, executor=Failing(1, BrokenExecutor("a worker died")))) == files_of(family)
    with pytest.warns(plr_jax.ConstructionInterrupted, match="2 of 3"):
        plrs = many(oracles, executor=Failing(1, KeyboardInterrupt()))
    assert plrs[1] is None and files_of(plrs[::2]) == files_of(family[::2])


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize(
    ("functions", "options", "message"),
    [
        (lambda oracles: [], {}, r"must be a list of distance functions, got \[\]"),
        (lambda oracles: 3, {}, "must be a list of distance functions"),
        (lambda oracles: [oracles[0], 5], {}, "got 5 at index 1"),
        (list, {"executor": 4}, "executor must be a concurrent.futures.Executor or None, got 4"),
        (list, {"leaf": "cone", "max_bytes": 10}, "too small: one leaf takes"),
        (list, {"seed": -1}, "seed must be"),
        (list, {"executor": Failing(0, ValueError("from a worker"))}, "from a worker"),
    ],
)
def test_wrong_arguments_raise(oracles, functions, options, message):
    with pytest.raises(ValueError, match=message):
        many(functions(oracles), **options)


# One PLR of a slow distance function.


def test_bytes_do_not_depend_on_workers_even_if_they_die(monkeypatch):
    monkeypatch.setattr(sampling, "_POINTS_OF_TASK", 50)
    roadmap = plr_jax.Roadmap.from_workspace(MAZE, goal=(0.06, 0.07), num_samples=100)
    box = plr_jax.Box((-3, -3, -np.pi), (3, 3, np.pi), (False, False, True))
    folded = plr_jax.ReedsShepp(goal=(0, 0, 0), radius=1)
    with ThreadPoolExecutor(3) as threads, ProcessPoolExecutor(1, get_context("forkserver")) as processes:
        for oracle, domain in ((roadmap, MAZE.bounds), (folded, box)):
            breaking = Failing(3, BrokenExecutor("a worker died"))
            options = [plr_jax.BuildOptions(executor=each) for each in (None, threads, processes, breaking)]
            plrs = [plr_jax.construct(oracle, domain, max_leaves=12, options=each) for each in options]
            assert len(set(files_of(plrs))) == 1 and breaking.left < -1
