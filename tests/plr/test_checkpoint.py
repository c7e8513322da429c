"""Work that is kept: resumed, refused where it is of other work, and dropped where it was cut short."""

from concurrent.futures import Executor, Future

import numpy as np
import pytest

import plr_jax
from plr_jax.plr import _construct_many

MAZE = plr_jax.scenes.maze().workspace


@pytest.fixture(scope="module")
def oracles():
    first = plr_jax.VisibilityGraph(MAZE, (0.06, 0.07))
    return [first, first.with_goal((0.93, 0.95)), plr_jax.Euclidean((0.2, 0.3))]


def build(oracles, path, leaf="cone", max_bytes=200, **options):
    return plr_jax.construct_many(oracles, MAZE.bounds, leaf=leaf, max_bytes=max_bytes, checkpoint=path, **options)


def files_of(plrs):
    return [plr.to_bytes() for plr in plrs]


@pytest.fixture(scope="module")
def finished(oracles, tmp_path_factory):
    path = tmp_path_factory.mktemp("checkpoint") / "work"
    return path, build(oracles, path)


def test_it_changes_nothing_and_nothing_is_built_twice(oracles, finished, monkeypatch):
    path, plrs = finished
    assert files_of(plrs) == files_of(build(oracles, None))
    monkeypatch.setattr(_construct_many, "_run_by", lambda pool, chunks, *rest: [] if not chunks else 1 / 0)
    again = build(oracles, path)
    assert files_of(again) == files_of(plrs)
    x = MAZE.sample_free(20, 0)
    np.testing.assert_array_equal(again[0](x), plrs[0](x))


def test_however_much_was_written_the_rest_is_built(oracles, finished, tmp_path):
    path, plrs = finished
    whole = path.read_bytes()
    for size in [*range(0, 60, 7), *range(60, len(whole), 97), len(whole) - 1]:
        cut = tmp_path / "cut"
        cut.write_bytes(whole[:size])
        assert files_of(build(oracles, cut)) == files_of(plrs)
        assert cut.read_bytes() == whole


def test_a_record_that_was_damaged_is_built_again(oracles, finished, tmp_path):
    path, plrs = finished
    damaged = bytearray(path.read_bytes())
    damaged[-20] ^= 1
    (tmp_path / "damaged").write_bytes(damaged)
    assert files_of(build(oracles, tmp_path / "damaged")) == files_of(plrs)
    assert (tmp_path / "damaged").read_bytes() == path.read_bytes()


def test_what_was_done_before_an_error_is_kept(oracles, tmp_path, finished):
    class Failing(Executor):
        """After two parts something fails."""

        def submit(self, fn, /, *args, **kwargs):
            future = Future()
            if fn.args[0] is oracles[2]:
                future.set_exception(RuntimeError("elsewhere"))
            else:
                future.set_result(fn(*args, **kwargs))
            return future

    path = tmp_path / "work"
    with pytest.raises(RuntimeError, match="elsewhere"):
        build(oracles, path, executor=Failing())
    assert path.stat().st_size > 0
    plrs = build(oracles, path)
    assert path.read_bytes() == finished[0].read_bytes()
    assert files_of(plrs) == files_of(finished[1])


@pytest.mark.parametrize(
    "change",
    [
        lambda oracles: (oracles[:2], {}),
        lambda oracles: ([*oracles[:2], plr_jax.Euclidean((0.2, 0.31))], {}),
        lambda oracles: ([oracles[0], oracles[0].with_goal((0.93, 0.951)), oracles[2]], {}),
        lambda oracles: (oracles[::-1], {}),
        lambda oracles: (oracles, {"max_bytes": 201}),
        lambda oracles: (oracles, {"leaf": "plane"}),
        lambda oracles: (oracles, {"seed": 1}),
        lambda oracles: (oracles, {"max_depth": 7}),
    ],
)
def test_other_work_is_refused_and_left_as_it_is(oracles, finished, change):
    path, before = finished[0], finished[0].read_bytes()
    others, options = change(oracles)
    with pytest.raises(ValueError, match=r"work is the checkpoint of other work.*or delete it"):
        build(others, path, **options)
    assert path.read_bytes() == before


def test_another_release_is_other_work(oracles, finished, monkeypatch):
    monkeypatch.setattr(plr_jax, "__version__", "0.0.0")
    with pytest.raises(ValueError, match="release"):
        build(oracles, finished[0])


@pytest.mark.usefixtures("unchecked_types")
def test_what_is_wrong_is_said(oracles, tmp_path):
    (tmp_path / "text").write_text("something else")
    with pytest.raises(ValueError, match="text is no checkpoint: choose another path"):
        build(oracles, tmp_path / "text")
    with pytest.raises(ValueError, match="checkpoint must be the path of a file or None, got 3"):
        build(oracles, 3)
    with pytest.raises(OSError, match="nowhere"):
        build(oracles, tmp_path / "nowhere" / "work")
