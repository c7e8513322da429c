"""Building a PLR: Algorithm 1 of the paper, for any leaf model; and proving the error of one that exists."""

import math
import os
import warnings
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np
from tqdm import tqdm

from plr_jax._arrays import as_bool, as_distances, as_number, require_function, require_integer, shortened
from plr_jax._types import (
    ArrayLike,
    CellSources,
    CellwiseFn,
    ChangingFn,
    DistanceFn,
    Distances,
    FreeSpaceFn,
    Points,
    Sources,
)
from plr_jax.geometry.box import Box
from plr_jax.plr._file import DecodedFile, encode
from plr_jax.plr._proof import BuildInputs, can_be_updated, certificate_of
from plr_jax.plr.cell_memory import CellMemory
from plr_jax.plr.certificate import Proof
from plr_jax.plr.container import frame_size
from plr_jax.plr.folding import Folding, folding_of
from plr_jax.plr.frame import table_corners
from plr_jax.plr.growth import ConstructionInterrupted, ShouldSplitRule, SplitRule, best_axis, largest_error
from plr_jax.plr.leaves import Cone, leaf_model, leaf_names
from plr_jax.plr.leaves.base import LeafModel, Rules, check_limits
from plr_jax.plr.portable.numpy import NumpyPLR
from plr_jax.plr.sampling import (
    FitRule,
    Sampler,
    WeightFn,
    call_oracle,
    folded_weights,
    least_squares,
    sample_pattern,
)
from plr_jax.plr.tree import Cells, grown_domain
from plr_jax.plr.work import Checkpoint, ParallelOracle, digest_of

if TYPE_CHECKING:
    from plr_jax.plr._plr import PLR

# A cell in which few samples reach the goal is sampled again with this many times as many.
_DENSE_FACTOR = 8
_MAX_SAMPLES = 2**16
# Random points of the domain that tell how much of free space reaches the goal.
_NUM_ADVICE_POINTS = 1000
BEST = "best"
_MOST_TIED_AXES = 6
# Cones are tried if all corners take at most this many times the budget, and alone if they take at most this share of
# it. On random maps of 10 to 80 blocked cells, cones erred less there on average and at most, or by far on average.
_CROWDED, _ROOMY = 4, 0.5
_BYTES_A_SOURCE = 7
_ERROR_POINTS = 4096


