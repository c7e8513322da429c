"""What ``plr-jax build`` builds: a PLR with a proof, of the model asked for or of the least error; and from what."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

if TYPE_CHECKING:
    from plr_jax.geometry.workspace import Workspace
    from plr_jax.oracles import VisibilityGraph
    from plr_jax.plr._file import Contents


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
    oracle: "VisibilityGraph", label: str, leaf: str, leaf_bounds: bool, *, max_bytes: int | None, **options: Any
) -> tuple[bytes, "Contents", dict[str, float], bool]:
    """Build a PLR of a map with its proof, without importing JAX.

    Returns:
        The file, its contents, the proven largest error of each leaf model tried, and whether an interrupt ended the
        construction early.

    Raises:
        ValueError: If ``max_bytes``, which is of the whole file, has no room for one leaf and the label.
    """
    from plr_jax.plr._best import best_leaves
    from plr_jax.plr._construct import construct_leaves
    from plr_jax.plr._file import encode
    from plr_jax.plr.file.container import Container, frame_size, require_label
    from plr_jax.plr.growth.limits import BudgetTooSmall

    require_label(label)
    domain = oracle.workspace.bounds
    taken = frame_size(domain, label=label) - frame_size(domain)
    budget = None if max_bytes is None else max(1, max_bytes - taken)
    proven: Any = {"certified": True, "leaf_bounds": leaf_bounds, "max_bytes": budget, **options}
    try:
        best = best_leaves(construct_leaves, oracle, domain, leaf=leaf, what="file", **proven)
    except BudgetTooSmall as error:
        raise ValueError(
            f"--max-bytes {max_bytes} is too small: one leaf takes {error.num_bytes} bytes, the label {taken}; allow "
            f"at least {error.num_bytes + taken}."
        ) from error
    container = replace(Container.from_bytes(encode(best.contents)), label=label)
    return container.to_bytes(), best.contents, best.errors, best.is_interrupted
