"""Readers of the format, each leaf model: is what C and NumPy answer equal to the bit, how near is ``plr(x)``, how fast?

Points are uniform in a box 2 % wider than the domain. Units in the last place are those of the largest *term* of a
value: of a plane the products that are added, of a polynomial its monomials, of a cone its offset and its length. Where
``plr(x)`` is farther off, a rounding of folded or wrapped coordinates has put the point into a neighboring leaf.
"""

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from experiments._tables import aligned
from experiments.porting._headers import compiled_header, median_seconds, section_bytes
from plr_jax import PLR, Box, Euclidean, NumpyPLR, ReedsShepp, VisibilityGraph, construct, scenes

NUM_POINTS, CHUNK, NUM_CALLS = 10_000_000, 1_000_000, 20_000
_WIDER = 1.02
_TURNS = Box((-5, -5, -np.pi), (5, 5, np.pi), periodic=(False, False, True))
_ZONE = Box((5e5, 4e6), (5e5 + 2000, 4e6 + 1500))


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    num_points, num_calls = (20_000, 100) if smoke else (NUM_POINTS, NUM_CALLS)
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for number, (name, make) in enumerate(plrs(512 if smoke else 2048).items()):
            plr = make()
            row = _measured(plr, Path(folder) / f"{number}", num_points, num_calls, seed)
            rows.append({"plr": name, "leaf": plr.leaf.name, "leaves": plr.num_leaves, "bytes": plr.num_bytes, **row})
            print(rows[-1], flush=True)
    return {"points": num_points, "rows": rows}


def plrs(max_bytes: int) -> dict[str, Callable[[], PLR]]:
    """PLRs of each leaf model, in several dimensions, with and without folding, near the origin and far from it."""
    problem = scenes.maze()
    oracle = VisibilityGraph(problem.workspace, problem.goals[0])
    car, ball = ReedsShepp((0, 0, 0), 1), Euclidean((0.3, 0.2, 0.1, 0, -0.3))
    square = problem.workspace.bounds
    return {
        "maze, planes": lambda: construct(oracle, square, max_bytes=max_bytes),
        "maze, continuous": lambda: construct(oracle, square, leaf="continuous", max_bytes=max_bytes),
        "maze, smooth": lambda: construct(oracle, square, leaf="smooth", max_bytes=max_bytes),
        "maze, cones": lambda: construct(oracle, square, leaf="cone", max_bytes=max_bytes, certified=True),
        "car, planes": lambda: construct(car, _TURNS, max_bytes=max_bytes),
        "car, continuous": lambda: construct(car, _TURNS, leaf="continuous", max_bytes=max_bytes),
        "car turned": lambda: construct(ReedsShepp((1, 0.5, 0.6), 1), _TURNS, leaf="continuous", max_bytes=max_bytes),
        "5-D, planes": lambda: construct(ball, (-np.ones(5), np.ones(5)), max_bytes=max_bytes),
        "5-D, continuous": lambda: construct(ball, (-np.ones(5), np.ones(5)), leaf="continuous", max_bytes=max_bytes),
        "UTM, planes": lambda: construct(Euclidean((5e5 + 700, 4e6 + 300)), _ZONE, max_bytes=max_bytes),
    }


def _measured(plr: PLR, folder: Path, num_points: int, num_calls: int, seed: int) -> dict[str, Any]:
    in_c, f, rng = compiled_header(plr, folder), plr.numpy(), np.random.default_rng(seed)
    center, half = (plr.domain.lo + plr.domain.hi) / 2, _WIDER / 2 * plr.domain.width
    equal, units = 0, []
    for start in range(0, num_points, CHUNK):
        shape = (min(CHUNK, num_points - start), plr.dim)
        x = (center + half * rng.uniform(-1, 1, shape)).astype(in_c.real)
        expected = f(x)
        equal += int(np.count_nonzero(in_c(x).view(np.uint32) == expected.view(np.uint32)))
        finite = np.isfinite(expected)
        off = np.abs(np.asarray(plr(x), np.float64)[finite] - expected[finite])
        units.append(off / np.spacing(largest_terms(f, x[finite])))
    units = np.concatenate(units)
    inside = [
        tuple(point) for point in (plr.domain.lo + plr.domain.width * rng.random((num_calls, plr.dim))).tolist()
    ]
    return {
        **section_bytes(plr, folder),
        "equal": equal / num_points,
        "units": float(units.max()),
        "beyond_two_units": float(np.mean(units > 2)),
        "c_nanoseconds": in_c.nanoseconds(x),
        "numpy_microseconds": median_seconds(lambda: [f(point) for point in inside]) / num_calls * 1e6,
        "numpy_batch_nanoseconds": median_seconds(lambda: f(x), 3) / len(x) * 1e9,
    }


class _Term:
    """A value, and the largest of the terms that it is a sum of."""

    __array_ufunc__ = None

    def __init__(self, value: np.ndarray, largest: np.ndarray | None = None):
        self.value, self.largest = value, np.abs(value) if largest is None else largest

    def __add__(self, other: "_Term") -> "_Term":
        return _Term(self.value + other.value, np.maximum(self.largest, other.largest))

    def __sub__(self, other: "_Term") -> "_Term":
        return _Term(self.value - other.value)

    def __mul__(self, other: "_Term") -> "_Term":
        return _Term(self.value * other.value, self.largest * np.abs(other.value))


def largest_terms(f: NumpyPLR, x: Float[np.ndarray, "n dim"]) -> Float[np.ndarray, "n"]:
    """The largest term of the value at each point inside the domain, as 32-bit floats.

    It asks the reader for its leaf and the places of points.
    """
    found = []

    def term(points, above, leaf):
        numbers = [_Term(column[leaf]) for column in f._columns]
        cells = [(_Term(count[leaf]), _Term(position[leaf])) for count, position in f._cell_columns]
        place = [_Term(along) for along in above]
        if f._program.leaf.is_of_cells:
            axes = zip(f._program.axes, above, cells, strict=True)
            place = [_Term(axis.in_cell(_Plain, a, n.value, p.value)) for axis, a, (n, p) in axes]
        value = f._program.leaf.value(numbers, place, lambda square: _Term(np.sqrt(square.value)))
        radius = np.sqrt(sum(points[axis] ** 2 for axis in f._program.radial)) if f._program.radial else 0
        found.append(np.maximum(value.largest, radius))
        return value.value

    f._answered(x, term, ())
    return np.concatenate(found).astype(np.float32)


class _Plain:
    """Operations of arrays, as far as a place in a cell needs them."""

    @staticmethod
    def let(name: str, value: np.ndarray) -> np.ndarray:
        return value


def table(results: dict[str, Any]) -> str:
    head = ["PLR", "leaves", "file B", "code B", "data B", "bit-equal", "JAX ulp", "beyond 2", "C ns", "NumPy us"]
    rows = [[*head, "batch ns"]]
    for row in results["rows"]:
        numbers = [f"{row[key]:,}" for key in ("leaves", "bytes", "code", "data")]
        speeds = [f"{row['c_nanoseconds']:.0f}", f"{row['numpy_microseconds']:.1f}"]
        units = [f"{100 * row['equal']:g} %", f"{row['units']:.2g}", f"{row['beyond_two_units']:.1g}"]
        rows.append([row["plr"], *numbers, *units, *speeds, f"{row['numpy_batch_nanoseconds']:.0f}"])
    return f"{results['points']:,} points each\n" + aligned(rows, len(rows[0]) - 1)
