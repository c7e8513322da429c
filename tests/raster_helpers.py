"""The cost of a path over a raster, integrated exactly."""

from itertools import pairwise, product

import numpy as np
from scipy import ndimage


def cost_along(path, costs, side=(1, 1), heights=None, slope_cost=None, parts=(1, 1), scale=None):
    """Integrate costs, constant in each cell, along a polyline; the cheaper cell counts along a border of two.

    Heights are bilinear at vertices and where the polyline crosses a row or a column of centers of the cells' parts.
    Between these places, heights are linear. ``scale`` is the length along each row of parts of a unit of the raster.
    """
    total, rows_and_columns = 0.0, parts[::-1]
    for begin, end in pairwise(path / side):
        change = end - begin
        borders, lines = (
            np.concatenate(
                [
                    ((np.arange(999) + h) / n - b) / c
                    for n, b, c in zip(rows_and_columns, begin, change, strict=True)
                    if c
                ]
            )
            for h in (0, 0.5)
        )
        cuts, lines = (np.unique(np.clip(np.append(each, (0, 1)).round(12), 0, 1)) for each in (borders, lines))
        cuts = np.union1d(cuts, lines)
        middles = begin + (cuts[:-1, None] + cuts[1:, None]) / 2 * change
        x, y = (middles[:, None] + list(product((-1e-9, 1e-9), repeat=2))).transpose(2, 0, 1)
        padded = np.pad(costs, 1, constant_values=np.inf)
        rates = padded[
            tuple(np.clip(np.floor(at).astype(int) + 1, 0, n + 1) for at, n in zip((y, x), costs.shape, strict=True))
        ]
        row = np.floor(y * parts[0]).astype(int)
        ratio = 1 if scale is None else scale[np.clip(row, 0, len(scale) - 1)]
        rates = (rates * np.hypot(change[0] * side[0] * ratio, change[1] * side[1])).min(axis=1)
        if heights is not None:
            at = (begin + lines[:, None] * change)[:, ::-1].T - 0.5
            height = np.interp(cuts, lines, ndimage.map_coordinates(heights, at, order=1, mode="nearest"))
            rates *= slope_cost(np.diff(height) / (np.diff(cuts) * np.linalg.norm(change * side)))
        total += np.diff(cuts) @ rates
    return total
