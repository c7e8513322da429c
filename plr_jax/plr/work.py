"""Work that takes long: workers that answer or build, and a checkpoint file that keeps what is done.

A checkpoint file has a head, which identifies the work, and then records, each with a key and a checksum. A record
that was cut short, by a kill or by a full disk, is dropped when the file is opened again.
"""

import os
import struct
import zlib
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor, as_completed
from contextlib import suppress
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import TypeAlias

import numpy as np
from tqdm import tqdm

import plr_jax
from plr_jax._arrays import as_distances, shortened
from plr_jax._compiled import num_cores
from plr_jax._files import write_atomically
from plr_jax._types import DistanceFn, Distances, FamilyFn, Points
from plr_jax.geometry.box import Box
from plr_jax.plr.sampling import call_oracle

KEY_SIZE = 16
_MAGIC = b"plr_jax checkpoint 1\n"
_RECORD = struct.Struct(f"<{KEY_SIZE}sII")  # key, bytes, checksum
_NUM_POINTS = 256  # at which distance functions are told apart


class Checkpoint:
    """The file of some work.

    Args:
        path: The file, which is made where there is none.
        digest: What tells this work from any other.

    Attributes:
        records: What is done, by key.

    Raises:
        ValueError: If the file is of other work, or no checkpoint.
        OSError: If it cannot be read or written.
    """

    def __init__(self, path: str | os.PathLike, digest: bytes):
        if not isinstance(path, str | os.PathLike):
            raise ValueError(f"checkpoint must be the path of a file or None, got {shortened(path)}.")
        self._path, self._head, self.records = Path(path), _MAGIC + digest, dict[bytes, bytes]()
        data = b""
        with suppress(FileNotFoundError):
            data = self._path.read_bytes()
        head = data[: len(self._head)]
        if not self._head.startswith(head):
            if not head.startswith(_MAGIC):
                raise ValueError(f"{path} is no checkpoint: choose another path.")
            raise ValueError(
                f"{path} is the checkpoint of other work: its distance functions or grid, domain, options or release "
                "were others. Choose another path, or delete it to begin anew."
            )
        self._end = self._read(data) if len(head) == len(self._head) else 0
        if not self._end:
            self._append(self._head)

    def add(self, records: Mapping[bytes, bytes]) -> None:
        """Keep what is done."""
        self.records.update(records)
        self._append(_encode_records(records))

    def finish(self) -> None:
        """Put the records in order, so that the file is the same however the work went."""
        write_atomically(self._path, self._head + _encode_records(dict(sorted(self.records.items()))))

    def _append(self, data: bytes) -> None:
        """Write behind what is whole, over a record that was cut short."""
        with open(self._path, "r+b" if self._path.exists() else "xb") as file:
            file.seek(self._end)
            file.write(data)
            file.truncate()
            file.flush()
            os.fsync(file.fileno())
        self._end += len(data)

    def _read(self, data: bytes) -> int:
        """Read the records up to the first that is not whole, which begins where this says."""
        end = len(self._head)
        while end + _RECORD.size <= len(data):
            key, size, checksum = _RECORD.unpack_from(data, end)
            record = data[end + _RECORD.size : end + _RECORD.size + size]
            if len(record) < size or zlib.crc32(key + record) != checksum:
                break
            self.records[key] = record
            end += _RECORD.size + size
        return end


def _encode_records(records: Mapping[bytes, bytes]) -> bytes:
    heads = (_RECORD.pack(key, len(record), zlib.crc32(key + record)) for key, record in records.items())
    return b"".join(part for both in zip(heads, records.values(), strict=True) for part in both)


def digest_of(oracles: Sequence[DistanceFn], domain: Box, options: str) -> bytes:
    """What tells work from any other: the release, the domain, options, and distances.

    Of a distance function these are those at some points; of a family, at some points from one of them, and of
    each that of all sources. They count to 32-bit floats, as other machines may round otherwise.
    """
    digest = sha256(f"{plr_jax.__version__} {domain} {options} {len(oracles)}".encode())
    x, families = np.random.default_rng(0).uniform(domain.lo, domain.hi, (_NUM_POINTS, domain.dim)), set()
    for oracle in oracles:
        if isinstance(oracle, FamilyFn):
            digest.update(oracle.sources.points.astype(np.float32).tobytes())
            digest.update(oracle.sources.distances.astype(np.float32).tobytes())
            if id(oracle.family) in families:
                continue
            families.add(id(oracle.family))
        digest.update(as_distances("distance_fn", oracle(x.copy()), x).astype(np.float32).tobytes())
    return digest.digest()


