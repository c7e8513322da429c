"""The solution of a planner with its path, the JSON file of a solution, and the limits of a search."""

import enum
import json
import os
import time
from dataclasses import asdict, dataclass, field
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Float

from plr_jax._arrays import as_finite, as_numbers, require_integer, shortened
from plr_jax._files import errors_named, file_path, format_name, json_of, require_format, write_atomically
from plr_jax._problem import JointPath, Problem, motion_costs, path_cost, row_times
from plr_jax._types import ArrayLike
from plr_jax.robots import between, rows_around

_KIND = "solution"
_VERSION = 1
_NUMBERS = ("cost", "makespan", "lower_bound", "motions_factor")
_KEYS = ("status", *_NUMBERS, "path", "times", "stats")
_COUNTS = ("num_nodes", "num_expansions", "num_children_scored", "num_children_valid", "num_bytes")
_MOST_BYTES = 2**26  # largest file: a path of about three million numbers


class Status(enum.StrEnum):
    """Reason why a planner ended; its value is a phrase for messages."""

    SOLVED = "a path was found"  # within the cost factor, if one is set
    EXHAUSTED = "no search is left that could find a path, or one of less cost"
    TIME_LIMIT = "the time limit was reached"
    EXPANSION_LIMIT = "the limit on expansions was reached"
    MEMORY_LIMIT = "the memory limit was reached, or a search left out children to save memory"
    INTERRUPTED = "interrupted by the user"


@dataclass(frozen=True)
class Stats:
    """Effort of a planner.

    Args:
        num_nodes: Joint configurations stored: nodes of the searches, or samples of a sampling-based planner.
        num_expansions: Search nodes expanded; for LaCAM, attempted steps of the whole team.
        num_children_scored: Children scored: extensions of a partial joint motion, in which only the first robots
            have moved, by a motion of the next robot. At each expansion, best-first search extends up to 65,536
            partial motions, LaCAM only one. So compare heuristics with one search, such as ``searchers=("bl",)``.
        num_children_valid: Children free of collision; for LaCAM, steps of the whole team found.
        seconds: Wall-clock seconds of each phase of the planner, by name.
        history: Seconds since the start, and cost, of each new best path.
        found_by: Search that found the best path of :func:`plr_jax.bl_plan`, by its name in
            ``BLOptions.searchers``, or "sequential".
        num_bytes: Estimated largest memory of the searches and lattices of ``bl_plan``, in bytes. It includes
            lattices that would have exceeded the memory limit, and so were not built.
    """

    num_nodes: int
    num_expansions: int = 0
    num_children_scored: int = 0
    num_children_valid: int = 0
    seconds: dict[str, float] = field(default_factory=dict)
    history: tuple[tuple[float, float], ...] = ()
    found_by: str = ""
    num_bytes: int = 0

    @property
    def first_solution(self) -> float:
        """Seconds to the first path; ``inf`` if there is none."""
        return self.history[0][0] if self.history else np.inf


Samples: TypeAlias = Float[np.ndarray, "nodes robots dof"]


