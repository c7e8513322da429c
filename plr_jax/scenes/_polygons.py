"""Reader of polygon files: free space as outer rings with holes, in JSON."""

import json
import os
from pathlib import Path
from typing import Any

from plr_jax.geometry.workspace import Workspace


def read_polygons(path: str | os.PathLike[str], *, squeeze: bool = False) -> Workspace:
    """Read a workspace from a JSON file of free-space polygons.

    A ring is a list of ``[x, y]`` points. Three shapes of file are understood::

        {"components": [{"outer": ring, "holes": [ring, ...]}, ...]}
        {"outer": ring, "holes": [ring, ...]}
        {"boundary": ring, "holes": [ring, ...]}        (extremitypathfinder)

    ``"holes"`` may be missing; other keys are ignored.

    Args:
        path: The ``.json`` file.
        squeeze: Whether a path may pass between two obstacles that touch in one point.

    Returns:
        The workspace; its bounds are the bounding box of the polygons.

    Raises:
        ValueError: If the file is no JSON, has none of these shapes, or a ring is invalid.
        OSError: If the file cannot be read.
    """
    path = Path(path)
    try:
        return Workspace.from_polygons(_components(read_json(path)), squeeze=squeeze)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def read_json(path: Path) -> Any:
    """The parsed JSON file, with an error that names what is wrong with it instead of a traceback."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except UnicodeDecodeError:
        raise ValueError("expected JSON text, got a binary file.") from None
    except json.JSONDecodeError as error:
        raise ValueError(f"expected JSON, got something else or a damaged file ({error}).") from None


def _components(data: Any) -> list[dict[str, Any]]:
    if isinstance(data, dict):
        if isinstance(data.get("components"), list):
            return [_component(entry, "outer") for entry in data["components"]]
        for outer in ("outer", "boundary"):
            if outer in data:
                return [_component(data, outer)]
    raise ValueError(
        'expected {"components": [{"outer", "holes"}, ...]}, {"outer", "holes"} or {"boundary", "holes"}.'
    )


def _component(entry: Any, outer: str) -> dict[str, Any]:
    if not isinstance(entry, dict) or outer not in entry or not isinstance(entry.get("holes", []), list):
        raise ValueError(f'expected every component to be {{"{outer}": ring, "holes": [ring, ...]}}.')
    return {"outer": entry[outer], "holes": entry.get("holes", [])}
