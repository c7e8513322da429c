"""Building many PLRs: those of one workspace's goals together, all others one by one, on all cores."""

import os
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from tqdm import tqdm

from plr_jax._arrays import require_integer, shortened
from plr_jax._types import ArrayLike, DistanceFn, FamilyFn
from plr_jax.geometry.box import Box
from plr_jax.plr._checkpoint import Checkpoint, digest_of
from plr_jax.plr._chunks import Chunk, Done
from plr_jax.plr._construct import construct, proof_of
from plr_jax.plr._file import Contents, encode
from plr_jax.plr._plr import deferred_plr
from plr_jax.plr._proof import certificate_of
from plr_jax.plr.certificate import Proof
from plr_jax.plr.container import frame_size
from plr_jax.plr.growth.limits import ConstructionInterrupted, check_limits
from plr_jax.plr.leaves import leaf_model
from plr_jax.plr.leaves.base import FamilyLeafModel, LeafModel, MemberLeaves
from plr_jax.plr.partition.cells import grown_domain
from plr_jax.plr.sampling.asked import as_executor

_MEMBERS_AT_ONCE = 64  # more share more, and take more memory: about 10 MB each


def construct_many(
    oracles: Sequence[DistanceFn],
    domain: Box | tuple[ArrayLike, ArrayLike],
    *,
    leaf: LeafModel | str = "plane",
    max_depth: int | None = None,
    max_leaves: int | None = None,
    max_bytes: int | None = None,
    tolerance: int | float | None = None,
    certified: bool = False,
    leaf_bounds: bool = False,
    seed: int = 0,
    executor: Executor | None = None,
    checkpoint: str | os.PathLike | None = None,
) -> list[Any]:
    """Build a PLR of each of many distance functions, as one for every goal of a fleet.

    Cones of goals of one workspace, whose oracles :meth:`VisibilityGraph.with_goal` made of one another, are built
    together: what corners see is found once, and cells that are alike for several goals are looked at once. Their
    PLRs err about as much as those that :func:`construct` builds, but are not the same: cells are not looked at whose
    halves the other way are better, and none larger than about eight times an average leaf is a leaf unless one
    source serves all of it.
    All others are what :func:`construct` builds, one by one.

    Args:
        oracles: The distance functions, of any kind.
        domain: The box to cover, a ``Box`` or its two corners, the same for all.
        leaf: As for :func:`construct`.
        max_depth: As for :func:`construct`, of each PLR, as are the other limits.
        max_leaves: Largest number of leaves.
        max_bytes: Largest size of the file.
        tolerance: Cells of errors up to this are not split.
        certified: Whether to prove a bound of the largest error of each.
        leaf_bounds: Whether the proofs have bounds of every leaf, instead of classes of leaves.
        seed: Seed of the samples' scrambling. The same seed gives the same files, whatever the executor.
        executor: What runs the parts, of 64 members of a family or one PLR each: threads, processes, a cluster's,
            such as Dask's ``Client.get_executor()``. Of processes, the distance functions must be picklable. What a
            pool did not finish because a worker died is built here, by threads. None: threads, one a core.
        checkpoint: A file in which PLRs are kept as their parts are done. Called again with the same arguments, it
            goes on with what is left, even if the process was killed, to the same PLRs, and in the end to the same
            file, byte for byte. Distance functions are known by what they say of 256 points. None: none.

    Returns:
        The PLRs, in the order of the distance functions. Their tables are made when they are first queried. If
        interrupted (Ctrl-C), those that are done, with None for the others and a ``ConstructionInterrupted`` warning.

    Raises:
        ValueError: If there are no distance functions, the checkpoint is of other work, or as for :func:`construct`.
        OSError: If the checkpoint cannot be read or written.
    """
    oracles, domain, model = _as_functions(oracles), Box.of(domain), leaf_model(leaf)
    require_integer("seed", seed, 0)
    executor = as_executor(executor)
    options: dict[str, Any] = {
        "leaf": leaf,
        "max_depth": max_depth,
        "max_leaves": max_leaves,
        "max_bytes": max_bytes,
        "tolerance": tolerance,
        "certified": certified,
        "leaf_bounds": leaf_bounds,
        "seed": seed,
    }
    limits = check_limits(
        domain.dim,
        model.least_bytes,
        model.has_deep_trees or certified,
        model.bytes_without_budget,
        max_depth,
        max_leaves,
        max_bytes,
        tolerance,
        proof_of(certified, leaf_bounds),
        frame_size(domain),
    )
    is_limited = min(limits.max_leaves, limits.max_bytes) < np.iinfo(np.int64).max
    is_plane = domain.dim == 2 and not domain.is_periodic
    as_family = isinstance(model, FamilyLeafModel) and is_plane and is_limited
    options_digested = f"{model} {limits} {int(seed)}"
    kept = None if checkpoint is None else Checkpoint(checkpoint, digest_of(oracles, domain, options_digested))
    done = Done.of(len(oracles), kept)
    families: dict[int, list[int]] = {}
    for number in (number for number, file in enumerate(done.results) if file is None):
        oracle = oracles[number]
        of_family = as_family and isinstance(oracle, FamilyFn)
        families.setdefault(id(oracle.family) if of_family else -1 - number, []).append(number)
    chunks = []
    for numbers in families.values():
        first = oracles[numbers[0]]
        if as_family and isinstance(model, FamilyLeafModel) and isinstance(first, FamilyFn):
            work = _Family(model.family_task(first, domain, limits, int(seed)), domain, model, limits.proof)
            parts = np.array_split(np.array(numbers), -(-len(numbers) // _MEMBERS_AT_ONCE))
            chunks += [Chunk(part.tolist(), partial(work, [oracles[i] for i in part])) for part in parts]
        else:
            chunks.append(Chunk(numbers, partial(_file_alone, first, domain, options)))
    with tqdm(
        desc="construct_many",
        unit=" PLRs",
        total=len(oracles),
        initial=done.count,
        delay=2,
        leave=False,
        disable=None,
    ) as progress:
        try:
            done.build(chunks, executor, progress)
            done.finish()
        except KeyboardInterrupt:
            message = f"Interrupted at {done.count} of {len(oracles)} PLRs: None stands for the others."
            warnings.warn(message, ConstructionInterrupted, stacklevel=2)
    return [None if file is None else deferred_plr(file) for file in done.results]


def _as_functions(oracles: Sequence[DistanceFn]) -> list[DistanceFn]:
    try:
        oracles = list(oracles)
    except TypeError:
        raise ValueError(f"oracles must be a list of distance functions, got {shortened(oracles)}.") from None
    if not oracles:
        raise ValueError("construct_many needs one distance function at least, got none.")
    for number, oracle in enumerate(oracles):
        if not callable(oracle):
            raise ValueError(f"oracles must be functions, that of number {number} is {shortened(oracle)}.")
    return oracles


@dataclass(frozen=True, eq=False)
class _Family:
    """Files of members of a family."""

    task: Callable[[Sequence[Any]], list[MemberLeaves]]
    domain: Box
    leaf: LeafModel
    proof: Proof

    def __call__(self, oracles: Sequence[FamilyFn]) -> list[bytes]:
        leaf, files = leaf_model(self.leaf.name), []
        for oracle, (levels, cells, stored) in zip(oracles, self.task(oracles), strict=True):
            contents = Contents(self.domain, leaf, levels, cells, stored)
            if self.proof is not Proof.NONE:
                root = oracle.cell_sources(grown_domain(self.domain))
                contents = replace(contents, certificate=certificate_of(contents, root, self.proof))
            files.append(encode(contents))
        return files


def _file_alone(oracle: DistanceFn, domain: Box, options: dict[str, Any]) -> list[bytes]:
    return [construct(oracle, domain, **options).to_bytes()]
