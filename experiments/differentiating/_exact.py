"""``polygon_distance`` beside ``VisibilityGraph`` on random maps, in 32 and in 64 bits.

Some points and goals are corners. A point at which two polygons touch is left out: it belongs to one side of the
contact only. Points beside a wall, within 1e-6 of the map in 32 bits and 1e-14 in 64, may count as inside or outside;
those that the oracle places on the other side are counted apart.
"""

from typing import Any

import jax
import numpy as np
import shapely

from experiments.differentiating._random_maps import RandomMap, random_map
from plr_jax import VisibilityGraph, Workspace, polygon_distance

MAPS, POINTS = 200, 1_000
ALLOWED = {32: 1e-5, 64: 1e-10}
BESIDE_WALLS = {32: 1e-6, 64: 1e-15}
_AT_CORNERS = 50
_FEWEST_CORNERS = 8
_TIGHT, _WIDE = ((0.0, 0.0), (1.0, 1.0)), ((-2.0, -2.0), (3.0, 3.0))  # bounds: the former cut polygons


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    rows = {bits: {"wrong": 0, "at_walls": 0, "largest": 0.0} for bits in ALLOWED}
    kinds: dict[str, int] = {}
    corners, num_infinite, count, number = [], 0, 0, 1_000_000 * seed
    while count < (2 if smoke else MAPS):
        number += 1
        # A minimal run compiles one shape.
        given = random_map(number, num_corners=16 if smoke else None)
        if given is None or sum(map(len, given.rings)) < _FEWEST_CORNERS:
            continue
        if (case := _Case.of_map(given, number)) is None:
            continue
        count += 1
        kinds[given.kind] = kinds.get(given.kind, 0) + 1
        corners.append(sum(map(len, given.rings)))
        num_infinite += int(np.isinf(case.truth).sum())
        for bits, row in rows.items():
            with jax.enable_x64(bits == 64):
                case.compare(bits, row)
    return {
        "maps": count,
        "points": POINTS,
        "kinds": kinds,
        "corners": [min(corners), max(corners)],
        "infinite": num_infinite,
        "rows": [{"bits": bits, "allowed": ALLOWED[bits], **row} for bits, row in rows.items()],
    }


class _Case:
    """A map with bounds, a goal and points, and the exact distances of the points."""

    def __init__(self, given: RandomMap, workspace: Workspace, goal: np.ndarray, x: np.ndarray) -> None:
        self.polygons, self.goal, self.x = given.polygons, goal, x
        self.bounds = np.stack([workspace.bounds.lo, workspace.bounds.hi])
        self.truth = VisibilityGraph(workspace, goal)(x)
        self.to_wall = shapely.distance(workspace.walls, shapely.points(x))

    @classmethod
    def of_map(cls, given: RandomMap, seed: int) -> "_Case | None":
        """Return None if the goal, in 32 bits, is not free."""
        rng = np.random.default_rng(seed)
        workspace = Workspace(_TIGHT if rng.random() < 0.7 else _WIDE, given.rings)
        goal = _in_32_bits(workspace.sample_free(1, seed=seed))
        if not workspace.is_free_to_tolerance(goal)[0]:
            return None
        x = _in_32_bits(rng.uniform(workspace.bounds.lo, workspace.bounds.hi, (POINTS, 2)))
        vertices = np.concatenate(given.rings)
        at_corners = vertices[rng.integers(len(vertices), size=_AT_CORNERS)]
        places = np.asarray(shapely.points(at_corners))
        polygons = np.array([shapely.Polygon(ring) for ring in given.rings])
        touches = (shapely.distance(places[:, None], polygons[None]) < BESIDE_WALLS[32]).sum(axis=1) > 1
        x[: (~touches).sum()] = at_corners[~touches]
        return cls(given, workspace, goal[0], x)

    def compare(self, bits: int, row: dict[str, Any]) -> None:
        """Add errors in one precision to a row."""
        dtype = np.dtype(f"float{bits}")
        polygons, goal, x, bounds = (each.astype(dtype) for each in (self.polygons, self.goal, self.x, self.bounds))
        found = np.asarray(polygon_distance(polygons, goal, bounds=bounds)(x), float)
        is_infinite = np.isinf(found), np.isinf(self.truth)
        with np.errstate(invalid="ignore"):
            error = np.where(is_infinite[0] & is_infinite[1], 0, np.abs(found - self.truth))
        at_wall = (is_infinite[0] != is_infinite[1]) & (self.to_wall < BESIDE_WALLS[bits])
        row["at_walls"] += int(at_wall.sum())
        row["wrong"] += int((~(error <= ALLOWED[bits]) & ~at_wall).sum())
        row["largest"] = max(row["largest"], float(error[np.isfinite(error)].max(initial=0)))


def _in_32_bits(x: np.ndarray) -> np.ndarray:
    return x.astype(np.float32).astype(float)
