"""Clearance of robots to walls and to one another along straight motions, differentiable, in JAX.

Every robot is a convex core rounded by a radius. A distance of two bodies that are apart is attained at a corner of
one of them, so corners against shapes is all there is to compute: at some times of a motion, and between them along
the chord that each corner takes past the corners of the other. For round robots, whose centers move along chords,
that is exact wherever it is positive.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from plr_jax._arrays import padded, padded_size
from plr_jax.geometry.vectors import distance_to_segment, left_normal
from plr_jax.geometry.workspace import Workspace
from plr_jax.robots.robot import Robot

_TINY = 1e-12  # under square roots, so that they have a gradient at 0
_POINT = 1e-18  # squared length to which a segment is a point; the gradient divides by its square, in 32 bits
_FAR = 1e3  # where corners are that are near to nothing


class Wedges(NamedTuple):
    """Corners of solid shapes: their places, and the normals of the two sides that meet there, out of the shape.

    Within ``reach`` of a corner the shape is the wedge between the two sides.
    """

    place: Float[Array, "*batch corners 2"]
    normals: Float[Array, "*batch corners 2 2"]
    reach: Float[Array, "*batch corners"]


class PaddedBoundary(NamedTuple):
    """The boundary of free space: its edges, and the corners that stand out into free space.

    Both are padded to powers of two by what changes nothing.
    """

    edges: Float[Array, "edges 2 2"]
    corners: Wedges


class Outlines(NamedTuple):
    """The robots' shapes.

    Their cores' corners, counterclockwise, are padded by the last one; there is a single one if all are round.
    ``turns`` is 1 for robots whose heading means something, else 0. ``half`` are half the sides of each core if all
    are boxes or points, which takes less to compute with.
    """

    corners: Wedges
    radius: Float[Array, "robots"]
    turns: Float[Array, "robots"]
    half: Float[Array, "robots 2"] | None

    @property
    def all_round(self) -> bool:
        """Whether every robot is a disc or a point about its reference point."""
        return self.corners.place.shape[1] == 1


def outlines_of(robots: Sequence[Robot], scale: float) -> Outlines:
    """The shapes of robots, in units of ``scale``."""
    all_round = not any(robot.core.any() for robot in robots)
    size = 1 if all_round else max(3, *(len(robot.core) for robot in robots))
    parts = zip(*(_wedges(robot.core / scale, size) for robot in robots), strict=True)
    radius = np.array([robot.rounding for robot in robots]) / scale
    turns = np.array([float(robot.dof == 3) for robot in robots])
    corners = Wedges(*(_single(np.stack(part)) for part in parts))
    halves = [robot.half_sides for robot in robots if robot.half_sides is not None]
    half = _single(np.stack(halves) / scale) if len(halves) == len(robots) else None
    return Outlines(corners, _single(radius), _single(turns), half)


def _wedges(core: Float[np.ndarray, "k 2"], size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Corners of a convex polygon, the last one repeated; a point is within no wedge, but outside of some side."""
    if len(core) == 1:
        angle = 2 * np.pi * np.arange(size) / size
        out = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        return np.repeat(core, size, axis=0), np.stack([-out, out], axis=1), np.zeros(size)
    sides = np.stack([core, np.roll(core, -1, axis=0)], axis=1)
    out, length = -left_normal(sides[:, 1] - sides[:, 0]), np.linalg.norm(sides[:, 1] - sides[:, 0], axis=1)
    away = np.array(
        [_distance_to_segments(x, np.roll(sides, -i, axis=0)[1:-1]).min(initial=np.inf) for i, x in enumerate(core)]
    )
    reach = np.min([away, length, np.roll(length, 1)], axis=0) / 2
    rows = np.minimum(np.arange(size), len(core) - 1)
    return core[rows], np.stack([np.roll(out, 1, axis=0), out], axis=1)[rows], reach[rows]


def padded_boundary(workspace: Workspace, origin: Float[np.ndarray, "2"], scale: float) -> PaddedBoundary:
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
    normals, reach = left_normal(np.stack([leaving, arriving], axis=1)), np.min([away, *sides], axis=0)
    size = padded_size(len(place))
    corners = Wedges(*map(_single, (padded(place, size, _FAR), padded(normals, size), padded(reach, size))))
    return PaddedBoundary(_single(padded(edges, padded_size(len(edges)), edges[0, :1])), corners)


def point_clearance(walls: PaddedBoundary, x: Float[Array, "*batch 2"]) -> Float[Array, "*batch"]:
    """Signed distance of points to the walls, negative where not free."""
    near, free = _nearest_edge(walls.edges, jax.lax.stop_gradient(x))
    offset = x - _nearest(x, walls.edges[near])
    return jnp.where(free, 1.0, -1.0) * _norm(offset)


