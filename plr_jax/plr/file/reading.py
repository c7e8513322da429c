"""Files as bytes, of which no more is read than may be a PLR."""

import os

from plr_jax.plr.file.container import MAGIC, MOST_BYTES

_START = 2**12


def read_bytes(path: str | os.PathLike) -> bytes:
    """What a file holds: all of it, or one byte more than a file may have; of what is no PLR file only the start."""
    with open(path, "rb") as file:
        data = file.read(_START)
        if data.startswith(MAGIC):  # or there is nothing to read for, and it may not end
            data += file.read(MOST_BYTES + 1 - len(data))
        return data
