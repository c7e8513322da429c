"""Where NumPy's 64-bit points are placed before queries round them to 32 bits."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from plr_jax.geometry.box import Box


@dataclass(frozen=True, eq=False)
class Placement:
    """Placing points on the host: around periodic axes, and from a corner far from the origin.

    Attributes:
        domain: The domain, if it has a periodic axis; else None.
        corner: The corner from which the tables count coordinates; None for the origin.
    """

    domain: Box | None
    corner: Float[np.ndarray, "dim"] | None

    def __call__(self, x: Float[np.ndarray, "*batch dim"]) -> Float[np.ndarray, "*batch dim"]:
        """The points as the tables want them."""
        if self.domain is not None:
            x = self.domain.wrapped(x)
        return x if self.corner is None else x - self.corner
