"""Calling the caller's functions of points: what they answer is checked here, once."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from plr_jax._arrays import as_distances, as_values
from plr_jax._types import DistanceFn, Distances, Points

WeightFn = Callable[[Points], Float[np.ndarray, "n"]]


def call_oracle(distance_fn: DistanceFn, x: Points) -> Distances:
    """Distances at points, checked; a masked entry is one that cannot be reached."""
    return as_distances("distance_fn", distance_fn(x.copy()), x)  # it may compute in place


def call_weights(weight_fn: WeightFn, x: Points) -> Float[np.ndarray, "n"]:
    """Weights at points, checked."""
    weight = as_values("weight_fn", weight_fn(x.copy()), len(x))
    if not np.isfinite(weight).all() or (weight < 0).any():
        raise ValueError(
            f"weight_fn must return finite weights >= 0, got values from {weight.min(initial=np.inf):g} to "
            f"{weight.max(initial=-np.inf):g}."
        )
    return weight
