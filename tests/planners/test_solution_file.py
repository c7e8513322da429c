"""The file of a solution: it gives the solution back to the bit, and nothing else passes for one."""

import json
import re
import warnings
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given, settings
from solution_helpers import COUNTS, NONE, PATH, ROOM, SOLUTION, findings, found_by_a_planner

from plr_jax import Problem, RectangleRobot, bl_plan, scenes, straight_line
from plr_jax.planners import Solution, Stats, Status
from plr_jax.planners import _solution as module
from plr_jax.planners._solution import save_solution, solution_of


def assert_same(a, b):
    """Two solutions are the same to the bit, but for the samples."""
    for name in {each.name for each in fields(Solution)} - {"path", "times", "samples"}:
        assert getattr(a, name) == getattr(b, name), name
    for one, other in ((a.path, b.path), (a.times, b.times)):
        assert (one is None) == (other is None)
        if one is not None:
            assert one.shape == other.shape and one.dtype == other.dtype and one.tobytes() == other.tobytes()


@given(found=findings())
@settings(max_examples=60, deadline=None)
def test_a_solution_survives_the_file_to_the_bit(found, tmp_path_factory):
    solution = found_by_a_planner(*found)
    folder = tmp_path_factory.mktemp("solutions")
    solution.save(folder / "a.json")
    again = Solution.load(folder / "a.json")
    assert_same(again, solution)
    assert again.samples.shape == ((0, 0, 0) if solution.path is None else (0, 2, 3))
    again.save(str(folder / "b.json"))
    assert (folder / "a.json").read_bytes() == (folder / "b.json").read_bytes()


def test_a_planner_s_solution_survives_the_file(tmp_path):
    problem = scenes.single_door()
    solution = bl_plan(problem, straight_line(problem))
    solution.save(tmp_path / "a.json")
    again = Solution.load(tmp_path / "a.json")
    assert_same(again, solution)
    times = np.linspace(-1, solution.makespan + 1, 50)
    np.testing.assert_array_equal(again.path_at(times), solution.path_at(times))


def test_the_file_is_json_as_the_standard_has_it(tmp_path):
    def no_such_word(word):
        raise AssertionError(word)

    for solution in (NONE, SOLUTION):
        solution.save(tmp_path / "a.json")
        entry = json.loads((tmp_path / "a.json").read_text(), parse_constant=no_such_word)
        assert (entry["format"], entry["version"]) == ("plr_jax solution", 1)
        assert entry["status"] == solution.status.name
    assert entry["path"] == PATH.tolist() and entry["times"] == SOLUTION.times.tolist()
    NONE.save(tmp_path / "a.json")
    entry = json.loads((tmp_path / "a.json").read_text())
    assert [entry[name] for name in ("cost", "makespan", "motions_factor", "path", "times")] == [None] * 5
    assert entry["lower_bound"] == 8.0


def test_numbers_of_numpy_are_saved_as_those_of_python(tmp_path):
    stats = Stats(
        np.int32(5), np.int64(4), seconds={"a": np.float32(0.5)}, history=((np.float64(0.25), np.int64(9)),)
    )
    solution = replace(SOLUTION, cost=np.float64(11.5), stats=stats)
    solution.save(tmp_path / "a.json")
    assert_same(Solution.load(tmp_path / "a.json"), solution)


def test_more_keys_are_written_and_ignored(tmp_path):
    save_solution(SOLUTION, tmp_path / "a.json", clearance=0.5)
    assert json.loads((tmp_path / "a.json").read_text())["clearance"] == 0.5
    assert_same(Solution.load(tmp_path / "a.json"), SOLUTION)


def test_a_failed_save_keeps_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "a.json"
    SOLUTION.save(path)
    old = path.read_bytes()
    contradictions = [
        replace(SOLUTION, times=None),
        replace(SOLUTION, cost=float("inf")),
        replace(SOLUTION, makespan=6.0),
        replace(SOLUTION, cost=float("nan")),
        replace(SOLUTION, path=np.where(PATH == 8, np.nan, PATH)),
        replace(NONE, cost=1.0),
    ]
    for solution in contradictions:
        with pytest.raises(ValueError, match=r"expected|must be"):
            solution.save(path)
    monkeypatch.setattr(module, "_MOST_BYTES", 300)
    with pytest.raises(ValueError, match=r"has at most 300 bytes, this one would have \d+"):
        SOLUTION.save(path)
    monkeypatch.undo()

    def fail(_):
        raise OSError("disk full")

    monkeypatch.setattr("os.fsync", fail)
    with pytest.raises(OSError, match="disk full"):
        NONE.save(path)
    assert path.read_bytes() == old and list(tmp_path.iterdir()) == [path]


def test_a_solution_may_be_larger_than_a_scene(tmp_path):
    steps = 2**18
    turn = np.linspace(0, 1, steps) / 3
    long = np.zeros((steps, 1, 3)) + np.stack([1 + turn, 2 + turn, turn], axis=1)[:, None]
    problem = Problem(ROOM, [RectangleRobot(1, 1)], long[0], long[-1])
    solution = solution_of(problem, long, 0.0, Status.SOLVED, Stats(1), long[:1])
    solution.save(tmp_path / "a.json")
    assert (tmp_path / "a.json").stat().st_size > 2**24
    assert_same(Solution.load(tmp_path / "a.json"), solution)


