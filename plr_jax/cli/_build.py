"""What ``plr-jax build`` builds: a PLR with a proof, of the leaf model asked for or of the one of the least error."""

import warnings
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from plr_jax.geometry.box import Box
    from plr_jax.oracles import VisibilityGraph
    from plr_jax.plr import PLR

BEST = "best"


def build_proven(
    oracle: "VisibilityGraph", domain: "Box", leaf: str, *, seed: int, **limits: int | float | None
) -> tuple["PLR", dict[str, float]]:
    """A PLR with its proof, and the proven largest error of each leaf model that was tried.

    An interrupt (Ctrl-C) ends what is being built early, with a ``ConstructionInterrupted`` warning, and leaves the
    rest untried.
    """
    from plr_jax.plr import ConstructionInterrupted, construct
    from plr_jax.plr.leaves import leaf_names

    best, errors = None, {}
    for name in leaf_names() if leaf == BEST else [leaf]:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", ConstructionInterrupted)
            plr = construct(oracle, domain, leaf=name, seed=seed, certified=True, **limits)  # type: ignore[arg-type]
        errors[name] = plr.max_error
        if best is None or errors[name] < errors[best.leaf.name]:
            best = plr
        if caught:
            warnings.warn(caught[0].message, stacklevel=2)  # type: ignore[arg-type]
            break
    assert best is not None, "there are leaf models"
    return best, errors
