"""Clearance of robots to walls and to one another along straight motions, differentiable, in JAX.

Every robot is a box rounded by a radius: a disc is a box of no size, a rectangle has no rounding. A distance of two
bodies that are apart is attained at a corner of one of them, so corners against shapes is all there is to compute:
at some times of a motion, and between them along the chord that each corner takes past the corners of the other.
For round robots, whose centers move along chords, that is exact wherever it is positive.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from plr_jax.geometry.vectors import left_normal
from plr_jax.geometry.workspace import Workspace
from plr_jax.robots.robot import DiscRobot, RectangleRobot, Robot

_TINY = 1e-12  # under square roots, so that they have a gradient at 0
_POINT = 1e-18  # squared length to which a segment is a point; the gradient divides by its square, in 32 bits
_FAR = 1e3  # where corners are that are near to nothing
_SIGNS = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)], dtype=np.float32)


class Corners(NamedTuple):
    """Corners of solid shapes.

    Args:
        place: Where they are.
        normals: Normals of the two sides that meet there, out of the shape.
        reach: Distance from each corner within which the shape is the wedge between the two sides.
    """

    place: Float[Array, "*batch corners 2"]
    normals: Float[Array, "*batch corners 2 2"]
    reach: Float[Array, "*batch corners"]


class Walls(NamedTuple):
    """The boundary of free space, both parts padded to powers of two by what changes nothing.

    Args:
        edges: First and last point of each edge.
        corners: Those that stand out into free space.
    """

    edges: Float[Array, "edges 2 2"]
    corners: Corners


class Bodies(NamedTuple):
    """The robots' shapes: half the sides of a box, and the radius by which it is rounded."""

    half: Float[Array, "robots 2"]
    radius: Float[Array, "robots"]


def bodies_of(robots: Sequence[Robot], scale: float) -> Bodies:
    """The shapes of robots, in units of ``scale``."""
    half = [(r.length / 2, r.width / 2) if isinstance(r, RectangleRobot) else (0.0, 0.0) for r in robots]
    radius = [r.radius if isinstance(r, DiscRobot) else 0.0 for r in robots]
    return Bodies(_single(np.array(half) / scale), _single(np.array(radius) / scale))


def walls_of(workspace: Workspace, origin: Float[np.ndarray, "2"], scale: float) -> Walls:
    """The walls of a workspace, seen from ``origin`` in units of ``scale``."""
    boundary = workspace.boundary
    edges = (boundary.segments - origin) / scale
    out = np.flatnonzero(boundary.is_reflex(workspace.tolerance))
    place = edges[out, 0]
    arriving = place - (boundary.vertices[boundary.sector_end[out]] - origin) / scale
    leaving = edges[out, 1] - place
    elsewhere = (boundary.edges[None] != boundary.edges[out, :1, None]).all(axis=2)
    away = [
        np.min(_distance_to_segments(x, edges[others]), initial=_FAR)
        for x, others in zip(place, elsewhere, strict=True)
    ]
    sides = [np.linalg.norm(side, axis=1) for side in (leaving, arriving)]
    corners = Corners(
        _single(_padded(place, np.full(2, _FAR))),
        _single(_padded(left_normal(np.stack([leaving, arriving], axis=1)), np.zeros((2, 2)))),
        _single(_padded(np.minimum(np.array(away), np.minimum(*sides)), np.zeros(()))),
    )
    return Walls(_single(_padded(edges, edges[0, :1].repeat(2, axis=0))), corners)


def point_clearance(walls: Walls, x: Float[Array, "*batch 2"]) -> Float[Array, "*batch"]:
    """Signed distance of points to the walls, negative where not free."""
    near, free = _nearest_edge(walls.edges, jax.lax.stop_gradient(x))
    offset = x - _nearest(x, walls.edges[near])
    return jnp.where(free, 1.0, -1.0) * _norm(offset)


