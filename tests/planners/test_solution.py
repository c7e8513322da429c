"""Solutions: costs and times of their paths, and files that give them back exactly."""

import json
import re
import warnings
from dataclasses import fields, replace

import numpy as np
import pytest

from plr_jax import DiscRobot, Problem, RectangleRobot, Workspace, scenes
from plr_jax._problem import motion_costs
from plr_jax.metrics import makespan
from plr_jax.planners import Solution, Stats, Status
from plr_jax.planners import _solution as module
from plr_jax.planners._solution import make_solution, straight_line_bound

ROOM = Workspace(((0, 0), (10, 10)))
PROBLEM = Problem(ROOM, [DiscRobot(0.5), RectangleRobot(2, 1)], [(1, 1, 7), (5, 5, 3)], [(4, 5, 7), (5, 8, -3)], 2.0)
TURN = 2 * np.pi - 6  # from heading 3 to -3 by the shorter way
PATH = np.array([[(1, 1, 7), (5, 5, 3.0)], [(1, 5, 7), (5, 5, -3)], [(1, 5, 7), (5, 5, -3)], [(4, 5, 7), (5, 8, -3)]])
SOME = Stats(9, 8, 7, 6, {"a": 0.1}, ((0.25, 99.5), (0.5, 1 / 3)))
SOLUTION = replace(make_solution(PROBLEM, PATH, 8.5, Status.SOLVED, SOME, PATH), motions_factor=1.25)
NONE = make_solution(PROBLEM, None, 8.0, Status.EXHAUSTED, Stats(1), PROBLEM.starts[None])
COUNTS = ("num_nodes", "num_expansions", "num_children_scored", "num_children_valid", "num_bytes")


def random_solution(seed):
    """Return a solution with a random path, in which rows may repeat, or without a path, and random statistics."""
    rng = np.random.default_rng(seed)
    amounts = rng.choice([0.0, 5e-324, 1 / 3, 1e300], 8).tolist()
    path = np.repeat(rng.uniform(-1, 1, (5, 2, 3)) * 10.0 ** rng.integers(-3, 6), rng.integers(1, 4, 5), axis=0)
    counts = dict(zip(COUNTS, rng.integers(0, 2**60, len(COUNTS)).tolist(), strict=True))
    stats = Stats(**counts, history=((*amounts[:2],), (*amounts[2:4],)), seconds={"": amounts[4], 'é"\n\0': 0.1})
    bounds = amounts[5], rng.choice([amounts[6], np.inf])
    status, path = list(Status)[seed % len(Status)], None if seed % 4 == 3 else path
    solution = make_solution(PROBLEM, path, bounds[0], status, stats, PROBLEM.starts[None])
    return solution if path is None else replace(solution, motions_factor=float(bounds[1]))


def test_solution_computes_costs_from_path():
    path = PATH[[0, 1, 3]]
    solution = make_solution(PROBLEM, path, 8.0, Status.SOLVED, Stats(3), path)
    assert straight_line_bound(PROBLEM) == pytest.approx(5 + 3 + 2 * TURN)
    assert solution.solved and solution.path is path and solution.lower_bound == 8.0
    assert solution.cost == pytest.approx(4 + 3 + 3 + 2 * TURN)
    assert solution.makespan == pytest.approx(4 + 3)
    assert solution.makespan == makespan(PROBLEM, path) == solution.times[-1]
    np.testing.assert_allclose(solution.times, [0, 4, 7])


def test_missing_path_costs_infinity():
    assert not NONE.solved and NONE.path is None and NONE.times is None
    assert NONE.cost == NONE.makespan == np.inf and NONE.lower_bound == 8.0
    with pytest.raises(ValueError, match="no path to follow: the planner ended because no search is left"):
        NONE.path_at([0.0])


def test_first_solution_is_first_entry_of_history():
    assert Stats(1).first_solution == np.inf
    assert Stats(1, history=((0.25, 9.0), (0.5, 8.0))).first_solution == 0.25
    first, second = Stats(1), Stats(1)
    first.seconds["search"] = 1.0
    assert second.seconds == {}


