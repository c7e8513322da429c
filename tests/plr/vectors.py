"""Write ``tests/plr/vectors``: answers of the slow reader at points, for small PLR files of all kinds.

Run this script after saving a file NAME.plr of a new kind, or when the arithmetic of the format has changed:

    PYTHONPATH=tests:tests/plr python tests/plr/vectors.py NAME ...

For each file NAME.plr there is a table NAME.json: the ``type`` of the points, float32 or float64; the ``points``, as
hexadecimal floats; the ``distances``, as the bits of 32-bit floats in hexadecimal; for cones, the ``waypoints``, like
points.
"""

import json
import re
import sys
from pathlib import Path

import numpy as np

FOLDER = Path(__file__).parent / "vectors"
_POINTS = 100


def vector_names() -> list[str]:
    """Return the names of all vectors."""
    return sorted(path.stem for path in FOLDER.glob("*.json"))


def read_vector(name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Return points, distances, and waypoints, which are None unless leaves are cones."""
    table = json.loads((FOLDER / f"{name}.json").read_text())
    points, waypoints = (
        np.array([[float.fromhex(along) for along in point] for point in table.get(key, [])], table["type"])
        for key in ("points", "waypoints")
    )
    distances = np.array([int(text, 16) for text in table["distances"]], np.uint32).view(np.float32)
    return points, distances, waypoints if len(waypoints) else None


def write(name: str) -> None:
    """Write the vector of this name."""
    from portable_helpers import SlowReader, case, hard_points

    plr = case(name)
    every = hard_points(plr, 60)
    x = every[np.sort(np.random.default_rng(1).choice(len(every), _POINTS, replace=False))]
    reader = SlowReader(plr)
    table = {
        "type": x.dtype.name,
        "points": [[_hex(along) for along in point] for point in x],
        "distances": [f"{bits:08x}" for bits in reader(x).view(np.uint32)],
    }
    if plr.leaf.name == "cone":
        table["waypoints"] = [[_hex(along) for along in point] for point in reader.waypoint(x)]
    (FOLDER / f"{name}.json").write_text(json.dumps(table, indent=0) + "\n")


def _hex(value: float) -> str:
    return re.sub(r"\.?0*p", "p", float(value).hex())  # 32-bit floats end with zeros


if __name__ == "__main__":
    for name in sys.argv[1:]:
        write(name)
