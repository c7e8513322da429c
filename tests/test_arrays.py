import numpy as np
import pytest

from plr_jax._arrays import (
    as_booleans,
    as_distances,
    as_finite,
    as_finite_point,
    as_number,
    as_numbers,
    as_point,
    as_points,
    as_values,
    padded,
    padded_size,
    require_integer,
    shortened,
)


def test_points_become_float64_rows():
    points = as_points("x", [[1, 2]], 2)
    np.testing.assert_array_equal(points, [[1.0, 2.0]])
    assert points.dtype == np.float64
    assert as_points("x", np.zeros((0, 3)), 3).shape == (0, 3)
    assert as_points("x", np.zeros((4, 7), dtype=np.float32)).shape == (4, 7)
    given = np.array([[np.nan, np.inf]])
    assert as_points("x", given, 2) is given


def test_a_point_becomes_a_float64_vector():
    np.testing.assert_array_equal(as_point("start", (1, np.nan), 2), [1.0, np.nan])
    np.testing.assert_array_equal(as_point("start", [7]), [7.0])


def test_a_finite_point_is_kept_as_it_was_given():
    given = np.array([1.0, 2.0])
    kept = as_finite_point("The goal", given, 2)
    given[0] = 9.0
    np.testing.assert_array_equal(kept, [1.0, 2.0])
    with pytest.raises(ValueError, match="read-only"):
        kept[0] = 9.0


@pytest.mark.parametrize(
    ("value", "dim", "message"),
    [
        ([1, 2], 2, r"x must have shape \(n, 2\), got \(2,\)\. Use x\[None\] for a single point"),
        ([1, 2], None, r"shape \(n, dim\), got \(2,\)\. Use x\[None\]"),
        ([1, 2, 3], 2, r"got \(3,\)\.$"),
        ([[1, 2, 3]], 2, r"shape \(n, 2\), got \(1, 3\)"),
        (np.zeros((4, 0)), None, r"shape \(n, dim\), got \(4, 0\)"),
        (1.0, None, r"got \(\)"),
        ("points", 2, r"x must be numbers of shape \(n, 2\), got 'points'"),
        ([[1, 2], [3]], 2, r"x must be numbers"),
        ([[1j, 2]], 2, r"x must be numbers"),
        (np.array([[1j, 2]]), 2, r"x must be numbers"),
        ([[10**400, 2]], 2, r"x must be numbers"),
    ],
)
def test_what_is_no_batch_of_points_is_refused(value, dim, message):
    with pytest.raises(ValueError, match=message):
        as_points("x", value, dim)


@pytest.mark.parametrize(
    ("value", "dim", "message"),
    [
        ((1, 2, 3), 2, r"The goal must be one point of shape \(2,\), got shape \(3,\)"),
        ([[1, 2]], 2, r"shape \(2,\), got shape \(1, 2\)"),
        (1.0, None, r"shape \(dim,\), got shape \(\)"),
        ([], None, r"shape \(dim,\), got shape \(0,\)"),
        (("a", 0), 2, r"must be numbers of shape \(2,\), got \('a', 0\)"),
        ((1, np.nan), 2, r"finite coordinates, got \[1.0, nan\]"),
        ((1, -np.inf), None, r"finite coordinates, got \[1.0, -inf\]"),
        ((1, None), 2, r"finite coordinates"),
    ],
)
def test_what_is_no_finite_point_is_refused(value, dim, message):
    with pytest.raises(ValueError, match=message):
        as_finite_point("The goal", value, dim)


@pytest.mark.parametrize("value", [-1, 1.0, "1", None, 1 + 0j])
def test_what_is_no_integer_or_too_small_is_refused(value):
    with pytest.raises(ValueError, match="num must be an integer >= 0, got "):
        require_integer("num", value, 0)


@pytest.mark.parametrize("value", [0, 7, np.int64(3), np.uint8(0)])
def test_integers_of_any_type_are_let_through(value):
    require_integer("num", value, 0)


@pytest.mark.parametrize(
    ("n", "sizes", "size"),
    [(0, (), 1), (1, (), 1), (3, (), 4), (4, (), 4), (5, (), 8), (0, (1, 6), 1), (2, (1, 6), 6), (7, (1, 6), 8)],
)
def test_sizes_to_fill_up_to(n, sizes, size):
    assert padded_size(n, sizes) == size


def test_arrays_are_filled_up_with_a_row():
    rows = np.array([[1, 2], [3, 4]], np.int16)
    filled = padded(rows, 4, rows[-1])
    assert filled.dtype == np.int16 and filled.tolist() == [[1, 2], [3, 4], [3, 4], [3, 4]]
    assert padded(rows, 3).tolist() == [[1, 2], [3, 4], [0, 0]]
    assert padded(np.zeros((0, 2, 2)), 1, 7.0).tolist() == [[[7, 7], [7, 7]]]
    assert padded(rows, 2).tolist() == rows.tolist() and padded(rows, 2) is not rows