@dataclass(frozen=True)
class BuildOptions:
    """Options of :func:`construct` that few users need: rules of Algorithm 1, samples, workers and a checkpoint.

    The paper's own configuration is ``BuildOptions(should_split=maximum_depth, split=cyclic_axis)`` (or
    ``should_split=center_error`` with a tolerance) and ``max_depth=9``.

    Args:
        compute_coefficients: Function that fits the plane of each cell: ``least_squares`` or your own. Leaf models
            that share values between leaves ignore it.
        should_split: Function of a ``CellFit`` that gives a priority a cell: ``largest_error``, ``center_error``,
            ``maximum_depth`` or your own. The cell of the largest positive priority is split next.
        split: Function of a ``CellFit`` that gives the axis along which to halve each cell: ``best_axis``,
            ``cyclic_axis`` or your own.
        num_samples: Samples of a cell, at its center, inside and on its faces, at most 65,536. None: 192 for planes,
            96 for other leaves. Planes need at least ``dim + 1``, other leaves ``2**dim + 1``; take several times as
            many.
        margin: How far samples reach beyond their cell, as a fraction from 0 to 1 of its width. A margin averages the
            noise of an oracle such as a roadmap.
        weight_fn: Weight of the error at each of a batch of points, finite and >= 0. None: weight 1 everywhere.
        executor: ``concurrent.futures.Executor`` (threads, processes, a cluster) that calls a slow distance function
            for 1,024 points at a time. Processes need a picklable distance function. The PLR does not depend on the
            number of workers. None: this process.
        checkpoint: Path of a file that keeps answers of the distance function, 8 bytes each. When ``construct`` is
            called again with the same arguments, even after the process was killed, only missing answers are
            computed. The distance function is recognized by its answers at 256 points. None: no file.

    Raises:
        ValueError: If an option is of another kind or out of its range.
    """

    compute_coefficients: FitRule = least_squares
    should_split: ShouldSplitRule = largest_error
    split: SplitRule = best_axis
    num_samples: int | None = None
    margin: int | float = 0
    weight_fn: WeightFn | None = None
    executor: Executor | None = None
    checkpoint: str | os.PathLike | None = None

    def __post_init__(self):
        for name in ("compute_coefficients", "should_split", "split", "weight_fn"):
            if name != "weight_fn" or self.weight_fn is not None:
                require_function(name, getattr(self, name))
        as_number("margin", self.margin, "a fraction from 0 to 1 of a cell's width", lambda share: 0 <= share <= 1)
        if self.num_samples is not None:
            require_integer("num_samples", self.num_samples, 1)
            if self.num_samples > _MAX_SAMPLES:
                raise ValueError(f"num_samples must be at most {_MAX_SAMPLES:,} a cell, got {self.num_samples:,}.")
        if self.executor is not None and not isinstance(self.executor, Executor):
            raise ValueError(
                f"executor must be a concurrent.futures.Executor or None, got {shortened(self.executor)}."
            )

    @property
    def names(self) -> str:
        """The options as text that is the same in every process, by which checkpoints are told apart."""
        rules = self.compute_coefficients, self.should_split, self.split, self.weight_fn
        names = " ".join(getattr(rule, "__qualname__", type(rule).__qualname__) for rule in rules)
        return f"{names} {self.num_samples} {self.margin}"


DEFAULT_OPTIONS = BuildOptions()


