import pytest

from plr_jax import _arrays
from plr_jax._arrays import deadline_after, require_time


@pytest.mark.parametrize("time_limit", [0, -1.0, float("nan"), "1", None, True])
def test_a_limit_is_a_positive_number(time_limit):
    with pytest.raises(ValueError, match="time_limit must be a positive number or inf, got"):
        deadline_after(time_limit)


def test_what_is_needed_must_be_left(monkeypatch):
    monkeypatch.setattr(_arrays.time, "perf_counter", lambda: 100.0)
    assert deadline_after(float("inf")) == float("inf")
    require_time(float("inf"), "it was done", 1e300)
    deadline = deadline_after(1000.0)
    assert deadline == 1100.0
    require_time(deadline, "it was done", 1000.0)
    with pytest.raises(TimeoutError, match=r"^The deadline passed before it was done\.$"):
        require_time(deadline, "it was done", 1000.5)
    require_time(100.0, "it was done")
    with pytest.raises(TimeoutError):
        require_time(99.5, "it was done")
