"""What ``plr-jax build`` builds: a PLR with a proof, of the model asked for or of the least error; and from what."""

import math
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

if TYPE_CHECKING:
    from plr_jax.geometry.box import Box
    from plr_jax.geometry.workspace import Workspace
    from plr_jax.oracles import VisibilityGraph
    from plr_jax.plr import PLR

BEST = "best"
_EXTENSION_BYTES, _MARK_BYTES = 4, 4
"""Of a header with a label, and at the most of each mark."""
_CROWDED, _BYTES_A_SOURCE = 4, 7
"""Times the budget that all corners may take where leaves that name them are tried, and bytes of one."""


def prepared_oracle(workspace: "Workspace", goal: Float[np.ndarray, "2"], file: Path | None) -> "VisibilityGraph":
    """The exact oracle, from what a file holds of its workspace; where there is no such file, it is written.

    ``ValueError`` if the file holds something else.
    """
    from plr_jax.oracles import VisibilityGraph

    if file is None or not file.exists():
        oracle = VisibilityGraph(workspace, goal)
        if file is not None:
            oracle.save(file)
        return oracle
    oracle = VisibilityGraph.load(file)
    same = oracle.workspace.free_space.equals_exact(workspace.free_space, 0.0)
    if not same or oracle.workspace.squeeze != workspace.squeeze:
        raise ValueError(f"{file} was prepared for another map; name another file, or remove it.")
    return oracle.with_goal(goal)


def build_file(
    oracle: "VisibilityGraph",
    label: str,
    prefixes: Sequence[int],
    leaf: str,
    leaf_bounds: bool,
    *,
    seed: int,
    max_bytes: int | None,
    **limits: int | float | None,
) -> tuple["PLR", dict[str, float], bool]:
    """A PLR with its proof and a label, in a file that begins with coarser ones, and what :func:`build_proven` says.

    Limits are of the whole file. An interrupt ends what is being built and leaves out what is finer. A coarser one
    that is as large as what comes after it is left out, with a warning. ``ValueError`` names the option that is too
    small, and how many bytes are enough for a leaf with all that is around it.
    """
    from plr_jax.plr import progressive
    from plr_jax.plr.growth.limits import BudgetTooSmall

    if sorted(set(prefixes)) != list(prefixes) or (max_bytes is not None and prefixes and prefixes[-1] >= max_bytes):
        raise ValueError(f"Prefixes must rise, up to less than --max-bytes, got {', '.join(map(str, prefixes))}.")
    extension = len(label.encode()) + _EXTENSION_BYTES + _MARK_BYTES * len(prefixes)
    plrs: list[PLR] = []
    errors: dict[str, float] = {}
    parts = [*(("--prefix", size) for size in prefixes), ("--max-bytes", max_bytes)]
    for number, (option, size) in enumerate(parts, 1):
        of_file = limits if option == "--max-bytes" else {}
        taken = extension + sum(plr.num_bytes for plr in plrs)
        budget = None if size is None else max(1, size - taken)
        if plrs and budget is not None and budget <= (coarser := plrs[-1].num_bytes):
            raise ValueError(
                f"{option} {size} is too small: {taken} bytes are for what comes before, and a finer one takes more "
                f"than {coarser}; allow more than {taken + coarser}."
            )
        try:
            plr, of_models, interrupted = build_proven(
                f"part {number} of {len(parts)}" if prefixes else "file",
                oracle,
                oracle.workspace.bounds,
                leaf,
                leaf_bounds,
                seed=seed,
                max_bytes=budget,
                **of_file,
            )
        except BudgetTooSmall as error:
            raise ValueError(
                f"{option} {size} is too small: one leaf takes {error.num_bytes} bytes, the label and what "
                f"else comes before it {taken}; allow at least {error.num_bytes + taken}."
            ) from error
        if not (interrupted and plrs and _body_size(plr) <= _body_size(plrs[-1])):  # which is better
            smaller = [coarser for coarser in plrs if _body_size(coarser) < _body_size(plr)]
            if len(smaller) < len(plrs):
                warnings.warn(
                    "prefixes as large as what comes after them are left out: the limits allow no larger file.",
                    stacklevel=2,
                )
            plrs, errors = [*smaller, plr], of_models
        if interrupted:
            break
    return progressive(plrs).with_label(label), errors, interrupted


def _body_size(plr: "PLR") -> int:
    return len(plr.container.last.body)


def build_proven(
    what: str,
    oracle: "VisibilityGraph",
    domain: "Box",
    leaf: str,
    leaf_bounds: bool,
    *,
    seed: int,
    **limits: int | float | None,
) -> tuple["PLR", dict[str, float], bool]:
    """A PLR with its proof, the proven largest error of each leaf model that was tried, and whether that ended early.

    Of several, those that cannot be built are left out; ``ValueError`` if none can be built. An interrupt (Ctrl-C)
    ends what is being built and leaves the rest untried. A terminal shows how many models of ``what`` are done, and
    which is being built.
    """
    from tqdm import tqdm

    options: Any = {"seed": seed, "certified": True, "leaf_bounds": leaf_bounds, **limits}
    best, errors, interrupted = None, {}, False
    refused: list[ValueError] = []
    names = _tried(oracle, limits) if leaf == BEST else [leaf]
    with tqdm(names, what, unit=" models", leave=False, disable=None) as progress:
        for name in progress:
            progress.set_description(f"{what}: leaves of kind {name!r}")
            try:
                plr, interrupted = _constructed(oracle, domain, name, options)
            except ValueError as error:  # as of a budget that is too small for one leaf of this model
                refused.append(error)
                continue
            errors[name] = float("inf") if plr.max_error is None else plr.max_error  # if interrupted in its proof
            if best is None or errors[name] < errors[best.leaf.name]:
                best = plr
            if interrupted:
                break
    if best is None:
        raise min(refused, key=lambda error: getattr(error, "num_bytes", math.inf))
    return best, errors, interrupted


def _constructed(oracle: "VisibilityGraph", domain: "Box", leaf: str, options: dict[str, Any]) -> tuple["PLR", bool]:
    """The PLR of one leaf model, and whether that was interrupted, of which there is no other warning."""
    from plr_jax.plr import ConstructionInterrupted, construct

    interrupted = False
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", ConstructionInterrupted)
        plr = construct(oracle, domain, leaf=leaf, **options)
    for warning in caught:
        if issubclass(warning.category, ConstructionInterrupted):
            interrupted = True
        else:
            warnings.warn_explicit(warning.message, warning.category, warning.filename, warning.lineno)
    return plr, interrupted


def _tried(oracle: "VisibilityGraph", limits: dict[str, Any]) -> list[str]:
    """The leaf models to choose from: cones alone where all corners have room, all but these where few have.

    On all maps of the experiments cones with that room err ten to a thousand times less on average than the others.
    """
    from plr_jax.plr.leaves import leaf_model, leaf_names
    from plr_jax.plr.leaves.base import SourcedLeafModel

    of_corners = _BYTES_A_SOURCE * np.count_nonzero(np.isfinite(oracle.sources.distances))
    share = of_corners / (limits.get("max_bytes") or math.inf)
    sourced = [name for name in leaf_names() if isinstance(leaf_model(name), SourcedLeafModel)]
    if share <= 1 and limits.get("max_leaves") is limits.get("max_depth") is None:
        return sourced
    return [name for name in leaf_names() if share <= _CROWDED or name not in sourced]
