"""Of many places to go next, the most promising ones in sight: tested best first, so that few tests are needed."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float, Int

_CHUNK = 1 << 20  # pairs of a point and a place held at a time

Sees = Callable[[Int[np.ndarray, "pairs"], Int[np.ndarray, "pairs"]], Bool[np.ndarray, "pairs"]]
"""Visibility, for pairs of a point and a place, by index."""


def best_in_sight(
    scores: Callable[[slice], Float[np.ndarray, "rows places"]], n: int, num_places: int, count: int, sees: Sees
) -> Int[np.ndarray, "n count"]:
    """The places of lowest score that each point sees.

    Args:
        scores: Scores of all places from a run of points; not finite where a place is no option.
        n: Number of points.
        num_places: Number of places.
        count: How many places to find for each point.
        sees: Visibility.

    Returns:
        The places, lowest score first; -1 where a point sees fewer.
    """
    found = np.full((n, count), -1)
    step = max(1, _CHUNK // num_places)
    for begin in range(0, n, step):
        rows = slice(begin, min(begin + step, n))
        found[rows] = _search(scores(rows), count, lambda row, place, begin=begin: sees(begin + row, place))
    return found


def _search(scores: Float[np.ndarray, "n places"], count: int, sees: Sees) -> Int[np.ndarray, "n count"]:
    """Tests the ``count`` best places of every point, then twice as many of the next ones of those still short."""
    found, num_found = np.full((len(scores), count), -1), np.zeros(len(scores), int)
    scores = np.where(np.isfinite(scores), scores, np.inf)
    pending, num_tests = np.arange(len(scores)), count
    while pending.size:
        tests = _lowest(scores, num_tests)
        score = np.take_along_axis(scores, tests, axis=1)
        row, column = np.nonzero(np.isfinite(score))
        visible = np.zeros(tests.shape, bool)
        visible[row, column] = sees(pending[row], tests[row, column])
        rank = num_found[pending, None] + np.cumsum(visible, axis=1)
        row, column = np.nonzero(visible & (rank <= count))
        found[pending[row], rank[row, column] - 1] = tests[row, column]
        num_found[pending] = rank[:, -1]
        more = (rank[:, -1] < count) & np.isfinite(score[:, -1])
        np.put_along_axis(scores, tests, np.inf, axis=1)
        pending, scores, num_tests = pending[more], scores[more], 2 * num_tests
    return found


def _lowest(scores: Float[np.ndarray, "n places"], count: int) -> Int[np.ndarray, "n tests"]:
    """Columns of the lowest scores of each row, ascending."""
    if count >= scores.shape[1]:
        return np.argsort(scores, axis=1, kind="stable")
    if count == 1:
        return scores.argmin(axis=1)[:, None]
    columns = np.sort(np.argpartition(scores, count - 1, axis=1)[:, :count], axis=1)
    order = np.argsort(np.take_along_axis(scores, columns, axis=1), axis=1, kind="stable")
    return np.take_along_axis(columns, order, axis=1)
