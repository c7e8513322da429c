"""Volumes made from a seed: arrays that say which voxels are free."""

import numpy as np
from jaxtyping import Bool, Int

Volume = Bool[np.ndarray, "nx ny nz"]


def rooms(rng: np.random.Generator, shape: tuple[int, int, int], size: int, doors: float) -> Volume:
    """Rooms of a size, with walls one voxel thick between them, and doors in a share of these."""
    free = np.ones(shape, bool)
    number = np.array(shape) // size
    for axis in range(3):
        np.moveaxis(free, axis, 0)[size::size] = False
    for axis in range(3):
        for room in np.ndindex(*number):
            if room[axis] + 1 < number[axis] and rng.random() < doors:
                width = rng.integers(3, size // 2, 3)
                begin = np.array(room) * size + rng.integers(1, size - width)
                begin[axis], width[axis] = (room[axis] + 1) * size, 1
                free[_part(begin, width)] = True
    return free


def boxes(rng: np.random.Generator, shape: tuple[int, int, int], num: int, least: int, most: int) -> Volume:
    """Boxes of random sizes at random places."""
    free = np.ones(shape, bool)
    for _ in range(num):
        width = rng.integers(least, most, 3)
        free[_part(rng.integers(0, np.array(shape) - width), width)] = False
    return free


def spiral(size: int, pitch: int) -> Volume:
    """A ramp around a column, three voxels thick, in a round shaft."""
    x, y, z = (each + 0.5 - size / 2 for each in np.ogrid[:size, :size, :size])
    from_axis, height = np.hypot(x, y), z - pitch * np.arctan2(y, x) / (2 * np.pi)
    return (from_axis > size / 10) & (from_axis < size / 2) & (height % pitch > 3)


def first_free(free: Volume) -> Int[np.ndarray, "3"]:
    """The free voxel that is nearest to the lower corner."""
    voxels = np.argwhere(free)
    return voxels[voxels.sum(axis=1).argmin()]


def _part(begin: Int[np.ndarray, "3"], width: Int[np.ndarray, "3"]) -> tuple[slice, ...]:
    return tuple(slice(first, first + num) for first, num in zip(begin.tolist(), width.tolist(), strict=True))
