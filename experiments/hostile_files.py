"""Damaged and malicious files: every reader refuses them by name, at once, and in little memory, or reads them.

Valid files are mutated: bits flipped, bytes inserted, deleted and repeated, ends cut off, numbers replaced by extreme
ones, lists by deep ones. A PLR file gets a header and a checksum that fit again, or its reader would look no further.
A reader may read what comes of it, or raise a ``ValueError`` or an ``OSError`` with the file's name in it. It fails
by any other exception, by more than a second of computing, and by a process that grows by more than 100 MB.
Files that a reader failed at are kept.
"""

import json
import multiprocessing
import re
import resource
import struct
import tempfile
import time
import warnings
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

import plr_jax
from experiments._results import command_line, environment, output_folder, read, write
from plr_jax import Box, DiscRobot, PointRobot, Problem, RectangleRobot, Workspace, construct, scenes

NAME = "hostile_files"
MUTATIONS, SMOKE_MUTATIONS = 20_000, 40
MOST_SECONDS, MOST_GROWTH = 1.0, 100e6
_HANGS = 60.0  # seconds after which a reader is ended
_ADDRESS_SPACE = 8 * 2**30  # beyond what is in use: the net under a reader that asks for all there is
_KEPT = "hostile_files"

_GRID = """type octile
height 8
width 12
map
@@@@@@@@@@@@
@....TT....@
@.GG.TT.SS.@
@....@@....@
@..........@
@.@@....W..@
@.@@...WW..@
@@@@@@@@@@@@
"""
_QUERIES = "version 1\n" + "".join(f"{i}\tgrid.map\t12\t8\t1\t{1 + i}\t{10 - i}\t4\t{9.5 + i}\n" for i in range(4))
_DBCBS = """
environment:
  max: [6, 4.5]
  min: [0, 0]
  obstacles:
  - {center: [3, 1], size: [1, 2], type: box}
robots:
- {type: unicycle_first_order_0_sphere, start: [1, 1, 0.5], goal: [5, 1, 0]}
- type: unicycle_first_order_0
  start: [5, 3, 3.14]
  goal: [1.0, 3e0, 0]
"""
_TRAJECTORIES = """
result:
- states:
  - [0, 1, 2.5, 9]
  - [3, 4, 5, 9]
  actions:
  - [1.0e-3, 2]
- states: [[6, 7, 8, 9]]
"""
_SQUARE = [[0, 0], [4, 0], [4, 4], [0, 4]]
_POLYGONS = {"components": [{"outer": _SQUARE, "holes": [[[1, 1], [1, 2], [2, 2.5], [2, 1]]]}], "source": "none"}


@dataclass(frozen=True)
class Reader:
    """A reader, and valid files to mutate.

    Attributes:
        read: Takes a path.
        suffix: How the names of its files end.
        valid: Makes the files' contents.
        repaired: Takes a mutated file; gives one whose checksum is right.
    """

    read: Callable[[Path], Any]
    suffix: str
    valid: Callable[[], list[bytes]]
    repaired: Callable[[bytes], bytes] | None = None


def _scene_files() -> list[bytes]:
    rings = [_SQUARE, [[5, 5], [6, 5], [6, 6]]]
    holed = Workspace.from_polygons([{"outer": [[-1, -1], [9, -1], [9, 9], [-1, 9]], "holes": rings}])
    robots = [DiscRobot(0.25), RectangleRobot(0.7, 0.1), PointRobot()]
    starts, goals = [(8, 8, 0), (7, 1, 1), (1, 8, 0)], [(8, 0, 0), (6, 2, 2), (5, 8, 0)]
    team = Problem(holed, robots, starts, goals, rotation_weight=0.3)
    with tempfile.TemporaryDirectory() as folder:
        path, files = Path(folder, "scene.json"), []
        for problem in (scenes.maze(), scenes.tangle(), team):
            scenes.save(problem, path)
            files += [path.read_bytes()]
    return files


