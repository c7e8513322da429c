"""What the tests of cars share: poses at random, motions along arcs, and lengths of another library."""

import numpy as np
import pytest

RADIUS = 1.7
GOAL = np.array([0.3, -0.8, 2.2])
LATTICE = np.stack(np.meshgrid(*[np.linspace(-4, 4, 9)] * 2, np.pi / 4 * np.arange(-3, 5)), axis=-1).reshape(-1, 3)
"""Poses at which many words begin, end or are equally long."""


def random_poses(n, extent=8.0, seed=0):
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(-extent, extent, (n, 2)), rng.uniform(-np.pi, np.pi, n)])


def driven(pose, segments, radius):
    """Where a car ends that drives segments of a letter and a signed length, each in closed form."""
    x, y, heading = pose
    for letter, length in segments:
        if letter == "S":
            x, y = x + length * np.cos(heading), y + length * np.sin(heading)
            continue
        side = {"L": radius, "R": -radius}[letter]
        center = x - side * np.sin(heading), y + side * np.cos(heading)
        heading += length / side
        x, y = center[0] + side * np.sin(heading), center[1] - side * np.cos(heading)
    return np.array([x, y, heading])


def pose_error(a, b):
    """Largest difference of coordinates, of headings modulo whole turns."""
    difference = np.asarray(a) - b
    difference[..., 2] = np.angle(np.exp(1j * difference[..., 2]))
    return np.abs(difference).max()


def in_frame_of(goal, relative):
    """Poses given relative to a goal."""
    turn = np.exp(1j * goal[2]) * (relative[:, 0] + 1j * relative[:, 1])
    return np.column_stack([goal[0] + turn.real, goal[1] + turn.imag, goal[2] + relative[:, 2]])


def ompl_distances(name, radius, starts, goal):
    """Lengths from starts to a goal in a state space of OMPL."""
    space = getattr(pytest.importorskip("ompl.base"), name)(radius)
    first, last = space.allocState(), space.allocState()

    def assign(state, pose):
        state.setX(pose[0])
        state.setY(pose[1])
        state.setYaw(pose[2])

    assign(last, goal)
    lengths = []
    for start in starts:
        assign(first, start)
        lengths.append(space.distance(first, last))
    return np.array(lengths)