def construct(
    distance_fn: DistanceFn,
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
) -> "PLR":
    """Build a PLR of a distance function: Algorithm 1 of the paper.

    Most calls give a budget, ``max_bytes``, and a leaf. Use ``leaf="cone"`` for distances among polygons, such as
    ``VisibilityGraph``, and add ``certified=True`` for proven bounds. Use ``"plane"``, the paper's leaf, or
    ``"continuous"`` for any other distance function. Limits may be combined; construction stops at the first one
    that is reached. Without limits it stops at 512 leaves.

    Args:
        distance_fn: Distance to the goal for a batch of points ``(n, dim)``; ``inf`` (or a masked entry) where the
            goal cannot be reached.
        domain: The box to cover, a ``Box`` or its two corners. Along periodic axes the distance must be periodic.
        leaf: Leaf model: its name, as listed below, or an instance such as ``Plane(coefficient_bits=16)``.
        max_bytes: Largest size of the file. Planes then get as few bits as serve the error best.
        max_leaves: Largest number of leaves.
        max_depth: Largest number of splits between the root and a leaf, at most 60. Query tables limit it as well:
            in the plane to 7 (2 KB) to 14 halvings along an axis, in ``dim`` > 2 dimensions to ``28 // dim``.
        tolerance: Cells with at most this largest sample error are not split, in units of distance. For cones and
            certified planes it is the proven error.
        certified: True proves ``plr.max_error`` and ``plr.bounds(x)`` over all points that reach the goal;
            ``"leaves"`` keeps bounds of every leaf, 2 bytes each. Needs a distance function that answers for whole
            cells, such as ``VisibilityGraph``; see :func:`certify`.
        seed: Seed of the samples. The same seed gives the same PLR.
        options: Rules of fitting and splitting, samples, workers and a checkpoint: see :class:`BuildOptions`.

    Leaf models:
        - ``"plane"``: one plane a leaf, fitted best-first. The function may jump between leaves.
        - ``"continuous"``: values at the leaves' corners, shared across free faces; in up to 6 dimensions.
        - ``"smooth"``: a continuous gradient as well, in 1 or 2 dimensions. Both err less a byte than planes, and
          take longer to build and to query.
        - ``"cone"``: the distance by way of one *source*, a corner of an obstacle. Exact except where the next corner
          changes, if the budget has room for the corners (about 7 bytes each). The partition is the best at a price a
          leaf. Needs a distance function that answers for whole cells, in the plane.
        - ``"best"``: builds several models and keeps the one that errs least: by the largest proven error, without a
          proof by the mean and the largest error at random points, multiplied. If the distance function answers for
          whole cells, it builds cones alone where all corners take at most half of ``max_bytes``, no cones where they
          take over four times as much, and between these cones and other leaves: all kinds with a proof, else
          continuous and smooth ones. Without a choice leaves are continuous, in more than 6 dimensions planes.

    A distance function that states ``symmetries``, as ``ReedsShepp`` does, is *folded*: points are mirrored into
    ``folded_domain``, and only that box is stored. Cones and certified PLRs are not folded.

    Returns:
        The PLR. After an interrupt (Ctrl-C), the PLR built so far, with a ``ConstructionInterrupted`` warning.
        Another warning says if most free points do not reach the goal.

    Raises:
        ValueError: If an argument is out of range, a budget is too small for one leaf, the leaf model or a proof is
            not available for this distance function or domain, ``distance_fn`` returns NaN or a wrong shape, no
            sample reaches the goal, or the checkpoint belongs to other work.
        OSError: If the checkpoint cannot be read or written.

    References:
        Section III-B of the paper. ``"smooth"``: Bogner, Fox, Schmit 1965. Best partition: Donoho, "CART and
        best-ortho-basis: a connection", Annals of Statistics 1997.
    """
    from plr_jax.plr._plr import plr_of_leaves  # the only part that imports JAX

    domain, proof = Box.of(domain), proof_of(certified)
    require_function("distance_fn", distance_fn)
    if not isinstance(options, BuildOptions):
        raise ValueError(f"options must be BuildOptions(...), got {shortened(options)}.")
    limits = max_depth, max_leaves, max_bytes, tolerance

    def build(name: LeafModel | str, oracle: DistanceFn) -> DecodedFile:
        return _build_leaves(oracle, domain, leaf_model(name), limits, proof, seed, options)

    if leaf == BEST:
        has_rules = (options.weight_fn, options.should_split, options.split) != (None, largest_error, best_axis)
        only_bytes = max_leaves is None and max_depth is None and not has_rules
        contents, is_interrupted = best_leaves(build, distance_fn, domain, proof, max_bytes, only_bytes, seed)
        if is_interrupted:
            message = "Interrupted: the PLR is the best one built so far."
            warnings.warn(message, ConstructionInterrupted, stacklevel=2)
    else:
        contents = build(leaf, distance_fn)
    if isinstance(distance_fn, FreeSpaceFn) and (advice := _advice(distance_fn, domain)):
        warnings.warn(advice, stacklevel=2)
    if can_be_updated(contents) and isinstance(distance_fn, ChangingFn):
        return plr_of_leaves(contents, BuildInputs(distance_fn, max_bytes, max_leaves, tolerance))
    return plr_of_leaves(contents)


