"""The search that a query of a graph oracle makes: of many ways on, the shortest whose first leg is free."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float, Int


def first_visible(
    lengths: Float[np.ndarray, "n ways"],
    sees: Callable[[Int[np.ndarray, "pairs"], Int[np.ndarray, "pairs"]], Bool[np.ndarray, "pairs"]],
) -> tuple[Int[np.ndarray, "n"], Float[np.ndarray, "n"]]:
    """The shortest visible way of each point.

    Tests the two shortest ways of every point, then the 8, 32, ... next ones of those still without: it finds
    what a test of all pairs would find, with few tests where the shortest are visible.

    Args:
        lengths: Length of each way from each point; NaN where there is none to test, ``inf`` where one leads
            nowhere.
        sees: Visibility, for pairs of a point and a way.

    Returns:
        The index of the way, -1 where none is visible, and its length, ``inf`` where none is.
    """
    way, shortest = np.full(len(lengths), -1), np.full(len(lengths), np.inf)
    pending, num_tests = np.arange(len(lengths)), 2
    while pending.size and lengths.shape[1]:
        tests = _shortest(lengths, num_tests)
        length = lengths[np.arange(len(lengths))[:, None], tests]
        row, column = np.nonzero(~np.isnan(length))
        visible = np.zeros(tests.shape, dtype=bool)
        visible[row, column] = sees(pending[row], tests[row, column])
        found, best = visible.any(axis=1), visible.argmax(axis=1)
        way[pending[found]] = tests[found, best[found]]
        shortest[pending[found]] = length[found, best[found]]
        more = ~found & ~np.isnan(length[:, -1])
        pending, lengths = pending[more], lengths[more]
        lengths[np.arange(len(lengths))[:, None], tests[more]] = np.nan
        num_tests *= 4
    return way, shortest


def _shortest(lengths: Float[np.ndarray, "n ways"], count: int) -> Int[np.ndarray, "n tests"]:
    """Columns of the smallest entries of each row, ascending, NaN last."""
    if count >= lengths.shape[1]:
        return np.argsort(lengths, axis=1)
    rows = np.arange(len(lengths))[:, None]
    columns = np.argpartition(lengths, count - 1, axis=1)[:, :count]
    return columns[rows, np.argsort(lengths[rows, columns], axis=1)]
