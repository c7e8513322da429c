"""Rivals that interpolate nodes: regular grids read by several libraries, a travel-time field, and triangles."""

from collections.abc import Callable
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator, RegularGridInterpolator
from scipy.ndimage import distance_transform_edt

from experiments.benchmarks._rivals import Rival, compiled
from plr_jax import Box, Workspace
from plr_jax._types import DistanceFn

_BYTES_A_FLOAT = 4
_BYTES_A_VERTEX = 12
_CHUNK = 10_000
_CANDIDATES = 20_000  # SciPy takes a second to find the triangles of 10^5 points
_GROWTH = 3  # vertices are added in rounds of a third


class Grid(NamedTuple):
    """Values at the nodes of a regular grid, and the bytes that these take."""

    axes: tuple[Float[np.ndarray, "rows"], Float[np.ndarray, "columns"]]
    values: Float[np.ndarray, "rows columns"]
    num_bytes: int

    @property
    def spacing(self) -> Float[np.ndarray, "2"]:
        """Distance of neighbors along each axis."""
        return np.array([axis[1] - axis[0] for axis in self.axes])


def filled_grid(workspace: Workspace, exact: DistanceFn, num_bytes: int) -> Grid:
    """Float32 nodes that fill so many bytes; those in obstacles take the value of the nearest free node."""
    axes = _axes(workspace.bounds, num_bytes // _BYTES_A_FLOAT)
    return _filled(axes, _on_nodes(exact, axes))


def sixteen_bit_grid(workspace: Workspace, exact: DistanceFn, num_bytes: int) -> Grid:
    """The same with 16-bit integers between the smallest and the largest value, so with twice as many nodes."""
    axes, values, _ = filled_grid(workspace, exact, 2 * num_bytes)
    lo, step = values.min(), np.ptp(values) / (2**16 - 1)
    return Grid(axes, (lo + step * np.round((values - lo) / step)).astype(np.float32), 2 * values.size)


def travel_time_grid(workspace: Workspace, goal: Float[np.ndarray, "2"], num_bytes: int) -> Grid:
    """The field of scikit-fmm on float32 nodes; those in obstacles are NaN, as the fast marching leaves them.

    A front cannot start at a point between nodes: it starts at a circle, large enough to hold one.
    """
    import skfmm

    axes = _axes(workspace.bounds, num_bytes // _BYTES_A_FLOAT)
    spacing = [float(axis[1] - axis[0]) for axis in axes]
    radius = float(np.linalg.norm(spacing))
    blocked = ~_on_nodes(workspace.is_free, axes).astype(bool)
    from_circle = _on_nodes(lambda x: np.linalg.norm(x - goal, axis=1), axes) - radius
    field = skfmm.distance(np.ma.MaskedArray(from_circle, blocked), dx=spacing)  # type: ignore[reportArgumentType]  # a list too
    values = np.ma.filled(field, np.nan).astype(np.float32) + np.float32(radius)
    return Grid(axes, values, values.nbytes)


def scipy_grid(grid: Grid) -> Rival:
    """SciPy's linear interpolation of a grid; what rounding moves out of the grid is answered too."""
    extrapolate: Any = None
    interpolator = RegularGridInterpolator(grid.axes, grid.values, bounds_error=False, fill_value=extrapolate)
    return Rival(grid.num_bytes, interpolator)


def map_coordinates(grid: Grid) -> Rival:
    """``jax.scipy.ndimage.map_coordinates`` of first order; the nodes are a constant of the compiled code."""
    values = jnp.asarray(grid.values)
    lo = np.array([axis[0] for axis in grid.axes], np.float32)
    scale = (1 / grid.spacing).astype(np.float32)

    def function(x: Float[Array, "*batch 2"]) -> Float[Array, "*batch"]:
        nodes = [(x[..., axis] - lo[axis]) * scale[axis] for axis in range(2)]
        return jax.scipy.ndimage.map_coordinates(values, nodes, order=1, mode="nearest")

    return Rival(grid.num_bytes, jax.jit(function), True, function)


def interpax_grid(grid: Grid, method: str) -> Rival:
    """Interpax's interpolation of a grid, in chunks of points, with which it is faster than all at once."""
    import interpax

    rows, columns = (jnp.asarray(axis, jnp.float32) for axis in grid.axes)
    values = jnp.asarray(grid.values)

    def function(x: Float[Array, "*batch 2"]) -> Float[Array, "*batch"]:
        return interpax.interp2d(x[..., 0], x[..., 1], rows, columns, values, method=method, extrap=True)

    return Rival(grid.num_bytes, compiled(function, _CHUNK), True, function, _CHUNK)


def triangles(
    workspace: Workspace, num_bytes: int, x: Float[np.ndarray, "n 2"], distance: Float[np.ndarray, "n"]
) -> Rival:
    """SciPy's linear interpolation over Delaunay triangles, whose vertices are chosen among samples.

    A vertex takes 12 bytes, its coordinates and value as float32; the triangles follow from the vertices. The corners
    of the workspace are vertices, with the value of the nearest sample, so that every point is in a triangle. As with
    a PLR, further ones go where the error is: in rounds, to the worst sample of each of the worst triangles.
    """
    x, distance = x[:_CANDIDATES], distance[:_CANDIDATES]
    (x0, y0), (x1, y1) = workspace.bounds.lo, workspace.bounds.hi
    corners = np.array([(x0, y0), (x0, y1), (x1, y0), (x1, y1)])
    at_corners = NearestNDInterpolator(x, distance)(corners)
    most = num_bytes // _BYTES_A_VERTEX
    begun = max(1, most // 10)
    vertices, values = np.r_[corners, x[:begun]], np.r_[at_corners, distance[:begun]]
    while True:
        interpolator = LinearNDInterpolator(vertices, values)
        room = min(most - len(vertices), len(vertices) // _GROWTH)
        if room <= 0:
            return Rival(_BYTES_A_VERTEX * len(vertices), interpolator)
        worst = _worst_in_triangles(interpolator, x, distance)[:room]
        vertices, values = np.r_[vertices, x[worst]], np.r_[values, distance[worst]]


def _worst_in_triangles(
    interpolator: LinearNDInterpolator, x: Float[np.ndarray, "n 2"], distance: Float[np.ndarray, "n"]
) -> Int[np.ndarray, "triangles"]:
    """The sample of the largest error in each triangle, the worst first."""
    order = np.argsort(-np.abs(interpolator(x) - distance))
    _, first = np.unique(interpolator.tri.find_simplex(x)[order], return_index=True)
    return order[np.sort(first)]


def _axes(bounds: Box, num_nodes: int) -> tuple[Float[np.ndarray, "rows"], Float[np.ndarray, "columns"]]:
    """Nodes spread in proportion to the sides of the map."""
    width, height = bounds.width
    rows = int(np.sqrt(num_nodes * width / height))
    return (
        np.linspace(bounds.lo[0], bounds.hi[0], rows),
        np.linspace(bounds.lo[1], bounds.hi[1], num_nodes // rows),
    )


def _on_nodes(
    function: Callable[[Any], Any], axes: tuple[np.ndarray, np.ndarray]
) -> Float[np.ndarray, "rows columns"]:
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    return np.asarray(function(nodes.reshape(-1, 2)), np.float64).reshape(nodes.shape[:2])


def _filled(axes: tuple[np.ndarray, np.ndarray], values: Float[np.ndarray, "rows columns"]) -> Grid:
    grid = Grid(axes, values, _BYTES_A_FLOAT * values.size)
    _, nearest = cast(tuple, distance_transform_edt(~np.isfinite(values), grid.spacing, return_indices=True))
    return grid._replace(values=values[tuple(nearest)].astype(np.float32))