def _build_leaves(
    distance_fn: DistanceFn,
    domain: Box,
    model: LeafModel,
    limits: tuple[int | None, int | None, int | None, int | float | None],
    proof: Proof,
    seed: int,
    options: BuildOptions,
) -> DecodedFile:
    """Build leaves of one model, with their proof, as a file holds them."""
    # 1. Check what is asked for.
    model.check_dim(domain.dim)
    table_corners(domain)  # or a query could not hold them
    require_integer("seed", seed, 0)
    answers_for_cells = isinstance(distance_fn, CellwiseFn)
    if proof is not Proof.NONE:
        require_certifiable(distance_fn, domain)
    folding = None
    if proof is Proof.NONE and not isinstance(model, Cone) and not answers_for_cells:
        folding = folding_of(distance_fn, domain)
    checked = check_limits(model, domain.dim, *limits, proof, frame_size(domain, folding))
    num_samples = model.num_samples if options.num_samples is None else options.num_samples
    require_integer("num_samples", num_samples, model.least_samples(domain.dim))

    # 2. Wrap the distance function: cells it answers for, workers and a checkpoint, folded points.
    memory = CellMemory(distance_fn, domain) if answers_for_cells and domain.dim == 2 else None
    weight_fn = options.weight_fn
    if options.executor is not None or options.checkpoint is not None:
        kept = None
        if options.checkpoint is not None:
            kept = Checkpoint(options.checkpoint, digest_of([distance_fn], domain, "answers"))
        distance_fn = ParallelOracle(distance_fn, options.executor, kept)
    if folding is not None:
        domain, weight_fn = folding.box, partial(folded_weights, weight_fn, folding)
        distance_fn = partial(_of_folded, distance_fn, folding)

    # 3. Grow the partition.
    pattern, dense = (
        sample_pattern(domain.dim, factor * int(num_samples), float(options.margin), int(seed))
        for factor in (1, _DENSE_FACTOR)
    )
    sampler = Sampler(
        distance_fn, domain, weight_fn, pattern, dense, checked.max_axis_depth, options.compute_coefficients, memory
    )
    tree, stored = model.construct(sampler, Rules(options.should_split, options.split), checked)
    model = leaf_model(model.name)  # a file knows no options of a model
    contents = DecodedFile(domain, model, tree, stored, folding=folding)

    # 4. Prove its error.
    if proof is not Proof.NONE and memory is not None:
        root = memory.sources(Cells.root(domain.dim))
        try:
            contents = replace(contents, certificate=certificate_of(contents, root, proof))
        except KeyboardInterrupt:
            message = "Interrupted in its proof: the PLR is as it was to be, but nothing is proven of it."
            warnings.warn(message, ConstructionInterrupted, stacklevel=4)
    return contents


def _of_folded(distance_fn: DistanceFn, folding: Folding, z: Points) -> Distances:
    """Distances of points that fold to given ones."""
    return call_oracle(distance_fn, folding.unfold(z))


def proof_of(certified: bool | str) -> Proof:
    """Return the kind of proof that ``certified`` asks for."""
    if isinstance(certified, str) and certified == "leaves":
        return Proof.LEAVES
    if not isinstance(certified, bool | np.bool):
        raise ValueError(f"certified must be True, False or 'leaves', got {shortened(certified)}.")
    return Proof.CLASSES if certified else Proof.NONE


def _advice(distance_fn: FreeSpaceFn, domain: Box) -> str | None:
    """Return a warning if most free points do not reach the goal."""
    x = domain.lo + domain.width * np.random.default_rng(0).random((_NUM_ADVICE_POINTS, domain.dim))
    try:
        x = x[np.asarray(distance_fn.is_free(x))]
        cut_off = np.count_nonzero(np.isinf(np.ma.filled(distance_fn(x), np.inf))) if len(x) else 0
    except KeyboardInterrupt:  # the PLR is complete
        return None
    if 2 * cut_off <= len(x):
        return None
    return (
        f"The goal cannot be reached from {100 * cut_off / len(x):.0f} % of {len(x):,} free points of the domain. Is "
        "it in the part of free space that you mean? What the PLR answers in the others means nothing."
    )


# ``leaf="best"``: build the leaf models that may serve a distance function, and keep the one that errs least.


@dataclass(frozen=True, eq=False)
class _OracleOfBox:
    """An oracle that finds what it says of a box, as one cell, once for all leaf models that are tried."""

    oracle: CellwiseFn
    box: Box

    @cached_property
    def cell(self) -> CellSources:
        return self.oracle.cell_sources(self.box)

    @property
    def sources(self) -> Sources:
        return self.cell.sources

    def cell_sources(self, domain: Box) -> CellSources:
        return self.cell if domain == self.box else self.oracle.cell_sources(domain)

    def __call__(self, x: ArrayLike) -> Distances:
        return np.ma.filled(self.oracle(x), np.inf)


