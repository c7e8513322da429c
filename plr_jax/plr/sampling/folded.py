"""What construction is shown of a distance function, and of weights, whose points are folded."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from plr_jax._types import DistanceFn, Distances, Points
from plr_jax.plr.folding import Folding
from plr_jax.plr.sampling.cell_fit import WeightFn, call_oracle, call_weights


@dataclass(frozen=True, eq=False)
class FoldedFn:
    """A distance function of folded points: the distance of a point that folds there."""

    distance_fn: DistanceFn
    folding: Folding

    def __call__(self, z: Points) -> Distances:
        """Distances at folded points."""
        return call_oracle(self.distance_fn, self.folding.unfolded(z))


@dataclass(frozen=True, eq=False)
class FoldedWeights:
    """Weights of errors at folded points: the largest of all points of the domain that fold there, 0 without any.

    Where the caller has no ``weight_fn``, every point of the domain has weight 1.
    """

    weight_fn: WeightFn | None
    folding: Folding

    def __call__(self, z: Points) -> Float[np.ndarray, "n"]:
        """Weights at folded points."""
        largest = np.zeros(len(z))
        for x, inside in self.folding.images(z):
            weight = 1.0 if self.weight_fn is None else call_weights(self.weight_fn, x[inside])
            largest[inside] = np.maximum(largest[inside], weight)
            if self.weight_fn is None and largest.all():
                break
        return largest
