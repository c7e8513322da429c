"""PLRs saved to files and loaded from them."""

import os
from pathlib import Path

from plr_jax._arrays import shortened
from plr_jax._atomic import write_atomically
from plr_jax.plr._assembly import from_bytes
from plr_jax.plr._plr import PLR
from plr_jax.plr.file.container import HEADER_SIZE, file_size, is_header


def save(plr: PLR, path: str | os.PathLike) -> None:
    """Write a PLR to a file of ``plr.num_bytes`` bytes.

    The format is documented in ``plr_jax/plr/file/container.py``. The file is complete or absent: it is written under
    another name first, then renamed.

    Args:
        plr: The PLR.
        path: The file.

    Raises:
        ValueError: If it is no PLR.
        OSError: If the file cannot be written.
    """
    if not isinstance(plr, PLR):
        raise ValueError(f"Only a PLR can be saved, got {shortened(plr)}.")
    write_atomically(Path(path), plr.to_bytes())


def load(path: str | os.PathLike) -> PLR:
    """Read a PLR that :func:`save` wrote; it answers alike, bit for bit, and has the same ``to_bytes()``.

    Args:
        path: The file.

    Returns:
        The PLR.

    Raises:
        ValueError: If the file is truncated, corrupt, no PLR file, or of another version of the format.
        OSError: If the file cannot be read.
    """
    try:
        with open(path, "rb") as file:
            data = file.read(HEADER_SIZE)
            if is_header(data):  # or nothing says how much to read
                data += file.read(max(file_size(data) - len(data), 0) + 1)
        return from_bytes(data)
    except ValueError as error:
        raise ValueError(f"{path} cannot be read as a PLR: {error}.") from error
