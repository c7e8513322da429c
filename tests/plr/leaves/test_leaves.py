import pytest

from plr_jax.plr import Continuous, Plane
from plr_jax.plr.leaves import code_of_leaf, leaf_model, leaf_of_code

MODELS = [("plane", 0, Plane()), ("continuous", 1, Continuous(order=0)), ("smooth", 2, Continuous(order=1))]


@pytest.mark.parametrize(("name", "code", "model"), MODELS)
def test_every_model_has_a_name_and_a_code_that_stay(name, code, model):
    assert leaf_model(name) == leaf_of_code(code) == leaf_model(model) == model
    assert code_of_leaf(model) == code and model.name == name


def test_options_of_a_model_do_not_change_its_code():
    assert code_of_leaf(Plane(coefficient_bits=16)) == 0
    assert leaf_model(Plane(coefficient_bits=16)).coefficient_bits == 16


def test_what_is_no_model_is_refused():
    unchecked = getattr(leaf_model, "__wrapped__", leaf_model)
    with pytest.raises(ValueError, match="one of 'plane', 'continuous', 'smooth', 'cone', got 'cubic'"):
        leaf_model("cubic")
    with pytest.raises(ValueError, match=r"leaf must be a leaf model or its name, one of 'plane', .*, got 7"):
        unchecked(7)
    with pytest.raises(ValueError, match="it has leaves of kind 4, this release knows kinds 0 to 3"):
        leaf_of_code(4)


def test_models_are_hashable_and_equal_where_their_options_are():
    """Compiled queries are told apart by them."""
    assert len({Plane(), Plane(), Plane(coefficient_bits=8), Continuous(), Continuous(order=0)}) == 3
