"""Cones through samples, by least squares, many at once.

The square of ``distance - offset = |x - source|``, which is

    |x|^2 - distance^2 = 2 source . x - 2 offset distance + (offset^2 - |source|^2),

is linear in the source, the offset and the rest. That gives a start; Gauss-Newton steps on the distance itself
follow. The square also admits ``distance = offset - |x - source|``: where the solution is that one, or its source is
too far, the slope of a plane gives a second start, a source far away against it.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

_STEPS = 6
_RIDGE = 1e-13
_RANK_TOLERANCE = 1e-12


@dataclass(frozen=True, eq=False)
class Samples:
    """Points, as many of each cell, their distances, and weights: 0 where a point does not count."""

    x: Float[np.ndarray, "cells k dim"]
    distance: Float[np.ndarray, "cells k"]
    weight: Float[np.ndarray, "cells k"]

    def __len__(self) -> int:
        return len(self.x)

    def __getitem__(self, index) -> "Samples":
        return Samples(self.x[index], self.distance[index], self.weight[index])

    def append(self, other: "Samples") -> "Samples":
        """Those of these cells, followed by those of others."""
        parts = (np.concatenate([getattr(self, name), getattr(other, name)]) for name in ("x", "distance", "weight"))
        return Samples(*parts)

    def as_one(self) -> "Samples":
        """Those of all cells that count, as of one."""
        counts = self.weight > 0
        return Samples(self.x[counts][None], self.distance[counts][None], self.weight[counts][None])

    def mean(self, value: Float[np.ndarray, "cells k *rest"]) -> Float[np.ndarray, "cells *rest"]:
        """Weighted mean of what each sample has, 0 in a cell without weight."""
        total = self.weight.sum(axis=1)
        return np.einsum("ck,ck...->c...", self.weight / np.where(total > 0, total, 1)[:, None], value)


@dataclass(frozen=True, eq=False)
class Cones:
    """Functions ``offset + |x - point|``."""

    point: Float[np.ndarray, "cones dim"]
    offset: Float[np.ndarray, "cones"]

    def __len__(self) -> int:
        return len(self.offset)

    def __getitem__(self, index) -> "Cones":
        return Cones(self.point[index], self.offset[index])

    def append(self, other: "Cones") -> "Cones":
        """These, followed by others."""
        return Cones(np.concatenate([self.point, other.point]), np.append(self.offset, other.offset))

    def __call__(self, x: Float[np.ndarray, "cones k dim"]) -> Float[np.ndarray, "cones k"]:
        """Values at points, as many for each cone."""
        return self.offset[:, None] + _length(x - self.point[:, None])

    def errors(self, samples: Samples) -> Float[np.ndarray, "cones k"]:
        """Value minus distance at the samples of a cell for each cone, 0 where they do not count."""
        return np.where(samples.weight > 0, self(samples.x) - samples.distance, 0.0)

    def mean_square(self, samples: Samples) -> Float[np.ndarray, "cones"]:
        """Weighted mean of the squared errors."""
        return samples.mean(np.square(self.errors(samples)))


def fit_cones(samples: Samples, farthest: float) -> Cones:
    """The cone for every cell that errs least, its source at most so far from the samples' center."""
    frame = _Frame.of(samples)
    local, farthest_here = frame.samples(samples), farthest / frame.scale
    starts = _of_squares(local), _of_planes(local, farthest_here)
    one, other = (_descended(local, start, farthest_here) for start in starts)
    is_one = one.mean_square(local) <= other.mean_square(local)
    best = Cones(np.where(is_one[:, None], one.point, other.point), np.where(is_one, one.offset, other.offset))
    return frame.to_world(best)


def refine_cones(samples: Samples, start: Cones, farthest: float) -> Cones:
    """The cone for every cell that errs least, near one to start from."""
    frame = _Frame.of(samples)
    return frame.to_world(_descended(frame.samples(samples), frame.cones(start), farthest / frame.scale))


def normal_equations(
    samples: Samples, cones: Cones
) -> tuple[Float[np.ndarray, "cells terms terms"], Float[np.ndarray, "cells terms"]]:
    """Matrix and right side of the equations of a Gauss-Newton step: of the source, and of the offset last."""
    slope = slopes(samples, cones)
    weighted = slope * samples.weight[..., None]
    normal = weighted.transpose(0, 2, 1) @ slope
    total, terms = samples.weight.sum(axis=1), normal.shape[1]
    normal[:, range(terms), range(terms)] += np.where(total > 0, _RIDGE * total, 1.0)[:, None]
    return normal, np.einsum("ckt,ck->ct", weighted, cones.errors(samples))


