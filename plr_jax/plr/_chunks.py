"""Parts of long work, built by threads, processes or machines, with what is done kept."""

from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor, as_completed
from contextlib import suppress
from dataclasses import dataclass

from tqdm import tqdm

from plr_jax._compiled import num_cores
from plr_jax.plr._checkpoint import KEY_SIZE, Checkpoint


@dataclass(frozen=True, eq=False)
class Chunk:
    """Some of the parts, by their numbers, and what gives their bytes, in a process of its own perhaps."""

    numbers: list[int]
    results: Callable[[], list[bytes]]


@dataclass(frozen=True, eq=False)
class Done:
    """The bytes of the parts that are done, None for the others, and where they are kept."""

    results: list[bytes | None]
    checkpoint: Checkpoint | None

    @classmethod
    def of(cls, total: int, checkpoint: Checkpoint | None) -> "Done":
        """Those of a checkpoint, if there is one."""
        records = {} if checkpoint is None else checkpoint.records
        return cls([records.get(_key(number)) for number in range(total)], checkpoint)

    @property
    def count(self) -> int:
        """How many are done."""
        return sum(result is not None for result in self.results)

    def build(self, chunks: list[Chunk], executor: Executor | None, progress: tqdm) -> None:
        """Build chunks; what a pool does not finish because a worker of it dies, by threads of this process.

        If interrupted (Ctrl-C), what is done is here.
        """
        threads = ThreadPoolExecutor(num_cores())
        try:
            left = chunks if executor is None else self._build_by(executor, chunks, progress)
            self._build_by(threads, left, progress)
        finally:
            threads.shutdown(wait=False, cancel_futures=True)

    def finish(self) -> None:
        """Put the checkpoint in order, once all parts are done."""
        if self.checkpoint is not None and self.count == len(self.results):
            self.checkpoint.finish()

    def _build_by(self, pool: Executor, chunks: list[Chunk], progress: tqdm) -> list[Chunk]:
        """Build chunks by a pool; these are left of them when it breaks."""
        futures: dict[Future[list[bytes]], Chunk] = {}
        try:
            with suppress(BrokenExecutor):
                for chunk in chunks:
                    futures[pool.submit(chunk.results)] = chunk
            for future in as_completed(futures):
                with suppress(BrokenExecutor):
                    self._keep(futures[future], future.result())
                    progress.update(len(futures[future].numbers))
        except KeyboardInterrupt:
            for future, chunk in futures.items():
                if future.done() and not future.cancelled() and future.exception() is None:
                    self._keep(chunk, future.result())
            raise
        finally:
            for future in futures:
                future.cancel()
        return [chunk for chunk in chunks if self.results[chunk.numbers[0]] is None]

    def _keep(self, chunk: Chunk, results: list[bytes]) -> None:
        """Put the parts of a chunk in their places."""
        if self.checkpoint is not None and self.results[chunk.numbers[0]] is None:
            self.checkpoint.add({_key(number): data for number, data in zip(chunk.numbers, results, strict=True)})
        for number, data in zip(chunk.numbers, results, strict=True):
            self.results[number] = data


def _key(number: int) -> bytes:
    return number.to_bytes(KEY_SIZE, "big")
