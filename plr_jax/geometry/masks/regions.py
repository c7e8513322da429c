"""The free pixels of a grid as polygons with holes, placed in the plane."""

import math
from typing import Any

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int
from shapely.geometry import MultiPolygon, Polygon

from plr_jax._arrays import as_finite, as_numbers, product_in_order, require_integer, shortened
from plr_jax._types import ArrayLike
from plr_jax.geometry.masks.simplification import simplified
from plr_jax.geometry.masks.tracing import PixelRings, pixel_rings
from plr_jax.geometry.polygons import LARGEST_COORDINATE, rounding_at

_ALL_AROUND = np.ones((3, 3), dtype=bool)
_LEAST_PIXEL = 8e3  # roundings of its side: the tolerance of a workspace is 1e3, a wall a quarter of a pixel at least


def placed_region(
    free: ArrayLike,
    resolution: float | int,
    origin: ArrayLike,
    *,
    row0: str,
    tolerance: float | int,
    drop_specks: int,
) -> Any:
    """The free pixels of a grid as a Shapely MultiPolygon; the arguments are those of ``Workspace.from_mask``.

    Raises:
        ValueError: If an argument is none of those described there, no pixel is free, or the outline has too many
            corners.
    """
    free = _as_mask(free)
    if row0 not in ("bottom", "top"):
        raise ValueError(f"row0 must be 'bottom' or 'top', got {shortened(row0)}.")
    require_integer("drop_specks", drop_specks, 0)
    tolerance, resolution = as_finite("tolerance", tolerance), as_finite("resolution", resolution, positive=True)
    pose = as_numbers("origin", origin, "(x, y) or (x, y, yaw)")
    if pose.shape not in ((2,), (3,)) or not np.isfinite(pose).all():
        raise ValueError(f"origin must be finite numbers (x, y) or (x, y, yaw), got {shortened(origin)}.")
    _require_resolved(free.shape, resolution, np.abs(pose[:2]).max())
    free = free if row0 == "bottom" else free[::-1]
    free = without_specks(free, drop_specks) if drop_specks else free
    if not free.any():
        raise ValueError(f"No pixel of {free.shape[0]} x {free.shape[1]} is free.")
    yaw = pose[2] if len(pose) == 3 else 0.0
    turn = np.array([[math.cos(yaw), math.sin(yaw)], [-math.sin(yaw), math.cos(yaw)]])
    # In one order, so that contacts, of which there are two, are placed alike.
    return shapely.transform(
        region_of_mask(free, tolerance), lambda points: pose[:2] + product_in_order(resolution * points, turn)
    )


def rounded_one_by_one(region: Any, grid: float) -> Any:
    """A placed region with each vertex rounded to a grid, as ``shapely.set_precision`` does in more time.

    That looks for edges that rounding lets meet. Here none do: two that do not share an end are a quarter of a pixel
    apart, the other ends of two that share one as far from either; and a vertex moves by less than a thousandth.
    """
    return shapely.transform(region, lambda points: np.floor(points / grid + 0.5) * grid)


def _require_resolved(shape: tuple[int, ...], resolution: float, origin: float) -> None:
    """Refuse pixels that coordinates of double precision cannot tell apart where the grid lies."""
    size = resolution * math.hypot(*shape)
    reach = float(origin) + size
    if not reach <= LARGEST_COORDINATE:
        raise ValueError(
            f"A workspace's coordinates go to {LARGEST_COORDINATE:g}, got pixels of side {resolution:g} as far out "
            f"as {reach:g}: choose a larger unit."
        )
    least = _LEAST_PIXEL * rounding_at(size, reach)
    if resolution < least:
        raise ValueError(
            f"resolution must be at least {least:.2g} at coordinates up to {reach:g}, which are no finer, got "
            f"{resolution:g}: choose an origin nearer to zero, or check the unit of both."
        )


def _as_mask(free: ArrayLike) -> Bool[np.ndarray, "rows columns"]:
    mask = np.asarray(free)
    if mask.dtype != bool or mask.ndim != 2 or np.ma.is_masked(free):
        masked = ", some masked" if np.ma.is_masked(free) else ""
        raise ValueError(
            f"free must be booleans of shape (rows, columns), such as picture > 127, got {mask.dtype} of shape "
            f"{mask.shape}{masked}."
        )
    return mask


