"""Run long constructions of PLRs on parallel workers, and keep finished results in checkpoint files.

A checkpoint file has a head, which identifies the computation, and records with a key and a checksum each. Whoever
opens the file drops the first incomplete or damaged record and all later records.
"""

import os
import struct
import zlib
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor, as_completed
from contextlib import suppress
from dataclasses import dataclass
from hashlib import sha256
from itertools import zip_longest
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
_RECORD = struct.Struct(f"<{KEY_SIZE}sII")  # key, size, checksum
_NUM_POINTS = 256  # test points whose distances identify a distance function


class Checkpoint:
    """A checkpoint file of a computation, identified by ``digest``; ``records`` maps keys to finished results."""

    def __init__(self, path: str | os.PathLike, digest: bytes):
        if not isinstance(path, str | os.PathLike):
            raise ValueError(f"checkpoint must be the path of a file or None, got {shortened(path)}.")
        self._path, self._head, self.records = Path(path), _MAGIC + digest, dict[bytes, bytes]()
        data = self._path.read_bytes() if self._path.exists() else b""
        head = data[: len(self._head)]
        if not self._head.startswith(head):
            if not head.startswith(_MAGIC):
                raise ValueError(
                    f"checkpoint must be a checkpoint file or a new path, got {path}. Choose another path."
                )
            raise ValueError(
                f"{path} is the checkpoint of other work: with another distance function, grid, domain, option or "
                "release. Choose another path, or delete it to start again."
            )
        self._end = self._read(data) if len(head) == len(self._head) else 0
        if not self._end:
            self._append(self._head)

    def add(self, records: Mapping[bytes, bytes]) -> None:
        self.records.update(records)
        self._append(_encode_records(records))

    def finish(self) -> None:
        # Sort the records, so that the file does not depend on the order in which workers finished.
        write_atomically(self._path, self._head + _encode_records(dict(sorted(self.records.items()))))

    def _append(self, data: bytes) -> None:
        with open(self._path, "r+b" if self._path.exists() else "xb") as file:
            file.seek(self._end)
            file.write(data)
            file.truncate()
            file.flush()
            os.fsync(file.fileno())
        self._end += len(data)

    def _read(self, data: bytes) -> int:
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
    return b"".join(_RECORD.pack(key, len(data), zlib.crc32(key + data)) + data for key, data in records.items())


def digest_of(oracles: Sequence[DistanceFn], domain: Box, options: str) -> bytes:
    """Return a digest that identifies a computation: release, domain, options, and distances at test points."""
    # Numbers are rounded to 32 bits, because machines round differently.
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


_AT_ONCE = 1024  # points in a task, whatever the number of workers


@dataclass(frozen=True, eq=False)
class ParallelOracle:
    """A distance function that workers of an executor, if any, evaluate; a checkpoint, if any, keeps the answers."""

    distance_fn: DistanceFn
    executor: Executor | None
    checkpoint: Checkpoint | None

    def __call__(self, x: Points) -> Distances:
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
            for part, future in zip_longest(parts, futures):
                answer = None
                with suppress(BrokenExecutor):
                    answer = future and future.result()
                # If the worker died, this process computes the answer.
                answers.append(call_oracle(self.distance_fn, part) if answer is None else answer)
        finally:
            for future in futures:
                future.cancel()
        return np.concatenate(answers)


Chunk: TypeAlias = tuple[list[int], Callable[[], list[bytes]]]
"""Indices of some results (such as PLRs), and a function that computes the bytes of each."""


class BuildResults:
    """The ``results`` of many independent computations, such as PLRs, as bytes; None for missing results."""

    def __init__(self, total: int, checkpoint: Checkpoint | None) -> None:
        records = {} if checkpoint is None else checkpoint.records
        self.results, self._checkpoint = [records.get(_key(number)) for number in range(total)], checkpoint

    @property
    def count(self) -> int:
        return sum(result is not None for result in self.results)

    def build(self, chunks: list[Chunk], executor: Executor | None, progress: tqdm) -> None:
        """Compute all results on ``executor``, or on threads of this process if it is None or a worker dies."""
        threads = ThreadPoolExecutor(num_cores())
        try:
            left = chunks if executor is None else self._build_by(executor, chunks, progress)
            self._build_by(threads, left, progress)
        finally:
            threads.shutdown(wait=False, cancel_futures=True)
        if self._checkpoint is not None and self.count == len(self.results):
            self._checkpoint.finish()

    def _build_by(self, pool: Executor, chunks: list[Chunk], progress: tqdm) -> list[Chunk]:
        futures: dict[Future[list[bytes]], list[int]] = {}
        try:
            with suppress(BrokenExecutor):
                for numbers, build in chunks:
                    futures[pool.submit(build)] = numbers
            for future in as_completed(futures):
                with suppress(BrokenExecutor):
                    self._store(futures[future], future.result())
                    progress.update(len(futures[future]))
        finally:  # after an interrupt, keep what is finished
            for future, numbers in futures.items():
                if not future.cancel() and future.done() and future.exception() is None:
                    self._store(numbers, future.result())
        return [chunk for chunk in chunks if self.results[chunk[0][0]] is None]

    def _store(self, numbers: list[int], results: list[bytes]) -> None:
        if self._checkpoint is not None and self.results[numbers[0]] is None:
            self._checkpoint.add({_key(number): data for number, data in zip(numbers, results, strict=True)})
        for number, data in zip(numbers, results, strict=True):
            self.results[number] = data


def _key(number: int) -> bytes:
    return number.to_bytes(KEY_SIZE, "big")
