"""Functions as files: both kinds are written alike, and told apart by their first bytes."""

import os
from pathlib import Path

from plr_jax._atomic import write_atomically
from plr_jax.plr._plr import PLR, plr_from_bytes
from plr_jax.plr.leaves.continuous import codec as _nodal_file
from plr_jax.plr.leaves.continuous.evaluation import ContinuousPLR, continuous_from_bytes


def from_bytes(data: bytes) -> PLR | ContinuousPLR:
    """The PLR, plain or continuous, that a file's bytes hold.

    Args:
        data: What ``to_bytes`` of a PLR gave.

    Raises:
        ValueError: If the bytes are not those of a PLR file of a version this release reads, or its distances are
            beyond 32-bit floats.
    """
    return continuous_from_bytes(data) if data.startswith(_nodal_file.KIND.magic) else plr_from_bytes(data)


def save(plr: PLR | ContinuousPLR, path: str | os.PathLike) -> None:
    """Write a PLR to a file of ``plr.num_bytes`` bytes.

    The formats are documented in ``plr_jax/plr/_file.py`` and ``plr_jax/plr/_nodal_file.py``. The file is complete or
    absent: it is written under another name first, then renamed.

    Args:
        plr: The PLR, plain or continuous.
        path: The file.

    Raises:
        OSError: If the file cannot be written.
    """
    write_atomically(Path(path), plr.to_bytes())


def load(path: str | os.PathLike) -> PLR | ContinuousPLR:
    """Read a PLR that :func:`save` wrote; it equals the saved one bit for bit.

    Args:
        path: The file.

    Returns:
        The PLR, of the kind that was saved.

    Raises:
        ValueError: If the file is truncated, corrupt, no PLR file, or of a newer format.
        OSError: If the file cannot be read.
    """
    try:
        return from_bytes(Path(path).read_bytes())
    except ValueError as error:
        raise ValueError(f"{path} cannot be read as a PLR: {error}.") from error