@dataclass(frozen=True, eq=False)
class Solution:
    """The result of a planner.

    Args:
        path: Joint configurations ``(steps, robots, dof)`` from the starts to the goals, in workspace units and
            radians. Between two rows all robots move at once along straight lines. None if no path was found.
        cost: Sum of the path's motion costs; ``inf`` if there is no path.
        makespan: Duration of the path (see :func:`plr_jax.metrics.makespan`); ``inf`` if there is no path.
        lower_bound: Proven lower bound of the cost of every path.
        status: Reason why the planner ended. Any status may come with a path: EXHAUSTED, for instance, with a path
            that costs more than the cost factor allows.
        stats: Effort of the planner.
        samples: Joint configurations ``(nodes, robots, dof)`` of the search nodes, in the order of creation. For
            ``bl_plan``, nodes of the search with the most nodes, on the lattices that were searched last.
        motions_factor: Proven upper bound of a ratio: the cost of the path before shortening, over the cost of
            the cheapest path made of motions on the same lattices. ``inf`` if nothing is proven.
        times: Time at which the path reaches each row, ``(steps,)``, from 0 to the makespan. None without a path.
    """

    path: JointPath | None
    cost: float
    makespan: float
    lower_bound: float
    status: Status
    stats: Stats
    samples: Samples
    motions_factor: float = np.inf
    times: Float[np.ndarray, " steps"] | None = None

    @property
    def factor(self) -> float:
        """Proven upper bound of the ratio of the path's cost to the least possible cost; ``inf`` without a proof."""
        if self.cost == 0:
            return 1.0
        return self.cost / self.lower_bound if self.lower_bound > 0 else np.inf

    @property
    def solved(self) -> bool:
        """Whether there is a path."""
        return self.path is not None

    def path_at(self, times: ArrayLike) -> Float[np.ndarray, "*batch robots dof"]:
        """Return the joint configurations ``(n, robots, dof)`` at times ``(n,)``, or ``(robots, dof)`` at one time.

        Each motion between two rows takes as long as its costliest robot needs at unit speed. The other robots move
        at a constant rate and arrive at the same time. Headings turn the shorter way. At the time of a row, the
        result equals the row. Until 0 the robots are at their starts, after the makespan (or at ``inf``) at their
        goals. If there is no path, or a time is NaN, masked or not a number, ``ValueError`` is raised.
        """
        if self.path is None or self.times is None:
            raise ValueError(f"There is no path to follow: the planner ended because {self.status}.")
        times = as_numbers("times", times, "numbers, such as an array (n,)")
        if np.isnan(times).any():
            raise ValueError("times must not be NaN.")
        when = times.ravel()
        row, after, fraction = rows_around(self.times, when)
        fraction = fraction[:, None, None]
        at = np.where(fraction == 1, self.path[after], between(self.path[row], self.path[after], fraction))
        at[when >= self.makespan] = self.path[-1]
        at[when <= 0] = self.path[0]  # several rows may have time 0
        return at.reshape(*times.shape, *self.path.shape[1:])

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the solution, without its samples, to a JSON file that :meth:`load` describes; the write is atomic.

        ``ValueError`` if the solution is inconsistent or the file would be larger than 64 MiB, ``OSError`` if writing
        fails.
        """
        entry: dict[str, Any] = {"format": format_name(_KIND), "version": _VERSION, "status": self.status.name}
        numbers = {name: getattr(self, name) for name in _NUMBERS}
        entry |= {name: None if number == np.inf else float(number) for name, number in numbers.items()}
        entry["stats"] = asdict(self.stats) | {name: int(getattr(self.stats, name)) for name in _COUNTS}
        entry |= {"times": self.times, "path": self.path}
        _solution_from_json(entry)  # raises if the file could not be read back
        data = (json.dumps(entry, allow_nan=False, default=lambda numbers: numbers.tolist()) + "\n").encode()
        if len(data) > _MOST_BYTES:
            raise ValueError(f"A solution's file has at most {_MOST_BYTES:,} bytes, this one has {len(data):,}.")
        write_atomically(file_path(path), data)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> "Solution":
        """Read a solution from a file that :meth:`save` or ``plr-jax plan --output`` wrote.

        Version 1 is one JSON object with the keys below, named after attributes of :class:`Solution` and
        :class:`Stats`; other keys are ignored. Numbers are finite or, for infinity, null. ``path`` and ``times`` are
        null if there is no path. Lengths are in workspace units, angles in radians::

            "format": "plr_jax solution", "version": 1
            "status": name of a Status, such as "SOLVED"
            "cost", "makespan", "lower_bound", "motions_factor": number or null
            "path": [[[x, y], ...], ...]: per row, one configuration per robot, with a heading if any robot has one
            "times": [time, ...], one per row, from 0 to the makespan
            "stats": {"num_nodes", "num_expansions", "num_children_scored", "num_children_valid", "num_bytes": count,
                      "seconds": {phase: seconds, ...}, "history": [[seconds, cost], ...], "found_by": name or ""}

        Every float64 is restored exactly; ``samples`` are empty, since the file omits them. Raises ``ValueError`` if
        the file is not a solution, is damaged or of a newer version, and ``OSError`` if it cannot be read.
        """
        path = file_path(path)
        with errors_named(path):
            return _solution_from_json(json_of(path, _MOST_BYTES))

    def __repr__(self) -> str:
        costs = f"cost {self.cost:.4g}, makespan {self.makespan:.4g}, lower bound {self.lower_bound:.4g}"
        effort = f"{self.stats.num_nodes:,} nodes, {sum(self.stats.seconds.values()):.3g} s"
        return f"Solution({self.status.name}: {costs}, {effort})"


def make_solution(
    problem: Problem, path: JointPath | None, lower_bound: float, status: Status, stats: Stats, samples: Samples
) -> Solution:
    if path is None:
        return Solution(None, np.inf, np.inf, lower_bound, status, stats, samples)
    cost, times = path_cost(problem, path), row_times(problem, path)
    return Solution(path, cost, float(times[-1]), lower_bound, status, stats, samples, times=times)


def straight_line_bound(problem: Problem) -> float:
    return float(motion_costs(problem, problem.starts, problem.goals).sum())


def _solution_from_json(entry: Any) -> Solution:
    """Make a solution from a decoded JSON file; ``ValueError`` if an entry is missing or invalid."""
    require_format(entry, _KIND, _VERSION, _KEYS)
    status = entry["status"]
    if not isinstance(status, str) or status not in Status.__members__:
        raise ValueError(f'expected "status" to be one of {", ".join(Status.__members__)}, got {shortened(status)}.')
    numbers = (np.inf if entry[name] is None else as_finite(f'"{name}"', entry[name]) for name in _NUMBERS)
    cost, makespan, lower_bound, factor = numbers
    path = times = None
    parts = {name: entry[name] for name in ("cost", "makespan", "path", "times")}
    missing = [name for name, part in parts.items() if part is None]
    if len(missing) < len(parts):
        if missing:
            expected = f"all or none of {', '.join(parts)} to be null"
            raise ValueError(f"expected {expected}, got null for {', '.join(missing)}.")
        path = as_numbers('"path"', parts["path"], "numbers of shape (steps, robots, dof)")
        if path.ndim != 3 or 0 in path.shape or path.shape[2] not in (2, 3) or not np.isfinite(path).all():
            expected = "finite, of shape (steps, robots, 2 or 3)"
            raise ValueError(f'expected "path" to be {expected}, got shape {path.shape}.')
        times = as_numbers('"times"', parts["times"], "numbers of shape (steps,)")
        if times.shape != path.shape[:1] or not np.isfinite(times).all() or (np.diff(times) < 0).any():
            expected = f"{len(path)} finite nondecreasing numbers, one per row of the path"
            raise ValueError(f'expected "times" to be {expected}.')
        if times[0] != 0 or times[-1] != makespan:
            raise ValueError(f'expected "times" from 0 to the makespan {makespan}, got {times[0]} to {times[-1]}.')
    samples = np.zeros((0, 0, 0) if path is None else (0, *path.shape[1:]))
    stats = _stats_from_json(entry["stats"])
    return Solution(path, cost, makespan, lower_bound, Status[status], stats, samples, factor, times)


def _stats_from_json(entry: Any) -> Stats:
    """Make :class:`Stats` from the entry "stats" of a decoded JSON file; ``ValueError`` if the entry is invalid."""
    keys = (*_COUNTS, "seconds", "history", "found_by")
    if not isinstance(entry, dict) or any(key not in entry for key in keys):
        raise ValueError(f'expected "stats" to have the keys {", ".join(keys)}, got {shortened(entry)}.')
    for name in _COUNTS:
        require_integer(f'"{name}"', entry[name], 0)
    seconds, history, found_by = entry["seconds"], entry["history"], entry["found_by"]
    lists = list, tuple  # `Solution.save` checks tuples before it writes them as lists
    are_pairs = isinstance(history, lists) and all(isinstance(pair, lists) and len(pair) == 2 for pair in history)
    if not isinstance(seconds, dict) or not isinstance(found_by, str) or not are_pairs:
        expected = '"seconds" to be an object, "found_by" a string, and "history" a list of pairs [seconds, cost]'
        raise ValueError(f"expected {expected}, got {shortened(entry)}.")
    seconds = {phase: as_finite(f'"seconds" of "{phase}"', value) for phase, value in seconds.items()}
    history = tuple((as_finite("seconds", pair[0]), as_finite("a cost", pair[1])) for pair in history)
    return Stats(**{name: entry[name] for name in _COUNTS}, seconds=seconds, history=history, found_by=found_by)


@dataclass
class SearchBudget:
    """Limits of a planner, and counters of its effort.

    ``deadline`` is a time of ``time.perf_counter``. Memory is in bytes.
    """

    deadline: float
    max_expansions: float | int
    max_memory: float | int
    num_nodes: int = 0
    num_expansions: int = 0
    num_children_scored: int = 0
    num_children_valid: int = 0
    memory: int = 0

    def exceeded(self) -> Status | None:
        """Return the status that names a limit if one more expansion would exceed this limit, else None."""
        if self.num_expansions + 1 > self.max_expansions and time.perf_counter() < self.deadline:
            return Status.EXPANSION_LIMIT  # after the deadline, the status is TIME_LIMIT
        return self.spent()

    def spent(self) -> Status | None:
        """Return TIME_LIMIT or MEMORY_LIMIT if the time or memory limit is reached, else None."""
        if time.perf_counter() >= self.deadline:
            return Status.TIME_LIMIT
        return None if self.has_memory() else Status.MEMORY_LIMIT

    def has_memory(self, num_bytes: float | int = 0) -> bool:
        return self.memory + num_bytes < self.max_memory


class MemoryUse:
    """The number of bytes of one data structure. The bytes also count in ``budget.memory`` until :meth:`release`."""

    def __init__(self, budget: SearchBudget):
        self.budget, self.num_bytes = budget, 0

    def add(self, num_bytes: int) -> None:
        self.num_bytes += num_bytes
        self.budget.memory += num_bytes

    def release(self) -> None:
        self.add(-self.num_bytes)
