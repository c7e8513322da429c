"""What a planner is given, options and limits, and what it returns: a path, its cost, why it ended; and its file."""

import enum
import json
import math
import os
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Float

from plr_jax._arrays import as_finite, as_number, as_numbers, require_integer, shortened
from plr_jax._files import errors_named, file_path, format_name, json_of, require_format, write_atomically
from plr_jax._problem import Problem, motion_costs, path_cost, require_problem, row_times
from plr_jax._types import ArrayLike
from plr_jax.robots.robot import between, motions_under_way

_KIND = "solution"
_VERSION = 1
_NUMBERS = ("cost", "makespan", "lower_bound", "motions_factor")
_KEYS = ("status", *_NUMBERS, "path", "times", "stats")
_COUNTS = ("num_nodes", "num_expansions", "num_children_scored", "num_children_valid", "num_bytes")
_MOST_BYTES = 2**26  # of a file: a path of about three million numbers


class Status(enum.StrEnum):
    """Why a planner ended; the value is the message."""

    SOLVED = "a path within the cost factor was found"
    EXHAUSTED = "the frontier is empty: no path, or none within the cost factor, on this lattice"
    TIME_LIMIT = "the time limit was reached"
    EXPANSION_LIMIT = "the limit on expansions was reached"
    MEMORY_LIMIT = "the memory limit was reached"
    INTERRUPTED = "interrupted by the user"


