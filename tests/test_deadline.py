import time

import pytest

from plr_jax._deadline import deadline_after, require_time


def test_an_infinite_limit_never_ends():
    assert deadline_after(float("inf")) == float("inf")
    require_time(float("inf"), "it was done", 1e300)


@pytest.mark.parametrize("time_limit", [0, -1.0, float("nan"), "1", None, True])
def test_a_limit_is_a_positive_number(time_limit):
    with pytest.raises(ValueError, match="time_limit must be a positive number or inf, got"):
        deadline_after(time_limit)


def test_what_is_needed_must_be_left():
    deadline = deadline_after(1000.0)
    assert 999 < deadline - time.perf_counter() <= 1000
    require_time(deadline, "it was done", 900.0)
    with pytest.raises(TimeoutError, match=r"^The deadline passed before it was done\.$"):
        require_time(deadline, "it was done", 1001.0)
    with pytest.raises(TimeoutError):
        require_time(time.perf_counter() - 1.0, "it was done")
