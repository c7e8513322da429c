"""What is measured of a rival on a map: the section of an experiment."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from experiments._tables import aligned, or_dash
from experiments.summaries._summary import Candidates, Given, Pairs, Summary
from experiments.summaries._truth import exact_of, pairs_of, published

MAX_BYTES = {"maze": 1_024, "arena": 32_768, "den312d": 65_536, "den520d": 1_200_000}
_SMOKE_MAP = "maze"
TOLERANCE = 1e-4  # of the mean distance, by which an answer is below or above the truth
_FAST_PAIRS, _SLOW_PAIRS = 1_000_000, 20_000
_TIMED_SECONDS, _MOST_CALLS = 5.0, 15


@dataclass(frozen=True)
class OnMap:
    """A rival on a map, as a section.

    Args:
        map_name: Name of the map.
        name: What the rival is called.
        candidates: What it makes of what it is given, one setting after the other.
        compiled: Whether its answers are compiled by JAX as a whole.
        every: Whether each setting is a row of its own; else only the best, on pairs of its own.
    """

    map_name: str
    name: str
    candidates: Callable[[Given], Candidates]
    compiled: bool = True
    every: bool = False

    def measure(self, seed: int, smoke: bool) -> dict[str, Any]:
        name, results = self.map_name, {"map": self.map_name, "rival": self.name, "compiled": self.compiled}
        exact = None if smoke and name != _SMOKE_MAP else exact_of(name)
        if exact is None:
            return results | {"rows": []}
        given = Given(exact, MAX_BYTES[name], pairs_of(name, "training", seed, smoke), seed, smoke)
        test = pairs_of(name, "test", seed, smoke).first(_FAST_PAIRS if self.compiled else _SLOW_PAIRS)
        made = self._made(given, pairs_of(name, "choice", seed, smoke))
        results |= {"rows": [self._row(each, test, published(name)) for each in made]}
        print(self.table(results), flush=True)
        return results

    def table(self, results: dict[str, Any]) -> str:
        return aligned(_cells(results["rows"]), _NUMBERS)

    def _made(self, given: Given, choice: Pairs) -> list[dict[str, Any]]:
        made, began = [], time.perf_counter()
        for setting, summary in self.candidates(given):
            if summary.num_bytes > given.max_bytes:
                raise ValueError(f"{setting}: {summary.num_bytes:,} bytes, of at most {given.max_bytes:,}")
            error = np.abs(_answers(summary, choice) - choice.distance).mean()
            made.append({"setting": setting, "summary": summary, "on_choice": float(error)})
        tried = {"settings": len(made), "build": time.perf_counter() - began}
        chosen = made if self.every else sorted(made, key=lambda each: each["on_choice"])[:1]
        return [each | tried for each in chosen]

    def _row(self, made: dict[str, Any], test: Pairs, listed: Pairs | None) -> dict[str, Any]:
        summary = made.pop("summary")
        x, y = (jnp.asarray(end, jnp.float32) if self.compiled else end for end in (test.x, test.y))
        row = made | {"bytes": int(summary.num_bytes)} | errors(_answers(summary, test), test.distance)
        row["nanoseconds"] = 1e9 * _seconds(lambda: summary(x, y)) / len(test.x)
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


def _seconds(call: Callable[[], Any]) -> float:
    """Median of warm calls, one if that takes long."""
    times: list[float] = []
    while not times or (sum(times) < _TIMED_SECONDS and len(times) < _MOST_CALLS):
        begun = time.perf_counter()
        jax.block_until_ready(call())
        times.append(time.perf_counter() - begun)
    return float(np.median(times))


_NUMBERS = 11


def _cells(rows: list[dict[str, Any]]) -> list[list[str]]:
    """A head, and a row a setting."""
    head = ["setting", "bytes", "mean error", "largest", "of the mean distance", "below", "above", "ns a pair"]
    table = [[*head, "settings", "s of all", "published: mean", "largest"]]
    for row in rows:
        listed = row.get("published", {})
        cells = [f"{row['bytes']:,}", f"{row['mean']:.2g}", f"{row['largest']:.2g}", f"{row['share']:.2g}"]
        cells += [f"{row['below']:.2%}", f"{row['above']:.2%}", f"{row['nanoseconds']:,.0f}"]
        cells += [f"{row['settings']}", f"{row['build']:.2g}"]
        table.append([row["setting"], *cells, *(or_dash(listed.get(which), ".2%") for which in ("mean", "max"))])
    return table
