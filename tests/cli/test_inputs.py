import numpy as np
import pytest

from plr_jax.cli._inputs import numbers_of, parse_goal


@pytest.mark.parametrize("text", ["", "1", "1,2,3", "1,x", "nan,1", "inf,1", "1_0,2", "1,2_000", "1e400,1"])
def test_a_goal_is_two_finite_numbers(text):
    with pytest.raises(ValueError, match="--goal must be two numbers"):
        parse_goal(text)
    np.testing.assert_array_equal(parse_goal("1, -2.5e1"), [1, -25])


@pytest.mark.parametrize(
    ("text", "numbers"),
    [
        ("1,-2.5e-1", [1, -0.25]),
        (" +.5 ,\t3.\r", [0.5, 3]),
        ("-inf,Infinity,1E400", [-np.inf, np.inf, np.inf]),
        ("nan,-NaN", [np.nan, np.nan]),
        ("1_0", []),
        ("1,1_0", []),
        ("\N{ARABIC-INDIC DIGIT ONE}", []),
        ("\N{NO-BREAK SPACE}1", []),
        ("0x10", []),
        ("1,", []),
        ("1 2", []),
        (".", []),
        ("e5", []),
        ("", []),
        ("1" * 100_000 + "x", []),  # which is not tried in every way
    ],
)
def test_numbers_are_decimal(text, numbers):
    np.testing.assert_array_equal(numbers_of(text), numbers)
