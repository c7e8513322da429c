"""What of a workspace's obstacles meets bodies: in motion, and where they are known to some distance only."""

from typing import Any, TypeAlias

import numpy as np
import shapely
from jaxtyping import Bool, Float

from plr_jax.collision.walls import motion_test
from plr_jax.geometry.vectors import cross_product, distance_to_segment
from plr_jax.geometry.workspace import Workspace
from plr_jax.robots.robot import Robot

Links: TypeAlias = Float[np.ndarray, "n 2 2"]


def are_free_motions(
    workspace: Workspace, robot: Robot, q0: Float[np.ndarray, "n dof"], q1: Float[np.ndarray, "n dof"]
) -> Bool[np.ndarray, "n"]:
    """Whether a robot's straight motions are free; those whose ends are not finite are not."""
    finite = np.isfinite(q0 + q1).all(axis=1)
    free = np.zeros(len(q0), dtype=bool)
    free[finite] = motion_test(workspace, robot)(q0[finite], q1[finite])
    return free


def have_walls_within(
    workspace: Workspace, x: Float[np.ndarray, "n 2"], radius: Float[np.ndarray, "n"]
) -> Bool[np.ndarray, "n"]:
    """Whether the clearance of points is at most a radius, which may be negative."""
    # A point of free space whose radius is negative needs no distance, and most are.
    within = ~shapely.intersects_xy(workspace.free_space, *x.T) | (radius > 0)
    within[within] = workspace.clearance(x[within]) <= radius[within]
    return within


def crosses_walls(workspace: Workspace, links: Links, reaches: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, "n"]:
    """Whether segments certainly cross a wall, wherever within some reaches their ends are, the second the larger.

    The ends stay on the two sides of the wall's line, so the segment crosses it, and not beyond an end of the wall:
    it stays within the larger reach of where it is, and both ends of the wall are farther from there.
    """
    boundary = workspace.boundary
    link, edge = workspace.edge_tree.query(shapely.linestrings(links), predicate="intersects")
    of_link, reach = links[link], reaches[link]
    heights = (of_link * boundary.normal[edge, None]).sum(axis=2) - boundary.offset[edge, None]
    crosses = (heights[:, 0] * heights[:, 1] < 0) & (np.abs(heights) > reach).all(axis=1)
    change = of_link[:, 1] - of_link[:, 0]
    for end in boundary.segments[edge].transpose(1, 0, 2):
        crosses &= distance_to_segment(*(of_link[:, 0] - end).T, *change.T) > reach[:, 1]
    result = np.zeros(len(links), dtype=bool)
    result[link[crosses]] = True
    return result


def distances_of_segments(a: Links, b: Links) -> Float[np.ndarray, "n"]:
    """Distances of segments, zero where they cross."""
    of_a, of_b = a[:, 1] - a[:, 0], b[:, 1] - b[:, 0]
    pairs = [(a, of_a, b[:, 0]), (a, of_a, b[:, 1]), (b, of_b, a[:, 0]), (b, of_b, a[:, 1])]
    distances = [distance_to_segment(*(segment[:, 0] - end).T, *change.T) for segment, change, end in pairs]
    crosses = _are_on_two_sides(a, of_a, b) & _are_on_two_sides(b, of_b, a)
    return np.where(crosses, 0.0, np.min(distances, axis=0))


def _are_on_two_sides(segments: Links, change: Float[np.ndarray, "n 2"], others: Links) -> Bool[np.ndarray, "n"]:
    """Whether the ends of other segments are strictly on the two sides of segments' lines."""
    return cross_product(change[:, None], others - segments[:, :1]).prod(axis=1) < 0


def come_near(workspace: Workspace, shapes: Any, distance: float) -> Bool[np.ndarray, "n"]:
    """Whether Shapely shapes are within a distance of walls, or touch them if it is 0."""
    if distance > 0:
        return shapely.dwithin(workspace.walls, shapes, distance)
    near = np.zeros(len(shapes), dtype=bool)
    near[workspace.edge_tree.query(shapes, predicate="intersects")[0]] = True
    return near