@dataclass(frozen=True)
class Stats:
    """What a planner did.

    Args:
        num_nodes: Joint configurations kept: nodes of the searches, samples of a sampling-based planner.
        num_expansions: How often a node's children were asked for; of LaCAM, steps that were tried.
        num_children_scored: Children given a cost and a heuristic: joint ones, of best-first search also those of the
            first robots alone; of LaCAM motions of single robots.
        num_children_valid: Those found free of collision; of LaCAM steps found.
        seconds: Wall-clock seconds by phase.
        history: Each new best path: seconds since the start and its cost.
        found_by: Of :func:`plr_jax.bl_plan`, the search whose path became the best one, "lacam" or "bl", or
            "sequential", of robots that go one after the other from corner to corner.
        num_bytes: Of the same, about what the largest lattices that were tried, and what was held beside them, take;
            what the limit on memory kept from being tried counts too, so that it then exceeds that limit.
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
        return self.history[0][0] if self.history else math.inf


JointPath: TypeAlias = Float[np.ndarray, "steps robots dof"]


@dataclass(frozen=True, eq=False)
class Solution:
    """The result of a planner.

    Args:
        path: Joint configurations ``(steps, robots, dof)`` from the starts to the goals, in workspace units and
            radians; robots move from one row to the next along straight lines, all at once. None if no path
            was found.
        cost: Sum of the path's motion costs, ``inf`` if there is none.
        makespan: Time that the path takes (see :func:`plr_jax.makespan`), ``inf`` if there is none.
        lower_bound: A cost below which there is no path.
        status: Why the planner ended. A path may be there whatever it says.
        stats: What the planner did.
        samples: Joint configurations of the nodes, ``(nodes, robots, dof)``, in the order of their making; of
            ``bl_plan``, those of the larger search on the lattices that were searched last.
        motions_factor: Proven bound of the cost of the path that ``path`` was shortened from, over that of the
            cheapest one made of the same motions; ``inf`` where nothing is proven of that. Of BL, the motions of the
            lattices on which it was found.
        times: When the path reaches each of its rows, ``(steps,)``: from 0 to the makespan, never falling. None if no
            path was found.
    """

    path: JointPath | None
    cost: float
    makespan: float
    lower_bound: float
    status: Status
    stats: Stats
    samples: Float[np.ndarray, "nodes robots dof"]
    motions_factor: float = math.inf
    times: Float[np.ndarray, "steps"] | None = None

    @property
    def factor(self) -> float:
        """How many times as much the path costs at the most as the best one there is, as far as is proven.

        ``inf`` if there is no path, or nothing is known but that a cost is not negative.
        """
        if self.cost == 0:
            return 1.0
        return self.cost / self.lower_bound if self.lower_bound > 0 else math.inf

    @property
    def solved(self) -> bool:
        """Whether there is a path."""
        return self.path is not None

    def path_at(self, times: ArrayLike) -> Float[np.ndarray, "*batch robots dof"]:
        """Where the robots are at some times, if they follow the path by a common clock.

        Each motion, from one row of the path to the next, takes as long as its costliest robot needs at unit speed.
        The others move at a constant rate and arrive with it. Headings turn the shorter way from those of the row
        before, so where the path's own headings jump by a whole turn, so do these.

        Args:
            times: Times ``(n,)`` from 0 to the makespan, or of any other shape. Before 0 the robots are at their
                starts, after the makespan at their goals, so ``inf`` is allowed.

        Returns:
            Joint configurations ``(n, robots, dof)``, for one time ``(robots, dof)``. At 0 those are the starts and
            at the makespan the goals, to the bit; at the time of a row in between, that row.

        Raises:
            ValueError: If there is no path, or a time is NaN, masked or no number.
        """
        if self.path is None or self.times is None:
            raise ValueError(f"There is no path to follow, the planner ended because: {self.status}.")
        times = as_numbers("times", times, "numbers, such as an array (n,)")
        if np.isnan(times).any():
            raise ValueError("times must not be NaN.")
        when = times.ravel()
        row, after, share = motions_under_way(self.times, when)
        share = share[:, None, None]
        at = np.where(share == 1, self.path[after], between(self.path[row], self.path[after], share))
        at[when <= 0] = self.path[0]  # of rows at time 0, the last one else
        at[when >= self.makespan] = self.path[-1]
        return at.reshape(*times.shape, *self.path.shape[1:])

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the solution as a JSON file, in the form that :meth:`load` describes, but for its samples.

        The file appears whole or not at all: an interrupted save leaves an older file as it was.

        Args:
            path: Where; usually ends in ``.json``.

        Raises:
            ValueError: If the solution contradicts itself, as a path without a cost does, or takes more than 64 MiB.
            OSError: If the file cannot be written.
        """
        stats = self.stats
        entry = {
            "format": format_name(_KIND),
            "version": _VERSION,
            "status": self.status.name,
            **{name: None if (number := getattr(self, name)) == math.inf else float(number) for name in _NUMBERS},
            "stats": {
                **{name: int(getattr(stats, name)) for name in _COUNTS},
                "seconds": {phase: float(seconds) for phase, seconds in stats.seconds.items()},
                "history": [[float(seconds), float(cost)] for seconds, cost in stats.history],
                "found_by": stats.found_by,
            },
            "times": None if self.times is None else self.times.tolist(),
            "path": None if self.path is None else self.path.tolist(),
        }
        _solution_from_json(entry)  # or it could not be read back
        data = (json.dumps(entry, allow_nan=False) + "\n").encode()
        if len(data) > _MOST_BYTES:
            had = f"this one would have {len(data):,}"
            raise ValueError(f"A solution's file has at most {_MOST_BYTES:,} bytes, {had}.")
        write_atomically(file_path(path), data)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> "Solution":
        """Read a solution from a file.

        Version 1 is one object with these keys; other keys are ignored. ``null`` stands for infinity, which JSON has
        no word for; lengths are in workspace units, angles in radians::

            "format":         "plr_jax solution"
            "version":        1
            "status":         name of a Status, such as "SOLVED"
            "cost":           number, or null if there is no path, likewise "makespan"
            "lower_bound":    number or null
            "motions_factor": number or null
            "path":           [[[x, y], ...], ...], one configuration a robot in each row ([x, y, heading] if any
                              robot has a heading), or null if there is no path
            "times":          [time, ...], one a row, from 0 to the makespan, or null if there is no path
            "stats":          {"num_nodes": count, "num_expansions": count, "num_children_scored": count,
                               "num_children_valid": count, "num_bytes": count,
                               "seconds": {phase: seconds, ...}, "history": [[seconds, cost], ...],
                               "found_by": name of a search, or ""}

        Numbers are written with as many digits as it takes to read the same float64 back.

        Args:
            path: A file that :meth:`save` or ``plr-jax plan --output`` wrote.

        Returns:
            The solution, equal to the saved one bit for bit, but that its ``samples`` are an empty array: they are
            not in the file. Whether the path is valid for a problem, :func:`plr_jax.validate` says.

        Raises:
            ValueError: If the file is no solution, is damaged, or was written by a newer version.
            OSError: If the file cannot be read.
        """
        path = file_path(path)
        with errors_named(path):
            return _solution_from_json(json_of(path, _MOST_BYTES))

    def __repr__(self) -> str:
        costs = f"cost {self.cost:.4g}, makespan {self.makespan:.4g}, lower bound {self.lower_bound:.4g}"
        effort = f"{self.stats.num_nodes:,} nodes, {sum(self.stats.seconds.values()):.3g} s"
        return f"Solution({self.status.name}: {costs}, {effort})"


