"""The public function :func:`construct_many`, which builds many PLRs in parallel, for example one for each goal."""

import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from typing import Any, TypeAlias

import numpy as np

from plr_jax._arrays import as_list, require_integer
from plr_jax._compiled import num_cores
from plr_jax._progress import Progress
from plr_jax._types import ArrayLike, DistanceFn, FamilyFn
from plr_jax.geometry.box import Box
from plr_jax.plr._construct import DEFAULT_OPTIONS, BuildOptions, construct, proof_of
from plr_jax.plr._file import DecodedFile, certificates_of, encode
from plr_jax.plr._plr import PLR
from plr_jax.plr.container import frame_size, padded_file
from plr_jax.plr.growth import ConstructionInterrupted
from plr_jax.plr.leaves import Cone, FamilyTask, WorstFirst, family_task, leaf_model
from plr_jax.plr.leaves.base import GivenLimits, LeafModel, check_limits
from plr_jax.plr.sampling import reach_of, run_tasks

# For each task of a worker: the indices of oracles, and a function that returns the bytes of their files.
Tasks: TypeAlias = dict[tuple[int, ...], Callable[[], list[bytes]]]
_MEMBERS_AT_ONCE = 64  # goals in a task of a worker, so that an interrupt keeps what is finished


def construct_many(
    oracles: Sequence[DistanceFn],
    domain: Box | tuple[ArrayLike, ArrayLike],
    *,
    leaf: LeafModel | str = "plane",
    max_bytes: int | None = None,
    max_leaves: int | None = None,
    max_depth: int | None = None,
    tolerance: int | float | None = None,
    certified: bool | str = False,
    seed: int = 0,
    options: BuildOptions = DEFAULT_OPTIONS,
) -> list[Any]:
    """Build a PLR for each of many distance functions, for example one for every goal of a fleet.

        first = plr_jax.VisibilityGraph(workspace, goals[0])
        oracles = [first, *(first.with_goal(goal) for goal in goals[1:])]
        plrs = plr_jax.construct_many(oracles, workspace.bounds, leaf="cone", max_bytes=1024)

    Oracles that :meth:`VisibilityGraph.with_goal` derives from one another are a *family*. PLRs of cones of a family
    are built together, which is faster than :func:`construct`:

    - Without a proof, cones are chosen by their mean errors at a grid of up to 512 x 512 points that all goals share.
      Mean errors are mostly smaller than those of :func:`construct`. A PLR that is exact at all these points gets no
      more leaves, so its file may be smaller than ``max_bytes``.
    - If ``certified``, the leaves of largest proven error are halved until files are full. ``plr.max_error`` and the
      gaps between bounds are mostly smaller than those of :func:`construct`; mean errors may be several times larger.

    All other PLRs are built one by one with :func:`construct`. Cones of a family are also built one by one in three
    cases: if a tolerance or options other than the executor are given; if ``max_bytes``, ``max_leaves`` or
    ``max_depth`` allow more than about 8,000 leaves; or if a part of free space cannot reach the goal.

    Args:
        oracles: The distance functions, of any kind.
        domain: The box that all PLRs cover, a ``Box`` or its two corners.
        leaf: Leaf model, as for :func:`construct`, except ``"best"``.
        max_bytes: Largest size of each PLR's file, in bytes.
        max_leaves: Largest number of leaves of each PLR.
        max_depth: Largest number of splits between the root and a leaf.
        tolerance: As for :func:`construct`.
        certified: As for :func:`construct`.
        seed: Seed of the samples. The same seed gives the same files, whatever the executor.
        options: As for :func:`construct`, except that workers of ``executor``, such as Dask's
            ``Client.get_executor()``, build whole PLRs. Each task builds up to 64 PLRs of a family, or a single PLR.
            If a worker dies, threads of this process build the missing PLRs. If ``executor`` is None, one thread per
            core builds PLRs.

    Returns:
        The PLRs, in the order of ``oracles``; lookup tables are made at the first query. After an interrupt (Ctrl-C),
        the list has None for each missing PLR, and there is a ``ConstructionInterrupted`` warning. An interrupt
        before the first PLR is begun raises ``KeyboardInterrupt``.

    Raises:
        ValueError: If ``oracles`` is empty, or as for :func:`construct`.
    """
    # 1. Check the arguments.
    oracles = as_list("oracles", oracles, "distance functions", callable)
    domain, model, proof = Box.of(domain, "domain, such as workspace.bounds,"), leaf_model(leaf), proof_of(certified)
    require_integer("seed", seed, 0)
    executor = options.executor
    options = replace(options, executor=None)
    given = GivenLimits(max_depth, max_leaves, max_bytes, tolerance)
    limits = check_limits(model, domain.dim, proof, frame_size(domain), given)
    # 2. Group the oracles: families whose cones are built together, and single oracles.
    is_plane = domain.dim == 2 and not domain.is_periodic
    as_family = isinstance(model, Cone) and is_plane and limits.tolerance == 0 and options == DEFAULT_OPTIONS
    settings = {"leaf": leaf, "certified": certified, "seed": seed, "options": options}
    alone = partial(construct, domain=domain, **given._asdict(), **settings)
    families: dict[int, list[int]] = {}  # indices of oracles; keys of single oracles are negative
    for number, oracle in enumerate(oracles):
        is_member = as_family and isinstance(oracle, FamilyFn) and reach_of(oracle, domain) is None
        key = id(oracle.family) if is_member else -1 - number
        families.setdefault(key, []).append(number)
    # 3. Divide the groups into tasks for workers, and run them.
    tasks: Tasks = {}
    for key, numbers in families.items():
        first = oracles[numbers[0]]
        task = family_task(first, domain, limits) if key >= 0 and isinstance(first, FamilyFn) else None
        for part in np.array_split(np.array(numbers), -(-len(numbers) // (_MEMBERS_AT_ONCE if task else 1))):
            tasks[tuple(part.tolist())] = partial(_files, alone, task, [oracles[i] for i in part])
    total = len(oracles)
    with Progress("construct_many", "PLRs", total) as progress:
        files, is_interrupted = build_files(tasks, executor, progress)
    if is_interrupted:
        message = f"Interrupted at {len(files)} of {total} PLRs: the list has None for the others."
        warnings.warn(message, ConstructionInterrupted, stacklevel=2)
    return [PLR(padded_file(files[number])) if number in files else None for number in range(total)]


def _files(alone: Callable[..., Any], task: FamilyTask | WorstFirst | None, oracles: Sequence[Any]) -> list[bytes]:
    """Return the bytes of the file of each oracle's PLR.

    ``task`` builds PLRs of cones for several oracles together, but may leave out some. ``alone`` builds the PLR of a
    single oracle: of each oracle that the task leaves out or, if there is no task, of every oracle.
    """
    if task is None:
        return [alone(oracle).to_bytes() for oracle in oracles]
    files: dict[int, bytes] = {}
    for begin in range(0, len(oracles), task.goals_at_once):
        trees, visible = task(oracles[begin : begin + task.goals_at_once])  # None for a tree that is left out
        built = {i: tree for i, tree in enumerate(trees, begin) if tree is not None}
        contents = [DecodedFile(task.domain, leaf_model("cone"), *tree) for tree in built.values()]
        if contents and visible is not None:
            proofs = certificates_of(contents, visible, task.limits.proof)
            contents = [replace(file, certificate=proof) for file, proof in zip(contents, proofs, strict=True)]
        files |= zip(built, map(encode, contents), strict=True)
    return [files.get(i) or alone(oracle).to_bytes() for i, oracle in enumerate(oracles)]


def build_files(tasks: Tasks, executor: Executor | None, progress: Progress) -> tuple[dict[int, bytes], bool]:
    """Build the files of all tasks on parallel workers.

    ``executor`` runs the tasks. If it is None or a worker dies, threads of this process run the missing tasks.
    ``progress`` counts the files. Return the finished files by index, and whether an interrupt (Ctrl-C) stopped the
    construction.
    """
    done: dict[tuple[int, ...], list[bytes]] = {}  # files of finished tasks
    is_interrupted = False
    threads = ThreadPoolExecutor(num_cores())
    try:
        for pool in (threads,) if executor is None else (executor, threads):
            run_tasks(pool, {key: task for key, task in tasks.items() if key not in done}, done, progress)
    except KeyboardInterrupt:
        is_interrupted = True
    finally:
        threads.shutdown(wait=False, cancel_futures=True)
    files = {number: file for key, built in done.items() for number, file in zip(key, built, strict=True)}
    return files, is_interrupted
