"""Options of the planner that make no sense are refused."""

import pytest

from plr_jax import BLOptions


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"step": 0.0}, "step must be None or a positive finite number, got 0.0"),
        ({"step": float("inf")}, "step must be None or a positive"),
        ({"cell_size": -1.0}, "cell_size must be None or a positive"),
        ({"lower_bound": float("nan")}, "lower_bound must be None or a positive"),
        ({"heuristic_weight": -0.1}, "heuristic_weight must be .* from 0 to 1e6, got -0.1"),
        ({"heuristic_weight": float("inf")}, "heuristic_weight must be"),
        ({"heuristic_weight": 1e300}, "heuristic_weight must be"),
        ({"time_limit": 10**400}, "time_limit must be"),
        ({"step": 10**400}, "step must be"),
        *(({"searchers": other}, "searchers must be some of") for other in (5, [[]], iter(["bl"]), None)),
        ({"batch": 0}, "batch must be an integer of at least 1, got 0"),
        ({"branching": -3}, "branching must be an integer of at least 1, got -3"),
        ({"width": True}, "width must be an integer"),
        ({"cost_factor": 0.0}, "cost_factor must be a positive number or inf"),
        ({"time_limit": -5.0}, "time_limit must be a positive number or inf, got -5.0"),
        ({"time_limit": float("nan")}, "time_limit must be a positive"),
        ({"max_expansions": 0.0}, "max_expansions must be a positive"),
        ({"max_memory": 0.0}, "max_memory must be a positive"),
        ({"searchers": ()}, "searchers must be some of"),
        ({"searchers": "bl"}, "searchers must be some of"),
        ({"primitives": ()}, "primitives must be distinct offsets"),
        ({"primitives": ((1, 0, 0), (1, 0, 0))}, "primitives must be distinct"),
        ({"primitives": ((0, 0, 0), (1, 0, 0))}, r"none of them \(0, 0, 0\)"),
        ({"primitives": tuple((k, 0, 0) for k in range(1, 256))}, "integers, 1 to 254"),
    ],
    ids=lambda value: str(value)[:40] if isinstance(value, dict) else "",
)
@pytest.mark.usefixtures("unchecked_types")
def test_options_that_make_no_sense(options, message):
    with pytest.raises(ValueError, match=message):
        BLOptions(**options)