def corner_clearance(
    corners: Corners, a: Float[Array, "*#batch 2"], b: Float[Array, "*#batch 2"]
) -> Float[Array, "*batch"]:
    """Smallest distance of segments to corners; minus that, where they cut one off, and inf deeper than its reach."""
    segments = jnp.stack([a, b], axis=-2)[..., None, :, :]
    still = jax.lax.stop_gradient(segments)
    near = _smallest(_squared(_nearest(corners.place, still) - corners.place))[..., None]
    place, normals, reach = (
        jnp.take_along_axis(part, near.reshape(near.shape + (1,) * rest), axis=-1 - rest)
        if part.ndim > rest + 1
        else part[near]
        for part, rest in zip(corners, (1, 2, 0), strict=True)
    )
    offset = (_nearest(place, segments) - place)[..., 0, :]
    distance = _norm(offset)
    behind = ((offset[..., None, :] * normals[..., 0, :, :]).sum(axis=-1) < 0).all(axis=-1)
    # Deeper than its reach, the corner says nothing: points along the motion do.
    return jnp.where(behind, jnp.where(distance < reach[..., 0], -distance, jnp.inf), distance)


def round_clearances(
    walls: Walls, bodies: Bodies, q0: Float[Array, "*batch robots 2"], q1: Float[Array, "*batch robots 2"]
) -> tuple[Float[Array, "*batch robots"], Float[Array, "*batch robots"], Float[Array, "*batch pairs"]]:
    """Clearance of round robots in motions: to the walls at first, to their corners, and to one another."""
    i, j = np.triu_indices(q0.shape[-2], 1)
    relative = jnp.stack([q0[..., i, :] - q0[..., j, :], q1[..., i, :] - q1[..., j, :]], axis=-2)
    return (
        point_clearance(walls, q0) - bodies.radius,
        corner_clearance(walls.corners, q0, q1) - bodies.radius,
        _norm(_nearest(jnp.zeros(2), relative)) - bodies.radius[i] - bodies.radius[j],
    )


def box_clearances(
    walls: Walls, bodies: Bodies, q0: Float[Array, "*batch robots 3"], q1: Float[Array, "*batch robots 3"]
) -> tuple[Float[Array, "..."], ...]:
    """Clearance of any robots in short motions: their corners to the walls, the walls' to them, both in passing."""
    corners0, corners1 = _corners(q0, bodies.half), _corners(q1, bodies.half)
    radius = bodies.radius[:, None]
    seen = _turned(walls.corners.place - q0[..., None, :2], -q0[..., 2, None])
    i, j = np.triu_indices(q0.shape[-2], 1)
    return (
        point_clearance(walls, corners0) - radius,
        corner_clearance(walls.corners, corners0, corners1) - radius,
        _box_distance(seen, bodies.half[:, None]) - radius,
        *(_passing(bodies, corners0, corners1, q0, q1, *pair) for pair in ((i, j), (j, i))),
    )


def _passing(
    bodies: Bodies,
    corners0: Float[Array, "*batch robots 4 2"],
    corners1: Float[Array, "*batch robots 4 2"],
    q0: Float[Array, "*batch robots 3"],
    q1: Float[Array, "*batch robots 3"],
    i: Int[np.ndarray, "pairs"],
    j: Int[np.ndarray, "pairs"],
) -> Float[Array, "*batch pairs 4"]:
    """Clearance of the corners of robots ``i`` to robots ``j``, at first and in passing theirs."""
    a, b = (_seen(corners[..., i, :, :], q[..., j, :]) for corners, q in ((corners0, q0), (corners1, q1)))
    half, rounding = bodies.half[j][:, None], (bodies.radius[i] + bodies.radius[j])[:, None]
    first = _box_distance(a, half)
    normals = jnp.asarray(_SIGNS[:, :, None] * np.eye(2, dtype=np.float32))
    corners = Corners(
        jnp.broadcast_to((_SIGNS * half)[:, None], (*a.shape[:-1], 4, 2)),
        jnp.broadcast_to(normals, (*a.shape[:-1], 4, 2, 2)),
        jnp.broadcast_to(half.min(axis=-1)[..., None], (*a.shape[:-1], 4)),
    )
    return jnp.minimum(first, corner_clearance(corners, a, b)) - rounding


def _seen(x: Float[Array, "*batch n 2"], q: Float[Array, "*batch 3"]) -> Float[Array, "*batch n 2"]:
    """Points in the frames of robots."""
    return _turned(x - q[..., None, :2], -q[..., 2, None])


