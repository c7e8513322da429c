"""PLRs saved to files and loaded from them."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from plr_jax._arrays import shortened
from plr_jax._atomic import write_atomically
from plr_jax.pairs.pair_plr import PairPLR, pairs_from_bytes
from plr_jax.plr._assembly import from_bytes
from plr_jax.plr._plr import PLR
from plr_jax.plr.file.container import read_bytes

Read = TypeVar("Read", PLR, PairPLR)


def save(plr: PLR | PairPLR, path: str | os.PathLike) -> None:
    """Write a PLR, or a PairPLR, to a file of ``plr.num_bytes`` bytes.

    The format is documented in ``plr_jax/plr/file/container.py``. The file is complete or absent: it is written under
    another name first, then renamed.

    Args:
        plr: The PLR.
        path: The file.

    Raises:
        ValueError: If it is no PLR.
        OSError: If the file cannot be written.
    """
    if not isinstance(plr, PLR | PairPLR):
        raise ValueError(f"Only a PLR or a PairPLR can be saved, got {shortened(plr)}.")
    write_atomically(Path(path), plr.to_bytes())


def load(path: str | os.PathLike) -> PLR:
    """Read a PLR that :func:`save` wrote; it answers alike, bit for bit, and has the same ``to_bytes()``.

    Args:
        path: The file.

    Returns:
        The PLR.

    Raises:
        ValueError: If the file is truncated, corrupt, no PLR file, of pairs, or of another version of the format.
        OSError: If the file cannot be read.
    """
    return _read(path, "a PLR", from_bytes)


def load_pairs(path: str | os.PathLike) -> PairPLR:
    """Read a PairPLR that :func:`save` wrote; it answers alike, bit for bit.

    What a query reads is many times as large as the file, and made when it is first asked: of thousands of corners
    that takes seconds to minutes. A file that was cut off at one of its ``file_marks`` is one of the same distances,
    whose queries take longer; its bounds are as true.

    Args:
        path: The file.

    Returns:
        The PairPLR.

    Raises:
        ValueError: If the file is truncated, corrupt, not one of pairs, or of another version of the format.
        OSError: If the file cannot be read.
    """
    return _read(path, "a PairPLR", pairs_from_bytes)


def _read(path: str | os.PathLike, what: str, from_data: Callable[[bytes], Read]) -> Read:
    try:
        return from_data(read_bytes(path))
    except ValueError as error:
        raise ValueError(f"{path} cannot be read as {what}: {error}.") from error