def make_solution(
    problem: Problem,
    path: JointPath | None,
    lower_bound: float,
    status: Status,
    stats: Stats,
    samples: Float[np.ndarray, "nodes robots dof"],
    motions_factor: float = math.inf,
) -> Solution:
    """A solution, its costs computed from the path."""
    if path is None:
        return Solution(None, math.inf, math.inf, lower_bound, status, stats, samples)
    cost, times = path_cost(problem, path), row_times(problem, path)
    return Solution(path, cost, float(times[-1]), lower_bound, status, stats, samples, motions_factor, times)


def straight_line_bound(problem: Problem) -> float:
    """The sum of the costs of the robots' straight motions to their goals: no path is cheaper."""
    return float(motion_costs(problem, problem.starts, problem.goals).sum())


def _solution_from_json(entry: Any) -> Solution:
    """The solution that a document stands for; ``ValueError`` if it stands for none."""
    require_format(entry, _KIND, _VERSION, _KEYS)
    status = entry["status"]
    if not isinstance(status, str) or status not in Status.__members__:
        raise ValueError(f'expected "status" to be one of {", ".join(Status.__members__)}, got {shortened(status)}.')
    numbers = (math.inf if entry[name] is None else as_finite(f'"{name}"', entry[name]) for name in _NUMBERS)
    cost, span, bound, factor = numbers
    path = times = None
    parts = {name: entry[name] for name in ("cost", "makespan", "path", "times")}
    missing = [name for name, part in parts.items() if part is None]
    if len(missing) < len(parts):
        if missing:
            raise ValueError(f"expected {', '.join(parts)} to be null all or none; null are {', '.join(missing)}.")
        path = as_numbers('"path"', parts["path"], "numbers of shape (steps, robots, dof)")
        if path.ndim != 3 or 0 in path.shape or path.shape[2] not in (2, 3) or not np.isfinite(path).all():
            expected = "finite, of shape (steps, robots, 2 or 3)"
            raise ValueError(f'expected "path" to be {expected}, got shape {path.shape}.')
        times = as_numbers('"times"', parts["times"], "numbers of shape (steps,)")
        if times.shape != path.shape[:1] or not np.isfinite(times).all() or (np.diff(times) < 0).any():
            expected = f"{len(path)} finite numbers that never fall, one a row of the path"
            raise ValueError(f'expected "times" to be {expected}.')
        if times[0] != 0 or times[-1] != span:
            raise ValueError(f'expected "times" from 0 to the makespan {span}, got {times[0]} to {times[-1]}.')
    samples = np.zeros((0, 0, 0) if path is None else (0, *path.shape[1:]))
    stats = _stats_from_json(entry["stats"])
    return Solution(path, cost, span, bound, Status[status], stats, samples, factor, times)


def _stats_from_json(entry: Any) -> Stats:
    keys = (*_COUNTS, "seconds", "history", "found_by")
    if not isinstance(entry, dict) or any(key not in entry for key in keys):
        raise ValueError(f'expected "stats" to have the keys {", ".join(keys)}, got {shortened(entry)}.')
    for name in _COUNTS:
        require_integer(f'"{name}"', entry[name], 0)
    seconds, history, found_by = entry["seconds"], entry["history"], entry["found_by"]
    are_pairs = isinstance(history, list) and all(isinstance(pair, list) and len(pair) == 2 for pair in history)
    for name, fine, expected in (
        ("seconds", isinstance(seconds, dict), "an object"),
        ("found_by", isinstance(found_by, str), "a text"),
        ("history", are_pairs, "a list of pairs [seconds, cost]"),
    ):
        if not fine:
            raise ValueError(f'expected "{name}" to be {expected}, got {shortened(entry[name])}.')
    seconds = {phase: as_finite(f'"seconds" of "{phase}"', value) for phase, value in seconds.items()}
    history = tuple((as_finite("seconds", pair[0]), as_finite("a cost", pair[1])) for pair in history)
    return Stats(**{name: entry[name] for name in _COUNTS}, seconds=seconds, history=history, found_by=found_by)


# Options and limits.

SEARCHERS = ("lacam", "bl")
_LARGEST_WEIGHT = 1e6


