"""Helpers for tests of robots: shapes drawn by Shapely, and motions sampled densely in time."""

from dataclasses import dataclass

import numpy as np
import shapely

from plr_jax.robots import DiscRobot, PointRobot, PolygonRobot, RectangleRobot, Robot


@dataclass(frozen=True)
class AnyShape(Robot):
    """A robot of any core, rounding and ``dof``, also of shapes that the package does not have."""

    body: tuple
    rounding: float = 0.0
    dof: int = 3

    @property
    def core(self):
        return np.array(self.body, dtype=float)


def pebble(size=0.3):
    """Return a rounded triangle."""
    return AnyShape(((1.2 * size, 0.0), (-0.4 * size, 0.7 * size), (-0.4 * size, -0.7 * size)), rounding=0.12)


def sled(size=1.0):
    """Return a triangle that keeps its heading."""
    return AnyShape(((0.3 * size, 0.0), (-0.2 * size, 0.25 * size), (-0.2 * size, -0.25 * size)), dof=2)


POINT, DISC, BAR = PointRobot(), DiscRobot(0.3), RectangleRobot(0.9, 0.3)
WING, PEBBLE = PolygonRobot([(0.5, 0.0), (0.0, 0.4), (-0.3, 0.25), (0.0, -0.1)]), pebble()
ROBOTS = [POINT, DISC, BAR, WING, PEBBLE]


def shapes(robot, q):
    """Return cores at configurations ``(n, 3)`` as Shapely geometries."""
    angle = np.exp(1j * (q[:, 2] if robot.dof == 3 else np.zeros(len(q))))[:, None]
    corners = (q[:, 0] + 1j * q[:, 1])[:, None] + angle * (robot.core[:, 0] + 1j * robot.core[:, 1])
    corners = np.stack([corners.real, corners.imag], axis=2)
    kind = (shapely.points, shapely.linestrings, shapely.polygons)[min(len(robot.core), 3) - 1]
    return kind(corners[:, 0] if len(robot.core) == 1 else corners)


def along(q0, q1, num_samples):
    """Return configurations at equal times along motions, ``(n * num_samples, 3)``."""
    turn = np.angle(np.exp(1j * (q1[:, 2] - q0[:, 2])))
    change = np.column_stack([q1[:, :2] - q0[:, :2], turn])
    t = np.linspace(0, 1, num_samples)[None, :, None]
    return (q0[:, None] + t * change[:, None]).reshape(-1, 3)


def sampled_distance(robot_a, a0, a1, robot_b, b0, b1, num_samples):
    """Return the smallest sampled distance of each motion; negative if interiors of the shapes overlap."""
    a, b = shapes(robot_a, along(a0, a1, num_samples)), shapes(robot_b, along(b0, b1, num_samples))
    distance = shapely.distance(a, b) - robot_a.rounding - robot_b.rounding
    # Shapes overlap if their interiors meet; touching is no overlap.
    for polygons, others in ((a, b), (b, a)):
        if shapely.get_type_id(polygons[0]) == shapely.GeometryType.POLYGON:
            deep = shapely.relate_pattern(polygons, others, "T********")
            distance[deep] = np.minimum(distance[deep], -1e-6)
    return distance.reshape(-1, num_samples).min(axis=1)


def random_motions(rng, n, extent, step, turn):
    q0 = np.column_stack([rng.uniform(0, extent, (n, 2)), rng.uniform(-7, 7, n)])
    return q0, q0 + np.column_stack([rng.normal(0, step, (n, 2)), rng.uniform(-turn, turn, n)])
