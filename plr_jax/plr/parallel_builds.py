"""Run long constructions of PLRs on parallel workers: calls of a distance function, or builds of many PLRs."""

from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor, as_completed
from contextlib import suppress
from dataclasses import dataclass
from itertools import zip_longest
from typing import TypeAlias

import numpy as np
from tqdm import tqdm

from plr_jax._compiled import num_cores
from plr_jax._types import DistanceFn, Distances, Points
from plr_jax.plr.sampling import call_oracle

_AT_ONCE = 1024  # points in a task, whatever the number of workers


@dataclass(frozen=True, eq=False)
class ParallelOracle:
    """A distance function that the workers of an executor evaluate in parallel, in tasks of up to 1,024 points."""

    distance_fn: DistanceFn
    executor: Executor

    def __call__(self, x: Points) -> Distances:
        parts = [x[begin : begin + _AT_ONCE] for begin in range(0, len(x), _AT_ONCE)]
        futures = []  # fewer than parts, if the workers died meanwhile
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


def build_chunks(chunks: list[Chunk], executor: Executor | None, progress: tqdm) -> tuple[dict[int, bytes], bool]:
    """Compute the results of all chunks, such as files of PLRs, on parallel workers.

    A chunk is a pair: the indices of some results, and a function that returns the bytes of these results.
    ``executor`` computes the chunks. If it is None or a worker dies, threads of this process compute the missing
    chunks. ``progress`` counts the results. Return the finished results by index, and whether an interrupt (Ctrl-C)
    stopped the computation.
    """
    results: dict[int, bytes] = {}
    threads = ThreadPoolExecutor(num_cores())
    try:
        if executor is not None:
            _build_by(executor, chunks, results, progress)
        _build_by(threads, [chunk for chunk in chunks if chunk[0][0] not in results], results, progress)
    except KeyboardInterrupt:
        return results, True
    finally:
        threads.shutdown(wait=False, cancel_futures=True)
    return results, False


def _build_by(pool: Executor, chunks: list[Chunk], results: dict[int, bytes], progress: tqdm) -> None:
    """Compute chunks on the workers of a pool; as each chunk finishes, add its results to ``results`` by index.

    If workers die, the results of some chunks stay missing.
    """
    futures: dict[Future[list[bytes]], list[int]] = {}
    try:
        with suppress(BrokenExecutor):
            for numbers, build in chunks:
                futures[pool.submit(build)] = numbers
        for future in as_completed(futures):
            with suppress(BrokenExecutor):
                results.update(zip(futures[future], future.result(), strict=True))
                progress.update(len(futures[future]))
    finally:  # after an interrupt, keep what is finished
        for future, numbers in futures.items():
            if not future.cancel() and future.done() and future.exception() is None:
                results.update(zip(numbers, future.result(), strict=True))