@dataclass(frozen=True)
class BLOptions:
    """Options of :func:`plr_jax.bl_plan`.

    Args:
        searchers: Which searches take turns until one finds a path. "lacam" is LaCAM, which moves the whole team one
            step at a time: it is over at once where robots can push one another along, for large teams as well. "bl"
            is best-first search over cells of the joint space: it finds what takes a plan, as swaps in tight places.
            It alone heeds ``heuristic_weight``. Only where both are asked for, a few discs are tried one after the
            other before.
        step: Side of a lattice's cells, in workspace units. None: chosen for each problem, and refined until the
            problem is solved.
        heuristic_weight: Factor of the heuristic in best-first search, from 0 to 1e6. The larger, the greedier. None:
            2, or 3/8 a robot if that is more, as many robots have more ways to stand in each other's. It grows by
            half from one lattice to the next finer one.
        cost_factor: Largest cost of a path to be content with, as a multiple of the lower bound. While the best path
            costs more, the search goes on with smaller weights and steps, until a limit. 1: to the limit, as a rule.
            The bound is that of straight lines unless something better is given: ``lower_bound``, or a heuristic
            that is one, such as the exact distances.
        lower_bound: A cost below which there is no path, in workspace units. It counts where it exceeds the bound of
            straight lines and what the heuristic proves.
        time_limit: Seconds, positive or ``inf``. A call of Shapely or of the heuristic, and a search of a lattice for
            costs-to-go, are not cut short.
        max_expansions: Most expansions; deterministic, unlike the time limit.
        max_memory: Most bytes of the lattices and of the search's nodes.

    Raises:
        ValueError: If an option is out of its range, or ``searchers`` names none or an unknown one.
    """

    searchers: Sequence[str] = SEARCHERS
    step: float | int | None = None
    heuristic_weight: float | int | None = None
    cost_factor: float | int = float("inf")
    lower_bound: float | int | None = None
    time_limit: float | int = 60.0
    max_expansions: float | int = float("inf")
    max_memory: float | int = 4e9

    def __post_init__(self) -> None:
        for name in ("step", "lower_bound"):
            value = getattr(self, name)
            if value is not None:
                as_number(name, value, "None or a positive finite number", lambda number: 0 < number < math.inf)
        for name in ("time_limit", "max_expansions", "max_memory", "cost_factor"):
            as_number(name, getattr(self, name), "a positive number or inf", lambda number: number > 0)
        if self.heuristic_weight is not None:
            expected, weight = "None or a number from 0 to 1e6", self.heuristic_weight
            weight = as_number("heuristic_weight", weight, expected, lambda weight: 0 <= weight <= _LARGEST_WEIGHT)
            object.__setattr__(self, "heuristic_weight", weight)
        is_some = isinstance(self.searchers, tuple | list | set | frozenset) and len(self.searchers) > 0
        if not is_some or any(name not in SEARCHERS for name in self.searchers):
            raise ValueError(f"searchers must be some of {SEARCHERS}, at least one, got {self.searchers!r}.")


def require_problem_and_options(problem: Problem, options: BLOptions) -> None:
    """``ValueError`` unless these are a problem and options."""
    require_problem(problem)
    if not isinstance(options, BLOptions):
        raise ValueError(f"options must be BLOptions(...), got {shortened(options)}.")


@dataclass
class SearchBudget:
    """What a planner may still do, until a time of ``time.perf_counter``, and what it has done."""

    deadline: float
    max_expansions: float | int
    max_memory: float | int
    num_nodes: int = 0
    num_expansions: int = 0
    num_children_scored: int = 0
    num_children_valid: int = 0
    memory: int = 0

    def exceeded(self) -> Status | None:
        """The limit that is reached, if one is."""
        if self.num_expansions + 1 > self.max_expansions and time.perf_counter() < self.deadline:
            return Status.EXPANSION_LIMIT
        return self.spent()

    def spent(self) -> Status | None:
        """The limit of time or memory, if one of these is reached."""
        if time.perf_counter() >= self.deadline:
            return Status.TIME_LIMIT
        return Status.MEMORY_LIMIT if self.memory >= self.max_memory else None


class MemoryUse:
    """Bytes that something holds, and that count against a budget until they are released."""

    def __init__(self, budget: SearchBudget):
        self.budget, self.num_bytes = budget, 0

    def add(self, num_bytes: int) -> None:
        """Hold so many bytes more, or less."""
        self.num_bytes += num_bytes
        self.budget.memory += num_bytes

    def release(self) -> None:
        """Hold none."""
        self.add(-self.num_bytes)