def refused(text, message, tmp_path):
    """Fails unless such a file is refused by its name."""
    path = tmp_path / "a.json"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ValueError, match=re.escape(f"{path}: ") + f"(?s:.*){message}"), warnings.catch_warnings():
        warnings.simplefilter("error")
        Solution.load(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "expected JSON"),
        ("{", "expected JSON"),
        ("[1]", 'expected a solution file, with "format": "plr_jax solution"'),
        ('"plr_jax solution"', "expected a solution file"),
        ('{"format": "plr_jax solution"}', "expected a version number of at least 1, got None"),
        ('{"format": "plr_jax solution", "version": 1}', "missing status, cost, makespan"),
        ("[" * 100_000, "recursion"),
        ("[" * 33 + "]" * 33, "at most 32 deep"),
        ("[" + "1" * 400 + "]", "larger integer"),
        ("[" + "1" * 5000 + "]", "Exceeds the limit"),
        (b'{"a": "\xff"}', "expected text in UTF-8"),
        (b" " * (2**26 + 1), "at most 67,108,864 bytes"),
    ],
    ids=range(12),
)
def test_what_is_no_solution_file_is_refused_by_name(text, message, tmp_path):
    refused(text, message, tmp_path)


def test_a_scene_file_is_no_solution_file(tmp_path):
    scenes.save(scenes.maze(), tmp_path / "a.json")
    refused((tmp_path / "a.json").read_bytes(), "expected a solution file", tmp_path)
    SOLUTION.save(tmp_path / "a.json")
    with pytest.raises(ValueError, match="expected a scene file"):
        scenes.load(tmp_path / "a.json")


STATS = {**dict.fromkeys(COUNTS, 1), "seconds": {}, "history": [], "found_by": "bl"}
DEEP = {"a": [[[[[]]]]]}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"version": 2}, "has version 2, this release reads up to 1: update plr-jax"),
        *(({"version": version}, "expected a version number") for version in (0, 1.0, True, "1", None, [])),
        *(
            ({"status": status}, 'expected "status" to be one of SOLVED')
            for status in ("solved", 1, None, ["SOLVED"])
        ),
        *(({name: -1}, f'"{name}" must be a finite number of at least 0') for name in ("cost", "lower_bound")),
        *(({"motions_factor": value}, "must be a finite number") for value in (True, "1", [], float("nan"))),
        *(({"cost": value}, "must be a finite number") for value in (float("inf"), float("nan"), "1", DEEP)),
        *(({name: None}, f"null all or none; null are {name}") for name in ("cost", "makespan", "path", "times")),
        ({"path": None, "times": None}, "null are path, times"),
        ({"makespan": 7.5}, 'expected "times" from 0 to the makespan 7.5'),
        *(({"path": path}, "path") for path in ([], [[]], [[[]]], [1, 2], "abc", {}, [[[1, 2]], [[1]]], DEEP)),
        *(({"path": [[[1, x]]] * 4}, '"path" to be finite') for x in (float("nan"), float("inf"), None)),
        *(({"path": [[[1.0] * n]] * 4}, "2 or 3") for n in (1, 4)),
        ({"path": PATH[:3].tolist()}, '"times" to be 3 finite numbers that never fall'),
        *(({"times": [0, a, b, 7]}, "that never fall") for a, b in ((5, 4), (4, float("nan")), (8, 8))),
        *(({"times": times}, "times") for times in ([1, 4, 4, 7], [], 7, "abc", [[0, 4, 4, 7]], [0, 4, 4, {}])),
        *(({"stats": stats}, 'expected "stats" to have the keys') for stats in (None, [], {}, {"num_nodes": 1})),
        *(({"stats": {**STATS, "num_nodes": n}}, "must be an integer >= 0") for n in (-1, 1.5, True, "1", None)),
        *(({"stats": {**STATS, "seconds": x}}, '"seconds"') for x in ([], 1, {"a": -1}, {"a": None}, {"a": {}})),
        *(
            ({"stats": {**STATS, "history": x}}, "history|seconds must|a cost must")
            for x in ({}, 1, [1], [[1]], [[1, 2, 3]], [[1, float("nan")]], [["1", 2]], [[-1, 2]], [[1, None]])
        ),
    ],
    ids=str,
)
def test_what_contradicts_a_solution_is_refused_by_name(changes, message, tmp_path):
    SOLUTION.save(tmp_path / "a.json")
    entry = json.loads((tmp_path / "a.json").read_text())
    refused(json.dumps({**entry, **changes}), message, tmp_path)


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(FileNotFoundError):
        Solution.load(tmp_path / "a.json")
    with pytest.raises(ValueError, match=re.escape("a\0b: ")):
        Solution.load("a\0b")
