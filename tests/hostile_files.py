"""Damaged and malicious files: every reader reads them, or refuses them by name, quickly and in little memory.

Valid files are mutated: bits are flipped, bytes inserted, deleted and repeated, ends cut off, numbers replaced by
extreme ones and lists by deep ones. The checksums of PLR files are repaired, since their reader would stop at them.

A reader may succeed, or raise a ``ValueError`` or an ``OSError`` that names the file. It fails if it raises another
exception, computes for more than a second, or makes the process grow by more than 100 MB. Files at which a reader
fails are kept.

``python tests/hostile_files.py`` tests 20,000 files per reader, which takes hours.
"""

import argparse
import re
import resource
import signal
import struct
import tempfile
import time
import warnings
from collections import Counter
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from hostile_readers import READERS, Reader

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
    """Apply one to four random mutations to a file's bytes."""
    kinds = ("flip", "insert", "delete", "repeat", "cut", *(("replace",) * 5 if text else ("overwrite",) * 2))
    for _ in range(int(rng.choice([1, 1, 1, 2, 3, 4]))):
        at = int(rng.integers(len(data) + 1))
        behind = at + int(rng.choice([1, 4, 40, 400]))
        match kinds[rng.integers(len(kinds))]:
            case "flip":
                flipped = bytes(byte ^ 1 << rng.integers(8) for byte in data[at : at + 1])
                data = data[:at] + flipped + data[at + 1 :]
            case "insert":
                data = data[:at] + rng.bytes(int(rng.integers(1, 9))) + data[at:]
            case "delete":
                data = data[:at] + data[behind:]
            case "repeat":
                data = data[:behind] + data[at:behind] * int(rng.choice([1, 2, 30])) + data[behind:]
            case "cut":
                data = data[:at] if rng.random() < 0.3 else data
            case "overwrite":
                pattern = _PATTERNS[rng.integers(len(_PATTERNS))]
                data = data[:at] + pattern + data[at + len(pattern) :]
            case "replace":  # replace a number, or an innermost list or mapping, by an extreme value
                if tokens := list((_NUMBER if rng.random() < 0.8 else _BRACKETS).finditer(data)):
                    token, extreme = tokens[rng.integers(len(tokens))], _EXTREMES[rng.integers(len(_EXTREMES))]
                    data = data[: token.start()] + extreme.encode() + data[token.end() :]
    return data


def hostile(reader: Reader, valid: list[bytes], seed: int, number: int) -> bytes:
    """Return the mutated file of a number, deterministically."""
    rng = np.random.default_rng([seed, number])
    data = mutated(valid[rng.integers(len(valid))], rng, reader.repaired is None)
    return reader.repaired(data) if reader.repaired and rng.random() < 0.95 else data


MOST_SECONDS, MOST_GROWTH = 1.0, 100e6  # limits of a reader: seconds, bytes
_HANGS = 60  # seconds after which a reader is interrupted
_ADDRESS_SPACE = 8 * 2**30  # bytes that a reader may allocate before allocations fail


class Outcome(NamedTuple):
    """The result of reading a file.

    Attributes:
        kind: "read" or "refused"; anything else is a failure of the reader.
        message: The message of the exception.
        seconds: CPU time.
        growth: Bytes by which the process grew beyond its largest size so far.
    """

    kind: str
    message: str
    seconds: float
    growth: float

    @property
    def failed(self) -> bool:
        return self.kind not in ("read", "refused")


def attempt(reader: Reader, path: Path) -> Outcome:
    """Read a file, and judge the reader by its exception, time and memory."""
    begin, before = time.process_time(), _peak()
    kind, message = "read", ""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            reader.read(path)
    except (ValueError, OSError) as error:
        kind, message = "refused" if str(path) in str(error) else "error without the file's name", repr(error)
    except Exception as error:
        kind, message = type(error).__name__, repr(error)
    outcome = Outcome(kind, message[:300], time.process_time() - begin, _peak() - before)
    if outcome.failed or (outcome.seconds <= MOST_SECONDS and outcome.growth <= MOST_GROWTH):
        return outcome
    return outcome._replace(kind="too slow" if outcome.seconds > MOST_SECONDS else "too large")


def _peak() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024.0


_valid = cache(lambda name: READERS[name].valid())


def trial(name: str, number: int, folder: Path) -> Outcome:
    """Read a mutated file, and keep it if its reader fails."""
    reader = READERS[name]
    path = folder / f"{name}_{number}{reader.suffix}"
    path.write_bytes(hostile(reader, _valid(name), 0, number))
    signal.alarm(_HANGS)
    outcome = attempt(reader, path)
    signal.alarm(0)
    if not outcome.failed:
        path.unlink()
    return outcome


def _give_up(*_: Any) -> None:
    raise RuntimeError("hangs")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mutations", type=int, default=20_000, help="files a reader")
    parser.add_argument("--readers", nargs="+", choices=READERS, metavar="READER", default=list(READERS))
    arguments = parser.parse_args()
    kept = Path(tempfile.mkdtemp(prefix="plr_jax_"))
    print(f"files that a reader fails at are in {kept}", flush=True)
    signal.signal(signal.SIGALRM, _give_up)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + _ADDRESS_SPACE, resource.RLIM_INFINITY))
    for name in arguments.readers:
        found = [trial(name, number, kept) for number in range(arguments.mutations)]
        seconds, growth = max(each.seconds for each in found), max(each.growth for each in found) / 1e6
        failures = {number: outcome for number, outcome in enumerate(found) if outcome.failed}
        kinds = dict(Counter(each.kind for each in found))
        print(f"{name}: {kinds}, at most {seconds:.2f} s and {growth:.0f} MB; {failures}", flush=True)


if __name__ == "__main__":
    main()
