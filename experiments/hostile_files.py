"""Damaged and malicious files: every reader refuses them by name, at once, and in little memory, or reads them.

Valid files are mutated: bits flipped, bytes inserted, deleted and repeated, ends cut off, numbers replaced by extreme
ones, lists by deep ones. A PLR file gets checksums that fit again, or its reader would look no further.
A reader may read what comes of it, or raise a ``ValueError`` or an ``OSError`` with the file's name in it. It fails
by any other exception, by more than a second of computing, and by a process that grows by more than 100 MB.
Files that a reader failed at are kept.
"""

import multiprocessing
import resource
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from experiments._mutations import READERS, Reader, hostile
from experiments._results import command_line, environment, output_folder, read, write

NAME = "hostile_files"
MUTATIONS, SMOKE_MUTATIONS = 20_000, 40
MOST_SECONDS, MOST_GROWTH = 1.0, 100e6
_HANGS = 60.0  # seconds after which a reader is ended
_ADDRESS_SPACE = 8 * 2**30  # beyond what is in use: the net under a reader that asks for all there is
_KEPT = "hostile_files"


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