def slopes(samples: Samples, cones: Cones) -> Float[np.ndarray, "cells k terms"]:
    """By how much values at samples grow with coordinates of the source, and with the offset last."""
    away = cones.point[:, None] - samples.x
    length = _length(away)[..., None]
    return np.concatenate([away / np.where(length > 0, length, 1), np.ones_like(length)], axis=2)


@dataclass(frozen=True, eq=False)
class _Frame:
    """Coordinates in which the samples of a cell are about 0, and about 1 apart: nothing cancels there."""

    center: Float[np.ndarray, "cells dim"]
    distance: Float[np.ndarray, "cells"]
    scale: Float[np.ndarray, "cells"]

    @staticmethod
    def of(samples: Samples) -> "_Frame":
        center = samples.mean(samples.x)
        spread = np.where(samples.weight > 0, _length(samples.x - center[:, None]), 0.0).max(axis=1)
        return _Frame(center, samples.mean(samples.distance), np.where(spread > 0, spread, 1.0))

    def samples(self, samples: Samples) -> Samples:
        scale = self.scale[:, None]
        x = (samples.x - self.center[:, None]) / scale[:, None]
        return Samples(x, (samples.distance - self.distance[:, None]) / scale, samples.weight)

    def cones(self, cones: Cones) -> Cones:
        point = (cones.point - self.center) / self.scale[:, None]
        return Cones(point, (cones.offset - self.distance) / self.scale)

    def to_world(self, cones: Cones) -> Cones:
        point = self.center + cones.point * self.scale[:, None]
        return Cones(point, self.distance + cones.offset * self.scale)


def _of_squares(samples: Samples) -> Cones:
    """Solutions of the linear equations."""
    x, distance, root = samples.x, samples.distance, np.sqrt(samples.weight)
    design = np.concatenate([2 * x, -2 * distance[..., None], np.ones_like(distance)[..., None]], axis=2)
    square = np.square(x).sum(axis=2) - np.square(distance)
    solution = np.linalg.pinv(design * root[..., None], rcond=_RANK_TOLERANCE) @ (root * square)[..., None]
    return Cones(solution[:, :-2, 0], solution[:, -2, 0])


def _of_planes(samples: Samples, farthest: Float[np.ndarray, "cells"]) -> Cones:
    """Sources as far as may be, from which distances grow as those of the samples do."""
    x, root = samples.x, np.sqrt(samples.weight)[..., None]
    slope = np.linalg.pinv(x * root, rcond=_RANK_TOLERANCE) @ (root * samples.distance[..., None])
    slope = slope[..., 0]
    length = _length(slope)
    upward = np.where(length[:, None] > 0, slope / np.where(length > 0, length, 1)[:, None], np.eye(x.shape[2])[0])
    return _with_offsets(samples, -upward * farthest[:, None])


def _with_offsets(samples: Samples, point: Float[np.ndarray, "cells dim"]) -> Cones:
    """Cones of some sources, as high as errs least."""
    flat = Cones(point, np.zeros(len(point)))
    return Cones(point, -samples.mean(flat.errors(samples)))


def _descended(samples: Samples, start: Cones, farthest: Float[np.ndarray, "cells"]) -> Cones:
    """Gauss-Newton steps from a start, each kept where the error falls."""
    here = _within(samples, start, farthest)
    square = here.mean_square(samples)
    for _ in range(_STEPS):
        normal, moments = normal_equations(samples, here)
        step = np.linalg.solve(normal, moments[..., None])[..., 0]
        there = _within(samples, Cones(here.point - step[:, :-1], here.offset - step[:, -1]), farthest)
        square_there = there.mean_square(samples)
        falls = square_there < square
        here = Cones(np.where(falls[:, None], there.point, here.point), np.where(falls, there.offset, here.offset))
        square = np.where(falls, square_there, square)
    return here


def _within(samples: Samples, cones: Cones, farthest: Float[np.ndarray, "cells"]) -> Cones:
    """The cones, but sources farther than may be moved closer, with offsets that fit."""
    length = _length(cones.point)
    far = length > farthest
    nearer = _with_offsets(samples, cones.point * (farthest / np.where(far, length, 1))[:, None])
    return Cones(np.where(far[:, None], nearer.point, cones.point), np.where(far, nearer.offset, cones.offset))


def _length(vector: Float[np.ndarray, "*n dim"]) -> Float[np.ndarray, "*n"]:
    return np.sqrt(np.square(vector).sum(axis=-1))
