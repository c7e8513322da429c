"""Reader of polygon files: free space as outer rings with holes, in JSON."""

import os
from pathlib import Path
from typing import Any

from plr_jax.geometry.workspace import Workspace
from plr_jax.scenes._documents import errors_named, json_of


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
    with errors_named(path):
        return Workspace.from_polygons(_components(json_of(path)), squeeze=squeeze)


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
