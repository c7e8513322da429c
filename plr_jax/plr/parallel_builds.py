"""Run long constructions of PLRs on parallel workers: calls of a distance function, or builds of many PLRs."""

from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor, as_completed
from contextlib import suppress
from dataclasses import dataclass
from itertools import zip_longest
from typing import NamedTuple

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
                if future is not None:
                    with suppress(BrokenExecutor):
                        answer = future.result()
                # If the worker died, this process computes the answer.
                answers.append(call_oracle(self.distance_fn, part) if answer is None else answer)
        finally:
            for future in futures:
                future.cancel()
        return np.concatenate(answers)


class Chunk(NamedTuple):
    """A task of one worker, which computes the bytes of several results, such as files of PLRs."""

    indices: list[int]  # of the results among those of all chunks
    compute: Callable[[], list[bytes]]  # returns the bytes of each result


def build_chunks(chunks: list[Chunk], executor: Executor | None, progress: tqdm) -> tuple[dict[int, bytes], bool]:
    """Compute the results of all chunks, such as files of PLRs, on parallel workers.

    ``executor`` computes the chunks. If it is None or a worker dies, threads of this process compute the missing
    chunks. ``progress`` counts the results. Return the finished results by index, and whether an interrupt (Ctrl-C)
    stopped the computation.
    """
    results: dict[int, bytes] = {}
    threads = ThreadPoolExecutor(num_cores())
    try:
        if executor is not None:
            _build_by(executor, chunks, results, progress)
        # A chunk has all of its results or none.
        missing = [chunk for chunk in chunks if chunk.indices[0] not in results]
        _build_by(threads, missing, results, progress)
    except KeyboardInterrupt:
        return results, True
    finally:
        threads.shutdown(wait=False, cancel_futures=True)
    return results, False


def _build_by(pool: Executor, chunks: list[Chunk], results: dict[int, bytes], progress: tqdm) -> None:
    """Compute chunks on the workers of a pool, and add the results of finished chunks to ``results`` by index.

    If workers die or an interrupt (Ctrl-C) stops the computation, the results of some chunks stay missing.
    """
    futures: dict[Future[list[bytes]], list[int]] = {}
    try:
        with suppress(BrokenExecutor):
            for chunk in chunks:
                futures[pool.submit(chunk.compute)] = chunk.indices
        for future in as_completed(futures):
            with suppress(BrokenExecutor):
                progress.update(len(future.result()))
    finally:  # after an interrupt or an error, keep what is finished
        for future, indices in futures.items():
            if not future.cancel() and future.done() and future.exception() is None:
                results.update(zip(indices, future.result(), strict=True))