def best_leaves(
    build: Callable[[str, DistanceFn], DecodedFile],
    distance_fn: DistanceFn,
    domain: Box,
    proof: Proof,
    max_bytes: int | None,
    only_bytes: bool,
    seed: int,
) -> tuple[DecodedFile, bool]:
    """Build leaves of all models that may serve, and return those that err least.

    Args:
        build: Function of a model's name and an oracle that builds leaves. Models for which it raises ``ValueError``
            are left out.
        distance_fn: The distance function.
        domain: The box to cover.
        proof: Kind of proof. With a proof the largest proven errors are compared, else the geometric means of the
            mean and the largest error at random points.
        max_bytes: The budget, as the caller gave it.
        only_bytes: Whether neither the number of leaves nor the depth is limited, and no rules are the caller's own:
            then cones alone may be tried.
        seed: Seed of the random points.

    Returns:
        The leaves, and whether an interrupt (Ctrl-C) ended the search early.

    Raises:
        ValueError: If no model can be built.
    """
    if isinstance(distance_fn, CellwiseFn) and domain.dim == 2 and not domain.is_periodic:
        distance_fn = _OracleOfBox(distance_fn, grown_domain(domain))
    names = _models_to_try(distance_fn, domain, proof, max_bytes, only_bytes)
    best, least, refused = None, math.inf, []
    with tqdm(names, "construct", unit=" models", leave=False, disable=None) as progress:
        for name in progress:
            progress.set_description(f"construct: leaves of kind {name!r}")
            is_interrupted, error = False, 0.0
            try:
                with warnings.catch_warnings(record=True) as caught:
                    warnings.simplefilter("always", ConstructionInterrupted)
                    contents = build(name, distance_fn)
            except ValueError as refusal:  # for example, a budget that is too small for one leaf of this model
                refused.append(refusal)
                continue
            except KeyboardInterrupt:
                if best is None:
                    raise
                return best, True
            for warning in caught:
                if issubclass(warning.category, ConstructionInterrupted):
                    is_interrupted = True
                else:
                    warnings.warn_explicit(warning.message, warning.category, warning.filename, warning.lineno)
            if proof is not Proof.NONE:  # an interrupted build has no certificate
                error = math.inf if contents.certificate is None else contents.certificate.max_error
            elif len(names) > 1:
                try:
                    error = _sampled_error(contents, distance_fn, seed)
                except KeyboardInterrupt:
                    is_interrupted, error = True, math.nan
            if best is None or error < least:
                best, least = contents, error
            if is_interrupted:
                return best, True
    if best is None:
        raise min(refused, key=lambda error: getattr(error, "num_bytes", math.inf))
    return best, False


def _models_to_try(
    distance_fn: DistanceFn, domain: Box, proof: Proof, max_bytes: int | None, only_bytes: bool
) -> list[str]:
    """Return names of leaf models: cones alone where all corners have much room, all but cones where few have room.

    On all maps of the experiments cones with that room err ten to a thousand times less on average than the others.
    With less room, they may err far more than the others in few leaves. Of the other models all are tried for the
    least proven error. Without a proof planes are not, which err more than continuous leaves on average, and smooth
    leaves, which take longer to build and to query, only where cones are.
    """
    cones = [name for name in leaf_names() if isinstance(leaf_model(name), Cone)]
    others = [name for name in leaf_names() if name not in cones]
    if proof is Proof.NONE:
        others = ["continuous" if domain.dim <= _MOST_TIED_AXES else "plane"]
    if not isinstance(distance_fn, _OracleOfBox):
        return others
    corner_bytes = _BYTES_A_SOURCE * np.count_nonzero(np.isfinite(distance_fn.sources.distances))
    share = corner_bytes / max_bytes if isinstance(max_bytes, int | float) and max_bytes > 0 else 0.0
    if share <= _ROOMY and only_bytes:
        return cones
    if proof is Proof.NONE and share <= _CROWDED:
        others.append("smooth")
    return [name for name in leaf_names() if name in others or (name in cones and share <= _CROWDED)]