def _plr_files() -> list[bytes]:
    def distance(x: Any) -> Any:
        return np.where((x[:, 0] > 0.4) & (x[:, -1] < 0.3), np.inf, np.linalg.norm(x - 0.7, axis=1))

    kinds = [
        (2, {"leaf": "plane", "max_leaves": 20}),  # of floats
        (3, {"leaf": "plane", "max_bytes": 300}),  # of integers
        (2, {"leaf": "continuous", "max_leaves": 20}),
        (1, {"leaf": "smooth", "max_leaves": 10}),
    ]
    return [construct(distance, Box([0.0] * dim, [1.0] * dim), **options).to_bytes() for dim, options in kinds]


def _with_checksum(data: bytes) -> bytes:
    """A PLR file whose header states its size, and whose last four bytes are its checksum."""
    if len(data) < 20:
        return data
    data = data[:12] + struct.pack("<I", len(data)) + data[16:-4]
    return data + struct.pack("<I", zlib.crc32(data))


READERS = {
    "scene": Reader(scenes.load, ".json", _scene_files),
    "polygons": Reader(scenes.read_polygons, ".json", lambda: [json.dumps(_POLYGONS).encode()]),
    "db-CBS": Reader(scenes.read_dbcbs, ".yaml", lambda: [_DBCBS.encode()]),
    "trajectories": Reader(scenes.read_trajectories, ".yaml", lambda: [_TRAJECTORIES.encode()]),
    "map": Reader(scenes.read_map, ".map", lambda: [_GRID.encode()]),
    "scenario": Reader(scenes.read_scen, ".scen", lambda: [_QUERIES.encode()]),
    "PLR": Reader(plr_jax.load, ".plr", _plr_files, _with_checksum),
}

_NUMBER = re.compile(rb"-?\d+(\.\d+)?([eE][-+]?\d+)?")
_BRACKETS = re.compile(rb"\[[^][]*\]|\{[^{}]*\}")
_EXTREMES = [
    *("0", "-1", "1", "2147483648", "4294967295", "9223372036854775808", "1e308", "-1e308", "1e-308", "1e999", "0.5"),
    *("nan", ".nan", "NaN", "Infinity", ".inf", "true", "null", '"1"', "1" * 400, "1" * 5000, "1e155", "1e15"),
    *("[]", "{}", '""', "[1]", "[[[[1]]]]", "*a", "&a 1", "!!binary 1", "<<", "2001-01-01", "0x_", "\ufeff", "\0"),
    *("[" * 40 + "]" * 40, "[" * 5000, "- " * 100 + "1", '{"a":' * 2000),
]
_PATTERNS = [
    *(struct.pack("<I", value) for value in (0, 1, 2**16, 2**31, 2**32 - 1)),
    *(struct.pack("<f", value) for value in (np.nan, np.inf, -1.0, 1e-45, 3e38)),
    *(struct.pack("<d", value) for value in (np.nan, np.inf, -1.0, 5e-324, 1e308, 1e15)),
    *(bytes([value]) * length for value in (0, 255, 170) for length in (1, 8, 64)),
]


def mutated(data: bytes, rng: np.random.Generator, text: bool) -> bytes:
    """A file's bytes after one to four mutations."""
    for _ in range(int(rng.choice([1, 1, 1, 2, 3, 4]))):
        kinds = (_flip, _insert, _delete, _repeat, _cut, *((_replace_token,) * 5 if text else (_overwrite,) * 2))
        data = kinds[rng.integers(len(kinds))](data, rng)
    return data


def _flip(data: bytes, rng: np.random.Generator) -> bytes:
    at = int(rng.integers(len(data) + 1))
    return data[:at] + bytes(byte ^ 1 << rng.integers(8) for byte in data[at : at + 1]) + data[at + 1 :]