def test_slowest_robot_sets_times_of_rows():
    """In the first motion the disc goes 4 at unit speed, and the rectangle turns through pi the shorter way."""
    at = SOLUTION.path_at([0, 1, 2, 4, 5, 7])
    np.testing.assert_allclose(at[:, 0, :2], [(1, 1), (1, 2), (1, 3), (1, 5), (2, 5), (4, 5)])
    np.testing.assert_allclose(at[:, 1, 1], [5, 5, 5, 5, 6, 8])
    np.testing.assert_allclose(at[:3, 1, 2], [3, 3 + TURN / 4, 3 + TURN / 2])
    np.testing.assert_allclose(at[3:, 1, 2], -3)


def test_path_at_takes_any_shape_and_clamps_times():
    at = SOLUTION.path_at([-np.inf, -1, -0.0, SOLUTION.makespan, 8, np.inf])
    np.testing.assert_array_equal(at, [*[PROBLEM.starts] * 3, *[PROBLEM.goals] * 3])
    np.testing.assert_array_equal(SOLUTION.path_at(2), SOLUTION.path_at([2])[0])
    assert SOLUTION.path_at([]).shape == (0, 2, 3)
    times = np.linspace(0, 7, 6)
    np.testing.assert_array_equal(SOLUTION.path_at(times.reshape(2, 3)).reshape(6, 2, 3), SOLUTION.path_at(times))


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_fastest_robot_moves_at_unit_speed(seed):
    solution = random_solution(seed)
    times, scale = np.linspace(0, solution.makespan, 17), 1e-9 * (1 + solution.makespan)
    at = solution.path_at(times)
    spent = motion_costs(PROBLEM, at[:-1], at[1:])
    assert (spent.max(axis=1) <= np.diff(times) + scale).all()
    np.testing.assert_array_equal(at[[0, -1]], solution.path[[0, -1]])
    is_last_of_its_time = np.append(np.diff(solution.times) > 0, True)
    rows = solution.path_at(solution.times[is_last_of_its_time])
    np.testing.assert_array_equal(rows[1:], solution.path[is_last_of_its_time][1:])
    moving = np.flatnonzero(np.diff(solution.times) > scale)
    halves = solution.times[moving] + np.diff(solution.times)[moving] / 2
    half_way = motion_costs(PROBLEM, solution.path[moving], solution.path_at(halves))
    np.testing.assert_allclose(half_way.max(axis=1), np.diff(solution.times)[moving] / 2, rtol=1e-6, atol=scale)


def test_free_turn_lasts_as_long_as_by_default():
    robot = RectangleRobot(2, 1)
    for weight, scale in ((0, robot.circumscribed_radius), (0.5, 0.5), (None, robot.circumscribed_radius)):
        problem = Problem(ROOM, [robot], [(3, 3, 0)], [(7, 3, 1)], rotation_weight=weight)
        path = np.array([[(3.0, 3, 0)], [(3, 3, 1)], [(7, 3, 1)]])
        solution = make_solution(problem, path, 0.0, Status.SOLVED, Stats(1), path)
        np.testing.assert_allclose(solution.times, [0, scale, scale + 4])
        at = solution.path_at([0, scale / 2, scale + 2, np.inf])
        np.testing.assert_allclose(at[:, 0], [(3, 3, 0), (3, 3, 0.5), (5, 3, 1), (7, 3, 1)])


def test_path_that_takes_no_time_begins_at_the_start():
    """A disc's heading changes at once."""
    problem = Problem(ROOM, [DiscRobot(0.4), RectangleRobot(2, 1)], *[[(3, 3, turn), (7, 3, 0)] for turn in (0, 1)])
    path = np.stack([problem.starts, problem.goals])
    at = make_solution(problem, path, 0.0, Status.SOLVED, Stats(1), path).path_at([0, 1e-300])
    np.testing.assert_array_equal(at, path)


@pytest.mark.usefixtures("unchecked_types")
def test_invalid_times_raise():
    masked = np.ma.masked_greater([1.0, 2.0], 1.5)
    for times, message in (
        ([0.0, np.nan], r"times must not be NaN"),
        ("soon", r"times must be numbers, such as an array"),
        ([1j], r"times must be numbers"),
        (masked, r"times must be numbers, such as .* and some are masked"),
    ):
        with pytest.raises(ValueError, match=message):
            SOLUTION.path_at(times)


