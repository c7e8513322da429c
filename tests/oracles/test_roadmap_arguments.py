"""Arguments of a roadmap that make no sense are refused, saying what to do."""

import numpy as np
import pytest
from jaxtyping import TypeCheckError
from oracle_helpers import CUT, NOTHING, UNIT, roadmap

from plr_jax.oracles import Roadmap


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"goal": (0.5, 0.5)}, "not free; move it"),
        ({"goal": (1.5, 0.5)}, "outside the domain.*move it inside"),
        ({"goal": (np.nan, 0.5)}, "finite coordinates"),
        ({"goal": ("a", 0)}, "The goal must be numbers"),
        ({"domain": (0, 1)}, "Box lo must be one point"),
        ({"domain": 3.0}, "The domain must be a Box"),
        ({"goal": (0.1, 0.1, 0.1)}, r"shape \(2,\)"),
        ({"num_samples": 0}, "num_samples"),
        ({"is_visible": None}, "Give either is_visible"),
        ({"resolution": 0.1}, "Give either is_visible"),
        ({"is_visible": None, "resolution": 0.0}, "resolution must be a positive finite number"),
        ({"is_visible": None, "resolution": np.nan}, "resolution must be a positive finite number"),
        ({"is_visible": lambda a, b: np.ones((len(a), 1), bool)}, "is_visible must return one boolean"),
        ({"is_visible": lambda a, b: True}, "is_visible must return one boolean"),
        ({"is_visible": lambda a, b: np.ma.masked_equal(a[:, 0] < 2, True)}, "is_visible .* some masked"),
    ],
)
def test_bad_arguments_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        roadmap(CUT, **{"goal": (0.1, 0.1), **change})


def test_a_fractional_number_of_samples_is_refused():
    with pytest.raises((ValueError, TypeCheckError), match="num_samples"):
        roadmap(NOTHING, num_samples=1e3)


@pytest.mark.parametrize("answer", [lambda x: np.ones(len(x)), lambda x: x > 0, lambda x: np.True_, lambda x: None])
def test_a_test_that_does_not_answer_one_boolean_a_point_is_refused(answer):
    with pytest.raises(ValueError, match="is_free must return one boolean"):
        Roadmap(UNIT, answer, (0.1, 0.1), 10, resolution=0.1)


@pytest.mark.parametrize("x", [[0.1, 0.2], [[0.1, 0.2, 0.3]], 0.5, [[[0.1, 0.2]]]])
def test_points_of_the_wrong_shape_are_refused(x):
    with pytest.raises(ValueError, match=r"shape \(n, 2\)"):
        roadmap(NOTHING, num_samples=10)(x)


def test_a_start_of_the_wrong_shape_is_refused():
    with pytest.raises(ValueError, match=r"shape \(2,\)"):
        roadmap(NOTHING, num_samples=10).shortest_path([[0.1, 0.2]])
