"""Landmarks of a grid: who searches from them, and however often that is cut short, the tables are the same."""

from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context

import numpy as np
import pytest
from grid_helpers import dijkstra, mosaic

from plr_jax import GridGraph, construct_grid_pairs
from plr_jax.pairs.grid_corners import units
from plr_jax.pairs.grid_landmarks import LandmarkTables, evaluate_bounds, landmark_tables, landmarks_within
from plr_jax.plr.work import Checkpoint

FREE = mosaic(3, 3, 9)
NUM = 9


def tables_equal(one, other):
    assert (one.step, one.connectivity) == (other.step, other.connectivity)
    for name in ("before", "part", "lengths"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


@pytest.fixture(scope="module")
def expected():
    return landmark_tables(FREE, 4, NUM)


@pytest.mark.parametrize("connectivity", [4, 8])
def test_lengths_are_those_from_one_cell_of_each_part_rounded_down(connectivity):
    tables = landmark_tables(FREE, connectivity, NUM)
    cells, part, lengths = np.argwhere(FREE), np.asarray(tables.part), np.asarray(tables.lengths)
    for number in range(NUM):
        landmarks = np.flatnonzero(lengths[:, number] == 0)
        for landmark in landmarks[:: 1 + len(landmarks) // 5]:
            to_all = units(connectivity) * dijkstra(FREE, tuple(cells[landmark].tolist()), connectivity)[FREE]
            here = part == part[landmark]
            np.testing.assert_array_equal(np.isfinite(to_all), here)
            rounded = tables.step * lengths[here, number].astype(float)
            assert (rounded <= to_all[here] + 1e-6).all()
            assert (to_all[here] < (rounded + tables.step) * (1 + 1e-6)).all()
        assert set(part[landmarks]) == set(part)


def test_long_paths_are_kept_in_16_bits_and_bounds_hold():
    rows = np.zeros((181, 800), bool)  # a path of 72,000 steps, to and fro
    rows[::2] = True
    rows[1::4, -1] = rows[3::4, 0] = True
    pairs = construct_grid_pairs(rows, max_bytes=400_000)
    assert isinstance(pairs.tables, LandmarkTables) and pairs.tables.step > 1
    cells = np.argwhere(rows)[::97, ::-1].astype(float)
    x, y = np.repeat(cells[::40], len(cells), axis=0), np.tile(cells, (len(cells[::40]), 1))
    truth = GridGraph(rows).between(x, y)
    lower, upper = pairs.bounds(x, y)
    assert truth.max() > 2**16 and (lower <= truth).all() and (truth <= upper).all()
    assert (truth - lower).max() <= 2 * (pairs.tables.step - 1)  # a landmark is at an end of the path


def test_upper_bounds_of_the_longest_paths_are_finite():
    rows = 500_000
    free = np.ones((rows, 3), bool)
    free[1:, 1] = False
    tables = landmark_tables(free, 8, 1)
    x, y = np.array([[0.0, rows - 1]]), np.array([[0.0, rows - 2]])  # at the one end, and the landmark at the other
    assert np.isfinite(evaluate_bounds(tables, x, y, above=True)).all()
    with pytest.raises(ValueError, match="are too long"):
        landmark_tables(np.ones((1, 600_000), bool), 8, 1)


def test_a_step_changes_a_bound_by_no_more():
    pairs = construct_grid_pairs(FREE, max_bytes=4_000)
    assert isinstance(pairs.tables, LandmarkTables) and pairs.tables.step == 1
    cells = np.argwhere(FREE)[:, ::-1]
    table = np.nan_to_num(pairs(cells[:, None], cells[None]), posinf=-1)
    beside = np.abs(cells[:, None] - cells[None]).sum(axis=-1) == 1
    for one, other in np.argwhere(beside):
        assert (abs(table[one] - table[other]) <= 1).all()


def test_threads_and_processes_give_the_same_tables(expected):
    for pool in (ThreadPoolExecutor(3), ProcessPoolExecutor(2, get_context("forkserver"))):
        with pool as executor:
            tables_equal(landmark_tables(FREE, 4, NUM, executor), expected)


class Ends(Executor):
    """Ends the work with an error after some searches."""

    def __init__(self, left: int, error: BaseException):
        self.left, self.error = left, error

    def submit(self, fn, /, *args, **kwargs):
        future: Future = Future()
        self.left -= 1
        if self.left < 0:
            future.set_exception(self.error)
        else:
            future.set_result(fn(*args, **kwargs))
        return future


def test_what_is_cut_short_goes_on_to_the_same_tables_and_file(expected, tmp_path):
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    tables_equal(landmark_tables(FREE, 4, NUM, checkpoint=whole), expected)
    for left in range(NUM):
        with pytest.raises(KeyboardInterrupt):
            landmark_tables(FREE, 4, NUM, Ends(left, KeyboardInterrupt()), cut)
        assert len(cut.read_bytes()) < len(whole.read_bytes())
        rest = Ends(NUM - left, RuntimeError("more is searched for than was left"))
        tables_equal(landmark_tables(FREE, 4, NUM, rest, cut), expected)
        assert cut.read_bytes() == whole.read_bytes()
        cut.unlink()
    tables_equal(landmark_tables(FREE, 4, NUM, Ends(2, BrokenExecutor("a worker died"))), expected)
    with pytest.raises(ValueError, match="checkpoint of other work"):
        landmark_tables(FREE, 4, NUM + 1, checkpoint=whole)


def test_what_is_whole_is_searched_for_no_more_and_written_once(expected, tmp_path, monkeypatch):
    landmark_tables(FREE, 4, NUM, checkpoint=tmp_path / "whole")
    written = []
    monkeypatch.setattr(Checkpoint, "finish", lambda checkpoint: written.append(len(checkpoint.records)))
    tables_equal(
        landmark_tables(FREE, 4, NUM, Ends(0, RuntimeError("there was nothing left")), tmp_path / "whole"), expected
    )
    assert written == [NUM]


def test_room_is_used_and_no_more():
    size = 6_000
    number = landmarks_within(FREE, 4, size)
    pairs = construct_grid_pairs(FREE, max_bytes=size)
    assert pairs.num_landmarks == number and size - 2 * FREE.sum() < pairs.resident_bytes <= size
    # An island needs no landmarks beyond its cells.
    assert landmarks_within(np.array([[True, True, False, True]]), 4, 10**9) == 2