# Files


def assert_same(a, b):
    """Check that two solutions are identical, except for the samples."""
    for name in {each.name for each in fields(Solution)} - {"path", "times", "samples"}:
        assert getattr(a, name) == getattr(b, name), name
    for one, other in ((a.path, b.path), (a.times, b.times)):
        assert (one is None) == (other is None)
        if one is not None:
            assert one.shape == other.shape and one.dtype == other.dtype and one.tobytes() == other.tobytes()


def test_solutions_survive_files_exactly(tmp_path):
    for seed in range(12):
        solution = random_solution(seed)
        solution.save(tmp_path / "a.json")
        again = Solution.load(tmp_path / "a.json")
        assert_same(again, solution)
        assert again.samples.shape == ((0, 0, 0) if solution.path is None else (0, 2, 3))
        again.save(str(tmp_path / "b.json"))
        assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()


def test_file_is_standard_json(tmp_path):
    def no_such_word(word):
        raise AssertionError(word)

    for solution in (NONE, SOLUTION):
        solution.save(tmp_path / "a.json")
        entry = json.loads((tmp_path / "a.json").read_text(), parse_constant=no_such_word)
        assert (entry["format"], entry["version"]) == ("plr_jax solution", 1)
        assert entry["status"] == solution.status.name
    assert entry["path"] == PATH.tolist() and entry["times"] == SOLUTION.times.tolist()
    (tmp_path / "a.json").write_text(json.dumps({**entry, "clearance": 0.5}))  # files may have more keys
    assert_same(Solution.load(tmp_path / "a.json"), SOLUTION)
    NONE.save(tmp_path / "a.json")
    entry = json.loads((tmp_path / "a.json").read_text())
    assert [entry[name] for name in ("cost", "makespan", "motions_factor", "path", "times")] == [None] * 5
    assert entry["lower_bound"] == 8.0


def test_numpy_numbers_are_saved_as_python_numbers(tmp_path):
    stats = Stats(np.int32(5), np.int64(4), seconds={"a": np.float32(0.5)}, history=((np.float64(0.5), np.int64(9)),))
    solution = replace(SOLUTION, cost=np.float64(11.5), stats=stats)
    solution.save(tmp_path / "a.json")
    assert_same(Solution.load(tmp_path / "a.json"), solution)


def test_failed_save_keeps_old_file(tmp_path, monkeypatch):
    path = tmp_path / "a.json"
    SOLUTION.save(path)
    old = path.read_bytes()
    changes = [{"times": None}, {"cost": float("inf")}, {"makespan": 6.0}, {"cost": float("nan")}]
    changes.append({"path": np.where(PATH == 8, np.nan, PATH)})
    for solution in (replace(NONE, cost=1.0), *(replace(SOLUTION, **change) for change in changes)):
        with pytest.raises(ValueError, match=r"expected|must be"):
            solution.save(path)
    monkeypatch.setattr(module, "_MOST_BYTES", 300)
    with pytest.raises(ValueError, match=r"has at most 300 bytes, this one has \d+"):
        SOLUTION.save(path)
    monkeypatch.undo()

    def fail(_):
        raise OSError("disk full")

    monkeypatch.setattr("os.fsync", fail)
    with pytest.raises(OSError, match="disk full"):
        NONE.save(path)
    assert path.read_bytes() == old and list(tmp_path.iterdir()) == [path]


def test_solution_file_may_be_larger_than_a_scene(tmp_path):
    SOLUTION.save(tmp_path / "a.json")
    with (tmp_path / "a.json").open("ab") as file:
        file.write(b" " * 2**24)
    assert_same(Solution.load(tmp_path / "a.json"), SOLUTION)


def assert_refused(text, message, tmp_path):
    """Check that a file with this text is refused, and that the error names the file."""
    path = tmp_path / "a.json"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ValueError, match=re.escape(f"{path}: ") + f"(?s:.*){message}"), warnings.catch_warnings():
        warnings.simplefilter("error")
        Solution.load(path)