def region_of_mask(free: Bool[np.ndarray, "rows columns"], tolerance: float | int) -> Any:
    """The free pixels as a valid Shapely MultiPolygon, in pixels, the first row lowest.

    Args:
        free: Which pixels are free.
        tolerance: How far, in pixels, its outline may be from theirs, and theirs from it.
    """
    outlines = pixel_rings(free)
    component = _components(free, outlines)
    rings = simplified(outlines, tolerance)
    loops, ring = _simple_loops(rings)
    component = component[ring]
    # Each component has one loop that runs counterclockwise, around it; the others are its holes.
    is_outer = shapely.is_ccw(loops)
    shells = loops[is_outer][np.argsort(component[is_outer])]
    holes, of = loops[~is_outer], component[~is_outer]
    order = np.argsort(of, kind="stable")
    holes = np.split(holes[order], np.searchsorted(of[order], np.arange(2, len(shells) + 1)))
    return MultiPolygon([Polygon(shell, rings) for shell, rings in zip(shells, holes, strict=True)])


def without_specks(free: Bool[np.ndarray, "rows columns"], num_pixels: int) -> Bool[np.ndarray, "rows columns"]:
    """The grid less components of at most so many pixels: blocked ones become free, and then free ones blocked."""
    free = free | _is_small(~free, num_pixels, _ALL_AROUND)
    return free & ~_is_small(free, num_pixels, None)


def _is_small(
    pixels: Bool[np.ndarray, "rows columns"], num_pixels: int, structure: Bool[np.ndarray, "3 3"] | None
) -> Bool[np.ndarray, "rows columns"]:
    label = _labels(pixels, structure)
    is_small = np.bincount(label.ravel()) <= num_pixels
    is_small[0] = False
    return is_small[label]


def _labels(
    pixels: Bool[np.ndarray, "rows columns"], structure: Bool[np.ndarray, "3 3"] | None = None
) -> Int[np.ndarray, "rows columns"]:
    """The number of each pixel's connected component, from 1, and 0 for the other pixels."""
    import scipy.ndimage  # which takes longer to import than most workspaces need

    found: Any = scipy.ndimage.label(pixels, structure)
    return found[0]


def _components(free: Bool[np.ndarray, "rows columns"], rings: PixelRings) -> Int[np.ndarray, "rings"]:
    """The number of the connected free pixels on the left of each ring."""
    begin = rings.points[rings.start[:-1]].astype(int)
    ahead = np.sign(rings.points[rings.start[:-1] + 1].astype(int) - begin)
    left = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)
    column, row = (begin + (ahead + left - 1) // 2).T
    return _labels(free)[row, column]


def _simple_loops(rings: PixelRings) -> tuple[Any, Int[np.ndarray, "loops"]]:
    """The rings as Shapely rings, cut where one meets itself; and which ring each is of."""
    order, ring = np.arange(len(rings.points)), np.repeat(np.arange(len(rings.start) - 1), np.diff(rings.start))
    loop = ring.copy()
    num_loops = len(rings.start) - 1
    for meets in np.unique(ring[rings.is_contact]).tolist():
        begin, end = rings.start[meets], rings.start[meets + 1]
        parts = _loops_of(rings.points[begin:end], rings.is_contact[begin:end])
        order[begin:end] = begin + np.concatenate(parts)
        loop[begin:end] = np.repeat([meets, *range(num_loops, num_loops + len(parts) - 1)], [len(p) for p in parts])
        num_loops += len(parts) - 1
    sorted_by_loop = np.argsort(loop, kind="stable")
    loops: Any = shapely.linearrings(rings.points[order][sorted_by_loop], indices=loop[sorted_by_loop])
    ring_of = np.empty(num_loops, dtype=int)
    ring_of[loop] = ring
    return loops, ring_of


def _loops_of(points: Float[np.ndarray, "n 2"], is_contact: Bool[np.ndarray, "n"]) -> list[list[int]]:
    """The loops that a ring consists of, as indices of its points: each begins where the ring comes back to."""
    loops, path, place = [], [], {}
    for i, (point, meets) in enumerate(zip(map(tuple, points.tolist()), is_contact.tolist(), strict=True)):
        if meets and point in place:
            loops.append(path[place[point] :])
            for j in loops[-1]:
                place.pop(tuple(points[j].tolist()), None)
            path = path[: -len(loops[-1])]
        if meets:
            place[point] = len(path)
        path.append(i)
    return [*loops, path]