def test_masked_entries_are_refused_and_a_mask_of_none_is_not():
    with pytest.raises(ValueError, match=r"x must be numbers of shape \(n, 2\), and some are masked"):
        as_points("x", np.ma.masked_array([[1.0, 2.0]], [[False, True]]), 2)
    with pytest.raises(ValueError, match="x must be a number, and some are masked"):
        as_numbers("x", np.ma.masked, "a number")
    assert as_points("x", np.ma.masked_array([[1.0, 2.0]], False), 2).tolist() == [[1, 2]]


def test_values_may_be_anything_but_masked_ones_are_infinite():
    given = np.array([np.nan, -np.inf, 1.0])
    assert as_values("f", given, 3) is given
    masked = np.ma.masked_array([1, 2, 3], [False, True, False])
    for value in (masked, masked.astype(np.float32)):
        values = as_values("f", value, 3)
        assert type(values) is np.ndarray and values.dtype == np.float64
        np.testing.assert_array_equal(values, [1, np.inf, 3])
    np.testing.assert_array_equal(as_values("f", np.ma.masked_all(2), 2), [np.inf, np.inf])


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ([1.0], r"f must give one number a point, shape \(2,\), got \(1,\)"),
        (3.0, r"got \(\)"),
        ([1j, 2], r"f's answer must be real numbers of shape \(2,\)"),
        (np.ma.masked_array([1j, 2], [True, False]), "real numbers"),
        (["a", "b"], "real numbers"),
    ],
)
def test_answers_of_another_kind_are_refused(value, message):
    with pytest.raises(ValueError, match=message):
        as_values("f", value, 2)


def test_booleans_are_one_a_point_and_none_is_masked():
    assert as_booleans("f", [True, False], 2).tolist() == [True, False]
    assert as_booleans("f", np.ma.masked_array([True], [False]), 1).tolist() == [True]
    for value, got in (
        ([1, 0], r"int64 of shape \(2,\)\."),
        ([True], r"bool of shape \(1,\)\."),
        (np.ma.masked_array([True, True], [False, True]), r"bool of shape \(2,\), some masked\."),
    ):
        with pytest.raises(ValueError, match=r"f must return one boolean a point, shape \(2,\), got " + got):
            as_booleans("f", value, 2)


def test_distances_are_never_nan():
    x = np.array([[1.0, 2], [3, 4]])
    np.testing.assert_array_equal(as_distances("f", [-1e-9, np.inf], x), [-1e-9, np.inf])
    np.testing.assert_array_equal(as_distances("f", np.ma.masked_invalid([np.nan, 2]), x), [np.inf, 2])
    for bad, word in ((np.nan, "NaN"), (-np.inf, "-inf")):
        with pytest.raises(ValueError, match=rf"f gives {word} at \[3.0, 4.0\]; use inf"):
            as_distances("f", [0, bad], x)


def test_what_an_error_shows_is_short_and_says_what_came():
    assert shortened({"a": [1, 2.5, "x"]}) == "{'a': [1, 2.5, 'x']}"
    for huge in (list(range(10**6)), "x" * 10**6, 10**400, {i: [i] * 9 for i in range(999)}, np.zeros((99, 99))):
        assert 3 <= len(shortened(huge)) <= 200
    assert shortened([1] * 9).startswith("[1, 1, 1, ")
    assert shortened(10**5000) == "a very large int"


def test_the_text_of_a_value_whose_lists_share_their_parts_is_never_built():
    value = ["parts"]
    for _ in range(60):  # 2**60 entries
        value = [value, value]
    assert len(shortened(value)) <= 200


@pytest.mark.parametrize("value", [-1, np.nan, np.inf, "1", None, True, 1j, 10**400, [1.0]])
def test_a_number_that_is_not_finite_or_too_small_is_named(value):
    with pytest.raises(ValueError, match="radius must be a finite number of at least 0, got "):
        as_finite("radius", value)


def test_a_finite_number_is_a_float():
    assert as_finite("radius", np.float32(0.5)) == 0.5 and as_finite("radius", 0) == 0.0
    with pytest.raises(ValueError, match="positive finite number, got 0"):
        as_finite("radius", 0, positive=True)


@pytest.mark.parametrize(
    "value", [0, 1.0, -0.1, np.nan, True, np.bool_(True), np.complex128(0.5), "x", [0.5], 10**400]
)
def test_a_number_out_of_its_range_is_named(value):
    with pytest.raises(ValueError, match="share must be between 0 and 1, got "):
        as_number("share", value, "between 0 and 1", lambda share: 0 < share < 1)


def test_the_ends_of_a_range_belong_to_it_as_the_range_says():
    assert as_number("share", 1, "from 0 to 1", lambda share: 0 <= share <= 1) == 1.0
    assert as_number("limit", np.inf, "positive", lambda limit: limit > 0) == np.inf


def test_a_truth_value_is_no_integer():
    with pytest.raises(ValueError, match="seed must be an integer >= 0, got True"):
        require_integer("seed", True, 0)
