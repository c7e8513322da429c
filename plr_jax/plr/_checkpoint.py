"""What is done of some long work, kept in a file, so that a process that was killed can go on where it was.

After a head, which tells the work, records are appended, each with a key and a checksum. One that was cut short, by
the kill or by a full disk, is dropped when the file is opened again.
"""

import os
import struct
import zlib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from hashlib import sha256
from pathlib import Path

import numpy as np

import plr_jax
from plr_jax._arrays import as_distances, shortened
from plr_jax._files import write_atomically
from plr_jax._types import DistanceFn, FamilyFn
from plr_jax.geometry.box import Box

KEY_SIZE = 16
_MAGIC = b"plr_jax checkpoint 1\n"
_RECORD = struct.Struct(f"<{KEY_SIZE}sII")  # key, bytes, checksum
_NUM_POINTS = 256  # at which distance functions are told apart


def require_path(checkpoint: object) -> None:
    """``ValueError`` unless it names a file."""
    if not isinstance(checkpoint, str | os.PathLike):
        raise ValueError(f"checkpoint must be the path of a file or None, got {shortened(checkpoint)}.")


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
        require_path(path)
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
        self._append(_joined(records))

    def finish(self) -> None:
        """Put the records in order, so that the file is the same however the work went."""
        write_atomically(self._path, self._head + _joined(dict(sorted(self.records.items()))))

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


def _joined(records: Mapping[bytes, bytes]) -> bytes:
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