def _sampled_error(contents: DecodedFile, distance_fn: DistanceFn, seed: int) -> float:
    domain = contents.domain
    x = domain.lo + domain.width * np.random.default_rng(seed).random((_ERROR_POINTS, domain.dim))
    distance = as_distances("The distance function", distance_fn(x), x)
    reached = np.isfinite(distance)
    errors = np.abs(NumpyPLR(encode(contents))(x[reached]) - distance[reached])
    return float(np.sqrt(errors.mean() * errors.max())) if len(errors) else 0.0


# Proving how far a PLR that exists can be from the distance function that it stands for.


def certify(plr: "PLR", oracle: DistanceFn, *, leaf_bounds: bool = False) -> "PLR":
    """Prove bounds of the distance for a PLR that exists.

    Nothing is sampled: the oracle says, for whole cells, which sources some of their points may use and which all of
    them can. The proof holds for all points of the domain from which the goal can be reached. It is about this
    oracle: where that is itself an approximation, as of an inflated workspace, so is the proof. Where free space
    touches itself in a point, the cell there holds both sides, and the proven error is at least half of the jump.

    Args:
        plr: The PLR, of any leaf model, in the plane.
        oracle: The distance function, one that answers for whole cells, as ``VisibilityGraph`` does.
        leaf_bounds: Whether to keep bounds of every leaf, 2 bytes each; else of a few classes of leaves, in at most a
            128th of what the leaves take, if that is 10 bytes at least; of smaller PLRs the largest error alone.

    Returns:
        The same PLR with this proof instead of any it had, in ``max_error`` and ``bounds``.

    Raises:
        ValueError: If it is no PLR in the plane, its domain has a periodic axis or lies so far from the origin that
            free space is known worse than to a 10,000th of its shorter side, ``leaf_bounds`` is no bool, the oracle
            does not answer for cells, or a leaf answers ``inf`` although some of its points reach the goal: then
            nothing can be proven.
    """
    from plr_jax.plr._plr import PLR, with_certificate  # and JAX, which no proof needs

    if not isinstance(plr, PLR):
        raise ValueError(f"Only a PLR can be certified, got {shortened(plr)}.")
    if plr.tables.folding is not None:
        raise ValueError(
            "Nothing can be proven of a PLR whose points are folded, as by the symmetries of its distance function. "
            "Build it with certified=True."
        )
    proof = Proof.LEAVES if as_bool("leaf_bounds", leaf_bounds) else Proof.CLASSES
    root = require_certifiable(oracle, plr.domain).cell_sources(grown_domain(plr.domain))
    certified = with_certificate(plr, certificate_of(plr._contents, root, proof))
    if isinstance(plr.leaf, Cone) and isinstance(oracle, ChangingFn):
        certified.build_inputs = BuildInputs(oracle, certified.num_bytes)
    return certified


def require_certifiable(oracle: DistanceFn, domain: Box) -> CellwiseFn:
    """A distance function about which something can be proven; raises ``ValueError`` if it is none."""
    if domain.dim != 2 or not isinstance(oracle, CellwiseFn):
        raise ValueError(
            "A proof needs a distance function in the plane that answers for whole cells, such as VisibilityGraph, "
            f"got a {type(oracle).__name__} in {domain.dim} dimensions. Build the PLR without one, and measure its "
            "error."
        )
    if domain.is_periodic:
        raise ValueError(
            f"A proof is of Euclidean distances in the plane, which has no periodic axis, got {domain}. Build the "
            "PLR without one, and measure its error."
        )
    return oracle
