"""Saving PLRs, and distances between any two points (pairs), to files, and loading any of them."""

import os
from typing import Any

from plr_jax._arrays import shortened
from plr_jax._files import file_path, write_atomically
from plr_jax.pairs.grid_pairs import GridPairs
from plr_jax.pairs.pair_plr import PairPLR, pairs_from_bytes
from plr_jax.plr._plr import PLR, from_bytes
from plr_jax.plr.container import GRID_MAGIC, holds_pairs, read_bytes


def save(plr: PLR | PairPLR | GridPairs, path: str | os.PathLike) -> None:
    """Write a PLR, a PairPLR or GridPairs to a file of ``plr.num_bytes`` bytes, which is complete or absent.

    For a ``MetricPairs``, save its ``plr``. The formats are documented in ``plr/portable/FORMAT.md``,
    ``pairs/stored.py`` and ``pairs/grid_pairs.py``. Another object or file name raises ``ValueError``; a file that
    cannot be written raises ``OSError``.
    """
    if not isinstance(plr, PLR | PairPLR | GridPairs):
        raise ValueError(f"Only a PLR, a PairPLR or GridPairs can be saved, got {shortened(plr)}.")
    write_atomically(file_path(path), plr.to_bytes())


def load(path: str | os.PathLike) -> Any:
    """Read a PLR, a PairPLR or GridPairs that :func:`save` wrote.

    The result gives the same answers, bit for bit, as the saved object. The query tables of a PairPLR are many times
    larger than its file. They are built by the first query, which takes seconds to minutes with thousands of corners.
    A file that is truncated, corrupt, or of another kind or format version raises ``ValueError``; a file that cannot
    be read raises ``OSError``.
    """
    path = file_path(path)
    try:
        data = read_bytes(path)
        if data.startswith(GRID_MAGIC):
            return GridPairs.from_bytes(data)
        return pairs_from_bytes(data) if holds_pairs(data) else from_bytes(data)
    except ValueError as error:
        raise ValueError(f"{path} cannot be read as a PLR or as pairs: {error}.") from error
