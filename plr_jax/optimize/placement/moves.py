"""Steps in free space: what is blocked by a wall turns aside, is shortened, or is not taken."""

import numpy as np
from jaxtyping import Float

from plr_jax.geometry.workspace import Workspace

_ANGLES = np.deg2rad([20, 40, 60, 80])
_SHORTER = (0.5, 0.25)


def _detours() -> Float[np.ndarray, "detours 2 2"]:
    """Linear maps of a step to those tried in its place: turned, as long as it is in that direction, or shortened."""
    turned = [
        np.cos(angle) * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        for angle in np.concatenate([_ANGLES, -_ANGLES])
    ]
    tried = [*turned, *(share * np.eye(2) for share in _SHORTER)]
    return np.array(sorted(tried, key=lambda each: -each[0, 0]))  # by how far they go where the step would


_DETOURS = _detours()


def moved(
    workspace: Workspace, x: Float[np.ndarray, "n 2"], step: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "n 2"]:
    """Free points after steps along free segments."""
    end = x + step
    blocked = np.flatnonzero(~workspace.is_visible(x, end))
    if not blocked.size:
        return end
    from_here = np.repeat(x[blocked, None], len(_DETOURS), axis=1)
    tried = from_here + np.einsum("dij,nj->ndi", _DETOURS, step[blocked])
    visible = np.reshape(workspace.is_visible(from_here.reshape(-1, 2), tried.reshape(-1, 2)), tried.shape[:2])
    first = tried[np.arange(len(blocked)), visible.argmax(axis=1)]
    end[blocked] = np.where(visible.any(axis=1, keepdims=True), first, x[blocked])
    return end
