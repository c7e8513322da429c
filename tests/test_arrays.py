import numpy as np
import pytest

from plr_jax import _arrays


def masked(values, mask=False):
    return np.ma.masked_array(values, mask)


SHARE = ("between 0 and 1", lambda share: 0 < share < 1)
FAR = np.array([[1.0, 2], [3, 4]])


def test_wrong_value_raises():
    for function, arguments, values, message in [
        ("as_points", [2], [[1, 2]], r"x must have shape \(n, 2\), got \(2,\)\. Use x\[None\] for a single point"),
        ("as_points", [2], [[1, 2, 3]], r"got \(3,\)\.$"),
        ("as_points", [2], [np.zeros((2, 5))], r"got \(2, 5\)\. Use x\.T for rows of points"),
        ("as_points", [2], [np.zeros((2, 3))], r"got \(2, 3\)\.$"),  # two points of a volume
        ("as_points", [2], [[[1, 2, 3]]], r"shape \(n, 2\), got \(1, 3\)"),
        ("as_points", [], [np.zeros((4, 0))], r"shape \(n, dim\), got \(4, 0\)"),
        ("as_points", [2], ["points"], r"x must be numbers of shape \(n, 2\), got 'points'"),
        ("as_points", [2], [[[1, 2], [3]], [[1j, 2]], np.array([[1j, 2]]), [[10**400, 2]]], "x must be numbers"),
        ("as_points", [2], [masked([[1.0, 2.0]], [[0, 1]])], r"numbers of shape \(n, 2\), and some are masked"),
        ("as_numbers", ["a number"], [np.ma.masked], "x must be a number, and some are masked"),
        ("as_finite_point", [2], [(1, 2, 3)], r"x must be one point of shape \(2,\), got shape \(3,\)"),
        ("as_finite_point", [], [1.0], r"shape \(dim,\), got shape \(\)"),
        ("as_finite_point", [], [[]], r"shape \(dim,\), got shape \(0,\)"),
        ("as_finite_point", [2], [("a", 0)], r"must be numbers of shape \(2,\), got \('a', 0\)"),
        ("as_finite_point", [2], [(1, np.nan)], r"finite coordinates, got \[1.0, nan\]"),
        ("as_finite_point", [], [(1, -np.inf), (1, None)], "finite coordinates"),
        ("require_integer", [0], [-1, 1.0, "1", None, 1 + 0j, True], "x must be an integer >= 0, got "),
        ("as_values", [2], [[1.0]], r"x must give one number per point, shape \(2,\), got \(1,\)"),
        ("as_values", [2], [[1j, 2]], r"x's answer must be real numbers of shape \(2,\)"),
        ("as_values", [2], [masked([1j, 2], [True, False]), ["a", "b"]], "real numbers"),
        ("as_booleans", [2], [[1, 0]], r"one boolean per point, shape \(2,\), got int64 of shape \(2,\)\."),
        ("as_booleans", [2], [[True]], r"bool of shape \(1,\)\."),
        ("as_booleans", [1], [masked([True], [True])], r"bool of shape \(1,\), some masked\."),
        ("as_distances", [FAR], [[0, np.nan]], r"x gives NaN at \[3.0, 4.0\]; use inf"),
        ("as_distances", [FAR], [[0, -np.inf]], r"x gives -inf at \[3.0, 4.0\]; use inf"),
        ("as_finite", [], [-1, np.nan, np.inf, "1", None, True], "x must be a finite number of at least 0, got "),
        ("as_finite", [], [1j, 10**400, [1.0]], "x must be a finite number of at least 0, got "),
        ("as_number", SHARE, [0, 1.0, -0.1, np.nan, True, np.bool_(True)], "x must be between 0 and 1, got "),
        ("as_number", SHARE, [np.complex128(0.5), "x", [0.5], 10**400], "x must be between 0 and 1, got "),
    ]:
        for value in values:
            with pytest.raises(ValueError, match=message):
                getattr(_arrays, function)("x", value, *arguments)


def test_points_become_float64_without_needless_copy():
    points = _arrays.as_points("x", [[1, 2]], 2)
    np.testing.assert_array_equal(points, [[1.0, 2.0]])
    assert points.dtype == np.float64
    assert _arrays.as_points("x", np.zeros((0, 3)), 3).shape == (0, 3)
    assert _arrays.as_points("x", np.zeros((4, 7), dtype=np.float32)).shape == (4, 7)
    given = np.array([[np.nan, np.inf]])
    assert _arrays.as_points("x", given, 2) is given
    assert _arrays.as_points("x", masked([[1.0, 2.0]]), 2).tolist() == [[1, 2]]
    np.testing.assert_array_equal(_arrays.as_point("start", (1, np.nan), 2), [1.0, np.nan])
    np.testing.assert_array_equal(_arrays.as_point("start", [7]), [7.0])


def test_finite_point_is_copied_read_only():
    given = np.array([1.0, 2.0])
    kept = _arrays.as_finite_point("The goal", given, 2)
    given[0] = 9.0
    np.testing.assert_array_equal(kept, [1.0, 2.0])
    with pytest.raises(ValueError, match="read-only"):
        kept[0] = 9.0


