"""Where the published collections are."""

import os
from pathlib import Path

SKIPPED = "skipped: PLR_JAX_DATA names no folder with this collection\n"


def collections(name: str) -> Path | None:
    """The folder of all collections; None if one of some name is not in it."""
    folder = os.environ.get("PLR_JAX_DATA")
    return Path(folder) if folder and (Path(folder) / name).is_dir() else None
