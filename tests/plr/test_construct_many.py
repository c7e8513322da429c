"""Many PLRs at once, executors and checkpoints: bytes depend neither on workers nor on interruptions."""

import pickle
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from multiprocessing import get_context

import numpy as np
import pytest

import plr_jax
from plr_jax.plr import _construct_many, parallel_builds
from plr_jax.plr.leaves.cone import worst_first
from plr_jax.plr.parallel_builds import BuildResults

# Many PLRs at once.


MAZE = plr_jax.scenes.maze().workspace
OPEN = plr_jax.Workspace(((0, 0), (1, 1)))
CONES = {"leaf": "cone", "max_bytes": 240}


@pytest.fixture(scope="module")
def oracles():
    first = plr_jax.VisibilityGraph(MAZE, (0.06, 0.07))
    return [first, *(first.with_goal(goal) for goal in MAZE.sample_free(6, seed=4)[:2])]


def many(oracles, executor=None, checkpoint=None, **limits):
    limits = limits if "leaf" in limits else CONES | limits
    work = plr_jax.BuildOptions(executor=executor, checkpoint=checkpoint)
    return plr_jax.construct_many(oracles, MAZE.bounds, **limits, options=work)


def files_of(plrs):
    return [plr.to_bytes() for plr in plrs]


@pytest.fixture(scope="module")
def family(oracles):
    return many(oracles)


def errors_of(plr, oracle, x):
    return np.abs(np.asarray(plr(x), np.float64) - oracle(x))


def test_family_errs_less_than_single_constructions(oracles, family):
    x, alone, together = MAZE.sample_free(1000, seed=1), [], []
    for plr, oracle in zip(family, oracles, strict=True):
        assert plr.num_bytes <= 240
        assert np.ldexp(1.0, -plr.cells.depth.sum(axis=1)).sum() == 1
        np.testing.assert_array_equal(plr_jax.from_bytes(plr.to_bytes())(x), plr(x))
        together.append(errors_of(plr, oracle, x).mean())
        alone.append(errors_of(plr_jax.construct(oracle, MAZE.bounds, **CONES), oracle, x).mean())
    assert np.mean(together) < np.mean(alone)
    assert np.max(together) < 2 * np.max(alone)


def test_members_have_the_sources_of_their_own_goal(oracles, family):
    starts = MAZE.sample_free(200, seed=3)
    for plr, oracle in zip(family, oracles, strict=True):
        stored = plr.stored.sources
        for point, offset in zip(stored.points, stored.offsets, strict=True):
            to_source = np.linalg.norm(oracle.sources.points - point, axis=1)
            assert to_source.min() < 1e-6
            np.testing.assert_allclose(offset, oracle.sources.distances[to_source.argmin()], atol=1e-6)
        traces = plr_jax.trace(plr, starts)
        assert (np.asarray(traces.status) == plr_jax.TraceStatus.ARRIVED).mean() > 0.99


@pytest.mark.parametrize("certified", [False, True])
def test_limits_hold(oracles, certified):
    x, build = MAZE.sample_free(1000, seed=1), partial(many, oracles[:1], leaf="cone", certified=certified)
    for most in (1, 2, 60):
        (plr,) = build(max_leaves=most)
        assert most * 8 / 9 - 2 <= plr.num_leaves <= most
        assert np.isfinite(np.asarray(plr(x))).all()
    assert 0.95 * 200 <= build(max_bytes=200)[0].num_bytes <= 200
    (shallow,) = build(max_bytes=200, max_depth=7)
    assert shallow.depth <= 7
    (few,) = build(max_bytes=1000, tolerance=0.05)
    assert few.num_bytes < 400 and errors_of(few, oracles[0], x).max() < 0.051


PROVEN = CONES | {"certified": "leaves"}


@pytest.fixture(scope="module")
def proven(oracles):
    return many(oracles, **PROVEN)


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
    (plane,) = many(oracles[:1], **planes)
    assert plane.to_bytes() == plr_jax.construct(oracles[0], MAZE.bounds, **planes).to_bytes()


@pytest.fixture
def parts_of_one(monkeypatch):
    monkeypatch.setattr(_construct_many, "_MEMBERS_AT_ONCE", 1)


