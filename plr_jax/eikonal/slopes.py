"""How steep a lower bound of the cost-to-go may be: convex sets of gradients, one a control point.

Along a motion ``dq``, the cost-to-go falls by no more than the motion costs. So of a lower bound with gradient ``g``,
``-g`` has to be in the set whose support function is the cost: for a length, a ball; for length and weighted turn, a
product of balls; where something pulls, a ball moved along a segment. Gradients are in coordinates in which a step
of length 1 within any block of axes costs 1.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

Vectors = Float[np.ndarray, "dim controls"]
_TINY = float(np.finfo(float).tiny)


@dataclass(frozen=True, eq=False)
class SlopeSets:
    """The sets.

    Attributes:
        blocks: Axes whose gradients are bounded together.
        radius: Of the balls, at each control point.
        pulls: Ends of the segment at each control point; None for none. There is one block then.
    """

    blocks: Sequence[Sequence[int]]
    radius: Float[np.ndarray, "controls"]
    pulls: Float[np.ndarray, "2 dim controls"] | None = None

    def project(self, g: Vectors, radius: Float[np.ndarray, "controls"]) -> Vectors:
        """The nearest vectors in the sets, their balls of another radius."""
        offset = self._nearest_offset(g)
        g, nearest = g - offset, np.empty_like(g)
        for block in self.blocks:
            axes = list(block)
            length = np.sqrt(np.sum(g[axes] ** 2, axis=0))
            nearest[axes] = g[axes] * (radius / np.maximum(length, radius))
        return nearest + offset

    def _nearest_offset(self, g: Vectors) -> Vectors | float:
        """The nearest points of the segments, of what gradients are the negative of."""
        if self.pulls is None:
            return 0.0
        first, along = -self.pulls[0], self.pulls[0] - self.pulls[1]
        t = np.sum((g - first) * along, axis=0) / np.maximum(np.sum(along**2, axis=0), _TINY)
        return first + np.clip(t, 0.0, 1.0) * along

    def lengths(self, g: Vectors) -> Float[np.ndarray, "controls"]:
        """The radii of the balls that would just hold vectors."""
        g = g - self._nearest_offset(g)
        return np.sqrt(np.max([np.sum(g[list(block)] ** 2, axis=0) for block in self.blocks], axis=0))

    def factors(self, g: Vectors) -> Float[np.ndarray, "controls"]:
        """By what vectors have to be divided, at the most, to be in the sets; below 1 within."""
        length = self.lengths(g)
        if self.pulls is None:
            return length / self.radius
        inner = self.radius - np.linalg.norm(self._nearest_offset(np.zeros_like(g)), axis=0)  # of a ball about 0
        return 1 + (length - self.radius) / np.maximum(inner, _TINY)

    def costs(self, flow: Vectors) -> Float[np.ndarray, "controls"]:
        """What it costs to move along a flow toward the goal, which is against its vectors."""
        norm = np.sum([np.sqrt(np.sum(flow[list(block)] ** 2, axis=0)) for block in self.blocks], axis=0)
        if self.pulls is None:
            return self.radius * norm
        return self.radius * norm + np.max(-np.sum(self.pulls * flow, axis=1), axis=0)
