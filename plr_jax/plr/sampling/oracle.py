"""Calling the caller's functions of points: what they answer is checked here, once."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from plr_jax._types import DistanceFn, Points

WeightFn = Callable[[Points], Float[np.ndarray, "n"]]


def call_oracle(distance_fn: DistanceFn, x: Points) -> Float[np.ndarray, "n"]:
    """Distances at points, checked; a masked entry is one that cannot be reached."""
    distance = distance_fn(x.copy())  # it may compute in place
    try:
        distance = np.ma.asarray(distance)
        distance = distance if distance.dtype.kind == "c" else distance.astype(np.float64).filled(np.inf)
    except (TypeError, ValueError) as error:
        raise ValueError(f"distance_fn must return an array of numbers, got {distance!r}.") from error
    if distance.dtype.kind == "c":
        raise ValueError("distance_fn must return real numbers, got complex ones.")
    if distance.shape != (len(x),):
        raise ValueError(
            f"distance_fn must return one distance a point, shape ({len(x)},) for points of shape {x.shape}, "
            f"got shape {distance.shape}."
        )
    bad = np.isnan(distance) | (distance == -np.inf)
    if bad.any():
        first = int(np.argmax(bad))
        raise ValueError(
            f"distance_fn must return numbers, or inf where the goal cannot be reached, got {distance[first]} "
            f"at {x[first].tolist()}."
        )
    return distance


def call_weights(weight_fn: WeightFn, x: Points) -> Float[np.ndarray, "n"]:
    """Weights at points, checked."""
    weight = np.asarray(weight_fn(x), dtype=np.float64)
    if weight.shape != (len(x),) or not np.isfinite(weight).all() or (weight < 0).any():
        raise ValueError(
            f"weight_fn must return one finite weight >= 0 a point, shape ({len(x)},), got shape {weight.shape} "
            f"with values from {weight.min(initial=np.inf):g} to {weight.max(initial=-np.inf):g}."
        )
    return weight
