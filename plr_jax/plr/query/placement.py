"""Where NumPy's 64-bit points are placed before queries round them to 32 bits."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from plr_jax._types import ArrayLike
from plr_jax.geometry.box import Box
from plr_jax.plr.folding.folding import Folding
from plr_jax.plr.query.frame import Frame

_FAR = 4.0  # widths from the origin, beyond which 32-bit coordinates resolve a domain worse than its tables do


def corner_if_far(frame: ArrayLike) -> Float[np.ndarray, "dim"] | None:
    """The rounded lower corner of a domain, given by its frame, that is far from the origin; else None."""
    lo, hi = np.asarray(frame, np.float64)[[Frame.LO, Frame.HI]]
    return lo if (np.maximum(np.abs(lo), np.abs(hi)) > _FAR * (hi - lo)).any() else None


@dataclass(frozen=True, eq=False)
class Placement:
    """Placing points on the host: around periodic axes, and from a corner far from the origin, or folded.

    Attributes:
        domain: The domain, if it has a periodic axis; else None.
        corner: The corner from which the tables count coordinates; None for the origin.
        folding: How to fold them, if the tables are of folded points; else None.
    """

    domain: Box | None
    corner: Float[np.ndarray, "dim"] | None
    folding: Folding | None = None

    def __call__(self, x: Float[np.ndarray, "*batch dim"]) -> Float[np.ndarray, "*batch dim"]:
        """The points as the tables want them."""
        if self.domain is not None:
            x = self.domain.wrapped(x)
        if self.folding is not None:
            inside = self.folding.domain.contains(x.reshape(-1, x.shape[-1])).reshape(x.shape[:-1])
            return np.where(inside[..., None], self.folding(x), np.where(np.isnan(x), np.nan, np.inf))
        return x if self.corner is None else x - self.corner
