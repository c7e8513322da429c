"""A PLR over pairs of points, from samples: ``construct_metric_pairs``, which needs no polygons."""

from experiments.summaries._summary import Candidates, Given
from plr_jax import construct_metric_pairs

_MOST_LEAVES = {False: 5_000, True: 50}  # each asks for hundreds of exact distances


def candidates(given: Given) -> Candidates:
    """One for each kind of leaf that may be of four dimensions."""
    for leaf in ("plane", "continuous"):
        pairs = construct_metric_pairs(
            given.exact.between,
            given.workspace.bounds,
            leaf=leaf,
            max_bytes=given.max_bytes,
            max_leaves=_MOST_LEAVES[given.smoke],
            seed=given.seed,
        )
        yield f"{leaf}, {pairs.plr.num_leaves:,} leaves", pairs
