"""Where the published collections are."""

import os
from pathlib import Path

SKIPPED = "skipped: PLR_JAX_DATA names no folder with this collection\n"


def collection(name: str) -> Path | None:
    """The folder of a collection, by its name; None where it is not there."""
    folder = os.environ.get("PLR_JAX_DATA")
    return Path(folder, name) if folder and Path(folder, name).is_dir() else None