def test_bytes_do_not_depend_on_groups_and_threads(oracles, proven, monkeypatch):
    for at_once, leaves, boxes in ((64, 1, 1 << 12), (2, 1 << 15, 7)):
        monkeypatch.setattr(_construct_many, "_MEMBERS_AT_ONCE", at_once)
        monkeypatch.setattr(worst_first, "_LEAVES_AT_ONCE", leaves)
        monkeypatch.setattr(worst_first, "_BOXES_AT_ONCE", boxes)
        with ThreadPoolExecutor(3) as threads:
            assert files_of(many(oracles[::-1], executor=threads, **PROVEN)) == files_of(proven)[::-1]


class Failing(Executor):
    """An executor in which the part with this number fails; then it may take no more parts.

    It pickles tasks and results, as processes do.
    """

    def __init__(self, number: int, error: BaseException, takes_more=True):
        self.left, self.error, self.takes_more = number, error, takes_more

    def submit(self, fn, /, *args, **kwargs):
        future: Future = Future()
        self.left -= 1
        if self.left < -1 and not self.takes_more:
            raise self.error
        if self.left == -1:
            future.set_exception(self.error)
        else:
            fn, args, kwargs = pickle.loads(pickle.dumps((fn, args, kwargs)))
            future.set_result(pickle.loads(pickle.dumps(fn(*args, **kwargs))))
        return future


@pytest.mark.usefixtures("parts_of_one")
def test_parts_of_a_dead_worker_are_built_again(oracles, family):
    assert files_of(many(oracles, executor=Failing(0, BrokenExecutor("a worker died")))) == files_of(family)


@pytest.mark.usefixtures("parts_of_one")
def test_interrupt_keeps_finished_members(oracles, family):
    with pytest.warns(plr_jax.ConstructionInterrupted, match="2 of 3"):
        plrs = many(oracles, executor=Failing(1, KeyboardInterrupt()))
    assert plrs[1] is None and files_of(plrs[::2]) == files_of(family[::2])


# Checkpoints of many PLRs.


@pytest.fixture(scope="module")
def work(oracles):
    return [*oracles[:2], plr_jax.VisibilityGraph(OPEN, (0.2, 0.3))]


@pytest.fixture(scope="module")
def finished(work, tmp_path_factory):
    path = tmp_path_factory.mktemp("checkpoint") / "work"
    return path, files_of(many(work, checkpoint=path))