_AT_ONCE = 1024  # points that a worker is asked for, however many workers there are


@dataclass(frozen=True, eq=False)
class ParallelOracle:
    """A distance function, answered from what is kept or by workers; None: by this process, and kept nowhere."""

    distance_fn: DistanceFn
    executor: Executor | None
    checkpoint: Checkpoint | None

    def __call__(self, x: Points) -> Distances:
        """Distances of points."""
        if self.checkpoint is None:
            return self._evaluate(x)
        key = sha256(np.array(x.shape).tobytes() + x.tobytes()).digest()[:16]
        if key not in self.checkpoint.records:
            self.checkpoint.add({key: self._evaluate(x).tobytes()})
        return np.frombuffer(self.checkpoint.records[key]).copy()

    def _evaluate(self, x: Points) -> Distances:
        if self.executor is None:
            return call_oracle(self.distance_fn, x)
        parts, futures = [x[begin : begin + _AT_ONCE] for begin in range(0, len(x), _AT_ONCE)], []
        try:
            with suppress(BrokenExecutor):
                for part in parts:
                    futures.append(self.executor.submit(call_oracle, self.distance_fn, part))
            answers = [np.empty(0)]
            for number, part in enumerate(parts):
                answer = None
                with suppress(BrokenExecutor):
                    answer = futures[number].result() if number < len(futures) else None
                # If a worker has died, this process answers.
                answers.append(call_oracle(self.distance_fn, part) if answer is None else answer)
        finally:
            for future in futures:
                future.cancel()
        return np.concatenate(answers)


Chunk: TypeAlias = tuple[list[int], Callable[[], list[bytes]]]
"""Numbers of some parts, and a function that returns the bytes of each, in a process of its own perhaps."""


class BuildResults:
    """The bytes of the parts that are done, None for the others.

    Args:
        total: The number of parts.
        checkpoint: The file that keeps what is done; None: no file.
    """

    def __init__(self, total: int, checkpoint: Checkpoint | None) -> None:
        records = {} if checkpoint is None else checkpoint.records
        self.results, self._checkpoint = [records.get(_key(number)) for number in range(total)], checkpoint

    @property
    def count(self) -> int:
        """How many are done."""
        return sum(result is not None for result in self.results)

    def build(self, chunks: list[Chunk], executor: Executor | None, progress: tqdm) -> None:
        """Build chunks; what a pool does not finish because a worker of it dies, by threads of this process.

        If interrupted (Ctrl-C), what is done is here. Once all parts are done, the checkpoint is put in order.
        """
        threads = ThreadPoolExecutor(num_cores())
        try:
            left = chunks if executor is None else self._build_by(executor, chunks, progress)
            self._build_by(threads, left, progress)
        finally:
            threads.shutdown(wait=False, cancel_futures=True)
        if self._checkpoint is not None and self.count == len(self.results):
            self._checkpoint.finish()

    def _build_by(self, pool: Executor, chunks: list[Chunk], progress: tqdm) -> list[Chunk]:
        """Build chunks by a pool; these are left of them when it breaks."""
        futures: dict[Future[list[bytes]], Chunk] = {}
        try:
            with suppress(BrokenExecutor):
                for chunk in chunks:
                    futures[pool.submit(chunk[1])] = chunk
            for future in as_completed(futures):
                with suppress(BrokenExecutor):
                    numbers, _ = futures[future]
                    self._store(numbers, future.result())
                    progress.update(len(numbers))
        except KeyboardInterrupt:
            for future, chunk in futures.items():
                if future.done() and not future.cancelled() and future.exception() is None:
                    self._store(chunk[0], future.result())
            raise
        finally:
            for future in futures:
                future.cancel()
        return [chunk for chunk in chunks if self.results[chunk[0][0]] is None]

    def _store(self, numbers: list[int], results: list[bytes]) -> None:
        """Put the parts of a chunk in their places."""
        if self._checkpoint is not None and self.results[numbers[0]] is None:
            self._checkpoint.add({_key(number): data for number, data in zip(numbers, results, strict=True)})
        for number, data in zip(numbers, results, strict=True):
            self.results[number] = data


def _key(number: int) -> bytes:
    return number.to_bytes(KEY_SIZE, "big")
