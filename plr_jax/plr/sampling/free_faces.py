"""Which faces of leaves are free: seen through the distance function, which alone knows of walls."""

import numpy as np
from jaxtyping import Bool, Float

from plr_jax._types import DistanceFn
from plr_jax.geometry.box import Box
from plr_jax.plr.partition.cells import Cells
from plr_jax.plr.partition.faces import SharedFaces, face_points
from plr_jax.plr.sampling.cell_fit import call_oracle, sample_pattern

_NUM_POINTS = 32
_FEW = 4  # points that most free faces need
_BESIDE = 1e-6  # how far from a face its two sides are, in fractions of the domain: well within the smallest cell
_INSET = 0.998  # keeps the points off the ends of a face, which belong to other faces too


class FaceTests:
    """Whether faces are free; each is tested once, however often it is asked about.

    A piece of a face is free if somewhere on it both sides can be reached.
    """

    def __init__(self, distance_fn: DistanceFn, domain: Box) -> None:
        self._distance_fn = distance_fn
        self._domain = domain
        self._known: dict[bytes, bool] = {}

    def are_free(self, cells: Cells, faces: SharedFaces) -> Bool[np.ndarray, "faces"]:
        """Whether each face is free."""
        geometry = np.concatenate(
            [part[side] for part in (cells.depth, cells.position) for side in (faces.lower, faces.upper)], axis=1
        )
        geometry = np.column_stack([geometry, faces.axis])  # a cell may share faces with itself along several axes
        keys = [row.tobytes() for row in geometry]
        new = np.array([index for index, key in enumerate(keys) if key not in self._known], np.int64)
        free = np.zeros(len(new), bool)
        # Fractions of a face; along its own axis, whichever that is, it has no width.
        points = (1 + _INSET * sample_pattern(self._domain.dim, _NUM_POINTS, 0.0, 0).u) / 2
        for some in (points[:_FEW], points[_FEW:]):
            unsure = np.flatnonzero(~free)
            if len(some) and len(unsure):
                free[unsure] = self._is_crossed(cells, faces[new[unsure]], some)
        self._known |= {keys[index]: bool(is_free) for index, is_free in zip(new, free, strict=True)}
        return np.array([self._known[key] for key in keys], bool)

    def _is_crossed(
        self, cells: Cells, faces: SharedFaces, w: Float[np.ndarray, "k dim"]
    ) -> Bool[np.ndarray, "faces"]:
        """Whether at one of the points or more both sides can be reached."""
        x = face_points(cells, faces, w)
        across = _BESIDE * np.eye(self._domain.dim)[faces.axis][:, None]
        sides = [self._domain.lo + self._domain.width * (x + sign * across) for sign in (-1, 1)]
        points = self._domain.wrapped(np.concatenate(sides)).reshape(-1, self._domain.dim)
        distance = call_oracle(self._distance_fn, points)
        below, above = np.isfinite(distance).reshape(2, *x.shape[:2])
        return np.any(below & above, axis=1)