def test_malformed_file_raises(tmp_path):
    for text, message in (
        ("", "expected JSON"),
        ("{", "expected JSON"),
        ("[1]", 'expected a solution file, with "format": "plr_jax solution"'),
        ('"plr_jax solution"', "expected a solution file"),
        ('{"format": "plr_jax solution"}', "expected a version number of at least 1, got None"),
        ('{"format": "plr_jax solution", "version": 1}', "missing status, cost, makespan"),
        (b" " * (2**26 + 1), "at most 67,108,864 bytes"),
    ):
        assert_refused(text, message, tmp_path)


def test_scene_and_solution_files_are_told_apart(tmp_path):
    path = tmp_path / "a.json"
    scenes.save(scenes.maze(), path)
    assert_refused(path.read_bytes(), "expected a solution file", tmp_path)
    SOLUTION.save(path)
    with pytest.raises(ValueError, match="expected a scene file"):
        scenes.load(path)


STATS = {**dict.fromkeys(COUNTS, 1), "seconds": {}, "history": [], "found_by": "bl"}
DEEP = {"a": [[[[[]]]]]}


NAN, INF = float("nan"), float("inf")
CONTRADICTIONS = {
    "has version 2, this release reads up to 1: update plr-jax": [{"version": 2}],
    "expected a version number": [{"version": version} for version in (0, 1.0, True, "1", None, [])],
    'expected "status" to be one of SOLVED': [{"status": status} for status in ("solved", 1, None, ["SOLVED"])],
    "must be a finite number of at least 0": [
        *({name: -1} for name in ("cost", "lower_bound")),
        *({"motions_factor": value} for value in (True, "1", [], NAN)),
        *({"cost": value} for value in (INF, NAN, "1", DEEP)),
    ],
    "got null for (cost|makespan|path|times)": [{name: None} for name in ("cost", "makespan", "path", "times")],
    "got null for path, times": [{"path": None, "times": None}],
    'expected "times" from 0 to the makespan 7.5': [{"makespan": 7.5}],
    "path": [{"path": path} for path in ([], [[]], [[[]]], [1, 2], "abc", {}, [[[1, 2]], [[1]]], DEEP)],
    '"path" to be finite': [{"path": [[[1, x]]] * 4} for x in (NAN, INF, None)],
    "2 or 3": [{"path": [[[1.0] * n]] * 4} for n in (1, 4)],
    '"times" to be 3 finite nondecreasing numbers': [{"path": PATH[:3].tolist()}],
    "nondecreasing numbers": [{"times": [0, a, b, 7]} for a, b in ((5, 4), (4, NAN), (8, 8))],
    "times": [{"times": times} for times in ([1, 4, 4, 7], [], 7, "abc", [[0, 4, 4, 7]], [0, 4, 4, {}])],
    'expected "stats" to have the keys': [{"stats": stats} for stats in (None, [], {}, {"num_nodes": 1})],
    "must be an integer >= 0": [{"stats": {**STATS, "num_nodes": n}} for n in (-1, 1.5, True, "1", None)],
    '"seconds"': [{"stats": {**STATS, "seconds": x}} for x in ([], 1, {"a": -1}, {"a": None}, {"a": {}})],
    "history|seconds must|a cost must": [
        {"stats": {**STATS, "history": x}}
        for x in ({}, 1, [1], [[1]], [[1, 2, 3]], [[1, NAN]], [["1", 2]], [[-1, 2]], [[1, None]])
    ],
}


@pytest.mark.parametrize("message", CONTRADICTIONS)
def test_contradicting_file_raises(message, tmp_path):
    SOLUTION.save(tmp_path / "a.json")
    entry = json.loads((tmp_path / "a.json").read_text())
    for changes in CONTRADICTIONS[message]:
        assert_refused(json.dumps({**entry, **changes}), message, tmp_path)


def test_repr_names_status_costs_and_nodes():
    stats = Stats(1234, seconds={"a": 0.5, "b": 1.0})
    text = "Solution(TIME_LIMIT: cost 12.35, makespan 7, lower bound 10, 1,234 nodes, 1.5 s)"
    assert repr(Solution(None, 12.3456, 7.0, 10.0, Status.TIME_LIMIT, stats, PROBLEM.starts[None])) == text