def test_numbers_of_any_type_in_range_pass():
    for value in (0, 7, np.int64(3), np.uint8(0)):
        _arrays.require_integer("num", value, 0)
    with pytest.raises(ValueError, match="positive finite number, got 0"):
        _arrays.as_finite("radius", 0, positive=True)
    assert _arrays.as_finite("radius", np.float32(0.5)) == 0.5 and _arrays.as_finite("radius", 0) == 0.0
    assert _arrays.as_number("share", 1, "from 0 to 1", lambda share: 0 <= share <= 1) == 1.0
    assert _arrays.as_number("limit", np.inf, "positive", lambda limit: limit > 0) == np.inf


def test_padded_size_is_given_or_power_of_two():
    assert [_arrays.padded_size(n, ()) for n in (0, 1, 3, 4, 5)] == [1, 1, 4, 4, 8]
    assert [_arrays.padded_size(n, (1, 6)) for n in (0, 2, 7)] == [1, 6, 8]


def test_batches_have_all_rows_in_order():
    for rows in ([], [*"abcdefg"], np.arange(6)):
        parts = [*_arrays.batches(rows, 3)]
        assert [row for part in parts for row in part] == [*rows]
        assert all(len(part) == 3 for part in parts[:-1]) and all(0 < len(part) <= 3 for part in parts[-1:])


def test_masked_values_become_infinite():
    given = np.array([np.nan, -np.inf, 1.0])
    assert _arrays.as_values("f", given, 3) is given
    some = masked([1, 2, 3], [False, True, False])
    for value in (some, some.astype(np.float32)):
        values = _arrays.as_values("f", value, 3)
        assert type(values) is np.ndarray and values.dtype == np.float64
        np.testing.assert_array_equal(values, [1, np.inf, 3])
    np.testing.assert_array_equal(_arrays.as_values("f", np.ma.masked_all(2), 2), [np.inf, np.inf])
    x = np.zeros((2, 2))
    np.testing.assert_array_equal(_arrays.as_distances("f", [-1e-9, np.inf], x), [-1e-9, np.inf])
    np.testing.assert_array_equal(_arrays.as_distances("f", np.ma.masked_invalid([np.nan, 2]), x), [np.inf, 2])
    assert _arrays.as_booleans("f", [True, False], 2).tolist() == [True, False]
    assert _arrays.as_booleans("f", masked([True], [False]), 1).tolist() == [True]


def test_shortened_value_has_at_most_200_characters():
    assert _arrays.shortened({"a": [1, 2.5, "x"]}) == "{'a': [1, 2.5, 'x']}"
    shared = ["parts"]
    for _ in range(60):  # 2**60 entries, whose text must not be built
        shared = [shared, shared]
    huge = (list(range(10**6)), "x" * 10**6, 10**400, {i: [i] * 9 for i in range(999)}, np.zeros((99, 99)), shared)
    assert all(3 <= len(_arrays.shortened(value)) <= 200 for value in huge)
    assert _arrays.shortened([1] * 9).startswith("[1, 1, 1, ")
    assert _arrays.shortened(10**5000) == "a very large int"


def test_deadline_without_enough_time_raises(monkeypatch):
    monkeypatch.setattr(_arrays.time, "perf_counter", lambda: 100.0)
    _arrays.require_time(float("inf"), "it was done", 1e300)
    _arrays.require_time(1100.0, "it was done", 1000.0)
    with pytest.raises(TimeoutError, match=r"^The deadline passed before it was done\.$"):
        _arrays.require_time(1100.0, "it was done", 1000.5)
    _arrays.require_time(100.0, "it was done")
    with pytest.raises(TimeoutError):
        _arrays.require_time(99.5, "it was done")


def test_misspelled_choice_gets_a_suggestion():
    for value, message in [
        ("Nearst", r"^mode must be 'bilinear', 'nearest' or 4, got 'Nearst'\. Did you mean 'nearest'\?$"),
        ("4", r"Did you mean 4\?$"),
        (np.array(["nearest", "x"]), "got array"),
        ("?", r"^mode must be 'bilinear', 'nearest' or 4, got '\?'\.$"),
        (True, "got True"),
        (8, r"got 8\.$"),
        (["nearest"], "got "),
        (None, r"got None\.$"),
    ]:
        with pytest.raises(ValueError, match=message):
            _arrays.require_choice("mode", value, ("bilinear", "nearest", 4))
    for value in (np.int64(4), 4.0, np.array(4)):
        _arrays.require_choice("mode", value, ("bilinear", "nearest", 4))


def test_integers_and_single_items_get_advice():
    with pytest.raises(ValueError, match=r"max_bytes must be an integer >= 1, got 1000\.0\. Use 1000\.$"):
        _arrays.require_integer("max_bytes", 1e3, 1)
    with pytest.raises(ValueError, match=r"got 0\.5\.$"):
        _arrays.require_integer("max_bytes", 0.5, 1)
    with pytest.raises(ValueError, match="Put a single one into a list"):
        _arrays.as_list("oracles", len, "functions", callable)
