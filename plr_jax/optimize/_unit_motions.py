"""Directions of motions, spread evenly."""

import math

import numpy as np
from jaxtyping import Float
from scipy.special import ndtri
from scipy.stats import qmc

from plr_jax.spaces import MotionCost

_CIRCLE, _PER_AXIS = 64, 32  # directions in a plane, and an axis in more dimensions


def unit_motions(motion: MotionCost) -> Float[np.ndarray, "n dof"]:
    """Motions of cost 1 in many directions: those of all axes, and those of each block alone."""
    everything = tuple(range(motion.dof))
    parts = {everything, *(axes for axes, _ in motion.blocks)}
    scale = motion.scale
    changes = []
    for axes in sorted(parts):
        change = np.zeros((len(directions := _directions(len(axes))), motion.dof))
        change[:, axes] = directions / scale[list(axes)]
        changes.append(change / motion.norm(change)[:, None])
    return np.concatenate(changes)


def _directions(dim: int) -> Float[np.ndarray, "n dim"]:
    """Directions that are spread evenly, of each its opposite as well."""
    axes = np.eye(dim)
    if dim == 2:
        angle = 2 * np.pi * np.arange(_CIRCLE) / _CIRCLE
        return np.stack([np.cos(angle), np.sin(angle)], axis=1)
    if dim > 2:
        num = 2 ** math.ceil(math.log2(_PER_AXIS * dim / 2))
        share = qmc.Sobol(dim, scramble=False).random(2 * num)[num:]  # the first points include 0
        axes = np.concatenate([axes, ndtri(share)])
        axes = axes[np.linalg.norm(axes, axis=1) > 1e-9]
    directions = np.concatenate([axes, -axes])
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)
