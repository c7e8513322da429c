"""The outline of a workspace on the widest lattice that holds it."""

import numpy as np
from jaxtyping import Float, Int

from plr_jax.geometry.boundary import Boundary
from plr_jax.geometry.vectors import pseudo_angle
from plr_jax.plr.pairs.outline import Outline

_FINEST = 2.0**-24  # of the width: 32-bit floats tell no finer


def outline_of(
    boundary: Boundary, origin: Float[np.ndarray, "2"], width: float, tolerance: float, may_squeeze: bool
) -> tuple[Outline, Int[np.ndarray, "points"]]:
    """The outline of a boundary, and the boundary's vertex at each of its points."""
    edges, onward = boundary.edges, _onward(boundary, may_squeeze)
    vertex, first, is_done = [], [0], np.zeros(len(edges), bool)
    for start in range(len(edges)):
        edge = start
        while not is_done[edge]:
            is_done[edge] = True
            vertex.append(edges[edge, 0])
            edge = onward[edge]
        if len(vertex) > first[-1]:
            first.append(len(vertex))
    index = np.array(vertex)
    step = lattice_step(boundary.vertices - origin, width, tolerance)
    points = np.rint((boundary.vertices[index] - origin) / step).astype(np.int64)
    return Outline(origin, step, points, np.array(first), may_squeeze), index


def _onward(boundary: Boundary, may_squeeze: bool) -> Int[np.ndarray, "edges"]:
    """The edge with which each edge's ring goes on: that whose sector it closes.

    Where paths may squeeze between walls that touch, it is the next one around the same wall instead.
    """
    edges = boundary.edges
    leaving = {
        (int(at), int(end)): i for i, (at, end) in enumerate(zip(edges[:, 0], boundary.sector_end, strict=True))
    }
    onward = np.array([leaving[b, a] for a, b in edges.tolist()])
    if may_squeeze:
        direction = boundary.segments[:, 1] - boundary.segments[:, 0]
        angle = pseudo_angle(direction[:, 0], direction[:, 1])
        following = np.arange(len(edges))
        for vertex in boundary.contacts:
            around = np.flatnonzero(edges[:, 0] == vertex)
            around = around[np.argsort(angle[around])]
            following[around] = np.roll(around, -1)
        onward = following[onward]
    return onward


def lattice_step(points: Float[np.ndarray, "n 2"], width: float, tolerance: float) -> float:
    """The widest step of which all coordinates are multiples: a power of ten or two, or the finest there is."""
    exponents = np.arange(-60, 60)
    steps = np.concatenate([2.0**exponents, 10.0 ** exponents[40:80]])
    for step in np.sort(steps[(steps <= width) & (steps >= _FINEST * width)])[::-1]:
        if np.abs(points - step * np.rint(points / step)).max(initial=0.0) <= tolerance:
            return float(step)
    return float(2.0 ** np.floor(np.log2(_FINEST * width)))