def _insert(data: bytes, rng: np.random.Generator) -> bytes:
    at = int(rng.integers(len(data) + 1))
    return data[:at] + rng.bytes(int(rng.integers(1, 9))) + data[at:]


def _delete(data: bytes, rng: np.random.Generator) -> bytes:
    first, last = _slice(data, rng)
    return data[:first] + data[last:]


def _repeat(data: bytes, rng: np.random.Generator) -> bytes:
    first, last = _slice(data, rng)
    return data[:last] + data[first:last] * int(rng.choice([1, 2, 30])) + data[last:]


def _cut(data: bytes, rng: np.random.Generator) -> bytes:
    return data[: int(rng.integers(len(data) + 1))] if rng.random() < 0.3 else data


def _overwrite(data: bytes, rng: np.random.Generator) -> bytes:
    at, pattern = int(rng.integers(len(data) + 1)), _PATTERNS[rng.integers(len(_PATTERNS))]
    return data[:at] + pattern + data[at + len(pattern) :]


def _replace_token(data: bytes, rng: np.random.Generator) -> bytes:
    """A number or an innermost list or mapping gives way to something extreme."""
    tokens = list((_NUMBER if rng.random() < 0.8 else _BRACKETS).finditer(data))
    if not tokens:
        return data
    token = tokens[rng.integers(len(tokens))]
    return data[: token.start()] + _EXTREMES[rng.integers(len(_EXTREMES))].encode() + data[token.end() :]


def _slice(data: bytes, rng: np.random.Generator) -> tuple[int, int]:
    first = int(rng.integers(len(data) + 1))
    return first, first + int(rng.choice([1, 4, 40, 400]))


def hostile(reader: Reader, valid: list[bytes], seed: int, number: int) -> bytes:
    """The mutated file of a number; the same for the same seed."""
    rng = np.random.default_rng([seed, number])
    data = mutated(valid[rng.integers(len(valid))], rng, reader.repaired is None)
    return reader.repaired(data) if reader.repaired and rng.random() < 0.95 else data


@dataclass(frozen=True)
class Outcome:
    """What became of a file.

    Attributes:
        kind: "read" or "refused"; else how the reader failed.
        message: What it said.
        seconds: Of computing.
        growth: Bytes by which the process grew beyond its largest size so far.
    """

    kind: str
    message: str = ""
    seconds: float = 0.0
    growth: float = 0.0

    @property
    def failed(self) -> bool:
        """Whether the reader did what it must not."""
        return self.kind not in ("read", "refused")


def attempt(reader: Reader, path: Path) -> Outcome:
    """Read a file. Only time and memory are left for the caller to judge."""
    began, before = time.process_time(), _peak()
    kind, message = "read", ""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            reader.read(path)
    except (ValueError, OSError) as error:
        kind, message = "refused" if str(path) in str(error) else "error without the file's name", repr(error)
    except Exception as error:
        kind, message = type(error).__name__, repr(error)
    return Outcome(kind, message[:300], time.process_time() - began, _peak() - before)


def _peak() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024.0


def _judged(outcome: Outcome) -> Outcome:
    for kind, over in (("too slow", outcome.seconds > MOST_SECONDS), ("too large", outcome.growth > MOST_GROWTH)):
        if over and not outcome.failed:
            return Outcome(kind, outcome.message, outcome.seconds, outcome.growth)
    return outcome


def _work(results: Connection, folder: Path, trials: list[tuple[str, int]], seed: int) -> None:
    """Read the files of all trials one after the other, until one has made the process too large to go on with."""
    valid = {name: READERS[name].valid() for name in dict.fromkeys(name for name, _ in trials)}
    for name, files in valid.items():  # so that what is loaded but once is there
        for data in files:
            if (outcome := _attempt(name, data, folder, "valid")).kind != "read":
                raise RuntimeError(f"A valid file of {name} is not read: {outcome.message}")
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + _ADDRESS_SPACE, resource.RLIM_INFINITY))
    results.send(None)
    for name, number in trials:
        outcome = _judged(_attempt(name, hostile(READERS[name], valid[name], seed, number), folder, str(number)))
        results.send(outcome)
        if outcome.growth > MOST_GROWTH:
            return


