"""The rival nearest in kind: LightGBM's trees with a plane in every leaf."""

from typing import Any

import numpy as np
from jaxtyping import Float

from experiments.benchmarks._rivals import Rival

_PACKED_BYTES_A_LEAF = 17  # axis, float32 threshold, three float32 coefficients
_PACKED_BYTES_OF_STUMP = 13
NUM_TREES = (1, 2, 4)
_NUM_THREADS = 2
_WORTH_A_THREAD = 10_000  # points; waking another thread costs more than it saves for fewer


def linear_trees(
    x: Float[np.ndarray, "n 2"], distance: Float[np.ndarray, "n"], leaves: int, num_trees: int, seed: int
) -> Rival:
    """Trees with so many leaves each; bytes are counted as if packed, a fraction of the text that LightGBM saves."""
    trees = train_linear_trees(x, distance, leaves, num_trees, seed)

    def answer(x: Float[np.ndarray, "n 2"]) -> Any:
        return trees.predict(x, num_threads=_NUM_THREADS if len(x) >= _WORTH_A_THREAD else 1)

    return Rival(_PACKED_BYTES_OF_STUMP + _PACKED_BYTES_A_LEAF * leaves * num_trees, answer)


def train_linear_trees(
    x: Float[np.ndarray, "n 2"], distance: Float[np.ndarray, "n"], leaves: int, num_trees: int, seed: int
) -> Any:
    """LightGBM's booster: a stump, then boosted trees with so many leaves each.

    LightGBM gives the leaves of its first tree no slope, so that tree is a stump, and all other leaves hold planes.
    """
    import lightgbm

    parameters = {
        "objective": "l2",
        "linear_tree": True,
        "learning_rate": 1.0,
        "min_data_in_leaf": 8,
        "max_bin": 1023,
        "linear_lambda": 1e-6,
        "seed": seed,
        "deterministic": True,
        "num_threads": _NUM_THREADS,
        "verbosity": -1,
    }
    data = lightgbm.Dataset(x, distance, free_raw_data=False)
    stump = lightgbm.train({**parameters, "num_leaves": 2}, data, num_boost_round=1)
    return lightgbm.train({**parameters, "num_leaves": leaves}, data, num_boost_round=num_trees, init_model=stump)


def leaves_that_fit(num_bytes: int, num_trees: int) -> int:
    """Leaves of each of so many trees that take so many packed bytes together."""
    return max(2, (num_bytes - _PACKED_BYTES_OF_STUMP) // _PACKED_BYTES_A_LEAF // num_trees)


def best_linear_trees(
    x: Float[np.ndarray, "n 2"], distance: Float[np.ndarray, "n"], num_bytes: int, seed: int
) -> Rival:
    """One, two or four trees of so many packed bytes together, whichever are nearest to their own samples."""
    trees = [linear_trees(x, distance, leaves_that_fit(num_bytes, number), number, seed) for number in NUM_TREES]
    return min(trees, key=lambda rival: np.abs(rival.on_host(x) - distance).mean())
