"""Write ``tests/plr/vectors``: small PLR files, points, and the answers of the slow reader at these points.

Run this script when the format or its arithmetic has changed on purpose:

    PYTHONPATH=tests:tests/plr python tests/plr/vectors.py

For each file NAME.plr there is a table NAME.json: the ``type`` of the points, float32 or float64; the ``points``, as
hexadecimal floats; the ``distances``, as the bits of 32-bit floats in hexadecimal; for cones, the ``waypoints``, like
points.
"""

import json
from pathlib import Path
from typing import NamedTuple

import numpy as np

FOLDER = Path(__file__).parent / "vectors"
_CHOSEN = "maze of planes, maze of values, maze of gradients, maze of cones, cones of exits, cones in space"
_CHOSEN += ", random planes, deep, around, random values, smooth around"
_CHOSEN += ", folded car, folded car of planes, far cones, far folded car"
_POINTS = 200


def vector_names() -> list[str]:
    """Return the names of all vectors."""
    return sorted(path.stem for path in FOLDER.glob("*.json"))


class Vector(NamedTuple):
    """A file, points, and the answers there; ``waypoints`` are None unless leaves are cones."""

    path: Path
    points: np.ndarray
    distances: np.ndarray
    waypoints: np.ndarray | None


def read_vector(name: str) -> Vector:
    """Read the vector of this name."""
    table = json.loads((FOLDER / f"{name}.json").read_text())
    points, waypoints = (
        np.array([[float.fromhex(along) for along in point] for point in table.get(key, [])], table["type"])
        for key in ("points", "waypoints")
    )
    distances = np.array([int(text, 16) for text in table["distances"]], np.uint32).view(np.float32)
    return Vector(FOLDER / f"{name}.plr", points, distances, waypoints if len(waypoints) else None)


def write() -> None:
    """Write all vectors."""
    from portable_helpers import CASES, SlowReader, hard_points

    from plr_jax import save

    FOLDER.mkdir(exist_ok=True)
    for path in FOLDER.glob("*.json"):  # beside files that are refused
        path.unlink()
    for name in _CHOSEN.split(", "):
        plr, file = CASES[name](), name.replace(" ", "_")
        every = hard_points(plr, 60)
        x = every[np.sort(np.random.default_rng(1).choice(len(every), _POINTS, replace=False))]
        save(plr, FOLDER / f"{file}.plr")
        reader = SlowReader(plr)
        table = {
            "type": x.dtype.name,
            "points": [[float(along).hex() for along in point] for point in x],
            "distances": [f"{bits:08x}" for bits in reader(x).view(np.uint32)],
        }
        if plr.leaf.name == "cone":
            table["waypoints"] = [[float(along).hex() for along in point] for point in reader.waypoint(x)]
        (FOLDER / f"{file}.json").write_text(json.dumps(table, indent=0) + "\n")


if __name__ == "__main__":
    write()
