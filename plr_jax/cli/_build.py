"""What ``plr-jax build`` builds: a PLR with a proof, of the model asked for or of the least error; and from what."""

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

if TYPE_CHECKING:
    from plr_jax.geometry.box import Box
    from plr_jax.geometry.workspace import Workspace
    from plr_jax.oracles import VisibilityGraph
    from plr_jax.plr._file import Contents
    from plr_jax.plr.file.container import Container

_EXTENSION_BYTES, _MARK_BYTES = 4, 4
"""Of a header with a label, and at the most of each mark."""


@dataclass(frozen=True, eq=False)
class Built:
    """Leaves with their proof, and their file without a label. Neither is a PLR yet, for which JAX is imported."""

    contents: "Contents"

    @cached_property
    def data(self) -> bytes:
        """The bytes of the file."""
        from plr_jax.plr._file import encode

        return encode(self.contents)

    @cached_property
    def container(self) -> "Container":
        """The file."""
        from plr_jax.plr.file.container import Container

        return Container.from_bytes(self.data)

    @property
    def body_size(self) -> int:
        """Bytes of its layer."""
        return len(self.container.last.body)

    @property
    def max_error(self) -> float:
        """The proven largest error; ``inf`` if nothing is proven, as construction was interrupted."""
        certificate = self.contents.certificate
        return math.inf if certificate is None else certificate.max_error


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
) -> tuple["Container", Built, dict[str, float], bool]:
    """A file that begins with coarser PLRs, its last one, and what else :func:`build_proven` says of that.

    Limits are of the whole file. An interrupt ends what is being built and leaves out what is finer. A coarser one
    that is as large as what comes after it is left out, with a warning. ``ValueError`` names the option that is too
    small, and how many bytes are enough for a leaf with all that is around it.
    """
    from plr_jax.plr.file.container import layered, require_label
    from plr_jax.plr.growth.limits import BudgetTooSmall

    require_label(label)
    if sorted(set(prefixes)) != list(prefixes) or (max_bytes is not None and prefixes and prefixes[-1] >= max_bytes):
        raise ValueError(f"Prefixes must rise, up to less than --max-bytes, got {', '.join(map(str, prefixes))}.")
    extension = len(label.encode()) + _EXTENSION_BYTES + _MARK_BYTES * len(prefixes)
    plrs: list[Built] = []
    errors: dict[str, float] = {}
    parts = [*(("--prefix", size) for size in prefixes), ("--max-bytes", max_bytes)]
    for number, (option, size) in enumerate(parts, 1):
        of_file = limits if option == "--max-bytes" else {}
        taken = extension + sum(len(plr.data) for plr in plrs)
        budget = None if size is None else max(1, size - taken)
        if plrs and budget is not None and budget <= (coarser := len(plrs[-1].data)):
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
        if not (interrupted and plrs and plr.body_size <= plrs[-1].body_size):  # which is better
            smaller = [coarser for coarser in plrs if coarser.body_size < plr.body_size]
            if len(smaller) < len(plrs):
                warnings.warn(
                    "prefixes as large as what comes after them are left out: the limits allow no larger file.",
                    stacklevel=2,
                )
            plrs, errors = [*smaller, plr], of_models
        if interrupted:
            break
    return replace(layered([plr.container for plr in plrs]), label=label), plrs[-1], errors, interrupted


def build_proven(
    what: str,
    oracle: "VisibilityGraph",
    domain: "Box",
    leaf: str,
    leaf_bounds: bool,
    *,
    seed: int,
    **limits: int | float | None,
) -> tuple[Built, dict[str, float], bool]:
    """What was built with its proof, the proven largest error of each leaf model tried, and whether that ended early.

    As :func:`best_leaves` has it, which shows on a terminal how many models of ``what`` are done.
    """
    from plr_jax.plr._best import best_leaves
    from plr_jax.plr._construct import construct_leaves

    options: Any = {"seed": seed, "certified": True, "leaf_bounds": leaf_bounds, **limits}
    best = best_leaves(construct_leaves, oracle, domain, leaf=leaf, what=what, **options)
    return Built(best.contents), best.errors, best.is_interrupted
