"""A building of two floors with stairs, a lift, and a slide that leads one way."""

import numpy as np

from plr_jax import Building, Link, Workspace

GOAL = 0, (10.0, 1.0)


def two_floors(ground=(0.0, 0.0), upper=(-5.0, 3.0)) -> Building:
    """The building with the lower left corners of its floors at the given points."""

    def place(floor, x, y):
        corner = (ground, upper)[floor]
        return floor, (corner[0] + x, corner[1] + y)

    def floor(index, wall):
        return Workspace(
            (place(index, 0, 0)[1], place(index, 20, 10)[1]), [[place(index, *point)[1] for point in wall]]
        )

    floors = [floor(0, [(8, 0), (8.2, 0), (8.2, 8), (8, 8)]), floor(1, [(12, 2), (12.2, 2), (12.2, 10), (12, 10)])]
    stairs, lift = Link(place(0, 2, 9), place(1, 2, 8), 9), Link(place(0, 18, 5), place(1, 18, 5), 15)
    slide = Link(place(1, 19, 9), place(0, 12, 5), 0.5, both_ways=False)
    return Building(floors, [stairs, lift, slide])


def samples(building: Building, num: int, seed: int = 0):
    """Free points of all floors: their floors ``(n,)`` and coordinates ``(n, 2)``."""
    floor = np.repeat(np.arange(len(building.floors)), num)
    return floor, np.concatenate([each.sample_free(num, seed=seed + k) for k, each in enumerate(building.floors)])
