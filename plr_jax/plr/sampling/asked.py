"""Distance functions that take long: asked by the workers of an executor, their answers kept."""

from collections.abc import Mapping
from concurrent.futures import BrokenExecutor, Executor, Future
from dataclasses import dataclass
from hashlib import sha256
from typing import Protocol, runtime_checkable

import numpy as np

from plr_jax._arrays import shortened
from plr_jax._types import DistanceFn, Distances, Points
from plr_jax.plr.sampling.cell_fit import call_oracle

_AT_ONCE = 1024  # points that a worker is asked for, however many workers there are


@runtime_checkable
class Kept(Protocol):
    """Where answers are kept, by keys of 16 bytes."""

    @property
    def records(self) -> Mapping[bytes, bytes]:
        """What is kept."""
        ...

    def add(self, records: Mapping[bytes, bytes], /) -> None:
        """Keep more."""
        ...


@dataclass(frozen=True, eq=False)
class AskedFn:
    """A distance function, answered from what is kept or by workers; None: by this process, and kept nowhere."""

    distance_fn: DistanceFn
    executor: Executor | None
    kept: Kept | None

    def __call__(self, x: Points) -> Distances:
        """Distances of points."""
        if self.kept is None:
            return self._ask(x)
        key = sha256(np.array(x.shape).tobytes() + x.tobytes()).digest()[:16]
        if key not in self.kept.records:
            self.kept.add({key: self._ask(x).tobytes()})
        return np.frombuffer(self.kept.records[key]).copy()

    def _ask(self, x: Points) -> Distances:
        if self.executor is None:
            return call_oracle(self.distance_fn, x)
        parts, futures = [x[begin : begin + _AT_ONCE] for begin in range(0, len(x), _AT_ONCE)], []
        try:
            for part in parts:
                futures.append(_submitted(self.executor, self.distance_fn, part))
            answers = [self._answer(*pair) for pair in zip(parts, futures, strict=True)]
        finally:
            for future in futures:
                future.cancel()
        return np.concatenate([np.empty(0), *answers])

    def _answer(self, x: Points, future: "Future[Distances]") -> Distances:
        """What a worker says; what this process does, if the worker died."""
        try:
            return future.result()
        except BrokenExecutor:
            return call_oracle(self.distance_fn, x)


def as_executor(executor: object) -> Executor | None:
    """An executor, or None; raises ``ValueError`` if it is neither."""
    if executor is not None and not isinstance(executor, Executor):
        raise ValueError(f"executor must be a concurrent.futures.Executor or None, got {shortened(executor)}.")
    return executor


def _submitted(executor: Executor, distance_fn: DistanceFn, x: Points) -> "Future[Distances]":
    """The answer to come; one that never will, if the executor is broken already."""
    try:
        return executor.submit(call_oracle, distance_fn, x)
    except BrokenExecutor as error:
        future: Future[Distances] = Future()
        future.set_exception(error)
        return future
