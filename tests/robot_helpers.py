"""What the tests of robots share: shapes drawn by Shapely, and motions sampled densely in time."""

import numpy as np
import shapely

from plr_jax.robots.disc import DiscRobot
from plr_jax.robots.point import PointRobot
from plr_jax.robots.rectangle import RectangleRobot

POINT, DISC, BAR = PointRobot(), DiscRobot(0.3), RectangleRobot(0.9, 0.3)
ROBOTS = [POINT, DISC, BAR]


def rounding(robot):
    return robot.radius if isinstance(robot, DiscRobot) else 0.0


def shapes(robot, q):
    """Shapely geometries at configurations (n, 3): centers for round robots."""
    if not isinstance(robot, RectangleRobot):
        return shapely.points(q[:, :2])
    angle = np.exp(1j * q[:, 2])[:, None]
    corners = (q[:, 0] + 1j * q[:, 1])[:, None] + angle * (
        np.array([1, -1, -1, 1]) * robot.length / 2 + 1j * np.array([1, 1, -1, -1]) * robot.width / 2
    )
    return shapely.polygons(np.stack([corners.real, corners.imag], axis=2))


def along(q0, q1, num_samples):
    """Configurations at equal times along motions, (n * num_samples, 3)."""
    turn = np.angle(np.exp(1j * (q1[:, 2] - q0[:, 2])))
    change = np.column_stack([q1[:, :2] - q0[:, :2], turn])
    t = np.linspace(0, 1, num_samples)[None, :, None]
    return (q0[:, None] + t * change[:, None]).reshape(-1, 3)


def sampled_distance(robot_a, a0, a1, robot_b, b0, b1, num_samples):
    """Smallest distance over samples of each motion; negative where discs overlap, 0 where others do."""
    a, b = shapes(robot_a, along(a0, a1, num_samples)), shapes(robot_b, along(b0, b1, num_samples))
    distance = shapely.distance(a, b) - rounding(robot_a) - rounding(robot_b)
    # Touching is no overlap: only interiors that meet are.
    for polygons, others in ((a, b), (b, a)):
        if shapely.get_type_id(polygons[0]) == shapely.GeometryType.POLYGON:
            deep = shapely.relate_pattern(polygons, others, "T********")
            distance[deep] = np.minimum(distance[deep], -1e-6)
    return distance.reshape(-1, num_samples).min(axis=1)


def random_motions(rng, n, extent, step, turn):
    q0 = np.column_stack([rng.uniform(0, extent, (n, 2)), rng.uniform(-7, 7, n)])
    return q0, q0 + np.column_stack([rng.normal(0, step, (n, 2)), rng.uniform(-turn, turn, n)])
