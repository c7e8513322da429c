"""Files of buildings: floors and the links between them, as JSON."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from plr_jax._arrays import shortened
from plr_jax._files import StrPath, errors_named, file_path, format_name, json_of, require_format, write_atomically
from plr_jax.buildings import Building, Link
from plr_jax.geometry.workspace import Workspace
from plr_jax.scenes._scenes import read_workspace_entry, workspace_entry
from plr_jax.scenes._workspaces import read_workspace

_KIND = "building"
_KEYS = ("start", "end", "cost")


def save_building(building: Building, path: StrPath) -> None:
    """Write a building as a JSON file, with its floors inside; :func:`read_building` describes the format.

    ``OSError`` if the file cannot be written; an interrupted write leaves no partial file.
    """
    content = {
        "format": format_name(_KIND),
        "version": 1,
        "floors": [workspace_entry(floor) for floor in building.floors],
        "links": [asdict(link) for link in building.links],
    }
    write_atomically(file_path(path), (json.dumps(content, indent=1) + "\n").encode())


def read_building(path: StrPath) -> Building:
    """Read a building from a JSON file.

    The file is one object with these keys::

        "format":   "plr_jax building"
        "version":  1
        "floors":   [a workspace as in a scene file, or the name of a file beside this one, ...]
        "links":    [{"start": [floor, [x, y]], "end": [floor, [x, y]], "cost": c, "both_ways": true}, ...]

    A floor in a file of its own is read by :func:`read_workspace`. Floors are numbered from 0. ``"both_ways"`` is
    optional; without it, a link leads both ways. ``ValueError`` if the file is invalid.
    """
    with errors_named(path) as file:
        content = json_of(file)
        require_format(content, _KIND, 1, ("floors", "links"))
        floors, links = content["floors"], content["links"]
        if not isinstance(floors, list) or not isinstance(links, list):
            got = f"{shortened(floors)} and {shortened(links)}"
            raise ValueError(f'expected lists of "floors" and "links", got {got}.')
        return Building([_read_floor(file, i, entry) for i, entry in enumerate(floors)], map(_read_link, links))


def is_building(path: StrPath) -> bool:
    """Return whether the file ``path`` is JSON that declares itself a building of this format, of any version."""
    try:
        content = json_of(Path(path))
    except (ValueError, OSError):
        return False
    return isinstance(content, dict) and content.get("format") == format_name(_KIND)


def _read_floor(file: Path, i: int, entry: Any) -> Workspace:
    try:
        return read_workspace(file.parent / entry) if isinstance(entry, str) else read_workspace_entry(entry)
    except ValueError as error:
        raise ValueError(f"floor {i}: {error}") from None


def _read_link(entry: Any) -> Link:
    if not isinstance(entry, dict) or not set(_KEYS) <= set(entry):
        raise ValueError(f"expected links with {', '.join(_KEYS)}, got {shortened(entry)}.")
    return Link(entry["start"], entry["end"], entry["cost"], entry.get("both_ways", True))
