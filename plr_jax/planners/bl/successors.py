"""Joint configurations and their children: products of the robots' primitives, scored and checked together."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, UInt8

from plr_jax.planners.lattice.joint import JointLattice, State


class Successors(NamedTuple):
    """The best children of some joint configurations, by score, best first.

    Args:
        score: Sums of the robots' terms; ``inf`` for children that collide.
        primitive: The primitive of each robot.
        num_scored: Joint children, whole and partial, that were scored to find them.
        num_valid: Of the whole ones, how many collide with nothing.
        whole: Whether no collision-free child is missing.
    """

    score: Float[np.ndarray, "n m"]
    primitive: UInt8[np.ndarray, "n m robots"]
    num_scored: int
    num_valid: int
    whole: Bool[np.ndarray, "n"]


def best_successors(
    joint: JointLattice, terms: tuple[Float[np.ndarray, "_ _"], ...], state: State, width: int
) -> Successors:
    """The best children of joint configurations, one robot added after the other.

    The product of the first robots' primitives is cut to the ``width`` best collision-free ones before the next
    robot joins. A product that fits is not cut, so that its children are complete. The ``terms`` are each robot's, of
    its configurations' primitives, ``inf`` where blocked.
    """
    score = np.zeros((len(state), 1), np.float32)
    primitive = np.zeros((len(state), 1, 0), np.uint8)
    num_scored, num_valid, whole = 0, len(state), np.ones(len(state), dtype=bool)
    rows = np.arange(len(state))[:, None]
    for i, term in enumerate(terms):
        extended = score[:, :, None] + term[state[:, i], None]
        for j in range(i):
            near, collide = joint.collisions(j, i, state)
            if collide.any():
                penalty = np.where(collide, np.float32(np.inf), np.float32(0.0))
                extended[near] += penalty[np.arange(len(near))[:, None], primitive[near, :, j]]
        num_scored += extended.size
        score = extended.reshape(len(state), -1)
        valid = np.count_nonzero(score < np.inf, axis=1)
        num_valid = int(valid.sum())
        kept = np.broadcast_to(np.arange(score.shape[1]), score.shape)
        if width < score.shape[1]:
            whole &= valid <= width
            kept = np.argpartition(score, width - 1, axis=1)[:, :width]
            score = np.take_along_axis(score, kept, axis=1)
        parent, own = np.divmod(kept, term.shape[1])
        primitive = np.concatenate([primitive[rows, parent], own[..., None].astype(np.uint8)], axis=2)
    order = np.argsort(score, axis=1, kind="stable")
    return Successors(np.take_along_axis(score, order, axis=1), primitive[rows, order], num_scored, num_valid, whole)
