"""The rival nearest in kind: LightGBM's trees with a plane in every leaf."""

from typing import Any

import numpy as np
from jaxtyping import Float

from experiments.benchmarks._rivals import Rival

_PACKED_BYTES_A_LEAF = 17  # axis, float32 threshold, three float32 coefficients
_PACKED_BYTES_OF_STUMP = 13
_NUM_TREES = (1, 2, 4)
_NUM_THREADS = 2
_WORTH_A_THREAD = 10_000  # points; waking another thread costs more than it saves for fewer


def linear_trees(
    x: Float[np.ndarray, "n 2"], distance: Float[np.ndarray, "n"], leaves: int, num_trees: int, seed: int
) -> Rival:
    """A stump, then boosted trees with so many leaves each; bytes are counted as if packed.

    LightGBM gives the leaves of its first tree no slope, so that tree is a stump, and all other leaves hold planes.
    The packed bytes are a fraction of the text that LightGBM saves.
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
    trees = lightgbm.train({**parameters, "num_leaves": leaves}, data, num_boost_round=num_trees, init_model=stump)

    def answer(x: Float[np.ndarray, "n 2"]) -> Any:
        return trees.predict(x, num_threads=_NUM_THREADS if len(x) >= _WORTH_A_THREAD else 1)

    return Rival(_PACKED_BYTES_OF_STUMP + _PACKED_BYTES_A_LEAF * leaves * num_trees, answer)


def best_linear_trees(
    x: Float[np.ndarray, "n 2"], distance: Float[np.ndarray, "n"], num_bytes: int, seed: int
) -> Rival:
    """One, two or four trees of so many packed bytes together, whichever are nearest to their own samples."""
    room = (num_bytes - _PACKED_BYTES_OF_STUMP) // _PACKED_BYTES_A_LEAF
    trees = [linear_trees(x, distance, max(2, room // number), number, seed) for number in _NUM_TREES]
    return min(trees, key=lambda rival: np.abs(rival.on_host(x) - distance).mean())
