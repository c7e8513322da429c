"""Files that hold all distances of a map, at equal bytes: ours, and whatever else tells the distance of two points.

Every section is a rival on a map, written as soon as it is measured; ``--only arena_network`` measures it again and
keeps the others as they are. What a rival does is told in its file in ``experiments/summaries/``, or below. All are
given exact distances as often as they ask, and as many settings as their file says, of which the best is chosen on
pairs that are neither those of training nor those of the test. The test pairs are the same for all
(``experiments/summaries/_given.py``).
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np

from experiments._runner import Section, run
from experiments.benchmarks._timing import interleaved
from experiments.summaries import _fastmap, _landmarks, _network, _node_tables
from experiments.summaries._given import (
    Candidates,
    Given,
    Pairs,
    Points,
    Summary,
    compiled,
    exact_of,
    pairs_of,
    published,
    straight,
)
from plr_jax import VisibilityGraph, construct_metric_pairs, construct_pairs

MAX_BYTES = {"maze": 1_024, "arena": 32_768, "den312d": 65_536, "den520d": 1_200_000}
_SMOKE_MAP = "maze"
TOLERANCE = 1e-4  # of the mean distance, by which an answer is below or above the truth
_FAST_PAIRS, _SLOW_PAIRS = 1_000_000, 20_000
_TURNS, _SECONDS_A_TURN = 5, 0.1


@dataclass(frozen=True)
class OnMap:
    """A rival on a map, as a section.

    Args:
        map_name: Name of the map.
        name: What the rival is called.
        candidates: What it makes of what it is given, one setting after the other.
        compiled: Whether its answers are compiled by JAX as a whole.
    """

    map_name: str
    name: str
    candidates: Callable[[Given], Candidates]
    compiled: bool = True

    def measure(self, seed: int, smoke: bool) -> dict[str, Any]:
        """Bytes, errors and times of the best setting."""
        name, results = self.map_name, {"map": self.map_name, "rival": self.name, "compiled": self.compiled}
        exact = None if smoke and name != _SMOKE_MAP else exact_of(name)
        if exact is None:
            return results | {"rows": []}
        given = Given(exact, MAX_BYTES[name], pairs_of(name, "training", seed, smoke), seed, smoke)
        test = pairs_of(name, "test", seed, smoke).first(_FAST_PAIRS if self.compiled else _SLOW_PAIRS)
        best = self._best(given, pairs_of(name, "choice", seed, smoke))
        return results | {"rows": [self._row(best, test, published(name))]}

    def _best(self, given: Given, choice: Pairs) -> dict[str, Any]:
        """Make all settings, and return the one that errs least on pairs kept for this choice."""
        made, began = [], time.perf_counter()
        for setting, summary in self.candidates(given):
            if summary.num_bytes > given.max_bytes:
                raise ValueError(f"{setting}: {summary.num_bytes:,} bytes, of at most {given.max_bytes:,}")
            error = np.abs(_answers(summary, choice) - choice.distance).mean()
            made.append({"setting": setting, "summary": summary, "on_choice": float(error)})
        best = min(made, key=lambda each: each["on_choice"])
        return best | {"settings": len(made), "build": time.perf_counter() - began}

    def _row(self, made: dict[str, Any], test: Pairs, listed: Pairs | None) -> dict[str, Any]:
        summary = made.pop("summary")
        x, y = (jnp.asarray(end, jnp.float32) if self.compiled else end for end in (test.x, test.y))
        row = made | {"bytes": int(summary.num_bytes)} | errors(_answers(summary, test), test.distance)
        seconds = interleaved({"": lambda: summary(x, y)}, _TURNS, _SECONDS_A_TURN)[""]
        row["nanoseconds"] = 1e9 * seconds.median / len(test.x)
        if listed is not None:
            relative = np.abs(_answers(summary, listed) / listed.distance - 1)
            row["published"] = {"mean": float(relative.mean()), "max": float(relative.max())}
        return row


def _answers(summary: Summary, pairs: Pairs) -> np.ndarray:
    return np.asarray(summary(pairs.x, pairs.y), float)


def errors(answer: np.ndarray, distance: np.ndarray) -> dict[str, float]:
    """Mean and largest error, and how often it is below and above the truth by more than nothing."""
    error, mean = answer - distance, distance.mean()
    return {
        "pairs": len(error),
        "mean": float(np.abs(error).mean()),
        "largest": float(np.abs(error).max()),
        "share": float(np.abs(error).mean() / mean),
        "below": float((error < -TOLERANCE * mean).mean()),
        "above": float((error > TOLERANCE * mean).mean()),
    }


# Our file of all pairs: ``construct_pairs``.


def ours(given: Given) -> Candidates:
    """The file of at most so many bytes."""
    yield "", construct_pairs(given.workspace, max_bytes=given.max_bytes)


# A PLR over pairs of points, from samples: ``construct_metric_pairs``, which needs no polygons.

_MOST_LEAVES = {False: 5_000, True: 50}  # each asks for hundreds of exact distances


def over_pairs(given: Given) -> Candidates:
    """One for each kind of leaf that may be of four dimensions."""
    for leaf in ("plane", "continuous"):
        pairs = construct_metric_pairs(
            given.exact.between,
            given.workspace.bounds,
            leaf=leaf,
            max_bytes=given.max_bytes,
            max_leaves=_MOST_LEAVES[given.smoke],
            seed=given.seed,
        )
        yield f"{leaf}, {pairs.plr.num_leaves:,} leaves", pairs


# The straight line, which takes no bytes: what the others have to be better than.


def straight_line(given: Given) -> Candidates:
    """The one there is."""
    yield "", compiled(0, straight)


# The polygon itself: 4 bytes a vertex and the exact oracle. What is derived when the file is loaded is not counted.


@dataclass(frozen=True)
class Polygon:
    """The exact distances between points of a map."""

    exact: VisibilityGraph

    @property
    def num_bytes(self) -> int:
        """Bytes of the vertices, of two 16-bit coordinates."""
        return 4 * len(self.exact.workspace.boundary.vertices)

    def __call__(self, x: Points, y: Points) -> np.ndarray:
        """Distances of pairs."""
        return self.exact.between(x, y)


def polygon(given: Given) -> Candidates:
    """Yield the exact oracle."""
    yield "VisibilityGraph.between", Polygon(given.exact)


COMPILED = {
    "ours": ours,
    "product_plr": over_pairs,
    "straight_line": straight_line,
    "full_table": _node_tables.full_table,
    "landmark_tables": _landmarks.tables,
    "landmark_plrs": _landmarks.plrs,
    "fastmap": _fastmap.candidates,
    "network": _network.candidates,
}
SECTIONS = {
    f"{name}_{rival.name}": Section(rival.measure)
    for name in MAX_BYTES
    for rival in (
        *(OnMap(name, rival, candidates) for rival, candidates in COMPILED.items()),
        OnMap(name, "polygon", polygon, compiled=False),
    )
}

if __name__ == "__main__":
    run("compare_summaries", __doc__, SECTIONS)