def _corners(q: Float[Array, "*batch robots 3"], half: Float[Array, "robots 2"]) -> Float[Array, "*batch robots 4 2"]:
    """Corners of the robots' boxes."""
    return q[..., None, :2] + _turned(jnp.asarray(_SIGNS) * half[:, None], q[..., 2, None])


def _turned(x: Float[Array, "*#batch 2"], angle: Float[Array, "*#batch"]) -> Float[Array, "*batch 2"]:
    """Points turned about the origin."""
    c, s = jnp.cos(angle), jnp.sin(angle)
    return jnp.stack([c * x[..., 0] - s * x[..., 1], s * x[..., 0] + c * x[..., 1]], axis=-1)


def _box_distance(x: Float[Array, "*#batch 2"], half: Float[Array, "*#batch 2"]) -> Float[Array, "*batch"]:
    """Signed distance of points to boxes about the origin, negative inside."""
    gap = jnp.abs(x) - half
    return _norm(jnp.maximum(gap, 0.0)) + jnp.minimum(gap.max(axis=-1), 0.0)


def _nearest(x: Float[Array, "*#batch 2"], segments: Float[Array, "*#batch 2 2"]) -> Float[Array, "*batch 2"]:
    """The points of segments that are nearest to points."""
    a, along = segments[..., 0, :], segments[..., 1, :] - segments[..., 0, :]
    squared = _squared(along)
    t = ((x - a) * along).sum(axis=-1) / jnp.where(squared > _POINT, squared, 1.0)
    return a + jnp.clip(t, 0.0, 1.0)[..., None] * along


def _nearest_edge(
    edges: Float[Array, "edges 2 2"], x: Float[Array, "*batch 2"]
) -> tuple[Int[Array, "*batch"], Bool[Array, "*batch"]]:
    """Index of the edge nearest to each point, and whether the point is free: edges of odd number to its right."""
    (x0, x1), (y0, y1) = edges[..., 0].T, edges[..., 1].T
    dx, dy = x1 - x0, y1 - y0
    u, v = x[..., :1] - x0, x[..., 1:] - y0
    squared = dx * dx + dy * dy
    t = jnp.clip((u * dx + v * dy) / jnp.where(squared > 0, squared, 1.0), 0.0, 1.0)
    across = (y0 > x[..., 1:]) != (y1 > x[..., 1:])
    right = (u * dy < v * dx) == (dy > 0)
    free = (across & right).sum(axis=-1) % 2 == 1
    return _smallest((u - t * dx) ** 2 + (v - t * dy) ** 2), free


def _smallest(squared: Float[Array, "*batch n"]) -> Int[Array, "*batch"]:
    """Index of the smallest number along the last axis, a power of two long: ``argmin``, but for close ties.

    The index takes the place of the last bits of the numbers, none of them negative: an ``argmin`` is not vectorized.
    """
    size = squared.shape[-1]
    keys = jax.lax.bitcast_convert_type(squared, jnp.int32) & ~(size - 1) | jnp.arange(size, dtype=jnp.int32)
    return keys.min(axis=-1) & (size - 1)


def _squared(x: Float[Array, "*batch 2"]) -> Float[Array, "*batch"]:
    return (x * x).sum(axis=-1)


def _norm(x: Float[Array, "*batch 2"]) -> Float[Array, "*batch"]:
    return jnp.sqrt(_squared(x) + _TINY)


def _distance_to_segments(x: Float[np.ndarray, "2"], segments: Float[np.ndarray, "n 2 2"]) -> Float[np.ndarray, "n"]:
    along = segments[:, 1] - segments[:, 0]
    t = np.clip(((x - segments[:, 0]) * along).sum(axis=1) / (along * along).sum(axis=1), 0.0, 1.0)
    return np.linalg.norm(segments[:, 0] + t[:, None] * along - x, axis=1)


def _padded(rows: Float[np.ndarray, "n *rest"], row: Float[np.ndarray, "*rest"]) -> Float[np.ndarray, "padded *rest"]:
    """Rows, and copies of another up to a power of two."""
    size = 1 << max(0, len(rows) - 1).bit_length()
    return np.concatenate([rows, np.broadcast_to(row, (size - len(rows), *rows.shape[1:]))])


def _single(x: Float[np.ndarray, "*shape"]) -> Float[Array, "*shape"]:
    return jnp.asarray(x, jnp.float32)
