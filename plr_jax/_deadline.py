"""Ends of time limits, on the clock of ``time.perf_counter``."""

import time

from plr_jax._arrays import as_number


def deadline_after(time_limit: object) -> float:
    """The end of so many seconds, ``inf`` for no end."""
    return time.perf_counter() + as_number(
        "time_limit", time_limit, "a positive number or inf", lambda number: number > 0
    )


def require_time(deadline: float, purpose: str, seconds: float = 0.0) -> None:
    """Raise ``TimeoutError`` if so many seconds are not left before a deadline.

    Args:
        deadline: The time that must not be passed.
        purpose: What is not done if it is, as the message says after "before".
        seconds: How long what follows takes that cannot be cut short.
    """
    if time.perf_counter() + seconds > deadline:
        raise TimeoutError(f"The deadline passed before {purpose}.")