def corner_clearance(
    corners: Wedges, a: Float[Array, "*#batch 2"], b: Float[Array, "*#batch 2"]
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
    walls: PaddedBoundary,
    outlines: Outlines,
    q0: Float[Array, "*batch robots 2"],
    q1: Float[Array, "*batch robots 2"],
) -> tuple[Float[Array, "*batch robots"], Float[Array, "*batch robots"], Float[Array, "*batch pairs"]]:
    """Clearance of round robots in motions: to the walls at first, to their corners, and to one another."""
    i, j = np.triu_indices(q0.shape[-2], 1)
    relative = jnp.stack([q0[..., i, :] - q0[..., j, :], q1[..., i, :] - q1[..., j, :]], axis=-2)
    return (
        point_clearance(walls, q0) - outlines.radius,
        corner_clearance(walls.corners, q0, q1) - outlines.radius,
        _norm(_nearest(jnp.zeros(2), relative)) - outlines.radius[i] - outlines.radius[j],
    )


def convex_clearances(
    walls: PaddedBoundary,
    outlines: Outlines,
    q0: Float[Array, "*batch robots dof"],
    q1: Float[Array, "*batch robots dof"],
) -> tuple[Float[Array, "..."], ...]:
    """Clearance of any robots in short motions: their corners to the walls, the walls' to them, both in passing."""
    poses = [(q[..., :2], q[..., 2] * outlines.turns if q.shape[-1] > 2 else 0.0 * q[..., 0]) for q in (q0, q1)]
    corners = [_placed(outlines.corners.place, *pose) for pose in poses]
    radius = outlines.radius[:, None]
    i, j = np.triu_indices(q0.shape[-2], 1)
    return (
        point_clearance(walls, corners[0]) - radius,
        corner_clearance(walls.corners, *corners) - radius,
        _signed_distance(outlines, _seen(walls.corners.place, *poses[0])) - radius,
        *(_passing(outlines, corners, poses, *pair) for pair in ((i, j), (j, i))),
    )


def _passing(
    outlines: Outlines,
    corners: list[Float[Array, "*batch robots k 2"]],
    poses: list[tuple[Float[Array, "*batch robots 2"], Float[Array, "*batch robots"]]],
    i: Int[np.ndarray, "pairs"],
    j: Int[np.ndarray, "pairs"],
) -> Float[Array, "*batch pairs k"]:
    """Clearance of the corners of robots ``i`` to robots ``j``, at first and in passing theirs."""
    a, b = (
        _seen(x[..., i, :, :], at[..., j, :], theta[..., j]) for x, (at, theta) in zip(corners, poses, strict=True)
    )
    others = jax.tree.map(lambda part: part[j], outlines)
    every = Wedges(*(jnp.broadcast_to(part[:, None], (*a.shape[:-1], *part.shape[1:])) for part in others.corners))
    rounding = (outlines.radius[i] + outlines.radius[j])[:, None]
    return jnp.minimum(_signed_distance(others, a), corner_clearance(every, a, b)) - rounding


def _seen(
    x: Float[Array, "*#batch n 2"], at: Float[Array, "*batch 2"], theta: Float[Array, "*batch"]
) -> Float[Array, "*batch n 2"]:
    """Points in the frames of robots."""
    return _turned(x - at[..., None, :], -theta[..., None])


def _placed(
    x: Float[Array, "robots k 2"], at: Float[Array, "*batch robots 2"], theta: Float[Array, "*batch robots"]
) -> Float[Array, "*batch robots k 2"]:
    """Points of the robots' own frames where they are."""
    return at[..., None, :] + _turned(x, theta[..., None])


def _turned(x: Float[Array, "*#batch 2"], angle: Float[Array, "*#batch"]) -> Float[Array, "*batch 2"]:
    """Points turned about the origin."""
    c, s = jnp.cos(angle), jnp.sin(angle)
    return jnp.stack([c * x[..., 0] - s * x[..., 1], s * x[..., 0] + c * x[..., 1]], axis=-1)


def _signed_distance(outlines: Outlines, x: Float[Array, "*#batch robots n 2"]) -> Float[Array, "*batch robots n"]:
    """Signed distance of points to cores about the origin, negative inside."""
    if outlines.half is not None:
        gap = jnp.abs(x) - outlines.half[:, None]
        return _norm(jnp.maximum(gap, 0.0)) + jnp.minimum(gap.max(axis=-1), 0.0)
    corners = outlines.corners
    (x0, y0), (nx, ny) = (
        jnp.moveaxis(part, -1, 0)[..., None, :] for part in (corners.place, corners.normals[:, :, 1])
    )
    dx, dy = jnp.roll(x0, -1, axis=-1) - x0, jnp.roll(y0, -1, axis=-1) - y0
    squared = dx * dx + dy * dy
    u, v = x[..., :1] - x0, x[..., 1:] - y0
    depth = (nx * u + ny * v).max(axis=-1)
    t = jnp.clip((u * dx + v * dy) / jnp.where(squared > _POINT, squared, 1.0), 0.0, 1.0)
    away = ((u - t * dx) ** 2 + (v - t * dy) ** 2).min(axis=-1)
    return jnp.where(depth > 0, jnp.sqrt(away + _TINY), depth)


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
    return distance_to_segment(*(segments[:, 0] - x).T, *(segments[:, 1] - segments[:, 0]).T)


def _single(x: Float[np.ndarray, "*shape"]) -> Float[Array, "*shape"]:
    return jnp.asarray(x, jnp.float32)
