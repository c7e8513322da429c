import numpy as np
import pytest

from plr_jax.cli._inputs import parse_goal


@pytest.mark.parametrize("text", ["", "1", "1,2,3", "1,x", "nan,1", "inf,1"])
def test_a_goal_is_two_finite_numbers(text):
    with pytest.raises(ValueError, match="--goal must be two numbers"):
        parse_goal(text)
    np.testing.assert_array_equal(parse_goal("1, -2.5e1"), [1, -25])
