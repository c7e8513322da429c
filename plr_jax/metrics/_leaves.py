"""What happens between the leaves of a partition: jumps at their faces, and walks down the gradient out of them."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float

from plr_jax._types import PiecewiseFunction
from plr_jax.geometry.workspace import Workspace

ValuesAndGradients = Callable[[Float[np.ndarray, "n 2"]], tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n 2"]]]

_POINTS_A_FACE = 8
_ASIDE = 2.0**-20  # of the domain: eight times what a query in 32-bit floats resolves
_STEPS_A_SIDE = 4
_SIDES_WALKED = 4


def face_jumps(
    partition: PiecewiseFunction, evaluate: ValuesAndGradients, workspace: Workspace, seed: int
) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n 2"]]:
    """Differences of value across the faces of leaves, and where.

    Args:
        partition: What has the leaves.
        evaluate: Its values and gradients.
        workspace: Faces in obstacles do not count: a point does if it is free and so is what lies next to it on both
            sides.
        seed: Seed of the points, which are uniform on the upper faces of each leaf.

    Returns:
        Absolute differences of the values carried on to the face by the gradients beside it, where both are finite;
        and the points.
    """
    lo, hi = (np.asarray(corner, np.float64) for corner in partition.leaf_boxes)
    rng, domain = np.random.default_rng(seed), partition.domain
    points, aside = [np.empty((0, 2))], [np.empty((0, 2))]
    for axis in range(2):
        inner = hi[:, axis] < domain.hi[axis]
        share = rng.random((_POINTS_A_FACE, inner.sum(), 2))
        share[..., axis] = 1.0
        on_face = (lo[inner] + share * (hi - lo)[inner]).reshape(-1, 2)
        points.append(on_face)
        aside.append(np.tile(np.eye(2)[axis] * _ASIDE * domain.width[axis], (len(on_face), 1)))
    face, step = np.concatenate(points), np.concatenate(aside)
    free = workspace.is_visible(face - step, face + step)
    face, step = face[free], step[free]
    (below, slope_below), (above, slope_above) = evaluate(face - step), evaluate(face + step)
    both = np.isfinite(below) & np.isfinite(above)
    rise = (step * (slope_below + slope_above)).sum(axis=1)
    return np.abs(above[both] - below[both] - rise[both]), face[both]


def walk_from_leaves(
    partition: PiecewiseFunction,
    evaluate: ValuesAndGradients,
    workspace: Workspace,
    goal: Float[np.ndarray, "2"],
    is_start: Callable[[Float[np.ndarray, "n 2"]], Bool[np.ndarray, "n"]],
) -> tuple[Bool[np.ndarray, "walks"], Bool[np.ndarray, "walks"]]:
    """Walk straight down the gradient from the centers of leaves.

    A walk takes steps of a quarter of its leaf's shorter side, against the gradient, 16 of them. It ends early at
    the goal, within a step of it, and where a step would leave free space.

    Args:
        partition: What has the leaves.
        evaluate: Its values and gradients.
        workspace: The free space.
        goal: The goal.
        is_start: Of which centers to walk.

    Returns:
        Whether each walk ran into a wall; and whether it ended less than one shorter side from where it began, its
        leaf's descent going in circles or nowhere.
    """
    lo, hi = (np.asarray(corner, np.float64) for corner in partition.leaf_boxes)
    center, side = (lo + hi) / 2, (hi - lo).min(axis=1)
    start = is_start(center)
    center, side = center[start], side[start]
    at, step = center.copy(), side[:, None] / _STEPS_A_SIDE
    walled, home = np.zeros((2, len(center)), bool)
    for _ in range(_STEPS_A_SIDE * _SIDES_WALKED):
        home |= np.linalg.norm(at - goal, axis=1) <= step[:, 0]
        onward = at + step * unit_vectors(-evaluate(at)[1])
        moves = ~home & ~walled & np.isfinite(onward).all(axis=1)
        walled[moves] = ~workspace.is_visible(at[moves], onward[moves])
        moves &= ~walled
        at[moves] = onward[moves]
    stalled = ~home & ~walled & (np.linalg.norm(at - center, axis=1) < side)
    return walled, stalled


def unit_vectors(v: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
    """Vectors of length one; NaN where there is no direction."""
    length = np.linalg.norm(v, axis=1, keepdims=True)
    usable = np.isfinite(length) & (length > 0)
    return np.divide(v, length, out=np.full_like(v, np.nan), where=usable)