def _attempt(name: str, data: bytes, folder: Path, stem: str) -> Outcome:
    reader = READERS[name]
    path = folder / f"{name}_{stem}{reader.suffix}"
    path.write_bytes(data)
    outcome = attempt(reader, path)
    if not _judged(outcome).failed:
        path.unlink()
    return outcome


def outcomes(folder: Path, trials: list[tuple[str, int]], seed: int) -> Iterator[tuple[str, int, Outcome]]:
    """What becomes of each trial's file, in a process of its own that is replaced where a reader ends it or hangs."""
    context = multiprocessing.get_context("spawn")
    while trials:
        ours, theirs = context.Pipe(duplex=False)
        process = context.Process(target=_work, args=(theirs, folder, trials, seed))
        process.start()
        theirs.close()
        ours.recv()  # ready
        done = 0
        try:
            while done < len(trials):
                outcome = ours.recv() if ours.poll(_HANGS) else Outcome("hangs")
                yield *trials[done], outcome
                done += 1
                if outcome.kind == "hangs":
                    break
        except EOFError:
            process.join()
            if process.exitcode:
                yield *trials[done], Outcome(f"ends the process ({process.exitcode})")
                done += 1
        process.kill()
        process.join()
        trials = trials[done:]


def compute(seed: int, num_mutations: int, folder: Path) -> dict[str, Any]:
    trials = [(name, number) for name in READERS for number in range(num_mutations)]
    rows: dict[str, dict[str, Any]] = {
        name: {"outcomes": Counter(), "most_seconds": 0.0, "most_growth": 0.0, "failures": []} for name in READERS
    }
    for name, number, outcome in outcomes(folder, trials, seed):
        row = rows[name]
        row["outcomes"][outcome.kind] += 1
        row["most_seconds"] = max(row["most_seconds"], outcome.seconds)
        row["most_growth"] = max(row["most_growth"], outcome.growth)
        if outcome.failed:
            row["failures"].append({"number": number, "kind": outcome.kind, "message": outcome.message})
    return {"mutations": num_mutations, "readers": rows}


def table(results: dict[str, Any]) -> str:
    """One line a reader."""
    lines = [f"{'reader':14}{'files':>8}{'read':>8}{'refused':>9}{'failed':>8}{'most s':>8}{'most MB':>9}"]
    for name, row in results["readers"].items():
        counts = row["outcomes"]
        lines.append(
            f"{name:14}{results['mutations']:8}{counts.get('read', 0):8}{counts.get('refused', 0):9}"
            f"{len(row['failures']):8}{row['most_seconds']:8.2f}{row['most_growth'] / 1e6:9.0f}"
        )
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = command_line(NAME, __doc__)
    parser.add_argument("--mutations", type=int, help=f"files a reader (default: {MUTATIONS})")
    arguments = parser.parse_args()
    output = output_folder(arguments)
    if not arguments.draw:
        kept = output / _KEPT if arguments.output or arguments.smoke else Path(tempfile.mkdtemp(prefix="plr_jax_"))
        kept.mkdir(parents=True, exist_ok=True)
        number = arguments.mutations or (SMOKE_MUTATIONS if arguments.smoke else MUTATIONS)
        results = compute(arguments.seed, number, kept)
        record = {"experiment": NAME, "smoke": arguments.smoke, "seed": arguments.seed, **environment()}
        print(f"wrote {write(output, NAME, {**record, 'results': results})}")
        print(f"files that a reader failed at are in {kept}")
    text = table(read(output, NAME)["results"])
    (output / f"{NAME}.txt").write_text(text, encoding="utf-8")
    print(text, end="")


if __name__ == "__main__":
    main()