def test_cut_or_damaged_checkpoints_are_completed(work, finished, tmp_path, monkeypatch):
    path, files = finished
    whole = path.read_bytes()
    kept = [whole[:size] for size in (0, 42, len(whole) // 2)]
    for data in (*kept, whole[:-20] + bytes([whole[-20] ^ 1]) + whole[-19:]):
        (tmp_path / "cut").write_bytes(data)
        assert files_of(many(work, checkpoint=tmp_path / "cut")) == files
        assert (tmp_path / "cut").read_bytes() == whole
    monkeypatch.setattr(BuildResults, "_build_by", lambda done, pool, chunks, progress: [] if not chunks else 1 / 0)
    assert files_of(many(work, checkpoint=path)) == files, "a complete checkpoint builds nothing"


@pytest.mark.usefixtures("parts_of_one")
def test_members_finished_before_an_error_are_kept(work, finished, tmp_path):
    path = tmp_path / "work"
    with pytest.raises(RuntimeError, match="elsewhere"):
        many(work, checkpoint=path, executor=Failing(2, RuntimeError("elsewhere")))
    assert path.stat().st_size > 0
    assert files_of(many(work, checkpoint=path)) == finished[1]
    assert path.read_bytes() == finished[0].read_bytes()


@pytest.mark.parametrize(
    "change",
    [
        lambda work: (work[:2], {}),
        lambda work: ([work[0], work[0].with_goal((0.93, 0.951)), work[2]], {}),
        lambda work: (work[::-1], {}),
        lambda work: (work, {"max_bytes": 241}),
        lambda work: (work, {"leaf": "plane", "max_bytes": 240}),
        lambda work: (work, {"seed": 1}),
    ],
)
def test_checkpoints_of_other_work_are_refused_and_unchanged(work, finished, change):
    path, before = finished[0], finished[0].read_bytes()
    others, options = change(work)
    with pytest.raises(ValueError, match=r"work is the checkpoint of other work.*or delete it"):
        many(others, checkpoint=path, **options)
    assert path.read_bytes() == before


def test_checkpoints_of_another_release_are_refused(work, finished, monkeypatch):
    monkeypatch.setattr(plr_jax, "__version__", "0.0.0")
    with pytest.raises(ValueError, match="release"):
        many(work, checkpoint=finished[0])


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize(
    ("functions", "options", "message"),
    [
        (lambda oracles: [], {}, "at least one distance function, got none"),
        (lambda oracles: 3, {}, "must be a list of distance functions"),
        (lambda oracles: [oracles[0], 5], {}, "got 5 at index 1"),
        (list, {"executor": 4}, "executor must be a concurrent.futures.Executor or None, got 4"),
        (list, {"leaf": "cone", "max_bytes": 10}, "too small: one leaf takes"),
        (list, {"seed": -1}, "seed must be"),
        (list, {"checkpoint": __file__}, "or a new path, got .*test_construct_many.py. Choose another path"),
        (list, {"checkpoint": 3}, "checkpoint must be the path of a file or None, got 3"),
    ],
)
def test_wrong_arguments_raise(oracles, functions, options, message):
    with pytest.raises(ValueError, match=message):
        many(functions(oracles), **options)
    with pytest.raises(OSError, match="nowhere"):
        many(oracles, checkpoint="/nowhere/work")


# One PLR of a slow distance function.


WORKSPACE = plr_jax.Workspace(((0, 0), (10, 6)), [[(3, 0), (4, 0), (4, 4), (3, 4)]])


@pytest.fixture(scope="module")
def roadmap():
    return plr_jax.Roadmap.from_workspace(WORKSPACE, goal=[9, 1], num_samples=100)


def build(distance_fn, **options):
    options = plr_jax.BuildOptions(**options)
    return plr_jax.construct(distance_fn, WORKSPACE.bounds, max_leaves=12, options=options).to_bytes()


class Counted:
    """A distance function that raises an error, as if the process was killed, after ``most`` calls."""

    def __init__(self, distance_fn, most=10**9):
        self.distance_fn, self.most, self.count = distance_fn, most, 0

    def __call__(self, x):
        self.count += 1
        if self.count > self.most:
            raise RuntimeError("killed")
        return self.distance_fn(x)


def test_bytes_do_not_depend_on_workers_even_if_they_die(roadmap, monkeypatch):
    monkeypatch.setattr(parallel_builds, "_AT_ONCE", 50)
    expected, breaking = build(roadmap), Failing(3, BrokenExecutor("a worker died"), takes_more=False)
    with ThreadPoolExecutor(3) as executor:
        assert build(roadmap, executor=executor) == expected
    assert build(roadmap, executor=breaking) == expected
    assert breaking.left < -1
    with ProcessPoolExecutor(1, mp_context=get_context("forkserver")) as executor:
        assert build(roadmap, executor=executor) == expected


def test_killed_constructions_continue_from_their_checkpoint(roadmap, tmp_path):
    whole = Counted(roadmap)
    expected = build(whole, checkpoint=tmp_path / "whole")
    # Each run calls the function once for the digest, and twice more.
    runs = [Counted(roadmap, 3) for _ in range(whole.count)]
    for run in runs:
        with suppress(RuntimeError):
            plr = build(run, checkpoint=tmp_path / "parts")
            break
    assert plr == expected
    ended = runs.index(run)
    assert ended > 2 and 2 * ended + run.count - 1 == whole.count - 1
    assert (tmp_path / "parts").read_bytes() == (tmp_path / "whole").read_bytes()
    assert build(Counted(roadmap, 1), checkpoint=tmp_path / "whole") == expected
    with pytest.raises(ValueError, match="whole is the checkpoint of other work"):
        build(plr_jax.Euclidean((9, 1)), checkpoint=tmp_path / "whole")


def test_build_over_folded_domain_resumes_from_checkpoint(tmp_path):
    car, box = (
        plr_jax.ReedsShepp(goal=(0, 0, 0), radius=1),
        plr_jax.Box((-3, -3, -np.pi), (3, 3, np.pi), (False, False, True)),
    )
    options = [plr_jax.BuildOptions(checkpoint=path) for path in (None, tmp_path / "car", tmp_path / "car")]
    plrs = [plr_jax.construct(car, box, leaf="continuous", max_leaves=12, options=each) for each in options]
    assert len(set(files_of(plrs))) == 1
