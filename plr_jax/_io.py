"""PLRs, pairs and grids saved to files and loaded from them: a file says what it holds."""

import os
from typing import Any

from plr_jax._arrays import shortened
from plr_jax._files import file_path, write_atomically
from plr_jax.pairs.grid_pairs import GridPairs
from plr_jax.pairs.pair_plr import PairPLR, pairs_from_bytes
from plr_jax.plr._plr import PLR, from_bytes
from plr_jax.plr.container import GRID_MAGIC, holds_pairs, read_bytes


def save(plr: PLR | PairPLR | GridPairs, path: str | os.PathLike) -> None:
    """Write a PLR, or pairs of points or of cells of a grid, to a file of ``plr.num_bytes`` bytes.

    The formats are documented in ``plr_jax/plr/container.py`` and ``plr_jax/pairs/grid_pairs.py``. The file is
    complete or absent: it is written under another name first, then renamed.

    Args:
        plr: What to save; of a ``MetricPairs`` its ``plr``.
        path: The file.

    Raises:
        ValueError: If it is none of these, or the path no name of a file.
        OSError: If the file cannot be written.
    """
    if not isinstance(plr, PLR | PairPLR | GridPairs):
        raise ValueError(f"Only a PLR, a PairPLR or GridPairs can be saved, got {shortened(plr)}.")
    write_atomically(file_path(path), plr.to_bytes())


def load(path: str | os.PathLike) -> Any:
    """Read what :func:`save` wrote, whatever it is; it answers alike, bit for bit, and has the same ``to_bytes()``.

    What a query of a PairPLR reads is many times as large as the file, and made when it is first asked: of thousands
    of corners that takes seconds to minutes.

    Args:
        path: The file.

    Returns:
        A PLR, a PairPLR or GridPairs.

    Raises:
        ValueError: If the file is truncated, corrupt, none of these, or of another version of the format, or if the
            path is no name of a file.
        OSError: If the file cannot be read.
    """
    path = file_path(path)
    try:
        data = read_bytes(path)
        if data.startswith(GRID_MAGIC):
            return GridPairs.from_bytes(data)
        return pairs_from_bytes(data) if holds_pairs(data) else from_bytes(data)
    except ValueError as error:
        raise ValueError(f"{path} cannot be read as a PLR or as pairs: {error}.") from error
