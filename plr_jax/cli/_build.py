"""What ``plr-jax build`` builds: a PLR with a proof, of the leaf model asked for or of the one of the least error."""

import warnings
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from plr_jax.geometry.box import Box
    from plr_jax.oracles import VisibilityGraph
    from plr_jax.plr import PLR

BEST = "best"


def build_proven(
    oracle: "VisibilityGraph", domain: "Box", leaf: str, leaf_bounds: bool, *, seed: int, **limits: int | float | None
) -> tuple["PLR", dict[str, float], bool]:
    """A PLR with its proof, the proven largest error of each leaf model that was tried, and whether that ended early.

    Of several, those that cannot be built are left out; ``ValueError`` if none can. An interrupt (Ctrl-C) ends what
    is being built and leaves the rest untried.
    """
    from plr_jax.plr import ConstructionInterrupted, construct
    from plr_jax.plr.leaves import leaf_names

    options: Any = {"seed": seed, "certified": True, "leaf_bounds": leaf_bounds, **limits}
    best, errors, refused, interrupted = None, {}, None, False
    for name in leaf_names() if leaf == BEST else [leaf]:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", ConstructionInterrupted)
            try:
                plr = construct(oracle, domain, leaf=name, **options)
            except ValueError as error:  # as of a budget that is too small for one leaf of this model
                refused = error
                continue
        errors[name] = float("inf") if plr.max_error is None else plr.max_error  # if interrupted in its proof
        if best is None or errors[name] < errors[best.leaf.name]:
            best = plr
        for warning in caught:
            if issubclass(warning.category, ConstructionInterrupted):
                interrupted = True
            else:
                warnings.warn_explicit(warning.message, warning.category, warning.filename, warning.lineno)
        if interrupted:
            break
    if best is None:
        assert refused is not None, "there are leaf models"
        raise refused
    return best, errors, interrupted
