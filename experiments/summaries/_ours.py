"""Our file of all pairs: ``construct_pairs``."""

from experiments.summaries._summary import Candidates, Given
from plr_jax import construct_pairs


def candidates(given: Given) -> Candidates:
    """The file of at most so many bytes."""
    yield "", construct_pairs(given.workspace, max_bytes=given.max_bytes)
